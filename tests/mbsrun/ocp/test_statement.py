"""Problem files: what they mean, and every fault of a bad one at its place."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from mbsgen.errors import Fault, InputError
from mbsgen.manifest import Argument, Wrench
from mbsgen.roles import Role
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.problem.problem import Constraint, Cost, Form, Problem, Representation, Term
from mbsrun.ocp.statement.statement import read_problem
from tests.mbsrun.peer import Peer

GOOD = """\
model: arm.yaml
constants: {a: acos(0.55/0.6), b: 2*a}
horizon: 4/2
intervals: 10
scheme: legendre
degree: 3
cost:
  inputs: 1
  input_rates: 1e5
start:
  pose: {q2: a, q3: -b, q4: a}
  velocity: [0.1, 0, 0, 0, 0, 0]
bounds:
  coordinates: {q1: [-pi, null]}
  velocities: [-10, 10]
  inputs: {q4: [-3, 4]}
end:
  sensors:
    hand: {radius: 0.63, azimuth: pi/2, height: -0.1}
    pendulum: {x: 1, y: 2, z: 3}
  pose: {q1: pi/2}
  velocity: zero
guess:
  upright: [hand]
  motion: line
  end: {q2: 0.2}
accuracy: 1e-4
solver: {tolerance: 1e-6, max_iterations: 50, objective_scaling: 1e-5}
"""


def read(tmp_path: Path, text: str, arm: Peer) -> Problem:
    path = tmp_path / "task.ocp.yaml"
    path.write_text(text, "utf-8")
    return read_problem(path, lambda _: arm)[0]


def test_the_papers_problem(reach: Problem) -> None:
    """Equations (22)-(27), with alpha such that the hand is at 0.65 m."""
    alpha = math.acos(0.55 / 0.6)
    assert reach.name == "arm_reach"
    assert (reach.horizon, reach.intervals, reach.family, reach.degree) == (2.0, 100, Family.RADAU, 4)
    assert (reach.cost.inputs, reach.cost.input_rates) == (1.0, 1e5)
    assert reach.start_q == pytest.approx((0, alpha, -2 * alpha, alpha, 0, 0))
    assert reach.start_qd == (0.0,) * 6
    (name, target), *others = reach.end.sensors
    assert name == "hand"
    assert not others
    assert target == pytest.approx((0.0, 0.63, -0.1), abs=1e-15)
    assert reach.end.velocity_zero
    assert reach.end.acceleration_zero
    assert reach.bounds.q[0] == (-math.inf, math.inf)
    assert reach.bounds.q[2] == pytest.approx((-5 * math.pi / 12, 0))
    assert set(reach.bounds.qd + reach.bounds.u) == {(-math.inf, math.inf)}


def test_everything_that_a_file_can_say(tmp_path: Path, arm: Peer) -> None:
    problem = read(tmp_path, GOOD, arm)
    a = math.acos(0.55 / 0.6)
    assert problem.start_q == pytest.approx((0, a, -2 * a, a, 0, 0))
    assert problem.start_qd == (0.1, 0, 0, 0, 0, 0)
    assert problem.bounds.q[0] == (-math.pi, math.inf)
    assert problem.bounds.q[1] == pytest.approx((-math.pi / 2, math.pi / 2))  # the model's
    assert problem.bounds.qd == ((-10.0, 10.0),) * 6
    assert problem.bounds.u == (*((-math.inf, math.inf),) * 3, (-3.0, 4.0))
    assert dict(problem.end.sensors)["pendulum"] == (1.0, 2.0, 3.0)
    assert problem.end.coordinates == ((0, math.pi / 2),)
    assert problem.end.velocity_zero
    assert not problem.end.acceleration_zero
    assert problem.guess.upright == ("hand",)
    assert problem.guess.motion == "line"
    assert problem.guess.end == ((1, 0.2),)
    assert problem.accuracy == 1e-4
    assert (problem.solver.tolerance, problem.solver.max_iterations) == (1e-6, 50)
    assert problem.solver.objective_scaling == 1e-5


RICH = """\
model: arm.yaml
constants: {a: 0.3, b: 2*a, unread: 1}
horizon: {guess: 1 + b, range: [a, null]}
intervals: 10
scheme: radau
degree: 3
representation: EXP2-O
cost:
  running: [{expression: (q_q2 - a)**2, weight: 2*b}]
  terminal: [{expression: T}, {expression: z_hand, weight: -1}]
start:
  pose: {q1: null, q2: a}
  velocity: [0, 0, null, 0, 0, 0]
