"""Read the data of a model file, and move its bodies joint by joint: all in the base frame, in any number type.

This is an independent program: it reads the YAML's data, and shares no line with the generator. A rigid body that moves
with a point p, at the velocity v and the angular velocity om, carries a point at the distance d along:

    v_d = v + om x d,    a_d = a + alpha x d + om x (om x d).

A joint adds its own velocity along its axis e, which moves with the body before it: the slide e qd adds e qdd +
2 om x e qd to a, and the turn e qd adds e qdd + om x e qd to alpha.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from decimal import Context, Decimal, localcontext
from types import MappingProxyType
from typing import Any

import numpy as np
from mpmath import MPContext
from numpy.typing import NDArray

Array = NDArray[Any]
Data = Mapping[str, Any]
Values = Mapping[str, Any]  # numbers by name

UNITS = {
    "x": (1.0, 0, 0),
    "y": (0, 1.0, 0),
    "z": (0, 0, 1.0),
    "-x": (-1.0, 0, 0),
    "-y": (0, -1.0, 0),
    "-z": (0, 0, -1.0),
}
NORMALS = {"xy": "z", "xz": "y", "yz": "x"}
OPERATORS = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
_NAMES = ("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sqrt", "exp", "log", "tanh")
_SIXTY = MPContext()
_SIXTY.dps = 60


@dataclass(frozen=True)
class Numbers:
    """A number type: how it is made of a float, and its functions."""

    make: Callable[[Any], Any]
    functions: Mapping[str, Callable[..., Any]]
    pi: Any
    kind: type

    def array(self, values: Any) -> Array:
        """Make an array of numbers of the type."""
        given = np.array(values, dtype=object)
        return np.array([self.make(x) for x in given.ravel()], dtype=self.kind).reshape(given.shape)

    def length(self, vector: Array) -> Any:
        """Return the Euclidean norm."""
        return self.functions["sqrt"](vector @ vector)


def _decimal(name: str) -> Callable[..., Decimal]:
    def apply(*operands: Decimal) -> Decimal:
        return Decimal(_SIXTY.nstr(getattr(_SIXTY, name)(*(_SIXTY.mpf(str(x)) for x in operands)), 60))

    return apply


def _soften(functions: Mapping[str, Callable[..., Any]]) -> dict[str, Callable[..., Any]]:
    """Return smooth switches over other functions, by sums that do not overflow."""
    exp, log = functions["exp"], functions["log"]

    def softplus(x: Any, w: Any) -> Any:
        return w * log(1 + exp(x / w)) if x < 0 else x + w * log(1 + exp(-x / w))

    def step(x: Any, w: Any) -> Any:
        return exp(x / w) / (1 + exp(x / w)) if x < 0 else 1 / (1 + exp(-x / w))

    return {**functions, "softplus": softplus, "step": step, "abs": abs, "max": max, "min": min}


FLOATS = Numbers(float, MappingProxyType(_soften({name: getattr(math, name) for name in _NAMES})), math.pi, float)
DECIMALS = Numbers(
    Decimal,
    MappingProxyType(_soften({name: _decimal(name) for name in _NAMES} | {"sqrt": Decimal.sqrt})),
    Decimal(_SIXTY.nstr(+_SIXTY.pi, 60)),
    object,
)  # within `fifty_digits()`


def fifty_digits() -> AbstractContextManager[Context]:
    """Make `decimal` compute in 50 digits."""
    return localcontext(Context(prec=50))


def value_of(number: Any, names: Values, numbers: Numbers = FLOATS) -> Any:
    """Evaluate a number or an expression of a file."""
    if not isinstance(number, str):
        return numbers.make(number)
    return evaluate(ast.parse(number, mode="eval").body, names, numbers)


def evaluate(node: ast.AST, names: Values, numbers: Numbers) -> Any:
    """Evaluate an expression; a name may have dots."""
    match node:
        case ast.Constant(value=int() | float() as number):
            return numbers.make(number)
        case ast.Name(id="pi"):
            return numbers.pi
        case ast.Name() | ast.Attribute():
            return names[ast.unparse(node)]
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -evaluate(operand, names, numbers)
        case ast.BinOp(left=left, op=op, right=right):
            return OPERATORS[type(op)](evaluate(left, names, numbers), evaluate(right, names, numbers))
        case ast.Call(func=ast.Name(id=name), args=arguments):
            return numbers.functions[name](*(evaluate(x, names, numbers) for x in arguments))
    raise AssertionError(ast.dump(node))


@dataclass(frozen=True)
class Column:
    """The effect of a unit velocity: a slide along an axis, or a turn about it through a point, or both."""

    name: str
    axis: Array
    point: Array | None
    pitch: Any = 0  # of a screw: how far it slides in a turn of 1 rad

    def at(self, place: Array) -> tuple[Array, Array]:
        """Return the velocity of a place and the angular velocity."""
        if self.point is None:
            return self.axis, self.axis * 0
        return np.cross(self.axis, place - self.point) + self.pitch * self.axis, self.axis


@dataclass
class Motion:
    """How a frame stands and moves, in the base frame, and the velocities that move it."""

    p: Array
    R: Array
    v: Array
    om: Array
    a: Array
    alpha: Array
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


def rest(numbers: Numbers) -> Motion:
    """Return the motion of the base."""
    zero = numbers.array([0.0, 0.0, 0.0])
    return Motion(zero, numbers.array(np.eye(3)), zero, zero, zero, zero)


@dataclass(frozen=True)
class Link:
    """A joint that moves: the node before it, the node that it moves, and where the two frames of the joint are."""

    kind: str  # revolute, prismatic, helical, ball or free
    names: tuple[str, ...]  # of its velocities
    axis: Array | None  # in both frames; None: of ball and free
    before: int  # node; 0: the base
    node: int
    carrier: Motion  # of its frame on the node before it
    moved: Motion  # of its frame on its own node, which is the node's frame
    pitch: Any = 0
    q: Any = None  # its coordinate; None: of ball and free


@dataclass
class Moved:
    """All bodies in motion. A node is what one joint moves: a body, or nothing between two joints in a row."""

    bodies: dict[str, Motion]
    nodes: dict[str, int]  # of the bodies
    links: list[Link] = field(default_factory=list)  # link k moves node k + 1


class Kinematics:
    """A model with numbers for its parameters. Coordinates, velocities and accelerations are given by name."""

    def __init__(self, model: Data, names: Values, numbers: Numbers = FLOATS) -> None:
        self.model, self.numbers = model, numbers
        self.names = {name: numbers.make(value) for name, value in names.items()}
        for name, given in model.get("parameters", {}).items():
            value = given["value"] if isinstance(given, dict) else given
            if isinstance(value, str):  # over parameters that stand before it
                self.names[name] = self.number(value)

    def velocities(self) -> list[str]:
        """Name all velocities, also of joints that follow others."""
        found = [name for name, _ in self.elementary()]
        for body in self.model["bodies"]:
            kind = body["joint"]["type"] if isinstance(body["joint"], dict) else ""
            if kind in ("ball", "free"):
                found += _label_velocities(body["name"], is_free=kind == "free")
        return found

    def move(self, q: Values, qd: Values, qdd: Values) -> Moved:
        """Move the bodies."""
        moved = Moved({"base": rest(self.numbers)}, {"base": 0})
        waiting = list(self.model["bodies"])
        while waiting:
            for body in [b for b in waiting if b.get("parent", "base") in moved.bodies]:
                parent = body.get("parent", "base")
                motion, node = moved.bodies[parent], moved.nodes[parent]
                for joint in body["joint"] if isinstance(body["joint"], list) else [body["joint"]]:
                    before, after = _list_places(joint)
                    for place in before:
                        motion = self.place(motion, place)
                    for link in self._join(motion, node, len(moved.links), body, joint, q, qd, qdd):
                        moved.links.append(link)
                        motion, node = link.moved, link.node
                    for place in after:
                        motion = self.place(motion, place)
                moved.bodies[body["name"]], moved.nodes[body["name"]] = motion, node
                waiting.remove(body)
        return moved

    def _join(
        self,
        motion: Motion,
        node: int,
        count: int,
        body: Data,
        joint: Data,
        q: Values,
        qd: Values,
        qdd: Values,
    ) -> Iterator[Link]:
        kind, own = joint["type"], body["name"]
        if kind in ("ball", "free"):
            is_free = kind == "free"
            moved = _float(self.numbers, motion, own, q, qd, qdd, is_free=is_free)
            yield Link(kind, tuple(_label_velocities(own, is_free=is_free)), None, node, count + 1, motion, moved)
            return
        for name, kind, axis in self._steps(body, joint):
            pitch, start = self.number(joint["pitch"]) if kind == "helical" else 0, motion
            if kind == "helical":
                motion = _screw(self.numbers, motion, name, axis, pitch, q[name], qd[name], qdd[name])
            else:
                motion = _step(self.numbers, motion, name, kind, axis, q[name], qd[name], qdd[name])
            count += 1
            yield Link(kind, (name,), axis, node, count, start, motion, pitch, q[name])
            node = count

    def _steps(self, body: Data, joint: Data) -> list[tuple[str, str, Array]]:
        """List the elementary joints of a joint: name, kind, axis."""
        own, kind = body["name"], joint["type"]
        match kind:
            case "revolute" | "prismatic" | "helical":
                return [(joint.get("name", own), kind, self.direction(joint["axis"]))]
            case "dh":
                return [(joint.get("name", own), joint.get("motion", "revolute"), self.direction("z"))]
            case "universal" if "axis" in joint:
                return _label(own, [("revolute", self.direction(joint[key])) for key in ("axis", "axis2")])
            case "cylindrical":
                axis = self.direction(joint["axis"])
                return _label(own, [("revolute", axis), ("prismatic", axis)])
            case "planar" if "normal" in joint:
                normal = self.direction(joint["normal"])
                nearest = self.numbers.array(np.eye(3)[min(range(3), key=lambda k: abs(normal[k]))])
                first = np.cross(normal, np.cross(nearest, normal))
                slides = [("prismatic", self._unit(e)) for e in (first, np.cross(normal, first))]
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
        return _label(own, [(kind, self.direction(x)) for kind, x in kinds])

    def elementary(self) -> Iterator[tuple[str, Data]]:
        """List all elementary joints with their settings."""
        for body in self.model["bodies"]:
            for joint in body["joint"] if isinstance(body["joint"], list) else [body["joint"]]:
                for name, _, _ in self._steps(body, joint):
                    alone = joint["type"] in ("revolute", "prismatic", "helical", "dh")
                    yield name, joint if alone else joint.get("axes", {}).get(name.split(".")[-1], {})

    def law(self, joint: Data, q: Any, qd: Any, state: Values = MappingProxyType({})) -> Any:
        """Return the force of a joint's own law, which may read the state."""
        force = -self.number(joint.get("stiffness", 0.0)) * (q - self.number(joint.get("rest", 0.0)))
        force -= self.number(joint.get("damping", 0.0)) * qd
        if "friction" in joint:
            torque, speed = (self.number(joint["friction"][x]) for x in ("torque", "speed"))
            force -= torque * self.numbers.functions["tanh"](qd / speed)
        if "force" not in joint:
            return force
        return force + value_of(joint["force"], {**self.names, **state, "q": q, "qd": qd}, self.numbers)

    # -- numbers ------------------------------------------------------------------------------------------------------

    def number(self, number: Any) -> Any:
        """Evaluate a number or an expression of the file."""
        return value_of(number, self.names, self.numbers)

    def vector(self, numbers: Any) -> Array:
        """Evaluate three numbers."""
        return np.array([self.number(x) for x in numbers], dtype=self.numbers.kind)

    def direction(self, axis: Any) -> Array:
        """Evaluate an axis, as a unit vector."""
        return self._unit(self.vector(UNITS[axis] if isinstance(axis, str) else axis))

    def inertia(self, body: Data) -> Array:
        """Evaluate the inertia tensor of a body about its centre of mass."""
        given = body.get("inertia", [0, 0, 0])
        if not isinstance(given, dict):
            return np.array(np.diag(self.vector(given)) + self.numbers.array(np.zeros((3, 3))))
        entry = {key: self.number(x) for key, x in given.items() if key != "about"}
        zero = self.numbers.make(0.0)
        rows = [[entry.get("".join(sorted(r + c)), zero) for c in "xyz"] for r in "xyz"]
        tensor = np.array(rows, dtype=self.numbers.kind)
        if "about" not in given:
            return tensor
        cross = skew(self.vector(body.get("com", [0, 0, 0])) - self.vector(given["about"]))
        return np.asarray(tensor + self.number(body.get("mass", 0.0)) * cross @ cross)

    def place(self, motion: Motion, placement: Data) -> Motion:
        """Move on to a frame that is placed in another."""
        motion = motion.carry(self.vector(placement.get("position", [0, 0, 0])))
        return motion.turned(self._turns(placement.get("orientation", [])))

    def _unit(self, vector: Array) -> Array:
        return np.asarray(vector / self.numbers.length(vector))

    def _turns(self, turns: Any) -> Array:
        R = self.numbers.array(np.eye(3))
        match turns:
            case {"rpy": [*angles]}:
                for axis, angle in zip("xyz", angles, strict=True):
                    R = _rotation(self.numbers, self.direction(axis), self.number(angle)) @ R
                return R
            case {"quaternion": [*parts]}:
                return turn_by(self.numbers, *map(self.number, parts))
            case {"matrix": [*rows]}:
                return np.array([self.vector(row) for row in rows])
        for turn in turns:
            R = R @ _rotation(self.numbers, self.direction(turn["axis"]), self.number(turn["angle"]))
        return R


