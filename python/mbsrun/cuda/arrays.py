"""Arrays on a GPU: what other libraries hold, read by `__cuda_array_interface__` or DLPack; and own ones, given so."""

from __future__ import annotations

import ctypes
import math
import weakref
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbsrun.cuda.driver import Driver

LEGACY = 1  # the handle of the default stream in exchanges
_CUDA, _CUDA_MANAGED = 2, 13  # kinds of devices of DLPack; all others are not a GPU's own memory
_CODES = {0: "i", 1: "u", 2: "f"}  # of types of numbers
_CAPSULE = b"dltensor"


@dataclass(frozen=True)
class View:
    """Numbers that lie on a GPU."""

    pointer: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]  # in numbers
    dtype: str  # float64, ...
    stream: int | None  # that writes them; None: they are there
    is_writable: bool
    holder: object  # which keeps them


class _Tensor(ctypes.Structure):
    _fields_ = (
        ("data", ctypes.c_void_p),
        ("kind", ctypes.c_int32),
        ("device", ctypes.c_int32),
        ("ndim", ctypes.c_int32),
        ("code", ctypes.c_uint8),
        ("bits", ctypes.c_uint8),
        ("lanes", ctypes.c_uint16),
        ("shape", ctypes.POINTER(ctypes.c_int64)),
        ("strides", ctypes.POINTER(ctypes.c_int64)),
        ("offset", ctypes.c_uint64),
    )


class _Managed(ctypes.Structure):
    pass


_Deleter = ctypes.CFUNCTYPE(None, ctypes.POINTER(_Managed))
_Managed._fields_ = (("tensor", _Tensor), ("context", ctypes.c_void_p), ("deleter", _Deleter))
_Destructor = ctypes.PYFUNCTYPE(None, ctypes.c_void_p)
_get_pointer = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.py_object, ctypes.c_char_p)(
    ("PyCapsule_GetPointer", ctypes.pythonapi)
)
_find_address = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)(
    ("PyCapsule_GetPointer", ctypes.pythonapi)
)
_is_valid = ctypes.PYFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_char_p)(("PyCapsule_IsValid", ctypes.pythonapi))
_new_capsule = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)(
    ("PyCapsule_New", ctypes.pythonapi)
)


def read(value: object, stream: int) -> View | str:
    """Return the numbers of an array of any library, for work on a stream; or why it cannot be read."""
    try:
        interface = getattr(value, "__cuda_array_interface__", None)
    except RuntimeError as fault:  # of a tensor of PyTorch that requires a gradient
        return f"{fault}; give x.detach()"
    if interface is not None:
        return _read_interface(value, interface)
    if not hasattr(value, "__dlpack__"):
        return f"a {type(value).__name__} is not an array on a GPU; give an array of CuPy, PyTorch or JAX"
    if value.__dlpack_device__()[0] not in (_CUDA, _CUDA_MANAGED):  # type: ignore[attr-defined]
        return f"this {type(value).__name__} lies in the memory of the host; copy it to the GPU, as by cupy.asarray"
    try:
        return _read_capsule(value.__dlpack__(stream=stream or LEGACY))
    except (BufferError, RuntimeError) as fault:  # of a tensor of PyTorch that requires a gradient
        return f"it gives no DLPack: {fault}"