end:
  velocity: {q1: a, q5: 0}
  acceleration: {q6: -1}
  sensor_velocities:
    hand: {x: 1}
guess:
  start: {q1: a}
constraints:
  - {expression: vx_hand*t - qdd_q6 - b, range: [null, 1]}
  - {expression: u_q1, range: [0, 0], at: start}
"""


def test_what_the_model_bounds_holds_unless_the_file_says_otherwise(tmp_path: Path, arm: Peer) -> None:
    """Speeds and forces either way; a file's own bounds, also none, take their place."""
    first, second, *rest = arm.manifest.coordinates
    bounded = (first.model_copy(update={"max_speed": 3.0, "max_force": 40.0}), second, *rest)
    plant = Peer.__new__(Peer)
    plant.manifest = arm.manifest.model_copy(update={"coordinates": bounded})
    own = GOOD.replace("velocities: [-10, 10]", "velocities: {q2: [null, 1]}")
    bounds = read(tmp_path, own, plant).bounds
    assert bounds.qd[:3] == ((-3.0, 3.0), (-math.inf, 1.0), (-math.inf, math.inf))
    assert bounds.u[:2] == ((-40.0, 40.0), (-math.inf, math.inf))
    assert read(tmp_path, GOOD, plant).bounds.qd == ((-10.0, 10.0),) * 6


def test_free_horizons_expressions_and_constraints(tmp_path: Path, arm: Peer) -> None:
    """The costs are the given ones: inputs are free where there is another cost."""
    problem = read(tmp_path, RICH, arm)
    assert problem.horizon == 1.6
    assert problem.horizon_range == (0.3, math.inf)
    assert problem.representation is Representation.EXP2_O
    assert problem.cost == Cost(0.0, 0.0, (Term("(q_q2 - a)**2", 1.2),), (Term("T", 1.0), Term("z_hand", -1.0)))
    assert problem.start_q == (0, 0.3, 0, 0, 0, 0)
    assert problem.free_start == (0, 8)
    assert problem.guess.start == ((0, 0.3),)
    assert problem.end.velocities == ((0, 0.3), (4, 0.0))
    assert problem.end.accelerations == ((5, -1.0),)
    assert not problem.end.velocity_zero
    assert problem.end.sensor_velocities == (("hand", (1.0, 0.0, 0.0)),)
    assert problem.constraints == (
        Constraint("vx_hand*t - qdd_q6 - b", (-math.inf, 1.0)),
        Constraint("u_q1", (0.0, 0.0), "start"),
    )
    assert problem.constants == (("a", 0.3), ("b", 0.6))


BAD_RICH = {  # what is changed in the rich file: path, finding, remedy
    "quantity": ("(q_q2 - a)", "(q_q7 - a)", "cost.running[0].expression", 'unknown name "q_q7"', "did you mean"),
    "input of a passive joint": ("u_q1,", "u_q6,", "constraints[1].expression", '"u_q6"', "did you mean"),
    "code": ("vx_hand*t", "vx_hand.T", "constraints[0].expression", '"."', "use numbers"),
    "list": ("expression: T}", "expression: [T]}", "cost.terminal[0].expression", "found", "give a number"),
    "constant that is a quantity": ("unread: 1", "T: 1", "constants.T", "no name for a constant", "give a name"),
    "negative horizon": ("[a, null]", "[-1, null]", "horizon.range", "the least is -1", "positive"),
    "no least horizon": ("[a, null]", "[null, 3]", "horizon.range", "the least is -inf", "positive"),
    "crossed range": ("[a, null]", "[3, 1]", "horizon.range", "3 is above 1", "[lower, upper]"),
    "guess out of range": ("[a, null]", "[a, 1]", "horizon.guess", "1.6 is out of [0.3, 1]", "within the range"),
    "place": ("at: start", "at: middle", "constraints[1].at", '"middle"', "'start'"),
    "range": ("[null, 1]", "[2, 1]", "constraints[0].range", "2 is above 1", "[lower, upper]"),
    "end velocity": ("{q1: a,", "{q9: a,", "end.velocity.q9", 'no coordinate "q9"', "q5, q6"),
    "velocity of no sensor": ("    hand:", "    foot:", "end.sensor_velocities.foot", "no sensor", "hand, pendulum"),
    "weight": ("2*b", "2*c", "cost.running[0].weight", 'unknown name "c"', "a, b"),
    "second order and a free horizon": (
        "EXP2-O",
        "EXP2-A\nform: integral\nintegrator: second-order",
        "integrator",
        "does not go with a horizon that is free",
        "give the horizon, or take form: standard",
    ),
    "too many terms": (
        "{expression: T}",
        ", ".join(["{expression: T}"] * 101),
        "cost.terminal",
        "102",
        "100",
    ),
    "representation": ("EXP2-O", "EXP2", "representation", '"EXP2"', "'EXP2-A'"),
}


