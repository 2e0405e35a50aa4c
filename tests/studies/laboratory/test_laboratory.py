"""The laboratory: a slice of every case meets its criterion, and what does not is never hidden."""

from __future__ import annotations

import csv
import itertools
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from mbsgen.style import picture_format
from mbsrun import cli
from mbsrun.external import Mechanism
from mbsrun.measuring.sections import read_folders
from mbsrun.models import find_folder
from mbsrun.ocp.ground.status import INFEASIBLE
from mbsrun.ocp.methods import Answer
from mbsrun.ocp.problem.problem import Representation
from mbsrun.ocp.solution.solution import Failure, Run, Solution
from mbsrun.ocp.solving.phases import PhasedSolver
from mbsrun.ocp.solving.solve import solve
from studies.laboratory import (
    chains,
    derivatives,
    digits,
    expressions,
    integration,
    interpretation,
    limits,
    locks,
    loops,
    maps,
    modelling,
    optimisation,
    orientations,
)
from studies.laboratory import command as lab_commands
from studies.laboratory.case import (
    Case,
    Finding,
    Loss,
    Trial,
    Workspace,
    check,
    demand,
    find_worst,
    judge,
    show_failure,
)
from studies.laboratory.cases import CASES
from studies.laboratory.digits import specimen
from studies.laboratory.mechanisms import LOCKS, describe_lock, describe_spatial, draw, write
from studies.laboratory.runs import name_verdict, open_workspace, run_cases, write_findings
from tests.picture_kinds import find_kind

Measure = Callable[[Workspace], list[Finding]]

SLICE: dict[str, str | Measure] = {  # of each case a short trial, or a smaller one
    "F01": partial(chains.measure_straight, size=2),
    "F02": partial(chains.measure_long, kind="spatial", size=12),
    "F03": partial(chains.measure_heavy_tip, size=3, ratio=1e8),
    "F04": partial(chains.measure_harmless, factors=[1.0, 1e12, 1.0], is_alarming=True),
    "F05": partial(locks.measure_lock, lock="elbow", distances=(1e-3, 1e-9, 0.0)),
    "F06": "a leaf without mass",
    "F07": "where the file allows it",
    "F08": "a mass below 1e-150",
    "F10": "1e-06 rad away",
    "F11": "3 links",
    "F13": "1e22 rad",
    "F14": "refusals",
    "F15": partial(chains.measure_single, kind="spatial", size=3),
    "F16": "rod, h = 0.01 s",
    "F17": "midpoint rule",
    "F18": partial(integration.measure_explicit, durations=(0.025, 0.05)),
    "F20": "weights",
    "F23": "a start at a lock",
    "F24": partial(loops.measure_passages, bars=1),
    "F25": partial(derivatives.measure_derivatives, size=2),
    "F26": "lengths",
    "F28": "1 ms",
    "F30": "a spring",
    "F36": partial(limits.measure_masses, intervals=(8,)),
}
ELSEWHERE = (  # in tests/mbsgen/failures, simulation and ocp; and below, in part
    *("F09", "F12", "F19", "F21", "F22"),
    *("F27", "F29", "F31", "F32", "F33", "F34", "F35"),
)


def quiet(*_: object) -> None:
    """Ignore progress."""


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    return open_workspace(tmp_path_factory.mktemp("laboratory"))


def test_every_case_is_run() -> None:
    assert [case.id for case in CASES] == [f"F{k:02}" for k in range(1, 37)]
    assert all(case.trials for case in CASES)
    for case in CASES:
        assert len({trial.name for trial in case.trials}) == len(case.trials)
    assert {*SLICE, *ELSEWHERE} == {case.id for case in CASES}


@pytest.mark.parametrize(("name", "trial"), SLICE.items(), ids=SLICE)
def test_criteria_are_met(name: str, trial: str | Measure, workspace: Workspace) -> None:
    if isinstance(trial, str):
        (trial,) = (x.measure for case in CASES if case.id == name for x in case.trials if x.name == trial)
    findings = trial(workspace)
    assert findings
    assert [x for x in findings if not x.is_met] == []


CONTRASTS = {  # a short trial of each, in which a method that fails stands beside
    "F11": "determinants",
    "F13": "1e22 rad",
    "F14": "fast-math",
    "F19": "the solver's word",
    "F21": "one start",
    "F23": "IPOPT alone",
}


@pytest.mark.parametrize(("name", "trial"), CONTRASTS.items(), ids=CONTRASTS)
def test_a_method_that_fails_stands_beside(name: str, trial: str, workspace: Workspace) -> None:
    (measure,) = (x.measure for case in CASES if case.id == name for x in case.trials if x.name == trial)
    findings = measure(workspace)
    assert any(x.is_contrast for x in findings)
    assert [x for x in findings if not x.is_met] == []


