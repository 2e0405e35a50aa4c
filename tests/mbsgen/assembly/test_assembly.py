"""Assemblies of loops: closed poses, redundant equations, choices of coordinates, and loops that cannot be closed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from decimal import Decimal
from math import acos, cos, pi, sin
from pathlib import Path

import numpy as np
import pytest

from mbsgen.assembly import AssemblyError, assemble, describe
from mbsgen.assembly.poses import FEWEST, SPREADS, count_starts
from mbsgen.errors import InputError
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.formulations.reductions import ALL, Reductions
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.construction import (
    body,
    constraint,
    end,
    free,
    joint,
    loop,
    make_model,
    number,
    prismatic,
    revolute,
    rod,
    runtime,
)
from mbsgen.model.model import Body, Follow, Loop, Model, Parameter
from mbsgen.model.tree import Kind, Tree
from mbsgen.pipeline import Options, make, read_tree
from mbsgen.procedure.procedure import evaluate
from mbsgen.tape.interpreter import DECIMALS, fifty_digits

CRANK, COUPLER, ROCKER, GROUND = 0.2, 0.5, 0.4, 0.6
UNIFORM = (0.1, 0.1, 0.1)
ONE_PLAN = Options(derivatives=0, reductions=Reductions(trials=1))


def link(name: str, parent: str, x: float, *, actuated: bool = False) -> object:
    joint = revolute("z", name=name, position=(x, 0, 0), actuated=actuated)
    return body(name, joint, parent=parent, mass=1.0, com=(0.1, 0, 0), inertia=UNIFORM)


def four_bar(
    lengths: tuple[float, float, float, float] = (CRANK, COUPLER, ROCKER, GROUND), **settings: object
) -> Model:
    crank, coupler, rocker, ground = lengths
    bodies = [
        link("crank", "base", 0.0, actuated=True),
        link("coupler", "crank", crank),
        link("rocker", "base", ground),
    ]
    first, second = end("coupler", position=(coupler, 0, 0)), end("rocker", position=(rocker, 0, 0))
    known = {"loops": [loop("knee", "hinge", first, second)], "assembly": {"crank": 1.0, "rocker": 1.5}} | settings
    return make_model("four-bar", bodies, gravity=(0, -9.81, 0), **known)  # type: ignore[arg-type]


def close(model: Model) -> Tree:
    return assemble(build_tree(model))


def refuse(model: Model) -> str:
    with pytest.raises(InputError) as found:
        read_tree(model)
    return str(found.value)


def test_a_four_bar_closes_where_its_circles_meet() -> None:
    """The knee lies on the circles about the tip of the crank and about the ground's second pivot."""
    closure = close(four_bar()).closure
    assert closure is not None
    crank, coupler, rocker = closure.pose
    x, y = CRANK * cos(crank) + COUPLER * cos(crank + coupler), CRANK * sin(crank) + COUPLER * sin(crank + coupler)
    np.testing.assert_allclose([x, y], [GROUND + ROCKER * cos(rocker), ROCKER * sin(rocker)], rtol=0, atol=1e-14)


def test_both_assemblies_of_a_four_bar_are_found() -> None:
    """They are images of each other in the line from the tip of the crank to the ground's second pivot."""
    found = describe(close(four_bar()))
    assert found is not None
    assert len(found.assemblies) == 2
    one, other = (np.array(pose) for pose in found.assemblies)
    line = np.arctan2(-CRANK * sin(one[0]), GROUND - CRANK * cos(one[0]))
    mirrored = np.remainder(2 * line - (one[0] + one[1]) - (other[0] + other[1]) + pi, 2 * pi) - pi
    assert one[0] == other[0]
    assert abs(mirrored) < 1e-9


def test_equations_across_the_plane_are_redundant() -> None:
    found = describe(close(four_bar()))
    assert found is not None
    assert found.freedoms == 1
    assert found.redundant == ("knee.z", "knee.turn_x", "knee.turn_y")


def test_joints_with_inputs_are_independent_and_an_author_decides_otherwise() -> None:
    chosen, own = close(four_bar()).closure, close(four_bar(independent=["rocker"])).closure
    assert chosen is not None
    assert chosen.independent == (0,)
    assert own is not None
    assert own.independent == (2,)
    assert own.dependent == (0, 1)


