"""C functions, and where they take their arguments; called on the arrays of one state with little overhead in Python.

Calls use the functions in CasADi's contract, since their signature is the same for all kernels. The library's own
description of the arguments is compared with the manifest before anything is called.
"""

from __future__ import annotations

import ast
import ctypes
import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

import _cffi_backend
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbsgen.errors import MbsError
from mbsgen.manifest import Argument, Kernel
from mbsgen.roles import Role
from mbsrun.cache import COMPILED, DECLARED, find_or_make
from mbsrun.library import SHARED, CompileError

if TYPE_CHECKING:
    import cffi

Array = NDArray[np.float64]
Status = NDArray[np.int32]

_FACE = """
typedef int mbs_kernel(const double **arg, double **res, long long *iw, double *w, int mem);
typedef long long mbs_n(void);
typedef const char *mbs_name(long long i);
typedef const long long *mbs_sparsity(long long i);
"""
_POINTERS, _STEPS = "double *[]", "long long[]"
NULL: Any = _cffi_backend.FFI("mbs").NULL
MASKED = "some entries are masked, so they have no numbers"
ROUNDED = "{} given, float64 expected; convert it by astype(np.float64), if its digits suffice"


class ArgumentError(MbsError):
    """A kernel that does not exist, or arguments that do not fit."""


def is_exact(array: NDArray[Any]) -> bool:
    """Whether an array holds real numbers of a type that is meant for float64: of float64, or whole numbers."""
    return array.dtype.kind in "iu" or (array.dtype.kind == "f" and array.dtype.itemsize == np.dtype(float).itemsize)


def check_numbers(**values: ArrayLike) -> None:
    """Raise ArgumentError for arrays with masked entries, whose values NumPy would take, and of other digits."""
    masked = [name for name, value in values.items() if np.ma.is_masked(value)]
    if masked:
        raise ArgumentError(f"{', '.join(masked)}: {MASKED}")
    for name, value in values.items():
        if isinstance(value, np.ndarray) and value.dtype.kind == "f" and not is_exact(value):
            raise ArgumentError(f"{name}: {ROUNDED.format(value.dtype)}")


@dataclass(frozen=True)
class Port:
    """An argument, and where the C function takes it."""

    argument: Argument
    position: int

    @cached_property
    def is_vector(self) -> bool:
        """Whether it is a column that is passed as a one-dimensional array."""
        return self.argument.cols == 1 and not self.argument.matrix

    @cached_property
    def is_hidden(self) -> bool:
        """Whether it is computed from the run-time parameters, and filled in for the caller."""
        return self.argument.role is Role.SETUP

    @cached_property
    def shape(self) -> tuple[int, ...]:
        """Shape of one state's array."""
        a = self.argument
        return (a.rows,) if self.is_vector else (a.rows, a.cols)

    @cached_property
    def places(self) -> tuple[NDArray[np.intp], NDArray[np.intp]] | None:
        """Rows and columns of the nonzeros; None where every entry is one."""
        a = self.argument
        if a.row is None or a.colind is None:
            return None
        return np.array(a.row, dtype=np.intp), np.repeat(np.arange(a.cols), np.diff(a.colind))

    @cached_property
    def entries(self) -> NDArray[np.int64] | None:
        """Which nonzero each number is, row by row, -1 for none; None where they are all the numbers, in turn."""
        entries = self.spread().astype(np.int64)
        return None if np.array_equal(entries, np.arange(entries.size)) else entries

    def find_places(self, strides: tuple[int, ...]) -> NDArray[np.int64] | None:
        """Return where the nonzeros of one state stand in an array, counted in numbers; None: one after the other."""
        if strides not in self._places:
            a = self.argument
            rows, cols = self.places or (np.tile(np.arange(a.rows), a.cols), np.repeat(np.arange(a.cols), a.rows))
            places = (rows * strides[0] + cols * (strides[1] if len(strides) > 1 else 0)).astype(np.int64)
            self._places[strides] = None if np.array_equal(places, np.arange(places.size)) else places
        return self._places[strides]

    @cached_property
    def _places(self) -> dict[tuple[int, ...], NDArray[np.int64] | None]:
        """Found places, by the strides of arrays."""
        return {}

    def spread(self) -> NDArray[np.intp]:
        """Return, for each entry, row by row, the index of its nonzero; -1: none."""
        a = self.argument
        if self.places is None:
            return np.arange(a.nnz, dtype=np.intp).reshape(a.cols, a.rows).T.ravel()
        numbers = np.full((a.rows, a.cols), -1, dtype=np.intp)
        numbers[self.places] = np.arange(a.nnz)
        return numbers.ravel()


