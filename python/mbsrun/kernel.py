"""The NumPy face of generated kernels: arrays by name in, arrays by name out, one state or a batch of them."""

from __future__ import annotations

import copy
import math
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from inspect import Parameter, Signature
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbsgen import manifest as manifests
from mbsgen.errors import MbsError
from mbsgen.manifest import FIRST_LENGTH, Argument, Kernel, Manifest
from mbsgen.roles import FAMILY, ON_REQUEST, Order, Role, name_kernel, split_kernel
from mbsrun import many
from mbsrun.binding import MASKED, ROUNDED, ArgumentError, Array, Entry, Port, Status, bind, is_exact
from mbsrun.library import Compiler, compile_library, find_compiler
from mbsrun.many import Loop, Several

if TYPE_CHECKING:
    from scipy.sparse import csc_array

__all__ = ["ArgumentError", "Array", "KernelError", "Kernels", "Place", "find_place"]


class KernelError(MbsError):
    """A kernel that returned a nonzero status: it failed at a joint, a loop, or a force without a direction."""

    def __init__(self, kernel: str, place: Place, state: int) -> None:
        self.kernel, self.joint, self.loop, self.state = kernel, place.joint, place.loop, state
        super().__init__(f"{kernel} failed at {place}, in state {state} (from 0) of the given states")


@dataclass(frozen=True)
class Place:
    """The joint, the loop, the force element or the contact that a status names; none where it names none."""

    joint: str | None
    loop: str | None
    status: int
    length: str | None = None  # a force element whose points meet
    spheres: str | None = None  # a contact of two spheres whose centres coincide
    wrench: str | None = None  # between frames turned by a quarter about the middle axis

    def __str__(self) -> str:
        if self.length is not None:
            return f"force element {self.length}, whose points meet: it has no direction there"
        if self.spheres is not None:
            return f"contact {self.spheres}, whose centres coincide: it has no direction there"
        if self.wrench is not None:
            return f"wrench {self.wrench}, whose middle turn is a quarter: the other two have no values there"
        named = (("joint", self.joint), ("loop", self.loop))
        return next((f"{kind} {name}" for kind, name in named if name is not None), f"number {self.status}")


def find_place(manifest: Manifest, status: int) -> Place:
    """Find the entry that a kernel's status names.

    It is joint number k for k, loop number k for n + k, of n joints, from 1; and force element or contact k for
    FIRST_LENGTH + k.
    """
    if status >= FIRST_LENGTH:
        name = next(iter(manifest.lengths[status - FIRST_LENGTH :]), None)
        if name in manifest.contacts:
            return Place(None, None, status, spheres=name)
        if name is not None and {name, name.rpartition(".")[0]}.isdisjoint(manifest.elements):
            return Place(None, None, status, wrench=name)
        return Place(None, None, status, length=name)
    joints, loops = ([x.name for x in entries] for entries in (manifest.coordinates, manifest.loops))
    n = len(joints)
    joint = joints[status - 1] if 0 < status <= n else None
    return Place(joint, loops[status - n - 1] if n < status <= n + len(loops) else None, status)


