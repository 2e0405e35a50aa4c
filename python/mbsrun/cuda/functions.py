"""Functions of a model on arrays of a GPU: inputs by name in, results and statuses out, one launch a batch."""

from __future__ import annotations

import copy
import ctypes
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from mbsgen.manifest import Kernel, Manifest
from mbsgen.roles import Role
from mbsrun.binding import ArgumentError, Port
from mbsrun.cuda.arrays import LEGACY, Array, View, read
from mbsrun.cuda.driver import Driver, find_driver
from mbsrun.cuda.images import DOUBLE_ALONE, PRECISIONS, Source, write_source
from mbsrun.cuda.nvrtc import CudaError
from mbsrun.external import Mechanism, OnDemand, load_on_demand

BLOCK = 128  # threads: each may have 255 registers then, the limit of a thread


class _Place(ctypes.Structure):
    """The mbs_array of mbs_cuda.h."""

    _fields_ = (
        ("first", ctypes.c_uint64),
        ("step", ctypes.c_longlong),
        ("down", ctypes.c_longlong),
        ("across", ctypes.c_longlong),
    )


@dataclass(frozen=True)
class _Call:
    """A kernel, its inputs that have entries, and its results."""

    kernel: Kernel
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    source: Source


@dataclass(frozen=True)
class _Task:
    """A use of a kernel: how many states, in which numbers."""

    states: int
    is_batch: bool  # results have an axis for the states
    dtype: str
    stream: int
    sparse: bool


