"""Written files are read as the same model."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mbsgen.documents.reading import MAX_BYTES
from mbsgen.model.construction import (
    Setting,
    ball,
    body,
    cardan,
    end,
    fixed,
    floating,
    frame,
    free,
    inertia,
    loop,
    make_model,
    planar,
    prismatic,
    revolute,
    rod,
    runtime,
    spherical,
    wrench,
)
from mbsgen.model.expansion import list_steps
from mbsgen.model.model import Body, Fixed, Joint, Loop, Model
from mbsgen.model.reader import read_model
from mbsgen.model.writer import MAX_WIDTH, write_model
from tests.mbsgen.model.files import GOOD, LINKAGE, WALKER, reread
from tests.shipped import MODELS


@pytest.mark.parametrize("file", MODELS, ids=lambda file: file.stem)
def test_models_that_ship_are_read_as_they_were(file: Path) -> None:
    model = read_model(file)
    assert reread(model) == model
    assert max(map(len, write_model(model).splitlines())) <= MAX_WIDTH


@pytest.mark.parametrize("text", [GOOD, WALKER, LINKAGE], ids=["crane", "walker", "linkage"])
def test_models_of_many_parts_are_read_as_they_were(text: str, tmp_path: Path) -> None:
    file = tmp_path / "model.yaml"
    file.write_text(text, encoding="utf-8")
    assert reread(read_model(file)) == read_model(file)


# Names that YAML takes for something else, unless they are in quotes.
NAMES = [
    *("b", "true", "Null", "1e3", "0x1F", "010", "-1", "1.", "- x", "a: b", "c:", "#", "d #e", "'q'", '"', "{", "["),
    *("a, b", "*x", "&x", "!x", "%", "@", "`", "?", "? x", "|", ">", "=", "é 鈎", "yes", "2*l", "<<", "x  y", "---"),
]
NUMBERS = ["l", "2*l", "-l/3", "atan2(l, m)", "-(l - 1)**2", "1e-3*l", "-1", "sqrt(2)*pi", 0, 1, -2.5, 1e-7, 0.1]
PARAMETERS = {"l": 0.3, "m": runtime("1 + l"), "true": 5, "n": "2*l - true"}

numbers, positive = st.sampled_from(NUMBERS), st.sampled_from(["l", "m/2", "l**2", 1, 2.5, 1e-3])
vectors = st.tuples(numbers, numbers, numbers)
turns = st.lists(st.tuples(st.sampled_from("xyz"), st.sampled_from([0.3, "pi/2", "-l", "l*m"])), max_size=3)
axes = st.sampled_from(["x", "y", "-z", (0, 0.6, 0.8), (1, "l", 0), (0, 0, 2)])
placements = {"position": vectors, "orientation": turns}
limits = st.sampled_from([(None, None), (-1, 1), (None, "pi/2"), ("-l", None)])


@st.composite
def joint_settings(draw: st.DrawFn) -> Setting:
    setting: Setting = {
        "limits": draw(limits),
        "actuated": draw(st.booleans()),
        "damping": draw(positive),
    }
    if draw(st.booleans()):
        setting["position"], setting["orientation"] = draw(vectors), draw(turns)
    if draw(st.booleans()):
        setting["stiffness"], setting["rest"] = draw(positive), draw(numbers)
    if draw(st.booleans()):
        setting["friction"] = draw(st.tuples(positive, positive))
    if draw(st.booleans()):
        setting["max_speed"], setting["max_force"] = 2.5, draw(st.sampled_from(["l", 40]))
    if draw(st.booleans()):
        setting["armature"] = draw(positive)
    if draw(st.booleans()):
        setting["force"] = draw(st.sampled_from(["-l*q**3", "m*sin(q) - qd", "atan2(q, qd)", "-q*exp(-qd**2)"]))
    return setting


joints = st.one_of(
    st.builds(lambda axis, setting: revolute(axis, **setting), axes, joint_settings()),
    st.builds(lambda axis, setting: prismatic(axis, **setting), axes, joint_settings()),
)
compounds = st.one_of(
    st.builds(cardan, st.sampled_from(["xy", "zx"]), actuated=st.booleans(), **placements),
    st.builds(spherical, st.sampled_from(["zyx", "xzy"]), actuated=st.booleans(), **placements),
    st.builds(planar, st.sampled_from(["xy", "xz"]), actuated=st.booleans(), **placements),
    st.builds(floating, st.sampled_from(["zyx", "yxz"]), actuated=st.booleans(), **placements),
    st.builds(ball, actuated=st.booleans(), **placements),
)
sequences = st.one_of(st.tuples(joints, joints), st.tuples(joints, joints, joints))
carriers = st.one_of(joints, compounds, sequences, st.builds(fixed, **placements))


@st.composite
def models(draw: st.DrawFn) -> Model:
    names = draw(st.lists(st.sampled_from(NAMES), min_size=3, max_size=6, unique=True))
    bodies: list[Body] = []
    for name in names:
        joint = draw(carriers if bodies else joints)
        parent = draw(st.sampled_from(["base", *(b.name for b in bodies)]))
        tensor = inertia(2, 2.5, 3, 0.1, -0.2)
        bodies.append(body(name, joint, parent=parent, mass=draw(positive), com=(0.31, "l", -0.7), inertia=tensor))
    anywhere = st.sampled_from(names)
    frames = [frame(name, draw(anywhere), position=draw(vectors), orientation=draw(turns)) for name in names[:2]]
    moving = [b.name for b in bodies if not isinstance(b.joint, Fixed)]
    wrenches = [
        wrench(
            name,
            draw(st.sampled_from(moving)),
            frame=draw(st.sampled_from(["base", "body"])),
            position=draw(vectors),
            force=draw(st.sampled_from(["input", (1, "l", 0)])),
            moment=draw(st.sampled_from(["input", (0, 0, 0), ("m", -2, 0)])),
        )
        for name in names[1:]
    ]
    loops = [draw_loop(draw, name, k, bodies) for k, name in enumerate(names[:3])]
    named = [step.name for i, made in enumerate(bodies) for step in list_steps(i, made) if not step.joint.floats]
    passive = [name for name in named if name not in list_inputs(bodies)]
    chosen = draw(st.lists(st.sampled_from(named), max_size=2, unique=True))
    rough = draw(st.dictionaries(st.sampled_from(named), numbers, max_size=2))
    driven = draw(st.lists(st.sampled_from(passive), max_size=2, unique=True)) if passive else []
    gravity, unphysical = draw(st.one_of(vectors, st.just((3e20, -1e15, 1e-300)))), draw(st.booleans())
    return make_model(
        names[0], bodies, gravity=gravity, parameters=PARAMETERS, frames=frames, wrenches=wrenches,
        loops=loops, driven=driven, independent=chosen, assembly=rough, allow_unphysical=unphysical,
    )  # fmt: skip


def draw_loop(draw: st.DrawFn, name: str, k: int, bodies: list[Body]) -> Loop:
    """Draw a loop between the base and a body that moves."""
    moving = [b.name for b in bodies if not isinstance(b.joint, Fixed)]
    first = end("base", position=(k, *draw(vectors)[1:]), orientation=draw(turns))
    second = end(draw(st.sampled_from(moving)), position=draw(vectors))
    kind = draw(st.sampled_from(["rod", "ball", "hinge", "universal", "solid"]))
    match kind:
        case "rod":
            return rod(name, second, first, draw(positive))
        case "hinge":
            return loop(name, kind, first, second, axis=draw(axes))
        case "universal":
            return loop(name, kind, first, second, axis=draw(axes), axis2=(1, 2, 3))
    return loop(name, kind, first, second)


def list_inputs(bodies: list[Body]) -> set[str]:
    return {step.name for i, made in enumerate(bodies) for step in list_steps(i, made) if step.joint.actuated}


@given(models())
@settings(derandomize=True, deadline=None, max_examples=40)
def test_random_models_are_read_as_they_were(model: Model) -> None:
    assert reread(model) == model


@pytest.mark.parametrize(
    "joint", [cardan("zy"), spherical("yzx", actuated=False), planar("yz"), floating("xzy"), ball(), free()]
)
def test_joints_that_have_a_name_are_written_by_it(joint: tuple[Joint, ...]) -> None:
    model = make_model("m", [body("b", joint, mass=1, com=(1, 2, 3), inertia=(1, 1, 1))], gravity=(0, 0, 0))
    (line,) = (line for line in write_model(model).splitlines() if "joint:" in line)
    assert "revolute" not in line
    assert reread(model) == model


def test_the_largest_model_still_fits_into_a_file() -> None:
    law = {"limits": (-1.2345678, 1.2345678), "damping": 0.12345678, "position": (0.12345678,) * 3}
    bodies = [
        body(f"a body with a long name {i}", revolute("z", **law), mass=1.2345678, com=(0.12345678,) * 3)
        for i in range(1000)
    ]
    assert len(write_model(make_model("m", bodies, gravity=(0, 0, 0)))) < MAX_BYTES
