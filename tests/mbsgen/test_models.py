"""The trees that ship: what they are made of, and how they move, by closed forms and by Pinocchio."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.formulations import exp2, impl, semi
from mbsgen.model.tree import Motion, Tree
from mbsgen.pipeline import Options, make, read_tree
from mbsgen.tape.interpreter import evaluate
from tests.random_trees import Pinocchio, floats, law_forces, values_of
from tests.shipped import FOLDER, TREES

Array = NDArray[np.float64]
NAMES = tuple(file.stem for file in TREES)
QUATERNIONS = ("satellite",)  # models with some
G = 9.81

# Joints, sliding joints, driven joints, sensors.
PARTS = {
    "acrobot": (2, 0, 1, 1),
    "arm_pendulum": (6, 0, 4, 2),
    "branched": (7, 5, 5, 2),
    "cart_pole": (2, 1, 1, 1),
    "double_pendulum": (2, 0, 0, 1),
    "leg": (3, 0, 3, 1),
    "pendulum": (1, 0, 1, 1),
    "planar_arm": (2, 0, 2, 1),
    "quadruped": (18, 3, 12, 4),
    "satellite": (4, 0, 4, 1),
    "six_axis": (6, 0, 6, 1),
}


def read(name: str) -> Tree:
    return read_tree(FOLDER / f"{name}.yaml")


@pytest.mark.parametrize("name", NAMES)
def test_models_have_their_parts(name: str) -> None:
    tree = read(name)
    joints = [body.joint for body in tree.bodies]
    sliding = sum(joint.motion is Motion.PRISMATIC for joint in joints)
    driven = sum(joint.actuated for joint in joints)
    assert (len(joints), sliding, driven, len(tree.sensors)) == PARTS[name]
    assert tree.name == name
    assert bool(tree.quaternions) is (name in QUATERNIONS)


@pytest.mark.parametrize("name", NAMES)
def test_models_generate(name: str) -> None:
    product = make(FOLDER / f"{name}.yaml", Options(derivatives=0))
    assert len(product.manifest.coordinates) == PARTS[name][0]


def phi(tree: Tree, q: Array, qd: Array, qdd: Array) -> Array:
    """Phi - Q by IMPL, with all inputs 0."""
    u = [0.0] * sum(body.joint.actuated for body in tree.bodies)
    given = {"q": list(q), "qd": list(qd), "qdd": list(qdd), "u": u} | ({"p": p} if (p := values_of(tree)) else {})
    return np.array(evaluate(impl.build(tree), given)["Phi"], float)


def draw_state(seed: int, n: int) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(seed)
    return rng.uniform(-3, 3, n), rng.uniform(-2, 2, n), rng.uniform(-3, 3, n)


@pytest.mark.parametrize("name", [name for name in NAMES if name not in QUATERNIONS])
def test_models_move_as_pinocchio_says(name: str) -> None:
    """Phi against `rnea`, without the joints' own forces; quaternions have a separate test."""
    tree = read(name)
    q, qd, qdd = draw_state(0, len(tree.bodies))
    expected = Pinocchio(tree).residual(q, qd, qdd) - law_forces(tree, q, qd)
    np.testing.assert_allclose(phi(tree, q, qd, qdd), expected, rtol=0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("seed", range(3))
def test_pendulum_closed_form(seed: int) -> None:
    """(m (l/2)^2 + m l^2/12) qdd + d qd + m g l/2 sin q, with the numbers of the file."""
    q, qd, qdd = draw_state(seed, 1)
    m, l, d = 2.0, 1.0, 0.05
    expected = m * l**2 / 3 * qdd + d * qd + m * G * l / 2 * np.sin(q)
    np.testing.assert_allclose(phi(read("pendulum"), q, qd, qdd), expected, rtol=1e-14)


@pytest.mark.parametrize("seed", range(3))
def test_cart_pole_closed_form(seed: int) -> None:
    """The equations of its comment: Lagrange's, of a cart at x and a point mass at (x + l sin q, -l cos q)."""
    q, qd, qdd = draw_state(seed, 2)
    cart, mass, l = 1.0, 0.3, 0.5
    s, c = math.sin(q[1]), math.cos(q[1])
    expected = [
        (cart + mass) * qdd[0] + mass * l * (qdd[1] * c - qd[1] ** 2 * s),
        mass * l**2 * qdd[1] + mass * l * qdd[0] * c + mass * G * l * s,
    ]
    np.testing.assert_allclose(
        phi(read("cart_pole"), q, qd, qdd), expected, rtol=0, atol=1e-14 * np.abs(expected).max()
    )


@pytest.mark.parametrize("seed", range(3))
def test_double_pendulum_closed_form(seed: int) -> None:
    """Lagrange's equations of two rods, the second angle relative to the first."""
    q, qd, qdd = draw_state(seed, 2)
    m1, m2, l1, l2 = 1.5, 0.8, 1.0, 0.7
    a1, a2, J1, J2 = l1 / 2, l2 / 2, m1 * l1**2 / 12, m2 * l2**2 / 12
    near, far = J1 + m1 * a1**2 + m2 * l1**2, J2 + m2 * a2**2
    coupling, h = m2 * l1 * a2 * math.cos(q[1]), m2 * l1 * a2 * math.sin(q[1])
    M = np.array([[near + far + 2 * coupling, far + coupling], [far + coupling, far]])
    c = np.array([-h * (2 * qd[0] * qd[1] + qd[1] ** 2), h * qd[0] ** 2])
    lower = m2 * G * a2 * math.sin(q[0] + q[1])
    g = np.array([(m1 * a1 + m2 * l1) * G * math.sin(q[0]) + lower, lower])
    expected = M @ qdd + c + g
    tree = read("double_pendulum")
    np.testing.assert_allclose(phi(tree, q, qd, qdd), expected, rtol=0, atol=1e-14 * np.abs(expected).max())
    terms = evaluate(semi.build(tree), {"q": list(q), "qd": list(qd)})
    np.testing.assert_allclose(np.array(terms["M"], float).reshape(2, 2), M, rtol=1e-14)
    np.testing.assert_allclose(np.array(terms["c"], float), c + g, rtol=0, atol=1e-14 * np.abs(c + g).max())


def test_the_pendulum_swings_with_its_period() -> None:
    """A small swing of a rod, undamped, takes 2 pi sqrt(2 l/(3 g)): its acceleration is -3 g/(2 l) q."""
    tree = read("pendulum")
    q = 1e-6
    (qdd,) = evaluate(exp2.build(tree), {"q": [q], "qd": [0.0], "u": [0.0]})["qdd"]
    assert float(qdd) == pytest.approx(-3 * G / 2 * q, rel=1e-11)


def test_the_quadruped_falls_freely() -> None:
    """Left alone in any pose, at rest, no joint turns, and the trunk falls with -g along z."""
    tree = read("quadruped")
    q = draw_state(1, 18)[0]
    qdd = np.array(evaluate(exp2.build(tree), {"q": list(q), "qd": [0.0] * 18, "u": [0.0] * 12})["qdd"], float)
    np.testing.assert_allclose(qdd, [0, 0, -G] + [0] * 15, rtol=0, atol=1e-10)


def test_the_quadruped_stands_on_symmetric_legs() -> None:
    """Mirrored from left to right, and nothing of the feet is lost: 4.2 + 4 (0.54 + 0.63 + 0.07 + 0.06) kg."""
    tree = read("quadruped")
    masses = {body.name: float(floats(tree, [body.mass])[0]) for body in tree.bodies}
    assert sum(masses.values()) == pytest.approx(4.2 + 4 * 1.3, rel=1e-15)
    assert masses["front left shank"] == pytest.approx(0.13, rel=1e-15)
    mirror = np.diag([1, -1, 1])
    bodies = {body.name: body for body in tree.bodies}
    for left in [body for body in tree.bodies if " left " in body.name]:
        right = bodies[left.name.replace("left", "right")]
        np.testing.assert_allclose(mirror @ floats(tree, left.com), floats(tree, right.com), atol=1e-16)
        np.testing.assert_allclose(mirror @ floats(tree, left.position), floats(tree, right.position), atol=1e-16)
        turned = mirror @ floats(tree, left.inertia) @ mirror
        np.testing.assert_allclose(turned, floats(tree, right.inertia), atol=1e-18)


@pytest.mark.parametrize("name", NAMES)
def test_inertias_are_those_of_bodies(name: str) -> None:
    """The covariance tr(I)/2 - I of the mass of each has no negative eigenvalue, after fixed bodies are merged."""
    tree = read(name)
    for body in tree.bodies:
        inertia = floats(tree, body.inertia)
        spread = np.eye(3) * np.trace(inertia) / 2 - inertia
        assert np.linalg.eigvalsh(spread).min() >= -1e-15 * np.abs(inertia).max()


def test_no_inertia_of_the_six_axis_arm_is_diagonal() -> None:
    tree = read("six_axis")
    for body in tree.bodies:
        assert all(body.inertia[i][j] != 0 for i, j in ((0, 1), (0, 2), (1, 2)))