class Kernels:
    """The kernels of a generated folder; each is compiled and loaded when it is first called.

    `k("impl", q=…, qd=…, qdd=…, u=…)` and `k.impl(q=…, …)` call a kernel; see `__call__`. Kernels can be called from
    several threads at once.
    """

    manifest: Manifest
    parameters: Mapping[str, float]  # the run-time and differentiated parameters in use, by the user's names

    def __init__(self, folder: str | Path, parameters: Mapping[str, float] | None = None) -> None:
        """Read the folder's manifest. `parameters` replace the model's values."""
        self._binder = _Binder(Path(folder))
        self.manifest = self._binder.manifest
        given = (*self.manifest.parameters, *self.manifest.design)
        self._set_parameters({p.name: p.value for p in given}, parameters or {})

    @property
    def folder(self) -> Path:
        """The folder of the C files."""
        return self._binder.folder

    def with_parameters(self, **parameters: float) -> Self:
        """Return the same kernels with other values of the named parameters."""
        other = copy.copy(self)
        other._set_parameters(self.parameters, parameters)
        return other

    def compile(self, *names: str) -> Path:
        """Compile the named kernels, several at once, and return a shared library that holds them.

        This is optional: it gathers compilations that first calls would do one by one.
        """
        return self._binder.compile([self._binder.describe(name) for name in names])

    def list_missing(self, names: Iterable[str]) -> list[str]:
        """List the kernels among some that cannot be called, by name."""
        return sorted({*names} - self._binder.kernels.keys())

    def find_holder(self, name: str) -> Kernels:
        """Return the kernels of one folder, with a kernel among them: these."""
        self.describe(name)
        return self

    def bind(self, name: str) -> Entry:
        """Return a kernel that is bound to its C function."""
        return self._binder.bind(name)

    def choose_loop(self, name: str, states: int) -> tuple[Loop, Several | None]:
        """Return the loop over a number of states, and the kernel for several at once where that is worth it."""
        return self._binder.choose_loop(self._binder.bind(name), states)

    def load_several(self, name: str, width: int) -> Several | None:
        """Return a kernel for `width` states at once; None where the compiler knows no such vectors."""
        return self._binder.load_several(self.describe(name), width)

    def describe(self, name: str) -> Kernel:
        """Return the manifest's description of a kernel. Raises ArgumentError with the names of the kernels."""
        return self._binder.describe(name)

    def __call__(self, name: str, /, *, sparse: bool = False, **inputs: ArrayLike) -> dict[str, Array]:
        """Call a kernel; return its results by name.

        A column is an array of shape (rows,), a matrix one of (rows, cols); Jacobians, positions and rotations are
        matrices even with one column. Any input may have a leading batch axis; results then have it too, and inputs
        without one are the same for all states. sparse: give the nonzeros only, column by column, shape (nnz,), of
        which `matrix` makes a matrix. Inputs without an entry may be left out; so may second parts of numbers, which
        are 0 then, and `theta`, the differentiated parameters, and `h`, the result of `setup`, where the present values
        of parameters are meant; a batch of `h` gives each state its parameters. Raises ArgumentError for inputs that do
        not fit, KernelError where a state cannot be computed. See `batch` for the time of many states.
        """
        entry = self._binder.bind(name)
        if entry.design:
            inputs.setdefault(entry.design, self._design)
        own = entry.hidden is not None and entry.hidden in inputs
        done = None if sparse or own else entry.call_once(inputs, self._hidden_for(entry))
        if done is None:
            results, status = self.attempt(name, sparse=sparse, **inputs)
            failed = np.flatnonzero(status)
            if failed.size:
                raise self._tell(name, int(status.flat[failed[0]]), int(failed[0]))
            return results
        if done[0]:
            raise self._tell(name, done[0], 0)
        return done[1]

    def attempt(self, name: str, /, *, sparse: bool = False, **inputs: ArrayLike) -> tuple[dict[str, Array], Status]:
        """Call a kernel as `__call__` does, but return the status of each state beside the results.

        The status, shape () or (batch,), is 0, or a number that `find_place` reads where the kernel failed; the results
        of such a state are not a number. Raises ArgumentError.
        """
        if taken := [word for word in ("threads", "lanes", "out") if word in inputs]:
            raise ArgumentError(
                "\n".join(f"{name}: {word}: there is no such input; `batch` takes it" for word in taken)
            )
        return self.batch(name, sparse=sparse, threads=1, lanes=None, out=None, **inputs)

    def batch(
        self,
        name: str,
        /,
        *,
        sparse: bool = False,
        threads: int = 1,
        lanes: bool | None = None,
        out: Mapping[str, Array] | None = None,
        **inputs: ArrayLike,
    ) -> tuple[dict[str, Array], Status]:
        """Call a kernel as `attempt` does, in several threads, and into arrays that are there.

        Many states are computed several at once, in lanes of the processor's vectors; the kernel is compiled for that
        at its first batch of 2000 states, or more where it is long. `lanes` decides otherwise. Digits are a single
        state's, except for the last ones where a kernel divides by pivots; they depend neither on other states nor on
        `threads`, the number of parts that are computed side by side. `out`, the results of an earlier call, is
        written over: new memory often takes longer than a kernel. Inputs are read where they lie, whatever their
        strides.
        """
        if not is_count(threads):
            raise ArgumentError(f"{name}: {threads} threads; give a whole number, 1 or more")
        if not (lanes is None or isinstance(lanes, bool | np.bool_)):
            raise ArgumentError(f"{name}: lanes: {lanes!r}; give True or False, or leave it out")
        entry = self._binder.bind(name)
        if entry.design:
            inputs.setdefault(entry.design, self._design)
        if entry.hidden:
            inputs.setdefault(entry.hidden, self._hidden)
        arrays = _collect(entry, inputs)
        batches = {array.shape[0] for port, array in arrays if array.ndim > len(port.shape)}
        if len(batches) > 1:
            raise ArgumentError(
                f"{name}: the inputs have batches of {sorted(batches)} states; give all the same number"
            )
        _check_patterns(name, arrays)
        states = batches.pop() if batches else 1
        loop, several = self._binder.choose_loop(entry, states, lanes)
        shapes = {p.argument.name: (states, *((p.argument.nnz,) if sparse else p.shape)) for p in entry.outputs}
        is_batch = any(array.ndim > len(port.shape) for port, array in arrays)
        results = _make_results(name, shapes, out if is_batch else None, arrays)
        status = many.compute(loop, entry, several, arrays, results, states, sparse=sparse, threads=threads)
        if is_batch:
            return results, status
        return {key: value[0] for key, value in results.items()}, status.reshape(())

    def jac(self, name: str, /, *, sparse: bool = False, **inputs: ArrayLike) -> dict[str, Array]:
        """Call `jac_<name>`: the Jacobians `jac_<result>_<input>`; rows are entries of the result."""
        return self(name_kernel(name, Order.JACOBIAN), sparse=sparse, **inputs)

    def lin(self, name: str, /, *, sparse: bool = False, **inputs: ArrayLike) -> dict[str, Array]:
        """Call `lin_<name>`: the results of `<name>` and `jac_<name>`, for less than both."""
        return self(name_kernel(name, Order.LINEARISATION), sparse=sparse, **inputs)

    def adj(self, name: str, /, *, sparse: bool = False, **inputs: ArrayLike) -> dict[str, Array]:
        """Call `adj1_<name>`: the gradients `adj_<input>` of the sum of results weighted by inputs `adj_<result>`."""
        return self(name_kernel(name, Order.ADJOINT), sparse=sparse, **inputs)

    def hess(self, name: str, /, *, sparse: bool = False, **inputs: ArrayLike) -> dict[str, Array]:
        """Call `jac_adj1_<name>`: second derivatives of the sum of results weighted by inputs `adj_<result>`.

        `jac_adj_<a>_<b>` is the block of its Hessian by the inputs a, down the rows, and b.
        """
        return self(name_kernel(name, Order.ADJOINT_JACOBIAN), sparse=sparse, **inputs)

    def matrix(self, name: str, result: str, nonzeros: Array) -> csc_array:
        """Make a sparse matrix of a result of the kernel `name` with `sparse=True`, for one state."""
        kernel = self._binder.describe(name)
        a = next((a for a in kernel.outputs if a.name == result), None)
        if a is None:
            raise ArgumentError(
                f"{name} has no result {result!r}; there are {', '.join(o.name for o in kernel.outputs)}"
            )
        if np.shape(nonzeros) != (a.nnz,):
            raise ArgumentError(
                f"{name}: {result} has {a.nnz} nonzeros; an array of shape {np.shape(nonzeros)} is given"
            )
        row = np.tile(np.arange(a.rows), a.cols) if a.row is None else np.array(a.row, dtype=int)
        colind = np.arange(a.cols + 1) * a.rows if a.colind is None else np.array(a.colind, dtype=int)
        from scipy.sparse import csc_array  # takes long to load, and few need it

        return csc_array((nonzeros, row, colind), shape=(a.rows, a.cols))

    def __getattr__(self, name: str) -> Callable[..., dict[str, Array]]:
        """Return a kernel as a function."""
        if name.startswith("_") or name not in self._binder.kernels:
            raise AttributeError(f"{type(self).__name__} has no attribute or kernel {name!r}")
        return document(self, self.describe(name))

    def __repr__(self) -> str:
        """Return the model, its coordinates and inputs, and the functions."""
        manifest = self.manifest
        functions = ", ".join(kernel.name for kernel in manifest.kernels if kernel.order is Order.VALUE)
        parts = {"coordinates": manifest.positions, "inputs": manifest.inputs, "parameters": tuple(self.parameters)}
        told = "; ".join(f"{kind} {_shorten(names)}" for kind, names in parts.items() if names)
        return f"{type(self).__name__}({manifest.model}: {told}; functions {functions})"

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._binder.kernels]

    def _set_parameters(self, present: Mapping[str, float], changes: Mapping[str, float]) -> None:
        unknown = [name for name in changes if name not in present]
        if unknown:
            known = f"there are {', '.join(present)}" if present else "the model has none"
            raise ArgumentError(f"no run-time parameter {', '.join(unknown)}; {known}")
        wrong = [f"{name} = {value!r}" for name, value in changes.items() if not _is_finite(value)]
        if wrong:
            raise ArgumentError(f"{', '.join(wrong)}: a parameter must be a finite number")
        self.parameters = {name: float(changes.get(name, value)) for name, value in present.items()}
        for cached in ("_hidden", "_design"):
            self.__dict__.pop(cached, None)

    @cached_property
    def _hidden(self) -> Array:
        """The results of the setup for the present parameters, computed at the first call."""
        setup = self.manifest.setup
        if setup is None:
            return np.zeros(0)
        values = np.array([self.parameters[p.name] for p in self.manifest.parameters])
        given: dict[str, Any] = {setup.inputs[0].name: values}
        return self(setup.name, **given)[setup.outputs[0].name]

    @cached_property
    def _design(self) -> Array:
        """The differentiated parameters."""
        return np.array([self.parameters[p.name] for p in self.manifest.design])

    @property
    def filled(self) -> dict[str, Array]:
        """The inputs that come from parameters, by name: the differentiated ones, and the result of the setup."""
        arguments = [a for kernel in self.manifest.kernels for a in kernel.inputs]
        hidden = {a.name: self._hidden for a in arguments if a.role is Role.SETUP}
        return hidden | {a.name: self._design for a in arguments if a.role is Role.DESIGN}

    def _hidden_for(self, entry: Entry) -> Array | None:
        return self._hidden if entry.takes_hidden else None

    def _tell(self, name: str, status: int, state: int) -> KernelError:
        return KernelError(name, find_place(self.manifest, status), state)


