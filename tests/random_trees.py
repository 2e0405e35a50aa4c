"""Random trees, as Trees and as Pinocchio models: the ground of the property tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray
from sympy import Float, Integer, Rational, Symbol, tanh

from mbsgen.model.tree import (
    COORDINATE,
    RATE,
    Body,
    Joint,
    Kind,
    Matrix,
    Motion,
    Parameter,
    Sensor,
    Tree,
    Vector,
    Wrench,
)

Array = NDArray[np.float64]


def random_tree(seed: int, size: int, *, runtime: bool = False, tidy: bool = False) -> Tree:
    """Make a tree of `size` bodies: any branching, both motions, full inertias, turned joints, tilted gravity.

    tidy: axes of a joint stand to the parent's as they do in hand-written models (no turn at q = 0).
    """
    rng = np.random.default_rng(seed)
    parameters: list[Parameter] = []

    def number(value: float) -> object:
        if not runtime:
            return Float(value)
        symbol = Symbol(f"p{len(parameters)}")
        parameters.append(Parameter(symbol.name, symbol, float(value), Kind.RUNTIME))
        return symbol

    def vector(values: Array) -> Vector:
        return tuple(number(float(x)) for x in values)  # type: ignore[return-value]

    bodies = []
    for i in range(1, size + 1):
        motion = Motion.REVOLUTE if rng.random() < 0.7 else Motion.PRISMATIC
        joint = Joint(f"q{i}", motion, int(rng.integers(3)), bool(rng.random() < 0.8), None, None)
        orientation = exact_matrix(np.eye(3) if tidy else random_rotation(rng))
        entries = random_inertia(rng)
        inertia = [[number(float(entries[r, c])) if c >= r else None for c in range(3)] for r in range(3)]
        symmetric = tuple(tuple(inertia[min(r, c)][max(r, c)] for c in range(3)) for r in range(3))
        bodies.append(
            Body(
                f"b{i}",
                int(rng.integers(0, i)),
                joint,
                vector(rng.uniform(-0.5, 0.5, 3)),
                orientation,
                number(float(rng.uniform(0.5, 3))),
                vector(rng.uniform(-0.3, 0.3, 3)),
                symmetric,  # type: ignore[arg-type]
            )
        )
    place = vector(rng.uniform(-0.5, 0.5, 3))
    sensors = (Sensor("tip", size, place, exact_matrix(random_rotation(rng))),)
    return Tree(f"random{seed}", vector(np.array([0.3, -0.2, -9.81])), tuple(parameters), tuple(bodies), sensors)


def with_wrenches(tree: Tree, seed: int) -> Tree:
    """Pull at random bodies: forces and moments given and open, in the base's components and in the body's."""
    rng = np.random.default_rng(seed + 500)

    def vector() -> Vector:
        return tuple(Float(x) for x in rng.uniform(-5, 5, 3))  # type: ignore[return-value]

    kinds = [
        (True, False, True),
        (True, True, False),
        (False, False, False),
        (False, True, False),
        (True, False, False),
    ]
    wrenches = tuple(
        Wrench(
            f"wrench{k}",
            int(rng.integers(1, len(tree.bodies) + 1)) if k else len(tree.bodies),
            vector(),
            in_base,
            None if force_open else vector(),
            None if moment_open else vector(),
        )
        for k, (in_base, force_open, moment_open) in enumerate(kinds)
    )
    return replace(tree, wrenches=wrenches)


def with_laws(tree: Tree) -> Tree:
    """Add to every other joint a spring, a damper and smoothed dry friction, in numbers and in a parameter."""
    k = Symbol("stiffness")
    law = -k * (COORDINATE - Rational(1, 5)) - 3 * RATE - 2 * tanh(RATE / Rational(1, 10)) + COORDINATE**2 * RATE
    joints = [replace(b.joint, law=law) if i % 2 else b.joint for i, b in enumerate(tree.bodies)]
    bodies = tuple(replace(b, joint=joint) for b, joint in zip(tree.bodies, joints, strict=True))
    kind = tree.parameters[0].kind if tree.parameters else Kind.CONSTANT
    return replace(tree, bodies=bodies, parameters=(*tree.parameters, Parameter("stiffness", k, 7.0, kind)))


def with_rotors(tree: Tree, seed: int) -> Tree:
    """Add an armature to two of three joints, less or more than the inertia they carry; parameters where a tree has
    them.
    """
    rng = np.random.default_rng(seed + 700)
    bodies, parameters = list(tree.bodies), list(tree.parameters)
    for i, body in enumerate(bodies):
        value = float(10 ** rng.uniform(-2, 1))
        if i % 3 == 1:
            continue
        armature = Float(value)
        if tree.parameters:
            armature = Symbol(f"rotor{i}")
            parameters.append(Parameter(armature.name, armature, value, tree.parameters[0].kind))
        bodies[i] = replace(body, joint=replace(body.joint, armature=armature))
    return replace(tree, bodies=tuple(bodies), parameters=tuple(parameters))


def law_forces(tree: Tree, q: Array, qd: Array) -> Array:
    """Evaluate the joints' force laws at the default parameters, by SymPy."""
    table = {p.symbol: p.value for p in tree.parameters}
    laws = [body.joint.law for body in tree.bodies]
    return np.array([law.subs({**table, COORDINATE: a, RATE: b}) for law, a, b in zip(laws, q, qd, strict=True)], float)


