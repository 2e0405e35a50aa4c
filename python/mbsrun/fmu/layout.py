"""The numbers of an instance and the functions that compute with them, as `csrc/fmi` takes them.

Numbers are coordinates, velocities, forces and wrenches, parameters, differentiated parameters, the set-up; then the
results: rates of the coordinates, accelerations, outputs; then the nonzeros of derivatives.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

from mbsgen.errors import MbsError
from mbsgen.manifest import Argument, Kernel, Manifest
from mbsgen.roles import Order, Role
from mbsrun.kernel import Kernels
from mbsrun.quaternions import neutral
from mbsrun.simulation.drive import input_labels

DYNAMICS = "exp2"
OUTPUTS = "sensors"
RATES = "rates"


class FmuError(MbsError):
    """A mechanism that FMI cannot take."""


@dataclass(frozen=True)
class Call:
    """A generated function, with the places of its arguments and results."""

    kernel: Kernel
    arguments: tuple[int, ...]
    results: tuple[int, ...]


@dataclass(frozen=True)
class Entry:
    """A nonzero of the derivatives: row among rates, accelerations and outputs, column among states and inputs."""

    row: int
    column: int
    place: int  # among the numbers; -1: it is 1


class Layout:
    """Where the numbers of a mechanism are."""

    def __init__(self, kernels: Kernels) -> None:
        """Number them. Raises FmuError for a mechanism with closed loops, and where functions are missing."""
        self.kernels, self.manifest = kernels, kernels.manifest
        _check(kernels.manifest)
        manifest = self.manifest
        inputs = len(input_labels(manifest))
        sizes = {
            Role.COORDINATE: len(manifest.positions),
            Role.VELOCITY: len(manifest.coordinates),
            Role.FORCE: len(manifest.actuated),
            Role.WRENCH: inputs - len(manifest.actuated),
            Role.PARAMETER: len(manifest.parameters),
            Role.DESIGN: len(manifest.design),
            Role.SETUP: _count(manifest.setup.outputs[0]) if manifest.setup else 0,
        }
        self.first: dict[Role, int] = {}
        place = 0
        for role, size in sizes.items():
            self.first[role] = place
            place += size
        self.given = self.first[Role.SETUP]
        self.states = sizes[Role.COORDINATE] + sizes[Role.VELOCITY]
        self.inputs = inputs
        self.outputs = tuple(f"{f.name}.{axis}" for f in manifest.frames if f.sensor for axis in "xyz")
        self.results = place
        self._free = place + self.states + len(self.outputs)

    @property
    def start(self) -> list[float]:
        """The first values of all numbers that are given."""
        manifest, found = self.manifest, [0.0] * self.given
        pose = neutral(manifest)
        found[: pose.size] = [float(x) for x in pose]
        for role, parameters in ((Role.PARAMETER, manifest.parameters), (Role.DESIGN, manifest.design)):
            first = self.first[role]
            found[first : first + len(parameters)] = [x.value for x in parameters]
        return found

    @cached_property
    def calls(self) -> Mapping[str, Call | None]:
        """The functions of values: set-up, rates, accelerations, outputs."""
        nq = self.first[Role.VELOCITY]
        return {
            "setup": self._call(self.manifest.setup, self.first[Role.SETUP]),
            "rates": self._call(self._find(RATES) if self.manifest.configuration else None, self.results),
            "accelerations": self._call(self._find(DYNAMICS), self.results + nq),
            "outputs": self._call(self._find(OUTPUTS) if self.outputs else None, self.results + self.states),
        }

    @cached_property
    def slopes(self) -> tuple[tuple[Call, ...], tuple[Entry, ...], int]:
        """The functions of derivatives, all nonzeros, and the size of all numbers."""
        nq, n = self.first[Role.VELOCITY], len(self.manifest.coordinates)
        rows = {DYNAMICS: nq, RATES: 0, OUTPUTS: self.states}
        calls, entries, free = [], list[Entry](), self._free
        if not self.manifest.configuration:
            entries += [Entry(k, nq + k, -1) for k in range(n)]
        for base in (DYNAMICS, *([RATES] * bool(self.manifest.configuration)), *([OUTPUTS] * bool(self.outputs))):
            kernel = self._find(base, Order.JACOBIAN)
            results = []
            for block in kernel.outputs:
                results.append(free)
                column = self.first[_find_role(kernel, block)]
                for k, (r, c) in enumerate(_list_nonzeros(block)):
                    entries.append(Entry(rows[base] + r, column + c, free + k))
                free += _count(block)
            calls.append(Call(kernel, self._place(kernel), tuple(results)))
        known = self.states + self.inputs
        return tuple(calls), tuple(e for e in entries if e.column < known), free

    def _call(self, kernel: Kernel | None, result: int) -> Call | None:
        return None if kernel is None else Call(kernel, self._place(kernel), (result,))

    def _place(self, kernel: Kernel) -> tuple[int, ...]:
        return tuple(self.first[argument.role] for argument in kernel.inputs)

    def _find(self, base: str, order: Order = Order.VALUE) -> Kernel:
        kernel = self.manifest.find(base, order)
        if kernel is None:
            raise FmuError(f"{self.manifest.model} was generated without {base} and its derivatives")
        return kernel


def _check(manifest: Manifest) -> None:
    if manifest.loops or manifest.driven:
        raise FmuError(
            f"{manifest.model} has closed loops or driven joints, whose states FMI would let drift; "
            "simulate it with mbsrun simulate"
        )


def _find_role(kernel: Kernel, block: Argument) -> Role:
    return next(argument.role for argument in kernel.inputs if argument.name == block.by)


def _count(argument: Argument) -> int:
    return argument.rows * argument.cols if argument.colind is None else argument.colind[-1]


def _list_nonzeros(argument: Argument) -> Iterator[tuple[int, int]]:
    """List the rows and columns of nonzeros, column by column."""
    if argument.colind is None or argument.row is None:
        yield from ((r, c) for c in range(argument.cols) for r in range(argument.rows))
        return
    for c in range(argument.cols):
        yield from ((argument.row[k], c) for k in range(argument.colind[c], argument.colind[c + 1]))
