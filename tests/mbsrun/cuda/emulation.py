"""A GPU of plain C++: its grid, compiled for this machine, and its driver; and arrays that lie on it."""

from __future__ import annotations

import ctypes
import hashlib
import re
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbsrun.cuda import driver, images
from mbsrun.cuda.arrays import Array
from mbsrun.cuda.driver import Driver, find_driver

HERE = Path(__file__).parent
# Each operation is rounded, as in the C that these are compared with; no vectors, as on a GPU.
FLAGS = ("-std=c++17", "-O0", "-ffp-contract=off", "-march=native", "-fPIC", "-w")
LOG = (
    "Function properties for {}\n ptxas . 8 bytes stack frame, 16 bytes spill stores, 0 bytes spill\nUsed 24 registers"
)


@dataclass(frozen=True)
class Emulator:
    """In place of NVRTC: it compiles a file with a grid to a library, and gives the library's path for code."""

    folder: Path
    flags: tuple[str, ...] = FLAGS

    @property
    def version(self) -> str:
        return str(self.folder)  # which differs for each run of the tests

    def compile(
        self, main: str, files: Mapping[str, bytes], architecture: str, defined: Sequence[str] = ()
    ) -> tuple[bytes, str]:
        assert architecture == "sm_90"
        function = re.search(r'^extern "C" __global__ void (\w+)\(', files[main].decode(), re.MULTILINE)[1]
        tail = f"""
            extern "C" void {function}_grid(unsigned blocks, unsigned threads, void **arguments)
            {{
                grid_run({function}, blocks, threads, arguments);
            }}"""
        digest = hashlib.sha256(repr((sorted(files.items()), defined)).encode()).hexdigest()
        place = self.folder / digest
        place.mkdir(exist_ok=True)
        for name, text in files.items():
            (place / name).write_bytes(text)
        (place / "all.cpp").write_text(f'#include "{HERE / "grid.h"}"\n#include "{main}"\n{tail}')
        library = place / "all.so"
        command = ["g++", *self.flags, *(f"-D{word}" for word in defined), "-shared", place / "all.cpp", "-o", library]
        subprocess.run(command, check=True)
        return str(library).encode() + b"\0", LOG.format(function)


@dataclass(frozen=True)
class Gpu:
    """The emulated GPUs."""

    driver: Driver
    fake: Any

    def put(self, array: np.ndarray, *, device: int = 0, by_states: bool = False) -> Array:
        """Copy an array to a GPU: in C's order, or with the entries of the first axis side by side."""
        order = (*range(1, array.ndim), 0) if by_states else tuple(range(array.ndim))
        stored = np.ascontiguousarray(array.transpose(order))
        strides = [0] * array.ndim
        for axis, stride in zip(order, stored.strides, strict=True):
            strides[axis] = stride // array.itemsize
        made = Array(self.driver, device, array.shape, tuple(strides), array.dtype.name, 0)
        if made.size:
            with self.driver.using(device):
                self.driver.copy_to(made.pointer, stored.tobytes())
        return made

    def tell(self) -> list[str]:
        """Return the calls since the last time."""
        lines = self.fake.fake_told().decode().splitlines()
        self.fake.fake_forget()
        return lines


class Foreign:
    """An array of another library: a part of an own one, with any strides."""

    def __init__(self, holder: Array, **changes: Any) -> None:
        self._holder = holder
        self.__cuda_array_interface__ = {**holder.__cuda_array_interface__, "stream": None, **changes}


class Packed:
    """An array that is given by DLPack alone."""

    def __init__(self, holder: Array) -> None:
        self._holder = holder
        self.streams: list[int | None] = []

    def __dlpack_device__(self) -> tuple[int, int]:
        return self._holder.__dlpack_device__()

    def __dlpack__(self, *, stream: int | None = None) -> object:
        self.streams.append(stream)
        return self._holder.__dlpack__(stream=stream)


@contextmanager
def emulate(folder: Path, flags: tuple[str, ...] = FLAGS) -> Iterator[Gpu]:
    """Put emulated GPUs in place of NVIDIA's, for a while."""
    library = folder / "libcuda.so"
    subprocess.run(["g++", *FLAGS, "-shared", HERE / "fake_driver.cpp", "-o", library, "-ldl"], check=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(driver, "LIBRARY", str(library))
        patch.setattr(images, "find_nvrtc", lambda: Emulator(folder, flags))
        find_driver.cache_clear()
        fake = ctypes.CDLL(str(library))
        fake.fake_told.restype = ctypes.c_char_p
        try:
            yield Gpu(find_driver(), fake)
        finally:
            find_driver.cache_clear()