class _Binder:
    """A generated folder; each kernel is compiled and bound at its first use."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.manifest = manifests.read(folder / manifests.FILE_NAME)
        self.kernels = {**{kernel.name: kernel for kernel in self.manifest.kernels}, **self.manifest.quickest}
        self._entries: dict[str, Entry] = {}
        self._loops: dict[int, Loop] = {}  # by how many states they compute at once
        self._several: dict[str, Several | None] = {}
        self._bytes: dict[str, int] = {}  # of kernels' sources
        orders = "|".join(order.prefix for order in FAMILY)
        own = re.compile(rf"({orders}){re.escape(self.manifest.prefix)}_\w+", re.ASCII)
        strange = [kernel.symbol for kernel in self.manifest.kernels if not own.fullmatch(kernel.symbol)]
        if strange:  # `gamma` would be found in libm
            raise ArgumentError(
                f"the manifest of {self.manifest.model} names {strange}, which cannot be its C functions"
            )

    def describe(self, name: str) -> Kernel:
        """Return the description of a kernel. Raises ArgumentError with the names of the kernels."""
        kernel = self.kernels.get(name)
        if kernel is None:
            base = split_kernel(name)[0]
            more = f"; `mbsgen MODEL --functions {base}` writes it" if base in ON_REQUEST else ""
            known = ", ".join(self.kernels)
            raise ArgumentError(f"{self.manifest.model} has no kernel {name!r}; there are {known}{more}")
        return kernel

    def bind(self, name: str) -> Entry:
        """Return a kernel that can be called."""
        entry = self._entries.get(name)
        if entry is None:
            kernel = self.describe(name)
            entry = self._entries[name] = bind(self.compile([kernel]), kernel)
        return entry

    def compile(self, kernels: Sequence[Kernel]) -> Path:
        """Compile kernels to one library."""
        sources = [source for kernel in kernels for source in kernel.sources]
        return compile_library(self.folder, self.manifest.prefix, sources, self._compiler)

    def choose_loop(self, entry: Entry, states: int, lanes: bool | None = None) -> tuple[Loop, Several | None]:
        """Return the loop over states: with lanes, and the kernel for these, where the number of states is worth it."""
        is_worth = states >= many.FEWEST and states >= self._count_bytes(entry.kernel) / many.BYTES_PER_STATE
        if is_worth if lanes is None else lanes:
            width = self._width
            several = self._bind_several(entry.kernel, width)
            if several is not None:
                return self._load_loop(width), several
        return self._load_loop(1), None

    def _count_bytes(self, kernel: Kernel) -> int:
        if kernel.name not in self._bytes:
            self._bytes[kernel.name] = sum((self.folder / source).stat().st_size for source in kernel.sources)
        return self._bytes[kernel.name]

    def _load_loop(self, width: int) -> Loop:
        if width not in self._loops:
            self._loops[width] = many.load_loop(self._compiler, width)
        return self._loops[width]

    def _bind_several(self, kernel: Kernel, width: int) -> Several | None:
        """Return a kernel for several states at once; None where there is none."""
        if kernel.name not in self._several:
            self._several[kernel.name] = self.load_several(kernel, width)
        return self._several[kernel.name]

    def load_several(self, kernel: Kernel, width: int) -> Several | None:
        """Compile and load a kernel for several states at once; None where there are no vectors of that width."""
        if not 1 < width <= self._width:
            return None
        compiler = many.for_states(self._compiler, width)
        library = compile_library(self.folder, self.manifest.prefix, kernel.sources, compiler)
        return many.load_several(library, kernel, width)

    @cached_property
    def _width(self) -> int:
        return many.find_width(self._compiler)

    @cached_property
    def _compiler(self) -> Compiler:
        return find_compiler(os.environ)


def is_count(value: object, least: int = 1) -> bool:
    """Return whether a value is a whole number of at least `least`."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and bool(value >= least)