def bricard() -> Model:
    """Five rods along the edges of a cube, and six hinges: mobile by the directions of its axes alone."""
    steps = [("y", (1, 0, 0)), ("z", (0, -1, 0)), ("x", (0, 0, 1)), ("y", (-1, 0, 0)), ("z", (0, 1, 0))]
    bodies, parent, place = [], "base", (0, 0, 0)
    for k, (axis, rod_) in enumerate(steps):
        joint = revolute(axis, name=f"q{k}", position=place, actuated=False)
        bodies.append(body(f"rod{k}", joint, parent=parent, mass=1.0, com=tuple(x / 2 for x in rod_), inertia=UNIFORM))
        parent, place = f"rod{k}", rod_
    last = loop("last", "hinge", end(parent, position=place), end("base", position=(0, 0, 1)), axis="x")
    return make_model("Bricard", bodies, gravity=(0, -9.81, 0), loops=[last])


def test_a_mechanism_that_moves_by_its_geometry_has_its_redundant_equation_named() -> None:
    """Five joints and five equations leave no freedom by counting; one equation follows from the others (Bricard)."""
    found = describe(close(bricard()))
    assert found is not None
    assert (found.coordinates, found.freedoms, len(found.redundant)) == (5, 1, 1)


def test_equations_that_are_redundant_for_one_geometry_are_no_run_time_matter() -> None:
    with pytest.raises(InputError, match="for the present lengths alone"):
        make(bricard(), replace(ONE_PLAN, runtime=True, functions=("impl",)))


def three_cranks(scale: float, height: float | str, bodies: Sequence[Body] = (), rods: Sequence[Loop] = ()) -> Model:
    """A bar on three cranks of equal length: the third one's equation follows from the others."""
    joints = (revolute("y", name="q1"), revolute("y", name="q2", position=(0, 0, scale / 2), actuated=False))
    crank = body("crank", joints[0], mass=1.0, inertia=UNIFORM)
    bar = body("bar", joints[1], parent="crank", mass=1.0, inertia=UNIFORM)
    own = [
        rod(name, end("base", position=(x, 0, 0)), end("bar", position=(x, 0, 0)), length)
        for name, x, length in (("second", scale, scale / 2), ("third", scale / 2, height))
    ]
    return make_model(
        "cranks",
        [crank, bar, *bodies],
        gravity=(0, 0, -9.81),
        parameters={"height": runtime(scale / 2), "reach": runtime(1.0005)},
        loops=[*own, *rods],
        assembly={"q1": 0.4, "q2": -0.4} | ({"p1": 0.1, "p2": 3.0} if bodies else {}),
    )


@pytest.mark.parametrize("scale", [1.0, 1e-2, 1e-4])
def test_equations_are_redundant_for_one_geometry_at_any_size(scale: float) -> None:
    """A rod of 0.05 mm that grows by a part of 1 % leaves its equation open by less than a micrometre."""
    close(three_cranks(scale, scale / 2))
    with pytest.raises(AssemblyError, match='loop "third": its equation distance follows from the others for the pres'):
        close(three_cranks(scale, "height"))


def test_redundancy_is_examined_at_numbers_for_which_the_loops_close() -> None:
    """A crank of 1 m reaches points at 2 m by rods from 1 m to 3 m: `reach` may be 1 to 1.001."""
    cranks = [
        body(f"arm{k}", revolute("y", name=f"p{k}", position=(5 * k, 0, 0)), mass=1.0, inertia=UNIFORM) for k in (1, 2)
    ]
    rods = [
        rod(f"rod{k}", end("base", position=(5 * k + 2, 0, 0)), end(f"arm{k}", position=(1, 0, 0)), length)
        for k, length in ((1, "reach"), (2, "reach + 1.999"))
    ]
    with pytest.raises(AssemblyError, match='loop "third": its equation distance follows from the others for the pres'):
        close(three_cranks(1.0, "height", cranks, rods))


