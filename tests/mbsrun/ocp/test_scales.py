"""Scales of variables: what they are, and that units do not decide whether a problem is solved."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse

from mbsrun.external import load_on_demand
from mbsrun.ocp.ground.no_mechanism import NO_MECHANISM
from mbsrun.ocp.ground.status import SOLVED
from mbsrun.ocp.solution.phases import PhasedSolution
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.phases import solve_phases
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.phases import read_phased_problem
from mbsrun.ocp.statement.statement import read_problem
from mbsrun.ocp.transcription.scales import FLAT, STEEP, USUAL, find_terms, round_scale, scale_cost

LANDER = """
horizon: {guess: 4, range: [1, 10]}
intervals: 20
scheme: radau
degree: 3
constants: {unit: UNIT}
states:
  h: {rate: v, start: 10*unit, end: 0, range: [null, 20*unit], guess: [10*unit, 0]}
  v: {rate: thrust - 1.5*unit, start: -2*unit, end: 0, guess: [-2*unit, 0]}
controls: {thrust: {range: [0, 3*unit], guess: 1.5*unit}}
cost: {running: [{expression: thrust/unit}]}
"""


@pytest.mark.parametrize(
    ("largest", "limits", "scale"),
    [
        (3.0, [np.inf], 1.0),  # near 1: none
        (6e6, [1.2e7], 2.0**23),  # the nearest power of 2 of the guess
        (0.0, [1e4], 2.0**13),  # no guess: the bound
        (0.0, [np.inf], 1.0),  # neither
        (1e-12, [1e5], 2.0**7),  # a thousandth of the bound at least
        (5e6, [1e4], 2.0**13),  # the bound at most
        (3e-5, [np.inf], 2.0**-15),
    ],
)
def test_a_scale_is_a_power_of_two_near_the_size(largest: float, limits: list[float], scale: float) -> None:
    """So that dividing by it rounds nothing."""
    assert round_scale(largest, np.array(limits)) == scale


@pytest.mark.parametrize(
    ("limits", "scale"),
    [
        ([1e4, 1e6, 0.0, np.inf], 2.0**20),  # the largest finite bound, of the ones above 0
        ([0.0, 0.0], 1.0),
        ([], 1.0),
        ([10.0], 1.0),  # sizes from a tenth to ten need no scale
        ([0.1], 1.0),
        ([10.5], 2.0**3),
        ([0.095], 2.0**-3),
    ],
)
def test_bounds_are_sizes_where_nothing_is_guessed(limits: list[float], scale: float) -> None:
    assert round_scale(0.0, np.array(limits)) == scale


def test_a_mechanism_needs_scales_beyond_a_thousand() -> None:
    for size in (1e-3, 1e3):
        assert round_scale(size, np.array([np.inf]), USUAL) == 1.0
        assert round_scale(size, np.array([np.inf])) != 1.0
    assert round_scale(1.01e3, np.array([np.inf]), USUAL) == 2.0**10
    assert round_scale(np.inf, np.array([np.inf])) == 1.0


def test_a_cost_that_is_steep_or_flat_is_scaled_by_a_power_of_two() -> None:
    """A steep one to the largest usual slope, a flat one to 1; a cost without slopes stays."""
    for slope in (0.0, FLAT, 1.0, STEEP):
        assert scale_cost(slope) == 1.0
    for slope in (1.5 * STEEP, 3e7):
        assert 2**-0.5 <= slope * scale_cost(slope) / STEEP <= 2**0.5
        assert np.log2(scale_cost(slope)) % 1 == 0
    for slope in (0.7 * FLAT, 3e-9):
        assert 2**-0.5 <= slope * scale_cost(slope) <= 2**0.5


def test_the_largest_term_of_a_row_is_of_scaled_variables(rng: np.random.Generator) -> None:
    J = sparse.random_array((6, 4), density=0.5, rng=rng, data_sampler=rng.standard_normal).tocsc()
    scales = np.array([1.0, 8.0, 0.25, 2.0])
    assert np.array_equal(find_terms(J, scales), np.abs(J.toarray() * scales).max(axis=1))


@pytest.mark.parametrize("method", ["mbs", "ipopt"])
@pytest.mark.parametrize("unit", ["1", "1e7", "1e-7"])
def test_a_lander_in_any_unit_burns_as_much(tmp_path: Path, unit: str, method: str) -> None:
    """A landing from 10 m at -2 m/s under 1.5 m/s^2, at least thrust: full thrust after a fall, in any unit.

    Fall for s, thrust of 3 m/s^2 for b: 2 + 1.5 s = 1.5 b, and 10 = 2 s + 0.75 s^2 + 0.75 b^2; the cost is 3 b,
    except for the interval within which the thrust switches.
    """
    (tmp_path / "lander.ocp.yaml").write_text(LANDER.replace("UNIT", unit), "utf-8")
    problem, plant = read_problem(tmp_path / "lander.ocp.yaml", load_on_demand, NO_MECHANISM)
    solution = solve(problem.with_solver(method), plant)
    assert isinstance(solution, Solution), solution.finding
    s = max(np.roots([1.5, 4.0, 4 / 3 - 10]).real)
    assert solution.cost.total == pytest.approx(3 * (s + 4 / 3), rel=2e-3)
    assert solution.run.iterations < 40


ORBIT = """
horizon: 3.32*second
intervals: 15
scheme: radau
degree: 3
constants: {metre: METRE, second: SECOND, mu: metre**3/second**2, push: 0.1405*metre/second**2, flow: 0.0749/second}
states:
  r: {rate: out, start: metre, range: [0.6*metre, 2*metre]}
  out: {rate: along**2/r - mu/r**2 + push*sin(angle)/(1 - flow*t), start: 0, end: 0}
  along: {rate: -out*along/r + push*cos(angle)/(1 - flow*t), start: metre/second}
