"""Equations of motion of a mechanism with loops: all bodies free, all joints and loops as equations with multipliers.

This is an independent program: it reads the YAML's data, and shares no line with the generator. Every body has six
velocities V (of its joint's point, and angular, in the base frame). Joints, loops, constraints, couplings and driven
joints are equations f = 0 of the bodies' motion, in words of geometry: the second axis stays across the first one. With
fdd = G Vd + b, Newton's and Euler's equations are (Haug, 1989, section 11.2)

    A Vd - G^T lambda = F(V),    G Vd = -b,

in 50 digits, by an LU factorisation in float64 and iterative refinement.

Loops and constraints also have a Jacobian in the joints' coordinates, J = G S, with the bodies' velocities S of unit
joint velocities. Newton's method on it closes the loops, and projections on it make velocities consistent.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import lu_factor, lu_solve, qr

from tests.fuzz.forces import Applied, Forces
from tests.fuzz.jets import SLOPES, Jet, dot, evaluate_jet
from tests.fuzz.kinematics import (
    DECIMALS,
    Array,
    Data,
    Kinematics,
    Link,
    Motion,
    Moved,
    Numbers,
    Values,
    rest,
    skew,
    turn_by,
)

SYNONYMS = {"revolute": "hinge", "spherical": "ball", "fixed": "solid"}
RANK = 1e-9  # of the largest singular value: smaller ones are 0
STEPS = 60  # of Newton's method
LONGEST = 0.3  # of its steps [rad or m]


class OpenLoopError(Exception):
    """Newton's method does not close the loops."""


@dataclass(frozen=True)
class Closure:
    """The equations of loops, then of constraints, in the joints' coordinates."""

    h: Array
    hd: Array
    hdd: Array
    J: Array
    gamma: Array


@dataclass(frozen=True)
class Solution:
    """A motion that obeys all equations."""

    qdd: dict[str, Any]  # of all joints' velocities
    lam: Array  # of the kept equations
    tau: dict[str, Any]  # forces of the driven joints
    bodies: dict[str, Motion]  # with their accelerations


@dataclass(frozen=True)
class _Frame:
    """A frame on a body, its origin and axes as jets."""

    origin: Array
    axes: tuple[Array, Array, Array]


