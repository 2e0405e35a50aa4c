"""Kernels in many states: arrays as they lie in memory -> `mbs_many.c`, one state after the other or several in lanes.

A kernel that is compiled with -DMBS_STATES=8 computes 8 states at once. The arrays are read and written in place, with
any strides.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from mbsgen import resources
from mbsgen.manifest import Kernel
from mbsrun.binding import NULL, Array, Entry, Layout, Port, Status, declare, find_function, open_library
from mbsrun.library import Compiler, compile_library

if TYPE_CHECKING:
    import cffi

# Lanes want a kernel compiled once more, which takes long for a long one. They are worth it where a batch has this many
# states, and a state for this many bytes of the kernel's source; the 1001 states that a motion has by default take less
# than a millisecond without. The batch alone decides: earlier calls must not change last digits.
FEWEST, BYTES_PER_STATE = 2000, 100
LAID = 16  # descriptions of arguments that are kept for a kernel, by their shapes and strides
# Macros of compilers, each with how many doubles fill a register, the most first.
_WIDTHS = (("__AVX512F__", 8), ("__AVX__", 4), ("__SSE2__", 2), ("__ARM_NEON", 2))
_DECLARED = """
typedef struct {{ const double *first; long long step, nonzeros; const long long *places; }} mbs_given;
typedef struct {{ double *first; long long step, apart, nonzeros, numbers; const long long *entries; }} mbs_found;
size_t mbs_room_of_many{0}(long long n_in, const mbs_given *in, long long n_out, const mbs_found *out);
long long mbs_compute_many{0}(void *one, void *several, long long states, long long begin, long long end,
                              long long n_in, const mbs_given *in, long long n_out, const mbs_found *out,
                              void *room, int *status);
