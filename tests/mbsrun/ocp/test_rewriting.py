"""Keys of problem files that are other parts of a problem: slacks, largest values, rates, linear inputs, delays.

A mass of 1 kg moves by 1 m from rest to rest: its optima are closed forms.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import mbsrun
from mbsgen.errors import InputError
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.showing.pictures import make_trajectories
from mbsrun.ocp.showing.summary import summarise, write_line
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.resimulation import resimulate
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.statement.statement import read_problem
from mbsrun.optimal.result import Solved
from tests.mbsrun.ocp.plants import mechanism
from tests.mbsrun.peer import Peer

MODELS = Path(__file__).parents[3] / "models"
PUSH = """\
model: mass.yaml
horizon: 1
intervals: 4
scheme: radau
degree: 3
start: {pose: {}}
end: {pose: {x: 1}, velocity: zero}
"""


@cache
def mass() -> Peer:
    q, qd, qdd, u = (ca.SX.sym(name) for name in ("q", "qd", "qdd", "u"))
    return mechanism(("x",), qdd - u + 0 * q + 0 * qd, (q, qd, qdd, u))


@pytest.fixture
def read(tmp_path: Path) -> Callable[[str], Problem]:
    def read_text(text: str) -> Problem:
        (tmp_path / "push.ocp.yaml").write_text(text, "utf-8")
        return read_problem(tmp_path / "push.ocp.yaml", lambda _: mass())[0]

    return read_text


def find(problem: Problem) -> Solution:
    found = solve(problem, mass())
    assert isinstance(found, Solution), found
    return resimulate(found, mass())


# --- inputs and their rates ----------------------------------------------------------------------------------------


def test_linear_inputs_find_the_linear_optimum(read: Callable[[str], Problem]) -> None:
    """The least integral of u^2 is 12, by u = 6 - 12 t, whose motion is a cubic polynomial; u is continuous."""
    found = find(read(PUSH + "inputs: linear\ncost: {inputs: 1}\n"))
    t = found.trajectory
    assert found.cost.total == pytest.approx(12, rel=1e-9)
    assert t.states[:, 0] == pytest.approx(6 - 12 * t.t, abs=1e-6)
    assert t.controls[:, 0] == pytest.approx(np.full(4, -12.0), abs=1e-6)
    assert found.resimulation is not None
    assert found.resimulation.is_accurate


def test_rates_of_polynomial_inputs_are_their_derivatives(read: Callable[[str], Problem]) -> None:
    """The least integral of the squared rate is 120: u = 5 - 30 t^2 + 20 t^3, whose motion is of degree 5."""
    text = PUSH.replace("degree: 3", "degree: 5").replace("intervals: 4", "intervals: 2")
    found = find(read(text + "inputs: polynomial\ncost: {input_rates: 1}\n"))
    t = found.trajectory.t
    assert found.cost.total == pytest.approx(120, rel=1e-8)
    assert found.trajectory.states[:, 0] == pytest.approx(5 - 30 * t**2 + 20 * t**3, abs=1e-6)


@pytest.mark.parametrize("course", ["linear", "polynomial"])
def test_rates_of_continuous_inputs_are_bounded_and_read(read: Callable[[str], Problem], course: str) -> None:
    """A rate of exactly 12 either way still admits u = 6 - 12 t; expressions read it."""
    text = f"inputs: {course}\ncost: {{inputs: 1}}\nbounds: {{input_rates: {{x: [-12, 12]}}}}\n"
    found = find(read(PUSH + text + "constraints: [{expression: rate_u_x + 12, range: [-1e-3, 1e-3]}]\n"))
    assert found.cost.total == pytest.approx(12, rel=1e-6)


def step(N: int, most: float, horizon: float) -> tuple[float, list[float]]:
    """Reach 1 m at any speed by constant inputs and exact integration: cost and inputs."""
    opti, h = ca.Opti(), horizon / N
    u = opti.variable(N)
    x, v = ca.MX(0), ca.MX(0)
    for k in range(N):
        x, v = x + h * v + h**2 / 2 * u[k], v + h * u[k]
    opti.subject_to(x == 1)
    opti.subject_to(opti.bounded(-most * h, u[1:] - u[:-1], most * h))
    opti.minimize(h * ca.sumsqr(u))
    opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes", "tol": 1e-10})
    found = opti.solve()
    return float(found.value(opti.f)), np.ravel(found.value(u)).tolist()


@pytest.mark.parametrize("where", ["inputs", "controls"])
@pytest.mark.parametrize("horizon", ["1", "{guess: 1.2, range: [1, 1.5]}"])
def test_rates_of_constant_inputs_are_differences_over_time(
    read: Callable[[str], Problem], where: str, horizon: str
) -> None:
    """A program of CasADi's bounds (u[k+1] - u[k]) / h; a free horizon grows to its limit, as the cost falls."""
    text = PUSH.replace("intervals: 4", "intervals: 10").replace("horizon: 1", f"horizon: {horizon}")
    text = text.replace(", velocity: zero", "")
    T = 1.0 if horizon == "1" else 1.5
    most = 1.0 if T == 1 else 0.4
    if where == "inputs":
        text += f"cost: {{inputs: 1}}\nbounds: {{input_rates: [-{most}, {most}]}}\n"
    else:
        text += f"controls: {{push: {{rate: {{range: [-{most}, {most}]}}}}}}\n"
        text += "forces: {x: push}\n"
        text += "cost: {running: [{expression: push**2}]}\n"
    found = find(read(text))
    cost, inputs = step(10, most, T)
    values = found.trajectory.u if where == "inputs" else found.trajectory.controls
    assert found.trajectory.t[-1] == pytest.approx(T, abs=1e-6)
    assert found.cost.total == pytest.approx(cost, rel=1e-6)
    assert values[:, 0] == pytest.approx(inputs, abs=1e-4)
    assert np.abs(np.diff(inputs)).max() == pytest.approx(most * T / 10, rel=1e-6)