class Functions:
    """The functions of a model on a GPU: `batch` computes many states, a state a thread."""

    def __init__(
        self, model: str | Path | Mechanism | OnDemand, parameters: Mapping[str, float] | None = None, device: int = 0
    ) -> None:
        """Load a model file or a generated folder, or take what `mbsrun.load` has loaded; `device` numbers the GPU."""
        loaded = load_on_demand(Path(model)) if isinstance(model, (str, Path)) else model
        self.kernels = loaded.with_parameters(**parameters) if parameters else loaded
        self.device = device
        self._calls: dict[str, _Call] = {}
        self._functions: dict[tuple[str, str, bool], Any] = {}  # loaded, by kernel, type of numbers, and sparse
        self._filled: dict[tuple[str, str, str], Array] = {}  # inputs from parameters, by kernel and name, and type

    @property
    def manifest(self) -> Manifest:
        """The description of the model and its functions."""
        return self.kernels.manifest

    @property
    def parameters(self) -> Mapping[str, float]:
        """The values of run-time and differentiated parameters that calls take where they give none."""
        return self.kernels.parameters

    def with_parameters(self, **parameters: float) -> Self:
        """Return the same functions with other values of the named parameters."""
        other = copy.copy(self)
        other.kernels = self.kernels.with_parameters(**parameters)
        other._filled = {}
        return other

    def __repr__(self) -> str:
        """Return the model, its coordinates and inputs, and the functions."""
        return repr(self.kernels).replace(f"{type(self.kernels).__name__}(", "mbsrun.cuda.Functions(", 1)

    def batch(
        self,
        name: str,
        /,
        *,
        sparse: bool = False,
        out: Mapping[str, Any] | None = None,
        stream: object = None,
        **inputs: Any,
    ) -> tuple[dict[str, Array], Array]:
        """Call a kernel in many states; return its results by name, and the status of each state.

        Inputs are arrays on the GPU, all of float64 or all of float32, with any strides: anything with
        `__cuda_array_interface__` or `__dlpack__`. Shapes, `sparse`, defaults of parameters and statuses are as of
        `mbsrun.Mechanism.batch`; entries outside of a matrix's pattern are not read. Results are written to `out`,
        arrays of their shapes, or to new ones, whose states are neighbours in memory. The call returns when the work is
        in the stream: a handle, or a stream of CuPy or PyTorch; by default, the default stream. Raises ArgumentError
        for inputs that do not fit, CudaError without a GPU.
        """
        call = self._find(name)
        driver, handle = find_driver(), _read_stream(stream)
        if not 0 <= self.device < driver.count():
            raise CudaError(f"there is no GPU {self.device}: there are {driver.count()}, counted from 0")
        views = _collect(call, inputs, handle)
        self._check_devices(driver, name, views)
        states = _count_states(call, views)
        number = 1 if states is None else states
        task = _Task(number, states is not None, _find_dtype(call, views), handle, sparse)
        with driver.using(self.device):
            for view in views.values():
                if view.stream not in (None, handle or LEGACY):
                    driver.order(view.stream or 0, handle)
            given = [self._place(driver, call, port, views, task) for port in call.inputs]
            results, found = self._make_results(driver, call, task, out)
            status = self._make(driver, task, (), "int32")
            if task.states:
                function = self._load(driver, call, task)
                arguments = [ctypes.c_longlong(task.states), *given, *found, ctypes.c_uint64(status.pointer)]
                driver.launch(function, -(-task.states // BLOCK), BLOCK, handle, arguments)
        return results, status

    def _find(self, name: str) -> _Call:
        if name not in self._calls:
            kernels = self.kernels.find_holder(name)
            kernel = kernels.describe(name)
            inputs = tuple(Port(a, k) for k, a in enumerate(kernel.inputs) if a.nnz)
            outputs = tuple(Port(a, k) for k, a in enumerate(kernel.outputs))
            self._calls[name] = _Call(kernel, inputs, outputs, write_source(kernels, kernel))
        return self._calls[name]

    def _load(self, driver: Driver, call: _Call, task: _Task) -> Any:
        key = (call.kernel.name, task.dtype, task.sparse)
        if key not in self._functions:
            architecture = driver.describe(self.device)[1]
            code = call.source.find(architecture, task.dtype, sparse=task.sparse)
            self._functions[key] = driver.load(code, call.source.function)
        return self._functions[key]

    def _place(self, driver: Driver, call: _Call, port: Port, views: Mapping[str, View], task: _Task) -> _Place:
        """Return the place of an input; one that is left out comes from parameters, or is 0."""
        name = port.argument.name
        if name in views:
            view = views[name]
            return _point(view.pointer, view.strides, is_batch=len(view.shape) > len(port.shape))
        key = (call.kernel.name, name, task.dtype)
        if key not in self._filled:
            holder = self.kernels.find_holder(call.kernel.name)  # with the present parameters
            values = holder.filled.get(name, np.zeros(port.argument.nnz)).astype(task.dtype)
            array = Array(driver, self.device, values.shape, (1,), task.dtype, 0)
            driver.copy_to(array.pointer, values.tobytes())
            self._filled[key] = array
        return _Place(self._filled[key].pointer, 0, 1, 0)

    def _make(self, driver: Driver, task: _Task, shape: tuple[int, ...], dtype: str) -> Array:
        """Make an array for a result; neighbours in memory are the states, then the entries of a row."""
        strides = tuple(task.states * math.prod(shape[i + 1 :]) for i in range(len(shape)))
        if task.is_batch:
            shape, strides = (task.states, *shape), (1, *strides)
        return Array(driver, self.device, shape, strides, dtype, task.stream)

    def _make_results(
        self, driver: Driver, call: _Call, task: _Task, out: Mapping[str, Any] | None
    ) -> tuple[dict[str, Any], list[_Place]]:
        """Make arrays for results, or take the given ones; return them, and the places of all that have entries."""
        shapes = {p.argument.name: (p.argument.nnz,) if task.sparse else p.shape for p in call.outputs}
        if out is None:
            made = {name: self._make(driver, task, shape, task.dtype) for name, shape in shapes.items()}
            places = {name: (array.pointer, array.strides) for name, array in made.items()}
        else:
            batch = (task.states,) if task.is_batch else ()
            taken = _take(call.kernel.name, {name: (*batch, *shape) for name, shape in shapes.items()}, task, out)
            self._check_devices(driver, call.kernel.name, {f"out {name}": view for name, view in taken.items()})
            places = {name: (view.pointer, view.strides) for name, view in taken.items()}
        entries = [p.argument.name for p in call.outputs if p.argument.rows * p.argument.cols]
        return dict(out or made), [_point(*places[name], is_batch=task.is_batch) for name in entries]

    def _check_devices(self, driver: Driver, name: str, views: Mapping[str, View]) -> None:
        """Raise ArgumentError for arrays that do not lie on the device."""
        faults = []
        for key, view in views.items():
            if not view.pointer:
                continue  # it has no entries
            device = driver.find_device(view.pointer)
            if device is None:
                faults.append(f"{key}: it lies in the memory of the host; copy it to the GPU")
            elif device != self.device:
                faults.append(
                    f"{key}: it lies on GPU {device}, the functions are loaded for GPU {self.device}; copy it, or load "
                    f"the functions with device={device}"
                )
        _raise(name, faults)


def _collect(call: _Call, inputs: Mapping[str, Any], stream: int) -> dict[str, View]:
    """Read the given inputs; all faults are reported together."""
    wanted = {port.argument.name: port for port in call.inputs}
    faults = [f"{name}: there is no such input" for name in inputs if name not in wanted]
    views = {}
    for name, port in wanted.items():
        if name not in inputs:
            is_optional = port.argument.role in (Role.REMAINDER, Role.SETUP, Role.DESIGN)
            faults += [] if is_optional else [f"{name}: missing, shape {_text(port.shape)}"]
            continue
        view = read(inputs[name], stream)
        if isinstance(view, str):
            faults.append(f"{name}: {view}")
        elif view.shape[-len(port.shape) :] != port.shape or len(view.shape) > len(port.shape) + 1:
            batch = _text(("batch", *port.shape))
            faults.append(f"{name}: shape {_text(view.shape)} given, {_text(port.shape)} or {batch} expected")
        else:
            views[name] = view
    _raise(call.kernel.name, faults)
    return views


def _find_dtype(call: _Call, views: Mapping[str, View]) -> str:
    """Return the type of all numbers."""
    kinds = {view.dtype for view in views.values()}
    if kinds - PRECISIONS.keys() or len(kinds) > 1:
        given = ", ".join(f"{name} {view.dtype}" for name, view in views.items())
        raise ArgumentError(f"{call.kernel.name}: {given}; give all inputs in float64, or all in float32")
    if kinds == {"float32"} and DOUBLE_ALONE in call.source.files:
        raise ArgumentError(f"{call.kernel.name} computes in double-double: give all inputs in float64")
    return kinds.pop() if kinds else "float64"


def _count_states(call: _Call, views: Mapping[str, View]) -> int | None:
    """Return the number of states; None where no input has an axis for it."""
    ports = {port.argument.name: port for port in call.inputs}
    batches = {view.shape[0] for name, view in views.items() if len(view.shape) > len(ports[name].shape)}
    if len(batches) > 1:
        found = sorted(batches)
        raise ArgumentError(f"{call.kernel.name}: the inputs have batches of {found} states; give all the same number")
    return batches.pop() if batches else None


def _take(name: str, shapes: Mapping[str, tuple[int, ...]], task: _Task, out: Mapping[str, Any]) -> dict[str, View]:
    """Read the arrays that results go to. Raises ArgumentError where they do not fit."""
    if out.keys() != shapes.keys():
        wanted = ", ".join(f"{key} {_text(shape)}" for key, shape in shapes.items())
        raise ArgumentError(f"{name}: out must hold {wanted}; it holds {', '.join(out) or 'nothing'}")
    views, faults = {}, []
    for key, array in out.items():
        view = read(array, task.stream)
        if isinstance(view, str):
            faults.append(f"out {key}: {view}")
        elif view.shape != shapes[key] or view.dtype != task.dtype or not view.is_writable:
            given = f"{_text(view.shape)} of {view.dtype}{'' if view.is_writable else ', which is read-only'}"
            faults.append(f"out {key}: {given} given; {_text(shapes[key])} of {task.dtype}, to be written, expected")
        elif 0 not in view.shape and any(not x and n > 1 for x, n in zip(view.strides, view.shape, strict=True)):
            faults.append(f"out {key}: some of its entries lie at one place; give an array without a stride of 0")
        else:
            views[key] = view
    _raise(name, faults)
    return views


def _point(pointer: int, strides: tuple[int, ...], *, is_batch: bool) -> _Place:
    step, own = (strides[0], strides[1:]) if is_batch else (0, strides)
    return _Place(pointer, step, own[0], own[1] if len(own) > 1 else 0)


def _raise(name: str, faults: Iterable[str]) -> None:
    if text := "\n".join(f"{name}: {fault}" for fault in faults):
        raise ArgumentError(text)


def _read_stream(stream: object) -> int:
    """Return the handle of a stream of any library. Raises ArgumentError for anything else."""
    if stream is None:
        return 0
    if hasattr(stream, "__cuda_stream__"):
        return int(stream.__cuda_stream__()[1])
    handle = next((getattr(stream, name) for name in ("ptr", "cuda_stream") if hasattr(stream, name)), stream)
    if not isinstance(handle, int) or isinstance(handle, bool):
        raise ArgumentError(f"stream: a {type(stream).__name__} is no stream; give a handle, or one of CuPy or PyTorch")
    return handle


def _text(shape: tuple[object, ...]) -> str:
    return f"({', '.join(map(str, shape))}{',' if len(shape) == 1 else ''})"
