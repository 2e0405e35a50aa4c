"""The driver of NVIDIA's GPUs, libcuda, by ctypes: devices, memory, modules, launches and the order of streams.

Calls use the primary context of a device, which CUDA's run time, CuPy, PyTorch and JAX use as well.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from mbsrun.cuda.nvrtc import CudaError

LIBRARY = "libcuda.so.1"
_MAJOR, _MINOR = 75, 76  # attributes of devices: the compute capability
_MEMORY_TYPE, _IS_MANAGED, _ORDINAL = 2, 8, 9  # attributes of pointers
_ON_DEVICE = 2  # a memory type
_NO_TIMING = 2  # a kind of events
_UNKNOWN_TO_DRIVER = (200, 209, 222)  # code for another GPU, or by a newer compiler than the driver knows
_Pointer = ctypes.c_uint64


@dataclass(frozen=True)
class Driver:
    """The driver, loaded and initialised."""

    library: Any
    _contexts: dict[int, ctypes.c_void_p] = field(default_factory=dict)

    def count(self) -> int:
        """Count the GPUs."""
        number = ctypes.c_int()
        self._call("cuDeviceGetCount", ctypes.byref(number))
        return number.value

    def describe(self, device: int) -> tuple[str, str]:
        """Return the name of a GPU, and its architecture, such as sm_90."""
        name, numbers = ctypes.create_string_buffer(256), []
        self._call("cuDeviceGetName", name, len(name), device)
        for attribute in (_MAJOR, _MINOR):
            number = ctypes.c_int()
            self._call("cuDeviceGetAttribute", ctypes.byref(number), attribute, device)
            numbers.append(number.value)
        return name.value.decode(), "sm_{}{}".format(*numbers)

    @contextmanager
    def using(self, device: int) -> Iterator[None]:
        """Make a device's primary context the current one for a while."""
        if device not in self._contexts:
            context = ctypes.c_void_p()
            self._call("cuDevicePrimaryCtxRetain", ctypes.byref(context), device)
            self._contexts[device] = context
        self._call("cuCtxPushCurrent_v2", self._contexts[device])
        try:
            yield
        finally:
            self._call("cuCtxPopCurrent_v2", ctypes.byref(ctypes.c_void_p()))

    def find_device(self, pointer: int) -> int | None:
        """Return the device that memory lies on; None for memory of the host."""
        kinds = {key: ctypes.c_uint(0) for key in (_MEMORY_TYPE, _IS_MANAGED, _ORDINAL)}
        for key, value in kinds.items():
            if self.library.cuPointerGetAttribute(ctypes.byref(value), key, _Pointer(pointer)):
                return None  # the driver does not know it
        is_on_device = kinds[_MEMORY_TYPE].value == _ON_DEVICE or kinds[_IS_MANAGED].value & 0xFF
        return kinds[_ORDINAL].value if is_on_device else None

    def load(self, code: bytes, function: str) -> ctypes.c_void_p:
        """Load machine code into the current context, for good, and return a function."""
        module, found = ctypes.c_void_p(), ctypes.c_void_p()
        failed = self.library.cuModuleLoadData(ctypes.byref(module), code)
        if failed in _UNKNOWN_TO_DRIVER:
            raise CudaError(
                "the GPU's driver is older than the compiler NVRTC, and does not know its code; update the driver, or "
                "take an NVRTC of its time: pip install nvidia-cuda-nvrtc-cu12"
            )
        self._check("cuModuleLoadData", failed)
        self._call("cuModuleGetFunction", ctypes.byref(found), module, function.encode())
        return found

    def launch(
        self, function: ctypes.c_void_p, blocks: int, threads: int, stream: int, arguments: Sequence[Any]
    ) -> None:
        """Start a function on a grid of blocks; arguments are values of ctypes, which are copied."""
        pointers = (ctypes.c_void_p * len(arguments))(*(ctypes.addressof(a) for a in arguments))
        self._call("cuLaunchKernel", function, blocks, 1, 1, threads, 1, 1, 0, ctypes.c_void_p(stream), pointers, None)

    def allocate(self, size: int, stream: int) -> int:
        """Allocate bytes on the current device, for work that follows in a stream."""
        pointer = _Pointer()
        self._call("cuMemAllocAsync", ctypes.byref(pointer), ctypes.c_size_t(size), ctypes.c_void_p(stream))
        return pointer.value

    def free(self, pointer: int, stream: int) -> None:
        """Free what `allocate` has given, after the present work of a stream; nobody waits."""
        self._call("cuMemFreeAsync", _Pointer(pointer), ctypes.c_void_p(stream))

    def copy_to(self, pointer: int, text: bytes) -> None:
        """Copy bytes to the device."""
        self._call("cuMemcpyHtoD_v2", _Pointer(pointer), text, ctypes.c_size_t(len(text)))

    def copy_from(self, pointer: int, size: int) -> bytes:
        """Copy bytes from the device."""
        text = ctypes.create_string_buffer(size)
        self._call("cuMemcpyDtoH_v2", text, _Pointer(pointer), ctypes.c_size_t(size))
        return text.raw

    def wait(self, stream: int) -> None:
        """Wait until the work of a stream is done."""
        self._call("cuStreamSynchronize", ctypes.c_void_p(stream))

    def order(self, first: int, then: int) -> None:
        """Make a stream wait for the present work of another one."""
        event = ctypes.c_void_p()
        self._call("cuEventCreate", ctypes.byref(event), _NO_TIMING)
        try:
            self._call("cuEventRecord", event, ctypes.c_void_p(first))
            self._call("cuStreamWaitEvent", ctypes.c_void_p(then), event, 0)
        finally:
            self._call("cuEventDestroy_v2", event)

    def _call(self, name: str, *arguments: object) -> None:
        self._check(name, getattr(self.library, name)(*arguments))

    def _check(self, name: str, failed: int) -> None:
        if failed:
            text = ctypes.c_char_p()
            self.library.cuGetErrorString(failed, ctypes.byref(text))
            reason = text.value.decode() if text.value else f"error {failed}"
            raise CudaError(f"the GPU's driver fails in {name}: {reason}")


@cache
def find_driver() -> Driver:
    """Load the driver. Raises CudaError where there is no GPU."""
    try:
        library = ctypes.CDLL(LIBRARY)
    except OSError:
        raise CudaError(f"there is no GPU here: {LIBRARY}, the driver of NVIDIA's GPUs, cannot be loaded") from None
    driver = Driver(library)
    if library.cuInit(0) or not driver.count():
        raise CudaError("there is no GPU here: the driver of NVIDIA's GPUs finds none")
    return driver
