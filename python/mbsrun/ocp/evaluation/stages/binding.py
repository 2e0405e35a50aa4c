"""Tables of stages in memory, as C evaluates and solves them: StageProgram and plant -> functions, and solves."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from mbsgen import resources
from mbsgen.errors import MbsError
from mbsrun.binding import Entry, bind, find_function
from mbsrun.kernel import Kernels
from mbsrun.library import compile_library, find_compiler
from mbsrun.many import Several
from mbsrun.ocp.evaluation.stages import formulas
from mbsrun.ocp.evaluation.stages.abreast import LANES, Abreast, find_repeated, is_independent, list_sizes
from mbsrun.ocp.evaluation.stages.calls import name_called
from mbsrun.ocp.evaluation.stages.interface import load
from mbsrun.ocp.evaluation.stages.tables import (
    FormulaFunction,
    KernelFunction,
    Kind,
    Nonzeros,
    Script,
    StageProgram,
    Step,
    Terms,
)
from mbsrun.ocp.evaluation.stages.threads import Team, make_memory
from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.ground.plant import Plant

INFINITE = 1e20
_NEVER = 1e300  # s
ROUNDING = 1e-8  # relative, by which a start may be beyond a bound; IPOPT relaxes all bounds by as much


class PlantError(MbsError):
    """Kernels that C cannot call."""


@dataclass(frozen=True)
class Lifted:
    """A stage with lifted variables: all of its variables, the lifted ones, and their equations in the stage."""

    number: int
    variables: Indices
    chosen: Indices
    equations: Indices


def list_lifted(data: StageProgram) -> tuple[Lifted, ...]:
    """List the stages with variables of the tables alone."""
    first, row, found = 0, 0, []
    for k, number in enumerate(data.kind_of_stage):
        kind = data.kinds[number]
        end, last = first + kind.nx + kind.nv, row + kind.ne
        chosen = data.lifted[(data.lifted >= first) & (data.lifted < end)]
        rows = data.lifted_rows[(data.lifted_rows >= row) & (data.lifted_rows < last)]
        if chosen.size:
            found.append(Lifted(k, np.arange(first, end), chosen, rows - row))
        first, row = end, last
    return tuple(found)


class Tables:
    """A program in stages in C's memory, which any number of solvers share."""

    def __init__(self, data: StageProgram, plant: Plant, others: tuple[Plant, ...] = ()) -> None:
        """Lay the tables, and load the functions; `others` are plants beside plant 0.

        Raises CompileError, PlantError.
        """
        self.data = data
        self.ffi, self.lib = load()
        self._kept: list[Any] = []
        self._plants = (plant, *others)
        self.needs = [0, 0]  # the most arguments and results of a call; kernels need no other memory
        kinds = self._keep(self.ffi.new("mbs_program_kind[]", len(data.kinds)))
        for target, kind in zip(kinds, data.kinds, strict=True):
            self._lay_kind(target, kind)
        functions = self._load_functions()
        program = self.program = self._keep(self.ffi.new("mbs_program *"))
        program.stages, program.kinds = len(data.kind_of_stage), len(data.kinds)
        program.kind_of_stage, program.kind = self._integers(data.kind_of_stage), kinds
        program.parameters = data.parameters + sum(part.size for part in data.given)
        program.numbers = data.numbers.shape[1]
        program.functions = functions
        program.arguments, program.results = self.needs
        self.sizes = self._keep(self.ffi.new("mbs_stages_size[]", program.stages))
        for k, number in enumerate(data.kind_of_stage):
            self.sizes[k] = kinds[number].size

    @cached_property
    def filled(self) -> Array:
        """The arguments that the plant fills."""
        parts = [np.zeros(0)]
        for given in self.data.given:
            parts.append(np.ravel(_find_kernels(self._plants[given.plant], given.kernel).filled[given.name]))
        return np.concatenate(parts)

    @cached_property
    def lifted(self) -> tuple[Lifted, ...]:
        """The stages with variables of the tables alone."""
        return list_lifted(self.data)

    # --- memory ---

    def _keep(self, value: Any) -> Any:
        self._kept.append(value)
        return value

    def _integers(self, values: Indices | Sequence[int]) -> Any:
        held = np.ascontiguousarray(values, dtype=np.intc)
        return self._keep(self.ffi.from_buffer("int[]", held)) if held.size else self.ffi.NULL

    def _numbers(self, values: Array) -> Any:
        held = np.ascontiguousarray(values, dtype=np.float64)
        return self._keep(self.ffi.from_buffer("double[]", held)) if held.size else self.ffi.NULL

    def _lay_kind(self, target: Any, kind: Kind) -> None:
        patterns = self._keep(self.ffi.new("mbs_stages_patterns *"))
        for name, pattern in (("de", kind.de), ("dd", kind.dd), ("dg", kind.dg), ("h", kind.hessian)):
            self._lay_pattern(getattr(patterns, name), pattern)
        size = target.size
        size.nx, size.nv, size.ne, size.ng, size.inner = kind.nx, kind.nv, kind.ne, kind.ng, kind.inner
        size.patterns = patterns
        for name, script in (("values", kind.values), ("jacobians", kind.jacobians), ("hessian", kind.second)):
            self._lay_script(getattr(target, name), script)

    def _lay_pattern(self, target: Any, pattern: Nonzeros) -> None:
        target.column = self._integers(np.searchsorted(pattern.col, np.arange(pattern.shape[1] + 1)))
        target.row = self._integers(pattern.row)

    def _lay_script(self, target: Any, script: Script) -> None:
        steps = self._keep(self.ffi.new("mbs_program_step[]", max(1, len(script.steps))))
        for step, given in zip(steps, script.steps, strict=False):
            self._lay_step(step, given)
        target.steps, target.step = len(script.steps), steps
        target.constants, target.start, target.size = script.start.size, self._numbers(script.start), script.size
        target.result = self._integers(script.results)

    def _lay_step(self, target: Any, step: Step) -> None:
        if step.terms is not None:
            self._lay_terms(target.terms, step.terms)
        if step.call is not None:
            call = self._keep(self.ffi.new("mbs_program_call *"))
            call.function = step.call.function
            call.arguments, call.argument = len(step.call.arguments), self._integers(step.call.arguments)
            call.results, call.result = len(step.call.results), self._integers(step.call.results)
            self.needs[0] = max(self.needs[0], call.arguments)
            self.needs[1] = max(self.needs[1], call.results)
            target.call = call

    def _lay_terms(self, target: Any, terms: Terms) -> None:
        target.count, target.coefficient = len(terms.to), self._numbers(terms.coefficient)
        target.to = self._integers(terms.to)
        setattr(target, "from", self._integers(terms.from_))
        if terms.by is not None:
            target.by = self._integers(terms.by)

    # --- functions ---

    def _load_functions(self) -> Any:
        """Compile all functions, and return pointers to them."""
        kernels = [f for f in self.data.functions if isinstance(f, KernelFunction)]
        texts = {
            f"mbs_formula_{i}": formulas.write(f.formula, f"mbs_formula_{i}", f.derivative)
            for i, f in enumerate(self.data.functions)
            if isinstance(f, FormulaFunction)
        }
        entries = self._entries = self._bind_kernels(kernels)
        written = self._compile_formulas(texts)
        pointers = self._keep(self.ffi.new("mbs_program_function[]", max(1, len(self.data.functions))))
        for i, function in enumerate(self.data.functions):
            if isinstance(function, KernelFunction):
                entry = entries[function]
                address = int(entry.ffi.cast("intptr_t", entry.function))
            else:
                address = written[f"mbs_formula_{i}"]
            pointers[i] = self.ffi.cast("mbs_program_function", address)
        return pointers

    def _bind_kernels(self, functions: Iterable[KernelFunction]) -> Mapping[KernelFunction, Entry]:
        """Compile kernels, all of one folder at once."""
        found: dict[KernelFunction, Entry] = {}
        folders: dict[int, tuple[Kernels, list[KernelFunction]]] = {}
        for function in functions:
            kernels = _find_kernels(self._plants[function.plant], function.kernel)
            folders.setdefault(id(kernels), (kernels, []))[1].append(function)
        for kernels, called in folders.values():
            library = kernels.compile(*map(name_called, called))
            found |= {one: self._keep(bind(library, kernels.describe(name_called(one)))) for one in called}
        return found

    @cached_property
    def abreast(self) -> Abreast | None:
        """The kernels that an interval's points call at once; None where there are no such, or no vectors."""
        scripts = [script for kind in self.data.kinds for script in kind.scripts]
        repeated = find_repeated(scripts)
        found: dict[int, tuple[Entry, Several]] = {}
        for number, function in enumerate(self.data.functions):
            if number not in repeated or not isinstance(function, KernelFunction):
                continue
            entry = self._entries[function]
            if not is_independent(scripts, number, list_sizes(entry)):
                continue
            kernels = _find_kernels(self._plants[function.plant], function.kernel)
            several = kernels.load_several(name_called(function), LANES)
            if several is not None:
                found[number] = entry, several
        return Abreast(self.ffi, found, len(self.data.functions)) if found else None

    def _compile_formulas(self, texts: Mapping[str, str]) -> Mapping[str, int]:
        if not texts:
            return {}
        files = {f"{name}.c": text for name, text in texts.items()}
        library = compile_library(
            resources.folder("csrc"), "mbs_formulas", files, find_compiler(os.environ), given=files
        )
        return {name: find_function(library, name) or 0 for name in texts}


