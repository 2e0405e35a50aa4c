"""A problem and its model -> all files of a controller, which has solved the problem once.

The shipped problem is solved by the controller itself, as it will run: from the guess that it stores.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from mbsgen import resources
from mbsgen.errors import MbsError
from mbsgen.manifest import FILE_NAME, Kernel
from mbsgen.roles import QUICKEST, Role
from mbsrun import bare
from mbsrun.controllers import folder as folders
from mbsrun.controllers.emulation import emulate
from mbsrun.controllers.fields import find_sources, list_delays, list_inputs
from mbsrun.controllers.loading import Controller, Result
from mbsrun.controllers.refusals import find_refusals
from mbsrun.controllers.report import Figures, count_operations, measure_single, measure_stacks
from mbsrun.controllers.sources import merge, read_kernels, read_solver
from mbsrun.controllers.writing import Design, choose_barrier, name_functions, scale_cost, write_files
from mbsrun.external import Mechanism, OnDemand
from mbsrun.library import find_compiler
from mbsrun.models import Extent, find_folder, is_model
from mbsrun.ocp.evaluation.backends import numpy as functions
from mbsrun.ocp.evaluation.stages.building import build
from mbsrun.ocp.evaluation.stages.calls import name_called
from mbsrun.ocp.evaluation.stages.tables import KernelFunction, StageProgram
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.functions import Array, Formula, KernelResult
from mbsrun.ocp.ground.program import Program
from mbsrun.ocp.ground.trajectory import Trajectory, hold_numbers
from mbsrun.ocp.guessing.guess import Pose, adapt, make_guess
from mbsrun.ocp.guessing.sizes import size_added
from mbsrun.ocp.guessing.state_guess import complete
from mbsrun.ocp.problem.design import equip
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.problem.rewriting import hold_unknowns
from mbsrun.ocp.solution.solution import Failure
from mbsrun.ocp.solving.fixing import fix_numbers
from mbsrun.ocp.solving.preparation import settle
from mbsrun.ocp.solving.solve import Solver
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.ocp.transcription.scales import find_scales
from mbsrun.ocp.transcription.transcription import Transcription

Mask = NDArray[np.bool_]

PREDICTING = QUICKEST  # gives the accelerations of the model's own motion


class UnsolvedError(MbsError):
    """A problem of which no controller is written, since its own solve fails."""


@dataclass(frozen=True)
class Made:
    """The files of a controller, and how it solved its problem."""

    files: Mapping[str, str]
    manifest: folders.Manifest
    result: Result


def make(
    problem: Problem,
    plant: Mechanism | OnDemand,
    model: Path,
    guess: Trajectory | None = None,
    *,
    prefix: str | None = None,
    emulated: bool = False,
) -> Made:
    """Make a controller; `emulated`: run it on an emulated microcontroller too, for the report.

    `prefix`: names in C begin with it, in place of the problem's name. Raises ProblemError, UnsolvedError, the errors
    of generation and compilation, and BareError.
    """
    refusals = find_refusals(problem, plant.manifest)
    if refusals:
        raise ProblemError(problem.name, [(refusal.key, refusal.finding, refusal.remedy) for refusal in refusals])
    if emulated:
        bare.find_tools()
    problem_hash = hash_problem(problem)
    fixed = fix_numbers(problem, plant, guess)
    if isinstance(fixed, Failure):
        raise UnsolvedError(f"the unknown numbers of the mechanism are not found: {fixed.finding}; {fixed.remedy}")
    problem, plant, guess = hold_unknowns(fixed.problem), fixed.plant, fixed.guess  # stages share no numbers
    if guess is not None:
        unknowns = fixed.problem.unknowns
        is_known = guess.unknowns.size == len(unknowns)
        guess = hold_numbers(guess, guess.unknowns if is_known else np.array([x.guess for x in unknowns]))
    scheme = schemes.build(problem.family, problem.degree)
    start = make_guess(problem, plant, scheme) if guess is None else adapt(guess, problem, scheme)
    if isinstance(start, Pose):
        finding = f"no pose within the bounds meets the targets; the nearest one found is {start.distance:.3g} away"
        raise UnsolvedError(f"{finding}; move the target or widen the bounds")
    problem = settle(problem, plant, start)
    start = complete(start, problem, plant)
    transcription = Solver(problem, plant).transcription
    place, kernels = gather_kernels(transcription.program, plant, model)
    kernels = equip(kernels, problem)
    tables = build(
        transcription.program, kernels, np.array(problem.cost.weights) != 0, find_rows(transcription, problem)
    )
    usual = transcription.pack(size_added(start, problem, plant))
    scales = place_scales(transcription, tables, usual, problem)
    placed = place_guess(transcription, tables, start, plant)
    design = Design(
        name=choose_name(problem.name, kernels.manifest.prefix, prefix),
        version=kernels.manifest.generator.split()[-1],
        problem=problem,
        problem_hash=problem_hash,
        numbers=fixed.numbers,
        manifest=kernels.manifest,
        transcription=transcription,
        tables=tables,
        sources=find_sources(problem, transcription, tables, kernels),
        scales=scales,
        guess=placed,
        plan=placed,
        prediction=() if chooses_more(problem) else choose_prediction(kernels, tables),
    )
    used = read_kernels(place, kernels.manifest, list_kernels(design), design.kernel_symbols)
    copied = merge(read_solver(), used)
    with tempfile.TemporaryDirectory() as building:
        return _finish(design, copied, Path(building), emulated)


def chooses_more(problem: Problem) -> bool:
    """Return whether the motion of a problem depends on more than the mechanism and its inputs."""
    return bool(problem.states or problem.forces) or any(not x.is_auxiliary for x in problem.controls)


def _finish(design: Design, copied: Mapping[str, str], place: Path, emulated: bool) -> Made:
    """Compile the controller, complete its guess, solve, and write what became known."""
    compiler = find_compiler(os.environ)
    controller = _load(_assemble(design, copied, UNSOLVED), place)
    design = replace(design, guess=complete_guess(controller, design.tables, design.guess))
    controller = _load(_assemble(design, copied, UNSOLVED), place)
    result = controller.solve()
    if not result.is_solved:
        raise UnsolvedError(describe_failure(result))
    design = replace(design, plan=controller.variables.copy())
    single = measure_single(place, controller.manifest, compiler)
    figures = Figures(
        double=controller.bytes,
        single=single,
        stack=measure_stacks(place, controller.manifest, compiler),
        compiler=" ".join(compiler.command),
        iterations=result.iterations,
        cost=float(f"{result.cost:.7g}"),
        status=result.status,
        emulation=emulate(place, controller.manifest, single) if emulated else None,
    )
    return replace(_assemble(design, copied, figures), result=result)


def describe_failure(result: Result) -> str:
    """Return finding and remedy of a controller's own solve that failed."""
    at = "" if result.stage is None else f", at stage {result.stage} (from 0)"
    reason = result.message.rstrip(".")
    remedy = "take another guess, such as a solution by --guess, or see what `mbsrun solve` finds"
    if result.status == "infeasible":
        reason = "no motion near the guess meets all conditions"
        remedy = "`mbsrun solve --solver mbs` names the ones that clash: move a target, or widen bounds"
    count = f"{result.iterations} iterations"
    return f"the controller does not solve its own problem in {count}{at}: {reason}; {remedy}"


