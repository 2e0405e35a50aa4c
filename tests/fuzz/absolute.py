"""Equations of motion of a model file by virtual power: all bodies in absolute coordinates, in the base frame.

This is an independent program: it reads the YAML's data, and shares no line with the generator. Each body's motion is
summed joint by joint, and its inertial force and moment (m (a - g); I alpha + om x I om) are applied to every joint
before it:

    Phi_j = sum of m (a - g) . dv/dqd_j + (I alpha + om x I om) . dom/dqd_j, less the wrenches' power at unit speed.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Data = Mapping[str, Any]

UNITS = {
    "x": (1.0, 0, 0),
    "y": (0, 1.0, 0),
    "z": (0, 0, 1.0),
    "-x": (-1.0, 0, 0),
    "-y": (0, -1.0, 0),
    "-z": (0, 0, -1.0),
}
_OPERATORS = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
NORMALS = {"xy": "z", "xz": "y", "yz": "x"}


def value_of(number: Any, names: Mapping[str, float]) -> float:
    """Evaluate a number or an expression of a file."""
    return float(number) if isinstance(number, int | float) else _evaluate(ast.parse(number, mode="eval").body, names)


def _evaluate(node: ast.AST, names: Mapping[str, float]) -> float:
    match node:
        case ast.Constant(value=int() | float() as number):
            return float(number)
        case ast.Name(id=name):
            return math.pi if name == "pi" else names[name]
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -_evaluate(operand, names)
        case ast.BinOp(left=left, op=op, right=right):
            return float(_OPERATORS[type(op)](_evaluate(left, names), _evaluate(right, names)))
        case ast.Call(func=ast.Name(id=name), args=arguments):
            return float(getattr(math, name)(*(_evaluate(x, names) for x in arguments)))
    raise AssertionError(ast.dump(node))


@dataclass(frozen=True)
class Column:
    """The effect of a unit velocity: a slide along an axis, or a turn about it through a point, or both."""

    name: str
    axis: Array
    point: Array | None
    pitch: float = 0.0  # of a screw: how far it slides in a turn of 1 rad

    def at(self, place: Array) -> tuple[Array, Array]:
        """Return the velocity of a place and the angular velocity."""
        if self.point is None:
            return self.axis, np.zeros(3)
        return np.cross(self.axis, place - self.point) + self.pitch * self.axis, self.axis


@dataclass
class Motion:
    """How a frame stands and moves, in the base frame, and the velocities that move it."""

    p: Array = field(default_factory=lambda: np.zeros(3))
    R: Array = field(default_factory=lambda: np.eye(3))
    v: Array = field(default_factory=lambda: np.zeros(3))
    om: Array = field(default_factory=lambda: np.zeros(3))
    a: Array = field(default_factory=lambda: np.zeros(3))
    alpha: Array = field(default_factory=lambda: np.zeros(3))
    columns: tuple[Column, ...] = ()

    def carry(self, r: Array) -> Motion:
        """Move on to a point that is fixed in the frame: r in its axes."""
        d = self.R @ r
        v = self.v + np.cross(self.om, d)
        a = self.a + np.cross(self.alpha, d) + np.cross(self.om, np.cross(self.om, d))
        return Motion(self.p + d, self.R, v, self.om, a, self.alpha, self.columns)

    def turned(self, R: Array) -> Motion:
        """Take other axes, which stand still in the frame."""
        return Motion(self.p, self.R @ R, self.v, self.om, self.a, self.alpha, self.columns)


@dataclass(frozen=True)
class Found:
    """The joint forces, by name; and energies."""

    Phi: dict[str, float]
    size: float  # of the largest sum of magnitudes that an entry of Phi is
    Q: dict[str, float]  # without u
    kinetic: float
    potential: float
    pull: float  # power of the wrenches
    frames: dict[str, Motion]


class Absolute:
    """A model with numbers for its parameters. Coordinates, velocities and accelerations are given by name."""

    def __init__(self, model: Data, names: Mapping[str, float], *, gravity: bool = True) -> None:
        self.model, self.names = model, names
        self.gravity = self._vector(model["gravity"]) if gravity else np.zeros(3)

    def run(
        self, q: Mapping[str, float], qd: Mapping[str, float], qdd: Mapping[str, float], w: Mapping[str, Array]
    ) -> Found:
        """Evaluate at a state of all joints. `w` holds `NAME.force` and `NAME.moment` of wrenches that are inputs."""
        bodies = self._move(q, qd, qdd)
        Phi, sizes, Q = (dict.fromkeys(qd, 0.0) for _ in range(3))
        kinetic = potential = pull = 0.0

        def hook(motion: Motion, F: Array, N: Array) -> None:
            for column in motion.columns:
                parts = [x @ y for x, y in zip((F, N), column.at(motion.p), strict=True)]
                Phi[column.name] += sum(parts)
                sizes[column.name] += sum(map(abs, parts))

        for body in self.model["bodies"]:
            mass = self._number(body.get("mass", 0.0))
            motion = bodies[body["name"]].carry(self._vector(body.get("com", [0, 0, 0])))
            inertia = motion.R @ self._inertia(body.get("inertia", [0, 0, 0])) @ motion.R.T
            hook(
                motion,
                mass * (motion.a - self.gravity),
                inertia @ motion.alpha + np.cross(motion.om, inertia @ motion.om),
            )
            kinetic += (mass * motion.v @ motion.v + motion.om @ inertia @ motion.om) / 2
            potential -= mass * self.gravity @ motion.p
        for wrench in self.model.get("wrenches", ()):
            motion = bodies[wrench["body"]].carry(self._vector(wrench.get("position", [0, 0, 0])))
            force, moment = (self._components(wrench, key, w) for key in ("force", "moment"))
            if wrench.get("frame", "base") == "body":
                force, moment = motion.R @ force, motion.R @ moment
            hook(motion, -force, -moment)
            pull += force @ motion.v + moment @ motion.om
        for name, joint in self._elementary():
            rotor = self._number(joint.get("armature", 0.0))
            Phi[name] += rotor * qdd[name]
            sizes[name] += abs(rotor * qdd[name])
            kinetic += rotor * qd[name] ** 2 / 2
            Q[name] = self._law(joint, q[name], qd[name])
        frames = {
            f["name"]: bodies[f["body"]].carry(self._vector(f.get("position", [0, 0, 0])))
            for f in self.model.get("frames", ())
        }
        return Found(Phi, max(sizes.values()), Q, kinetic, potential, pull, frames)

    def velocities(self) -> list[str]:
        """Name all velocities, also of joints that follow others."""
        found = [name for name, _ in self._elementary()]
        for body in self.model["bodies"]:
            kind = body["joint"]["type"] if isinstance(body["joint"], dict) else ""
            if kind in ("ball", "free"):
                found += [
                    f"{body['name']}.{x}" for x in (("x", "y", "z") if kind == "free" else ()) + ("rx", "ry", "rz")
                ]
        return found

    # -- motion -------------------------------------------------------------------------------------------------------

    def _move(self, q: Mapping[str, float], qd: Mapping[str, float], qdd: Mapping[str, float]) -> dict[str, Motion]:
        bodies = {"base": Motion()}
        waiting = list(self.model["bodies"])
        while waiting:
            for body in [b for b in waiting if b.get("parent", "base") in bodies]:
                motion = bodies[body.get("parent", "base")]
                for joint in body["joint"] if isinstance(body["joint"], list) else [body["joint"]]:
                    motion = motion.carry(self._vector(joint.get("position", [0, 0, 0])))
                    motion = motion.turned(self._turns(joint.get("orientation", [])))
                    motion = self._join(motion, body, joint, q, qd, qdd)
                bodies[body["name"]] = motion
                waiting.remove(body)
        return bodies

    def _join(
        self,
        motion: Motion,
        body: Data,
        joint: Data,
        q: Mapping[str, float],
        qd: Mapping[str, float],
        qdd: Mapping[str, float],
    ) -> Motion:
        if joint["type"] in ("ball", "free"):
            return _float(motion, body["name"], q, qd, qdd, is_free=joint["type"] == "free")
        for name, kind, axis in self._steps(body, joint):
            if kind == "helical":
                pitch = self._number(joint["pitch"])
                motion = _screw(motion, name, axis, pitch, q[name], qd[name], qdd[name])
                continue
            motion = _step(motion, name, kind, axis, q[name], qd[name], qdd[name])
        return motion

    def _steps(self, body: Data, joint: Data) -> list[tuple[str, str, Array]]:
        """List the elementary joints of a joint: name, kind, axis."""
        own, kind = body["name"], joint["type"]
        match kind:
            case "revolute" | "prismatic" | "helical":
                return [(joint.get("name", own), kind, self._direction(joint["axis"]))]
            case "universal" if "axis" in joint:
                return _label(own, [("revolute", self._direction(joint[key])) for key in ("axis", "axis2")])
            case "cylindrical":
                axis = self._direction(joint["axis"])
                return _label(own, [("revolute", axis), ("prismatic", axis)])
            case "planar" if "normal" in joint:
                normal = self._direction(joint["normal"])
                nearest = np.eye(3)[np.argmin(np.abs(normal))]
                first = np.cross(normal, np.cross(nearest, normal))
                slides = [("prismatic", e / np.linalg.norm(e)) for e in (first, np.cross(normal, first))]
                return _label(own, [*slides, ("revolute", normal)])
            case "cardan" | "universal" | "spherical":
                slides, turns = "", joint["order"]
            case "planar":
                slides, turns = joint["plane"], NORMALS[joint["plane"]]
            case "floating":
                slides, turns = "xyz", joint["order"]
            case _:
                return []
        kinds = [("prismatic", x) for x in slides] + [("revolute", x) for x in turns]
        return _label(own, [(kind, self._direction(x)) for kind, x in kinds])

    def _elementary(self) -> Iterator[tuple[str, Data]]:
        """List all elementary joints with their settings."""
        for body in self.model["bodies"]:
            for joint in body["joint"] if isinstance(body["joint"], list) else [body["joint"]]:
                for name, _, _ in self._steps(body, joint):
                    alone = joint["type"] in ("revolute", "prismatic", "helical")
                    yield name, joint if alone else joint.get("axes", {}).get(name.split(".")[-1], {})

    def _law(self, joint: Data, q: float, qd: float) -> float:
        force = -self._number(joint.get("stiffness", 0.0)) * (q - self._number(joint.get("rest", 0.0)))
        force -= self._number(joint.get("damping", 0.0)) * qd
        if "friction" in joint:
            torque, speed = (self._number(joint["friction"][x]) for x in ("torque", "speed"))
            force -= torque * math.tanh(qd / speed)
        return force + (value_of(joint["force"], {**self.names, "q": q, "qd": qd}) if "force" in joint else 0.0)

    # -- numbers ------------------------------------------------------------------------------------------------------

    def _number(self, number: Any) -> float:
        return value_of(number, self.names)

    def _direction(self, axis: Any) -> Array:
        e = np.array(UNITS[axis], float) if isinstance(axis, str) else self._vector(axis)
        return np.asarray(e / np.linalg.norm(e))

    def _vector(self, numbers: Any) -> Array:
        return np.array([self._number(x) for x in numbers])

    def _inertia(self, given: Any) -> Array:
        if not isinstance(given, dict):
            return np.diag(self._vector(given))
        entry = {key: self._number(x) for key, x in given.items()}
        return np.array([[entry.get("".join(sorted(r + c)), 0.0) for c in "xyz"] for r in "xyz"])

    def _turns(self, turns: Any) -> Array:
        R = np.eye(3)
        for turn in turns:
            R = R @ _rotation(np.array(UNITS[turn["axis"]], float), self._number(turn["angle"]))
        return R

    def _components(self, wrench: Data, key: str, w: Mapping[str, Array]) -> Array:
        given = wrench.get(key, [0, 0, 0])
        return w[f"{wrench['name']}.{key}"] if given == "input" else self._vector(given)


def _label(own: str, steps: list[tuple[str, Array]]) -> list[tuple[str, str, Array]]:
    """Name joints in a row by their motion: t and r where an axis is none of the coordinate axes."""
    found: list[tuple[str, str, Array]] = []
    for kind, axis in steps:
        letters = [x for x, component in zip("xyz", axis, strict=True) if component]
        label = ("r" if kind == "revolute" else "") + (letters[0] if len(letters) == 1 else "") or "t"
        count = sum(name.rstrip("2") == f"{own}.{label}" for name, _, _ in found)
        found.append((f"{own}.{label}{count + 1 if count else ''}", kind, axis))
    return found


def _screw(motion: Motion, name: str, axis: Array, pitch: float, q: float, qd: float, qdd: float) -> Motion:
    """Slide along an axis and turn about it, by one velocity."""
    moved = _step(motion, name, "prismatic", axis, pitch * q, pitch * qd, pitch * qdd)
    moved = _step(moved, name, "revolute", axis, q, qd, qdd)
    moved.columns = (*motion.columns, Column(name, motion.R @ axis, moved.p, pitch))
    return moved


def _step(motion: Motion, name: str, kind: str, axis: Array, q: float, qd: float, qdd: float) -> Motion:
    e = motion.R @ axis
    if kind == "revolute":
        columns = (*motion.columns, Column(name, e, motion.p))
        alpha = motion.alpha + e * qdd + np.cross(motion.om, e * qd)
        return Motion(motion.p, motion.R @ _rotation(axis, q), motion.v, motion.om + e * qd, motion.a, alpha, columns)
    moved = motion.carry(axis * q)
    columns = (*motion.columns, Column(name, e, None))
    a = moved.a + e * qdd + 2 * np.cross(motion.om, e * qd)
    return Motion(moved.p, moved.R, moved.v + e * qd, moved.om, a, moved.alpha, columns)


def _float(
    motion: Motion,
    own: str,
    q: Mapping[str, float],
    qd: Mapping[str, float],
    qdd: Mapping[str, float],
    *,
    is_free: bool,
) -> Motion:
    """Turn by a quaternion, and move, with velocities along the body's own axes."""
    x, y, z, s = (q[f"{own}.q{k}"] for k in "xyzw")
    length = math.sqrt(x * x + y * y + z * z + s * s)
    angle = 2 * math.atan2(math.sqrt(x * x + y * y + z * z), s)
    R = motion.R @ _rotation(np.array([x, y, z]) / math.sqrt(x * x + y * y + z * z), angle)
    assert length > 0
    place = motion.R @ np.array([q[f"{own}.{k}"] for k in "xyz"]) if is_free else np.zeros(3)
    w, wp = (R @ np.array([given[f"{own}.r{k}"] for k in "xyz"]) for given in (qd, qdd))
    om, alpha = motion.om + w, motion.alpha + wp + np.cross(motion.om, w)
    v, a, columns, p = motion.v, motion.a, list(motion.columns), motion.p + place
    if is_free:  # it stands on the base
        own_v, own_a = (R @ np.array([given[f"{own}.{k}"] for k in "xyz"]) for given in (qd, qdd))
        v, a = own_v, own_a + np.cross(om, own_v)
        columns += [Column(f"{own}.{k}", R[:, i], None) for i, k in enumerate("xyz")]
    columns += [Column(f"{own}.r{k}", R[:, i], p) for i, k in enumerate("xyz")]
    return Motion(p, R, v, om, a, alpha, tuple(columns))


def _rotation(axis: Array, angle: float) -> Array:
    """Turn about a unit vector (Rodrigues)."""
    x, y, z = axis
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + math.sin(angle) * skew + (1 - math.cos(angle)) * skew @ skew)