@dataclass(frozen=True, eq=False)
class Layout:
    """Arguments of many states, as `mbs_many.c` takes them: all that calls of equal shapes and strides share."""

    given: Any
    found: Any
    room: int  # bytes


@dataclass(frozen=True)
class Entry:
    """A kernel, bound to its function in a loaded library."""

    kernel: Kernel
    ffi: cffi.FFI
    function: Any
    n_in: int
    n_out: int
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    free: list[_Desk] = field(default_factory=list)  # taken and put back whole, so that threads do not share one
    laid: dict[object, list[Layout]] = field(default_factory=dict)  # likewise, of many states by shapes and strides

    @cached_property
    def wanted(self) -> dict[str, Port]:
        """The inputs that the caller may give, by name."""
        return {port.argument.name: port for port in self.inputs}

    @cached_property
    def takes_hidden(self) -> bool:
        """Return whether it needs run-time parameters."""
        return self.kernel.taking(Role.SETUP) is not None

    @cached_property
    def hidden(self) -> str | None:
        """The name of the input that the set-up of parameters gives, if it needs them."""
        found = self.kernel.taking(Role.SETUP)
        return found.name if found else None

    @cached_property
    def design(self) -> str | None:
        """The name of the input for differentiated parameters, if it needs them."""
        found = self.kernel.taking(Role.DESIGN)
        return found.name if found else None

    def call_once(self, inputs: Mapping[str, ArrayLike], hidden: Array | None) -> tuple[int, dict[str, Array]] | None:
        """Call for one state or a batch of one; return the status and dense results, None if the inputs do not fit."""
        try:
            desk = self.free.pop()
        except IndexError:
            desk = _Desk(self)
        if not desk.lay(inputs):
            self.free.append(desk)
            return None
        if desk.hidden is not None and hidden is not None:
            desk.arg[desk.hidden] = self.ffi.from_buffer("double[]", hidden.data)
        status = self.function(desk.arg, desk.res, NULL, NULL, 0)
        results = {} if status else desk.read()
        self.free.append(desk)
        return status, results


class _Desk:
    """Memory for the arguments of one call, laid out once, since this takes longer than most calls."""

    def __init__(self, entry: Entry) -> None:
        ffi = entry.ffi
        given = [port for port in entry.inputs if port.argument.nnz and not port.is_hidden]
        self.hidden = next((port.position for port in entry.inputs if port.is_hidden), None)
        self.is_plain = all(port.places is None for port in given)
        self.given = np.zeros(sum(port.argument.nnz for port in given))
        self.found = np.zeros(sum(port.argument.nnz for port in entry.outputs) + 1)  # the last, [-1], stays 0
        self.arg, self.res = ffi.new(f"const {_POINTERS}", entry.n_in), ffi.new(_POINTERS, entry.n_out)
        self.slots: list[tuple[str, tuple[int, ...], Array]] = []
        start, room = 0, ffi.from_buffer("double[]", self.given.data)
        for port in given:
            a = port.argument
            self.arg[port.position] = room + start
            block = self.given[start : start + a.nnz]
            slot = block if port.is_vector or port.places else block.reshape(a.cols, a.rows).T
            self.slots.append((a.name, port.shape, slot))
            start += a.nnz
        start, room = 0, ffi.from_buffer("double[]", self.found.data)
        spread, self.results, end = [np.zeros(0, dtype=np.intp)], [], 0
        for port in entry.outputs:
            self.res[port.position] = room + start
            numbers = port.spread()
            spread.append(np.where(numbers < 0, -1, numbers + start))
            self.results.append((port.argument.name, end, end + numbers.size, None if port.is_vector else port.shape))
            start, end = start + port.argument.nnz, end + numbers.size
        self.spread = np.concatenate(spread)
        self.is_batch = False

    def lay(self, inputs: Mapping[str, ArrayLike]) -> bool:
        """Copy the inputs to the memory that the function reads; return whether they are complete and fit one state."""
        if not self.is_plain or len(inputs) != len(self.slots):
            return False
        self.is_batch = False
        for name, shape, slot in self.slots:
            array = inputs.get(name)
            if type(array) is not np.ndarray:
                if np.ma.is_masked(array):
                    return False
                try:
                    array = np.asarray(array)
                except (ValueError, RuntimeError):
                    return False
            if array.shape != shape:
                if array.shape != (1, *shape):
                    return False
                array, self.is_batch = array[0], True
            if not is_exact(array):
                return False
            slot[...] = array
        return True

    def read(self) -> dict[str, Array]:
        """Copy the results from the memory that the function wrote."""
        entries = self.found.take(self.spread)
        found = {
            name: entries[start:end] if shape is None else entries[start:end].reshape(shape)
            for name, start, end, shape in self.results
        }
        return {name: array[None] for name, array in found.items()} if self.is_batch else found


