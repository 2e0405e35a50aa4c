"""The benchmark of optimal control: the peer solves the same program, and the table says so."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from benchmarks.ocp.__main__ import (
    MODELS,
    Way,
    check_dynamics,
    list_variants,
    main,
    make_ours,
    measure,
    write_place,
)
from benchmarks.ocp.peer import Effort, Peer, Points, Shelf, list_settings, write_dynamics
from benchmarks.ocp.rows import (
    OURS,
    Figures,
    Measured,
    Row,
    write_figures,
    write_page,
)
from benchmarks.study import DisagreementError
from mbsgen.pipeline import read_tree
from mbsrun.measuring.store import Store
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.guess import make_guess
from mbsrun.ocp.problem.problem import Problem, Representation
from mbsrun.ocp.statement.statement import read_problem
from tests.mbsrun.peer_arm import peer_arm


@pytest.fixture(scope="module")
def problem() -> Problem:
    return read_problem(MODELS / "arm_reach.ocp.yaml", lambda _: peer_arm())[0]


@pytest.fixture(scope="module")
def dynamics() -> dict[str, ca.Function]:
    return write_dynamics(read_tree(MODELS / "arm_pendulum.yaml"))


def test_the_peer_has_the_same_mechanics(dynamics: dict[str, ca.Function]) -> None:
    """Residual, its other form, accelerations and the hand's place agree with the arm made by hand."""
    arm, rng = peer_arm(), np.random.default_rng(2)
    q, qd, qdd, u = rng.uniform(-1, 1, 6), rng.uniform(-1, 1, 6), rng.uniform(-1, 1, 6), rng.uniform(-1, 1, 4)
    Phi = arm("impl", q=q, qd=qd, qdd=qdd, u=u)["Phi"]
    for name in ("impl", "semi"):
        assert dynamics[name](q, qd, qdd, u).full().ravel() == pytest.approx(Phi, abs=1e-12)
    found = dynamics["exp"](q, qd, u).full().ravel()
    assert np.abs(arm("impl", q=q, qd=qd, qdd=found, u=u)["Phi"]).max() < 1e-11
    symbol = ca.SX.sym("q", 6)
    place = ca.Function("place", [symbol], [write_place(symbol)])
    assert place(q).full().ravel() == pytest.approx(arm("sensors", q=q)["position"][:, 0], abs=1e-14)


@pytest.mark.parametrize("name", ["IMPL", "EXP1-O"])
def test_the_peer_has_the_program_of_the_paper(problem: Problem, dynamics: dict[str, ca.Function], name: str) -> None:
    """Table 3: 8812 variables, 8427 constraints, 72435 nonzeros; or 6412, 6027, 62519 for an ODE."""
    chosen = replace(problem, representation=Representation(name))
    symbol = ca.SX.sym("q", 6)
    place = ca.Function("place", [symbol], [write_place(symbol)])
    peer = Peer(chosen, dynamics, place, list_settings(chosen)["defaults"])
    sizes = (peer.variables, peer.constraints, peer.jacobian_nonzeros)
    assert sizes == ((8812, 8427, 72435) if name == "IMPL" else (6412, 6027, 62519))


def test_a_compiled_peer_is_kept_with_what_compiling_it_took(
    tmp_path: Path, problem: Problem, monkeypatch: pytest.MonkeyPatch, requires: Callable[[str], str]
) -> None:
    """Found again by its text, without the compiler, and solves as the interpreted one does."""
    requires("cc")
    q, qd, qdd, u = (ca.SX.sym(name, size) for name, size in (("q", 6), ("qd", 6), ("qdd", 6), ("u", 4)))
    light = {"impl": ca.Function("impl", [q, qd, qdd, u], [qdd - ca.vertcat(u, 0, 0) + ca.sin(q)])}
    place = ca.Function("place", [q], [q[:3]])
    chosen = replace(problem.with_target("hand", (0.1, 0.9, -1.9)), intervals=5, degree=2)
    shelf = Shelf(tmp_path)
    monkeypatch.setattr("benchmarks.ocp.peer.FLAGS", ["-O0"])
    first = Peer(chosen, light, place, list_settings(chosen)["tuned"], shelf)
    (library,) = tmp_path.glob("*.so")
    (record,) = tmp_path.glob("*.json")
    assert json.loads(record.read_text("utf-8"))["seconds"] > 0
    record.write_text('{"seconds": 1000}', "utf-8")
    monkeypatch.setattr("benchmarks.ocp.peer.FLAGS", ["-O0", "-DOTHER"])
    other = Peer(chosen, light, place, list_settings(chosen)["tuned"], shelf)
    monkeypatch.setattr("benchmarks.ocp.peer.FLAGS", ["-O0"])
    again = Peer(chosen, light, place, list_settings(chosen)["tuned"], shelf)
    assert other.seconds_building < 1000 <= again.seconds_building
    assert len(list(tmp_path.glob("*.so"))) == 2
    assert library.exists()
    assert first.jacobian_nonzeros == again.jacobian_nonzeros