def test_redundancy_is_examined_at_several_poses() -> None:
    """At q1 = q2 = 0 both equations hold for any number, and only where it is 1 do they follow from each other."""
    bodies = [body(f"arm{k}", revolute("y", name=f"q{k}"), mass=1.0, inertia=UNIFORM) for k in (1, 2, 3)]
    equations = [constraint("sines", "sin(q1) - sin(q2)"), constraint("tangents", "tan(q1) - w*tan(q2)")]
    with pytest.raises(AssemblyError, match='constraint "tangents": its equation follows from the others for the pres'):
        close(make_model("arms", bodies, gravity=(0, 0, 0), parameters={"w": runtime(1)}, constraints=equations))


def test_a_loop_in_a_plane_has_no_lengths_across_it_at_run_time() -> None:
    """Else a length across the plane, 0 now, could be changed, and the equation that it violates is left out."""
    model, options = four_bar(), replace(ONE_PLAN, runtime=True, zeros=True, functions=("loops",))
    make(model, replace(options, zeros=False))
    with pytest.raises(InputError, match=r'loop "knee": its equation [a-z_]+ follows from the others for the present'):
        make(model, options)
    first, second = end("coupler", position=(COUPLER, 0, 0)), end("rocker", position=(ROCKER, 0, "across"))
    shifted = {"loops": [loop("knee", "hinge", first, second)], "parameters": {"across": runtime(0)}}
    with pytest.raises(InputError, match='loop "knee": its equation z follows from the others for the present'):
        make(four_bar(**shifted), replace(options, runtime=False, zeros=False))


def test_a_loop_out_of_reach_is_named_with_what_is_left() -> None:
    """The knee cannot bridge 3 m - 0.2 m - 0.5 m - 0.4 m = 1.9 m."""
    told = refuse(four_bar((CRANK, COUPLER, ROCKER, 3.0)))
    assert told.startswith('model "four-bar": loops[0]: loop "knee" does not close')
    assert float(told.split("by ")[1].split(";")[0]) == pytest.approx(1.9, rel=0.02)


def test_the_gap_of_a_rod_is_a_length() -> None:
    """The tips of crank and rocker are at most 0.2 m + 0.6 m + 0.4 m apart: of 3 m, 1.8 m are missing."""
    ends = end("crank", position=(CRANK, 0, 0)), end("rocker", position=(ROCKER, 0, 0))
    told = refuse(four_bar(loops=[rod("bar", *ends, 3.0)]))
    assert float(told.split("by ")[1].split(" m;")[0]) == pytest.approx(1.8, rel=0.01)


def test_large_models_are_closed_from_fewer_starts() -> None:
    """A loop of hundreds of joints that is out of reach would be searched for minutes."""
    assert count_starts(1000) == len(SPREADS)
    assert count_starts(70_000) < 20
    assert count_starts(10**9) == FEWEST


def test_loops_that_contradict_each_other_are_both_named() -> None:
    ends = end("coupler"), end("rocker", position=(0.1, 0, 0))
    told = refuse(four_bar(loops=[rod("one", *ends, 0.4), rod("other", *ends, 0.5)]))
    assert 'loop "one" does not close' in told
    assert 'loop "other" does not close' in told


def test_a_constraint_without_a_solution_is_named() -> None:
    told = refuse(four_bar(constraints=[constraint("cam", "sin(crank) - 2")]))
    assert 'constraints[0]: constraint "cam" does not close' in told


def test_faults_of_constraints_have_their_lines_beside_such_as_became_followers(tmp_path: Path) -> None:
    """The gear's joint follows, so the cam is the first equation of the tree, and the second of the file."""
    joints = ("x, position: [0, 0, 0]", "y, actuated: false", "z, actuated: false")
    bodies = [
        f"  - {{name: b{i}, joint: {{type: revolute, axis: {text}}}, mass: 1, com: [0.1, 0.2, 0.3]}}\n"
        for i, text in enumerate(joints)
    ]
    file = tmp_path / "model.yaml"
    file.write_text(
        f"name: cam\ngravity: [0, 0, 0]\nbodies:\n{''.join(bodies)}constraints:\n"
        "  - {name: gear, equation: b2 - 2*b1}\n  - {name: cam, equation: sin(b0) - 2}\n",
        encoding="utf-8",
    )
    with pytest.raises(InputError, match=r'model\.yaml:9: constraints\[1\]: constraint "cam" does not close'):
        read_tree(file)


