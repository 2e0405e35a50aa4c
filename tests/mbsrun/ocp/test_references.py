"""References: recorded motions in costs and constraints, against least squares by hand; every fault at its place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.errors import InputError
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solution.phases import PhasedSolution
from mbsrun.ocp.solution.solution import Solution, read_solution, write_solution
from mbsrun.ocp.solving.phases import solve_phases
from mbsrun.ocp.solving.solve import Solver, solve
from mbsrun.ocp.statement.phases import read_phased_problem
from mbsrun.ocp.statement.statement import read_problem
from tests.mbsrun.ocp.plants import mechanism
from tests.mbsrun.peer import Peer

Array = NDArray[np.float64]

MASS = """\
model: mass.yaml
constants: {a: 0.5}
horizon: 1
intervals: 10
scheme: radau
degree: 3
references: {walk: {file: walk.csv}}
cost:
  inputs: 1e-3
  track: [{reference: walk, coordinates: [x], weight: 2*a}]
start: {pose: {x: 0}, velocity: {x: 0}}
"""
TIMES = np.linspace(0.0, 1.0, 101)


def wave(t: Array) -> Array:
    return 0.3 * np.sin(5 * t) + t**2


def mass() -> Peer:
    """A mass of 1 kg, driven by u."""
    q, qd, qdd, u = symbols = tuple(ca.SX.sym(name) for name in ("q", "qd", "qdd", "u"))
    return mechanism(("x",), qdd - u + 0 * q + 0 * qd, symbols)


def record(folder: Path, name: str = "walk.csv", gap: tuple[float, float] = (2, 2), head: str = "t,q[x]") -> None:
    rows = [f"{t},{'' if gap[0] < t < gap[1] else wave(t)}" for t in TIMES]
    (folder / name).write_text("\n".join([head, *rows]), "utf-8")


def read(folder: Path, text: str = MASS) -> Problem:
    (folder / "task.ocp.yaml").write_text(text, "utf-8")
    return read_problem(folder / "task.ocp.yaml", lambda _: mass())[0]


def track_by_hand(known: Array, points: Array, weights: Array) -> Array:
    """Inputs u_k that minimise the sum of w (x - ref)^2 and 1e-3 h u^2; u_k acts over interval k."""
    N, h = 10, 0.1
    t = (np.arange(N)[:, None] * h + points * h).ravel()
    starts = np.arange(N) * h

    def ramp(x: Array) -> Array:
        return np.maximum(x, 0) ** 2 / 2

    G = ramp(t[:, None] - starts) - ramp(t[:, None] - starts - h)
    root = np.sqrt(np.tile(h * weights, N) * known)
    A = np.vstack((root[:, None] * G, np.sqrt(1e-3 * h) * np.eye(N)))
    return np.asarray(np.linalg.lstsq(A, np.concatenate((root * wave(t), np.zeros(N))), rcond=None)[0])


@pytest.mark.parametrize("gap", [(2.0, 2.0), (0.355, 0.615)], ids=["whole", "gap"])
@pytest.mark.parametrize("form", ["standard", "integral"])
def test_a_tracked_motion_is_the_least_squares_solution(tmp_path: Path, gap: tuple[float, float], form: str) -> None:
    """Residuals in a long gap are left out."""
    record(tmp_path, gap=gap)
    problem = read(tmp_path, f"{MASS}form: {form}\n")
    found = solve(problem, mass())
    assert isinstance(found, Solution)
    scheme = schemes.build(Family.RADAU, 3)
    t = (np.arange(10)[:, None] * 0.1 + scheme.points * 0.1).ravel()
    known = np.where((t > gap[0] - 0.005) & (t < gap[1] + 0.005), 0.0, 1.0)  # to the samples beside it
    expected = track_by_hand(known, scheme.points, scheme.weights)
    np.testing.assert_allclose(found.trajectory.u[:, 0], expected, rtol=1e-4, atol=1e-4)
    title, value = found.cost.terms[-1]
    rest = np.tile(scheme.weights * 0.1, 10) @ (known * (found.trajectory.point_q.ravel() - wave(t)) ** 2)
    assert title == "track walk: x"
    assert value == pytest.approx(float(rest), rel=1e-3)


def test_a_solution_keeps_its_reference(tmp_path: Path) -> None:
    """The file of a solution holds the splines, so it is solved again without the recording."""
    record(tmp_path, gap=(0.355, 0.615))
    problem = read(tmp_path)
    found = solve(problem, mass())
    assert isinstance(found, Solution)
    write_solution(found, tmp_path / "solution.json")
    assert read_solution(tmp_path / "solution.json").problem == problem


def test_one_program_serves_other_weights_and_no_other_reference(tmp_path: Path) -> None:
    record(tmp_path)
    problem = read(tmp_path)
    solver = Solver(problem, mass())
    (term,) = problem.cost.running
    heavier = replace(problem, cost=replace(problem.cost, running=(replace(term, weight=100.0),)))
    guess = solve(problem, mass())
    assert isinstance(guess, Solution)
    assert isinstance(solver.solve(heavier, guess.trajectory), Solution)
    record(tmp_path, gap=(0.355, 0.615))
    with pytest.raises(ValueError, match="structure"):
        solver.solve(read(tmp_path), guess.trajectory)


def test_expressions_read_references(tmp_path: Path) -> None:
    """In constraints and costs; the motion is the reference where a constraint holds it there."""
    record(tmp_path)
    text = MASS.replace("track: [{reference: walk, coordinates: [x], weight: 2*a}]", "running: []")
    text += "constraints: [{expression: q_x - ref_walk_q_x*t, range: [-0.01, 0.01]}]\n"
    found = solve(read(tmp_path, text), mass())
    assert isinstance(found, Solution)
    t = found.trajectory.point_t
    gaps = np.abs(found.trajectory.point_q[..., 0] - wave(t) * t)
    assert gaps.max() < 0.01 + 1e-6
    assert gaps.max() > 0.009


def test_a_normalised_reference_goes_with_a_free_horizon(tmp_path: Path) -> None:
    """Whatever the horizon is, the motion is the whole recording: here a third faster."""
    record(tmp_path)
    text = MASS.replace("horizon: 1", "horizon: {guess: 0.75, range: [0.75, 0.75]}")
    text = text.replace("walk.csv}", "walk.csv, time: normalised}").replace("inputs: 1e-3", "inputs: 1e-7")
    found = solve(read(tmp_path, text.replace("intervals: 10", "intervals: 40")), mass())
    assert isinstance(found, Solution)
    trajectory = found.trajectory
    assert trajectory.t[-1] == pytest.approx(0.75)
    errors = np.abs(trajectory.q[:, 0] - wave(trajectory.t / 0.75))
    assert errors[5:-1].max() < 2e-3  # the reference starts with a speed, the mass at rest


def test_markers_are_tracked(tmp_path: Path) -> None:
    """The cost of a marker is its squared distance; here the sensor `place` stands at the origin."""
    rows = [f"{t},0.1,0.2,{'' if 0.3 < t < 0.5 else 0.3}" for t in TIMES]
    (tmp_path / "walk.csv").write_text("\n".join(["t,x[place],y[place],z[place] [m]", *rows]), "utf-8")
    found = solve(read(tmp_path, MASS.replace("coordinates: [x]", "markers: {place: place}")), mass())
    assert isinstance(found, Solution)
    assert found.cost.terms[-1][1] == pytest.approx(0.14 * 0.8, abs=0.01)
    assert found.run.instead == ""  # rounding of a gradient that vanishes is no way down


def test_phases_follow_parts_of_a_recording(tmp_path: Path) -> None:
    """Two phases that follow the two halves of a recording are one phase that follows all of it."""
    record(tmp_path)
    whole = solve(read(tmp_path), mass())
    assert isinstance(whole, Solution)
    given = "[{{name: {}, horizon: 0.5, intervals: 5, references: {{walk: {{file: walk.csv, start: {}}}}}{}}}]"
    first = given.format("first", 0, ", start: {pose: {x: 0}, velocity: {x: 0}}")
    second = given.format("second", 0.5, ", start: {pose: {x: null}, velocity: {x: null}}")
    kept = [line for line in MASS.splitlines() if not line.startswith(("horizon", "intervals", "references", "start"))]
    phases = f"phases: {first[:-1]}, {second[1:]}"
    text = "\n".join([*kept, phases, "links: [{from: first, to: second}]"])
    (tmp_path / "task.ocp.yaml").write_text(text, "utf-8")
    found = solve_phases(*read_phased_problem(tmp_path / "task.ocp.yaml", lambda _: mass()))
    assert isinstance(found, PhasedSolution)
    inputs = np.concatenate([part.trajectory.u for part in found.phases])
    np.testing.assert_allclose(inputs, whole.trajectory.u, rtol=1e-6, atol=1e-6)


WALK = "references: {walk: {file: walk.csv}}"
ITEM = "{reference: walk, coordinates: [x], weight: 2*a}"
BAD = {
    "missing file": ("walk.csv}", "run.csv}", ["run.csv: there is no such file"]),
    "no recording": ("walk.csv}", "walk.txt}", [":7: references.walk.file: found", ".csv, .trc, .mot, .sto"]),
    "name": (WALK, "references: {sin: {file: walk.csv}}", [":7: references.sin: no name for a reference"]),
    "twice": ("{a: 0.5}", "{a: 0.5, ref_walk_q_x: 1}", [":7: references: ref_walk_q_x has two meanings"]),
    "column": ("walk.csv}", "walk.csv, columns: {x: 'q[y]'}}", [":7: references.walk.columns.x: the recording has no"]),
    "unit": ("walk.csv}", "walk.csv, columns: {x: 'q[x] [ft]'}}", ['columns.x: unknown unit "ft"', "deg"]),
    "other unit": ("walk.csv}", "walk.csv, columns: {x: 'q[x] [deg]'}}", ["stated to be in deg; it is in m"]),
    "word": ("walk.csv}", "walk.csv, columns: {x-y: 'q[x]'}}", ["no name for a column"]),
    "degree": ("walk.csv}", "walk.csv, degree: 4}", [":7: references.walk.degree:"]),
    "gap": ("walk.csv}", "walk.csv, gap: -1}", [":7: references.walk.gap: found -1"]),
    "noise": ("walk.csv}", "walk.csv, noise: 0}", [":7: references.walk.noise: found 0"]),
    "filter": (
        "walk.csv}",
        "walk.csv, cutoff: 80}",
        ["cost.track[0].coordinates[0]", "cut-off of 80 Hz", "below 40.1"],
    ),
    "times": ("walk.csv}", "walk.csv, start: 2}", [":7: references.walk.start: 2 is not before the end, 1"]),
    "end": ("walk.csv}", "walk.csv, end: 0.5}", [":7: references.walk.end: the horizon gives the end"]),
    "beyond": ("horizon: 1", "horizon: 2", []),
    "reference": ("reference: walk", "reference: wlk", [":10: cost.track[0].reference:", 'did you mean "walk"?']),
    "coordinate": ("[x]", "[y]", [":10: cost.track[0].coordinates[0]: the model has no coordinate"]),
    "nothing": ("coordinates: [x]", "markers: []", [":10: cost.track[0]: nothing is tracked"]),
    "marker": (
        "coordinates: [x]",
        "markers: [place]",
        ["cost.track[0].markers[0]: the reference has no column x[place]"],
    ),
    "sensor": ("coordinates: [x]", "markers: [hand]", ["cost.track[0].markers[0]: the model has no sensor"]),
    "source": ("[x]", "{x: knee}", [":10: cost.track[0].coordinates.x: the reference has no column for"]),
    "weight": ("2*a", "-1", [":10: cost.track[0].weight: found -1"]),
    "weights": ("2*a", "1, weights: {y: 1}", [":10: cost.track[0].weights.y: it is not tracked; there are x"]),
    "horizon": (
        "horizon: 1",
        "horizon: {guess: 1, range: [0.5, 2]}",
        [":7: references.walk: the horizon is free", "normalised"],
    ),
    "expression": (
        ITEM,
        "]\n  running: [{expression: ref_walk_x**2}",
        ["running[0].expression: unknown name", "ref_walk_q_x"],
    ),
}


@pytest.mark.parametrize(("old", "new", "words"), BAD.values(), ids=BAD.keys())
def test_a_bad_problem(tmp_path: Path, old: str, new: str, words: list[str]) -> None:
    """A tracked reference may end early; all else is refused, with file, line, finding and remedy."""
    assert old in MASS
    record(tmp_path)
    if not words:
        (term,) = read(tmp_path, MASS.replace(old, new)).cost.running
        assert term.expression == "known_walk_q_x*(q_x - ref_walk_q_x)**2"
        return
    with pytest.raises(InputError) as caught:
        read(tmp_path, MASS.replace(old, new))
    for word in words:
        assert word in str(caught.value)


def test_an_expression_reads_no_gap_by_mistake(tmp_path: Path) -> None:
    """An expression that reads known_NAME minds the gaps; another is refused."""
    record(tmp_path, gap=(0.355, 0.615))
    term = "track: [{reference: walk, coordinates: [x], weight: 2*a}]"
    text = MASS.replace(term, "running: [{expression: (q_x - ref_walk_q_x)**2}]")
    with pytest.raises(InputError, match=r"0\.35 to 0\.62 s of its recording.*multiply by known_walk_q_x"):
        read(tmp_path, text)
    assert read(tmp_path, text.replace("(q_x -", "known_walk_q_x*(q_x -")).references


def test_the_unit_of_an_angle_in_a_motion_file_is_no_guess(tmp_path: Path) -> None:
    rows = "\n".join(f"{t}\t{wave(t)}" for t in TIMES)
    text = MASS.replace("walk.csv}", "walk.mot, columns: {a: knee}}").replace("[x]", "{x: a}")
    expression = "running: [{expression: ref_walk_a**2}]\n  track"
    (tmp_path / "walk.mot").write_text(f"walk\ninDegrees=yes\nendheader\ntime\tknee\n{rows}\n", "utf-8")
    with pytest.raises(InputError, match=r"running\[0\].expression: the unit of \"knee\" is open.*a: knee \[deg\]"):
        read(tmp_path, text.replace("track", expression))
    stated = text.replace("a: knee", "a: 'knee [deg]'").replace(
        "track: [{reference: walk, coordinates: {x: a}", expression[:-7] + "#"
    )
    (reference,) = read(tmp_path, stated).references
    assert reference.columns[0][1].evaluate(np.array([0.5]))[0] == pytest.approx(
        np.radians(wave(np.array(0.5))), rel=1e-6
    )