def _list_places(joint: Data) -> tuple[list[Data], list[Data]]:
    """List the placements before a joint and beyond it, in turn: two frames a row of a table, one of other joints."""
    if joint["type"] != "dh":
        return [joint], []
    axis = {"position": [0, 0, joint.get("d", 0)], "orientation": [{"axis": "z", "angle": joint.get("theta", 0)}]}
    link = {"position": [joint.get("a", 0), 0, 0], "orientation": [{"axis": "x", "angle": joint.get("alpha", 0)}]}
    base = {key: joint[key] for key in ("position", "orientation") if key in joint}
    return ([base, axis], [link]) if joint["convention"] == "standard" else ([base, link, axis], [])


def _label_velocities(own: str, *, is_free: bool) -> list[str]:
    return [f"{own}.{x}" for x in (("x", "y", "z") if is_free else ()) + ("rx", "ry", "rz")]


def _label(own: str, steps: list[tuple[str, Array]]) -> list[tuple[str, str, Array]]:
    """Name joints in a row by their motion: t and r where an axis is none of the coordinate axes."""
    found: list[tuple[str, str, Array]] = []
    for kind, axis in steps:
        letters = [x for x, component in zip("xyz", axis, strict=True) if component]
        label = ("r" if kind == "revolute" else "") + (letters[0] if len(letters) == 1 else "") or "t"
        count = sum(name.rstrip("2") == f"{own}.{label}" for name, _, _ in found)
        found.append((f"{own}.{label}{count + 1 if count else ''}", kind, axis))
    return found


