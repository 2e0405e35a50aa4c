"""The foundations of the comparison: counts, derivatives, agreement, the timing loop, ratios; and a slice of a whole
run.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks import growth
from benchmarks.__main__ import main
from benchmarks.angles import separate, write_source
from benchmarks.candidates import OURS, SHORT, TAPE, Candidate, Sines, read_candidate, write_candidate
from benchmarks.compilation import BuildError, Workshop
from benchmarks.ocp.rows import POINTS
from benchmarks.ocp.rows import Row as SolveRow
from benchmarks.preparation import describe_face
from benchmarks.study import Entry, Measurement, Study, find_disagreements, load
from benchmarks.summary import FILES
from benchmarks.summary import main as summarise
from benchmarks.symbolic import adjoint_jacobian, count_arithmetic, jacobian
from benchmarks.table import BASES, ROWS, Quickest, Row, Run, Timed, compare, write_json, write_markdown
from mbsrun.measuring.functions import Function, find_function
from mbsrun.measuring.store import Store
from mbsrun.measuring.timing import Watch, measure_rounds

ROOT = Path(__file__).parents[2]


def test_arithmetic_counts_roots_but_no_signs_and_no_sines() -> None:
    """Of sqrt(a b + c) - (-d) / e + sin(a) * 2, there are: a root, +, *, -, /, + and the doubling."""
    a, b, c, d, e = (ca.SX.sym(name) for name in "abcde")
    function = ca.Function("f", [a, b, c, d, e], [ca.sqrt(a * b + c) - (-d) / e + ca.sin(a) * 2])
    assert count_arithmetic(function) == 7


@pytest.fixture
def swing() -> ca.Function:
    q, u = ca.SX.sym("q", 2), ca.SX.sym("u")
    return ca.Function("swing", [q, u], [ca.vertcat(ca.sin(q[0]) * q[1], q[1] ** 2 * u)], ["q", "u"], ["Phi"])


def test_derivatives_have_the_kernels_names_and_values(swing: ca.Function) -> None:
    first, second = jacobian(swing, "jac_swing"), adjoint_jacobian(swing, "jac_adj1_swing")
    q, u, weight = [0.3, 0.7], 1.1, [2.0, 3.0]
    found = first(q=q, u=u)
    np.testing.assert_allclose(found["jac_Phi_q"], [[np.cos(0.3) * 0.7, np.sin(0.3)], [0, 2 * 0.7 * 1.1]])
    np.testing.assert_allclose(found["jac_Phi_u"], [[0], [0.7**2]])
    found = second(q=q, u=u, adj_Phi=weight)
    np.testing.assert_allclose(
        found["jac_adj_q_q"],
        [[-2 * np.sin(0.3) * 0.7, 2 * np.cos(0.3)], [2 * np.cos(0.3), 3 * 2 * 1.1]],
    )
    np.testing.assert_allclose(found["jac_adj_q_u"], [[0], [3 * 2 * 0.7]])
    np.testing.assert_allclose(found["jac_adj_q_adj_Phi"], np.array(first(q=q, u=u)["jac_Phi_q"]).T)


@pytest.fixture
def workshop(tmp_path: Path) -> Workshop:
    return Workshop(tmp_path, includes=None)


@pytest.fixture
def bind(workshop: Workshop, tmp_path: Path) -> Callable[[str, ca.SX, ca.SX], Entry]:
    """Compile a function of q as a candidate, and bind it to three states."""
    states = {"q": np.array([[0.1, 2.0], [0.2, 3.0], [0.3, 5.0]])}

    def make(name: str, q: ca.SX, result: ca.SX) -> Entry:
        function = ca.Function(name, [q], [result], ["q"], ["Phi"])
        function.generate(f"{name}.c", {"with_header": False})
        return make_call(name)

    def make_call(name: str) -> Entry:
        function = find_function(workshop.compile_c(tmp_path / f"{name}.c", name), name)
        candidate = Candidate(TAPE, "impl", name, None, function)
        assert read_candidate(json.loads(json.dumps(write_candidate(candidate)))) == candidate
        entry = load(candidate, states)
        assert entry is not None
        return entry

    return make


def test_a_peer_that_computes_something_else_is_found(
    bind: Callable[[str, ca.SX, ca.SX], Entry], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    q = ca.SX.sym("q", 2)
    right = ca.vertcat(q[0] * q[1], 1)
    one, same, other = (
        bind(name, q, result)
        for name, result in (("one", right), ("same", right * 1), ("other", ca.vertcat(q[0] * q[1], 1 + 1e-6)))
    )
    assert find_disagreements({"impl": [one, same]}, 0) == []
    assert find_disagreements({"impl": [one, same, other]}, 0) == [
        "impl: Phi of AD of our equations, other: off by 1.0e-06"
    ]


def test_the_timing_loop_passes_every_state(
    bind: Callable[[str, ca.SX, ca.SX], Entry], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a pass the results belong to the last state; every round times every function."""
    monkeypatch.chdir(tmp_path)
    q = ca.SX.sym("q", 2)
    entry = bind("product", q, q[0] * q[1])
    watch = Watch(entry.code, entry.inputs)
    assert watch.measure(2) > 0
    assert watch.last[0][0] == pytest.approx(0.3 * 5.0)
    rounds = list(measure_rounds([watch, watch], 3))
    assert np.shape(rounds) == (3, 2)
    assert np.all(np.array(rounds) > 0)