def test_a_peer_at_points_and_the_whole_program_have_one_optimum(
    tmp_path: Path, problem: Problem, dynamics: dict[str, ca.Function], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same equations: compiled at a point and assembled, or differentiated as a whole by CasADi, expanded."""
    monkeypatch.setattr("benchmarks.ocp.peer.FLAGS", ["-O0"])
    chosen = replace(problem, intervals=6, degree=2)
    plant, impl = peer_arm(), dynamics["impl"]
    guess = make_guess(chosen, plant, schemes.build(chosen.family, chosen.degree))
    assert isinstance(guess, Trajectory)
    named = ca.Function("impl", impl.sx_in(), impl.call(impl.sx_in()), ["q", "qd", "qdd", "u"], ["Phi"])
    points = Points(plant, {"impl": named}, Shelf(tmp_path))
    check_dynamics("points", points, plant, "impl")
    wrong = ca.Function("impl", impl.sx_in(), [1.001 * named(*impl.sx_in())], named.name_in(), named.name_out())
    with pytest.raises(DisagreementError, match="impl of wrong: off by"):
        check_dynamics("wrong", Points(plant, {"impl": wrong}, Shelf(tmp_path)), plant, "impl")
    symbol = ca.SX.sym("q", 6)
    place = ca.Function("place", [symbol], [write_place(symbol)])
    whole = Peer(chosen, dynamics, place, list_settings(chosen)["tuned"]).solve(guess)
    assembled = make_ours("points", chosen, points, guess).solve()
    assert whole.status == assembled.status == "Solve_Succeeded"
    assert assembled.cost == pytest.approx(whole.cost, rel=1e-7)
    assert points.seconds_compiling > 0


def test_what_takes_long_is_solved_once_and_the_rest_has_medians() -> None:
    """Of the times 3, 1, 2 the best is 1, the median 2; a way of 60 s is not repeated."""
    times = {"quick": iter((3.0, 1.0, 2.0)), "long": iter((60.0,))}

    def make(name: str) -> Way:
        return Way(name, 0.0, 1, 1, lambda: Effort("Solve_Succeeded", 1, 5.0, (t := next(times[name])), t / 2))

    quick, slow = measure([make("quick"), make("long")], "IMPL", 3)
    assert (quick.cpu_seconds, quick.cpu_seconds_median, quick.rounds) == (1.0, 2.0, 3)
    assert (quick.cpu_seconds_evaluating, quick.cpu_seconds_evaluating_median) == (0.5, 1.0)
    assert (slow.cpu_seconds, slow.rounds) == (60.0, 1)


def test_a_quick_run_measures_both(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], requires: Callable[[str], str]
) -> None:
    """Both find the same optimum from the same guess, under the same options in as many iterations."""
    requires("cc")
    assert main(["--quick", "--representation", "IMPL", "-o", str(tmp_path / "out")]) == 0
    rows = {row["way"]: row for row in json.loads((tmp_path / "out" / "ocp.json").read_text("utf-8"))["rows"]}
    ours, peer = rows["mbsgen"], rows["CasADi, interpreted, tuned"]
    assert peer["cost"] == pytest.approx(ours["cost"], rel=1e-6)
    assert abs(peer["iterations"] - ours["iterations"]) <= 2
    assert (peer["variables"], peer["constraints"]) == (ours["variables"], ours["constraints"])
    assert "CasADi, interpreted, defaults" in capsys.readouterr().out


def test_ours_are_all_forms_solvers_and_barriers(problem: Problem) -> None:
    """The linear solver that is taken anyway is not named."""
    found = dict(list_variants(replace(problem, representation=Representation.EXP1_O)))
    names = ["", ", adaptive", ", mumps", ", mumps, adaptive", ", by stages"]
    assert list(found) == [
        f"mbsgen{form}{name}" for form in ("", ", integral form", ", shooting form") for name in names
    ]
    told = found["mbsgen, shooting form, mumps, adaptive"].solver.options
    assert dict(told) == {"linear_solver": "mumps", "mu_strategy": "adaptive"}


def test_an_interrupted_run_is_kept_and_its_load_shown(tmp_path: Path) -> None:
    """The store returns the rows of a representation; the page warns where more processes than cores wanted to run."""
    row = Row("IMPL", OURS, 1.0, 10, 9, "Solve_Succeeded", 4, 2.0, 0.5, 0.1, 3, 0.6, 0.2)
    busy = Measured((row, replace(row, way="other")), 0.5, 7.0)
    path = tmp_path / "ocp.jsonl"
    assert Store(path, Measured).find_or_measure(("IMPL",), lambda: [busy]) == [busy]
    assert Store(path, Measured).find_or_measure(("IMPL",), lambda: pytest.fail("it is kept")) == [busy]
    calm = replace(busy, load_after=0.7)
    assert Store(path, Measured, is_renewed=True).find_or_measure(("IMPL",), lambda: [calm]) == [calm]
    write_figures(Figures("a machine", 2, 3.0, (busy,)), tmp_path)
    page = (tmp_path / "ocp.md").read_text("utf-8")
    assert "0.5 to 7.0 processes" in page
    assert "disturbed" in page
    assert "disturbed" not in write_page(Figures("a machine", 2, 3.0, (calm,)))