@pytest.mark.parametrize("horizon", ["1", "{guess: 1, range: [1, 1]}"])
def test_a_control_s_rates_have_the_price_of_an_input_s(read: Callable[[str], Problem], horizon: str) -> None:
    """The same weight on a control that is the input, and on the input: one optimum, with terms of one size."""
    text = PUSH.replace("horizon: 1", f"horizon: {horizon}")
    inputs = find(read(text + "cost: {inputs: 1, input_rates: 0.02}\n"))
    control = "controls: {push: {rate: {weight: 0.02}}}\nforces: {x: push}\ncost: {running: [{expression: push**2}]}\n"
    controls = find(read(text + control))
    assert dict(controls.cost.terms)["rates of push"] == pytest.approx(dict(inputs.cost.terms)["input rates"], rel=1e-5)
    assert controls.cost.total == pytest.approx(inputs.cost.total, rel=1e-8)


def test_a_linear_control_is_a_state_of_its_name(read: Callable[[str], Problem]) -> None:
    text = "controls: {push: {range: [-7, 7], rate: {weight: 0.01}}}\nforces: {x: push}\n"
    control = find(read(PUSH + f"inputs: linear\n{text}cost: {{running: [{{expression: push**2}}]}}\n"))
    inputs = "inputs: linear\ncost: {inputs: 1, input_rates: 0.01}\nbounds: {inputs: [-7, 7]}\n"
    assert [state.name for state in control.problem.states] == ["push"]
    assert control.cost.total == pytest.approx(find(read(PUSH + inputs)).cost.total, rel=1e-8)