@pytest.mark.parametrize(("old", "new", "path", "finding", "remedy"), BAD_RICH.values(), ids=BAD_RICH.keys())
def test_a_bad_rich_file_is_refused_at_the_place(
    tmp_path: Path, arm: Peer, old: str, new: str, path: str, finding: str, remedy: str
) -> None:
    assert RICH.count(old) == 1
    with pytest.raises(InputError) as refusal:
        read(tmp_path, RICH.replace(old, new), arm)
    (fault,) = refusal.value.faults
    assert fault.path == path
    assert finding in fault.finding
    assert remedy in fault.remedy
    assert 0 <= fault.line - (RICH[: RICH.index(old)].count("\n") + 1) <= new.count("\n")


def test_problems_have_a_grid_of_their_own(tmp_path: Path, arm: Peer) -> None:
    problem = read(tmp_path, "model: arm.yaml\nhorizon: 1\ncost: {}\nstart: {pose: {}}\n", arm)
    assert (problem.intervals, problem.family, problem.degree) == (50, Family.RADAU, 4)


def test_shooting_is_asked_for(tmp_path: Path, arm: Peer) -> None:
    """A contradiction is reported at the key that causes it; here two faults."""
    text = (Path(__file__).parents[3] / "models" / "arm_reach.ocp.yaml").read_text("utf-8")
    asked = text.replace("degree: 4", "degree: 4\nform: shooting\nintegrator: rk4\nsteps: 3\nrepresentation: EXP1-O")
    problem = read(tmp_path, asked, arm)
    assert (problem.form, problem.integrator, problem.steps) == (Form.SHOOTING, "rk4", 3)
    bad = asked.replace("EXP1-O", "IMPL")
    with pytest.raises(InputError) as refusal:
        read(tmp_path, bad.replace("steps: 3", "steps: 0"), arm)
    assert sorted(fault.path for fault in refusal.value.faults) == ["integrator", "steps"]


def test_second_order_is_refused_where_it_has_no_meaning(tmp_path: Path, arm: Peer) -> None:
    """In the integral form of an ODE, and where the horizon is free: two faults of one key."""
    with pytest.raises(InputError) as refusal:
        read(tmp_path, RICH.replace("degree: 3", "degree: 3\nform: integral\nintegrator: second-order"), arm)
    free, ode = refusal.value.faults
    assert ode.path == free.path == "integrator"
    assert "accelerations that are no variables, as in EXP2-O" in ode.finding
    assert "a horizon that is free" in free.finding


def test_the_model_is_looked_for_beside_the_file(tmp_path: Path, arm: Peer) -> None:
    asked: list[Path] = []

    def load(path: Path) -> Peer:
        asked.append(path)
        return arm

    path = tmp_path / "task.ocp.yaml"
    path.write_text(GOOD.replace("arm.yaml", "robots/arm.yaml"), "utf-8")
    read_problem(path, load)
    assert asked == [tmp_path / "robots" / "arm.yaml"]