controls: {angle: {range: [-3.2, 6.4], guess: 1.5}}
constraints: [{expression: along - sqrt(mu/r), range: [0, 0], at: end}]
cost: {terminal: [{expression: -r/metre}]}
solver: {method: mbs, fallback: false}
"""


def test_a_velocity_from_rest_to_rest_has_the_size_of_its_rate(tmp_path: Path) -> None:
    """An orbit is raised as far in metres and seconds as in its own units, though `out` is guessed as 0 in both."""
    costs = []
    for metre, second in (("1", "1"), ("1.5e11", "5.0e6"), ("1e-7", "1"), ("1e-7", "1e-7"), ("1e7", "1e-7")):
        (tmp_path / "orbit.ocp.yaml").write_text(ORBIT.replace("METRE", metre).replace("SECOND", second), "utf-8")
        problem, plant = read_problem(tmp_path / "orbit.ocp.yaml", load_on_demand, NO_MECHANISM)
        outcome = solve(problem, plant)
        assert isinstance(outcome, Solution), outcome.finding
        costs.append(outcome.cost.total)
    assert costs == pytest.approx([costs[0]] * len(costs), rel=1e-7)


PUSH = """
horizon: 1
intervals: 10
scheme: radau
degree: 3
constants: {unit: UNIT}
states:
  x: {rate: v, start: 0, end: 1.5*unit, range: [-unit, 1.5*unit]}
  v: {rate: f/2, start: 0, end: 0}
controls: {f: {}}
cost: {running: [{expression: (f/unit)**2}]}
solver: {method: mbs, fallback: false}
"""


@pytest.mark.parametrize("unit", ["1e-7", "1", "1e7"])
def test_a_force_has_the_size_that_moves_its_mass(tmp_path: Path, unit: str) -> None:
    """A mass of 2 goes 1.5 units to rest at a wall in 1 s; 12 (1.5)^2 2^2 / (1 - 1/100) by 10 constant forces.

    Velocity and force are guessed as 0 in any unit, and have no bounds.
    """
    (tmp_path / "push.ocp.yaml").write_text(PUSH.replace("UNIT", unit), "utf-8")
    problem, plant = read_problem(tmp_path / "push.ocp.yaml", load_on_demand, NO_MECHANISM)
    outcome = solve(problem, plant)
    assert isinstance(outcome, Solution), outcome.finding
    assert outcome.cost.total == pytest.approx(12 * 1.5**2 * 4 / (1 - 1 / 100), rel=1e-8)
    assert outcome.run.iterations < 15


UNITS = list(
    itertools.product(("1", "1e6", "1e-6"), ("1", "1e3", "1e-3"), ("1", "1e4", "1e-4"))
)  # metre, second, kilogram
TINY = [("1e-7", "1e7", "1"), ("1e-9", "1e3", "1"), ("1e-12", "1", "1e-6"), ("1e-9", "1e-3", "1e3")]
EXTREME = [("1e6", "1e3", "1e4"), ("1e6", "1e-3", "1e4"), ("1e-6", "1e3", "1e-4"), ("1e-6", "1e-3", "1e-4")]

REST_TO_REST = """
horizon: second
intervals: 20
scheme: radau
degree: 3
constants: {metre: METRE, second: SECOND, kilogram: KILOGRAM}
states:
  x: {rate: v, start: 0, end: metre}
  v: {rate: f/kilogram, start: 0, end: 0}
