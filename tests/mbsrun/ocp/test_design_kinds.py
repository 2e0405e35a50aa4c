"""Each kind of parameter as an unknown: a length, a mass, a spring, a gear ratio and the position of a frame.

The model is an arm on a spring with a tool that turns along with it, by a gear. An optimum over design and motion is
stationary in the design: with V(p) the least cost of a motion at the given p,

    dV/dp + d price/dp = 0,

where dV/dp is found through the optimum, and by solving again beside p. A fit finds the numbers of a motion that was
integrated by another method.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mbsrun.external import OnDemand, load_on_demand
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.optima.sensitivity import find_sensitivities
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem

RIG = """\
name: rig
gravity: [0, 0, -9.81]
parameters:
  reach: {value: 0.5, kind: differentiated}      # a length
  load: {value: 1, kind: differentiated}         # a mass
  spring: {value: 8, kind: differentiated}
  gear: {value: -0.5, kind: differentiated}      # a ratio
  grip: {value: 0.2, kind: differentiated}       # the position of a frame
bodies:
  - name: arm
    joint: {name: lift, type: revolute, axis: -y, stiffness: spring, rest: 0.3, damping: 0.1}
    mass: 2*reach
    com: [reach/2, 0, 0]
    inertia: [1e-3, reach**3/6, reach**3/6]
  - name: tool
    parent: arm
    joint: {name: wrist, type: revolute, axis: -y, position: [reach, 0, 0], follows: {joint: lift, ratio: gear}}
    mass: load
    com: [0.1, 0, 0.02]
    inertia: [1e-3, 2e-3, 2e-3]
frames:
  - {name: tip, body: tool, position: [grip, 0, 0.05]}
"""
REACH = """\
model: rig.yaml
horizon: 0.8
intervals: 8
scheme: radau
degree: 4
cost:
  inputs: 1
  running: [{expression: z_tip**2, weight: 3}]
  terminal: [{expression: (NAME - VALUE)**2, weight: WEIGHT}]
unknowns: {NAME: {guess: VALUE}}
start: {pose: {lift: -0.6}}
end: {sensors: {tip: {z: 0.2}}, velocity: zero}
solver: {tolerance: 1e-11}
"""
FIT = """\
model: rig.yaml
horizon: 1
intervals: 20
scheme: radau
degree: 4
references: {seen: {file: seen.csv, degree: 5}}
forces: {lift: 4 + 3*sin(7*t)}
unknowns:
  load: {guess: 0.8, range: [0.1, 5]}
  spring: {guess: 10, range: [0, 50]}
  gear: {guess: -0.4, range: [-2, 2]}
  reach: {guess: 0.55, range: [0.2, 1]}
  grip: {guess: 0.15, range: [0, 1]}
