"""Kernels as targets of XLA's foreign function interface: one handler in C, compiled against the installed jaxlib.

A program names its kernel by a number made from the content of the kernel's library. So a compiled program that JAX
keeps on disk finds the same code again, or none.
"""

from __future__ import annotations

import ctypes
import math
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
from mbsrun.faces.operators import Call
from mbsrun.library import CompileError, compile_library, find_compiler
from mbsrun.many import Loop, Several, find_room

TARGET = "mbs_jax"
_DECLARATIONS = """
typedef struct mbs_jax_kernel {
    long long key;
    void *kernel, *many, *several;
    long long room;
    long long n_in, n_out, given, wanted;
    const long long *in_place, *in_size, *out_place, *out_size;
    struct mbs_jax_kernel *next;
} mbs_jax_kernel;
int mbs_jax_enter(mbs_jax_kernel *entry);
"""
_entered: dict[int, list[Any]] = {}  # what C reads, by key; a compiled program may call it as long as the process lives
_lock = Lock()


def enter(call: Call, states: int) -> int:
    """Enter a kernel in the table of the handler, once; return the number by which programs name it.

    Where there are many states, it is the kernel that computes several of them at once.
    """
    loop, several = call.choose_loop(states)
    key = call.key if several is None else call.key ^ loop.width  # its bits depend on the number of lanes
    with _lock:
        if key not in _entered:
            _enter(key, call, loop, several)
    return key


def _enter(key: int, call: Call, loop: Loop, several: Several | None) -> None:
    ffi, library = _open_library()
    lists = [
        ffi.new("long long[]", [port.position for port in call.given]),
        ffi.new("long long[]", [port.argument.nnz for port in call.given]),
        ffi.new("long long[]", [port.position for port in call.wanted]),
        ffi.new("long long[]", list(call.sizes)),
    ]
    entry: Any = ffi.new("mbs_jax_kernel *")
    entry.key, entry.n_in, entry.n_out = key, call.entry.n_in, call.entry.n_out
    entry.kernel = _find_address(ffi, call.entry.function)
    entry.many = _find_address(ffi, loop.get("mbs_compute_many"))
    if several is not None:
        entry.several = _find_address(ffi, several.function)
    entry.room = find_room(loop, call.entry, call.given, call.wanted)
    entry.given, entry.wanted = len(call.given), len(call.wanted)
    entry.in_place, entry.in_size, entry.out_place, entry.out_size = lists
    if library.mbs_jax_enter(entry):
        raise ArgumentError(f"{call.entry.kernel.name} has more arguments than programs of JAX can pass")
    _entered[key] = [entry, *lists, call, loop, several]


def call(call: Call, batch: Sequence[int], arrays: Sequence[Any], *, with_status: bool) -> list[Any]:
    """Write a call into a program: results by nonzeros, a row for each state, and last the statuses, if asked."""
    results = [jax.ShapeDtypeStruct((*batch, size), np.float64) for size in call.sizes]
    if with_status:
        results.append(jax.ShapeDtypeStruct(tuple(batch), np.int32))
    if not call.wanted:
        return [jax.numpy.zeros(x.shape, x.dtype) for x in results]
    key = enter(call, math.prod(batch))
    return list(jax.ffi.ffi_call(TARGET, results)(*arrays, kernel=np.int64(key)))


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