# --- delays --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("course", ["constant", "polynomial"])
def test_a_delay_is_a_later_start(read: Callable[[str], Problem], course: str) -> None:
    """With no input before, the motion is the one of a horizon that is shorter by the delay."""
    whole = find(
        read(
            PUSH.replace("intervals: 4", "intervals: 5") + f"inputs: {{course: {course}, delay: 0.2}}\n"
            "cost: {inputs: 1}\n"
        )
    )
    short = find(read(PUSH.replace("horizon: 1", "horizon: 0.8") + f"inputs: {course}\ncost: {{inputs: 1}}\n"))
    assert whole.cost.total == pytest.approx(short.cost.total, rel=1e-8)
    assert whole.trajectory.u[0, 0] == 0
    assert whole.resimulation is not None
    assert whole.resimulation.is_accurate


def test_the_input_before_the_start_acts_during_the_delay(read: Callable[[str], Problem]) -> None:
    """A push of 2 N over 0.2 s leads to x = 0.04 m at 0.4 m/s; from there the least integral is a closed form."""
    text = PUSH.replace("intervals: 4", "intervals: [1, 1, 3, 3, 2]")
    found = find(read(text + "inputs: {course: linear, delay: {x: 0.2}, history: {x: 2}}\ncost: {inputs: 1}\n"))
    t = found.trajectory
    assert t.q[2, 0] == pytest.approx(0.04, abs=1e-9)
    assert t.qd[2, 0] == pytest.approx(0.4, abs=1e-9)
    free = find(read(text + "inputs: {course: constant, delay: {x: 0.2}, history: free}\ncost: {inputs: 1}\n"))
    none = find(read(text + "cost: {inputs: 1}\n"))
    assert free.cost.total == pytest.approx(none.cost.total, rel=1e-8)


def test_a_control_acts_later(read: Callable[[str], Problem]) -> None:
    """A delayed control that is the input is a delayed input."""
    text = PUSH.replace("intervals: 4", "intervals: 5")
    control = (
        "controls: {push: {delay: 0.2, history: 1}}\nforces: {x: push}\ncost: {running: [{expression: push**2}]}\n"
    )
    own = find(read(text + "inputs: {delay: 0.2, history: 1}\ncost: {inputs: 1}\n"))
    assert find(read(text + control)).cost.total == pytest.approx(own.cost.total, rel=1e-8)


# --- soft constraints and largest values ---------------------------------------------------------------------------


def test_a_slack_is_the_one_that_a_user_writes(read: Callable[[str], Problem]) -> None:
    """Both prices; the summary shows by how much the constraint is violated."""
    soft = "constraints: [{expression: qd_x, range: [null, 1.2], soft: {linear: 3, quadratic: 5}}]\ncost: {inputs: 1}\n"
    hand = """controls: {s: {range: [0, null]}}
constraints: [{expression: qd_x - s, range: [null, 1.2]}]
cost: {inputs: 1, running: [{expression: s, weight: 3}, {expression: s**2, weight: 5}]}
"""
    found, other = find(read(PUSH + soft)), find(read(PUSH + hand))
    assert found.cost.total == pytest.approx(other.cost.total, rel=1e-8)
    prices = {name: value for name, value in found.cost.terms if name.startswith("slack")}
    expected = [value for _, value in other.cost.terms if value][1:]
    assert list(prices) == ["slack of qd_x", "slack of qd_x, squared"]
    assert list(prices.values()) == pytest.approx(expected, rel=1e-5)
    most = float(found.trajectory.controls.max())
    assert most > 0.1
    assert summarise(found)["slack of qd_x "].startswith(f"{most:.6g}, the most from ")
    figure = make_trajectories(found, mass().manifest)
    legends = [legend for axes in figure.axes if (legend := axes.get_legend()) is not None]
    shown = [axes.get_title(loc="left") + axes.get_title() for axes in figure.axes]
    shown += [line.get_text() for legend in (*figure.legends, *legends) for line in legend.get_texts()]
    assert "slack of qd_x" in shown