@pytest.mark.parametrize("intervals", [5, 20, 40])
@pytest.mark.parametrize("representation", [Representation.IMPL, Representation.SEMI])
def test_a_start_at_a_lock_has_the_optimum_of_ipopt(
    representation: Representation, intervals: int, workspace: Workspace
) -> None:
    """Rates of some joints are hardly determined by the others there, and digits are lost if they are condensed."""
    plant = Mechanism(find_folder(write(workspace.folder, describe_lock(LOCKS["Cardan"])), optimisation.EXTENT))
    problem = optimisation.state_locked_start(intervals, representation)
    found, other = (solve(replace(problem, solver=problem.solver.with_method(x)), plant) for x in ("mbs", "ipopt"))
    assert isinstance(found, Solution)
    assert isinstance(other, Solution)
    assert found.cost.total == pytest.approx(other.cost.total, rel=1e-9)
    assert found.run.iterations <= other.run.iterations + 3


@pytest.mark.parametrize("status", ["Solve_Succeeded", "Infeasible_Problem_Detected"])
def test_an_end_at_which_a_kernel_fails_is_a_failure(
    status: str, workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Accelerations at a lock have no numbers, whatever a method says; no exception leaves the solver."""
    plant = Mechanism(find_folder(write(workspace.folder, describe_lock(LOCKS["Cardan"])), optimisation.EXTENT))
    monkeypatch.setattr(PhasedSolver, "_find_method", lambda *_: lambda start: Answer(start.x, status, 3))
    found = solve(optimisation.state_locked_start(20, Representation.EXP1_O), plant)
    assert isinstance(found, Failure)
    assert found.run.status == (status if status in INFEASIBLE else "Invalid_Number_Detected")


def test_determinants_are_multiplied_out() -> None:
    """Exact for whole numbers; Cramer's rule solves."""
    A = np.array([[2.0, -1, 3, 0], [1, 4, 0, -2], [0, 5, -1, 1], [3, 1, 2, 2]])
    assert expressions.multiply_out(A) == pytest.approx(np.linalg.det(A), rel=1e-14)
    x = np.array([1.0, -2, 3, 4])
    np.testing.assert_allclose(expressions.divide_determinants(A, A @ x), x, rtol=1e-14)


def test_exact_accelerations_are_those_of_elimination(workspace: Workspace) -> None:
    """Refinement and elimination in 50 digits agree to far more than a double; so do the mass matrices of both."""
    chosen, states = specimen(workspace, describe_spatial(3), "exp2"), draw(3, [3])
    (exact,) = chosen.find_exact(states)
    assert max(float(abs(a / b - 1)) for a, b in zip(exact.qdd, exact.moment.qdd, strict=True)) < 1e-22
    M = chosen._compute_mass({name: x[0] for name, x in states.items()})
    np.testing.assert_allclose(M, exact.M, rtol=0, atol=1e-14 * exact.M.max())


def test_elimination_in_loops() -> None:
    """It solves; it names the joint whose pivot is below n u 1000 of its entry; and takes no NaN."""
    rng = np.random.default_rng(0)
    A = rng.normal(size=(5, 5))
    M, b = A @ A.T + np.eye(5), rng.normal(size=5)
    found = interpretation.eliminate(M, b)
    assert found.status == 0
    np.testing.assert_allclose(found.x, np.linalg.solve(M, b), rtol=1e-13)
    unit = np.eye(5)
    unit[1, 2] = unit[2, 1] = np.sqrt(1 - 1e-13)  # joint 3 holds joint 2, of which 1e-13 is left: below 5 u 1000
    found = interpretation.eliminate(unit, b)
    assert found.status == 2
    assert found.x is not None
    unit[1, 2] = unit[2, 1] = np.sqrt(1 - 1e-12)
    assert interpretation.eliminate(unit, b).status == 0
    unit[1, 2] = unit[2, 1] = 1.1
    assert interpretation.eliminate(unit, b) == interpretation.Eliminated(2, None)
    assert interpretation.eliminate(np.full((2, 2), np.nan), b[:2]).status


def test_interpreted_chains_are_the_compiled_ones(workspace: Workspace) -> None:
    """To rounding, in every block of states; a status names a joint, and leaves no result."""
    compiled, states = specimen(workspace, describe_spatial(4), "exp2", "impl"), draw(4, range(40))
    chain = interpretation.LongChain(compiled.subject.model, 4)
    for kernel, result in (("impl", "Phi"), ("exp2", "qdd")):
        statuses, found = chain.evaluate(kernel, states)
        assert not statuses.any()
        for x, wanted in zip(found, compiled.evaluate(kernel, states)[1], strict=True):
            np.testing.assert_allclose(x[result], wanted[result], rtol=0, atol=1e-11 * np.abs(wanted[result]).max())
    path = write(workspace.folder, describe_lock("zyx"))
    lock = draw(3, range(2))
    lock["q"][1, 1] = np.pi / 2
    statuses, found = interpretation.LongChain(path, 3).evaluate("exp2", lock)
    assert statuses.tolist() == [0, 1]
    assert found[1] == {}


def test_the_pendulum_is_where_the_reference_has_it() -> None:
    """IFToMM's A01, of 40 digits: the angle's closed form to what SciPy's elliptic functions have over 2000 s."""
    file = Path(__file__).parents[2] / "reference" / "iftomm_A01_pendulum.json"
    places = json.loads(file.read_text(encoding="utf-8"))["xy_start_plus1"]
    assert len(places) == 7
    for t, (x, y) in places.items():
        q = float(integration.swing(float(t)))
        assert np.hypot(np.sin(q) - float(x), -np.cos(q) - float(y)) <= 1e-14 * max(10, float(t))


def test_bricards_screws_have_the_known_rank() -> None:
    """In the cube: 2 sin(72 deg) and 2 sin(36 deg), twice each, and 0."""
    found = np.linalg.svd(loops.list_screws(np.zeros(5)), compute_uv=False)
    np.testing.assert_allclose(found, loops.HOME, rtol=0, atol=1e-14)
    assert loops._find_rank(loops.list_screws(np.arange(5.0))) == 5  # its loop is open


def test_close_to_the_level_pose_digits_are_lost_or_a_loop_is_named(workspace: Workspace) -> None:
    """The reduced form keeps to it everywhere."""
    found = [x for x in loops.measure_level(workspace, bars=1) if x.way == "EXP1_RED"]
    assert [x for x in found if not x.is_met] == []
    assert {x.quantity for x in found} == {"error without a status", "status names a loop, and not too early"}


def test_lagranges_equations_are_right_and_their_length_is_counted() -> None:
    """A thin rod under gravity: (1/3) q'' = u - (9.81/2) cos q, in two products, a sum, a cosine and a quotient."""
    lagrange, length = modelling.derive(1)
    assert abs(float(lagrange(0.3, 2.0, 0.5)) - 3 * (0.5 - 4.905 * np.cos(0.3))) < 1e-13
    assert modelling.derive(2)[1] > 10 * length > 0


def test_the_reference_of_quaternions_is_a_rotation() -> None:
    """A quarter turn about z, of any length and sign."""
    for length in (1.0, -1.0, 7.0):
        R = orientations.turn(length * np.array([0, 0, np.sqrt(0.5), np.sqrt(0.5)]))
        np.testing.assert_allclose(R, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)


def test_the_price_of_a_turn_nears_the_smooth_one() -> None:
    """12 times the squared angle, by the Euler-Lagrange equations; constant inputs cost a little more."""
    assert 12 < orientations._price(1.0) < 12 * 1.01


LOSS = Loss("Cardan", 3, 1e-9, 0, "EXP1", 1e18, 1e18, 1e-3, 0.99, 1e-16)


def test_a_wrong_number_in_silence_is_not_met() -> None:
    """Neither is a status with another joint, an unnecessary one, nor one for masses that only scale M."""
    assert not locks._check_loss(LOSS).is_met
    assert locks._check_loss(replace(LOSS, error=None, failed="q1")).is_met
    assert not locks._check_loss(replace(LOSS, error=None, failed="q2")).is_met
    assert not locks._check_loss(replace(LOSS, error=None, failed="q1", estimate=1e-9)).is_met
    assert not locks._check_loss(replace(LOSS, error=float("nan"))).is_met
    assert not chains._check_error(replace(LOSS, error=None, failed="q1"), 1e-11).is_met
    assert not digits.check_estimate(replace(LOSS, estimate=1e-15)).is_met
    assert not digits.check_estimate(replace(LOSS, error=None)).is_met


def test_a_heavy_tip_may_fail_only_where_digits_are_gone() -> None:
    failed = replace(LOSS, error=None, failed="q1")
    assert chains._check_failure(failed).is_met
    assert chains._check_failure(replace(failed, estimate=None)).is_met
    far = replace(failed, way="EXP2", estimate=1e-4)  # times 16, more than 1e-3
    assert chains._check_failure(far).is_met
    for other in (
        replace(failed, estimate=1e-4),
        replace(far, estimate=1e-5),
        replace(far, scaled=1e10),
        replace(failed, failed="nothing: not a number"),
    ):
        assert not chains._check_failure(other).is_met


def test_verdicts_are_of_the_worst() -> None:
    """In any order, of each case and way apart; what misses its bound comes first; what is not a number misses."""
    found = [check("EXP1", "error", x, 1.0) for x in (0.9, 0.1, 0.5)] + [check("EXP1", "other", 1e-9, 1e-10)]
    for order in itertools.permutations(found):
        (verdict,) = judge(order)
        assert (verdict.quantity, verdict.met, verdict.total, verdict.is_met) == ("other", 3, 4, False)
    for order in itertools.permutations(found[:3]):
        (verdict,) = judge(order)
        assert (verdict.value, verdict.is_met) == (0.9, True)
    found += [demand("EXP2", "status", is_met=True, remark=""), check("EXP1", "nan", float("nan"), 1.0)]
    apart = judge([replace(x, case=case) for case in ("F01", "F02") for x in found])
    assert [(x.case, x.way, x.met, x.total) for x in apart] == [
        (case, way, met, total) for case in ("F01", "F02") for way, met, total in (("EXP1", 3, 5), ("EXP2", 1, 1))
    ]
    assert [x.quantity for x in apart] == ["nan", "status"] * 2
    assert not check("EXP1", "error", float("nan"), 1.0).is_met
    assert not check("EXP1", "error", float("inf"), 1.0).is_met
    assert check("EXP1", "error", 1.0, 1.0).is_met


def test_a_way_that_is_known_to_fail_has_to() -> None:
    """A verdict says which it is; what is not a number shows nothing."""
    for value, is_met in ((2.0, True), (float("inf"), True), (1.0, False), (0.5, False), (float("nan"), False)):
        finding = show_failure("by hand", "error", value, 1.0)
        assert finding.is_met == is_met
        (verdict,) = judge([finding])
        assert name_verdict(verdict) == ("fails, as known" if is_met else "does not fail")


def test_nothing_compared_is_no_agreement() -> None:
    assert find_worst([0.1, 0.3, 0.2]) == 0.3
    assert np.isnan(find_worst([]))
    assert np.isnan(find_worst([0.1, float("nan"), 0.2]))


def test_orders_are_of_errors_that_fall() -> None:
    np.testing.assert_allclose(optimisation._find_orders([1.0, 0.125, 2.0**-9]), [3, 6])
    assert not check("d = 2", "order off", abs(optimisation._find_orders([1.0, np.nan])[0] - 3), 0.1).is_met
    assert not check("d = 2", "order off", abs(optimisation._find_orders([1.0, 0.0])[0] - 3), 0.1).is_met


def fail(status: str) -> Failure:
    return Failure(optimisation.state_push(2), Run(status, 3, 0.0, 0.0), "", "")


def test_a_status_has_to_be_its_own() -> None:
    """A limit of iterations is no answer, and a failure that calls itself solved is none either."""
    assert optimisation.judge_status("IMPL", "", "Diverging_Iterates", fail("Diverging_Iterates")).is_met
    assert not optimisation.judge_status("IMPL", "", "Diverging_Iterates", fail("Maximum_Iterations_Exceeded")).is_met
    assert not optimisation.judge_status("IMPL", "", "Solve_Succeeded", fail("Solve_Succeeded")).is_met
    assert "Maximum_Iterations_Exceeded" not in {wanted for _, wanted, _ in optimisation.ATTEMPTS}


@pytest.mark.parametrize(
    ("costs", "failures", "met"),
    [
        ({58.1: 8, 58.93: 28, 304.4: 4}, {}, [True] * 4),
        ({58.1: 8, 58.93: 28}, {"Infeasible_Problem_Detected": 4}, [True, True, True, False]),
        ({58.93: 36, 304.4: 4}, {}, [True, False, True, True]),
        ({58.1: 8, 304.4: 32}, {}, [True, True, False, True]),
        ({58.1: 8, 58.93: 27, 304.4: 4}, {}, [False, True, True, True]),
        ({}, {"Infeasible_Problem_Detected": 40}, [True, False, False, False]),
    ],
)
def test_every_known_minimum_is_to_be_found(costs: dict[float, int], failures: dict[str, int], met: list[bool]) -> None:
    assert [x.is_met for x in optimisation.judge_minima("IMPL", costs, failures)] == met


def find_nothing(_: Workspace) -> list[Finding]:
    return []


def test_a_trial_without_findings_is_not_met(tmp_path: Path) -> None:
    (finding,) = run_cases([Case("F01", "case", "", "", (Trial("a", find_nothing),))], tmp_path, quiet)
    assert not finding.is_met


def break_down(_: Workspace) -> list[Finding]:
    raise ZeroDivisionError("its own")


def count(calls: list[str], name: str) -> Callable[[Workspace], list[Finding]]:
    def measure(_: Workspace) -> list[Finding]:
        calls.append(name)
        return [check("EXP1", "error", 0.5, 1.0, name)]

    return measure


def test_a_trial_that_breaks_hides_no_other_and_is_tried_again(tmp_path: Path) -> None:
    """Findings are kept, even if the run is cut off in the middle of a line."""
    calls: list[str] = []
    trials = (Trial("a", count(calls, "a")), Trial("broken", break_down), Trial("b", count(calls, "b")))
    cases = [Case("F01", "case", "", "", trials)]
    for expected in (["a", "b"], ["a", "b"]):
        findings = run_cases(cases, tmp_path, quiet)
        assert [(x.trial, x.is_met) for x in findings] == [("a", True), ("broken", False), ("b", True)]
        assert "ZeroDivisionError: its own" in findings[1].remark
        assert calls == expected
    kept = tmp_path / "findings.jsonl"
    kept.write_text(kept.read_text(encoding="utf-8")[:-20], encoding="utf-8")
    run_cases(cases, tmp_path, quiet)
    assert calls == ["a", "b", "b"]
    write_findings(cases, findings, tmp_path)
    with (tmp_path / "verdicts.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["verdict"] for row in rows] == ["met", "not met"]
    assert "| EXP1 | error | 0.5 | 1 | a | 2 of 2 | met |" in (tmp_path / "verdicts.md").read_text(encoding="utf-8")
    estimate = json.loads((tmp_path / "verdicts.json").read_text(encoding="utf-8"))
    assert set(estimate) == {"title", "columns", "rows", "note"}


def test_maps_show_errors_and_statuses(tmp_path: Path) -> None:
    """With their tables, as reports take them in; what is not known is drawn as well."""
    losses = [
        replace(LOSS, number=d, way=way, error=error, estimate=estimate, failed="" if error else "q1")
        for way in ("EXP1", "EXP2")
        for d, error, estimate in ((1e-3, 1e-12, 1e-12), (1e-8, None, None), (0.0, None, 2.0))
    ]
    losses += [replace(x, mechanism="heavy tip", number=10 ** (1 + k % 3)) for k, x in enumerate(losses)]
    (tmp_path / "printed").mkdir()
    with picture_format("pdf"):
        printed = maps.draw_maps(losses, tmp_path / "printed")
    assert [find_kind(path) for path in printed if path.suffix == ".pdf"] == ["pdf"] * 3
    paths = maps.draw_maps(losses, tmp_path)
    assert sum(path.suffix == ".png" for path in paths) == 3
    assert all(path.stat().st_size > 4_000 for path in paths if path.suffix == ".png")
    (section,) = read_folders([tmp_path])
    assert section.name == "laboratory"
    assert len(section.items) == 6


def test_the_list_keeps_the_width_that_is_asked_for(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """And cuts no word off."""
    for width in (60, 120):
        monkeypatch.setenv("COLUMNS", str(width))
        assert run(monkeypatch, "--list") in (0, None)
        lines = capsys.readouterr().out.splitlines()
        assert max(map(len, lines)) <= width
        listed = "".join(lines).replace(" ", "")
        assert listed.count("…") == sum((case.setup + case.criterion).count("…") for case in CASES)
        assert all(any(case.id in line for line in lines) for case in CASES)


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> object:
    monkeypatch.setattr(sys, "argv", ["mbsrun", "lab", *arguments])
    with pytest.raises(SystemExit) as end:
        cli.main()
    return end.value.code


def test_the_command_tells_by_its_exit_code(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    assert run(monkeypatch, "--list") in (0, None)
    assert "F24" in capsys.readouterr().out
    assert run(monkeypatch, "F99") == 2
    assert "there is no case F99" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
    assert run(monkeypatch, "f07", "--quick", "-o", "out") in (0, None)
    assert "F07" in capsys.readouterr().out
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {"verdicts.json", "findings.csv", "findings.jsonl"}
    broken = Case("F07", "broken", "", "", (Trial("broken", break_down),))
    monkeypatch.setattr(lab_commands, "CASES", (broken,))
    assert run(monkeypatch, "F07", "-o", "other") == 1
    assert "not met: F07, broken" in capsys.readouterr().out