def bind(library: Path, kernel: Kernel) -> Entry:
    """Load a library and find a kernel's arguments in it.

    Raises CompileError for a library that cannot be loaded, ArgumentError where it and the manifest differ.
    """
    ffi = declare(_FACE)
    try:
        lib = ctypes.CDLL(str(library))
    except OSError as error:
        raise _refuse(library, error) from None

    def find(kind: str, end: str = "") -> Any:
        address = ctypes.cast(lib[f"{kernel.symbol}{end}"], ctypes.c_void_p).value or 0
        return ffi.cast(f"mbs_{kind} *", address)

    try:
        function, n_in, n_out = find("kernel"), find("n", "_n_in")(), find("n", "_n_out")()
        inputs = tuple(_find_ports(ffi, find, n_in, "in", kernel.inputs))
        outputs = tuple(_find_ports(ffi, find, n_out, "out", kernel.outputs))
    except (AttributeError, LookupError):  # a name of libm would be found, but not its description
        finding = "the manifest and the C files disagree"
        raise ArgumentError(f"{kernel.symbol}: {finding}; generate the folder again") from None
    return Entry(kernel, ffi, function, n_in, n_out, inputs, outputs)


@lru_cache(maxsize=1024)
def declare(text: str) -> cffi.FFI:
    """Return the interface of C declarations; the cache keeps what cffi reads, which takes longer than a short solve.

    Raises CacheError.
    """
    name = hashlib.sha256(f"{_cffi_backend.__version__} {text}".encode()).hexdigest()[:40]

    def make(building: Path) -> Path:
        made = building / "declared"
        made.write_text(repr(_read_declarations(text, building / "module.py")), encoding="utf-8")
        return made

    kept = find_or_make(PurePath(COMPILED, SHARED, f"declared-{name}{DECLARED}"), make)
    parts: Any = ast.literal_eval(kept.read_text(encoding="utf-8"))
    ffi: Any = _cffi_backend.FFI("mbs", **parts)
    return ffi  # type: ignore[no-any-return]


def _read_declarations(text: str, module: Path) -> dict[str, Any]:
    """Read declarations by cffi; return the literal arguments of its interface, as in a module that it writes."""
    import cffi  # here and below: they load a parser of C
    from cffi import recompiler

    ffi = cffi.FFI()
    ffi.cdef(text)
    recompiler.make_py_source(ffi, "mbs", str(module))
    (call,) = (node for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))) if isinstance(node, ast.Call))
    return {str(keyword.arg): ast.literal_eval(keyword.value) for keyword in call.keywords}


def find_function(library: Path, name: str) -> int | None:
    """Return the address of a function in a library; None where it has none. Raises CompileError."""
    try:
        loaded = ctypes.CDLL(str(library))
    except OSError as error:
        raise _refuse(library, error) from None
    try:
        return ctypes.cast(loaded[name], ctypes.c_void_p).value
    except AttributeError:
        return None


def open_library(ffi: cffi.FFI, library: Path) -> Any:
    """Load a library for the functions that `ffi` declares. Raises CompileError."""
    try:
        return ffi.dlopen(str(library))
    except OSError as error:
        raise _refuse(library, error) from None


def _refuse(library: Path, error: OSError) -> CompileError:
    return CompileError(f"{library} cannot be loaded: {error}; remove it, it will be compiled again")


def _find_ports(
    ffi: cffi.FFI, find: Callable[..., Any], size: int, side: str, arguments: tuple[Argument, ...]
) -> Iterator[Port]:
    names, sparsity = (find(kind, f"_{kind}_{side}") for kind in ("name", "sparsity"))
    positions = {ffi.string(names(i)): i for i in range(size)}
    for argument in arguments:
        position = positions[argument.name.encode()]
        pattern = sparsity(position)
        if any(pattern[i] != x for i, x in enumerate(_compress(argument))):
            raise LookupError(argument.name)
        yield Port(argument, position)


def _compress(argument: Argument) -> list[int]:
    """Return a pattern as the library does."""
    if argument.row is None or argument.colind is None:
        return [argument.rows, argument.cols, 1]
    return [argument.rows, argument.cols, *argument.colind, *argument.row]