def _read_interface(value: object, interface: Mapping[str, Any]) -> View:
    dtype = np.dtype(interface["typestr"])
    shape = tuple(interface["shape"])
    strides = interface.get("strides")
    if strides is None:
        strides = _stride(shape, dtype.itemsize)
    pointer, is_read_only = interface["data"]
    given = interface.get("stream")
    counted = tuple(stride // dtype.itemsize for stride in strides)
    return View(pointer or 0, shape, counted, dtype.name, given, not is_read_only, value)


def _read_capsule(capsule: object) -> View:
    """Read a tensor; the capsule keeps it, and gives it back when it goes."""
    tensor = ctypes.cast(_get_pointer(capsule, _CAPSULE), ctypes.POINTER(_Managed)).contents.tensor
    shape = tuple(tensor.shape[i] for i in range(tensor.ndim))
    strides = tuple(tensor.strides[i] for i in range(tensor.ndim)) if tensor.strides else _stride(shape, 1)
    is_known = tensor.code in _CODES and tensor.lanes == 1
    dtype = np.dtype(f"{_CODES[tensor.code]}{tensor.bits // 8}").name if is_known else f"type {tensor.code}"
    return View((tensor.data or 0) + tensor.offset, shape, strides, dtype, None, True, capsule)


def _stride(shape: tuple[int, ...], step: int) -> tuple[int, ...]:
    """Return the strides of an array in C's order."""
    return tuple(step * math.prod(shape[i + 1 :]) for i in range(len(shape)))


class Array:
    """Numbers on a GPU: `cupy.asarray`, `torch.as_tensor`, `jax.dlpack.from_dlpack` and the like take it as it is.

    `get` copies it to an array of NumPy. When nobody refers to it, its memory is free after the present work of the
    stream that computed it.
    """

    def __init__(
        self, driver: Driver, device: int, shape: tuple[int, ...], strides: tuple[int, ...], dtype: str, stream: int
    ) -> None:
        """Allocate memory for numbers whose strides, in numbers, leave no gaps."""
        self.shape, self.strides, self.dtype = shape, strides, np.dtype(dtype)
        self.device, self._driver, self._stream = device, driver, stream
        self.pointer = 0
        self.size = math.prod(shape)
        if self.size:
            with driver.using(device):
                self.pointer = driver.allocate(self.size * self.dtype.itemsize, stream)
            weakref.finalize(self, _free, driver, device, self.pointer, stream).atexit = False

    def __repr__(self) -> str:
        return f"mbsrun.cuda.Array(shape={self.shape}, dtype={self.dtype}, device={self.device})"

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        """The array, for CuPy, PyTorch, Numba and others."""
        steps = tuple(stride * self.dtype.itemsize for stride in self.strides)
        told = {"shape": self.shape, "typestr": self.dtype.str, "data": (self.pointer, False), "strides": steps}
        return {**told, "stream": self._stream or LEGACY, "version": 3}

    def __dlpack_device__(self) -> tuple[int, int]:
        """Return the kind of its device, and its number."""
        return _CUDA, self.device

    def __dlpack__(self, *, stream: int | None = None, **_: object) -> object:
        """Return the array as a capsule, for work on a stream."""
        if stream not in (None, -1) and (stream or LEGACY) != (self._stream or LEGACY):
            with self._driver.using(self.device):
                self._driver.order(self._stream, stream or LEGACY)
        return _make_capsule(self)

    def get(self) -> np.ndarray[Any, np.dtype[Any]]:
        """Return a copy of the numbers, once they are computed, as an array of NumPy."""
        text = b""
        if self.size:
            with self._driver.using(self.device):
                self._driver.wait(self._stream)
                text = self._driver.copy_from(self.pointer, self.size * self.dtype.itemsize)
        order = sorted(range(len(self.shape)), key=lambda i: -self.strides[i])  # of axes in memory
        stored = np.frombuffer(text, self.dtype).reshape([self.shape[i] for i in order])
        return np.array(stored.transpose(np.argsort(order)), order="C")


def _free(driver: Driver, device: int, pointer: int, stream: int) -> None:
    with driver.using(device):
        driver.free(pointer, stream)


_shared: dict[int, tuple[object, ...]] = {}  # what a capsule refers to, by its address, until it is given back


def _make_capsule(array: Array) -> object:
    many = ctypes.c_int64 * len(array.shape)
    shape, strides = many(*array.shape), many(*array.strides)
    dtype, pointers = array.dtype, ctypes.POINTER(ctypes.c_int64)
    code = next(code for code, kind in _CODES.items() if kind == dtype.kind)
    kind, number = array.__dlpack_device__()
    numbers = (array.pointer, kind, number, len(array.shape), code, dtype.itemsize * 8, 1)
    tensor = _Tensor(*numbers, ctypes.cast(shape, pointers), ctypes.cast(strides, pointers), 0)
    managed = _Managed(tensor, None, _GIVE_BACK)
    address = ctypes.addressof(managed)
    _shared[address] = (managed, shape, strides, array)
    return _new_capsule(address, _CAPSULE, ctypes.cast(_DROP, ctypes.c_void_p))


def _give_back(managed: Any) -> None:
    """Forget an array that its reader no longer needs."""
    _shared.pop(ctypes.addressof(managed.contents), None)


def _drop(capsule: int) -> None:
    """Forget an array whose capsule nobody has read."""
    if _is_valid(capsule, _CAPSULE):
        _shared.pop(_find_address(capsule, _CAPSULE), None)


_GIVE_BACK, _DROP = _Deleter(_give_back), _Destructor(_drop)