def test_a_rough_turn_of_a_quaternion_is_where_the_search_begins() -> None:
    """The plate hangs from the base by a ball, so any turn closes it: it stays at the rough one."""
    plate = body("plate", free(), mass=1, inertia=(1, 1, 1))
    loops = [loop("hang", "ball", end("base", position=(1, 2, 3)), end("plate"))]
    rough = {"plate.x": 1, "plate.y": 2, "plate.z": 3, "plate.ry": 0.6, "plate.rz": 0.8}
    closure = close(make_model("plate", [plate], gravity=(0, 0, 0), loops=loops, assembly=rough)).closure
    assert closure is not None
    expected = (1, 2, 3, 0, 0.6 * sin(0.5), 0.8 * sin(0.5), cos(0.5))
    assert closure.pose == pytest.approx(expected, abs=1e-12)


def test_a_loop_that_leaves_no_freedom_is_refused() -> None:
    told = refuse(four_bar(constraints=[constraint("stop", "crank + sin(crank) - 1.5")]))
    assert "leave no joint free to move" in told


def test_a_parallelogram_in_line_is_singular() -> None:
    """All links lie on one line: the change point, where two assemblies meet."""
    told = refuse(four_bar((0.3, 0.6, 0.3, 0.6), assembly={}))
    assert "singular pose" in told
    assert "1 of their equations are independent there, 2 nearby" in told


def test_axes_turned_round_are_told() -> None:
    first = end("coupler", position=(COUPLER, 0, 0), orientation=[("x", pi)])
    told = refuse(four_bar(loops=[loop("knee", "hinge", first, end("rocker", position=(ROCKER, 0, 0)))]))
    assert 'loop "knee" closes with its axes turned round only' in told


@pytest.mark.parametrize("names", [["crank", "rocker"], ["crank", "coupler", "rocker"]])
def test_too_many_independent_joints_are_counted(names: list[str]) -> None:
    told = refuse(four_bar(independent=names))
    assert f"independent: {len(names)} independent joints" in told
    assert "1 determine all others" in told


def test_an_independent_joint_at_its_dead_centre_is_refused() -> None:
    """Crank and coupler in line: the rocker is at its limit, and does not determine the crank."""
    reach = CRANK + COUPLER
    crank = acos((reach**2 + GROUND**2 - ROCKER**2) / (2 * reach * GROUND))
    pose = {"crank": crank, "rocker": pi - acos((ROCKER**2 + GROUND**2 - reach**2) / (2 * ROCKER * GROUND))}
    assert "do not determine the others" in refuse(four_bar(independent=["rocker"], assembly=pose))


def test_more_driven_joints_than_freedoms_are_counted() -> None:
    model = four_bar()
    passive = [replace(b, joint=replace(b.joint, actuated=False)) for b in model.bodies]  # type: ignore[type-var]
    told = refuse(replace(model, bodies=tuple(passive), driven=("crank", "rocker")))
    assert "driven: 2 driven joints, where 1 determine all others" in told


def test_faults_of_loops_have_their_lines(tmp_path: Path) -> None:
    file = tmp_path / "model.yaml"
    file.write_text(
        "name: rods\ngravity: [0, -9.81, 0]\nbodies:\n"
        "  - {name: a, joint: {type: revolute, axis: z}, mass: 1, com: [0.1, 0, 0]}\n"
        "  - {name: b, joint: {type: revolute, axis: z, position: [1, 0, 0]}, mass: 1, com: [0.1, 0, 0]}\n"
        "loops:\n  - {name: bar, type: rod, from: {body: a, position: [0.2, 0, 0]}, to: {body: b}, length: 2}\n",
        encoding="utf-8",
    )
    with pytest.raises(InputError, match=r'model\.yaml:7: loops\[0\]: loop "bar" does not close'):
        read_tree(file)


def test_a_tree_without_loops_stays_as_it_is() -> None:
    tree = build_tree(make_model("one", [link("a", "base", 0.0)], gravity=(0, 0, -9.81)))  # type: ignore[list-item]
    assert assemble(tree) is tree
    assert all(p.kind is Kind.CONSTANT for p in tree.parameters)


