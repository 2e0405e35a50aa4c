"""A controller's folder from Python: compiled once, called with NumPy arrays; the same C that runs without Python.

c = mbsrun.controller("DIR")
c.data["end_q"][:] = 1.5
c.solve().status                    "solved"
c.solve_batch(states).inputs        of many starts
c.prepare(shift=True)
inputs, step = c.feedback(state)
"""

from __future__ import annotations

import os
import queue
import re
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import cffi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbsgen.errors import MbsError
from mbsrun.controllers import folder as folders
from mbsrun.controllers.sources import PLAIN
from mbsrun.library import compile_library, find_compiler

Array = NDArray[np.float64]

SOLVED = ("solved", "acceptable")
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_NUMBER = re.compile(r"#define \w+ \d+")
_ALIGNMENT = 16
_INSIDE = """
mbs_stages_point {0}_get_iterate({0} *);
int {0}_find_values({0} *, int k, double *f, double *e, double *d, double *g);
"""


class ControllerError(MbsError):
    """Arguments that do not fit a controller, or a folder that cannot be used."""


@dataclass(frozen=True)
class Result:
    """The outcome of a solve; numbers are unscaled."""

    status: str  # a word of `read_statuses`
    message: str
    stage: int | None  # where a function failed
    iterations: int
    cost: float
    violation: float
    stationarity: float

    @property
    def is_solved(self) -> bool:
        """Return whether a solution was found, if only to the acceptable tolerance."""
        return self.status in SOLVED


@dataclass(frozen=True)
class Step:
    """The outcome of a preparation or a feedback; violation and stationarity belong to the plan before it."""

    status: str
    message: str
    stage: int | None
    violation: float
    stationarity: float
    deviation: float  # of the measured state from the plan's first one, scaled
    length: float


@dataclass(frozen=True, eq=False)
class Batch:
    """The outcomes of many solves; each array has a row for each problem: without a solution, of the last iterate."""

    statuses: tuple[str, ...]  # words of `read_statuses`
    is_solved: NDArray[np.bool_]  # (problems,): a solution was found, if only to the acceptable tolerance
    iterations: NDArray[np.intc]
    cost: Array
    inputs: Array  # (problems, inputs): to apply first
    plan_states: Array  # (problems, N + 1, states)
    plan_inputs: Array  # (problems, N, inputs)


@dataclass(frozen=True, eq=False)
class Plan:
    """The kept plan: N intervals."""

    times: Array  # (N + 1,)
    states: Array  # (N + 1, states)
    inputs: Array  # (N, inputs)


