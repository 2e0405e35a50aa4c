"""The NumPy face of generated kernels: arrays by name in, arrays by name out, one state or a batch of them.

Calls go through the functions in CasADi's contract, since they take any kernel's arguments alike; the library's own
account of those arguments is compared with the manifest before anything is called.
"""

from __future__ import annotations

import copy
import hashlib
import math
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any, Self

import cffi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbsgen import manifest as manifests
from mbsgen import resources
from mbsgen.errors import MbsError
from mbsgen.manifest import Argument, Kernel, Manifest
from mbsrun.library import CompileError, building_place, cache_folder, compile_folder

Array = NDArray[np.float64]

HIDDEN = "h"  # what `setup` makes of the run-time parameters; filled in for the caller
# Matrices even with one column.
_MATRICES = {
    "in": frozenset({"adj_position", "adj_v", "adj_omega"}),
    "out": frozenset({"M", "position", "v", "omega", "J", "p", "R"}),
}
_BATCH = """
typedef int (*mbs_kernel)(const double **arg, double **res, long long *iw, double *w, int mem);
int mbs_batch(mbs_kernel f, long long states, long long n_in, const double **arg, const long long *arg_step,
              long long n_out, double **res, const long long *res_step, long long *failed);
"""
_FACE = """
int {0}(const double **arg, double **res, long long *iw, double *w, int mem);
long long {0}_n_in(void);
long long {0}_n_out(void);
const char *{0}_name_in(long long i);
const char *{0}_name_out(long long i);
const long long *{0}_sparsity_in(long long i);
const long long *{0}_sparsity_out(long long i);
"""


class ArgumentError(MbsError):
    """A kernel that is called with what it does not take, or that there is not."""


class KernelError(MbsError):
    """A kernel that returned a nonzero status: it failed at a joint."""

    def __init__(self, kernel: str, joint: str, state: int) -> None:
        self.kernel, self.joint, self.state = kernel, joint, state
        super().__init__(f"{kernel} failed at joint {joint}, in state {state} (from 0) of those given")


@dataclass(frozen=True)
class _Port:
    """An argument, and where the C function takes it."""

    argument: Argument
    position: int
    is_vector: bool  # a column that is passed as a one-dimensional array

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


@dataclass(frozen=True)
class _Entry:
    """A kernel of the library."""

    kernel: Kernel
    function: Any
    n_in: int
    n_out: int
    inputs: tuple[_Port, ...]
    outputs: tuple[_Port, ...]