BAD = {  # what is changed in the good file: path, finding, remedy
    "unknown key": ("accuracy: 1e-4", "acuracy: 1e-4", "acuracy", "unknown key", "did you mean `accuracy`?"),
    "missing key": ("horizon: 4/2\n", "", "horizon", "missing", "give it"),
    "a range of horizons": ("horizon: 4/2", "horizon: [1, 2]", "horizon", "found [1, 2]", "a mapping of guess, range"),
    "no model file": ("arm.yaml", "arm", "model", '"arm"', "give a model file"),
    "folder of C": ("arm.yaml", "../generated/arm", "model", "../generated/arm", "give a model file"),
    "code": ("4/2", '__import__("os")', "horizon", "has no meaning", "use numbers"),
    "code by attribute": ("4/2", "a.real", "horizon", '"."', "use numbers"),
    "unknown name": ("4/2", "4/c", "horizon", 'unknown name "c"', "a, b"),
    "constant before its definition": (
        "{a: acos(0.55/0.6), b: 2*a}",
        "{b: 2*a, a: 1}",
        "constants.b",
        '"a"',
        "no names",
    ),
    "constant called pi": ("{a: ", "{pi: 3, a: ", "constants.pi", "no name for a constant", "give a name"),
    "undefined function value": ("acos(0.55/0.6)", "acos(2)", "constants.a", "acos(2) has no value", "defined"),
    "negative horizon": ("4/2", "-2", "horizon", "found -2", "positive"),
    "zero horizon": ("4/2", "0", "horizon", "found 0", "positive"),
    "infinite horizon": ("4/2", ".inf", "horizon", "inf", "finite"),
    "boolean": ("4/2", "true", "horizon", "true", "number"),
    "no intervals": ("intervals: 10", "intervals: 0", "intervals", "found 0", "1"),
    "too many intervals": ("intervals: 10", "intervals: 1000000", "intervals", "found 1000000", "10000"),
    "half an interval": ("intervals: 10", "intervals: 1.5", "intervals", "found 1.5", "whole number"),
    "an accuracy below rounding": (
        "intervals: 10",
        "intervals: 10\nrefine: {accuracy: 1e-15}",
        "refine.accuracy",
        "1e-15",
        "1e-12",
    ),
    "no rounds": ("intervals: 10", "intervals: 10\nrefine: {rounds: 0}", "refine.rounds", "found 0", "1"),
    "a refinement that is a number": (
        "intervals: 10",
        "intervals: 10\nrefine: 1e-6",
        "refine",
        "found 1e-06",
        "mapping",
    ),
    "no lengths": ("intervals: 10", "intervals: []", "intervals", "found 0 lengths", "give from 1 to 10000"),
    "an interval of no length": ("intervals: 10", "intervals: [1, 0, 2]", "intervals[1]", "found 0", "positive"),
    "a length that is none": (
        "intervals: 10",
        "intervals: [1, long]",
        "intervals[1]",
        'unknown name "long"',
        "known here are",
    ),
    "a length that vanishes": ("intervals: 10", "intervals: [1, 1e-9]", "intervals[1]", "1e-09 is 1.0e-09", "1e-06"),
    "unequal intervals of shooting": (
        "intervals: 10",
        "integrator: second-order\nintervals: [1, 2]\nform: shooting",
        "integrator",
        "second-order collocation in the shooting form does not go with intervals of unequal length",
        "give their number, or take form: standard",
    ),
    "unknown scheme": ("legendre", "gauss", "scheme", '"gauss"', "'radau', 'legendre' or 'lobatto'"),
    "degree": ("degree: 3", "degree: 10", "degree", "found 10", "9"),
    "representation": ("degree: 3", "degree: 3\nrepresentation: EXP3", "representation", '"EXP3"', "'IMPL'"),
    "negative weight": ("inputs: 1\n", "inputs: -1\n", "cost.inputs", "found -1", "not negative"),
    "no cost": ("inputs: 1\n  input_rates: 1e5", "inputs: 0", "cost", "every weight is 0", "positive weight"),
    "short pose": ("{q2: a, q3: -b, q4: a}", "[0, a]", "start.pose", "found 2 numbers", "give 6"),
    "unknown coordinate": ("{q2: a,", "{q7: a,", "start.pose.q7", 'no coordinate "q7"', "q5, q6"),
    "start out of bounds": ("{q2: a,", "{q2: 3,", "start.pose.q2", "q2 = 3 is out of", "within the bounds"),
    "fast start": ("[0.1, 0,", "[11, 0,", "start.velocity[0]", "q1 = 11 is out of", "within the bounds"),
    "bounds reversed": ("[-10, 10]", "[10, -10]", "bounds.velocities", "10 is above -10", "[lower, upper]"),
    "one bound": ("[-3, 4]", "[-3]", "bounds.inputs.q4", "", "give"),
    "passive input": ("inputs: {q4:", "inputs: {q5:", "bounds.inputs.q5", 'no actuated coordinate "q5"', "q3, q4"),
    "unknown sensor": ("    hand:", "    foot:", "end.sensors.foot", 'no sensor "foot"', "hand, pendulum"),
    "body that is no sensor": ("    hand:", "    forearm:", "end.sensors.forearm", "no sensor", "hand"),
    "mixed position": (
        "{x: 1, y: 2, z: 3}",
        "{x: 1, radius: 2, z: 3}",
        "end.sensors.pendulum",
        "x, z, radius",
        "x, y, z",
    ),
    "end out of bounds": ("{q1: pi/2}", "{q2: 3}", "end.pose.q2", "3 is out of", "within the bounds"),
    "end velocity": ("velocity: zero", "velocity: 1", "end.velocity", "found 1", "'zero'"),
    "unknown frame": ("[hand]", "[hnad]", "guess.upright[0]", 'no frame "hnad"', 'did you mean "hand"?'),
    "guess of a given start": (
        "end: {q2: 0.2}",
        "start: {q1: 0.2}",
        "guess.start.q1",
        "has a value at the start",
        "null",
    ),
    "unknown coordinate of a guess": ("{q2: 0.2}", "{q7: 0.2}", "guess.end.q7", 'no coordinate "q7"', "there are"),
    "guess out of bounds": ("{q2: 0.2}", "{q2: 9}", "guess.end.q2", "9 is out of", "within the bounds"),
    "accuracy": ("accuracy: 1e-4", "accuracy: 0", "accuracy", "found 0", "positive"),
    "tolerance": ("tolerance: 1e-6", "tolerance: 1e-20", "solver.tolerance", "found 1e-20", "1e-14"),
    "no iterations": ("max_iterations: 50", "max_iterations: 0", "solver.max_iterations", "found 0", "1"),
    "anchor": ("horizon: 4/2", "horizon: &h 2", "horizon", "anchor", "remove it"),
    "tag": ("horizon: 4/2", "horizon: !!python/name:os.system 2", "horizon", "tag", "remove it"),
    "repeated key": ("horizon: 4/2", "horizon: 2\nhorizon: 3", "horizon", "key repeated", "keep one"),
}