def test_ratios_and_loops_read_parameters_that_a_function_does_not() -> None:
    """The forces of a loop depend on no mass, but the mass is a parameter of the model, and the ratio another."""
    known = {"m": Parameter("m", number(1.0), Kind.DIFFERENTIATED), "r": Parameter("r", number(2.0), Kind.RUNTIME)}
    turning = replace(revolute("x", actuated=False), follows=Follow("crank", number("r")))
    gear = body("gear", turning, mass=1.0, inertia=UNIFORM)
    model = four_bar()
    heavy = replace(model.bodies[0], mass=number("m"))
    model = replace(model, parameters=tuple(known.values()), bodies=(heavy, *model.bodies[1:], gear))
    product = make(model, replace(ONE_PLAN, functions=("loop_forces", "impl")))
    assert product.report.verification.unchecked == ()


@pytest.mark.parametrize(
    ("equation", "what"),
    [
        ("rocker - sqrt(crank**2/2 + coupler**2/4)", "no derivative"),
        ("rocker - atan2(coupler, crank)", "no derivative"),
        ("sqrt(rocker) - crank", "no derivative"),
        ("sqrt(rocker) - crank - 1", "no derivative"),
        ("rocker - abs(crank)", "no derivative"),
        ("rocker - coupler*abs(crank) - min(crank, 2*crank)", "no derivative"),
        ("rocker - asin(2 + crank)", "no value"),
    ],
)
def test_a_constraint_without_value_or_derivative_at_the_rough_pose_is_a_fault(equation: str, what: str) -> None:
    told = refuse(four_bar(loops=[], constraints=[constraint("cam", equation)], assembly={}))
    assert told.count("constraints[0]") == 1
    assert f"has {what} at" in told
    assert "give a rough pose under `assembly:`" in told


def test_a_constraint_whose_slopes_pass_through_a_side_of_abs_without_a_jump_is_read() -> None:
    """Where abs changes its side, coupler abs(crank) at coupler 0, and crank abs(crank), have a derivative."""
    equation = [constraint("cam", "rocker - coupler*abs(crank) - crank*abs(crank)")]
    product = make(four_bar(loops=[], constraints=equation, assembly={}), replace(ONE_PLAN, functions=("exp1",)))
    assert product.report.verification.unchecked == ()


def test_a_constraint_is_verified_near_its_pose_where_it_has_no_value_elsewhere() -> None:
    """The arc sine of 2 + q has a value for q from -3 to -1, and states are drawn from -1 to 1."""
    equation = [constraint("cam", "rocker - asin(2 + crank)")]
    product = make(
        four_bar(loops=[], constraints=equation, assembly={"crank": -1.6}), replace(ONE_PLAN, functions=("exp1",))
    )
    assert product.report.verification.unchecked == ()


def size(kind: str, s: float) -> Model:
    """A screw in a nut that slides; or two free bodies, one on a ball at the base, a hinge between them."""
    mass, inertia = s**3, (1e-3 * s**5, 2e-3 * s**5, 2.5e-3 * s**5)
    if kind == "screw":
        nut = body("nut", prismatic("z", name="x"), mass=mass, inertia=inertia)
        turning = revolute("z", name="turn", actuated=False)
        screw = body("screw", turning, parent="nut", mass=mass, inertia=inertia, com=(0.1 * s, 0, 0))
        thread = loop("thread", "helical", end("base"), end("screw"), axis="z", pitch=0.1 * s)
        rough = {"x": 0.05 * s, "turn": 0.4}
        return make_model("sized", [nut, screw], gravity=(0, 0, -9.81), loops=[thread], assembly=rough)
    if kind == "ball":
        crank = body("crank", revolute("y", name="q1"), mass=mass, inertia=inertia, com=(0.1 * s, 0, 0))
        plate = body("plate", joint("free"), mass=mass, inertia=inertia, com=(0.1 * s, 0.02 * s, 0))
        pin = loop("pin", "ball", end("crank", position=(0.2 * s, 0, 0)), end("plate", position=(0, 0.1 * s, 0)))
        return make_model("sized", [crank, plate], gravity=(0, 0, -9.81), loops=[pin], assembly={"q1": 0.3})
    bodies = [
        body(name, joint("free"), mass=mass, inertia=inertia, com=(0.1 * s, 0.02 * s, 0)) for name in ("one", "other")
    ]
    hung = loop("hung", "ball", end("base"), end("one", position=(0, 0.3 * s, 0)))
    pin = loop("pin", "hinge", end("one", position=(0.2 * s, 0, 0)), end("other"), axis="y")
    return make_model("sized", bodies, gravity=(0, 0, -9.81), loops=[hung, pin])