cost: {track: [{reference: seen, markers: [tip], weight: 1e3}]}
start: {pose: {lift: -0.6}}
guess: {motion: rest, inputs: zero}
solver: {tolerance: 1e-12}
"""
KINDS = {  # usual value, and the weight of the price of another
    "reach": (0.5, 100.0),
    "load": (1.0, 20.0),
    "spring": (8.0, 0.5),
    "gear": (-0.5, 50.0),
    "grip": (0.2, 100.0),
}


@pytest.fixture(scope="module")
def folder(requires: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    requires("cc")
    found = tmp_path_factory.mktemp("rig")
    (found / "rig.yaml").write_text(RIG, "utf-8")
    return found


def read(folder: Path, text: str) -> tuple[Problem, OnDemand]:
    (folder / "rig.ocp.yaml").write_text(text, "utf-8")
    problem, plant = read_problem(folder / "rig.ocp.yaml", load_on_demand)
    assert isinstance(plant, OnDemand)
    return problem, plant


def solved(problem: Problem, plant: Plant) -> Solution:
    outcome = solve(problem, plant)
    assert isinstance(outcome, Solution), outcome
    return outcome


def at(problem: Problem, **values: float) -> Problem:
    """Return the same problem with given numbers in place of unknowns and their prices."""
    cost = replace(problem.cost, terminal=())
    return replace(problem, unknowns=(), cost=cost, parameters=tuple(values.items()))


@pytest.mark.parametrize("name", KINDS)
def test_an_optimum_is_stationary_in_each_kind_of_parameter(folder: Path, name: str) -> None:
    """By the derivative through the optimum and by solving again, both to 1e-5."""
    usual, weight = KINDS[name]
    text = REACH.replace("NAME", name).replace("VALUE", str(usual)).replace("WEIGHT", str(weight))
    problem, plant = read(folder, text)
    found = solved(problem, plant)
    (best,) = found.trajectory.unknowns.tolist()
    price = weight * (best - usual) ** 2
    assert abs(best - usual) > 1e-3 * abs(usual)  # the motion has a say
    fixed = solved(at(problem, **{name: best}), plant)
    assert fixed.cost.total + price == pytest.approx(found.cost.total, rel=1e-9)
    through = dict(find_sensitivities(fixed, plant).sensitivities)
    assert set(through) == set(KINDS)
    assert through[name] == pytest.approx(-2 * weight * (best - usual), rel=1e-5)
    step = 1e-3 * abs(usual)
    costs = [solved(at(problem, **{name: best + d}), plant).cost.total for d in (-2 * step, -step, step, 2 * step)]
    again = (costs[0] - 8 * costs[1] + 8 * costs[2] - costs[3]) / (12 * step)
    assert through[name] == pytest.approx(again, rel=1e-5)


def test_all_kinds_are_chosen_together_with_the_motion(folder: Path) -> None:
    """The gradient of the least cost of a motion, by all five numbers, balances the gradient of the price."""
    first, *others = KINDS
    text = REACH.replace("NAME", first).replace("VALUE", str(KINDS[first][0])).replace("WEIGHT", str(KINDS[first][1]))
    for name in others:
        usual, weight = KINDS[name]
        text = text.replace("unknowns: {", f"unknowns: {{{name}: {{guess: {usual}}}, ")
        text = text.replace("terminal: [", f"terminal: [{{expression: ({name} - {usual})**2, weight: {weight}}}, ")
    problem, plant = read(folder, text)
    for method in ("ipopt", "mbs"):
        found = solved(problem.with_solver(method), plant)
        best = dict(zip([x.name for x in problem.unknowns], found.trajectory.unknowns.tolist(), strict=True))
        through = dict(find_sensitivities(solved(at(problem, **best), plant), plant).sensitivities)
        largest = max(map(abs, through.values()))
        for name, (usual, weight) in KINDS.items():
            assert through[name] == pytest.approx(-2 * weight * (best[name] - usual), rel=1e-5, abs=1e-6 * largest)


def test_a_fit_finds_the_numbers_of_a_recorded_motion(folder: Path) -> None:
    """Markers of a motion that another method integrates, under known forces: all five numbers come back."""
    true = {"reach": 0.6, "load": 1.3, "spring": 12.0, "gear": -0.7, "grip": 0.25}
    plant = load_on_demand(folder / "rig.yaml").with_parameters(**true)

    def rates(t: float, y: np.ndarray[tuple[int], np.dtype[np.float64]]) -> list[float]:
        qdd = plant("exp1", q=y[:1], qd=y[1:], u=np.array([4 + 3 * np.sin(7 * t)]))["qdd"]
        return [float(y[1]), float(np.ravel(qdd)[0])]

    times = np.linspace(0, 1, 101)
    motion = solve_ivp(rates, (0, 1), [-0.6, 0.0], method="DOP853", t_eval=times, rtol=1e-12, atol=1e-12)
    places = plant("sensors", q=motion.y[:1].T)["position"][..., 0]
    rows = [",".join(f"{x!r}" for x in (t, *p)) for t, p in zip(times.tolist(), places.tolist(), strict=True)]
    header = "t [s],x[tip] [m],y[tip] [m],z[tip] [m]"
    (folder / "seen.csv").write_text("\n".join([header, *rows]) + "\n", "utf-8")
    problem, own = read(folder, FIT)
    found = solved(problem, own)
    best = dict(zip([x.name for x in problem.unknowns], found.trajectory.unknowns.tolist(), strict=True))
    for name, value in true.items():
        assert best[name] == pytest.approx(value, rel=1e-4), name