def random_rotation(rng: np.random.Generator) -> Array:
    """Draw a rotation matrix."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def random_inertia(rng: np.random.Generator) -> Array:
    """Draw the inertia of a cloud of points: one that a body can have."""
    points = rng.normal(size=(6, 3)) * 0.3
    points -= points.mean(axis=0)
    return sum((p @ p * np.eye(3) - np.outer(p, p) for p in points), np.zeros((3, 3)))


def exact_matrix(m: Array) -> Matrix:
    """Take a matrix of floats into SymPy; 0 and 1 are exact."""
    return tuple(tuple(Integer(int(x)) if x in (0, 1, -1) else Float(x) for x in row) for row in m)  # type: ignore[return-value]


def values_of(tree: Tree) -> list[float]:
    """List the default values of the run-time parameters."""
    return [p.value for p in tree.parameters if p.kind is Kind.RUNTIME]


def floats(tree: Tree, rows: object) -> Array:
    """Evaluate an array of SymPy numbers at the default parameters."""
    table = {p.symbol: p.value for p in tree.parameters}
    return np.array(np.vectorize(lambda x: float(x.xreplace(table)), otypes=[float])(np.array(rows, dtype=object)))


class Pinocchio:
    """The same tree in Pinocchio; joints are added depth-first, as its `crba` needs, and results put in our order."""

    def __init__(self, tree: Tree) -> None:
        import pinocchio as pin

        self._pin, self.tree = pin, tree
        self.model = pin.Model()
        self.model.gravity.linear = floats(tree, tree.gravity)
        kinds = {
            Motion.REVOLUTE: (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ),
            Motion.PRISMATIC: (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ),
        }
        joints = {0: 0}

        def add(i: int) -> None:
            for j in tree.children(i):
                body = tree.bodies[j - 1]
                place = pin.SE3(floats(tree, body.orientation), floats(tree, body.position))
                kind = kinds[body.joint.motion][body.joint.axis]()
                joints[j] = self.model.addJoint(joints[i], kind, place, f"j{j}")
                mass, com = float(floats(tree, [body.mass])[0]), floats(tree, body.com)
                inertia = pin.Inertia(mass, com, floats(tree, body.inertia))
                self.model.appendBodyToJoint(joints[j], inertia, pin.SE3.Identity())
                add(j)

        add(0)
        self.data = self.model.createData()
        self.order = [joints[i] - 1 for i in range(1, len(tree.bodies) + 1)]
        self.model.armature = self._theirs(floats(tree, [body.joint.armature for body in tree.bodies]))

    def _theirs(self, ours: Array) -> Array:
        theirs = np.empty_like(ours)
        theirs[self.order] = ours
        return theirs

    def residual(self, q: Array, qd: Array, qdd: Array, w: Sequence[float] = ()) -> Array:
        """Compute Phi(q, qd, qdd), less the forces that go with the external wrenches; `w` are the open ones."""
        state = (self._theirs(q), self._theirs(qd), self._theirs(qdd))
        return np.array(self._pin.rnea(self.model, self.data, *state, self._external_forces(q, w)))[self.order]

    def _external_forces(self, q: Array, w: Sequence[float]) -> object:
        pin, given = self._pin, iter(w)
        pin.forwardKinematics(self.model, self.data, self._theirs(q))
        forces = pin.StdVec_Force()
        forces.extend([pin.Force.Zero() for _ in self.model.joints])
        for wrench in self.tree.wrenches:
            force, moment = (
                np.array(list(islice(given, 3))) if v is None else floats(self.tree, v)
                for v in (wrench.force, wrench.moment)
            )
            joint = self.order[wrench.body - 1] + 1
            if wrench.in_base:
                force, moment = (self.data.oMi[joint].rotation.T @ v for v in (force, moment))
            moment = moment + np.cross(floats(self.tree, wrench.position), force)
            forces[joint] += pin.Force(force, moment)
        return forces

    def mass_matrix(self, q: Array) -> Array:
        """Compute M(q)."""
        upper = np.triu(self._pin.crba(self.model, self.data, self._theirs(q)))
        M = upper + np.triu(upper, 1).T
        return M[np.ix_(self.order, self.order)]

    def residual_derivatives(self, q: Array, qd: Array, qdd: Array) -> tuple[Array, Array]:
        """Compute the derivatives of Phi by q and by qd."""
        state = (self._theirs(q), self._theirs(qd), self._theirs(qdd))
        self._pin.computeRNEADerivatives(self.model, self.data, *state)
        pick = np.ix_(self.order, self.order)
        return np.array(self.data.dtau_dq)[pick], np.array(self.data.dtau_dv)[pick]

    def acceleration_derivatives(self, q: Array, qd: Array, forces: Array) -> tuple[Array, Array, Array]:
        """Compute the derivatives of qdd by q, by qd and by the joints' forces."""
        state = (self._theirs(q), self._theirs(qd), self._theirs(forces))
        self._pin.computeABADerivatives(self.model, self.data, *state)
        pick = np.ix_(self.order, self.order)
        upper = np.triu(self.data.Minv)
        inverse = upper + np.triu(upper, 1).T
        return np.array(self.data.ddq_dq)[pick], np.array(self.data.ddq_dv)[pick], inverse[pick]


def driven(tree: Tree) -> Tree:
    """Add an actuator to every joint."""
    return replace(tree, bodies=tuple(replace(b, joint=replace(b.joint, actuated=True)) for b in tree.bodies))


def floating(tree: Tree) -> Tree:
    """Set a tree on a floating base: its bodies on the last of three slides and three turns without mass between."""
    zero, one = Integer(0), Integer(1)
    still = (zero, zero, zero)
    unit = ((one, zero, zero), (zero, one, zero), (zero, zero, one))
    base = tuple(
        Body(f"base{k}", k, Joint(f"f{k}", motion, k % 3, True, None, None), still, unit, zero, still, (still,) * 3)
        for k, motion in enumerate((*(Motion.PRISMATIC,) * 3, *(Motion.REVOLUTE,) * 3))
    )
    trunk = replace(base[5], mass=Float(3.0), inertia=tree.bodies[0].inertia, com=tree.bodies[0].com)
    limbs = tuple(replace(b, parent=b.parent + 6) for b in tree.bodies)
    return replace(tree, bodies=(*base[:5], trunk, *limbs), sensors=())