def _load(made: Made, place: Path) -> Controller:
    for name, text in made.files.items():
        (place / name).write_text(text, encoding="utf-8", newline="\n")
    return Controller(place)


def _assemble(design: Design, copied: Mapping[str, str], figures: Figures) -> Made:
    """Put all files together, with the manifest, the report and the files of builds."""
    from mbsgen.targets.c.symbols import seal
    from mbsgen.targets.layout import lay_out

    files, symbols = seal(merge(copied, write_files(design, figures.cost)), design.name)
    programs = {f"{design.name}_{program}.c" for program in ("main", "check")}
    sources = tuple(sorted(name for name in files if name.endswith(".c") and name not in programs))
    lists = lay_out("controller/CMakeLists.txt", name=design.name, version=design.version, sources=sources)
    files |= {"CMakeLists.txt": lists, REPORT: write_report(design, figures)}
    manifest = describe(design, symbols, sources, tuple(sorted((*files, FILE_NAME))), figures)
    return Made(files | {FILE_NAME: folders.write(manifest)}, manifest, UNKNOWN)


def write_report(design: Design, figures: Figures) -> str:
    """Write the report."""
    from mbsgen.targets.layout import lay_out

    tables, layout = design.tables, design.transcription.layout
    kinds = [tables.kinds[k] for k in tables.kind_of_stage]
    return lay_out(
        "controller/report.md",
        name=design.name,
        version=design.version,
        intervals=design.problem.intervals,
        stages=len(kinds),
        kinds=len(tables.kinds),
        states=layout.mesh.shape[1],
        inputs=len(list_inputs(design.problem, design.manifest)),
        variables=sum(kind.nx + kind.nv for kind in kinds),
        equations=sum(kind.ne for kind in kinds) + sum(kind.nx for kind in kinds[1:]),
        inequalities=sum(kind.ng for kind in kinds),
        data=design.sources.count,
        operations=count_operations(tables, design.manifest),
        figures=figures,
    )