def test_a_compiler_that_fails_says_why(workshop: Workshop, tmp_path: Path) -> None:
    (tmp_path / "wrong.c").write_text("int f( { }\n", encoding="utf-8")
    with pytest.raises(BuildError, match=r"(?s)wrong\.c.*error"):
        workshop.compile_c(tmp_path / "wrong.c", "wrong")


TYPED = """
#include <stdio.h>
#include "mbs_timing.h"
#include "double_pendulum.h"

MBS_TIMED(time_impl, double_pendulum_compute_impl(arg[0], arg[1], arg[2], res[0]))

int main(void)
{
    static const double q[2][2] = {{0}, {0.1, 0.2}}, zero[2][2] = {{0}};
    const double *inputs[3];
    const long long steps[3] = {2, 2, 2};
    double Phi[2], expected[2], *results[1];
    mbs_pool pool = {2, 3, 0, 0, 0, 0, 0, double_pendulum_impl};
    inputs[0] = q[0], inputs[1] = inputs[2] = zero[0];
    results[0] = Phi, pool.inputs = inputs, pool.steps = steps, pool.results = results;
    double_pendulum_compute_impl(q[1], zero[0], zero[0], expected);
    printf("%d ", time_impl(&pool, 10) > 0 && Phi[1] == expected[1]);
    Phi[1] = 0;
    printf("%d\\n", mbs_time_kernel(&pool, 10) > 0 && Phi[1] == expected[1]);
    return 0;
}
"""