def _screw(numbers: Numbers, motion: Motion, name: str, axis: Array, pitch: Any, q: Any, qd: Any, qdd: Any) -> Motion:
    """Slide along an axis and turn about it, by one velocity."""
    moved = _step(numbers, motion, name, "prismatic", axis, pitch * q, pitch * qd, pitch * qdd)
    moved = _step(numbers, moved, name, "revolute", axis, q, qd, qdd)
    moved.columns = (*motion.columns, Column(name, motion.R @ axis, moved.p, pitch))
    return moved


def _step(numbers: Numbers, motion: Motion, name: str, kind: str, axis: Array, q: Any, qd: Any, qdd: Any) -> Motion:
    e = motion.R @ axis
    if kind == "revolute":
        columns = (*motion.columns, Column(name, e, motion.p))
        R, alpha = motion.R @ _rotation(numbers, axis, q), motion.alpha + e * qdd + np.cross(motion.om, e * qd)
        return Motion(motion.p, R, motion.v, motion.om + e * qd, motion.a, alpha, columns)
    moved = motion.carry(axis * q)
    columns = (*motion.columns, Column(name, e, None))
    a = moved.a + e * qdd + 2 * np.cross(motion.om, e * qd)
    return Motion(moved.p, moved.R, moved.v + e * qd, moved.om, a, moved.alpha, columns)