REPORT = "report.md"
UNSOLVED = Figures(double=0, single=0, stack={}, compiler="", iterations=0, cost=0.0, status="")
UNKNOWN = Result("not prepared", "", None, 0, 0.0, 0.0, 0.0)


def describe(
    design: Design, symbols: str, sources: tuple[str, ...], files: tuple[str, ...], figures: Figures
) -> folders.Manifest:
    """Describe a controller."""
    manifest, layout = design.manifest, design.transcription.layout
    units = {c.name: c.unit for c in manifest.coordinates}
    velocities = [manifest.coordinates[i] for i in layout.motions.velocities]
    states = [folders.Quantity(name=name, unit=units.get(name, "")) for name in manifest.positions]
    states += [folders.Quantity(name=f"{c.name}'", unit=f"{c.unit}/s") for c in velocities]
    states += [folders.Quantity(name=state.name, unit="") for state in design.problem.states]
    data = [
        folders.Data(
            name=field.name,
            meaning=field.meaning,
            size=len(field.entries),
            rows=field.rows,
            entries=()
            if field.rows
            else tuple(
                folders.Entry(name=e.name, unit=e.unit, value=e.value if np.isfinite(e.value) else None, note=e.note)
                for e in field.entries
            ),
        )
        for field in design.sources.fields
    ]
    return folders.Manifest(
        format=folders.FORMAT,
        generator=manifest.generator,
        prefix=design.name,
        symbols=symbols,
        problem=design.problem.name,
        problem_hash=design.problem_hash,
        model=manifest.model,
        model_hash=manifest.model_hash,
        intervals=design.problem.intervals,
        horizon=None if layout.horizon is not None else design.problem.horizon,
        states=tuple(states),
        inputs=tuple(folders.Quantity(name=name, unit=unit) for name, unit in list_inputs(design.problem, manifest)),
        data=tuple(data),
        numbers=dict(design.numbers),
        delays=list_delays(design.problem),
        predicts=bool(design.prediction),
        cost=figures.cost,
        scale=scale_cost(design.problem),
        barrier=choose_barrier(design.problem, figures.cost),
        memory=folders.Memory(double=figures.double, single=figures.single),
        functions=tuple(name.replace(design.symbols, symbols) for name in name_functions(design)),
        sources=sources,
        files=files,
    )


# --- the problem ---------------------------------------------------------------------------------------------------


def choose_name(problem: str, model: str, prefix: str | None = None) -> str:
    """Return the name of a controller in C; no name of its model begins as it does. Raises OptionError for a prefix."""
    from mbsgen.targets.c.symbols import check_prefix
    from mbsgen.targets.names import mangle

    if prefix is not None:
        return check_prefix(prefix, model, _list_words())
    name = mangle(problem)
    return f"{name}_controller" if name == model or name in _list_words() else name


@cache
def _list_words() -> frozenset[str]:
    """List the words of the C around a controller, and of its headers, which cannot be the name of a type too."""
    texts = (path.read_text(encoding="utf-8") for path in (resources.folder("templates") / "controller").glob("*.c.j2"))
    code = (re.sub(r"/\*.*?\*/|\"[^\"\n]*\"|\{[{%].*?[}%]\}", " ", text, flags=re.DOTALL) for text in texts)
    return frozenset(_KEYWORDS.split()) | {word for text in code for word in re.findall(r"[A-Za-z]\w*", text)}


# Of C, and functions of its library that gcc knows, or that headers around controllers declare.
_KEYWORDS = """
auto break case char const continue default do double else enum extern float for goto if inline int long register
restrict return short signed sizeof static struct switch typedef union unsigned void volatile while bool true false
class delete new namespace operator private public template this throw try using virtual
abort abs acos asin atan atan2 atexit atof atoi bsearch calloc ceil clearerr cos cosh div exit exp fabs fclose feof
fflush floor fmod fopen fprintf fputs fread free frexp fscanf fseek ftell fwrite getc getchar getenv gets index labs
ldexp ldiv log log10 malloc memchr memcmp memcpy memmove memset modf perror pow printf putc putchar puts qsort raise
rand random realloc remove rename rewind rindex round scanf signal sin sinh size_t sprintf sqrt srand sscanf strcat
strcmp strcpy strlen system tan tanh tmpfile trunc ungetc
"""


