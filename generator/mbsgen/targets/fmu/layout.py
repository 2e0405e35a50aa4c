"""The numbers of an instance and the functions that compute with them, as `csrc/fmi` takes them.

Numbers are coordinates, velocities, forces and wrenches, parameters, differentiated parameters, the set-up; then the
results: rates of the coordinates, accelerations, outputs, closed coordinates and velocities, independent velocities;
then the nonzeros of derivatives.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

from mbsgen.manifest import Argument, Kernel, Manifest
from mbsgen.request import OptionError
from mbsgen.roles import Axis, Order, Role

DYNAMICS = "exp2"
OUTPUTS = "sensors"
RATES = "rates"
CLOSE, CLOSE_RATES, PROJECT = "close", "close_rates", "project_plain"  # of mechanisms with loops


class FmuError(OptionError):
    """A mechanism that FMI cannot take."""


@dataclass(frozen=True)
class Call:
    """A generated function, with the places of its arguments and results that have nonzeros."""

    kernel: Kernel
    places: tuple[int, ...]


@dataclass(frozen=True)
class Entry:
    """A nonzero of the derivatives: row among rates, accelerations and outputs, column among states and inputs."""

    row: int
    column: int
    place: int  # among the numbers; -1: it is 1


def list_functions() -> tuple[tuple[str, ...], tuple[str, ...]]:
    """List the functions that a unit calls: of every mechanism, and of some."""
    return (DYNAMICS,), (OUTPUTS, RATES, CLOSE, CLOSE_RATES, PROJECT)


class Layout:
    """Where the numbers of a mechanism are."""

    def __init__(self, manifest: Manifest) -> None:
        """Number them. Raises FmuError for a mechanism with driven joints, and where functions are missing."""
        self.manifest = manifest
        _check(manifest)
        inputs = len(manifest.inputs)
        velocities, positions = len(manifest.coordinates), len(manifest.positions)
        sizes = {
            Role.COORDINATE: positions,
            Role.VELOCITY: velocities,
            Role.FORCE: len(manifest.actuated),
            Role.WRENCH: inputs - len(manifest.actuated),
            Role.PARAMETER: len(manifest.parameters),
            Role.DESIGN: len(manifest.design),
            Role.SETUP: manifest.setup.outputs[0].nnz if manifest.setup else 0,
        }
        self.first: dict[Role, int] = {}
        place = 0
        for role, size in sizes.items():
            self.first[role] = place
            place += size
        self.given = self.first[Role.SETUP]
        self.states = positions + velocities
        self.inputs = inputs
        self.outputs = tuple(f"{f.name}.{axis}" for f in manifest.frames if f.sensor for axis in "xyz")
        self.results = place
        self.closed = place + self.states + len(self.outputs)
        self.independent = self.closed + (self.states if manifest.loops else 0)
        self._free = self.independent + len(manifest.independent)

    @property
    def start(self) -> list[float]:
        """Return the first values of all numbers that are given: the assembled pose, at rest, without forces."""
        manifest, found = self.manifest, [0.0] * self.given
        found[: len(manifest.pose)] = manifest.pose
        if not manifest.pose:
            for first in manifest.quaternions:
                found[first + 3] = 1.0
        for role, parameters in ((Role.PARAMETER, manifest.parameters), (Role.DESIGN, manifest.design)):
            first = self.first[role]
            found[first : first + len(parameters)] = [x.value for x in parameters]
        return found

    @cached_property
    def calls(self) -> Mapping[str, Call]:
        """Return the functions of values, by the part that they play, as far as the mechanism has them."""
        manifest, nq = self.manifest, self.first[Role.VELOCITY]
        found: dict[str, Call] = {}
        if manifest.setup:
            found["setup"] = self._call(manifest.setup, self.first[Role.SETUP])
        if manifest.configuration:
            found["rates"] = self._call(self._find(RATES), self.results)
        found["accelerations"] = self._call(self._find(DYNAMICS), self.results + nq)
        if self.outputs:
            found["places"] = self._call(self._find(OUTPUTS), self.results + self.states)
        if manifest.loops:
            found["close"] = self._call(self._find(CLOSE), self.closed)
            found["close_rates"] = self._call(self._find(CLOSE_RATES), self.closed + nq)
            found["project"] = self._call(self._find(PROJECT), self.closed, self.closed + nq)
        return found

    @cached_property
    def slopes(self) -> tuple[tuple[Call, ...], tuple[Entry, ...], int]:
        """Return the functions of derivatives, all nonzeros, and the size of all numbers."""
        nq, n = self.first[Role.VELOCITY], len(self.manifest.coordinates)
        rows = {DYNAMICS: nq, RATES: 0, OUTPUTS: self.states}
        calls, entries, free = [], list[Entry](), self._free + self._spare
        if not self.manifest.configuration:
            entries += [Entry(k, nq + k, -1) for k in range(n)]
        for base in (DYNAMICS, *([RATES] * bool(self.manifest.configuration)), *([OUTPUTS] * bool(self.outputs))):
            kernel = self._find(base, Order.JACOBIAN)
            first, results = self._find(base).outputs[0].name, list[int]()
            for block in kernel.outputs:
                results.append(free)
                column = self.first[_find_role(kernel, block)]
                if block.of == first:  # not the multipliers
                    nonzeros = enumerate(_list_nonzeros(block))
                    entries += [Entry(rows[base] + r, column + c, free + k) for k, (r, c) in nonzeros]
                free += block.nnz
            calls.append(self._call(kernel, *results))
        known = self.states + self.inputs
        return tuple(calls), tuple(e for e in entries if e.column < known), free

    @property
    def _spare(self) -> int:
        """Return the room for results that nothing reads: multipliers."""
        return max(sum(o.nnz for o in call.kernel.outputs[1:]) for call in self.calls.values())

    def _call(self, kernel: Kernel, *results: int) -> Call:
        """Place the arguments of a function, and its results; results without a place are not read."""
        arguments = [self._place(argument) for argument in kernel.inputs if argument.nnz]
        free, placed = self._free, list[int]()
        for k, result in enumerate(kernel.outputs):
            if k < len(results):
                placed += [results[k]] * bool(result.nnz)
            elif result.nnz:
                placed.append(free)
                free += result.nnz
        return Call(kernel, (*arguments, *placed))

    def _place(self, argument: Argument) -> int:
        if argument.role is Role.VELOCITY and argument.row_axis is Axis.INDEPENDENT:
            return self.independent
        return self.first[argument.role]

    def _find(self, base: str, order: Order = Order.VALUE) -> Kernel:
        kernel = self.manifest.find(base, order)
        if kernel is None:
            raise FmuError(
                f"a functional mock-up unit calls {base} and its first derivatives, which are left out here; name "
                f"{base} among the functions too"
            )
        return kernel


def _check(manifest: Manifest) -> None:
    if manifest.driven:
        raise FmuError(
            f"{manifest.model} has driven joints, whose motions FMI cannot give with their derivatives; actuate them, "
            "or simulate the model with mbsrun simulate"
        )
    if not manifest.coordinates:
        raise FmuError(f"{manifest.model} has no joint, and nothing to simulate; give a body a joint")


def _find_role(kernel: Kernel, block: Argument) -> Role:
    return next(argument.role for argument in kernel.inputs if argument.name == block.by)


def _list_nonzeros(argument: Argument) -> Iterator[tuple[int, int]]:
    """List the rows and columns of nonzeros, column by column."""
    if argument.colind is None or argument.row is None:
        yield from ((r, c) for c in range(argument.cols) for r in range(argument.rows))
        return
    for c in range(argument.cols):
        yield from ((argument.row[k], c) for k in range(argument.colind[c], argument.colind[c + 1]))