def test_typed_functions_are_timed_by_the_same_loop(requires: Callable[[str], str], tmp_path: Path) -> None:
    model, csrc = ROOT / "generated" / "double_pendulum", ROOT / "csrc"
    (tmp_path / "time.c").write_text(TYPED, encoding="utf-8")
    sources = [tmp_path / "time.c", csrc / "timing" / "mbs_timing.c", model / "double_pendulum_impl.c"]
    flags = ["-std=c99", "-D_POSIX_C_SOURCE=199309L", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
    include = [f"-I{path}" for path in (csrc, csrc / "timing", model)]
    command = [requires("cc"), *flags, "-O1", *include, *map(str, sources), "-lm", "-o", str(tmp_path / "time")]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    assert subprocess.run([tmp_path / "time"], capture_output=True, text=True, check=True).stdout == "1 1\n"


def measurement(
    author: str, function: str, way: str, flops: int | None, times: list[float] | None, sines: Sines = "libm"
) -> Measurement:
    candidate = Candidate(author, function, way, flops, None, sines)
    return Measurement(candidate, None if times is None else np.array(times))


def test_a_row_takes_the_best_of_each_author(tmp_path: Path) -> None:
    """In the second of three rounds the machine was slow, for both alike: ratios within a round do not see it."""
    study = Study(
        "arm",
        (
            measurement(OURS, "jac_exp1", "jac_exp1", 100, [10.0, 40.0, 11.0], "header"),
            measurement(OURS, "jac_exp1", "jac_exp1", 100, [20.0, 80.0, 22.0]),
            measurement(TAPE, "jac_exp1", "slow, short", 150, [50.0, 200.0, 55.0]),
            measurement(TAPE, "jac_exp2", "quick, long", 180, [25.0, 120.0, 33.0]),
            measurement(TAPE, "jac_exp1", "counted", 400, None),
            measurement(TAPE, "jac_impl", "another row's", 1, [1.0, 1.0, 1.0]),
            measurement(SHORT, "jac_exp1", "short", 200, [30.0, 160.0, 44.0]),
            measurement(SHORT, "jac_exp1", "short, header", 200, [15.0, 80.0, 22.0], "header"),
        ),
    )
    (row,) = compare(study)
    cell = row.cells[TAPE]
    assert row.title == "Jacobian of EXP1"
    assert (cell.flops, cell.flops_by, cell.flops_ratio) == (150, "slow, short", 1.5)
    assert cell.timed == {"libm": Timed(25.0, 33.0, "quick, long")}
    assert row.cells[SHORT].timed["header"] == Timed(15.0, 22.0, "short, header")
    found = {basis: (q.author, q.sines, q.ratio, q.ratio_median) for basis, q in row.quickest.items()}
    assert found == {
        "same header": (SHORT, "header", 1.5, 2.0),
        "C library": (TAPE, "libm", 1.25, 1.5),
        "as they come": (TAPE, "libm", 2.5, 3.0),
    }
    run = Run("a machine", "-O3", 3, {"arm": (row,)})
    assert json.loads(write_json(run))["models"]["arm"]["Jacobian of EXP1"]["quickest"]["C library"]["ratio"] == 1.25
    Store(tmp_path / "rows.jsonl", Row).find_or_measure(("arm",), lambda: [row])
    assert Store(tmp_path / "rows.jsonl", Row).find_or_measure(("arm",), list) == [row]
    assert "| Jacobian of EXP1 | 1.50 · 2.00 | 1.25 · 1.50 | 2.50 · 3.00 |" in write_markdown(run)


def test_sines_of_the_header_are_those_of_the_library(workshop: Workshop, tmp_path: Path) -> None:
    """Sines and cosines of three angles, one of them a sum, used by several results; to 4 eps."""
    q, u = ca.SX.sym("q", 2), ca.SX.sym("u")
    angle = q[0] + q[1]
    both = ca.sin(angle) * u
    results = [ca.vertcat(ca.sin(q[0]) * ca.cos(q[1]), both), ca.sqrt(ca.cos(angle) ** 2 + both**2) - q[1]]
    function = ca.Function("swing", [q, u], results, ["q", "u"], ["Phi", "c"])
    separated = separate(function)
    assert separated is not None
    assert separated.count == 3
    assert count_arithmetic(separated.function) + count_arithmetic(separated.angles) == count_arithmetic(function)
    source = write_source(separated, "swing_header", tmp_path)
    library = workshop.compile_c(source, "swing_header", ("-O1", "-DCASADI_SYMBOL_EXPORT=static"))
    code = Function(library, "swing_header", describe_face(function))
    states = {"q": np.array([[0.7, -2.0], [2.9, 40.0]]), "u": np.array([[1.1], [3.0]])}
    call = load(Candidate(TAPE, "impl", "swing", None, code), states)
    assert call is not None
    for k, (angle, force) in enumerate(zip(states["q"], states["u"], strict=True)):
        for value, expected in zip(call.evaluate(k).values(), function(angle, force), strict=True):
            np.testing.assert_allclose(value, expected.full(), rtol=4e-16, atol=4e-16)


def test_angles_that_depend_on_sines_are_left_alone() -> None:
    q = ca.SX.sym("q")
    assert separate(ca.Function("f", [q], [ca.sin(ca.cos(q))])) is None
    assert separate(ca.Function("f", [q], [q * q])) is None


def test_a_quick_run_measures_and_writes_everything(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every row of the small mechanism has figures of ours and of its peers; a second run measures nothing anew."""
    arguments = ["--quick", "--rounds", "2", "-o", str(tmp_path)]
    run = CliRunner().invoke(main, [*arguments, "--prepare"])
    assert run.exit_code == 0, run.output
    assert not (tmp_path / "benchmarks.json").exists()
    with monkeypatch.context() as without:
        without.setattr("benchmarks.preparation.write_functions", lambda *_: pytest.fail("it is prepared"))
        run = CliRunner().invoke(main, arguments)
    assert run.exit_code == 0, run.output
    found = json.loads((tmp_path / "benchmarks.json").read_text(encoding="utf-8"))["models"]["double_pendulum"]
    assert list(found) == list(ROWS)
    for title, row in found.items():
        cells = row["cells"]
        assert cells[OURS]["flops"] > 0
        assert set(cells[OURS]["timed"]) == {"header", "libm"}
        assert (TAPE in cells) == (" of " in title)
        assert (SHORT in cells) == (title not in {"Hessian of EXP1", "Hessian of EXP2"})
        assert all(set(cell["timed"]) == {"header", "libm"} for cell in cells.values())
        assert set(row["quickest"]) == set(BASES)
    assert (tmp_path / "benchmarks.png").read_bytes().startswith(b"\x89PNG")
    for name in ROWS:
        assert name in run.output
    monkeypatch.setattr("benchmarks.__main__.measure", lambda *_: pytest.fail("it is measured"))
    assert CliRunner().invoke(main, arguments).exit_code == 0


def test_growth_is_measured_without_pinocchio_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All kernels of a chain that may have Jacobians; a page and figures, with costs of making and of calls."""
    monkeypatch.setattr(growth, "find_includes", lambda: None)
    arguments = ["--size", "2", "--rounds", "2", "-o", str(tmp_path)]
    run = CliRunner().invoke(growth.main, arguments)
    assert run.exit_code == 0, run.output
    rows = json.loads((tmp_path / "growth.json").read_text(encoding="utf-8"))["rows"]
    assert [row["kernel"] for row in rows] == [*growth.VALUES, *growth.JACOBIANS]
    for row in rows:
        assert row["joints"] == 2
        assert {basis: found["author"] for basis, found in row["quickest"].items()} == dict.fromkeys(
            growth.BASES, SHORT
        )
        assert min(row["ns"], row["flops"], row["source_bytes"], row["compiled_s"], row["compiled_mb"]) > 0
    assert (tmp_path / "growth.md").read_text(encoding="utf-8").count("| chain2 |") == len(rows)
    monkeypatch.setattr(growth, "make_kernels", lambda *_: pytest.fail("it is measured"))
    assert CliRunner().invoke(growth.main, arguments).exit_code == 0


def test_a_model_that_cannot_be_compared_is_told(tmp_path: Path) -> None:
    run = CliRunner().invoke(main, [str(ROOT / "models" / "branched.yaml"), "--quick", "-o", str(tmp_path)])
    assert run.exit_code == 1
    assert "without forces but the actuators'" in run.output


def test_the_summary_compares_the_quickest_of_either_side(tmp_path: Path) -> None:
    """Of accelerations, 30 by 20 with one header, where EXP1's own peer takes 40; solves of 3 s by 2 s and 1 s."""

    def quickest(ours: float, peer: float, default: float) -> dict[str, Any]:
        both = {"same header": peer, "as they come": default}
        return {basis: asdict(Quickest(SHORT, "way", "libm", ours, ns, ns / ours, 1.0)) for basis, ns in both.items()}

    def solve(way: str, seconds: float) -> dict[str, Any]:
        return asdict(SolveRow("IMPL", way, 1.0, 9, 9, "Solve_Succeeded", 10, 5.0, seconds, seconds / 10, 3, 1.0, 1.0))

    kernels = {"EXP1": {"quickest": quickest(20.0, 40.0, 60.0)}, "EXP2": {"quickest": quickest(25.0, 30.0, 80.0)}}
    contents = {
        "benchmarks.json": {"machine": "a machine", "models": {"ur5": kernels}},
        "growth.json": {"rows": []},
        "ocp.json": {
            "about": "another machine; 3 rounds",
            "rows": [
                *(solve("mbsgen", 2.0), solve("mbsgen, by stages", 1.0)),
                *(solve(POINTS, 3.0), solve("CasADi, compiled, tuned", 8.0)),
            ],
        },
    }
    for file in FILES:
        (tmp_path / file).write_text(json.dumps(contents.get(file, "")), encoding="utf-8")
    out = tmp_path / "results"
    (tmp_path / "loops.md").write_text("loops", encoding="utf-8")
    arguments = ["--kernels", str(tmp_path), "--ocp", str(tmp_path), "--loops", str(tmp_path), "-o", str(out)]
    run = CliRunner().invoke(summarise, arguments)
    assert run.exit_code == 0, run.output
    page = (out / "summary.md").read_text(encoding="utf-8")
    assert "| UR5, 6 joints | – (–) | 1.50 (3.00) | – (–) | – (–) |" in page
    assert "| evaluation 1.50 (4.00) | by IPOPT 1.50 (4.00) | by stages 3.00 (8.00) |" in page
    assert "Measured on a machine; optimal control on another machine." in page
    assert (out / "growth.json").exists()
    assert (out / "loops.md").read_text(encoding="utf-8") == "loops"
    (tmp_path / "growth.md").unlink()
    run = CliRunner().invoke(summarise, arguments)
    assert "growth.md: not there; measure first" in run.output