def test_a_high_price_is_exact(read: Callable[[str], Problem]) -> None:
    """Beyond the constraint's multiplier the slack is 0, and the optimum the one of the hard constraint."""
    text = PUSH.replace("intervals: 4", "intervals: 8")
    hard = "constraints: [{expression: qd_x, range: [null, 1.4]}]\ncost: {inputs: 1}\n"
    own, soft = find(read(text + hard)), find(read(text + hard.replace("1.4]", "1.4], soft: 1000")))
    assert soft.cost.total == pytest.approx(own.cost.total, rel=1e-6)
    assert summarise(soft)["slack of qd_x "] == "not used"


@pytest.mark.parametrize(
    "part",
    [
        "constraints: [{expression: qd_x - limit, range: [null, 0.2], soft: 3}]\ncost: {inputs: 1}\n",
        "cost: {inputs: 1, largest: [{expression: qd_x - limit}]}\n",
    ],
)
def test_constants_that_only_a_slack_or_a_largest_value_reads_are_kept(
    part: str, read: Callable[[str], Problem]
) -> None:
    problem = read(f"{PUSH}constants: {{limit: 1, unused: 2}}\n{part}")
    assert problem.constants == (("limit", 1.0),)
    find(problem)


def test_a_soft_end_is_a_compromise(read: Callable[[str], Problem]) -> None:
    """Of 12 x^2 + 30 (1 - x)^2, the cost to come to rest at x, the minimum is at x = 30 / 42; either side is soft."""
    text = PUSH.replace("pose: {x: 1}, ", "") + "inputs: linear\ncost: {inputs: 1}\n"
    end = "constraints: [{expression: q_x, range: [1, 1], at: end, soft: {quadratic: 30, name: short}}]\n"
    found = find(read(text + end))
    assert found.trajectory.q[-1, 0] == pytest.approx(30 / 42, abs=1e-6)
    assert float(summarise(found)["slack of q_x "]) == pytest.approx(12 / 42, abs=1e-5)


@pytest.mark.parametrize("expression", ["u_x", "-u_x"])
def test_the_least_peak_of_an_input(read: Callable[[str], Problem], expression: str) -> None:
    """From rest to rest in 1 s the least peak is 4 N, pushed for one half and pulled for the other."""
    cost = f"cost: {{largest: [{{expression: {expression}, absolute: true, weight: 2, name: peak}}]}}\n"
    found = find(read(PUSH + cost))
    assert found.trajectory.unknowns == pytest.approx([4.0], abs=1e-6)
    assert found.cost.total == pytest.approx(8.0, abs=1e-5)
    assert float(summarise(found)["peak"]) == pytest.approx(4.0, abs=1e-6)


def test_lines_of_a_summary_keep_their_numbers_whatever_unknowns_and_terms_are_called(
    read: Callable[[str], Problem],
) -> None:
    """Unknowns with the names of lines, and two terms that are equal in words."""
    text = (
        "unknowns: {cost: {guess: 1}, horizon: {guess: 2}}\nconstraints: [{expression: u_x - cost, range: [0, null]}]\n"
    )
    cost = (
        "{inputs: 1, running: [{expression: q_x}], terminal: [{expression: q_x}, {expression: cost**2 + horizon**2}]}"
    )
    found = find(read(PUSH + text + f"cost: {cost}\n"))
    lines = summarise(found)
    assert lines["cost"] == f"{found.cost.total:.10g}"
    assert lines["horizon"] == f"{found.trajectory.t[-1]:.10g} s"
    assert float(lines["unknown cost"]) == pytest.approx(found.trajectory.unknowns[0], abs=1e-9)
    running, terminal = (float(lines[name]) for name in ("  q_x ", "  q_x (2) "))
    assert terminal == pytest.approx(1.0)
    assert running < 0.9
    assert write_line("unknown horizon", lines["unknown horizon"], 14).split()[1] == "horizon"
    shown = sum(float(text) for name, text in lines.items() if name.startswith("  ") and "processor" not in name)
    assert shown == pytest.approx(found.cost.total)