def describe_name(made: Made) -> str:
    """Return a notice where the names in C do not begin with the problem's name; else an empty text."""
    from mbsgen.targets.c.symbols import describe_mangling

    return describe_mangling(made.manifest.problem, made.manifest.prefix)


def hash_problem(problem: Problem) -> str:
    """Return a hash of a problem's content, without threads, which change no number, and what a loop gives alone."""
    content = TypeAdapter(Problem).dump_python(
        problem, mode="json", exclude={"solver": {"threads": True}, "first_inputs": True, "first_controls": True}
    )
    text = json.dumps(content, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def find_rows(transcription: Transcription, problem: Problem) -> Mask:
    """Mark the rows of the program that have a bound, and all rows that a solver does not see."""
    program = transcription.program
    lower, upper = transcription.constraint_bounds(problem)
    rows = np.ones(program.constraints, dtype=bool)
    rows[program.kept_rows] = np.isfinite(lower) | np.isfinite(upper)
    return rows


def gather_kernels(program: Program, plant: Mechanism | OnDemand, model: Path) -> tuple[Path, Mechanism]:
    """Return one folder with all kernels of a program, and these; the model's own motion is among them if it can be."""
    if not is_model(model):
        return model, Mechanism(model)
    names = {name for block in (*program.blocks, *program.costs) for name in _list_kernels(block.function)}
    if not plant.manifest.loops:
        names.add(PREDICTING)
        if plant.manifest.quaternions:
            names.add("rates")
    place = find_folder(model, Extent(tuple(sorted(names))))
    return place, Mechanism(place)


def _list_kernels(function: Formula | KernelResult) -> set[str]:
    if isinstance(function, KernelResult):
        return {function.kernel}
    return {result.kernel for _, result in function.computed}


def list_kernels(design: Design) -> list[Kernel]:
    """List the kernels that a controller calls."""
    called = {name_called(f) for f in design.tables.functions if isinstance(f, KernelFunction)}
    found = [k for k in design.manifest.kernels if k.name in called or k in design.prediction]
    has_setup = any(a.role is Role.SETUP for k in found for a in k.inputs)
    return [*found, *([design.manifest.setup] if has_setup and design.manifest.setup else [])]


def choose_prediction(kernels: Mechanism, tables: StageProgram) -> tuple[Kernel, ...]:
    """Choose the kernels of the model's own motion: accelerations, and rates where there are quaternions."""
    manifest = kernels.manifest
    acceleration = manifest.find(PREDICTING)
    rates = manifest.find("rates")
    if manifest.loops or acceleration is None or (manifest.quaternions and rates is None):
        return ()
    found = (acceleration, *([rates] if manifest.quaternions and rates else []))
    needed = {a.name for kernel in found for a in kernel.inputs if a.role is Role.SETUP}
    return found if needed <= {part.name for part in tables.given} else ()


def place_guess(
    transcription: Transcription, tables: StageProgram, guess: Trajectory, plant: Mechanism | OnDemand
) -> Array:
    """Put a guess in the order of the tables; variables of these alone are 0, or combinations."""
    x = functions.build(transcription.program, plant).complete(transcription.pack(guess))
    return tables.place(x)


def place_scales(transcription: Transcription, tables: StageProgram, guess: Array, problem: Problem) -> Array:
    """Return the usual sizes of the variables of the tables, as `mbsrun solve` has them."""
    program = transcription.program
    scales = np.ones(program.variables)
    scales[program.kept] = find_scales(transcription, guess, transcription.variable_bounds(problem))
    return np.where(tables.variables < 0, 1.0, scales[tables.variables])


def complete_guess(controller: Controller, tables: StageProgram, guess: Array) -> Array:
    """Compute the variables of the tables alone, y = f(x, v), at a guess."""
    kinds = [tables.kinds[k] for k in tables.kind_of_stage]
    equations = np.cumsum([0, *(kind.ne for kind in kinds)])
    w = guess.copy()
    for _ in range(MOST_LIFTS):
        e = controller.find_equations(w, [kind.ne for kind in kinds])
        assert e.size == equations[-1], "equations of all stages"
        w[tables.lifted] -= e[tables.lifted_rows]
        if not np.abs(e[tables.lifted_rows]).max(initial=0.0) > 0:
            break
    return w


MOST_LIFTS = 10  # rounds: some of the variables read others