controls: {f: {}}
cost: {running: [{expression: f**2}]}
solver: {method: mbs, fallback: false}
"""


def _write(folder: Path, text: str, units: Sequence[str]) -> Path:
    """Write a problem in units."""
    for name, value in zip(("METRE", "SECOND", "KILOGRAM"), units, strict=True):
        text = text.replace(name, value)
    path = folder / "scaled.ocp.yaml"
    path.write_text(text, "utf-8")
    return path


@pytest.mark.parametrize("units", UNITS)
def test_velocities_and_forces_that_are_guessed_as_0_have_sizes(tmp_path: Path, units: Sequence[str]) -> None:
    """A quadratic program, one iteration: 12 L^2 m^2 / T^3, over 1 - 1/N^2 for N constant forces."""
    problem, plant = read_problem(_write(tmp_path, REST_TO_REST, units), load_on_demand, NO_MECHANISM)
    outcome = solve(problem, plant)
    assert isinstance(outcome, Solution), outcome.finding
    metre, second, kilogram = map(float, units)
    expected = 12 / (1 - 1 / 400) * (metre * kilogram) ** 2 / second**3
    assert outcome.run.status == SOLVED
    assert outcome.run.iterations == 1
    assert outcome.cost.total == pytest.approx(expected, rel=1e-9)


FASTEST = """
horizon: {guess: second, range: [second/20, 20*second]}
intervals: 20
scheme: radau
degree: 3
constants: {metre: METRE, second: SECOND, kilogram: KILOGRAM, most: 4*metre*kilogram/second**2}
states:
  x: {rate: v, start: 0, end: metre}
  v: {rate: f/kilogram, start: 0, end: 0}
controls: {f: {range: [-most, most]}}
cost: {terminal: [{expression: T}]}
solver: {method: mbs, fallback: false}
"""


@pytest.mark.parametrize("units", EXTREME)
def test_small_bounds_hold_in_their_own_unit(tmp_path: Path, units: Sequence[str]) -> None:
    """The least time over L by a force of at most F is 2 sqrt(L m / F), the second of the file."""
    problem, plant = read_problem(_write(tmp_path, FASTEST, units), load_on_demand, NO_MECHANISM)
    outcome = solve(problem, plant)
    assert isinstance(outcome, Solution), outcome.finding
    assert outcome.cost.total == pytest.approx(float(units[1]), rel=1e-6)


FARTHEST = """
horizon: second
intervals: 20
scheme: radau
degree: 3
constants: {metre: METRE, second: SECOND, kilogram: KILOGRAM, most: kilogram*metre/second**2}
states:
  x: {rate: v, start: 0}
  v: {rate: f/kilogram, start: 0, end: 0}
controls: {f: {range: [-most, most]}}
cost: {terminal: [{expression: -x/metre}]}
solver: {method: mbs, fallback: false}
"""


@pytest.mark.parametrize("units", [*EXTREME, *TINY])
def test_a_state_has_the_size_that_a_limit_lets_it_reach(tmp_path: Path, units: Sequence[str]) -> None:
    """From rest to rest in T, a force of at most F moves m by F T^2 / (4 m); only F, which is tiny, states a size."""
    problem, plant = read_problem(_write(tmp_path, FARTHEST, units), load_on_demand, NO_MECHANISM)
    outcome = solve(problem, plant)
    assert isinstance(outcome, Solution), outcome.finding
    assert outcome.cost.total == pytest.approx(-0.25, rel=1e-6)
    assert outcome.run.iterations < 15


FARTHEST_BY_A_BUDGET = """
horizon: second
intervals: 20
scheme: radau
degree: 3
constants: {metre: METRE, second: SECOND, kilogram: KILOGRAM, budget: (kilogram*metre)**2/second**3}
states:
  x: {rate: v, start: 0}
  v: {rate: f/kilogram, start: 0, end: 0}
  effort: {rate: f**2, start: 0, end: [0, budget]}
