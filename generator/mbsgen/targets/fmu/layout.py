"""The numbers of an instance and the functions that compute with them, as `csrc/fmi` takes them.

Numbers are coordinates, velocities, forces and wrenches, accelerations of driven joints, parameters, differentiated
parameters, the set-up; then the results: rates of the coordinates, accelerations, outputs, closed coordinates and
velocities, independent velocities; then the nonzeros of derivatives. States are the
coordinates and velocities of joints that are not driven; driven joints have inputs.
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
    """A nonzero of the derivatives: row among rates of states and outputs, column among states and inputs."""

    row: int
    column: int
    place: int  # among the numbers; -1: it is 1


def list_functions() -> tuple[tuple[str, ...], tuple[str, ...]]:
    """List the functions that a unit calls: of every mechanism, and of some."""
    return (DYNAMICS,), (OUTPUTS, RATES, CLOSE, CLOSE_RATES, PROJECT)


class Layout:
    """Where the numbers of a mechanism are."""

    def __init__(self, manifest: Manifest) -> None:
        """Number them. Raises FmuError for a mechanism without joints, and where functions are missing."""
        self.manifest = manifest
        _check(manifest)
        self.named = manifest.inputs[:-1] if manifest.reads_time else manifest.inputs
        inputs = len(self.named)
        velocities, positions = len(manifest.coordinates), len(manifest.positions)
        names = [c.name for c in manifest.coordinates]
        self.driven = tuple(names[i] for i in manifest.driven)
        sizes = {
            Role.COORDINATE: positions,
            Role.VELOCITY: velocities,
            Role.FORCE: len(manifest.actuated),
            Role.WRENCH: manifest.open_entries,
            Role.DRIVE: len(self.driven),
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
        given = [*(manifest.positions.index(name) for name in self.driven), *(positions + i for i in manifest.driven)]
        self.states = tuple(k for k in range(positions + velocities) if k not in given)
        forces, drives = self.first[Role.FORCE], self.first[Role.DRIVE]
        self.inputs = (*range(forces, forces + inputs), *given, *range(drives, drives + len(self.driven)))
        self.clock = (
            forces + inputs if manifest.reads_time else -1
        )  # the time, the last entry of w; -1: nothing reads it
        self.outputs = tuple(f"{f.name}.{axis}" for f in manifest.frames if f.sensor for axis in "xyz")
        self.results = place
        self.places = place + positions + velocities
        self.driving = self.places + len(self.outputs)
        self.closed = self.driving + len(self.driven)
        self.independent = self.closed + (positions + velocities if manifest.loops else 0)
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
        dynamics = self._find(DYNAMICS)
        found["accelerations"] = self._call(dynamics, *self._list_results(dynamics))
        if self.outputs:
            found["places"] = self._call(self._find(OUTPUTS), self.places)
        if manifest.loops:
            found["close"] = self._call(self._find(CLOSE), self.closed)
            found["close_rates"] = self._call(self._find(CLOSE_RATES), self.closed + nq)
            found["project"] = self._call(self._find(PROJECT), self.closed, self.closed + nq)
        return found

    @cached_property
    def slopes(self) -> tuple[tuple[Call, ...], tuple[Entry, ...], int]:
        """Return the functions of derivatives, all nonzeros, and the size of all numbers."""
        nq, n = self.first[Role.VELOCITY], len(self.manifest.coordinates)
        calls, found, free = [], list[tuple[int, int, int]](), self._free + self._spare
        if not self.manifest.configuration:
            found += [(self.results + k, nq + k, -1) for k in range(n)]
        for base in (DYNAMICS, *([RATES] * bool(self.manifest.configuration)), *([OUTPUTS] * bool(self.outputs))):
            kernel, placed = self._find(base, Order.JACOBIAN), self._place_results(base)
            results = list[int]()
            for block in kernel.outputs:
                results.append(free)
                column, row = self.first[_find_role(kernel, block)], placed.get(block.of or "")
                if row is not None:  # not the multipliers
                    found += [(row + r, column + c, free + k) for k, (r, c) in enumerate(_list_nonzeros(block))]
                free += block.nnz
            calls.append(self._call(kernel, *results))
        unknowns = [*(self.results + k for k in self.states), *range(self.places, self.closed)]
        rows = {place: k for k, place in enumerate(unknowns)}
        columns = {place: k for k, place in enumerate((*self.states, *self.inputs))}
        entries = (Entry(rows[r], columns[c], place) for r, c, place in found if r in rows and c in columns)
        return tuple(calls), tuple(entries), free

    @property
    def _spare(self) -> int:
        """Return the room for results that nothing reads: multipliers."""
        return max(sum(o.nnz for o in call.kernel.outputs[1:]) for call in self.calls.values())

    def _place_results(self, base: str) -> Mapping[str, int]:
        """Return where the results of a function begin that rates of states and outputs are made of, by their names."""
        first = {
            DYNAMICS: self.results + self.first[Role.VELOCITY],
            RATES: self.results,
            OUTPUTS: self.places,
        }
        kernel = self._find(base)
        driving = {o.name: self.driving for o in kernel.outputs if o.role is Role.DRIVING_FORCE}
        return {kernel.outputs[0].name: first[base]} | driving

    def _list_results(self, kernel: Kernel) -> Iterator[int | None]:
        """List where the results of the accelerations' function begin; None: nothing reads them."""
        placed = self._place_results(DYNAMICS)
        yield from (placed.get(result.name) for result in kernel.outputs)

    def _call(self, kernel: Kernel, *results: int | None) -> Call:
        """Place the arguments of a function, and its results; results without a place are not read."""
        arguments = [self._place(argument) for argument in kernel.inputs if argument.nnz]
        free, placed = self._free, list[int]()
        for k, result in enumerate(kernel.outputs):
            place = results[k] if k < len(results) else None
            if place is not None:
                placed += [place] * bool(result.nnz)
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