"""
Result = TypeVar("Result")
_ITEM = np.dtype(np.float64).itemsize


@dataclass(frozen=True)
class Loop:
    """The loop over states in C, for `width` of them at once."""

    ffi: cffi.FFI
    library: Any
    width: int

    def get(self, name: str) -> Any:
        """Return a function of mbs_many.c."""
        return getattr(self.library, name + end_name(self.width))


@dataclass(frozen=True)
class Several:
    """A kernel that computes several states at once."""

    library: Path  # which holds it
    function: int  # its address


def find_width(compiler: Compiler) -> int:
    """Return how many states a kernel of this compiler computes best at once; 1 where it knows no vectors."""
    defined = set(compiler.macros.split())
    return next((width for macro, width in _WIDTHS if macro in defined and "__GNUC__" in defined), 1)


def load_loop(compiler: Compiler, width: int) -> Loop:
    """Compile and load the loop. Raises CompileError."""
    library = compile_library(resources.folder("csrc"), "mbs_many", ["mbs_many.c"], for_states(compiler, width))
    ffi = declare(_DECLARED.format(end_name(width)))
    return Loop(ffi, open_library(ffi, library), width)


def load_several(library: Path, kernel: Kernel, width: int) -> Several | None:
    """Load a kernel from a library that is compiled for several states; None where it computes one at a time.

    Raises CompileError.
    """
    address = find_function(library, kernel.symbol + end_name(width))
    return None if address is None else Several(library, address)


def for_states(compiler: Compiler, width: int) -> Compiler:
    """Return the compiler for kernels that compute `width` states at once."""
    return replace(compiler, flags=(*compiler.flags, f"-DMBS_STATES={width}")) if width > 1 else compiler


def compute(
    loop: Loop,
    entry: Entry,
    several: Several | None,
    inputs: Sequence[tuple[Port, Array]],
    results: Mapping[str, Array],
    states: int,
    *,
    sparse: bool,
    threads: int,
) -> Status:
    """Call a kernel in many states; an input has the shape of one state's array, or a leading batch axis.

    Writes the results, shapes (states, *shape), or with `sparse` the nonzeros, (states, nnz): NaN where a state's
    status is not 0. Returns the statuses, shape (states,). The bits do not depend on the number of threads.
    """
    given = [(port, array.copy() if any(x % _ITEM for x in array.strides) else array) for port, array in inputs]
    found = [(port, results[port.argument.name]) for port in entry.outputs]
    key = loop.width, sparse, tuple((port.position, a.shape, a.strides) for port, a in given)
    try:
        laid = entry.laid[key].pop()
    except LookupError:
        laid = _lay(loop, entry, given, found, sparse=sparse)
    kept = [*_point(loop.ffi, laid.given, given), *_point(loop.ffi, laid.found, found)]
    status = _run(loop, entry, several, laid, results.values(), states, threads)
    kept.clear()
    if len(entry.laid) > LAID:
        entry.laid.clear()
    entry.laid.setdefault(key, []).append(laid)
    return status


def _lay(
    loop: Loop,
    entry: Entry,
    given: Sequence[tuple[Port, Array]],
    found: Sequence[tuple[Port, Array]],
    *,
    sparse: bool,
) -> Layout:
    """Describe inputs and results of these shapes and strides."""
    ffi = loop.ffi
    laid = ffi.new("mbs_given[]", entry.n_in), ffi.new("mbs_found[]", entry.n_out)
    for port, array in given:
        _describe(ffi, laid[0][port.position], port, array)
    for port, array in found:
        _describe_result(ffi, laid[1][port.position], port, array, sparse=sparse)
    return Layout(*laid, loop.get("mbs_room_of_many")(entry.n_in, laid[0], entry.n_out, laid[1]))


def _run(
    loop: Loop,
    entry: Entry,
    several: Several | None,
    laid: Layout,
    results: Iterable[Array],
    states: int,
    threads: int = 1,
) -> Status:
    """Call a kernel on described inputs and results, and mark what failed."""
    ffi, status = loop.ffi, np.zeros(states, dtype=np.int32)
    arguments = (entry.n_in, laid.given, entry.n_out, laid.found)
    one, wide = (ffi.cast("void *", f) for f in (entry.function, several.function if several else NULL))
    told = ffi.from_buffer("int[]", status.data)

    def work(part: range) -> int:
        room = ffi.new("char[]", laid.room)
        return int(loop.get("mbs_compute_many")(one, wide, states, part.start, part.stop, *arguments, room, told))

    if sum(share(work, range(states), loop.width, threads)):
        for array in results:
            array[status != 0] = np.nan
    return status


def share(work: Callable[[range], Result], states: range, width: int, threads: int) -> list[Result]:
    """Do the work on parts of the states, in whole groups of `width`, each in a thread; return what it gives."""
    groups = -(-len(states) // width)
    ends = [min(states.start + groups * k // threads * width, states.stop) for k in range(threads + 1)]
    parts = [range(begin, end) for begin, end in pairwise(ends)]
    if threads == 1:
        return list(map(work, parts))
    with ThreadPoolExecutor(threads) as pool:  # while C computes, other threads go on
        return list(pool.map(work, parts))


@dataclass(frozen=True, eq=False)
class Rows:
    """A kernel on nonzeros of many states, laid out except for the addresses of its arguments."""

    compute: Callable[[int], int]  # to the statuses at an address; returns how many states fail
    given: tuple[Any, ...]
    found: tuple[Any, ...]
    point: Callable[[int], Any]
    kept: tuple[Any, ...]  # what the others point to

    def run(self, given: Iterable[int], found: Iterable[int], status: int) -> int:
        """Call the kernel on numbers at these addresses; write results and statuses; return how many states fail."""
        for argument, address in zip(self.given, given, strict=True):
            argument.first = self.point(address)
        for argument, address in zip(self.found, found, strict=True):
            argument.first = self.point(address)
        return self.compute(status)


def lay_rows(
    loop: Loop,
    entry: Entry,
    several: Several | None,
    inputs: Sequence[tuple[Port, tuple[int, int]]],
    outputs: Sequence[Port],
    states: int,
) -> Rows:
    """Lay out a call on nonzeros: of inputs with these strides from state to state, 0 for one row, and in a state.

    Results are contiguous, a row for each state.
    """
    ffi = loop.ffi
    given, found = ffi.new("mbs_given[]", entry.n_in), ffi.new("mbs_found[]", entry.n_out)
    kept = []
    for port, (step, apart) in inputs:
        size = port.argument.nnz
        places = NULL if apart == 1 or size == 1 else ffi.new("long long[]", [apart * k for k in range(size)])
        given[port.position] = (NULL, step, size, places)
        kept.append(places)
    for port in outputs:
        size = port.argument.nnz
        found[port.position] = (NULL, size, 1, size, size, NULL)
    room = ffi.new("char[]", loop.get("mbs_room_of_many")(entry.n_in, given, entry.n_out, found))
    one, wide = (ffi.cast("void *", f) for f in (entry.function, several.function if several else NULL))
    compute = partial(
        loop.get("mbs_compute_many"), one, wide, states, 0, states, entry.n_in, given, entry.n_out, found, room
    )
    to_statuses, to_numbers = ffi.typeof("int *"), ffi.typeof("double *")
    return Rows(
        lambda status: int(compute(ffi.cast(to_statuses, status))),
        tuple(given[port.position] for port, _ in inputs),
        tuple(found[port.position] for port in outputs),
        partial(ffi.cast, to_numbers),
        (given, found, *kept),
    )


def find_room(loop: Loop, entry: Entry, inputs: Sequence[Port], outputs: Sequence[Port]) -> int:
    """Return how many bytes the loop needs for these arguments."""
    given, found = loop.ffi.new("mbs_given[]", entry.n_in), loop.ffi.new("mbs_found[]", entry.n_out)
    for ports, items in ((inputs, given), (outputs, found)):
        for port in ports:
            items[port.position].nonzeros = port.argument.nnz
    return int(loop.get("mbs_room_of_many")(entry.n_in, given, entry.n_out, found))


def end_name(width: int) -> str:
    """Return the end of the names of functions for `width` states at once."""
    return f"_at_{width}" if width > 1 else ""


def _point(ffi: cffi.FFI, laid: Any, arrays: Sequence[tuple[Port, Array]]) -> list[Any]:
    """Point described arguments at the first numbers of arrays; return what must outlive the call."""
    kept = []
    for port, array in arrays:
        if array.size:
            first = _point_to(ffi, array)
            laid[port.position].first = first
            kept.append(first)
    return kept


def _describe(ffi: cffi.FFI, given: Any, port: Port, array: Array) -> None:
    """Describe an input for `mbs_many.c`."""
    if not array.size:
        return
    has_batch = array.ndim > len(port.shape)
    strides = tuple(stride // _ITEM for stride in array.strides)
    given.step = strides[0] if has_batch and array.shape[0] > 1 else 0
    given.nonzeros = port.argument.nnz
    places = port.find_places(strides[has_batch:])
    given.places = NULL if places is None else ffi.from_buffer("long long[]", places.data)  # which the port keeps


def _describe_result(ffi: cffi.FFI, found: Any, port: Port, array: Array, *, sparse: bool) -> None:
    """Describe a result likewise."""
    if not array.size:
        return
    entries = None if sparse else port.entries
    found.step = found.numbers = array[0].size
    found.apart, found.nonzeros = 1, port.argument.nnz
    found.entries = NULL if entries is None else ffi.from_buffer("long long[]", entries.data)


def _point_to(ffi: cffi.FFI, array: Array) -> Any:
    """Return a pointer to the first number of an array."""
    if array.flags.c_contiguous:  # an array's other ways to its address take longer than a kernel
        return ffi.from_buffer("double[]", array.data)
    return ffi.cast("double *", array.ctypes.data)