def test_one_side_alone_is_the_largest(read: Callable[[str], Problem]) -> None:
    """With constant inputs over 20 intervals, the fastest of them moves at 1/0.95 m/s: it starts and ends at rest."""
    found = find(
        read(PUSH.replace("intervals: 4", "intervals: 20") + "cost: {inputs: 1.0e-6, largest: [{expression: qd_x}]}\n")
    )
    assert found.trajectory.unknowns == pytest.approx([1 / 0.95], rel=1e-5)


def test_all_keys_together_have_one_optimum_by_both_methods(requires: Callable[[str], str]) -> None:
    """IPOPT and the project's method in stages: the pole swung up under a delay, rates, a slack and a peak."""
    requires("cc")
    swing = mbsrun.problem(
        MODELS / "cart_pole.yaml",
        horizon=2,
        intervals=25,
        degree=3,
        inputs={"delay": 0.08, "history": 1},
        end={"pose": {"cart": 1, "pole": "pi"}, "velocity": "zero"},
        bounds={"input_rates": [-80, 80]},
        constraints=[{"expression": "qd_cart", "range": [-1, 1.5], "soft": {"linear": 1, "quadratic": 3}}],
        cost={"inputs": 1, "largest": [{"expression": "u_cart", "absolute": True, "weight": 0.5}]},
    )
    costs = []
    for method in ("ipopt", "mbs"):
        found = swing.with_solver(method).solve(check=False)
        assert isinstance(found, Solved)
        u = found.trajectory.u[:, 0]
        assert u[0] == 1
        assert np.abs(np.diff(u)).max() == pytest.approx(80 * 0.08, rel=1e-5)
        assert found.unknowns["largest_0"] == pytest.approx(np.abs(u).max(), abs=1e-5)
        costs.append(found.cost)
    assert costs[0] == pytest.approx(costs[1], rel=1e-6)
    with pytest.raises(ProblemError, match="unknown name"):
        swing.with_constraint("rate_u_cart", 0, 1)
    soft = swing.with_constraint("q_cart", upper=0.5, soft={"quadratic": 2, "name": "far"})
    assert [control.name for control in soft.value.controls] == ["slack_0", "far"]
    with pytest.raises(ProblemError, match="a soft expression of CasADi; write the constraint as a text"):
        swing.with_constraint(swing.quantities().q_cart, upper=0.5, soft=1)


# --- faults --------------------------------------------------------------------------------------------------------