@pytest.mark.parametrize(
    ("kind", "scale", "names", "derivatives"),
    [
        ("screw", 1e6, ("semi_red", "exp1_red", "impl_red", "close_accelerations"), 0),
        ("screw", 1e-9, ("semi_red", "exp1_red", "impl_red", "close_accelerations"), 0),
        ("ball", 1e3, ("project_plain", "project"), 0),
        ("ball", 1e6, ("project_plain", "project"), 0),
        ("ball", 1e-9, ("project_plain", "project"), 0),
        ("free", 1e-10, ("exp1",), 1),
        ("free", 1e6, ("exp1",), 1),
    ],
)
def test_screws_and_quaternions_close_at_any_size(
    kind: str, scale: float, names: tuple[str, ...], derivatives: int
) -> None:
    """Each function is verified in 50 digits, against the mechanism's geometry and its own differences."""
    product = make(size(kind, scale), replace(ONE_PLAN, functions=names, derivatives=derivatives))
    assert product.report.verification.unchecked == ()


def test_a_plain_projection_does_not_depend_on_the_size() -> None:
    """Shifts count in units of the loops, powers of two: projected coordinates are in proportion to the size."""
    found = []
    for s in (2.0**-20, 2.0**14):
        tree = assemble(build_tree(size("ball", s)))
        shifts = [Decimal(x) for x in (1, s, s, s, 1, 1, 1, 1)]
        rough = [Decimal(x) for x in ("0.3", "0.2", "-0.09", "-0.06", "0", "0", "0", "1")]
        given = {"q": [x * y for x, y in zip(rough, shifts, strict=True)], "qd": [Decimal(0)] * 7}
        with fifty_digits():
            closed = evaluate(FUNCTIONS["project_plain"].build(tree, ALL), given, DECIMALS)["closed"]
        found.append([float(x / y) for x, y in zip(closed, shifts, strict=True)])
    np.testing.assert_allclose(found[0], found[1], atol=1e-13)


@pytest.mark.parametrize(("kind", "scale"), [("turns", 1e-9), ("turns", 1e6), ("slides", 1e-7), ("slides", 1e3)])
def test_kernels_close_loops_of_any_size(kind: str, scale: float) -> None:
    """A slider-crank has the same angles at any size; masses grow with the cube. Verification is by 50 digits."""
    s, mass, inertia = scale, scale**3, (1e-3 * scale**5,) * 3
    crank = body("crank", revolute("y", name="q1"), com=(0.1 * s, 0, 0), mass=mass, inertia=inertia)
    arm = body(
        "arm",
        revolute("y", name="q2", position=(0.2 * s, 0, 0), actuated=False),
        parent="crank",
        mass=mass,
        inertia=inertia,
    )
    if kind == "turns":
        rocker = body(
            "rocker", revolute("y", name="q3", position=(0.5 * s, 0, 0), actuated=False), mass=mass, inertia=inertia
        )
        found = loop(
            "knee", "hinge", end("arm", position=(0.4 * s, 0, 0)), end("rocker", position=(0.3 * s, 0, 0)), axis="y"
        )
        bodies, rough, last = [crank, arm, rocker], {"q1": -1, "q3": -1.5}, -1.50946381736058
    else:
        car = body("car", prismatic("x", name="x", actuated=False), mass=mass, inertia=inertia)
        found = loop("pin", "ball", end("arm", position=(0.4 * s, 0, 0)), end("car"))
        bodies, rough, last = [crank, arm, car], {"q1": -1, "q2": 1.3, "x": 0.6 * s}, None
    model = make_model("small", bodies, gravity=(0, 0, -9.81), loops=[found], independent=["q1"], assembly=rough)
    names = ("close", "project", "project_plain", "exp1")
    product = make(model, replace(ONE_PLAN, functions=names))
    q1, q2, q3 = product.manifest.pose
    reach = 0.2 * cos(q1) + 0.4 * cos(q1 + q2)
    assert q3 == pytest.approx(last if last else reach * s, rel=1e-12)
    assert 0.2 * sin(q1) + 0.4 * sin(q1 + q2) == pytest.approx(0.3 * sin(q3) if last else 0.0, abs=1e-13)
