"""What the comparison rests on: counts, derivatives, agreement, the timing loop, ratios; and a slice of a whole run."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks import growth
from benchmarks.__main__ import main
from benchmarks.candidates import OURS, SHORT, TAPE, Call, Candidate, load_code
from benchmarks.compilation import BuildError, Workshop
from benchmarks.study import Measurement, Study
from benchmarks.symbolic import adjoint_jacobian, count_arithmetic, jacobian
from benchmarks.table import ROWS, compare
from benchmarks.timing import Stopwatch, find_disagreements, measure_rounds

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
def bind(workshop: Workshop, tmp_path: Path) -> Callable[[str, ca.SX, ca.SX], Call]:
    """Compile a function of q as a candidate, and bind it to three states."""
    states = {"q": np.array([[0.1, 2.0], [0.2, 3.0], [0.3, 5.0]])}

    def make(name: str, q: ca.SX, result: ca.SX) -> Call:
        function = ca.Function(name, [q], [result], ["q"], ["Phi"])
        function.generate(f"{name}.c", {"with_header": False})
        return make_call(name)

    def make_call(name: str) -> Call:
        code = load_code(workshop.compile_c(tmp_path / f"{name}.c", name), name)
        return Call(Candidate(TAPE, "impl", name, None, code), code, states)

    return make


def test_a_peer_that_computes_something_else_is_found(
    bind: Callable[[str, ca.SX, ca.SX], Call], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
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
    bind: Callable[[str, ca.SX, ca.SX], Call], workshop: Workshop, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a pass the results are those of the last state; every round times every call."""
    monkeypatch.chdir(tmp_path)
    q = ca.SX.sym("q", 2)
    call = bind("product", q, q[0] * q[1])
    stopwatch = Stopwatch(workshop.compile_timing())
    assert stopwatch.measure(call, 2) > 0
    assert call.results[0][0] == pytest.approx(0.3 * 5.0)
    rounds = list(measure_rounds(stopwatch, [call, call], 3))
    assert np.shape(rounds) == (3, 2)
    assert np.all(np.array(rounds) > 0)


def test_a_compiler_that_fails_says_why(workshop: Workshop, tmp_path: Path) -> None:
    (tmp_path / "wrong.c").write_text("int f( { }\n", encoding="utf-8")
    with pytest.raises(BuildError, match=r"(?s)wrong\.c.*error"):
        workshop.compile_c(tmp_path / "wrong.c", "wrong")


TYPED = """
#include <stdio.h>
#include "mbs_timing.h"
#include "arm_pendulum.h"

MBS_TIMED(time_impl, arm_pendulum_compute_impl(arg[0], arg[1], arg[2], arg[3], res[0]))

int main(void)
{
    static const double q[2][6] = {{0}, {0.1, 0.2, 0.3, 0.4, 0.5, 0.6}}, zero[2][6] = {{0}};
    const double *inputs[4];
    const long long steps[4] = {6, 6, 6, 4};
    double Phi[6], expected[6], *results[1];
    mbs_pool pool = {2, 4, 0, 0, 0, 0, 0, arm_pendulum_impl};
    inputs[0] = q[0], inputs[1] = inputs[2] = inputs[3] = zero[0];
    results[0] = Phi, pool.inputs = inputs, pool.steps = steps, pool.results = results;
    arm_pendulum_compute_impl(q[1], zero[0], zero[0], zero[0], expected);
    printf("%d ", time_impl(&pool, 10) > 0 && Phi[1] == expected[1]);
    Phi[1] = 0;
    printf("%d\\n", mbs_time_kernel(&pool, 10) > 0 && Phi[1] == expected[1]);
    return 0;
}
"""