def is_compiled(plant: Plant, name: str) -> bool:
    """Return whether a kernel is in C; a plant without coordinates needs none."""
    return not plant.manifest.coordinates or isinstance(plant.find_family(name), Kernels)


def _find_kernels(plant: Plant, name: str) -> Kernels:
    family = plant.find_family(name)
    if not isinstance(family, Kernels):
        raise PlantError(f"{name} of {plant.manifest.model} is not compiled; take kernels that mbsrun.load returns")
    return family


@dataclass(frozen=True)
class Numbers:
    """The numbers of a solve, in the program's order; bounds are infinite where there are none."""

    parameters: Array
    lower: Array  # of all variables of the program
    upper: Array
    least: Array  # of all rows of the program
    most: Array
    scales: Array | None = None  # usual sizes of all variables of the program; None: 1


@dataclass(frozen=True)
class Settings:
    """Options of the solver by the names of its C structure; others keep their defaults."""

    values: Mapping[str, float]
    seconds: float = 0.0  # a limit; 0: none


@dataclass(frozen=True)
class Progress:
    """An iterate."""

    iteration: int
    is_restoring: bool
    cost: float
    violation: float


Watch = Callable[[Progress], None]


@dataclass(frozen=True)
class Clash:
    """A row that stays violated."""

    stage: int
    kind: int  # 0: of e, 1: of d, 2: of g
    row: int


