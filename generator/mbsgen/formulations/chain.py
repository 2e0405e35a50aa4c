"""Chains: a Tree in a builder, with its numbers. Every recursion starts from one.

The moments of bodies depend on parameters alone, so they are folded or move to `setup`.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from types import MappingProxyType

from sympy import Expr, Symbol

from mbsgen.algebra.rotations import axis_rotation
from mbsgen.algebra.vectors import Matrix, Vector, outer
from mbsgen.errors import TapeError
from mbsgen.formulations.links import AppliedWrench, Link
from mbsgen.formulations.points import Points
from mbsgen.formulations.states import State
from mbsgen.manifest import FIRST_LENGTH
from mbsgen.model.tree import (
    COORDINATE,
    RATE,
    Body,
    Kind,
    Motion,
    RigidPart,
    Tree,
    Wrench,
    coordinate_symbol,
    rate_symbol,
    signal_symbol,
)
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.lowering import lower

LENGTH_TOLERANCE = 1.0  # of a squared length beside the squares of both places: a length in doubles of 1.5e-8


@dataclass(frozen=True)
class Chain:
    """A Tree in a builder: its numbers are written when they are asked for."""

    tree: Tree
    builder: Builder
    state: State
    symbols: dict[Expr, Scalar]  # parameters

    @cached_property
    def links(self) -> tuple[Link, ...]:
        """The bodies, each in its own frame."""
        return tuple(_write_link(self, i, body, self.state.q[i - 1]) for i, body in enumerate(self.tree.bodies, 1))

    @cached_property
    def armatures(self) -> tuple[Scalar, ...]:
        """The rotors' inertias, added to the diagonal of M: each rotor feels the acceleration of its joint alone."""
        return tuple(self.scalar(body.joint.armature) for body in self.tree.bodies)

    @cached_property
    def gravity(self) -> Vector[Scalar]:
        """The acceleration of free fall, in the base frame."""
        return self.vector(self.tree.gravity)

    @cached_property
    def wrenches(self) -> tuple[AppliedWrench, ...]:
        """The external wrenches; what the model leaves open is taken from the input w."""
        given = iter(self.state.w)

        self.guard_lengths({wrench.name for wrench in self.tree.wrenches})

        def components(wrench: Wrench, vector: Sequence[Expr] | None) -> Vector[Scalar]:
            written = Vector.of(islice(given, 3)) if vector is None else self.components(vector)
            return written if wrench.in_base else self.matrix(wrench.orientation).apply(written)

        return tuple(
            AppliedWrench(x.body, self.vector(x.position), x.in_base, components(x, x.force), components(x, x.moment))
            for x in self.tree.wrenches
        )

    def guard_lengths(self, present: Container[str]) -> None:
        """Make the kernel fail where the points of these force elements or contacts meet: there is no direction."""
        lengths = [(x.symbol, x.length) for x in self.tree.definitions if x.length is not None]
        for number, (symbol, length) in enumerate(lengths, FIRST_LENGTH):
            if length.name not in present:
                continue
            scale = lower(length.scale, self.builder, self.known)
            self.builder.guard(self.known[symbol], scale, LENGTH_TOLERANCE, number)

    @cached_property
    def known(self) -> dict[Expr, Scalar]:
        """The numbers that forces may depend on, by symbol: parameters, and numbers of the state.

        A function without w has no signals, nor definitions that depend on them.
        """
        tree, state = self.tree, self.state
        known: dict[Expr, Scalar] = dict(self.symbols)
        for symbol, column in ((coordinate_symbol, state.q), (rate_symbol, state.qd)):
            known |= {symbol(body.joint.name): x for body, x in zip(tree.bodies, column, strict=True)}
        signals = [signal_symbol(name) for name in tree.signals]
        if state.w and signals:
            known |= zip(signals, state.w[-len(signals) :], strict=True)
        absent = {symbol for symbol in signals if symbol not in known}
        points = Points(self.links, state.qd, self.still)
        for probe in tree.probes:
            known |= zip(probe.symbols, points.read(probe.reading, probe.body, self.vector(probe.point)), strict=True)
        for definition in tree.definitions:
            if absent and not absent.isdisjoint(definition.value.free_symbols):
                absent.add(definition.symbol)
            else:
                known[definition.symbol] = lower(definition.value, self.builder, known)
        return known

    def components(self, vector: Sequence[Expr]) -> Vector[Scalar]:
        """Write the components of a force or moment, which may depend on the state."""
        return Vector.of(map(self.force, vector))

    def force(self, number: Expr, own: Mapping[Symbol, Scalar] = MappingProxyType({})) -> Scalar:
        """Write a force that may depend on the state, and on further numbers."""
        fixed = {**self.symbols, **own}
        return lower(number, self.builder, fixed if number.free_symbols <= fixed.keys() else {**self.known, **own})

    def scalar(self, number: Expr) -> Scalar:
        """Write a number of the model."""
        return lower(number, self.builder, self.symbols)

    def vector(self, components: Sequence[Expr]) -> Vector[Scalar]:
        """Write a vector of the model."""
        return Vector.of(map(self.scalar, components))

    def matrix(self, rows: Sequence[Sequence[Expr]]) -> Matrix[Scalar]:
        """Write a matrix of the model."""
        return Matrix.of(self.vector(row) for row in rows)

    def position(self, number: int) -> Vector[Scalar]:
        """Return the position of a body's joint on its parent."""
        body, frame = self.tree.bodies[number - 1], self.state.frames.get(number)
        position = self.vector(body.position)
        return position + self.matrix(body.orientation).apply(frame.p) if frame else position

    def orientation(self, number: int) -> Matrix[Scalar]:
        """Return the rotation from a body to its parent, at joint coordinate 0."""
        body, frame = self.tree.bodies[number - 1], self.state.frames.get(number)
        orientation = self.matrix(body.orientation)
        return orientation.times(frame.R) if frame else orientation

    @cached_property
    def drift(self) -> tuple[Scalar, ...]:
        """The joint accelerations at which the model's accelerations are 0.

        After turns about x, y, z in a row, the last body has the angular acceleration qdd + (w2 w3, -w1 w3, w1 w2), in
        its own axes. The velocity v along these axes changes by w x v besides, as they turn.
        """
        found = [self.builder.zero] * len(self.tree.bodies)
        for x in self.tree.quaternions:
            *slides, a, b, c = (i - 1 for i in x.bodies)
            w = Vector.of(self.state.qd[i] for i in (a, b, c))
            found[a], found[b], found[c] = -(w.y * w.z), w.x * w.z, -(w.x * w.y)
            if slides:
                carried = w.cross(Vector.of(self.state.qd[i] for i in slides))
                for i, amount in zip(slides, carried, strict=True):
                    found[i] = amount
        return tuple(found)

    def accelerate(self, qdd: Sequence[Scalar]) -> list[Scalar]:
        """Return the joint accelerations that belong to the model's accelerations."""
        return [own + more for own, more in zip(qdd, self.drift, strict=True)]

    @property
    def still(self) -> Vector[Scalar]:
        """The null vector."""
        zero = self.builder.zero
        return Vector(zero, zero, zero)