COST = "cost: {inputs: 1}\n"
SOFT = "constraints:\n  - {expression: qd_x, range: [null, 1], soft: %s}\n" + COST
BAD = [
    (SOFT % "0", "10: constraints[0].soft: the violation has no price; give linear, quadratic"),
    (SOFT % "-2", "10: constraints[0].soft: found -2; give a number that is not negative"),
    (SOFT % "{linear: 1, cubic: 2}", "10: constraints[0].soft.cubic: "),
    (SOFT % "{linear: 1, name: q_x}", "10: constraints[0].soft.name: no name for a slack: q_x"),
    ((SOFT % "1").replace("[null, 1]", "[null, null]"), "10: constraints[0].range: no bounds, so nothing is soft"),
    ((SOFT % "1").replace("qd_x", "qd_y"), "10: constraints[0].expression: unknown name qd_y; did you mean"),
    (SOFT % "1" + "form: integral\n", "10: constraints[0].soft: the integral form takes no slacks along the path"),
    (SOFT % "1" + "controls: {slack_0: {}}\nstates: {slack_0: {rate: 0, start: 0}}\n", "no name for a control"),
    ("cost: {largest: [{expression: u_y}]}\n", "9: cost.largest[0].expression: unknown name u_y; did you mean"),
    ("cost: {largest: [{expression: u_x, weight: 0}]}\n", "9: cost.largest[0].weight: found 0; give a positive number"),
    ("cost: {largest: [{expression: u_x, name: 2x}]}\n", "9: cost.largest[0].name: no name for a largest value: 2x"),
    ("cost: {largest: [{expression: u_x, at: end}]}\n", "9: cost.largest[0].at: "),
    (COST + "bounds: {input_rates: {y: [0, 1]}}\n", "10: bounds.input_rates.y: the model has no actuated coordinate y"),
    (COST + "bounds: {input_rates: [2, 1]}\n", "10: bounds.input_rates: 2 is above 1; give [lower, upper]"),
    (
        COST + "forces: {x: 3*t}\nbounds: {input_rates: {x: [0, 1]}}\n",
        "11: bounds.input_rates.x: forces gives the input x",
    ),
    (COST + "controls: {push: {rate: {}}}\n", "10: controls.push.rate: no bounds and no weight; give a range"),
    (COST + "controls: {push: {rate: {weight: -1}}}\n", "10: controls.push.rate.weight: found -1; give a number"),
    (COST + "controls: {push: {rate: {range: [1, 0]}}}\n", "10: controls.push.rate.range: 1 is above 0"),
    (COST + "inputs: quadratic\n", "10: inputs: "),
    (COST + "inputs: linear\nform: shooting\n", "10: inputs: the shooting form takes no inputs that change within"),
    (
        COST + "inputs: linear\nstates: {input_x: {rate: 1, start: 0}}\n",
        "10: inputs: no name for the continuous input: input_x",
    ),
    (
        COST + "inputs: linear\ncontrols: {a: {}, rate_a: {}, rate_of_a: {}}\n",
        "no name for the rate of a control: rate_of_a",
    ),
    (COST + "inputs: {delay: 0.3}\n", "10: inputs: a delay of 0.3 s ends within an interval, from 0.25 to 0.5 s"),
    (COST + "inputs: {delay: 1}\n", "10: inputs: a delay of 1 s, and the horizon is 1 s; give a positive delay"),
    (COST + "inputs: {delay: 0}\n", "10: inputs.delay: found 0; give a positive number"),
    (COST + "inputs: {delay: {y: 0.25}}\n", "10: inputs.delay.y: the model has no actuated coordinate y"),
    (COST + "inputs: {history: 1}\n", "10: inputs.history: a history without a delay; give delay"),
    (COST + "inputs: {delay: {x: 0.25}, history: {y: 1}}\n", "10: inputs.history.y: y has no delay; give it one"),
    (COST + "inputs: {delay: 0.25, history: 5}\nbounds: {inputs: [-2, 2]}\n", "the history 5 is out of [-2, 2]"),
    (COST + "inputs: {delay: 0.25, history: before}\n", "10: inputs.history: "),
    (
        COST + "inputs: {delay: {x: 0.25}}\nforces: {x: t}\n",
        "10: inputs.delay.x: forces gives the input x; delay the controls",
    ),
    (COST + "controls: {push: {history: 1}}\n", "10: controls.push.history: a history without a delay"),
    (COST + "controls: {push: {delay: -1}}\n", "10: controls.push.delay: found -1; give a positive number"),
    (
        COST + "inputs: {delay: 0.25}\nhorizon: {guess: 1, range: [1, 2]}\n",
        "the horizon is free, so the mesh points move",
    ),
]


@pytest.mark.parametrize(("text", "expected"), BAD, ids=[str(i) for i in range(len(BAD))])
def test_faults_name_their_line_and_a_remedy(read: Callable[[str], Problem], text: str, expected: str) -> None:
    head = PUSH.replace("horizon: 1\n", "") if "horizon:" in text else PUSH
    with pytest.raises(InputError) as caught:
        read(head.replace("model:", "# a mass\nmodel:") + text)
    assert expected in str(caught.value).replace('"', "")