@dataclass(frozen=True, eq=False)
class Point:
    """An iterate of the solver with its multipliers, in the order of the tables."""

    w: Array  # variables
    below: Array  # multipliers of lower bounds of variables
    above: Array  # and of upper ones
    y: Array  # of rows: of each stage's equations, dynamics and inequalities

    @property
    def parts(self) -> tuple[Array, ...]:
        """Return the arrays."""
        return self.w, self.below, self.above, self.y

    def fits(self, other: Point) -> bool:
        """Return whether another point has as many numbers of each kind."""
        return all(own.size == x.size for own, x in zip(self.parts, other.parts, strict=True))


@dataclass(frozen=True)
class Outcome:
    """The result of a solve."""

    point: Point
    status: str  # of the C enumeration
    stage: int
    iterations: int
    evaluating: float  # s in functions and derivatives, of the thread that took most
    cpu_evaluating: float  # of all threads
    clashes: tuple[Clash, ...]

    @property
    def z(self) -> Array:
        """Return the multipliers of bounds of variables: of upper ones, less of lower ones."""
        return self.point.above - self.point.below


class Evaluator:
    """The functions of tables for given parameters, as C's callbacks compute them."""

    def __init__(self, tables: Tables, parameters: Array) -> None:
        """Make an instance."""
        self.tables, ffi, lib = tables, tables.ffi, tables.lib
        self.memory = make_memory(lib.mbs_program_bytes(tables.program))
        self.instance = lib.mbs_program_create(tables.program, ffi.cast("void *", self.memory.ctypes.data))
        self.parameters = np.concatenate((parameters, tables.filled, [0.0]))
        self.numbers = np.ascontiguousarray(np.append(tables.data.numbers.ravel(), 0.0))
        self.instance.parameters = ffi.from_buffer("double[]", self.parameters)
        self.instance.numbers = ffi.from_buffer("double[]", self.numbers)

    def rows(self, k: int) -> tuple[int, int, int]:
        """Count the rows of e, d and g of a stage."""
        data = self.tables.data
        kind = data.kinds[data.kind_of_stage[k]]
        last = k + 1 == len(data.kind_of_stage)
        return kind.ne, 0 if last else data.kinds[data.kind_of_stage[k + 1]].nx, kind.ng

    def values(self, k: int, xv: Array) -> tuple[float, Array, Array, Array] | None:
        """Return f, e, d and g of a stage; None where a function has no result."""
        found = [np.zeros(size) for size in (1, *self.rows(k))]
        if self.tables.lib.mbs_program_values(self.instance, k, *self._split(k, xv), *map(self._point, found)):
            return None
        return float(found[0][0]), found[1], found[2], found[3]

    def jacobians(self, k: int, xv: Array) -> tuple[Array, Array, Array, Array] | None:
        """Return df, and the nonzeros of de, dd and dg."""
        kind = self._kind(k)
        sizes = (kind.nx + kind.nv, kind.de.row.size, kind.dd.row.size, kind.dg.row.size)
        found = [np.zeros(size) for size in sizes]
        if self.tables.lib.mbs_program_jacobians(self.instance, k, *self._split(k, xv), *map(self._point, found)):
            return None
        return found[0], found[1], found[2], found[3]

    def hessian(self, k: int, xv: Array, factor: float, y: Array) -> Array | None:
        """Return the nonzeros of the Hessian; y are the multipliers of e, d and g."""
        found = np.zeros(self._kind(k).hessian.row.size)
        ye, yd, yg = np.split(np.ascontiguousarray(y), np.cumsum(self.rows(k))[:-1])
        given = (*self._split(k, xv), factor, *map(self._point, (ye, yd, yg)), self._point(found))
        return None if self.tables.lib.mbs_program_hessian(self.instance, k, *given) else found

    def _kind(self, k: int) -> Kind:
        return self.tables.data.kinds[self.tables.data.kind_of_stage[k]]

    def _split(self, k: int, xv: Array) -> tuple[Any, Any]:
        x = self._point(xv)
        return x, x + self._kind(k).nx

    def _point(self, a: Array) -> Any:
        return self.tables.ffi.cast("double *", a.ctypes.data)


