"""Delays of inputs across links: a motion in two phases is the motion in one; where delays differ, see `write`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsrun import load
from mbsrun.external import load_on_demand
from mbsrun.ocp.solution.phases import PhasedSolution
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.phases import solve_phases
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.phases import read_phased_problem
from mbsrun.ocp.statement.statement import read_problem

MODEL = """
name: cart
gravity: [0, 0, 0]
bodies: [{name: cart, joint: {name: x, type: prismatic, axis: x}, mass: 1}]
"""
USUAL = """
model: cart.yaml
scheme: radau
degree: 3
cost: {inputs: 1}
bounds: {velocities: [-1.2, 1.2]}
solver: {tolerance: 1e-10}
"""
ONE = """
horizon: 1.2
intervals: 12
inputs: {course: COURSE, delay: 0.2, history: 2}
start: {pose: {}}
end: {pose: {x: 1}, velocity: zero}
"""
TWO = """
inputs: {course: COURSE, delay: 0.2}
phases:
  - {name: first, horizon: 0.5, intervals: 5, start: {pose: {}}, inputs: {history: 2}}
  - {name: second, horizon: 0.7, intervals: 7, end: {pose: {x: 1}, velocity: zero}, inputs: {history: link}}
links: [{from: first, to: second}]
"""


@pytest.mark.parametrize("course", ["constant", "polynomial", "linear"])
def test_commands_before_a_link_act_after_it(requires: Callable[[str], str], tmp_path: Path, course: str) -> None:
    """A push of 2 N acts at first; the commands of the last 0.2 s of the first phase act in the second one."""
    requires("cc")
    (tmp_path / "cart.yaml").write_text(MODEL)
    (tmp_path / "one.ocp.yaml").write_text((USUAL + ONE).replace("COURSE", course))
    (tmp_path / "two.ocp.yaml").write_text((USUAL + TWO).replace("COURSE", course))
    one = solve(*read_problem(tmp_path / "one.ocp.yaml", load))
    two = solve_phases(*read_phased_problem(tmp_path / "two.ocp.yaml", load_on_demand))
    assert isinstance(one, Solution)
    assert isinstance(two, PhasedSolution)
    assert two.cost == pytest.approx(one.cost.total, rel=1e-8)
    first, second = (phase.trajectory for phase in two.phases)
    assert first.u[:2] == pytest.approx(np.full((2, 1), 2.0))
    assert np.concatenate((first.u, second.u)) == pytest.approx(one.trajectory.u, abs=1e-4)


# --- delays that differ ---------------------------------------------------------------------------------------------

DIFFERENT = """
phases:
  - {name: first, horizon: 0.5, intervals: 5, start: {pose: {}}, FIRST}
  - {name: second, horizon: 0.7, intervals: COUNT, end: {pose: {x: 1}, velocity: zero}, SECOND}
