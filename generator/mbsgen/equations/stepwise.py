"""The equations of motion in named intermediate values, for mechanisms whose sums would fill pages.

Phi(q, qd, qdd) = M qdd + c + g - applied is linear in accelerations, so each part of it is the recursion with all other
parts at rest. The recursion runs on parts of the tree, without gravity, wrenches, force laws or inertia:

    M e_j = Phi(q, 0, e_j),    c = Phi(q, qd, 0) - Phi(q, 0, 0),    g = Phi(q, 0, 0) with gravity,    applied = -Phi
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import sympy as sp

from mbsgen.equations.lines import Given, Writer
from mbsgen.equations.motion import Motion, keep_used, list_values, name_symbols
from mbsgen.equations.named import Forces, name_forces
from mbsgen.formulations import closure, coupling, impl
from mbsgen.formulations.reductions import ALL
from mbsgen.formulations.results import poses
from mbsgen.model.tree import NO_FORCE, ZERO, Body, Tree
from mbsgen.roles import Role
from mbsgen.tape.types import Tape

_NONE = (ZERO, ZERO, ZERO)


def _rest(size: int) -> list[sp.Expr]:
    return [ZERO] * size


def _unit(place: int) -> Callable[[int], list[sp.Expr]]:
    return lambda size: [sp.Integer(k == place) for k in range(size)]


_FORCES: Given = dict.fromkeys((Role.FORCE, Role.WRENCH, Role.MULTIPLIER, Role.DRIVING_FORCE), _rest)
_STILL: Given = {Role.VELOCITY: _rest}
_UNACCELERATED: Given = {Role.ACCELERATION: _rest}


def derive_stepwise(tree: Tree) -> Motion:
    """Derive the equations of motion, of any length; entries read the lines of `named`."""
    naming, forces = name_symbols(tree), name_forces(tree)
    recursion = _Recursion(forces, Writer(naming))
    n = len(tree.joints)
    columns = [recursion.find_inertia(j) for j in range(n)]
    M = sp.Matrix(n, n, lambda i, j: columns[max(i, j)][min(i, j)])
    c, g, applied = recursion.find_motion(), recursion.find_rest(), recursion.find_applied()
    h, J = recursion.find_loops()
    position = recursion.find_positions()
    parts = (M, c, g, applied, h, J, position)
    named = keep_used(recursion.writer.lines, set().union(*(part.free_symbols for part in parts)))
    return Motion(
        tree.name,
        naming,
        *(M, c, g, applied, h, J),
        tuple(sensor.name for sensor in tree.sensors),
        position,
        _count((entry for part in (M, c, g, applied) for entry in part), (line.expression for line in named)),
        named,
        list_values(tree, naming),
    )


def _count(*every: Iterable[sp.Expr]) -> int:
    return sum(len(sp.Add.make_args(x)) for part in every for x in part)


@dataclass(frozen=True)
class _Recursion:
    """Writes parts of the equations."""

    forces: Forces
    writer: Writer

    def write(self, tape: Tape, given: Given, *, numbers: list[sp.Expr] | None = None) -> sp.Matrix:
        """Write the one result of a tape."""
        found = self.writer.write(tape, self.find_numbers(given) if numbers is None else numbers, given)
        (result,) = found.values()
        return result

    def find_numbers(self, given: Given) -> list[sp.Expr]:
        """Find the numbers that force laws read, where some of the state is at rest; contacts are left out."""
        values: list[sp.Expr] = []
        for k, number in enumerate(self.forces.numbers):
            before = [*values, *_rest(len(self.forces.numbers) - k)]
            operands = () if number.name else self.writer.write(self.forces.write_operands(k), before, given)["value"]
            values.append(ZERO if number.name else self.writer.name(number, tuple(operands)))
        return values

    def write_residual(self, change: Callable[[Tree], Tree]) -> Tape:
        """Write Phi of a part of the tree."""
        return coupling.write(impl.build, None, change(self.forces.tree), ALL)

    def find_inertia(self, place: int) -> sp.Matrix:
        """Find a column of the mass matrix."""
        given = {**_FORCES, **_STILL, Role.ACCELERATION: _unit(place)}
        return self.write(self.write_residual(_keep_inertia), given)

    def find_motion(self) -> sp.Matrix:
        """Find the forces that velocities cause."""
        tape = self.write_residual(_drop_gravity)
        moving = self.write(tape, {**_FORCES, **_UNACCELERATED})
        return moving - self.write(tape, {**_FORCES, **_UNACCELERATED, **_STILL})

    def find_rest(self) -> sp.Matrix:
        """Find the forces at rest."""
        return self.write(self.write_residual(_drop_wrenches), {**_FORCES, **_UNACCELERATED, **_STILL})

    def find_applied(self) -> sp.Matrix:
        """Find the applied forces, in the numbers of contacts and force elements."""
        numbers = self.writer.write_numbers(self.forces)
        return -self.write(self.write_residual(_keep_forces), _UNACCELERATED, numbers=numbers)

    def find_loops(self) -> tuple[sp.Matrix, sp.Matrix]:
        """Find the gaps of loops, and their Jacobian, column by column."""
        tree = self.forces.tree
        n = len(tree.joints)
        if not tree.is_constrained:
            return sp.zeros(0, 1), sp.zeros(0, n)
        h = self._write(lambda x: closure.build(x), {})
        columns = [self._write(lambda x: closure.build_rates(x), {Role.VELOCITY: _unit(j)}) for j in range(n)]
        return h, sp.Matrix.hstack(*columns)

    def find_positions(self) -> sp.Matrix:
        """Find the places of sensors, (3, sensors)."""
        tree = self.forces.tree
        return self._write(lambda x: poses.build_sensors(x), {}) if tree.sensors else sp.zeros(3, 0)

    def _write(self, build: Callable[[Tree], Tape], given: Given) -> sp.Matrix:
        return self.write(coupling.write(lambda x, _: build(x), None, self.forces.tree, ALL), given)


def _drop_wrenches(tree: Tree) -> Tree:
    return replace(tree, wrenches=())


def _drop_gravity(tree: Tree) -> Tree:
    return replace(tree, wrenches=(), gravity=_NONE)


def _keep_inertia(tree: Tree) -> Tree:
    return replace(_drop_gravity(tree), bodies=tuple(map(_drop_law, tree.bodies)))


def _keep_forces(tree: Tree) -> Tree:
    return replace(tree, gravity=_NONE, bodies=tuple(map(_drop_inertia, tree.bodies)))


def _drop_law(body: Body) -> Body:
    return replace(body, joint=replace(body.joint, law=NO_FORCE))


def _drop_inertia(body: Body) -> Body:
    joint = replace(body.joint, law=NO_FORCE, armature=ZERO)
    return replace(body, joint=joint, mass=ZERO, inertia=(_NONE, _NONE, _NONE), parts=())
