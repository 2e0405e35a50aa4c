"""Threads that work on stages at once, for the time of a solve: Evaluator -> a team of csrc/stages."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsrun.ocp.evaluation.stages.abreast import Abreast
from mbsrun.ocp.evaluation.stages.interface import load_threads


class Team:
    """The workers of a solver, each with its own instance of the functions, and with their time."""

    def __init__(self, ffi: Any, lib: Any, instance: Any, threads: int, abreast: Abreast | None = None) -> None:
        """Take the instance of worker 0 in a library; others get its tables and its numbers.

        Each makes several calls at once by `abreast`, if there is such. Raises CompileError.
        """
        self._ffi, self._lib = ffi, lib
        size = self._lib.mbs_program_bytes(instance.program)
        self._memories = [make_memory(size) for _ in range(threads - 1)]
        self.contexts = ffi.new("mbs_timed_program[]", threads)
        self.contexts[0].instance = instance
        for context, memory in zip(list(self.contexts)[1:], self._memories, strict=True):
            context.instance = self._lib.mbs_program_create(instance.program, ffi.cast("void *", memory.ctypes.data))
            context.instance.parameters, context.instance.numbers = instance.parameters, instance.numbers
        self._lanes = [self._lay(abreast, context.instance) for context in self.contexts] if abreast else []
        self.c: Any = ffi.NULL
        if threads > 1:
            self._threads = load_threads(ffi)
            self._pool = make_memory(self._threads.mbs_threads_bytes(threads))
            self._pointers = ffi.new("void *[]", [ffi.addressof(self.contexts, i) for i in range(threads)])
            spread = ffi.addressof(self._threads, "mbs_threads_spread")
            self.c = ffi.new("mbs_stages_team *", [threads, spread, ffi.NULL, self._pointers])

    def _lay(self, abreast: Abreast, instance: Any) -> tuple[Any, Any]:
        """Set the functions of a worker for several calls at once; return what must outlive it."""
        room = make_memory(abreast.numbers * self._ffi.sizeof("double"))
        lanes = abreast.lay(self._ffi.cast("double *", room.ctypes.data))
        instance.lanes = lanes
        return room, lanes

    @contextmanager
    def at_work(self) -> Iterator[None]:
        """Run the threads, and take their time from 0 on."""
        for context in self.contexts:
            context.seconds = 0.0
        if len(self.contexts) == 1:
            yield
            return
        memory = self._ffi.cast("void *", self._pool.ctypes.data)
        self.c.pool = self._threads.mbs_threads_start(memory, len(self.contexts))
        try:
            yield
        finally:
            self._threads.mbs_threads_stop(self.c.pool)

    @property
    def seconds(self) -> tuple[float, float]:
        """Return the time in functions and derivatives: of the worker that took most, and of all."""
        times = [float(context.seconds) for context in self.contexts]
        return max(times), sum(times)


def make_memory(size: int) -> NDArray[np.uint8]:
    """Return memory of a size, aligned to 64 bytes."""
    memory = np.zeros(size + 64, dtype=np.uint8)
    first = -memory.ctypes.data % 64
    return memory[first : first + size]
