"""Collocation at Lobatto points, `scheme: lobatto`: Hermite and Simpson's rule, and the trapezoidal one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from benchmarks.kkt.problems import PROBLEMS
from mbsgen.errors import InputError
from mbsrun import Mechanism, load
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solution.solution import Solution, read_solution, write_solution
from mbsrun.ocp.solution.table import list_motion
from mbsrun.ocp.solving.certificate import certify_motion
from mbsrun.ocp.solving.solve import Solver, solve
from mbsrun.ocp.statement.statement import read_problem
from tests.shipped import FOLDER

CART_POLE = FOLDER / "classics" / "cart_pole.ocp.yaml"
QUIET: dict[str, Any] = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-10}}
Rule = Callable[[ca.MX, ca.MX, ca.MX, ca.MX, float], tuple[list[ca.MX], ca.MX]]


@pytest.fixture(autouse=True)
def compiler(requires: Callable[[str], str]) -> None:
    requires("cc")


def read(path: Path, folder: Path, *changes: tuple[str, str]) -> tuple[Problem, Mechanism]:
    """Read a problem file whose text is changed."""
    text = path.read_text("utf-8")
    for old, new in (*changes, ("model: ", f"model: {path.parent}/")):
        assert old in text
        text = text.replace(old, new)
    (folder / path.name).write_text(text, "utf-8")
    return read_problem(folder / path.name, load)


def found(problem: Problem, plant: Mechanism) -> Solution:
    solution = solve(problem, plant)
    assert isinstance(solution, Solution), solution
    return solution


def trapezoid(f: ca.Function) -> Rule:
    """Kelly (2017), eq. 3.1 and 3.3; the integral of a linear input is the sum of its values at both ends."""

    def rule(x: ca.MX, y: ca.MX, u: ca.MX, v: ca.MX, h: float) -> tuple[list[ca.MX], ca.MX]:
        return [y - x - h / 2 * (f(x, u) + f(y, v))], h / 2 * (u**2 + v**2)

    return rule


def simpson(f: ca.Function) -> Rule:
    """Kelly (2017), eqs. 4.1 and 4.6: the state at the middle is Hermite's, the input the mean of both ends."""

    def rule(x: ca.MX, y: ca.MX, u: ca.MX, v: ca.MX, h: float) -> tuple[list[ca.MX], ca.MX]:
        first, last, mean = f(x, u), f(y, v), (u + v) / 2
        middle = f((x + y) / 2 + h / 8 * (first - last), mean)
        return [y - x - h / 6 * (first + 4 * middle + last)], h / 6 * (u**2 + 4 * mean**2 + v**2)

    return rule


def solve_peer(make: Callable[[ca.Function], Rule], N: int) -> float:
    """Swing the pole up, with the compressed form of a rule and inputs at mesh points."""
    peer = next(p for p in PROBLEMS if p.name == "cart-pole")
    x, u = ca.SX.sym("x", 4), ca.SX.sym("u")
    f = ca.Function("f", [x, u], [peer.rates(x, u, ca.SX(0), ca.SX(0))])
    X, U, h = ca.MX.sym("X", 4, N + 1), ca.MX.sym("U", N + 1), 2.0 / N
    rows, cost = [], ca.MX(0)
    for k in range(N):
        own, part = make(f)(X[:, k], X[:, k + 1], U[k], U[k + 1], h)
        rows += own
        cost += part
    ends = [np.array(part, dtype=float) for part in (peer.start, peer.end)]
    lower = np.full((4, N + 1), -np.inf)
    upper = -lower
    lower[0], upper[0] = -2, 2
    lower[:, 0] = upper[:, 0] = ends[0]
    lower[:, -1] = upper[:, -1] = ends[1]
    guess = np.linspace(ends[0], ends[1], N + 1).T
    solver = ca.nlpsol("peer", "ipopt", {"x": ca.vertcat(ca.vec(X), U), "f": cost, "g": ca.vertcat(*rows)}, QUIET)
    limits = [
        np.concatenate((part.ravel("F"), np.full(N + 1, sign * 20.0))) for part, sign in ((lower, -1), (upper, 1))
    ]
    x0 = np.concatenate((guess.ravel("F"), np.zeros(N + 1)))
    return float(solver(x0=x0, lbx=limits[0], ubx=limits[1], lbg=0, ubg=0)["f"])