def _float(numbers: Numbers, motion: Motion, own: str, q: Values, qd: Values, qdd: Values, *, is_free: bool) -> Motion:
    """Turn by a quaternion, and move, with velocities along the body's own axes."""
    x, y, z, s = (q[f"{own}.q{k}"] for k in "xyzw")
    R = motion.R @ turn_by(numbers, x, y, z, s)
    place = motion.R @ numbers.array([q[f"{own}.{k}"] for k in "xyz"]) if is_free else numbers.array([0, 0, 0])
    w, wp = (R @ numbers.array([given[f"{own}.r{k}"] for k in "xyz"]) for given in (qd, qdd))
    om, alpha = motion.om + w, motion.alpha + wp + np.cross(motion.om, w)
    v, a, columns, p = motion.v, motion.a, list(motion.columns), motion.p + place
    if is_free:  # it stands on the base
        own_v, own_a = (R @ numbers.array([given[f"{own}.{k}"] for k in "xyz"]) for given in (qd, qdd))
        v, a = own_v, own_a + np.cross(om, own_v)
        columns += [Column(f"{own}.{k}", R[:, i], None) for i, k in enumerate("xyz")]
    columns += [Column(f"{own}.r{k}", R[:, i], p) for i, k in enumerate("xyz")]
    return Motion(p, R, v, om, a, alpha, tuple(columns))


def turn_by(numbers: Numbers, x: Any, y: Any, z: Any, s: Any) -> Array:
    """Return the rotation of a quaternion of any length."""
    v, eye = numbers.array([x, y, z]), numbers.array(np.eye(3))
    return np.asarray(((s * s - v @ v) * eye + 2 * np.outer(v, v) + 2 * s * skew(v)) / (s * s + v @ v))


def skew(v: Array) -> Array:
    """Return the matrix of the cross product by a vector."""
    x, y, z = v
    return np.array([[x * 0, -z, y], [z, x * 0, -x], [-y, x, x * 0]])


def _rotation(numbers: Numbers, axis: Array, angle: Any) -> Array:
    """Turn about a unit vector (Rodrigues)."""
    cross, sin, cos = skew(axis), numbers.functions["sin"](angle), numbers.functions["cos"](angle)
    return np.asarray(numbers.array(np.eye(3)) + sin * cross + (1 - cos) * cross @ cross)