def _collect(entry: Entry, inputs: Mapping[str, ArrayLike]) -> list[tuple[Port, Array]]:
    """Pair ports with arrays; all faults are reported together."""
    wanted = entry.wanted
    faults = [f"{name}: there is no such input" for name in inputs if name not in wanted]
    arrays = []
    for name, port in wanted.items():
        if name not in inputs:
            is_optional = not port.argument.nnz or port.argument.role is Role.REMAINDER
            faults += [] if is_optional else [f"{name}: missing, shape {_text(port.shape)}"]
            continue
        array = _read(inputs[name])
        if np.ma.is_masked(inputs[name]):
            faults.append(f"{name}: {MASKED}")
        elif array is None:
            faults.append(f"{name}: not an array of real numbers, shape {_text(port.shape)} expected")
        elif not is_exact(array):
            faults.append(f"{name}: {ROUNDED.format(array.dtype)}")
        elif array.shape[-len(port.shape) :] != port.shape or array.ndim > len(port.shape) + 1:
            batch = _text(("batch", *port.shape))
            faults.append(f"{name}: shape {_text(array.shape)} given, {_text(port.shape)} or {batch} expected")
        else:
            arrays.append((port, array.astype(np.float64, copy=False)))
    if faults:
        raise ArgumentError("\n".join(f"{entry.kernel.name}: {fault}" for fault in faults))
    return arrays


