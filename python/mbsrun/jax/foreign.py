"""Kernels as targets of XLA's foreign function interface: one handler in C, compiled against the installed jaxlib.

A program names its kernel by a number made from the content of the kernel's library. So a compiled program that JAX
keeps on disk finds the same code again, or none.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from threading import Lock
from typing import Any

import cffi
import jax
import numpy as np

from mbsgen import resources
from mbsrun.binding import ArgumentError
from mbsrun.library import CompileError, compile_library, find_compiler
from mbsrun.operators import Call

TARGET = "mbs_jax"
_DECLARATIONS = """
typedef struct mbs_jax_kernel {
    long long key;
    void *batch;
    void *kernel;
    long long n_in, n_out, given, wanted;
    const long long *in_place, *in_size, *out_place, *out_size;
    struct mbs_jax_kernel *next;
} mbs_jax_kernel;
int mbs_jax_enter(mbs_jax_kernel *entry);
"""
_entered: dict[int, list[Any]] = {}  # what C reads, by key; a compiled program may call it as long as the process lives
_lock = Lock()


def enter(call: Call) -> int:
    """Enter a kernel in the table of the handler, once; return the number by which programs name it."""
    with _lock:
        if call.key not in _entered:
            ffi, library = _open_library()
            lists = [
                ffi.new("long long[]", [port.position for port in call.given]),
                ffi.new("long long[]", [port.argument.nnz for port in call.given]),
                ffi.new("long long[]", [port.position for port in call.wanted]),
                ffi.new("long long[]", list(call.sizes)),
            ]
            entry: Any = ffi.new("mbs_jax_kernel *")
            entry.key, entry.n_in, entry.n_out = call.key, call.entry.n_in, call.entry.n_out
            entry.batch, entry.kernel = (_find_address(ffi, f) for f in (call.batch.mbs_batch, call.entry.function))
            entry.given, entry.wanted = len(call.given), len(call.wanted)
            entry.in_place, entry.in_size, entry.out_place, entry.out_size = lists
            if library.mbs_jax_enter(entry):
                raise ArgumentError(f"{call.entry.kernel.name} has more arguments than programs of JAX can pass")
            _entered[call.key] = [entry, *lists, call]
    return call.key


def call(call: Call, batch: Sequence[int], arrays: Sequence[Any], *, with_status: bool) -> list[Any]:
    """Write a call into a program: results by nonzeros, a row for each state, and last the statuses, if asked."""
    results = [jax.ShapeDtypeStruct((*batch, size), np.float64) for size in call.sizes]
    if with_status:
        results.append(jax.ShapeDtypeStruct(tuple(batch), np.int32))
    if not call.wanted:
        return [jax.numpy.zeros(x.shape, x.dtype) for x in results]
    return list(jax.ffi.ffi_call(TARGET, results)(*arrays, kernel=np.int64(enter(call))))


def _find_address(ffi: cffi.FFI, function: Any) -> Any:
    return ffi.cast("void *", int(cffi.FFI().cast("uintptr_t", function)))


@cache
def _open_library() -> tuple[cffi.FFI, Any]:
    """Compile the handler, load it, and register it with JAX."""
    headers = Path(jax.ffi.include_dir()) / "xla" / "ffi" / "api"
    csrc = resources.folder("csrc")
    path = str(compile_library(csrc / "jax", TARGET, [f"{TARGET}.c"], find_compiler(os.environ), csrc, headers))
    ffi = cffi.FFI()
    ffi.cdef(_DECLARATIONS)
    try:
        library, functions = ffi.dlopen(path), ctypes.CDLL(path)
    except OSError as error:
        raise CompileError(f"{path} cannot be loaded: {error}; remove it, it will be compiled again") from None
    jax.ffi.register_ffi_target(TARGET, jax.ffi.pycapsule(functions.mbs_jax), platform="cpu")
    return ffi, library