class Controller:
    """A controller in memory.

    `data` holds its run-time data by name, as arrays; numbers that are written there count in the next call.
    """

    folder: Path  # that it was loaded from
    manifest: folders.Manifest
    data: Mapping[str, Array]
    library: Path  # the shared library that was loaded

    def __init__(self, folder: str | Path) -> None:
        """Compile the folder's C, or find it in the cache, and make a controller.

        Raises InputError for a folder without a manifest of a controller, CompileError, CacheError.
        """
        self.folder = Path(folder)
        self.manifest = folders.read(self.folder)
        self._name = self.manifest.prefix
        self._ffi: Any = cffi.FFI()
        self._ffi.cdef(_declare(self.folder / "mbs_stages.h"))
        self._ffi.cdef(self._tag(_declare(self.folder / f"{self._name}.h") + _INSIDE.format(self._name)))
        self._statuses = _name_statuses(self._ffi)
        compiler = find_compiler(os.environ)
        sources = self.manifest.sources
        rows = [name for name in sources if name.startswith("mbs_stages_")]
        self.library = compile_library(self.folder, self._name, sources, compiler, rows=rows, given=PLAIN)
        self._library: Any = self._ffi.dlopen(str(self.library))
        self._memory, self._controller = self._make()
        self._clock = self._ffi.callback("double(void *)", lambda _: time.perf_counter())
        self.data = MappingProxyType(self._view())

    def __repr__(self) -> str:
        """Return the controller's name, its plan and its data."""
        return f"Controller({self._name}: {self.manifest.intervals} intervals; data {', '.join(self.data)})"

    @property
    def bytes(self) -> int:
        """Count the bytes of memory that the controller uses."""
        return int(self._call("bytes"))

    @property
    def period(self) -> float:
        """Return the length of an interval of the plan [s]."""
        return float(self._call("get_period", self._controller))

    @property
    def options(self) -> Any:
        """The options of the solver as a struct, see mbs_stages.h: `c.options.mu_target = 1e-5`."""
        return self._call("get_options", self._controller)

    def reset(self) -> None:
        """Set data, options and plan as the folder has them."""
        self._call("reset", self._controller)

    def solve(
        self,
        *,
        iterations: int | None = None,
        seconds: float | None = None,
        tolerance: float | None = None,
        warm: bool = False,
    ) -> Result:
        """Solve from the kept plan; `warm`: from its multipliers too."""
        limits = self._limit(iterations=iterations, seconds=seconds, tolerance=tolerance)
        limits.warm = warm
        self._call("solve", self._controller, limits)
        return self._describe_result()

    def solve_batch(
        self,
        states: ArrayLike | None = None,
        *,
        data: Mapping[str, ArrayLike] | None = None,
        threads: int = 1,
        iterations: int | None = None,
        seconds: float | None = None,
        tolerance: float | None = None,
    ) -> Batch:
        """Solve many problems that differ in their numbers, each anew from the kept plan, in other memory.

        `states`, (problems, states), are where they start; `data` has rows of other data by name, (problems, size). The
        others are as the controller has them. Data, options and plan of this controller stay. No result depends on
        the other problems, nor on `threads`. Raises ControllerError for shapes that do not fit.
        """
        if threads < 1:
            raise ControllerError(f"threads = {threads!r}: give at least one")
        rows, count = self._collect(states, data or {})
        limits = self._limit(iterations=iterations, seconds=seconds, tolerance=tolerance)
        N, nx, nu = self.manifest.intervals, len(self.manifest.states), len(self.manifest.inputs)
        status, taken = np.zeros(count, dtype=np.intc), np.zeros(count, dtype=np.intc)
        found = [np.zeros((count, *shape)) for shape in ((), (nu,), (N + 1, nx), (N, nu))]
        batch = self._ffi.new(f"{self._name}_batch *")
        batch.data, batch.limits = self._pass(rows), limits
        batch.status, batch.iterations = (self._ffi.cast("int *", x.ctypes.data) for x in (status, taken))
        batch.cost, batch.inputs, batch.plan_states, batch.plan_inputs = map(self._pass, found)
        size = max(1, count // (4 * threads))
        spans = [(i, min(count, i + size)) for i in range(0, count, size)]
        workers = [self._make() for _ in range(min(threads, len(spans)))]
        free = queue.SimpleQueue[Any]()
        for worker in workers:
            free.put(worker)

        def solve(span: tuple[int, int]) -> None:
            memory, worker = free.get()
            self._call("solve_batch", worker, self._controller, batch, *span)
            free.put((memory, worker))

        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(solve, spans))
        words = tuple(self._statuses[k] for k in status.tolist())
        solved = np.array([word in SOLVED for word in words], dtype=bool)
        return Batch(words, solved, taken, *found)

    def prepare(self, *, shift: bool = False) -> Step:
        """Begin a sampling period, before its state is measured; `shift` moves the plan ahead by one interval."""
        self._call("prepare", self._controller, int(shift))
        return self._describe_step()

    def feedback(self, state: ArrayLike) -> tuple[Array, Step]:
        """Return the inputs to apply at a measured state, coordinates before velocities, and what was done."""
        given = self._check("state", state, len(self.manifest.states))
        inputs = np.zeros(len(self.manifest.inputs))
        self._call("feedback", self._controller, self._pass(given), self._pass(inputs))
        return inputs, self._describe_step()

    def gain(self) -> Array:
        """Return the feedback matrix (inputs, states) of the step that was prepared last: derivatives by the state.

        Between samples, `inputs + gain @ (state - measured)` goes on with the same plan. Raises ControllerError without
        a preparation since the last solve.
        """
        found = np.zeros((len(self.manifest.inputs), len(self.manifest.states)))
        status = self._call("gain", self._controller, self._pass(found))
        if self._statuses[int(status)] != "prepared":
            raise ControllerError(f"{self.folder}: there is no feedback matrix; call prepare first")
        return found

    def rescue(
        self, state: ArrayLike, *, iterations: int | None = None, seconds: float | None = None
    ) -> tuple[Array, Result]:
        """Solve anew from a measured state after steps went wrong; return the inputs to apply, and the outcome.

        The solve begins at the kept plan, unless it has diverged; without a solution from there, at the first guess.
        """
        given = self._check("state", state, len(self.manifest.states))
        inputs = np.zeros(len(self.manifest.inputs))
        limits = self._limit(iterations=iterations, seconds=seconds)
        self._call("rescue", self._controller, self._pass(given), limits, self._pass(inputs))
        return inputs, self._describe_result()

    def plan(self) -> Plan:
        """Return a copy of the kept plan."""
        N = self.manifest.intervals
        times, states = np.zeros(N + 1), np.zeros((N + 1, len(self.manifest.states)))
        inputs = np.zeros((N, len(self.manifest.inputs)))
        self._call("get_plan", self._controller, *map(self._pass, (times, states, inputs)))
        return Plan(times, states, inputs)

    @property
    def variables(self) -> Array:
        """All variables of the kept plan, stage by stage, as the solver has them: a view."""
        point = self._call("get_iterate", self._controller)
        return np.frombuffer(self._ffi.buffer(point.w, 8 * point.variables), dtype=np.float64)

    def predict(self, state: ArrayLike, inputs: ArrayLike, seconds: float, steps: int = 10) -> Array:
        """Return the state after some time under constant inputs, by the model's own dynamics.

        Raises ControllerError where the model has none in the folder, or no acceleration on the way.
        """
        if not self.manifest.predicts:
            finding = "the model's motion is not part of it, as it has loops, or the problem adds states"
            raise ControllerError(f"{self.folder}: {finding}")
        if steps < 1 or not seconds >= 0:
            raise ControllerError(f"seconds = {seconds!r}, steps = {steps!r}: give a time and at least one step")
        given = self._check("state", state, len(self.manifest.states))
        u = self._check("inputs", inputs, len(self.manifest.inputs))
        after = np.zeros_like(given)
        if self._call("predict", self._controller, self._pass(given), self._pass(u), seconds, steps, self._pass(after)):
            raise ControllerError("the model has no acceleration on the way; take another state or other inputs")
        return after

    def find_equations(self, w: Array, counts: Sequence[int]) -> Array:
        """Take variables as the kept iterate, stage by stage, and return all equations; `counts` of each stage.

        Raises ControllerError where a function has no value.
        """
        point = self._call("get_iterate", self._controller)
        self._ffi.memmove(point.w, np.ascontiguousarray(w, dtype=np.float64), 8 * w.size)
        rest = [np.zeros(point.variables + point.rows + 1) for _ in range(3)]
        found = []
        for k, count in enumerate(counts):
            e = np.zeros(count + 1)
            f, d, g = map(self._pass, rest)
            if self._call("find_values", self._controller, k, f, self._pass(e), d, g):
                raise ControllerError(f"at the guess, the functions of stage {k} have no value; take another guess")
            found.append(e[:-1])
        return np.concatenate(found)

    # --- the C side ---

    def _call(self, function: str, *arguments: Any) -> Any:
        return getattr(self._library, f"{self.manifest.symbols}_{function}")(*arguments)

    def _make(self) -> tuple[Any, Any]:
        """Make a controller; return its memory, which must outlive it, and the controller."""
        size = self._call("bytes")
        memory = self._ffi.new("char[]", size + _ALIGNMENT)
        address = int(self._ffi.cast("uintptr_t", memory))
        made = self._call("create", memory + (-address) % _ALIGNMENT, size)
        if made == self._ffi.NULL:
            raise ControllerError(f"{self.folder}: no controller can be made of it; write the folder again")
        return memory, made

    def _collect(self, states: ArrayLike | None, data: Mapping[str, ArrayLike]) -> tuple[Array, int]:
        """Return rows of all data, and how many there are."""
        known = [field.name for field in self.manifest.data]
        for name in data:
            if name not in known:
                raise ControllerError(f"data: there is no {name!r}; there are {', '.join(known)}")
        nx, sizes = len(self.manifest.states), {field.name: field.size for field in self.manifest.data}
        given = {name: self._check_rows(name, values, sizes[name]) for name, values in data.items()}
        starts = None if states is None else self._check_rows("states", states, nx)
        counts = {name: len(x) for name, x in given.items()} | ({} if starts is None else {"states": len(starts)})
        if not counts:
            raise ControllerError("solve_batch: give states, or rows of data")
        if len(set(counts.values())) > 1:
            told = ", ".join(f"{name} {count}" for name, count in counts.items())
            raise ControllerError(f"solve_batch: the rows differ in number: {told}")
        count = next(iter(counts.values()))
        rows = np.hstack([given.get(name, np.tile(self.data[name].ravel(), (count, 1))) for name in known])
        if starts is not None:
            rows[:, :nx] = starts
        return np.ascontiguousarray(rows), count

    def _check_rows(self, name: str, values: ArrayLike, size: int) -> Array:
        try:
            array = np.array(values, dtype=np.float64)
        except (TypeError, ValueError):
            raise ControllerError(f"{name}: no array of numbers; give rows of {size}") from None
        if array.ndim < 2 or array[0:1].size != size * len(array[0:1]):
            raise ControllerError(f"{name} has shape {array.shape}; give rows of {size} numbers, one for each problem")
        return array.reshape(len(array), size)

    def _tag(self, declarations: str) -> str:
        """Return declarations of functions by their symbols in the library."""
        return re.sub(rf"\b{self._name}(?=_\w+\()", self.manifest.symbols, declarations)

    def _pass(self, array: Array) -> Any:
        return self._ffi.cast("double *", array.ctypes.data)

    def _check(self, name: str, values: ArrayLike, size: int) -> Array:
        try:
            array = np.array(values, dtype=np.float64)
        except (TypeError, ValueError):
            raise ControllerError(f"{name} {values!r} is no vector of numbers; give {size} numbers") from None
        if array.shape != (size,):
            raise ControllerError(f"{name} has shape {array.shape}; give {size} numbers")
        return array

    def _limit(self, **given: float | None) -> Any:
        """Return limits of a solve as a struct."""
        limits = self._ffi.new(f"{self._name}_limits *")
        for name, limit in given.items():
            if limit is not None and not limit > 0:
                raise ControllerError(f"{name} = {limit!r} is no limit; give a number above 0, or leave it out")
            setattr(limits, name, limit or 0)
        if given.get("seconds") is not None:
            limits.clock = self._clock
        return limits

    def _view(self) -> dict[str, Array]:
        data = self._call("get_data", self._controller)
        memory = np.frombuffer(self._ffi.buffer(self._memory), dtype=np.uint8)  # lives as long as its views
        views = {}
        for field in self.manifest.data:
            first = int(self._ffi.cast("char *", getattr(data, field.name)) - self._memory)
            array = memory[first : first + 8 * field.size].view(np.float64)
            views[field.name] = array.reshape(field.rows, -1) if field.rows else array
        return views

    def _name_status(self, found: Any) -> dict[str, Any]:
        message = self._ffi.string(self._call("explain", found.status)).decode()
        return {
            "status": self._statuses[found.status],
            "message": message,
            "stage": None if found.stage < 0 else found.stage,
        }

    def _describe_result(self) -> Result:
        found = self._call("get_result", self._controller)
        return Result(
            **self._name_status(found),
            iterations=found.iterations,
            cost=found.cost,
            violation=found.violation,
            stationarity=found.stationarity,
        )

    def _describe_step(self) -> Step:
        found = self._call("get_step", self._controller)
        return Step(
            **self._name_status(found),
            violation=found.violation,
            stationarity=found.stationarity,
            deviation=found.deviation,
            length=found.length,
        )