class Solver:
    """A solver of tables for bounds of one structure: the same ones are equal."""

    def __init__(self, tables: Tables, threads: int = 1, *, has_lanes: bool = False) -> None:
        """Take the tables; memory follows with the first solve."""
        self._threads, self._has_lanes = threads, has_lanes
        self.tables, self.ffi, self.lib = tables, tables.ffi, tables.lib
        self._made: tuple[bytes, Workspace] | None = None
        self._options: tuple[Settings, Any] | None = None

    def solve(self, start: Array | Point, numbers: Numbers, settings: Settings, watch: Watch | None = None) -> Outcome:
        """Solve from the program's variables, or from a point; an exception in `watch` ends it, and is raised again."""
        memory = self._prepare(numbers)
        evaluator = memory.evaluator
        evaluator.parameters[: numbers.parameters.size] = numbers.parameters
        if isinstance(start, Point):
            for own, given in zip(memory.point.parts, start.parts, strict=True):
                own[:] = given
        else:
            memory.point.w[:] = fill(evaluator, start)
        options = self._write_options(settings)
        options.max_wall_time = settings.seconds or (0.0 if watch is None else _NEVER)
        # without a watch or a limit of time, C calls no Python, for which a thread would wait
        observer = _Observer(self.ffi, watch) if options.max_wall_time else None
        problem, nothing = memory.problem, self.ffi.NULL
        problem.watch = nothing if watch is None or observer is None else observer.watch
        problem.clock = nothing if observer is None else observer.clock
        with memory.team.at_work():
            result = self.lib.mbs_stages_solve(memory.solver, options)
        if observer is not None:
            observer.end()
        status = self.ffi.typeof("mbs_stages_status").elements[result.status]
        clashes = tuple(
            Clash(clash.stage, int(clash.kind), clash.row)
            for clash in (result.clash[i] for i in range(min(result.clashes, len(result.clash))))
        )
        seconds, stage = memory.team.seconds, result.stage
        point = Point(*(part.copy() for part in memory.point.parts))
        return Outcome(point, status, stage, result.iterations, *seconds, clashes)

    def _write_options(self, settings: Settings) -> Any:
        """Return the options in C's structure, which is written once for the same settings."""
        if self._options is None or self._options[0] is not settings:
            options = self.ffi.new("mbs_stages_options *", self.lib.mbs_stages_default_options())
            for name, value in settings.values.items():
                setattr(options, name, int(value) if isinstance(getattr(options, name), int) else value)
            self._options = settings, options
        return self._options[1]

    def _prepare(self, numbers: Numbers) -> Workspace:
        """Set the bounds; make the solver where other ones are equal than before."""
        data = self.tables.data
        bounds = set_bounds(data, numbers)
        key = b"".join((low == high).tobytes() for low, high in (bounds[:2], bounds[2:]))
        if self._made is None or self._made[0] != key:
            self._made = (
                key,
                Workspace(self.tables, numbers.parameters, bounds, self._threads, has_lanes=self._has_lanes),
            )
        memory = self._made[1]
        for held, given in zip(memory.bounds, bounds, strict=True):
            held[: given.size] = given
        if numbers.scales is not None:
            known = data.variables >= 0
            memory.scales[known.nonzero()[0]] = numbers.scales[data.variables[known]]
        return memory