@pytest.mark.parametrize(("old", "new", "path", "finding", "remedy"), BAD.values(), ids=BAD.keys())
def test_a_bad_file_is_refused_at_the_place(
    tmp_path: Path, arm: Peer, old: str, new: str, path: str, finding: str, remedy: str
) -> None:
    """One fault is put into the good file; it is reported with its line, and nothing that merely follows from it."""
    assert GOOD.count(old) == 1
    with pytest.raises(InputError) as refusal:
        read(tmp_path, GOOD.replace(old, new), arm)
    (fault,) = refusal.value.faults
    assert fault.path == path
    assert finding in fault.finding
    assert remedy in fault.remedy
    assert fault.file == str(tmp_path / "task.ocp.yaml")
    assert 1 <= fault.line <= GOOD[: GOOD.index(old)].count("\n") + 2


def test_all_faults_come_together(tmp_path: Path, arm: Peer) -> None:
    """Faults of shape, of numbers and of names, each with its own line."""
    text = GOOD.replace("4/2", "-1").replace("legendre", "gauss").replace("    hand:", "    foot:")
    with pytest.raises(InputError) as refusal:
        read(tmp_path, text, arm)
    assert [(fault.line, fault.path) for fault in refusal.value.faults] == [
        (3, "horizon"),
        (5, "scheme"),
        (19, "end.sensors.foot"),
    ]


def test_faults_of_the_model_come_along(tmp_path: Path) -> None:
    """A model that cannot be loaded is reported beside the faults of the problem."""

    def load(path: Path) -> Peer:
        raise InputError([Fault(str(path), 7, "bodies[0].mass", "found -1", "give a positive mass")])

    path = tmp_path / "task.ocp.yaml"
    path.write_text(GOOD.replace("legendre", "gauss"), "utf-8")
    with pytest.raises(InputError) as refusal:
        read_problem(path, load)
    assert [fault.path for fault in refusal.value.faults] == ["bodies[0].mass", "scheme"]


def test_a_model_without_inputs_is_refused(tmp_path: Path, arm: Peer) -> None:
    passive = Peer.__new__(Peer)
    coordinates = tuple(c.model_copy(update={"actuated": False}) for c in arm.manifest.coordinates)
    passive.manifest = arm.manifest.model_copy(update={"coordinates": coordinates})
    with pytest.raises(InputError, match="no actuated coordinate"):
        read(tmp_path, GOOD.replace("inputs: {q4: [-3, 4]}", "inputs: {}"), passive)


def test_a_model_with_open_wrenches_is_refused(tmp_path: Path, arm: Peer) -> None:
    """Every component needs a value."""
    pushed = Peer.__new__(Peer)
    kernels = [
        k.model_copy(update={"inputs": (*k.inputs, Argument(name="w", role=Role.WRENCH, rows=3, cols=1))})
        for k in arm.manifest.kernels
    ]
    wrench = Wrench(name="push", frame=0, in_base=True, force=True, moment=False)
    pushed.manifest = arm.manifest.model_copy(update={"kernels": tuple(kernels), "wrenches": (wrench,)})
    with pytest.raises(InputError, match="the model leaves wrenches open, and fx_push, fy_push, fz_push have no value"):
        read(tmp_path, GOOD, pushed)


def test_a_missing_file_is_told(arm: Peer) -> None:
    with pytest.raises(InputError, match="there is no such file"):
        read_problem(Path("nowhere.ocp.yaml"), lambda _: arm)