@pytest.mark.parametrize("method", ["mbs", "ipopt"])
@pytest.mark.parametrize(("degree", "rule"), [(2, trapezoid), (3, simpson)])
def test_optimum_is_the_one_of_the_rule_by_hand(
    tmp_path: Path, degree: int, rule: Callable[[ca.Function], Rule], method: str
) -> None:
    """Both have the same motions, in other variables: the peer's are states and inputs at mesh points alone."""
    changes = (("radau", "lobatto"), ("degree: 3", f"degree: {degree}"), ("polynomial", "linear"), ("50", "25"))
    problem, plant = read(CART_POLE, tmp_path, *changes)
    solution = found(problem.with_solver(method), plant)
    assert solution.cost.total == pytest.approx(solve_peer(rule, 25), rel=1e-8)


@pytest.mark.parametrize("representation", ["SEMI", "EXP1-A", "EXP2-O"])
def test_representations_have_one_optimum(tmp_path: Path, representation: str) -> None:
    changes = [("radau", "lobatto"), ("50", "20")]
    expected = found(*read(CART_POLE, tmp_path, *changes)).cost.total
    changes.append(("scheme:", f"representation: {representation}\nscheme:"))
    assert found(*read(CART_POLE, tmp_path, *changes)).cost.total == pytest.approx(expected, rel=1e-7)


def test_a_file_keeps_the_slopes_of_all_states(tmp_path: Path) -> None:
    """A motion that is packed again meets all rows: the rate of an activation at a start is in no other number."""
    problem, plant = read(FOLDER / "moco" / "hanging.ocp.yaml", tmp_path, ("radau", "lobatto"))
    solution = found(problem, plant)
    path = tmp_path / "solution.json"
    write_solution(solution, path)
    again = read_solution(path)
    solver = Solver(problem, plant)
    assert certify_motion(problem, solver, again.trajectory).violation < 1e-8
    own = solver.transcription
    x = own.pack(again.trajectory)
    assert own.pack(own.unpack(x)) == pytest.approx(x, abs=1e-15)
    bare = own.pack(replace(again.trajectory, slopes=np.zeros(0)))
    assert np.abs(bare - x).max() > 1e-6


def test_each_time_has_one_row_of_the_table(tmp_path: Path) -> None:
    problem, plant = read(CART_POLE, tmp_path, ("radau", "lobatto"), ("50", "20"))
    t, q, *_ = list_motion(found(problem, plant).trajectory)
    assert t.ravel() == pytest.approx(np.linspace(0, 2, 41))
    assert q.shape == (41, 2)


@pytest.mark.parametrize(
    ("file", "changes", "finding"),
    [
        (CART_POLE, (("degree: 3", "degree: 1"),), "degree: lobatto has points at both ends"),
        (
            CART_POLE,
            (("polynomial", "constant"), ("scheme", "form: integral\nscheme")),
            "scheme: the points of lobatto begin",
        ),
        (FOLDER / "five_bar_reach.ocp.yaml", (), "scheme: loops are closed at the mesh points"),
        (FOLDER / "driven" / "turntable_pass.ocp.yaml", (), "scheme: driven joints and contacts have conditions"),
    ],
)
def test_what_it_does_not_take_is_refused(
    tmp_path: Path, file: Path, changes: tuple[tuple[str, str], ...], finding: str
) -> None:
    with pytest.raises(InputError, match=finding):
        read(file, tmp_path, ("scheme: radau", "scheme: lobatto"), *changes)