def test_typed_functions_are_timed_by_the_same_loop(requires: Callable[[str], str], tmp_path: Path) -> None:
    model, csrc = ROOT / "generated" / "arm_pendulum", ROOT / "csrc"
    (tmp_path / "time.c").write_text(TYPED, encoding="utf-8")
    sources = [tmp_path / "time.c", csrc / "timing" / "mbs_timing.c", model / "arm_pendulum_impl.c"]
    flags = ["-std=c99", "-D_POSIX_C_SOURCE=199309L", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
    include = [f"-I{path}" for path in (csrc, csrc / "timing", model)]
    command = [requires("cc"), *flags, "-O1", *include, *map(str, sources), "-lm", "-o", str(tmp_path / "time")]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    assert subprocess.run([tmp_path / "time"], capture_output=True, text=True, check=True).stdout == "1 1\n"


def measurement(author: str, function: str, way: str, flops: int | None, times: list[float] | None) -> Measurement:
    return Measurement(Candidate(author, function, way, flops, None), None if times is None else np.array(times))


def test_a_row_takes_the_best_of_each_author() -> None:
    """In the second of three rounds the machine was slow, for both alike: ratios within a round do not see it."""
    study = Study(
        "arm",
        (
            measurement(OURS, "jac_exp1", "jac_exp1", 100, [10.0, 40.0, 11.0]),
            measurement(TAPE, "jac_exp1", "slow, short", 150, [50.0, 200.0, 55.0]),
            measurement(TAPE, "jac_exp2", "quick, long", 180, [25.0, 120.0, 33.0]),
            measurement(TAPE, "jac_exp1", "counted", 400, None),
            measurement(TAPE, "jac_impl", "another row's", 1, [1.0, 1.0, 1.0]),
        ),
    )
    (row,) = compare(study)
    cell = row.cells[TAPE]
    assert row.title == "Jacobian of EXP1"
    assert (cell.flops, cell.flops_by, cell.flops_ratio) == (150, "slow, short", 1.5)
    assert (cell.ns, cell.ns_by, cell.ns_ratio) == (25.0, "quick, long", 2.5)
    assert (cell.ns_median, cell.ns_ratio_median) == (33.0, 3.0)


def test_a_quick_run_measures_and_writes_everything(tmp_path: Path) -> None:
    """Every row of the small mechanism has figures of ours, and derivatives those of CasADi's differentiation."""
    run = CliRunner().invoke(main, ["--quick", "--rounds", "2", "-o", str(tmp_path)])
    assert run.exit_code == 0, run.output
    found = json.loads((tmp_path / "benchmarks.json").read_text(encoding="utf-8"))["models"]["double_pendulum"]
    assert list(found) == list(ROWS)
    for title, cells in found.items():
        assert cells[OURS]["flops"] > 0
        assert cells[OURS]["ns"] > 0
        assert (TAPE in cells) == (" of " in title)
        assert (SHORT in cells) == (
            title in {"IMPL", "EXP1", "Jacobian of IMPL", "Jacobian of EXP1", "Jacobian of EXP2"}
        )
    assert (tmp_path / "benchmarks.png").read_bytes().startswith(b"\x89PNG")
    for name in ROWS:
        assert name in run.output


def test_growth_is_measured_without_peers_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All kernels of a chain that may have Jacobians; a page and figures, with costs of making and of calls."""
    monkeypatch.setattr(growth, "find_includes", lambda: None)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))  # which the run sets, and is to be as before
    run = CliRunner().invoke(growth.main, ["--size", "2", "--rounds", "2", "-o", str(tmp_path)])
    assert run.exit_code == 0, run.output
    rows = json.loads((tmp_path / "growth.json").read_text(encoding="utf-8"))["rows"]
    assert [row["kernel"] for row in rows] == [*growth.VALUES, *growth.JACOBIANS]
    for row in rows:
        assert (row["joints"], row["peer"], row["peer_ns"]) == (2, None, None)
        assert min(row["ns"], row["flops"], row["source_bytes"], row["compiled_s"], row["compiled_mb"]) > 0
    assert (tmp_path / "growth.md").read_text(encoding="utf-8").count("| chain2 |") == len(rows)


def test_a_model_that_cannot_be_compared_is_told(tmp_path: Path) -> None:
    run = CliRunner().invoke(main, [str(ROOT / "models" / "branched.yaml"), "--quick", "-o", str(tmp_path)])
    assert run.exit_code == 1
    assert "without forces but the actuators'" in run.output