controls: {f: {}}
cost: {terminal: [{expression: -x/metre}]}
solver: {method: mbs, fallback: false}
"""


@pytest.mark.parametrize("units", [("1e-3", "1e2", "1"), ("1e3", "1e-2", "1"), EXTREME[0], *EXTREME[2:], *TINY])
def test_a_force_has_the_size_that_a_budget_of_its_square_lets_it_have(tmp_path: Path, units: Sequence[str]) -> None:
    """From rest to rest in T, the integral of f^2 up to B moves m by sqrt(B T^3 / 12) / m.

    For N constant forces B is divided by 1 + 1/(N^2 - 1), as in the least effort over a length. The square has no slope
    at 0.
    """
    problem, plant = read_problem(_write(tmp_path, FARTHEST_BY_A_BUDGET, units), load_on_demand, NO_MECHANISM)
    outcome = solve(problem, plant)
    assert isinstance(outcome, Solution), outcome.finding
    assert outcome.run.status == SOLVED
    assert outcome.cost.total == pytest.approx(-np.sqrt((1 - 1 / 400) / 12), rel=1e-7)
    assert outcome.run.iterations < 30


AROUND = """
model: table.yaml
horizon: second
intervals: 20
scheme: radau
degree: 3
constants: {metre: METRE, second: SECOND, kilogram: KILOGRAM, most: 11*metre*kilogram/second**2}
start: {pose: {}}
end: {pose: {x: metre, y: 0.3*metre}, velocity: zero}
bounds: {inputs: {x: [-most, most]}}
constraints:
  - {expression: (q_x - 0.5*metre)**2 + (q_y - 0.06*metre)**2, range: [(0.1*metre)**2, null]}
cost: {inputs: 1}
solver: {method: mbs, fallback: false}
"""
TABLE = """
name: table
gravity: [0, 0, 0]
bodies:
  - {name: x, joint: {type: prismatic, axis: x}, mass: KILOGRAM}
  - {name: y, parent: x, joint: {type: prismatic, axis: y}, mass: KILOGRAM}
"""


@pytest.mark.parametrize("units", [*EXTREME, *TINY])
def test_a_mechanism_passes_an_obstacle_in_any_unit(tmp_path: Path, units: Sequence[str]) -> None:
    """The forces are the ones of 1 m, 1 s, 1 kg, times the units.

    The row's limit of 0.01 m^2 is relaxed by 1e-8 in metres, and by 1e-8 of the row's size in other units.
    """
    costs = []
    for own in (("1", "1", "1"), units):
        (tmp_path / "table.yaml").write_text(TABLE.replace("KILOGRAM", own[2]), "utf-8")
        outcome = solve(*read_problem(_write(tmp_path, AROUND, own), load_on_demand))
        assert isinstance(outcome, Solution), outcome.finding
        metre, second, kilogram = map(float, own)
        costs.append(outcome.cost.total / ((metre * kilogram) ** 2 / second**3))
    assert costs[1] == pytest.approx(costs[0], rel=1e-5)


BOTH = """
model: table.yaml
horizon: second
intervals: 20
scheme: radau
degree: 3
constants: {metre: METRE, second: SECOND, kilogram: KILOGRAM, most: kilogram*metre/second**2}
start: {pose: {}}
end: {pose: {x: null, y: null}, velocity: zero}
bounds: {inputs: {x: [-most, most], y: [-most, most]}}
cost: {terminal: [{expression: -(q_x + q_y)/metre}]}
solver: {method: mbs, fallback: false}
"""


@pytest.mark.parametrize("units", [*EXTREME, *TINY])
def test_a_mechanism_has_the_size_that_limits_let_it_reach(tmp_path: Path, units: Sequence[str]) -> None:
    """From rest to rest in T, a force of at most F moves m by F T^2 / (4 m); the first body carries the second."""
    (tmp_path / "table.yaml").write_text(TABLE.replace("KILOGRAM", units[2]), "utf-8")
    outcome = solve(*read_problem(_write(tmp_path, BOTH, units), load_on_demand))
    assert isinstance(outcome, Solution), outcome.finding
    assert outcome.cost.total == pytest.approx(-0.25 / 2 - 0.25, rel=1e-6)


def test_a_launch_in_metres_and_kilograms() -> None:
    """The published optimum of the Delta III is 7529.7123 kg; radii are of 1e7 m, their squares of 1e14 m^2."""
    file = Path(__file__).parent / "phases" / "delta_iii.ocp.yaml"
    solution = solve_phases(*read_phased_problem(file, load_on_demand))
    assert isinstance(solution, PhasedSolution), solution.finding
    assert -1000 * solution.cost == pytest.approx(7529.7123, abs=1e-3)