def write_chain(tree: Tree, builder: Builder, state: State) -> Chain:
    """Start a tree in the builder that declares its state."""
    return Chain(tree, builder, state, assign_symbols(tree, builder, state.p, state.theta))


def assign_symbols(tree: Tree, builder: Builder, p: Sequence[Scalar], theta: Sequence[Scalar]) -> dict[Expr, Scalar]:
    """Return the parameters by their symbols, given the run-time parameters `p` and the differentiated ones."""
    symbols: dict[Expr, Scalar] = {}
    for kind, given in ((Kind.RUNTIME, p), (Kind.DIFFERENTIATED, theta)):
        symbols |= dict(zip((x.symbol for x in tree.parameters if x.kind is kind), given, strict=True))
    return symbols | {x.symbol: builder.number(x.value) for x in tree.parameters if x.kind is Kind.CONSTANT}


def _write_link(chain: Chain, number: int, body: Body, q: Scalar) -> Link:
    b = chain.builder
    zero, one = b.zero, b.number(1.0)
    placed = chain.orientation(number)
    dpt, slide, R = chain.position(number), chain.still, placed
    if body.joint.motion is Motion.REVOLUTE:
        R = placed.times(axis_rotation(body.joint.axis, b.sin(q), b.cos(q), zero, one))
    else:
        slide = chain.still.along(body.joint.axis, q)
        dpt = dpt + placed.apply(slide)
    m, S, J = _write_moments(chain, body)
    for part in body.parts:
        more = _write_moments(chain, part)
        m, S, J = m + more[0], S + more[1], J + more[2]
    return Link(number, body.parent, body.joint, R, dpt, slide, m, S, J)


def _write_moments(chain: Chain, part: Body | RigidPart) -> tuple[Scalar, Vector[Scalar], Matrix[Scalar]]:
    m, l = chain.scalar(part.mass), chain.vector(part.com)
    S = l.scale(m)
    zero, squared = chain.builder.zero, S.dot(l)
    turning = Matrix.of([[squared if r == c else zero for c in range(3)] for r in range(3)])
    return m, S, chain.matrix(part.inertia) + turning - outer(S, l)


def check_pivot(tree: Tree, number: int, pivot: Scalar) -> None:
    """Refuse a joint that has no inertia in any state. Raises TapeError; a checked model has no such joint."""
    if pivot.is_zero:
        finding = f"joint {tree.bodies[number - 1].joint.name!r} moves nothing, so its acceleration is not determined"
        raise TapeError(f"{tree.name}: {finding}; give a body it carries mass, or take the joint away")


def joint_forces(chain: Chain) -> list[Scalar]:
    """Return Q = Qa + Qp: u in the actuated joints, plus the force law of every joint (Docquier et al., eq. 14)."""
    state, active = chain.state, iter(chain.state.u)
    forces = []
    for body, q, qd in zip(chain.tree.bodies, state.q, state.qd, strict=True):
        own = next(active) if body.joint.actuated else chain.builder.zero
        forces.append(own + chain.force(body.joint.law, {COORDINATE: q, RATE: qd}))
    return forces