class Kernels:
    """The kernels of a generated folder, compiled and loaded.

    `k("impl", q=…, qd=…, qdd=…, u=…)` and `k.impl(q=…, …)` call a kernel; see `__call__`.
    """

    manifest: Manifest
    library: Path
    parameters: Mapping[str, float]  # the run-time parameters in use, by the user's names

    def __init__(self, folder: str | Path, parameters: Mapping[str, float] | None = None) -> None:
        """Compile the folder, unless it is in the cache, and load it. `parameters` replace the model's values."""
        folder = Path(folder)
        self.manifest = manifests.read(folder / manifests.FILE_NAME)
        self.library = compile_folder(folder)
        self._ffi, self._lib = _open(self.library, self.manifest)
        self._entries = {k.name: _bind(self._ffi, self._lib, k) for k in self.manifest.kernels}
        self._hidden = np.zeros(0)
        self._set_parameters({p.name: p.value for p in self.manifest.parameters}, parameters or {})

    def with_parameters(self, **parameters: float) -> Self:
        """Return the same kernels with other values of the named run-time parameters."""
        other = copy.copy(self)
        other._set_parameters(self.parameters, parameters)
        return other

    def __call__(self, name: str, /, *, sparse: bool = False, **inputs: ArrayLike) -> dict[str, Array]:
        """Call a kernel; return its results by name.

        A column is an array of shape (rows,), a matrix one of (rows, cols); Jacobians, positions and rotations are
        matrices even with one column. Any input may have a leading batch axis; results then have it too, and inputs
        without one are the same for all states. sparse: give the nonzeros only, column by column, shape (nnz,).
        Inputs without an entry may be left out. Raises ArgumentError for inputs that do not fit, KernelError where a
        state cannot be computed.
        """
        entry = self._entry(name)
        arrays = self._collect(entry, inputs)
        batches = {array.shape[0] for port, array in arrays if array.ndim > len(port.shape)}
        if len(batches) > 1:
            raise ArgumentError(
                f"{name}: the inputs have batches of {sorted(batches)} states; give all the same number"
            )
        states = batches.pop() if batches else 1
        nonzeros = self._run(entry, [(port, _gather(name, port, array)) for port, array in arrays], states)
        results = {
            port.argument.name: values if sparse else _scatter(port, values)
            for port, values in zip(entry.outputs, nonzeros, strict=True)
        }
        is_batch = any(array.ndim > len(port.shape) for port, array in arrays)
        return results if is_batch else {key: value[0] for key, value in results.items()}

    def __getattr__(self, name: str) -> Callable[..., dict[str, Array]]:
        """Give a kernel as a function."""
        if name.startswith("_") or name not in self.__dict__.get("_entries", {}):
            raise AttributeError(f"{type(self).__name__} has no attribute or kernel {name!r}")
        return partial(self, name)

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._entries]

    def _entry(self, name: str) -> _Entry:
        entry = self._entries.get(name)
        if entry is None:
            raise ArgumentError(f"{self.manifest.model} has no kernel {name!r}; there are {', '.join(self._entries)}")
        return entry

    def _set_parameters(self, present: Mapping[str, float], changes: Mapping[str, float]) -> None:
        unknown = [name for name in changes if name not in present]
        if unknown:
            known = f"there are {', '.join(present)}" if present else "the model has none"
            raise ArgumentError(f"no run-time parameter {', '.join(unknown)}; {known}")
        wrong = [f"{name} = {value!r}" for name, value in changes.items() if not _is_finite(value)]
        if wrong:
            raise ArgumentError(f"{', '.join(wrong)}: a parameter must be a finite number")
        self.parameters = {name: float(changes.get(name, value)) for name, value in present.items()}
        if "setup" in self._entries:
            self._hidden = self("setup", p=list(self.parameters.values()))[HIDDEN]

    def _collect(self, entry: _Entry, inputs: Mapping[str, ArrayLike]) -> list[tuple[_Port, Array]]:
        """Pair ports with arrays; all that does not fit is told at once."""
        ports = {port.argument.name: port for port in entry.inputs}
        wanted = {name: port for name, port in ports.items() if name != HIDDEN}
        faults = [f"{name}: there is no such input" for name in inputs if name not in wanted]
        arrays = []
        for name, port in wanted.items():
            if name not in inputs:
                faults += [f"{name}: missing, shape {_text(port.shape)}"] if port.argument.nnz else []
                continue
            array = _read(inputs[name])
            if array is None:
                faults.append(f"{name}: not an array of real numbers, shape {_text(port.shape)} expected")
            elif array.shape[-len(port.shape) :] != port.shape or array.ndim > len(port.shape) + 1:
                batch = _text(("batch", *port.shape))
                faults.append(f"{name}: shape {_text(array.shape)} given, {_text(port.shape)} or {batch} expected")
            else:
                arrays.append((port, array))
        if faults:
            raise ArgumentError("\n".join(f"{entry.kernel.name}: {fault}" for fault in faults))
        hidden = [(port, self._hidden) for name, port in ports.items() if name == HIDDEN]
        return arrays + hidden

    def _run(self, entry: _Entry, inputs: list[tuple[_Port, Array]], states: int) -> list[Array]:
        """Call the kernel for every state; inputs and results by nonzeros, one row a state."""
        ffi = self._ffi
        arg, arg_step = ffi.new("const double *[]", entry.n_in), ffi.new("long long[]", entry.n_in)
        res, res_step = ffi.new("double *[]", entry.n_out), ffi.new("long long[]", entry.n_out)
        for port, nonzeros in inputs:
            arg[port.position] = ffi.from_buffer("double[]", nonzeros.data)
            arg_step[port.position] = nonzeros.shape[1] if nonzeros.shape[0] == states else 0
        results = [np.empty((states, port.argument.nnz)) for port in entry.outputs]
        for port, nonzeros in zip(entry.outputs, results, strict=True):
            res[port.position] = ffi.from_buffer("double[]", nonzeros.data)
            res_step[port.position] = nonzeros.shape[1]
        failed = ffi.new("long long *")
        status = self._lib.mbs_batch(
            entry.function, states, entry.n_in, arg, arg_step, entry.n_out, res, res_step, failed
        )
        if status:
            names = [c.name for c in self.manifest.coordinates]
            joint = names[status - 1] if 0 < status <= len(names) else f"number {status}"
            raise KernelError(entry.kernel.name, joint, failed[0])
        return results


def find_folder(path: Path) -> Path:
    """Give the generated folder at `path`; for a model file, one in the user's cache, made by mbsgen if it is new.

    It is found again by the bytes of the model and of mbsgen, so a stale one is never met. Raises InputError with every
    fault of the model, CompileError if the cache cannot be written.
    """
    if not (path.is_file() or path.suffix in (".yaml", ".yml")):
        return path
    folder = cache_folder(os.environ) / "models" / _fingerprint(path)
    if folder.exists():
        return folder
    from mbsgen.pipeline import generate  # here alone, and late: kernels are called without SymPy

    with building_place(folder.parent) as place:
        generate(path, place / "generated")
        if folder.name != _fingerprint(path):  # it was changed meanwhile
            return find_folder(path)
        try:
            (place / "generated").rename(folder)
        except OSError:
            if not folder.exists():  # else another process was faster, and made the same
                raise
    return folder


def _fingerprint(model: Path) -> str:
    """Name what mbsgen makes of a model file."""
    try:
        text = model.read_bytes()
    except OSError:  # which mbsgen tells better
        text = b""
    return hashlib.sha256(_fingerprint_generator() + text).hexdigest()[:40]