def controller(folder: str | Path) -> Controller:
    """Load a controller from a folder that `mbsrun controller PROBLEM -o DIR` wrote."""
    return Controller(folder)


def read_statuses(folder: Path) -> tuple[str, ...]:
    """Return the words of the solver's statuses, by their numbers in C, from the header in a controller's folder."""
    ffi = cffi.FFI()
    ffi.cdef(_declare(folder / "mbs_stages.h"))
    return _name_statuses(ffi)


def _name_statuses(ffi: Any) -> tuple[str, ...]:
    """Return the words of an enumeration, such as `time limit` for MBS_STAGES_TIME_LIMIT."""
    elements = ffi.typeof("mbs_stages_status").elements
    return tuple(elements[i].removeprefix("MBS_STAGES_").replace("_", " ").lower() for i in range(len(elements)))


def _declare(header: Path) -> str:
    """Return the declarations of a header: without comments, other headers, C++ and single precision."""
    try:
        text = _COMMENT.sub("", header.read_text(encoding="utf-8"))
    except OSError as error:
        raise ControllerError(f"{header}: {error.strerror}; write the folder again") from None
    kept: list[str] = []
    hidden: list[bool] = []  # of each condition that is open
    for line in text.splitlines():
        word = line.strip()
        if word.startswith("#if"):
            hidden.append(word.startswith("#ifdef"))  # nothing is defined
        elif word.startswith("#else"):
            hidden[-1] = not hidden[-1]
        elif word.startswith("#endif"):
            hidden.pop()
        elif not any(hidden) and (not word.startswith("#") or _NUMBER.fullmatch(word)):
            kept.append(line)
    return "\n".join(kept)