def find_crossed(data: StageProgram, numbers: Numbers) -> tuple[int, ...]:
    """Return the rows of the program that give states of the start values beyond the bounds of these states."""
    variable, row = data.fixed.T
    bounded = data.bounded[variable]
    excess = np.maximum(numbers.least[row] - numbers.upper[bounded], numbers.lower[bounded] - numbers.most[row])
    return tuple(row[excess > ROUNDING * np.maximum(1.0, np.abs(numbers.least[row]))].tolist())


def set_bounds(data: StageProgram, numbers: Numbers) -> tuple[Array, Array, Array, Array]:
    """Return bounds of variables and of inequalities, in the order of the tables."""
    bounded, known = data.bounded, data.bounded >= 0
    lower, upper = np.full(bounded.size, -INFINITE), np.full(bounded.size, INFINITE)
    lower[known], upper[known] = numbers.lower[bounded[known]], numbers.upper[bounded[known]]
    variable, row = data.fixed.T
    lower[variable] = np.maximum(lower[variable], numbers.least[row])
    upper[variable] = np.minimum(upper[variable], numbers.most[row])
    upper = np.maximum(lower, upper)  # a start beyond a bound by rounding is on it
    of_program = data.rows_g >= 0
    least, most = (np.where(of_program, rows[data.rows_g], 0.0) for rows in (numbers.least, numbers.most))
    given = (lower, upper, least, most)
    lower, upper, least, most = (np.clip(part, -INFINITE, INFINITE) for part in given)
    return lower, upper, least, most


