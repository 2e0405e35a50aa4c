"""Kernels laid out for loops in C: the arrays that they read and write, and their lists of arguments."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from mbsgen import resources
from mbsgen.manifest import Argument, Kernel, Manifest
from mbsrun.binding import Entry, declare
from mbsrun.kernel import Kernels
from mbsrun.library import compile_library, find_compiler, once_per_compiler

if TYPE_CHECKING:
    import cffi

Array = NDArray[np.float64]


@runtime_checkable
class Source(Protocol):
    """Kernels of one model, perhaps from several folders."""

    @property
    def manifest(self) -> Manifest:
        """Describe the model."""

    def find_holder(self, name: str) -> Kernels:
        """Return the loaded kernels among which one is."""


class Memory:
    """Arrays by name, which C functions have pointers to: q, qd and the rest of the inputs, and results."""

    def __init__(self, ffi: Any, kernels: Source, arrays: Mapping[str, Array]) -> None:
        """Take arrays of inputs under their kernels' names; `u` and `w` are parts of the array `v`."""
        self.ffi, self.kernels = ffi, kernels
        self.arrays = {**arrays}
        self.inputs = {name: self.pointer(name) for name in self.arrays}
        if "v" in self.arrays:
            forces = len(kernels.manifest.actuated)
            self.inputs |= {"u": self.inputs["v"], "w": self.inputs["v"] + forces}
        self._kept: list[Any] = []  # objects that C has pointers to
        self._filled: dict[str, dict[str, Array]] = {}  # by kernel: the inputs that come from parameters

    def add(self, name: str, size: int) -> Any:
        """Make an array, and return a pointer to it."""
        self.arrays[name] = np.zeros(size)
        return self.pointer(name)

    def pointer(self, name: str) -> Any:
        """Return a pointer to an array."""
        return self.ffi.cast("double *", self.arrays[name].ctypes.data)

    def keep(self, value: Any) -> Any:
        """Keep an object as long as this memory, and return it."""
        self._kept.append(value)
        return value

    def bind(self, name: str) -> Entry:
        """Return a bound kernel, and keep its inputs that come from parameters."""
        holder = self.kernels.find_holder(name)
        entry = holder.bind(name)
        self._filled[name] = {key: x.copy() for key, x in holder.filled.items()}
        return entry

    def fill(self, kernels: Source) -> None:
        """Take the parameters of kernels that are the same else."""
        for name, arrays in self._filled.items():
            for key, x in kernels.find_holder(name).filled.items():
                arrays[key][:] = x

    def describe(self, name: str) -> Kernel:
        """Describe a kernel."""
        return self.kernels.find_holder(name).describe(name)

    @property
    def filled(self) -> Mapping[str, Mapping[str, Array]]:
        """The arrays of inputs that come from parameters, by kernel and by name."""
        return self._filled

    def lay(self, entry: Entry, results: Mapping[str, str]) -> tuple[Any, Any, Any]:
        """Return a kernel's function and its lists of arguments; `results` names the array of each result."""
        arg, res = self.ffi.new("const double *[]", entry.n_in), self.ffi.new("double *[]", entry.n_out)
        filled = self._filled[entry.kernel.name]
        inputs = self.inputs | {key: self.ffi.cast("double *", x.ctypes.data) for key, x in filled.items()}
        for port in entry.inputs:
            arg[port.position] = inputs[port.argument.name]
        for port in entry.outputs:
            if port.argument.name in results:
                res[port.position] = self.pointer(results[port.argument.name])
        function = self.ffi.cast("mbs_kernel", int(entry.ffi.cast("intptr_t", entry.function)))
        return function, self.keep(arg), self.keep(res)

    def place(self, entry: Entry, argument: Argument) -> Any:
        """Return which entry of the full matrix, row by row, each nonzero of a result is."""
        numbers = next(port for port in entry.outputs if port.argument == argument).spread()
        places = np.flatnonzero(numbers >= 0)[np.argsort(numbers[numbers >= 0])]
        return self.integers(places)

    def integers(self, values: Iterable[int]) -> Any:
        """Keep whole numbers, and return a pointer to them."""
        return self.keep(self.ffi.new("long long[]", [*map(int, values), 0]))  # an array without an entry is none


def load_functions(declarations: str, *sources: str) -> tuple[Any, Any]:
    """Compile C files of the project, and return the library of the functions that are declared."""
    return _load(declarations, sources)


@once_per_compiler
def _load(declarations: str, sources: tuple[str, ...]) -> tuple[cffi.FFI, Any]:
    ffi = declare(declarations)
    library = compile_library(resources.folder("csrc"), "mbs_simulate", sources, find_compiler(os.environ))
    return ffi, ffi.dlopen(str(library))