class FreeBodies(Kinematics):
    """A model with numbers for its parameters, in a scene; states are given by the names of joints with coordinates."""

    def __init__(
        self,
        model: Data,
        names: Values,
        numbers: Numbers = DECIMALS,
        scene: Data | None = None,
        *,
        gravity: bool = True,
    ) -> None:
        """Take a model, its parameters, a number type, and a scene."""
        super().__init__(model, names, numbers)
        self.scene = scene or {}
        self.gravity = self.vector(model["gravity"] if gravity and self.scene.get("gravity", True) else [0, 0, 0])
        self.locked = {name: self.number(x) for name, x in self.scene.get("locked", {}).items()}
        self.follows = {
            joint["name"]: joint["follows"]
            for body in model["bodies"]
            for joint in (body["joint"] if isinstance(body["joint"], list) else [body["joint"]])
            if "follows" in joint
        }
        self.driven = [name for name in model.get("driven", ()) if name not in self.locked]
        self.names_of_velocities = [x for x in self.velocities() if x not in self.follows and x not in self.locked]

    @property
    def names_of_coordinates(self) -> list[str]:
        """Name the coordinates of joints that have any, quaternions among them."""
        quaternions = [x for x in self.names_of_velocities if self._is_of_quaternion(x)]
        found = [x for x in self.names_of_velocities if x not in quaternions or x[-2] == "."]
        own = dict.fromkeys(x.rpartition(".")[0] for x in quaternions)
        return found + [f"{name}.q{k}" for name in own for k in "xyzw"]

    # -- joints that follow others, or are locked ----------------------------------------------------------------------

    def lead(self, name: str) -> tuple[dict[str, Any], Any]:
        """Follow a joint to the ones that it follows in the end: their ratios by name, the offset."""
        if name not in self.follows:
            return {name: self.numbers.make(1.0)}, self.numbers.make(0.0)
        found: dict[str, Any] = {}
        offset = self.number(self.follows[name].get("offset", 0.0))
        for joint, ratio in self._rule(name).items():
            leaders, start = self.lead(joint)
            for leader, slope in leaders.items():
                found[leader] = found.get(leader, self.numbers.make(0.0)) + ratio * slope
            offset += ratio * start
        return found, offset

    def _rule(self, name: str) -> dict[str, Any]:
        """Return the ratios of the joints that a joint follows by its own rule; `more` has the others of a sum."""
        given = self.follows[name]
        ratios = {given["joint"]: given.get("ratio", 1.0), **given.get("more", {})}
        return {joint: self.number(ratio) for joint, ratio in ratios.items()}

    def fill(self, q: Values) -> dict[str, Any]:
        """Return the coordinates of all joints, from the coordinates of the joints that follow no other."""
        found = {name: self.numbers.make(x) for name, x in q.items()}
        for name in self.velocities():
            leaders, offset = self.lead(name)
            if all(leader in self.locked or leader in q for leader in leaders):
                found[name] = offset + sum(
                    ratio * self.locked.get(leader, self.numbers.make(q.get(leader, 0.0)))
                    for leader, ratio in leaders.items()
                )
        return found

    def fill_rates(self, qd: Values) -> dict[str, Any]:
        """Return the velocities of all joints, or the accelerations."""
        found = {}
        for name in self.velocities():
            leaders, zero = self.lead(name)[0], self.numbers.make(0.0)
            rates = (ratio * self.numbers.make(qd[x]) for x, ratio in leaders.items() if x not in self.locked)
            found[name] = sum(rates, start=zero)
        return found

    def fold(self, shares: Mapping[str, Any], size: tuple[int, ...] = ()) -> Array:
        """Sum the shares of all joints' velocities, for the joints that have coordinates: an entry (last) for each."""
        order = {name: k for k, name in enumerate(self.names_of_velocities)}
        found = self.numbers.array(np.zeros((*size, len(order))))
        for name, share in shares.items():
            for leader, ratio in self.lead(name)[0].items():
                if leader in order:
                    found[..., order[leader]] += ratio * share
        return found

    # -- loops --------------------------------------------------------------------------------------------------------

    def close_over(self, q: Values, qd: Values, qdd: Values) -> Closure:
        """Evaluate the equations of loops and constraints at a state, which may be open."""
        rates = self.fill_rates(qd)
        still = self.move(self.fill(q), rates, dict.fromkeys(rates, self.numbers.make(0.0)))
        jets, S = self._equations(still), self._unit_motions(still)
        biases = self._stack(still, "a", "alpha")
        J = self._rows([jet.gradient for jet in jets], len(S)) @ S
        gamma = self._numbers(jet.bias + jet.gradient @ biases for jet in jets)
        accelerations = self._numbers(qdd[name] for name in self.names_of_velocities)
        return Closure(
            self._numbers(jet.value for jet in jets),
            self._numbers(jet.rate for jet in jets),
            J @ accelerations + gamma,
            J,
            gamma,
        )

    def jacobian(self, q: Values) -> tuple[Array, Array]:
        """Return h and J."""
        still = dict.fromkeys(self.names_of_velocities, 0.0)
        found = self.close_over(q, still, still)
        return found.h, found.J

    def close(self, q: Values, fixed: Collection[str] = (), within: float = 1e-45) -> dict[str, Any]:
        """Change coordinates, except fixed ones, until all loops are closed. Raises OpenLoopError."""
        free = [k for k, name in enumerate(self.names_of_velocities) if name not in fixed]
        found = {name: self.numbers.make(x) for name, x in q.items()}
        left: list[float] = []
        for _ in range(STEPS):
            h, J = self.jacobian(found)
            left.append(float(abs(h).max(initial=0)))
            if left[-1] <= within or (left[-1] < 1e-13 and len(left) > 3 and left[-1] >= left[-3] > 0):
                return found
            if not left[-1] < 1e6:
                break
            step = self.numbers.array(np.zeros(len(self.names_of_velocities)))
            step[free] = -(self._pseudoinverse(J[:, free]) @ h)
            size = float(abs(step).max(initial=0))
            found = self.advance(found, step * self.numbers.make(min(1.0, LONGEST / max(size, LONGEST))))
        raise OpenLoopError(f"h = {left[-1]:.1e} is left")

    def advance(self, q: Values, step: Sequence[Any] | Array) -> dict[str, Any]:
        """Move on by a step of the velocities of the joints that have coordinates."""
        change, found = dict(zip(self.names_of_velocities, step, strict=True)), dict(q)
        for body in self.model["bodies"]:
            kind = body["joint"]["type"] if isinstance(body["joint"], dict) else ""
            if kind in ("ball", "free"):
                found |= self._advance_quaternion(body["name"], found, change, is_free=kind == "free")
        for name in change:
            if name in found and not self._is_of_quaternion(name):
                found[name] += change[name]
        return found

    def make_consistent(self, J: Array, rates: Array, right: Array | None = None) -> Array:
        """Return the nearest rates that obey J x = right (0 where it is not given)."""
        inverse, right = self._pseudoinverse(J), J @ rates * 0 if right is None else right
        for _ in range(8):
            rates = rates + inverse @ (right - J @ rates)
        return rates

    def names_of_equations(self) -> list[tuple[str, str]]:
        """Name the loops and constraints that the entries of h belong to, and the equations."""
        counts = {
            "rod": ("distance",),
            "ball": ("x", "y", "z"),
            "hinge": ("x", "y", "z", "turn_x", "turn_y"),
            "universal": ("x", "y", "z", "angle"),
            "cylindrical": ("x", "y", "turn_x", "turn_y"),
            "helical": ("x", "y", "turn_x", "turn_y", "screw"),
            "prismatic": ("x", "y", "turn_x", "turn_y", "turn_z"),
            "planar": ("z", "turn_x", "turn_y"),
            "solid": ("x", "y", "z", "turn_x", "turn_y", "turn_z"),
        }
        loops = [(x["name"], SYNONYMS.get(x["type"], x["type"])) for x in self.model.get("loops", ())]
        names = [(name, equation) for name, kind in loops for equation in counts[kind]]
        return names + [(x["name"], "equation") for x in self.model.get("constraints", ())]

    def climb(self, moved: Moved, node: int) -> list[int]:
        """List the nodes from one to the base, without the nodes that a locked joint carries."""
        found = []
        while node:
            link = moved.links[node - 1]
            if not self.lead(link.names[0])[0].keys() <= self.locked.keys():
                found.append(node)
            node = link.before
        return [*found, 0]

    # -- motion -------------------------------------------------------------------------------------------------------

    def solve(
        self,
        q: Values,
        qd: Values,
        u: Values,
        w: Values,
        drive: Values | None = None,
        kept: Iterable[int] | None = None,
    ) -> Solution:
        """Return accelerations and forces. `drive`: accelerations of driven joints; `kept`: of the entries of h."""
        at, rates = self.fill(q), self.fill_rates(qd)
        zero = self.numbers.make(0.0)
        moved = self.move(at, rates, dict.fromkeys(rates, zero))
        own = {name: jet for link in moved.links for name, jet in self._own(moved, link).items()}
        forces = Forces(self, moved.bodies, at, rates, w)
        A, F = self._newton(moved, forces.list_applied(w))
        laws = dict(self.elementary())
        for name, jet in own.items():
            force = zero if name in self.follows else self.numbers.make(u.get(name, 0.0))
            if name in laws:
                rotor = self.number(laws[name].get("armature", 0.0))
                force += self.law(laws[name], at[name], rates[name], forces.names) - rotor * jet.bias
                if rotor:
                    A += rotor * np.outer(jet.gradient, jet.gradient)
            F += jet.gradient * force
        loops = self._equations(moved)
        loops = [loops[k] for k in (range(len(loops)) if kept is None else kept)]
        driven = {name: own[name] - self.numbers.make((drive or {})[name]) for name in self.driven}
        ties = [jet for link in moved.links for jet in self._joint(moved, link)]
        for name in self.follows:
            rule = [-ratio * own[joint] for joint, ratio in self._rule(name).items()]
            ties.append(sum(rule, start=own[name]))
        ties += [own[name] for name in self.locked]
        G = self._rows([jet.gradient for jet in (*loops, *driven.values(), *ties)], len(A))
        given = [self.numbers.make((drive or {})[name]) for name in driven]
        b = self._numbers(
            [jet.bias for jet in loops]
            + [jet.bias - a for jet, a in zip(driven.values(), given, strict=True)]
            + [jet.bias for jet in ties]
        )
        size = len(A)
        found = self._solve(A, G, F, b)
        motion = found[:size]
        bodies = {name: self._accelerated(moved, name, motion) for name in moved.bodies}
        lam, tau = found[size : size + len(loops)], found[size + len(loops) : size + len(loops) + len(driven)]
        qdd = {name: jet.gradient @ motion + jet.bias for name, jet in own.items()}
        return Solution(qdd, lam, dict(zip(driven, tau, strict=True)), bodies)

    def _newton(self, moved: Moved, applied: Iterable[Applied]) -> tuple[Array, Array]:
        """Return A and F: inertias, and all forces except joint forces."""
        size = 6 * len(moved.links)
        A, F = self.numbers.array(np.zeros((size, size))), self.numbers.array(np.zeros(size))
        for body in self.model["bodies"]:
            node = moved.nodes[body["name"]]
            if not node:
                continue
            motion, mass = moved.bodies[body["name"]], self.number(body.get("mass", 0.0))
            d, velocity, turn = self._point(moved, node, motion.R @ self.vector(body.get("com", [0, 0, 0])) + motion.p)
            inertia = motion.R @ self.inertia(body) @ motion.R.T
            om = motion.om
            A += mass * velocity.T @ velocity + turn.T @ inertia @ turn
            F += mass * (self.gravity - np.cross(om, np.cross(om, d))) @ velocity
            F -= np.cross(om, inertia @ om) @ turn
        for x in applied:
            if node := moved.nodes[x.body]:
                _, velocity, turn = self._point(moved, node, x.motion.p)
                F += x.force @ velocity + x.moment @ turn
        return A, F

    def _accelerated(self, moved: Moved, name: str, motion: Array) -> Motion:
        """Return the motion of a body with the accelerations that were found."""
        node, body = moved.nodes[name], moved.bodies[name]
        if not node:
            return body
        d, velocity, turn = self._point(moved, node, body.p)
        a = velocity @ motion + np.cross(body.om, np.cross(body.om, d))
        return Motion(body.p, body.R, body.v, body.om, a, turn @ motion, body.columns)

    def _solve(self, A: Array, G: Array, F: Array, b: Array) -> Array:
        """Solve A x - G^T y = F, G x = -b, in the digits of the numbers."""
        zero = self.numbers.array(np.zeros((len(G), len(G))))
        matrix, right = np.block([[A, -G.T], [G, zero]]), np.concatenate([F, -b])
        scale = 1 / np.maximum(abs(matrix.astype(float)).max(axis=1), 1e-30)
        factors = lu_factor(matrix.astype(float) * scale[:, None])
        found, last = right * 0, np.inf
        rest = right
        for _ in range(STEPS):
            size = float(abs(rest).max(initial=0))
            if not size or size >= last / 2:
                break
            last, unit = size, self.numbers.make(size)
            step = lu_solve(factors, (rest / unit).astype(float) * scale)
            found = found + unit * self.numbers.array(step)
            rest = right - matrix @ found
        if not last <= 1e-9 * max(1.0, float(abs(right).max(initial=0))):
            raise ZeroDivisionError(f"the equations of motion are singular: {last:.1e} is left")
        return found

    # -- equations ----------------------------------------------------------------------------------------------------

    def _equations(self, moved: Moved) -> list[Jet]:
        """List the equations of loops, then of constraints."""
        found: list[Jet] = []
        for loop in self.model.get("loops", ()):
            found += self._cut(moved, loop)
        own = {
            name: jet for link in moved.links for name, jet in self._own(moved, link).items() if jet.value is not None
        }
        for constraint in self.model.get("constraints", ()):
            found.append(evaluate_jet(str(constraint["equation"]), {**self.names, **own}, self.numbers))
        return found

    def _cut(self, moved: Moved, loop: Data) -> list[Jet]:
        kind = SYNONYMS.get(loop["type"], loop["type"])
        axis, axis2 = (self.direction(loop.get(key, unit)) for key, unit in (("axis", "z"), ("axis2", "x")))
        first, second = (
            self._end(moved, loop[key], along)
            for key, along in (("from", axis), ("to", axis2 if kind == "universal" else axis))
        )
        d = second.origin - first.origin
        (x1, y1, z1), (x2, _, z2) = first.axes, second.axes
        gap = [dot(d, axis) for axis in self._find_measure(moved, loop)]
        aligned = [dot(x1, z2), dot(y1, z2)]
        match kind:
            case "rod":
                length = self.number(loop["length"])
                return [(dot(d, d) - length * length) / (2 * length)]
            case "ball":
                return gap
            case "hinge":
                return [*gap, *aligned]
            case "universal":
                return [*gap, dot(z1, z2) - axis @ axis2]
            case "cylindrical":
                return [dot(d, x1), dot(d, y1), *aligned]
            case "helical":
                pitch = self.number(loop["pitch"])
                shift = dot(d, z1) / pitch
                s, c = (shift.apply(*SLOPES[name](shift.value, self.numbers.functions)) for name in ("sin", "cos"))
                sine, cosine = s * dot(x1, x2) - c * dot(y1, x2), c * dot(x1, x2) + s * dot(y1, x2)
                return [dot(d, x1), dot(d, y1), *aligned, 2 * pitch * (sine / (1 + cosine))]
            case "prismatic":
                return [dot(d, x1), dot(d, y1), *aligned, dot(y1, x2)]
            case "planar":
                return [dot(d, z1), *aligned]
        assert kind == "solid"
        return [*gap, *aligned, dot(y1, x2)]

    def _find_measure(self, moved: Moved, loop: Data) -> list[Array]:
        """Return the axes of the last body that carries both ends of a loop."""
        one, other = (self.climb(moved, moved.nodes[loop[key].get("body", "base")]) for key in ("from", "to"))
        node = next(node for node in one if node in other)
        if not node:
            start = rest(self.numbers)
            return [self._direction(moved, start, 0, e) for e in start.R.T]
        link = moved.links[node - 1]
        return [self._direction(moved, link.moved, node, e) for e in link.moved.R.T]

    def _end(self, moved: Moved, end: Data, axis: Array) -> _Frame:
        name = end.get("body", "base")
        motion, node = self.place(moved.bodies[name], end), moved.nodes[name]
        return self._frame(moved, motion.turned(self._align(axis)), node)

    def _align(self, axis: Array) -> Array:
        """Return axes of which z is a given unit vector.

        The nearest coordinate axis, or its opposite, is turned onto it on the shortest way; the coordinate axes that
        follow it become x and y. Before that, a half turn (about z, x, x) leads from x, y, z to its opposite.
        """
        k = max(range(3), key=lambda r: (abs(axis[r]), -r))
        half = np.ones(3) if axis[k] > 0 else -np.ones(3)
        if axis[k] < 0:
            half[[2, 0, 0][k]] = 1.0
        near = self.numbers.array(np.diag(half))
        start = near[:, k]
        v, c = np.cross(start, axis), start @ axis
        turn = self.numbers.array(np.eye(3)) + skew(v) + skew(v) @ skew(v) / (1 + c)
        return (turn @ near)[:, [(k + 1) % 3, (k + 2) % 3, k]]

    def _joint(self, moved: Moved, link: Link) -> list[Jet]:
        """List the equations that a joint adds: what it keeps together."""
        if link.kind == "free":
            return []
        turn = self.numbers.array(np.eye(3)) if link.axis is None else self._align(link.axis)
        first, second = (
            self._frame(moved, motion.turned(turn), node)
            for motion, node in ((link.carrier, link.before), (link.moved, link.node))
        )
        d = second.origin - first.origin
        (x1, y1, z1), (x2, _, z2) = first.axes, second.axes
        across = [dot(d, x1), dot(d, y1)]
        match link.kind:
            case "ball":
                return [*across, dot(d, z1)]
            case "revolute":
                return [*across, dot(d, z1), dot(x1, z2), dot(y1, z2)]
            case "prismatic":
                return [*across, dot(x1, z2), dot(y1, z2), dot(y1, x2)]
        assert link.kind == "helical"
        own = self._own(moved, link)[link.names[0]]
        return [*across, dot(d, z1) - link.pitch * own, dot(x1, z2), dot(y1, z2)]

    def _own(self, moved: Moved, link: Link) -> dict[str, Jet]:
        """Return the coordinates of a joint as jets; of a quaternion's velocities, jets without values."""
        start, end = link.carrier, link.moved
        gradient = {node: self._point(moved, node, end.p)[1:] for node in (link.before, link.node)}
        (_, w1), (v2, w2) = gradient[link.before], gradient[link.node]
        relative = end.om - start.om
        if link.axis is None:
            found = {}
            for name in link.names:
                e = end.R[:, "xyz".index(name[-1])]
                gradient_of, speed = (w2 - w1, relative) if name[-2] == "r" else (v2, end.v)
                found[name] = Jet(None, e @ speed, e @ gradient_of, np.cross(end.om, e) @ speed)
            return found
        e = start.R @ link.axis
        if link.kind == "prismatic":
            first, second = (
                self._frame(moved, motion, node) for motion, node in ((start, link.before), (end, link.node))
            )
            d = second.origin - first.origin
            return {link.names[0]: dot(d, self._direction(moved, start, link.before, e))}
        return {link.names[0]: Jet(link.q, e @ relative, e @ (w2 - w1), self.numbers.make(0.0))}

    # -- geometry -----------------------------------------------------------------------------------------------------

    def _point(self, moved: Moved, node: int, place: Array) -> tuple[Array, Array, Array]:
        """Return where a point is from its node's origin, and its velocity and angular velocity by all velocities."""
        velocity, turn = (self.numbers.array(np.zeros((3, 6 * len(moved.links)))) for _ in range(2))
        if not node:
            return place * 0, velocity, turn
        d, eye, k = place - moved.links[node - 1].moved.p, self.numbers.array(np.eye(3)), 6 * (node - 1)
        velocity[:, k : k + 3], velocity[:, k + 3 : k + 6], turn[:, k + 3 : k + 6] = eye, -skew(d), eye
        return d, velocity, turn

    def _frame(self, moved: Moved, motion: Motion, node: int) -> _Frame:
        d, velocity, _ = self._point(moved, node, motion.p)
        bias = np.cross(motion.om, np.cross(motion.om, d))
        origin = np.array([Jet(*x) for x in zip(motion.p, motion.v, velocity, bias, strict=True)], dtype=object)
        x, y, z = (self._direction(moved, motion, node, e) for e in motion.R.T)
        return _Frame(origin, (x, y, z))

    def _direction(self, moved: Moved, motion: Motion, node: int, e: Array) -> Array:
        _, _, turn = self._point(moved, node, motion.p)
        rate, om = np.cross(motion.om, e), motion.om
        return np.array([Jet(*x) for x in zip(e, rate, -skew(e) @ turn, np.cross(om, rate), strict=True)], dtype=object)

    def _unit_motions(self, moved: Moved) -> Array:
        """Return S: the nodes' velocities of unit velocities of the joints that have coordinates."""
        columns: dict[str, Array] = {}
        for k, link in enumerate(moved.links):
            for column in link.moved.columns:
                whole = columns.setdefault(column.name, self.numbers.array(np.zeros(6 * len(moved.links))))
                whole[6 * k : 6 * k + 6] = np.concatenate(column.at(link.moved.p))
        return self.fold(columns, (6 * len(moved.links),))

    def _stack(self, moved: Moved, *keys: str) -> Array:
        parts = [getattr(link.moved, key) for link in moved.links for key in keys]
        return np.concatenate(parts) if parts else self.numbers.array(np.zeros(0))

    def _is_of_quaternion(self, name: str) -> bool:
        own = name.rpartition(".")[0]
        joints = {body["name"]: body["joint"] for body in self.model["bodies"]}
        return isinstance(joints.get(own), dict) and joints[own]["type"] in ("ball", "free")

    def _advance_quaternion(self, own: str, q: Values, step: Values, *, is_free: bool) -> dict[str, Any]:
        """Turn a quaternion by a small rotation in its own axes, and move on along them."""
        x, y, z, s = (q[f"{own}.q{k}"] for k in "xyzw")
        v, w = np.array([x, y, z]), np.array([step[f"{own}.r{k}"] for k in "xyz"]) / 2
        vector, scalar = v + s * w + np.cross(v, w), s - v @ w
        length = self.numbers.functions["sqrt"](vector @ vector + scalar * scalar)
        found = dict(zip((f"{own}.q{k}" for k in "xyzw"), [*(vector / length), scalar / length], strict=True))
        if is_free:
            R = turn_by(self.numbers, x, y, z, s)
            moved = R @ np.array([step[f"{own}.{k}"] for k in "xyz"])
            found |= {f"{own}.{k}": q[f"{own}.{k}"] + d for k, d in zip("xyz", moved, strict=True)}
        return found

    # -- arrays -------------------------------------------------------------------------------------------------------

    def _numbers(self, values: Iterable[Any]) -> Array:
        return np.array([self.numbers.make(x) for x in values], dtype=self.numbers.kind)

    def _rows(self, rows: Sequence[Array], size: int) -> Array:
        return np.array(rows) if rows else self.numbers.array(np.zeros((0, size)))

    def _pseudoinverse(self, J: Array) -> Array:
        return self.numbers.array(np.linalg.pinv(J.astype(float), rcond=RANK))


def rank(J: Array) -> int:
    """Return the rank of a Jacobian."""
    return int(np.linalg.matrix_rank(J.astype(float), tol=RANK * max(1.0, float(abs(J).max(initial=0)))))


def independent_rows(J: Array) -> list[int]:
    """Choose rows that all others follow from."""
    _, _, order = qr(J.astype(float).T, pivoting=True)
    return sorted(int(k) for k in order[: rank(J)])