class Workspace:
    """The memory of one solver. With threads, it solves while its team is at work."""

    def __init__(
        self,
        tables: Tables,
        parameters: Array,
        bounds: tuple[Array, Array, Array, Array],
        threads: int = 1,
        *,
        has_lanes: bool = False,
    ) -> None:
        ffi, lib = tables.ffi, tables.lib
        self.evaluator = Evaluator(tables, parameters)
        self.bounds = [np.append(part, 0.0) for part in bounds]
        problem = self.problem = ffi.new("mbs_stages_problem *")
        problem.stages, problem.size = len(tables.data.kind_of_stage), tables.sizes
        self.team = Team(ffi, lib, self.evaluator.instance, threads, tables.abreast if has_lanes else None)
        problem.context, problem.team = self.team.contexts, self.team.c
        for name in ("values", "jacobians", "hessian"):
            setattr(problem, name, ffi.addressof(lib, f"mbs_timed_{name}"))
        for name, held in zip(("lower", "upper", "least", "most"), self.bounds, strict=True):
            setattr(problem, name, ffi.from_buffer("double[]", held))
        self.scales = np.ones(self.bounds[0].size)
        problem.scale = ffi.from_buffer("double[]", self.scales)
        size = lib.mbs_stages_bytes(problem)
        assert size, "the tables are a problem"
        self.memory = make_memory(size)
        self.solver = lib.mbs_stages_create(problem, ffi.cast("void *", self.memory.ctypes.data), size)
        point = lib.mbs_stages_iterate(self.solver)
        sizes = point.variables, point.variables, point.variables, point.rows
        pointers = point.w, point.below, point.above, point.y
        self.point = Point(
            *(
                np.frombuffer(ffi.buffer(part, 8 * size), dtype=np.float64)
                for part, size in zip(pointers, sizes, strict=True)
            )
        )


class _Observer:
    """Shows a watch every iterate; after an exception in it, time is over."""

    def __init__(self, ffi: Any, watch: Watch | None) -> None:
        self.error: BaseException | None = None

        def show(_: Any, progress: Any) -> None:
            if self.error is not None or watch is None:
                return
            try:
                watch(Progress(progress.iteration, bool(progress.restoring), progress.cost, progress.violation))
            except BaseException as error:
                self.error = error

        def read(_: Any) -> float:
            return time.perf_counter() if self.error is None else 2 * _NEVER

        self.watch = ffi.callback("void(void *, const mbs_stages_progress *)", show)
        self.clock = ffi.callback("double(void *)", read)

    def end(self) -> None:
        """Raise what the watch raised."""
        if self.error is not None:
            raise self.error


def fill(evaluator: Evaluator, x: Array) -> Array:
    """Return the variables of the tables from the program's; lifted ones y take the values of their equations.

    Combinations need no kernel, which could fail where they are 0. An equation y - f(x, y') = 0 may read others, which
    come first after at most as many passes as there are levels.
    """
    w = evaluator.tables.data.place(x)
    for stage in evaluator.tables.lifted:
        for _ in range(_LEVELS):
            values = evaluator.values(stage.number, w[stage.variables])
            if values is not None:
                w[stage.chosen] -= np.nan_to_num(values[1][stage.equations])
    return w


_LEVELS = 2  # combinations, and results of kernels of these
