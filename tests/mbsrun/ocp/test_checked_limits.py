"""Problems made in Python: the last values that are taken, and the first that are refused, of every number.

Each value stands beside its limit, and each refusal names the part and the finding alone.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mbsgen.roles import Role
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.problem.problem import (
    Bounds,
    Constraint,
    Control,
    Cost,
    Delay,
    Drive,
    End,
    Force,
    Form,
    GuessOptions,
    Loops,
    Problem,
    Refinement,
    Representation,
    SolverOptions,
    State,
    Symbolic,
    Term,
    Unknown,
    WrenchComponent,
)
from mbsrun.ocp.statement import checks
from mbsrun.ocp.statement.checks import (
    ProblemError,
    check_problem,
    find_loop_conflicts,
    find_open_references,
    list_open_inputs,
)
from mbsrun.recordings.references import Reference
from mbsrun.recordings.splines import Treatment, fit
from tests.mbsrun.ocp.closed_plants import pendulum_of_rods
from tests.mbsrun.ocp.plants import FREE_RANGE, push
from tests.mbsrun.peer import double_integrator

INF, NAN = math.inf, math.nan
FREE = (FREE_RANGE,)
MANIFEST = double_integrator().manifest
PASSIVE = tuple(c.model_copy(update={"actuated": False}) for c in MANIFEST.coordinates)
NONE = MANIFEST.model_copy(update={"coordinates": PASSIVE})
UNIT = ((-1.0, 1.0),)
CONTROL = Control("c", (-1.0, 1.0))
SHOOTING: dict[str, Any] = {"form": Form.SHOOTING, "representation": Representation.EXP2_O}
MBS = SolverOptions(method="mbs")


def find(changes: dict[str, Any], manifest: Any = MANIFEST, *, is_phase: bool = False) -> tuple[tuple[str, str], ...]:
    """Return the faults of a push with changes: the part, and the finding."""
    try:
        check_problem(replace(push(4), **changes), manifest, is_phase=is_phase)
    except ProblemError as error:
        return tuple((place, finding) for place, finding, _ in error.findings)
    return ()


def delay(seconds: float, **given: Any) -> dict[str, Any]:
    return {"delays": (Delay("input", 0, seconds, **given),), "bounds": Bounds(FREE, FREE, UNIT)}


GOOD: list[dict[str, Any]] = [
    {"intervals": 1},
    {"intervals": 10_000},
    {"degree": 1},
    {"degree": 9},
    {"degree": 2, "family": Family.LOBATTO},
    {**SHOOTING, "steps": 100, "integrator": "rk4"},
    {"solver": SolverOptions(max_iterations=1)},
    {"solver": SolverOptions(tolerance=1e-14)},
    {"solver": SolverOptions(objective_scaling=1e-300)},
    {"solver": replace(MBS, threads=64)},
    {"horizon": 5e-324},
    {"accuracy": 5e-324},
    {"mesh": (1e-6, 0.5, 0.25, 0.25 - 1e-6)},
    {"mesh": (0.25, 0.25, 0.25, 0.25 + 0.9e-9)},
    {"mesh": (1.0,), "intervals": 1},
    {"refine": Refinement(1e-12)},
    {"horizon_range": (1.0, 1.0)},
    {"horizon_range": (5e-324, INF)},
    {"cost": Cost(0.0, 1.0)},
    {"cost": Cost(terminal=(Term("q_slide", -1.0),))},
    {"free_start": (0, 1)},
    {"bounds": Bounds(FREE, FREE, FREE, UNIT), "first_inputs": UNIT},
    {"controls": (CONTROL,), "first_controls": UNIT},
    {"end": End(coordinates=((0, 0.0),), velocities=((0, 0.0),), accelerations=((0, 0.0),))},
    {"end": End(sensors=(("place", (1.0, None, None)),), sensor_velocities=(("place", (None, 0.0, None)),))},
    {"guess": GuessOptions(upright=("cart", "place"))},
    {"unknowns": (Unknown("p", (1.0, 2.0), 1.0), Unknown("r", (1.0, 2.0), 2.0))},
    {"controls": (CONTROL,), "cost": Cost(1.0, control_rates=(("c", 0.0),))},
    {"forces": (Force(0, "-q_slide"),), "controls": (CONTROL,), "bounds": Bounds(FREE, FREE, FREE, FREE)},
    delay(0.25, history=1.0),
    delay(0.25, history=-1.0),
    delay(0.75, history=None),
    {"controls": (CONTROL,), "delays": (Delay("control", 0, 0.25, 1.0),)},
    {"states": (State("s", "c", (0.0, 1.0), (1.0, 2.0), (-1.0, 0.0), (0.0, 1.0)),), "controls": (CONTROL,)},
]


@pytest.mark.parametrize("changes", GOOD)
def test_the_last_values_are_taken(changes: dict[str, Any]) -> None:
    assert find(changes) == ()


BAD: list[tuple[dict[str, Any], str, str]] = [
    ({"intervals": 10_001}, "intervals", "found 10001"),
    ({"degree": 0}, "degree", "found 0"),
    ({"degree": 1, "family": Family.LOBATTO}, "degree", "lobatto has points at both ends of an interval"),
    ({"steps": 0}, "steps", "found 0"),
    ({"steps": 101}, "steps", "found 101"),
    ({"solver": SolverOptions(max_iterations=0)}, "solver.max_iterations", "found 0"),
    ({"solver": SolverOptions(tolerance=0.99e-14)}, "solver.tolerance", "found 9.9e-15"),
    ({"solver": SolverOptions(tolerance=INF)}, "solver.tolerance", "found inf"),
    ({"solver": SolverOptions(objective_scaling=0.0)}, "solver.objective_scaling", "found 0"),
    ({"solver": replace(MBS, threads=65)}, "solver.threads", "found 65"),
    ({"solver": replace(MBS, threads=0)}, "solver.threads", "found 0"),
    ({"solver": SolverOptions(method="ipopt", threads=2)}, "solver.threads", "found 2, but ipopt has one thread"),
    ({"horizon": 0.0}, "horizon", "found 0"),
    ({"horizon": INF}, "horizon", "found inf"),
    ({"mesh": (0.99e-6, 0.5, 0.25, 0.25)}, "mesh", "the fractions are from 9.9e-07 to 0.5"),
    ({"mesh": (1.01,), "intervals": 1}, "mesh", "the fractions are from 1.01 to 1.01"),
    ({"mesh": (0.25, 0.25, 0.25, 0.25 + 1.1e-9)}, "mesh", "the fractions sum to 1.0000000011"),
    ({"mesh": (0.25, 0.25, 0.25, 0.25 - 1.1e-9)}, "mesh", "the fractions sum to 0.9999999989"),
    ({"refine": Refinement(0.99e-12)}, "refine.accuracy", "found 9.9e-13"),
    ({"refine": Refinement(INF)}, "refine.accuracy", "found inf"),
    ({"refine": Refinement(1e-6, 101)}, "refine.rounds", "found 101"),
    ({"horizon_range": (0.0, 2.0)}, "horizon_range", "the least is 0"),
    ({"horizon_range": (1.01, 2.0)}, "horizon", "1 is out of [1.01, 2]"),
    ({"horizon_range": (0.5, 0.99)}, "horizon", "1 is out of [0.5, 0.99]"),
    ({"cost": Cost(0.0, 0.0)}, "cost", "every weight is 0"),
    ({"cost": Cost(1.0, -1.0)}, "cost", "the weights are (1.0, -1.0)"),
    ({"cost": Cost(1.0, terminal=(Term("q_slide", INF),))}, "cost", "the weights are (1.0, 0.0, inf)"),
    ({"start_q": (NAN,)}, "start_q", 'found "(nan,)"'),
    ({"start_qd": (0.0, 0.0)}, "start_qd", "found 2 entries"),
    ({"bounds": Bounds((), FREE, FREE)}, "bounds.q", "found 0 entries"),
    ({"bounds": Bounds(FREE, FREE * 2, FREE)}, "bounds.qd", "found 2 entries"),
    ({"bounds": Bounds(FREE, FREE, FREE, UNIT * 2)}, "bounds.rates", "found 2 entries"),
    ({"bounds": Bounds(FREE, FREE, FREE, (), UNIT)}, "bounds.tau", "found 1 entries"),
    ({"first_inputs": UNIT * 2}, "first_inputs", "found 2 entries"),
    ({"first_controls": UNIT}, "first_controls", "found 1 entries"),
    ({"free_start": (2,)}, "free_start", "found index 2"),
    ({"free_start": (-1,)}, "free_start", "found index -1"),
    ({"following": (2,)}, "following", "found index 2"),
    ({"end": End(velocities=((1, 0.0),))}, "end.velocities", "found index 1"),
    ({"end": End(accelerations=((1, 0.0),))}, "end.accelerations", "found index 1"),
    ({"end": End(coordinates=((0, NAN),))}, "end", "a value is not finite"),
    ({"end": End(sensors=(("place", (INF, None, None)),))}, "end", "a value is not finite"),
    ({"end": End(sensor_velocities=(("place", (None, NAN, None)),))}, "end", "a value is not finite"),
    ({"end": End(sensors=(("cart", (1.0, None, None)),))}, "end.sensors", 'the model has no sensor "cart"'),
    ({"unknowns": (Unknown("p", (1.0, 2.0), 0.99),)}, "unknowns", "the guess of p is 0.99"),
    ({"unknowns": (Unknown("p", (1.0, 2.0), 2.01),)}, "unknowns", "the guess of p is 2.01"),
    ({"cost": Cost(1.0, control_rates=(("c", 1.0),))}, "cost.control_rates", 'no control "c"'),
    (delay(0.25, history=1.01), "delays[0].history", "1.01 is out of [-1, 1]"),
    (delay(0.25, history=-1.01), "delays[0].history", "-1.01 is out of [-1, 1]"),
    ({"delays": (Delay("input", 1, 0.25),)}, "delays[0].index", "found input 1"),
    ({"delays": (Delay("input", -1, 0.25),)}, "delays[0].index", "found input -1"),
    ({"delays": (Delay("control", 0, 0.25),)}, "delays[0].index", "found control 0"),
    ({"forces": (Force(1, "0"),)}, "forces[0].input", "found index 1"),
    ({"forces": (Force(-1, "0"),)}, "forces[0].input", "found index -1"),
    ({"forces": (Force(0, "0"), Force(0, "1"))}, "forces[1].input", "input 0 is given twice"),
    ({"driven": (Drive(0, "t"),)}, "driven[0]", "the model does not drive it"),
    ({"states": (State("q_slide", "1"),)}, "states[0].name", 'found "q_slide"'),
    ({"states": (State("s", "1"), State("s", "2"))}, "states[1].name", 'found "s"'),
    ({"states": (State("s", "1", guess=INF),)}, "states[0].guess", "found inf"),
    ({"states": (State("s", "1", guess=(0.0, NAN)),)}, "states[0].guess", "found (0.0, nan)"),
    ({"states": (State("s", "1", (0.0, 1.0), (1.01, 2.0)),)}, "states[0].start", "[1.01, 2] leaves nothing within"),
    ({"states": (State("s", "1", (0.0, 1.0), end=(-1.0, -0.01)),)}, "states[0].end", "[-1, -0.01] leaves nothing"),
    ({"states": (State("s", "1", start=(1.0, 0.0)),)}, "states[0].start", "[1, 0] leaves nothing within"),
    ({"states": (State("s", "speed"),)}, "states[0].rate", 'unknown name "speed"'),
    ({"controls": (Control("q_slide"),)}, "controls[0].name", 'found "q_slide"'),
    ({"controls": (CONTROL, Control("c"))}, "controls[1].name", 'found "c"'),
    ({"controls": (Control("c", guess=NAN),)}, "controls[0].guess", "found nan"),
    ({"unknowns": (Unknown("u_slide", (0.0, 1.0)),)}, "unknowns[0].name", 'found "u_slide"'),
    ({"unknowns": (Unknown("a b", (0.0, 1.0)),)}, "unknowns[0].name", 'found "a b"'),
    (
        {"forces": (Force(0, "-qdd_slide"),), "controls": (CONTROL,), "bounds": Bounds(FREE, FREE, FREE, FREE)},
        "forces[0].expression",
        "the expression reads accelerations, which depend on it",
    ),
    (
        {"forces": (Force(0, "-u_slide"),), "controls": (CONTROL,), "bounds": Bounds(FREE, FREE, FREE, FREE)},
        "forces[0].expression",
        "expressions that read each other in a circle",
    ),
    ({"forces": (Force(0, "speed"),)}, "forces[0].expression", 'unknown name "speed"'),
    (
        {"solver": SolverOptions(method="ipopt", options=(("max_cpu_time", "x"),))},
        "solver.options.max_cpu_time",
        'found "x"',
    ),
    ({"controls": (CONTROL,), "form": Form.SHOOTING}, "form", "takes no states, controls and integrals"),
    ({"integrals": (), "forces": (Force(0, "1"),), "form": Form.SHOOTING}, "form", "takes no forces and wrenches"),
    (delay(0.3), "inputs", "a delay of 0.3 s ends within an interval, from 0.25 to 0.5 s"),
    (delay(1.0), "inputs", "a delay of 1 s, and the horizon is 1 s"),
    (delay(0.0), "inputs", "a delay of 0 s, and the horizon is 1 s"),
    ({**delay(0.25), "horizon_range": (0.5, 2.0)}, "inputs", "the horizon is free, so the mesh points move"),
]


@pytest.mark.parametrize(("changes", "place", "finding"), BAD)
def test_the_first_values_beyond_are_refused_at_their_place(changes: dict[str, Any], place: str, finding: str) -> None:
    ((found, words),) = find(changes)
    assert found == place
    assert finding in words


def test_every_part_of_a_wrench_is_checked() -> None:
    """Components are 0 to 2 of a force and 3 to 5 of a moment, of wrenches that the model leaves open."""
    part = WrenchComponent("push", 0, "0", (1.0, 0.0))
    assert find({"wrenches": (part,)}) == (
        ("wrenches[0]", 'the model has no open component 0 of "push"'),
        ("wrenches[0].bounds", "found [1, 0]"),
    )


def test_a_rate_of_an_input_that_an_expression_gives_is_refused() -> None:
    given = {"forces": (Force(0, "c"),), "controls": (CONTROL,)}
    for limits in ((-1.0, INF), (-INF, 1.0)):
        (found,) = find({**given, "bounds": Bounds(FREE, FREE, FREE, (limits,))})
        assert found == ("bounds.rates[0]", "input 0 is given by an expression, and has no rate")
    late = {**given, "delays": (Delay("input", 0, 0.25),)}
    assert find(late) == (("delays[0].index", "found input 0"),)


def test_prices_of_rates_are_not_negative() -> None:
    for weight in (-1.0, INF):
        cost = Cost(1.0, control_rates=(("c", weight),))
        assert ("cost.control_rates", f"the weight of c is {weight:g}") in find({"controls": (CONTROL,), "cost": cost})


def test_a_phase_alone_may_cost_and_control_nothing() -> None:
    """Of several phases, others may: each of the two faults goes, and no other one."""
    bounds = Bounds(FREE, FREE, ())
    free = {"cost": Cost(0.0), "bounds": bounds}
    assert [place for place, _ in find(free, NONE)] == ["cost", "model"]
    assert find(free, NONE, is_phase=True) == ()
    assert find({**free, "start_q": ()}, NONE, is_phase=True) == (("start_q", "found 0 entries"),)
    assert find({"bounds": bounds, "controls": (CONTROL,)}, NONE) == ()


def test_an_unknown_and_a_parameter_have_one_value() -> None:
    """A parameter that the model has not is refused, and a number that is chosen and given."""
    assert find({"parameters": (("m", 1.0),)}) == (
        ("parameters", 'double integrator has no parameter "m" that may be changed'),
    )
    both: dict[str, Any] = {"parameters": (("m", 1.0),), "unknowns": (Unknown("m"),)}
    assert ("unknowns", "m has a value in parameters, too") in find(both)


def test_loops_are_left_out_where_there_are_none() -> None:
    assert find({"loops": Loops.REDUCED}) == (("loops", "the model has no closed loops"),)


def test_functions_have_names_of_their_own_and_code() -> None:
    """They read what expressions read, and are called by IPOPT alone."""
    function = Symbolic("f", ("q_slide",), "q_slide**2", "code")
    assert find({"functions": (function,)}) == ()
    for wrong, place, finding in (
        (replace(function, name="q_slide"), "functions[0].name", 'found "q_slide"'),
        (replace(function, reads=("x",)), "functions[0].reads", 'unknown name "x"'),
        (replace(function, code=""), "functions[0].code", '"f" has no code, which files do not hold'),
    ):
        assert find({"functions": (wrong,)}) == ((place, finding),)
    assert [place for place, _ in find({"functions": (function, function)})] == [
        "functions[0].name",
        "functions[1].name",
    ]
    refused = find({"functions": (function,), "solver": MBS})
    assert refused == (("solver.method", "mbs writes a problem in C, and an expression of CasADi has no C here"),)


def test_what_is_no_problem_is_refused() -> None:
    wrong: Any = np.zeros(3)
    with pytest.raises(ProblemError, match=r'problem \?: problem: found "ndarray"; give a Problem'):
        check_problem(wrong, MANIFEST)
    references: Any = (1.0,)
    assert find({"references": references}) == (("references[0]", 'found "float"'),)
    assert isinstance(push(4), Problem)


def test_a_quaternion_is_free_or_given_as_a_whole() -> None:
    """At the start, and at the end: all four entries or none."""
    names = tuple(f"ball.q{axis}" for axis in "xyzw")
    joints = tuple(MANIFEST.coordinates[0].model_copy(update={"name": f"ball_{axis}"}) for axis in "xyz")
    ball = MANIFEST.model_copy(update={"configuration": names, "quaternions": (0,), "coordinates": joints})
    usual: dict[str, Any] = {
        "start_q": (0.0, 0.0, 0.0, 1.0), "start_qd": (0.0,) * 3, "bounds": Bounds(FREE * 4, FREE * 3, FREE * 3),
        "end": End(),
    }  # fmt: skip
    for count in range(5):
        entries = tuple(range(count))
        for key, changes in (
            ("free_start", {"free_start": entries}),
            ("end.coordinates", {"end": End(coordinates=tuple((i, 0.5) for i in entries))}),
        ):
            found = find({**usual, **changes}, ball)
            assert found == (((key, "a part of the quaternion of ball"),) if 0 < count < 4 else ())


def test_a_delay_of_an_input_without_bounds_is_no_second_fault() -> None:
    changes = {**delay(0.25, history=5.0), "bounds": Bounds(FREE, FREE, ())}
    assert find(changes) == (("bounds.u", "found 0 entries"),)


ROUND = replace(
    push(4), start_q=(0.6, -0.8), start_qd=(0.0, 0.0), bounds=Bounds(FREE * 2, FREE * 2, FREE), end=End()
)  # fmt: skip
SEMI, MULTIPLIERS, REDUCED = Representation.SEMI, Loops.MULTIPLIERS, Loops.REDUCED
CUSTOM: list[tuple[dict[str, Any], list[tuple[str, str]]]] = [  # changes: the places, and a word of each remedy
    ({}, []),
    ({"loops": MULTIPLIERS}, []),
    ({"loops": REDUCED}, []),
    ({"loops": MULTIPLIERS, "form": Form.INTEGRAL}, [("form", "take standard, or loops: reduced")]),
    ({"loops": REDUCED, "form": Form.INTEGRAL}, []),
    ({"form": Form.INTEGRAL}, []),
    ({"family": Family.LOBATTO}, [("scheme", "take scheme: radau")]),
    ({"family": Family.LOBATTO, "loops": MULTIPLIERS}, [("scheme", "take scheme: radau")]),
    ({"family": Family.LEGENDRE, "loops": MULTIPLIERS}, [("loops", "take scheme: radau, or loops: reduced")]),
    ({"family": Family.LEGENDRE, "loops": REDUCED}, []),
    ({"family": Family.LEGENDRE}, []),
    ({"integrator": "second-order", "loops": MULTIPLIERS}, [("loops", "take integrator: collocation")]),
    ({"integrator": "second-order", "loops": REDUCED}, []),
    ({"representation": SEMI}, []),
    ({"representation": SEMI, "loops": MULTIPLIERS}, []),
    ({"representation": SEMI, "loops": REDUCED}, [("loops", "or EXP1-O, or loops: multipliers")]),
    ({"representation": SEMI, "form": Form.INTEGRAL}, [("form", "or EXP1-O, or form: standard")]),
    (
        {"representation": SEMI, "form": Form.INTEGRAL, "loops": REDUCED},
        [("loops", "or loops: multipliers, in form: standard")],
    ),
    ({"loops": REDUCED, "end": End(accelerations=((0, 0.0),))}, []),
    ({"loops": REDUCED, "end": End(accelerations=((1, 0.0),))}, [("loops", "take loops: multipliers")]),
    ({"loops": MULTIPLIERS, "end": End(accelerations=((1, 0.0),))}, []),
    ({"loops": REDUCED, "constraints": (Constraint("qdd_y", (0, 1)),)}, [("loops", "take loops: multipliers")]),
    ({"loops": REDUCED, "constraints": (Constraint("qdd_x", (0, 1)),)}, []),
]


@pytest.mark.parametrize(("changes", "expected"), CUSTOM)
def test_closed_loops_take_some_forms_alone(changes: dict[str, Any], expected: list[tuple[str, str]]) -> None:
    """The reduced form computes the accelerations of independent coordinates, and multipliers need mesh points."""
    found = list(find_loop_conflicts(replace(ROUND, **changes), pendulum_of_rods().manifest))
    assert [str(conflict.place[0]) for conflict in found] == [place for place, _ in expected]
    for conflict, (_, words) in zip(found, expected, strict=True):
        assert words in conflict.remedy


TIMES = np.linspace(0.0, 1.0, 11)


def refer(*holes: int, **given: Any) -> Reference:
    """Make a recording of x and y over a second; y is unknown around some samples."""
    gapped = np.where(np.isin(np.arange(11), holes), np.nan, TIMES)
    columns = tuple((name, fit(TIMES, values, Treatment())) for name, values in (("x", TIMES), ("y", gapped)))
    return Reference("walk", columns, 0.0, 1.0, **given)


def read(text: str, reference: Reference, **changes: Any) -> list[str]:
    """Return the findings about a reference that a cost reads."""
    cost = Cost(1.0, running=(Term(text, 1.0),))
    problem = replace(push(4), references=(reference,), cost=cost, **changes)
    conflicts = list(find_open_references(problem))
    assert all(conflict.place == ("references", "walk") for conflict in conflicts)
    return [conflict.finding for conflict in conflicts]


def test_references_in_seconds_need_a_horizon_of_one_length() -> None:
    free, seconds = (0.5, 2.0), ["the horizon is free, and the reference walk is in seconds"]
    for changes, given, expected in (
        ({}, {}, []),
        ({"horizon_range": free}, {}, seconds),
        ({"horizon_range": free}, {"is_normalised": True}, []),
        ({}, {"is_normalised": True}, []),
    ):
        assert read("ref_walk_x", refer(**given), **changes) == expected
        assert read("q_slide", refer(**given), **changes) == expected


def test_an_expression_that_reads_an_unknown_part_reads_where_it_is_known() -> None:
    """The factor known_... of the same gaps will do; parts beyond the horizon, and before it, do not count."""
    gapped = refer(4, 5)
    (finding,) = read("ref_walk_y**2", gapped)
    assert finding == 'ref_walk_y is unknown at 0.3 to 0.6 s of its recording, and "ref_walk_y**2" reads it'
    for text in ("ref_walk_x", "known_walk_y*ref_walk_y", "known_walk_y"):
        assert read(text, gapped) == []
    assert len(read("known_walk_x*ref_walk_y", gapped)) == 1
    assert read("ref_walk_y", gapped, horizon=0.3) == []
    assert len(read("ref_walk_y", gapped, horizon=0.31)) == 1
    (finding,) = read("ref_walk_x", gapped, horizon=1.5)
    assert "unknown at 1 to 1.5 s" in finding
    problem = replace(push(4), references=(replace(gapped, name="ref"),), cost=Cost(running=(Term("ref_ref_y", 1.0),)))
    (conflict,) = find_open_references(problem)
    assert conflict.remedy.startswith("multiply by known_ref_y, which is 0 there")
    many = refer(1, 4, 7)
    assert "at 0 to 0.2 s, 0.3 to 0.5 s, 0.6 to 0.8 s of its" in read("ref_walk_y", many, horizon=1.0)[0]
    assert "0.8 s, ... of its" in read("ref_walk_y", many, horizon=1.5)[0]


def test_inputs_of_a_model_to_which_no_problem_gives_a_value_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """All of them are named, as far as the equations read them."""
    roles = {"q": Role.COORDINATE, "u": Role.FORCE, "w": Role.WRENCH, "odd": Role.RESULT, "idle": Role.RESULT}
    inputs = [SimpleNamespace(name=name, role=role, nnz=int(name != "idle")) for name, role in roles.items()]
    manifest: Any = SimpleNamespace(coordinates=("x",), kernel=lambda _: SimpleNamespace(inputs=inputs))
    assert list_open_inputs(manifest) == ["odd"]
    manifest.coordinates = ()
    assert list_open_inputs(manifest) == []
    monkeypatch.setattr(checks, "list_open_inputs", lambda _: ["a", "b"])
    assert find({"cost": Cost(1.0), "name": "open"}) == (("model", "the model leaves a, b open, beside the inputs u"),)