def _read(value: ArrayLike) -> NDArray[Any] | None:
    """Return an array of real numbers of any type; None if the value is none."""
    try:
        array = np.asarray(value)
    except (ValueError, RuntimeError):  # ragged rows; a tensor of PyTorch that requires a gradient
        return None
    return array if array.dtype.kind in "fiu" else None


def _make_results(
    kernel: str,
    shapes: Mapping[str, tuple[int, ...]],
    out: Mapping[str, Array] | None,
    inputs: Sequence[tuple[Port, Array]],
) -> dict[str, Array]:
    """Make arrays for results, or take the given ones. Raises ArgumentError where these do not fit."""
    if out is None:
        return {name: np.empty(shape) for name, shape in shapes.items()}
    wanted = {name: (shape, np.dtype(np.float64), True, True) for name, shape in shapes.items()}
    if not isinstance(out, Mapping) or {name: _describe_array(a) for name, a in out.items()} != wanted:
        arrays = ", ".join(f"{name} {_text(shape)}" for name, shape in shapes.items())
        raise ArgumentError(f"{kernel}: out must hold {arrays}: C-contiguous arrays of float64; give an earlier result")
    named = [*out.items(), *((port.argument.name, array) for port, array in inputs)]
    shared = [f"{a} and {b}" for (a, x), (b, y) in combinations(named, 2) if a in out and np.may_share_memory(x, y)]
    if shared:
        raise ArgumentError(f"{kernel}: out: {', '.join(shared)} share memory; give arrays apart from all others")
    return dict(out)


