"""Joints of several degrees of freedom, and screws: the equations agree with closed forms and with Pinocchio.

Pinocchio's own joints are set up by hand. Tolerances are some hundred roundings of the largest entry.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.assembly import assemble
from mbsgen.expressions import Number
from mbsgen.formulations import closure
from mbsgen.formulations.catalogue import FUNCTIONS
from mbsgen.formulations.closure import kept_equations
from mbsgen.formulations.reductions import ALL, NONE, Reductions
from mbsgen.model.changes.locking import lock
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.construction import (
    body,
    differentiated,
    end,
    frame,
    inertia,
    joint,
    loop,
    make_model,
    revolute,
    runtime,
)
from mbsgen.model.model import Model, Parameter
from mbsgen.model.tree import Tree
from mbsgen.pipeline import Options, make
from mbsgen.procedure import procedure
from mbsgen.tape.interpreter import evaluate
from tests.random_trees import values_of

Array = NDArray[np.float64]
CLOSE = 1e-13
TENSOR = {"xx": 0.11, "yy": 0.13, "zz": 0.17, "xy": 0.01, "xz": -0.02, "yz": 0.03}
TENSOR_MATRIX = np.array([[TENSOR["".join(sorted(r + c))] for c in "xyz"] for r in "xyz"])
MASS, COM = 1.3, (0.1, -0.2, 0.3)
GRAVITY = (0.3, -2.0, -9.0)
SKEW = (0.36, 0.48, 0.8)  # of length 1
REDUCTIONS = (replace(ALL, trials=1), replace(NONE, trials=1))


def carry(type: str, **fields: object) -> Model:
    """Make a model of one body on a joint."""
    link = body("link", joint(type, **fields), mass=MASS, com=COM, inertia=inertia(**TENSOR))
    return make_model("m", [link], gravity=GRAVITY, frames=[frame("tip", "link", position=COM)])


def compute(tree: Tree, reductions: Reductions, state: Mapping[str, Array]) -> dict[str, Array]:
    """Compute Phi, M and c, and the accelerations by both explicit forms."""
    results: dict[str, Array] = {}
    for name in ("impl", "semi", "exp1", "exp2"):
        tape = FUNCTIONS[name].build(tree, reductions)
        found = evaluate(tape, {i.name: list(state[i.name]) for i in tape.inputs})
        results |= {f"{name}.{key}": np.array(value, float) for key, value in found.items()}
    return results


def draw(tree: Tree, seed: int) -> dict[str, Array]:
    rng, n = np.random.default_rng(seed), len(tree.joints)
    drawn = {name: rng.uniform(-1, 1, n) for name in ("q", "qd", "qdd")}
    return drawn | {"u": np.zeros(sum(j.actuated for j in tree.joints)), "p": np.array(values_of(tree))}


def assert_equations(tree: Tree, state: Mapping[str, Array], M: Array, c: Array) -> None:
    """All formulations have this mass matrix and this bias, with the reductions and without."""
    size = max(np.abs(M).max(), np.abs(c).max())
    qdd, lost = np.linalg.solve(M, -c), np.linalg.cond(M) * size
    for reductions in REDUCTIONS:
        found = compute(tree, reductions, state)
        np.testing.assert_allclose(found["semi.M"], M.flatten(order="F"), rtol=0, atol=CLOSE * size)
        np.testing.assert_allclose(found["semi.c"], c, rtol=0, atol=CLOSE * size)
        np.testing.assert_allclose(found["impl.Phi"], M @ state["qdd"] + c, rtol=0, atol=CLOSE * size)
        for name in ("exp1.qdd", "exp2.qdd"):
            np.testing.assert_allclose(found[name], qdd, rtol=0, atol=CLOSE * lost)


@pytest.mark.parametrize("pitch", [0.05, -3.0])
def test_a_screw_feels_its_mass_by_the_square_of_its_pitch(pitch: float) -> None:
    """Closed form, with the centre of mass on the axis: (I_zz + p^2 m) qdd - p m g_z = 0."""
    nut = body("nut", joint("helical", axis="z", pitch=pitch), mass=2.0, com=(0, 0, 0.3), inertia=(0.1, 0.2, 0.3))
    tree = build_tree(make_model("m", [nut], gravity=(0.3, 0.1, -9.81)))
    M = np.array([[0.3 + pitch**2 * 2.0]])
    assert_equations(tree, draw(tree, 1), M, np.array([pitch * 2.0 * 9.81]))


def test_a_screw_is_that_of_pinocchio() -> None:
    """About an axis of any direction, at any pitch, beyond another joint."""
    pin = pytest.importorskip("pinocchio")
    arm = body("arm", revolute("y"), mass=0.7, com=(0.2, 0, 0.1), inertia=(0.02, 0.03, 0.01))
    screw = joint("helical", axis=list(SKEW), pitch=0.3, position=(0.4, 0.1, 0), orientation=[("x", 0.5)])
    link = body("link", screw, parent="arm", mass=MASS, com=COM, inertia=inertia(**TENSOR))
    tree = build_tree(make_model("m", [arm, link], gravity=GRAVITY))
    peer = Peer(pin)
    first = peer.add(0, pin.JointModelRY(), np.eye(3), np.zeros(3), 0.7, (0.2, 0, 0.1), np.diag([0.02, 0.03, 0.01]))
    turned = pin.utils.rotate("x", 0.5)
    peer.add(first, pin.JointModelHelicalUnaligned(np.array(SKEW), 0.3), turned, np.array([0.4, 0.1, 0]))
    state = draw(tree, 2)
    assert_equations(tree, state, *peer.compute(state["q"], state["qd"]))


@pytest.mark.parametrize("angle", [0.7, -4.0, 9.0])
def test_a_thread_that_closes_a_loop_is_a_screw(angle: float) -> None:
    """A turn and a slide that a loop of type helical ties together, after whole turns too, move as a helical joint."""
    arm = body("arm", revolute("y"), mass=0.7, com=(0.2, 0, 0.1), inertia=(0.02, 0.03, 0.01))
    at: dict[str, Any] = {"position": (0.4, 0.1, 0), "orientation": [("x", 0.5)]}
    link: dict[str, Any] = {"parent": "arm", "mass": MASS, "com": COM, "inertia": inertia(**TENSOR)}
    free = body("link", joint("cylindrical", axis=list(SKEW), **at), **link)
    thread = loop("thread", "helical", end("arm", **at), end("link"), axis=list(SKEW), pitch=0.3)
    tied = assemble(build_tree(make_model("m", [arm, free], gravity=GRAVITY, loops=[thread])))
    joined = body("link", joint("helical", axis=list(SKEW), pitch=0.3, **at), **link)
    screw = build_tree(make_model("m", [arm, joined], gravity=GRAVITY))
    assert kept_equations(tied) == ((0, "screw"),)
    q, qd = [0.4, angle, 0.3 * angle], [1.5, -2.0, 0.3 * -2.0]
    assert evaluate(closure.build(tied), {"q": q})["gap"] == pytest.approx([0], abs=1e-14)
    expected = evaluate(FUNCTIONS["exp2"].build(screw, ALL), {"q": q[:2], "qd": qd[:2], "u": [0, 0]})["qdd"]
    found = evaluate(FUNCTIONS["exp2"].build(tied, ALL), {"q": q, "qd": qd, "u": [0, 0, 0]})["qdd"]
    assert found == pytest.approx([*expected, 0.3 * expected[1]], rel=1e-12)
    off = {"q": [0.4, angle, 0.3 * angle + 0.2]}
    assert procedure.evaluate(FUNCTIONS["close"].build(tied, ALL), off)["closed"] == pytest.approx(q, abs=1e-14)


def test_a_universal_joint_is_that_of_pinocchio() -> None:
    pin = pytest.importorskip("pinocchio")
    first, second = (0.8, 0.6, 0.0), (-0.36, 0.48, 0.8)  # Pinocchio's are perpendicular
    tree = build_tree(carry("universal", axis=first, axis2=second))
    peer = Peer(pin)
    peer.add(0, pin.JointModelUniversal(np.array(first), np.array(second)), np.eye(3), np.zeros(3))
    state = draw(tree, 3)
    assert_equations(tree, state, *peer.compute(state["q"], state["qd"]))


def test_a_cylindrical_joint_is_a_turn_and_a_slide_of_pinocchio() -> None:
    pin = pytest.importorskip("pinocchio")
    tree = build_tree(carry("cylindrical", axis=SKEW))
    peer, axis = Peer(pin), np.array(SKEW)
    both = pin.JointModelComposite(pin.JointModelRevoluteUnaligned(axis))
    both.addJoint(pin.JointModelPrismaticUnaligned(axis))
    peer.add(0, both, np.eye(3), np.zeros(3))
    state = draw(tree, 4)
    assert_equations(tree, state, *peer.compute(state["q"], state["qd"]))


def test_a_planar_joint_by_its_normal_is_that_of_pinocchio() -> None:
    """Pinocchio's velocities are along the body's axes: v = T qd, so M is TT M T, and c is TT (M T' qd + c)."""
    pin = pytest.importorskip("pinocchio")
    tree = build_tree(carry("planar", normal=SKEW))
    normal = np.array(SKEW)
    x = np.array([1.0, 0, 0]) - SKEW[0] * normal  # the first slide: the x axis is the farthest from the normal
    x /= np.linalg.norm(x)
    C = np.column_stack([x, np.cross(normal, x), normal])
    peer = Peer(pin)
    peer.add(0, pin.JointModelPlanar(), C, np.zeros(3), com=C.T @ COM, tensor=C.T @ TENSOR_MATRIX @ C)
    state = draw(tree, 5)
    (a, b, angle), (_, _, rate) = state["q"], state["qd"]
    c, s = np.cos(angle), np.sin(angle)
    T, Td = np.eye(3), np.zeros((3, 3))
    T[:2, :2], Td[:2, :2] = [[c, s], [-s, c]], rate * np.array([[-s, c], [-c, -s]])
    M, bias = peer.compute(np.array([a, b, c, s]), T @ state["qd"])
    assert_equations(tree, state, T.T @ M @ T, T.T @ (M @ Td @ state["qd"] + bias))


class Peer:
    """A model of Pinocchio, made joint by joint."""

    def __init__(self, pin: Any) -> None:
        self.pin, self.model = pin, pin.Model()
        self.model.gravity.linear = np.array(GRAVITY)

    def add(
        self,
        parent: int,
        kind: Any,
        rotation: Array,
        position: Array,
        mass: float = MASS,
        com: Any = COM,
        tensor: Array = TENSOR_MATRIX,
    ) -> int:
        place = self.pin.SE3(np.array(rotation), position)
        number = int(self.model.addJoint(parent, kind, place, f"j{self.model.njoints}"))
        self.model.appendBodyToJoint(number, self.pin.Inertia(mass, np.array(com), tensor), self.pin.SE3.Identity())
        return number

    def compute(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Compute M and c."""
        data = self.model.createData()
        upper = np.triu(np.array(self.pin.crba(self.model, data, q)))
        return upper + np.triu(upper, 1).T, np.array(self.pin.nonLinearEffects(self.model, data, q, v))


FIELDS: dict[str, dict[str, object]] = {
    "helical": {"axis": SKEW, "pitch": "0.3/pi"},
    "universal": {"axis": "x", "axis2": SKEW},
    "cylindrical": {"axis": SKEW},
    "planar": {"normal": SKEW, "actuated": True},
}
SETTINGS: dict[str, object] = {"damping": 0.1, "stiffness": 2, "armature": 0.05, "limits": [-1, 2], "max_force": 3}
LABELS = {"universal": "rx", "cylindrical": "t", "planar": "t2"}


@pytest.mark.parametrize("type", FIELDS)
def test_all_that_is_generated_is_verified(type: str) -> None:
    """Functions and derivatives, with laws, rotors and run-time numbers: `make` compares them in 50 digits."""
    own = SETTINGS if type == "helical" else {"axes": {LABELS[type]: SETTINGS}}
    made = make(carry(type, **FIELDS[type], **own), Options(runtime=True, functions=("impl", "exp2", "motion")))
    (limited,) = (x for x in made.manifest.coordinates if (x.lower, x.upper) == (-1, 2))
    assert limited.max_force == 3
    assert limited.name == ("link" if type == "helical" else f"link.{LABELS[type]}")
    assert limited.motion == ("prismatic" if type in ("cylindrical", "planar") else "revolute")


@pytest.mark.parametrize("kind", [runtime, differentiated])
def test_a_pitch_may_be_a_parameter(kind: Callable[[float], Parameter]) -> None:
    """Of run time, or one that the code is differentiated by: all of it is verified at several pitches, too."""
    nut = body("nut", joint("helical", axis="z", pitch="p/2"), mass=2.0, com=(0.1, 0, 0.3), inertia=(0.1, 0.2, 0.3))
    model = make_model("m", [nut], gravity=(0, 0, -9.81), parameters={"p": kind(0.2)}, frames=[frame("tip", "nut")])
    make(model, Options(functions=("impl", "semi", "exp1", "exp2", "energy", "motion")))
    tree = build_tree(model)
    given = {"q": [0.3], "qd": [0.7], ("p" if kind is runtime else "theta"): [6.0]}
    found = evaluate(FUNCTIONS["semi"].build(tree, ALL), given)
    assert found["M"] == pytest.approx([0.3 + 0.1**2 * 2 + 3.0**2 * 2], rel=1e-14)
    assert found["c"] == pytest.approx([3.0 * 2 * 9.81], rel=1e-14)


def test_a_locked_screw_stands_turned_and_moved() -> None:
    """The same place by hand: a fixed body, turned by q about z and moved by p q along it."""
    arm = body("arm", revolute("y"), parent="link", mass=MASS, com=COM, inertia=inertia(**TENSOR))
    models = [
        make_model("m", [body("link", held), arm], gravity=GRAVITY)
        for held in (
            joint("helical", axis="z", pitch=0.5),
            joint("fixed", position=(0, 0, 0.2), orientation=[("z", 0.4)]),
        )
    ]
    trees = [build_tree(lock(models[0], {"link": Number(0.4)})), build_tree(models[1])]
    found, expected = (compute(tree, REDUCTIONS[0], draw(tree, 6)) for tree in trees)
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, rtol=0, atol=CLOSE * max(1, np.abs(value).max()))