links: [{from: first, to: second}]
"""
BEGIN = 0.5  # s: of the second phase
SAME = 1e-9


@dataclass(frozen=True)
class Window:
    """Commands over some time, as a function of the fraction of it that has passed."""

    begin: float
    end: float
    read: Callable[[float], Any]


def write(
    course: str, first: float, second: float, count: int, *, rate: float = np.inf, history: float = 2.0
) -> tuple[float, Any]:
    """Return the least cost by a program of commands: u(t) = command(t - delay), in each phase with its own delay.

    The cart is a double integrator, so that three points of Gauss integrate its motion and the cost exactly.
    """
    opti = ca.Opti()
    windows: list[Window] = []
    x, v, cost, applied = 0.0, 0.0, 0.0, []
    s, b = np.polynomial.legendre.leggauss(3)
    s, b = (s + 1) / 2, b / 2
    times = [(t, t + 0.1, first) for t in 0.1 * np.arange(5)]
    times += [(t, t + 0.7 / count, second) for t in BEGIN + 0.7 / count * np.arange(count)]
    for t0, t1, delay in times:
        a, e = t0 - delay, t1 - delay
        known = [w for w in windows if w.begin <= a + SAME and e <= w.end + SAME]
        if known:
            w = known[0]
            own = Window(a, e, lambda c, w=w, a=a, e=e: w.read((a + c * (e - a) - w.begin) / (w.end - w.begin)))
        elif e <= SAME:
            own = Window(a, e, lambda _: history)
            windows.append(own)
        else:
            p = opti.variable({"constant": 1, "linear": 2, "polynomial": 3}[course])
            own = Window(a, e, lambda c, p=p: sum(p[i] * c**i for i in range(p.numel())))
            windows.append(own)
        h, values = t1 - t0, [own.read(float(c)) for c in s]
        x += h * v + h**2 * sum(b[i] * (1 - s[i]) * values[i] for i in range(3))
        v += h * sum(b[i] * values[i] for i in range(3))
        cost += h * sum(b[i] * values[i] ** 2 for i in range(3))
        applied.append(own.read(0.5))
    if course == "linear":
        ordered = sorted(windows, key=lambda w: w.begin)
        for w in ordered:
            if w.end > SAME and rate < np.inf:
                opti.subject_to(
                    opti.bounded(-rate * (w.end - w.begin), w.read(1) - w.read(0), rate * (w.end - w.begin))
                )
        for w, after in pairwise(ordered):
            gap = after.begin - w.end
            if after.end <= SAME:
                continue
            if gap < SAME:
                opti.subject_to(after.read(0) == w.read(1))
            elif rate < np.inf:
                opti.subject_to(opti.bounded(-rate * gap, after.read(0) - w.read(1), rate * gap))
    opti.minimize(cost)
    opti.subject_to(x == 1)
    opti.subject_to(v == 0)
    opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "tol": 1e-11})
    found = opti.solve()
    return float(found.value(cost)), np.array([float(found.value(ca.MX(u))) for u in applied])


def state(course: str, first: float, second: float, count: int, more: str = "") -> str:
    """Return a problem file of two phases with these delays."""

    def give(delay: float, history: str) -> str:
        return f"inputs: {{course: {course}" + (f", delay: {delay}, history: {history}}}" if delay else "}")

    text = USUAL.replace("bounds: {velocities: [-1.2, 1.2]}\n", more) + DIFFERENT.replace("COUNT", str(count))
    return text.replace("FIRST", give(first, "2")).replace("SECOND", give(second, "link"))


def solve_file(path: Path, text: str) -> PhasedSolution:
    """Solve a problem file beside the model of the cart."""
    (path / "cart.yaml").write_text(MODEL)
    (path / "two.ocp.yaml").write_text(text)
    found = solve_phases(*read_phased_problem(path / "two.ocp.yaml", load_on_demand))
    assert isinstance(found, PhasedSolution), found
    return found


@pytest.mark.parametrize("method", ["mbs", "ipopt"])
@pytest.mark.parametrize("course", ["constant", "polynomial", "linear"])
@pytest.mark.parametrize(
    ("first", "second", "count"),
    [(0.1, 0.3, 7), (0.0, 0.2, 7), (0.1, 0.4, 14), (0.3, 0.1, 7), (0.2, 0.0, 7)],
    ids=["longer", "first after the link", "longer, on finer intervals", "shorter", "none after the link"],
)
def test_each_phase_reads_the_commands_its_own_delay_ago(
    requires: Callable[[str], str], tmp_path: Path, first: float, second: float, count: int, course: str, method: str
) -> None:
    """The least cost and the inputs are the ones of a program that is written in commands."""
    requires("cc")
    text = state(course, first, second, count).replace("tolerance: 1e-10", f"tolerance: 1e-10, method: {method}")
    found = solve_file(tmp_path, text)
    cost, inputs = write(course, first, second, count)
    assert found.cost == pytest.approx(cost, rel=1e-8)
    middles = [_read_middles(phase, course) for phase in found.phases]
    assert np.concatenate(middles) == pytest.approx(inputs, abs=1e-4)


def _read_middles(phase: Solution, course: str) -> Any:
    """Return the input in the middle of every interval."""
    motion = phase.trajectory
    if course == "constant":
        return motion.u[:, 0]
    if course == "linear":
        return motion.states[:-1, 0] + np.diff(motion.states[:, 0]) / 2
    points = (motion.point_t - motion.t[:-1, None]) / np.diff(motion.t)[:, None]
    values = motion.point_u[..., 0]
    return np.array([np.polyval(np.polyfit(p, u, len(p) - 1), 0.5) for p, u in zip(points, values, strict=True)])


def test_commands_that_never_act_keep_within_the_bounds_of_their_rate(
    requires: Callable[[str], str], tmp_path: Path
) -> None:
    """A delay that shrinks leaves out commands, between which a continuous input changes no faster than it may."""
    requires("cc")
    text = state("linear", 0.3, 0.1, 7, "bounds: {input_rates: [-15, 15]}\n").replace("history: 2", "history: 4")
    found = solve_file(tmp_path, text)
    cost, inputs = write("linear", 0.3, 0.1, 7, rate=15, history=4)
    assert found.cost == pytest.approx(cost, rel=1e-8)
    first, second = (phase.trajectory.states[:, 0] for phase in found.phases)
    assert second[0] - first[-1] == pytest.approx(-15 * 0.2)
    assert np.concatenate([_read_middles(p, "linear") for p in found.phases]) == pytest.approx(inputs, abs=1e-4)


@pytest.mark.parametrize("course", ["constant", "linear"])
def test_controls_with_different_delays_are_inputs_with_them(
    requires: Callable[[str], str], tmp_path: Path, course: str
) -> None:
    requires("cc")
    controls = "controls: {push: {delay: DELAY, history: HISTORY}}"
    text = DIFFERENT.replace("COUNT", "7").replace("FIRST", controls.replace("DELAY", "0.1").replace("HISTORY", "2"))
    text = text.replace("SECOND", controls.replace("DELAY", "0.3").replace("HISTORY", "link"))
    usual = USUAL.replace("cost: {inputs: 1}", "cost: {running: [{expression: push**2}]}\nforces: {x: push}")
    usual = usual.replace("bounds: {velocities: [-1.2, 1.2]}\n", f"inputs: {course}\n")
    found = solve_file(tmp_path, usual + text)
    assert found.cost == pytest.approx(write(course, 0.1, 0.3, 7)[0], rel=1e-8)


BAD = {
    "no such input": ("course: constant, delay: 0.1", "course: linear, delay: 0.1", "which has no such input, or one"),
    "a free horizon": (
        "horizon: 0.5, intervals: 5, start: {pose: {}}, inputs: {course: constant, delay: 0.1, history: 2}",
        "horizon: {guess: 0.5, range: [0.1, 1]}, intervals: 5, start: {pose: {}}, inputs: {course: constant}",
        "and 0 s later in phase first, whose horizon is free, so its mesh points move; give that horizon",
    ),
    "a short phase": ("horizon: 0.5, intervals: 5", "horizon: 0.15, intervals: 3", "which lasts 0.15 s, less than the"),
    "another course": (
        "course: constant, delay: 0.1",
        "course: polynomial, delay: 0.1",
        "where inputs are polynomial,",
    ),
    "a grid that is refined": ("intervals: 5", "intervals: 5, refine: {accuracy: 1e-6}", "whose grid is refined;"),
    "no mesh point before": ("intervals: 5", "intervals: [1, 3, 1]", "no mesh point 0.2 s before its end"),
    "no mesh point after": ("intervals: 5", "intervals: 10", "so mesh points are missing here, at 0.05, 0.15 s; let"),
    "a map": ("to: second", "to: second, map: {input_x: input_x}", "links[0].map.input_x: inputs of the phase before"),
}


@pytest.mark.parametrize(("old", "new", "fault"), BAD.values(), ids=BAD.keys())
def test_delays_that_no_grid_can_have_are_refused(tmp_path: Path, old: str, new: str, fault: str) -> None:
    text = state("linear" if "map" in new else "constant", 0.1, 0.3, 7)
    assert old in text
    (tmp_path / "cart.yaml").write_text(MODEL)
    (tmp_path / "two.ocp.yaml").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as refusal:
        read_phased_problem(tmp_path / "two.ocp.yaml", load_on_demand)
    assert fault in str(refusal.value)
    assert str(refusal.value).count("two.ocp.yaml") == 1


def test_a_degree_below_the_one_of_commands_is_refused(tmp_path: Path) -> None:
    text = state("polynomial", 0.1, 0.3, 7).replace("name: second", "name: second, degree: 2")
    (tmp_path / "cart.yaml").write_text(MODEL)
    (tmp_path / "two.ocp.yaml").write_text(text)
    with pytest.raises(InputError, match=r"0.1 s later in phase first, where the degree is 3, and here 2"):
        read_phased_problem(tmp_path / "two.ocp.yaml", load_on_demand)