@cache
def _fingerprint_generator() -> bytes:
    """Hash the files that generation depends on."""
    digest = hashlib.sha256()
    for folder in (Path(resources.__file__).parent, resources.folder("templates"), resources.folder("csrc")):
        for file in sorted(folder.rglob("*.*")):
            if file.is_file() and file.suffix != ".pyc":
                digest.update(hashlib.sha256(str(file.relative_to(folder)).encode()).digest())
                digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.digest()


def _open(library: Path, manifest: Manifest) -> tuple[cffi.FFI, Any]:
    ffi = cffi.FFI()
    symbols = [kernel.symbol for kernel in manifest.kernels]
    own = re.compile(rf"(jac_|adj1_|jac_adj1_)?{re.escape(manifest.prefix)}_\w+", re.ASCII)
    strange = [symbol for symbol in symbols if not own.fullmatch(symbol)]
    if strange:  # `gamma` would be found in libm
        raise ArgumentError(f"the manifest of {manifest.model} names {strange}, which cannot be its C functions")
    ffi.cdef(_BATCH + "".join(map(_FACE.format, symbols)))
    try:
        return ffi, ffi.dlopen(str(library))
    except OSError as error:
        raise CompileError(f"{library} cannot be loaded: {error}; remove it, it will be compiled again") from None


def _bind(ffi: cffi.FFI, lib: Any, kernel: Kernel) -> _Entry:
    """Find a kernel's arguments in the library; ArgumentError where manifest and library differ."""
    try:
        function, n_in, n_out = (getattr(lib, kernel.symbol + end) for end in ("", "_n_in", "_n_out"))
        inputs = _ports(ffi, lib, kernel, "in", kernel.inputs)
        outputs = _ports(ffi, lib, kernel, "out", kernel.outputs)
    except (AttributeError, LookupError):  # a function of libm would be found by its name, but not its account
        finding = "the manifest and the C files disagree"
        raise ArgumentError(f"{kernel.symbol}: {finding}; generate the folder again") from None
    return _Entry(kernel, function, n_in(), n_out(), inputs, outputs)


def _ports(ffi: cffi.FFI, lib: Any, kernel: Kernel, side: str, arguments: tuple[Argument, ...]) -> tuple[_Port, ...]:
    size, names, sparsity = (getattr(lib, f"{kernel.symbol}_{x}_{side}") for x in ("n", "name", "sparsity"))
    positions = {ffi.string(names(i)): i for i in range(size())}
    ports = []
    for argument in arguments:
        position = positions[argument.name.encode()]
        pattern = sparsity(position)
        if any(pattern[i] != x for i, x in enumerate(_compress(argument))):
            raise LookupError(argument.name)
        is_matrix = argument.name.startswith("jac_") or argument.name in _MATRICES[side]
        ports.append(_Port(argument, position, argument.cols == 1 and not is_matrix))
    return tuple(ports)


def _compress(argument: Argument) -> list[int]:
    """Write a pattern as the library does."""
    if argument.row is None or argument.colind is None:
        return [argument.rows, argument.cols, 1]
    return [argument.rows, argument.cols, *argument.colind, *argument.row]


def _read(value: ArrayLike) -> Array | None:
    """Make an array of real numbers; None where the value is none."""
    try:
        array = np.asarray(value)
    except ValueError:
        return None
    return array.astype(np.float64) if array.dtype.kind in "fiu" else None


def _gather(kernel: str, port: _Port, array: Array) -> Array:
    """Take the nonzeros of each state: shape (states, nnz)."""
    a = port.argument
    if not a.nnz:
        return np.zeros((1, 0))
    matrices = array.reshape((-1, a.rows, a.cols))
    if port.places is None:
        return np.ascontiguousarray(matrices.swapaxes(1, 2)).reshape((-1, a.nnz))
    nonzeros = np.ascontiguousarray(matrices[:, *port.places])
    if np.count_nonzero(matrices) > np.count_nonzero(nonzeros):
        raise ArgumentError(f"{kernel}: {a.name} has entries that are not in its nonzero pattern")
    return nonzeros


def _scatter(port: _Port, nonzeros: Array) -> Array:
    """Spread the nonzeros of each state: shape (states, *shape)."""
    a, states = port.argument, nonzeros.shape[0]
    if port.places is None:
        return nonzeros.reshape((states, a.cols, a.rows)).swapaxes(1, 2).reshape((states, *port.shape))
    matrices = np.zeros((states, a.rows, a.cols))
    matrices[:, *port.places] = nonzeros
    return matrices.reshape((states, *port.shape))


def _is_finite(value: object) -> bool:
    return isinstance(value, (int, float, np.floating, np.integer)) and math.isfinite(value)


def _text(shape: tuple[object, ...]) -> str:
    return f"({', '.join(map(str, shape))}{',' if len(shape) == 1 else ''})"
