"""CUDA C -> machine code for a GPU, by NVIDIA's run-time compiler, NVRTC, which needs no GPU."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from mbsgen.errors import MbsError

REMEDY = "run in the folder of the project: pip install '.[cuda]'"
# The kernel's C has no words of CUDA; the report of the assembler is the log.
_OPTIONS = ("--device-as-default-execution-space", "--std=c++17", "--ptxas-options=-v")
_SYSTEM = {"math.h": b"", "float.h": b""}  # NVRTC has no files; it knows what these declare
_NAMES = ("libnvrtc.so.13", "libnvrtc.so.12", "libnvrtc.so")
_PROPERTIES = "Function properties for "
_USED = re.compile(r"(\d+) bytes stack frame, (\d+) bytes spill stores.*Used (\d+) registers", re.DOTALL)


class CudaError(MbsError):
    """A GPU, its driver or its compiler that is missing or fails."""


@dataclass(frozen=True)
class Resources:
    """The resources of a kernel, for each thread."""

    registers: int
    stack: int  # bytes
    spilled: int  # bytes that registers have no room for, and that are stored in memory


@dataclass(frozen=True)
class Nvrtc:
    """The compiler, loaded."""

    library: Any
    version: tuple[int, int]

    def compile(
        self, main: str, files: Mapping[str, bytes], architecture: str, defined: Sequence[str] = ()
    ) -> tuple[bytes, str]:
        """Compile the file `main`, which includes others of `files`, for an architecture such as sm_90.

        Returns machine code (cubin), and the log. Raises CudaError with the compiler's messages.
        """
        program = ctypes.c_void_p()
        given = {**_SYSTEM, **{name: text for name, text in files.items() if name != main}}
        names, texts = (_make_strings(x) for x in (map(str.encode, given), given.values()))
        self._check("CreateProgram", ctypes.byref(program), files[main], main.encode(), len(given), texts, names)
        try:
            options = [f"--gpu-architecture={architecture}", *_OPTIONS, *(f"-D{word}" for word in defined)]
            failed = self.library.nvrtcCompileProgram(program, len(options), _make_strings(map(str.encode, options)))
            log = self._get(program, "ProgramLog").rstrip(b"\0").decode(errors="replace")
            if failed:
                raise CudaError(f"NVRTC cannot compile {main} for {architecture}:\n{log.strip() or self._name(failed)}")
            return self._get(program, "CUBIN"), log
        finally:
            self.library.nvrtcDestroyProgram(ctypes.byref(program))

    def _get(self, program: ctypes.c_void_p, kind: str) -> bytes:
        size = ctypes.c_size_t()
        self._check(f"Get{kind}Size", program, ctypes.byref(size))
        text = ctypes.create_string_buffer(size.value)
        self._check(f"Get{kind}", program, text)
        return text.raw

    def _check(self, name: str, *arguments: object) -> None:
        failed = getattr(self.library, f"nvrtc{name}")(*arguments)
        if failed:
            raise CudaError(f"NVRTC fails in nvrtc{name}: {self._name(failed)}")

    def _name(self, failed: int) -> str:
        self.library.nvrtcGetErrorString.restype = ctypes.c_char_p
        return str(self.library.nvrtcGetErrorString(failed).decode())


def _make_strings(texts: Any) -> Any:
    listed = list(texts)
    return (ctypes.c_char_p * len(listed))(*listed)


@cache
def find_nvrtc() -> Nvrtc:
    """Load NVRTC: of the package nvidia-cuda-nvrtc, else of the system. Raises CudaError where there is none."""
    for path in (*_list_installed(), *_NAMES):
        try:
            library = ctypes.CDLL(path)
        except OSError:
            continue
        major, minor = ctypes.c_int(), ctypes.c_int()
        library.nvrtcVersion(ctypes.byref(major), ctypes.byref(minor))
        return Nvrtc(library, (major.value, minor.value))
    raise CudaError(f"NVRTC, the compiler for GPUs, is not installed; {REMEDY}")


def _list_installed() -> Iterator[str]:
    """List the libraries of packages: `nvidia/cu13/lib`, or before CUDA 13 `nvidia/cuda_nvrtc/lib`."""
    spec = find_spec("nvidia")
    for folder in (spec.submodule_search_locations or ()) if spec else ():
        yield from sorted(map(str, Path(folder).glob("cu*/lib/libnvrtc.so.[0-9]*")), reverse=True)


def read_resources(log: str, function: str) -> Resources:
    """Read the resources of a kernel from the log of its compilation."""
    for part in log.split(_PROPERTIES):
        if part.split()[:1] == [function] and (found := _USED.search(part)):
            stack, spilled, registers = map(int, found.groups())
            return Resources(registers, stack, spilled)
    raise CudaError(f"NVRTC's log says nothing of {function}; install another version of nvidia-cuda-nvrtc")