def _describe_array(array: object) -> tuple[object, ...]:
    """Return what an array for results must have: shape, type, order, and whether it may be written to."""
    if not isinstance(array, np.ndarray):
        return ()
    return array.shape, array.dtype, array.flags.c_contiguous, array.flags.writeable


def _check_patterns(kernel: str, arrays: Sequence[tuple[Port, Array]]) -> None:
    """Raise ArgumentError for a matrix with an entry that the kernel would not read."""
    for port, array in arrays:
        if port.places is not None and np.count_nonzero(array) > np.count_nonzero(array[..., *port.places]):
            raise ArgumentError(f"{kernel}: {port.argument.name} has entries that are not in its nonzero pattern")


def document(kernels: Kernels, kernel: Kernel) -> Callable[..., dict[str, Array]]:
    """Return a kernel as a function that describes itself: its inputs and results, with shapes and units."""

    def function(*, sparse: bool = False, **inputs: ArrayLike) -> dict[str, Array]:
        return kernels(kernel.name, sparse=sparse, **inputs)

    hidden = (Role.SETUP, Role.DESIGN)
    taken = [a for a in kernel.inputs if a.nnz and a.role not in hidden]
    parameters = [Parameter(a.name, Parameter.KEYWORD_ONLY) for a in taken]
    sparse = Parameter("sparse", Parameter.KEYWORD_ONLY, default=False)
    more = " Parameters have their present values." if len(taken) < len(kernel.inputs) else ""
    order = "" if kernel.order is Order.VALUE else f" ({kernel.order.value.replace('_', ' ')} of {kernel.base})"
    lines = [
        f"Compute {kernel.name}{order} of {kernels.manifest.model}, in one state or, with a leading axis, in a batch.",
        "",
        *_describe_arguments("Inputs:", taken),
        *_describe_arguments("Returns a dictionary of", kernel.outputs),
        "",
        f"sparse: give the nonzeros only.{more} See `Kernels.__call__` for errors.",
    ]
    function.__name__ = function.__qualname__ = kernel.name
    function.__doc__ = "\n".join(lines)
    function.__signature__ = Signature([*parameters, sparse])  # type: ignore[attr-defined]
    return function


def _describe_arguments(title: str, arguments: Sequence[Argument]) -> list[str]:
    """Return a line for each argument: its shape, and its unit where it has one."""
    shapes = [_text((a.rows,) if a.cols == 1 and not a.matrix else (a.rows, a.cols)) for a in arguments]
    width = max((len(a.name) for a in arguments), default=0) + 2
    lines = [f"    {a.name:<{width}}{shape:<10}{a.unit}" for a, shape in zip(arguments, shapes, strict=True)]
    return [title, *(line.rstrip() for line in lines)]


def _shorten(names: Sequence[str], most: int = 8) -> str:
    """List names, and count the ones that are too many."""
    return ", ".join(names[:most]) + (f", and {len(names) - most} more" if len(names) > most else "")


def _is_finite(value: object) -> bool:
    return isinstance(value, (int, float, np.floating, np.integer)) and math.isfinite(value)


def _text(shape: tuple[object, ...]) -> str:
    return f"({', '.join(map(str, shape))}{',' if len(shape) == 1 else ''})"
