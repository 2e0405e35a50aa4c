"""A controller as a folder of C: problem and plant -> tables, interface, kernels, formulas, solver; all one library.

`fields` finds the run-time data, `arrays` writes the tables, `sources` gathers the files that are copied. All names in
C begin with the controller's name, which is the problem's, mangled. No text of a problem file reaches a path.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mbsgen.manifest import Argument, Kernel, Manifest
from mbsgen.roles import Role
from mbsrun.controllers.arrays import Arrays, Wrap, repeat, split, write_kinds, write_real
from mbsrun.controllers.fields import (
    BEFORE,
    DESIGN,
    GIVEN,
    MASSES,
    NUMBERS,
    RATES_LOWER,
    RATES_UPPER,
    Sources,
    list_delays,
    list_histories,
    list_inputs,
)
from mbsrun.controllers.sources import PRIVATE, identify_solver, list_shared, name_kernel
from mbsrun.ocp.evaluation.stages import formulas
from mbsrun.ocp.evaluation.stages.calls import name_called
from mbsrun.ocp.evaluation.stages.tables import FormulaFunction, StageProgram
from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.methods import choose
from mbsrun.ocp.methods.stages import LANES
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.transcription.layout import Layout
from mbsrun.ocp.transcription.transcription import Transcription

METHOD = "mbs"  # of a problem file: the solver that controllers have
BARRIER = 3e-4  # of steps in real time, beside the optimum of the problem file: smaller ones diverge earlier


@dataclass(frozen=True)
class Design:
    """Everything that a controller is written from."""

    name: str  # in C
    version: str
    problem: Problem
    problem_hash: str
    numbers: Mapping[str, float]  # of the mechanism, which the problem chose
    manifest: Manifest  # of the kernels
    transcription: Transcription
    tables: StageProgram
    sources: Sources
    scales: Array  # usual sizes of all variables
    guess: Array
    plan: Array  # the optimum, once it is known
    prediction: tuple[Kernel, ...]  # kernels that give accelerations and rates; none: the model's own motion is unknown

    @property
    def symbols(self) -> str:
        """Return the beginning of all symbols, with the place of the tag."""
        from mbsgen.targets.c.symbols import tag

        return tag(self.name)

    @property
    def kernel_symbols(self) -> str:
        """Return the beginning of the symbols of kernels."""
        return f"{self.symbols}_{self.manifest.prefix}"


@dataclass(frozen=True)
class _Group:
    """Names of entries, for an enumeration."""

    name: str
    meaning: str
    names: tuple[str, ...]
    size: int = 0
    place: int = 0


@dataclass(frozen=True)
class _Given:
    """A part of the parameters that the model's parameters give."""

    is_setup: bool
    to: int
    from_: int
    size: int


@dataclass(frozen=True)
class _Call:
    """A call of a kernel for the model's own motion."""

    function: str
    arguments: tuple[str, ...]
    results: int
    result: int
    to: int


@dataclass(frozen=True)
class _Option:
    """An option of the solver that the problem file sets."""

    name: str
    value: str
    is_tolerance: bool


@dataclass(frozen=True)
class _History:
    """The memory of the commands of an input: places among the numbers of a controller."""

    place: int  # of the oldest one
    second: int
    last: int  # of the latest one
    kept: int  # how many move up
    given: int  # of the one that was given since


@dataclass(frozen=True)
class _Limit:
    """A bound of a rate from the command before to the one that is chosen now, as a bound of a variable.

    A step in real time keeps bounds of variables exactly, and rows of the problem only as far as they are linear.
    """

    variable: int  # among all
    before: int  # a place among the numbers, as the next two
    lower: int
    upper: int


@dataclass(frozen=True)
class _Histories:
    """The memory of commands."""

    inputs: tuple[_History, ...]
    limits: tuple[_Limit, ...]
    given: int  # where the inputs that were given lie among the numbers
    acting: tuple[int, ...]  # the stage at which each input acts that is given now; empty: the first


@dataclass(frozen=True)
class _Prediction:
    """How rates of a state begin."""

    positions: int
    copies_velocities: bool


def write_files(design: Design, cost: float) -> dict[str, str]:
    """Write the files that are the controller's own; `cost` is the optimum that its check expects."""
    from mbsgen.targets.c.symbols import OPEN
    from mbsgen.targets.entries import identify
    from mbsgen.targets.layout import lay_out
    from mbsgen.targets.statements import wrap

    name, sources, tables, problem = design.name, design.sources, design.tables, design.problem
    layout, manifest = design.transcription.layout, design.manifest
    velocities = [manifest.coordinates[i].name for i in layout.motions.velocities]
    states = [f"q_{x}" for x in identify(manifest.positions)] + [f"qd_{x}" for x in identify(velocities)]
    states += [f"s_{x}" for x in identify([state.name for state in problem.states])]
    inputs = identify([name for name, _ in list_inputs(problem, manifest)])
    fields = [
        _Group(
            field.name,
            field.meaning,
            () if field.rows else tuple(identify([entry.name for entry in field.entries])),
            len(field.entries),
            sources.place(field.name),
        )
        for field in sources.fields
    ]
    first = tables.kinds[tables.kind_of_stage[0]]
    given = tuple(_list_given(design))
    histories = _describe_histories(design)
    common = {
        "name": name,
        "prefix": name,
        "own": design.symbols,
        "open": OPEN,
        "private": PRIVATE,
        "solver": identify_solver(),
        "version": design.version,
        "problem_hash": design.problem_hash,
        "model_hash": manifest.model_hash,
        "intervals": design.problem.intervals,
        "states": _Group("STATE", "a state", tuple(states)),
        "inputs": _Group("INPUT", "the inputs", tuple(inputs)),
        "fields": fields,
        "data": design.sources.count,
        "predicts": _Prediction(layout.nq, len(design.prediction) == 1) if design.prediction else None,
        "is_late": histories is not None and bool(histories.acting),
        "histories": histories,
        "acting": ", ".join(
            str(_place_input(design, i, stage)) for i, stage in enumerate(histories.acting if histories else ())
        ),
        "scale": write_real(scale_cost(design.problem)),
        "share": f"{BARRIER:g}",
        "barrier": write_real(choose_barrier(design.problem, cost)),
        "weights": len(design.problem.cost.weights),
        "parameters": tables.parameters,
        "all_parameters": tables.parameters + sum(part.size for part in tables.given),
        "first_states": first.nx,
        "first_variables": first.nx + first.nv,
    }
    setup = manifest.setup if any(part.is_setup for part in given) else None
    parts = {
        f"{name}.h": lay_out("controller/controller.h", **common),
        f"{name}.c": lay_out(
            "controller/controller.c",
            given=given,
            setup=_call_kernel(setup, design) if setup else "",
            setup_arguments=len(setup.inputs) if setup else 0,
            setup_place=_find_place(setup, Role.PARAMETER),
            masses=sources.place(MASSES) if setup else 0,
            options=tuple(_list_options(problem)),
            predicted=[_write_call(kernel, design, given) for kernel in design.prediction],
            stage_numbers_from=sources.place(NUMBERS) if tables.numbers.shape[1] else 0,
            has_free_horizon=layout.horizon is not None,
            horizon=write_real(design.problem.horizon),
            **common,
        ),
        f"{name}_main.c": lay_out("controller/main.c", stride=max(1, design.problem.intervals // 10), **common),
        f"{name}_check.c": lay_out("controller/check.c", cost=f"{cost:.7g}", **common),
        f"{name}_guess.c": lay_out(
            "controller/guess.c",
            guess=wrap(map(write_real, design.guess)),
            plan=wrap(write_short(x) for x in design.plan),
            **common,
        ),
        f"{name}.pc": lay_out("controller/controller.pc", **common),
    }
    parts |= {**_write_tables(design, common, wrap), **write_formulas(design)}
    symbols = tag_names(_list_declared(name, parts), name, design.symbols)
    return {
        **parts,
        f"{name}_symbols.h": lay_out("c/symbols.h", symbols=symbols, **common),
        PRIVATE: lay_out("c/private.h", shared=list_shared(), macro="MBS_STAGES_NAME", **common),
    }


def _describe_histories(design: Design) -> _Histories | None:
    """Describe the memory of commands; None where there is none."""
    histories, sources = list_histories(design.problem), design.sources
    if not histories:
        return None
    before, given = sources.place(BEFORE), sources.place(GIVEN)
    rated = [x.input for x in histories if x.is_rated]
    inputs, limits = [], []
    for history in histories:
        last = before + history.count - 1
        inputs.append(_History(before, before + 1, last, history.count - 1, given + history.place))
        if history.is_rated:
            k = rated.index(history.input)
            lower, upper = (sources.place(name) + k for name in (RATES_LOWER, RATES_UPPER))
            limits.append(_Limit(_place_input(design, history.place, history.delay), last, lower, upper))
        before += history.count
    return _Histories(tuple(inputs), tuple(limits), given, list_delays(design.problem))


def _call_kernel(kernel: Kernel, design: Design) -> str:
    """Write the symbol of a kernel in C."""
    return _call_function(name_kernel(kernel, design.manifest, design.kernel_symbols), design)


def _call_function(symbol: str, design: Design) -> str:
    """Write the symbol of a kernel or a formula in C: the precision stands where its own file has it."""
    from mbsgen.targets.c.symbols import write_own

    end = design.kernel_symbols if design.kernel_symbols in symbol else design.symbols
    return write_own(symbol, end, "MBS_STAGES_OWN")


def tag_names(texts: Sequence[str], name: str, tagged: str) -> list[tuple[str, str]]:
    """Return names that begin with a controller's, each with its name in the object files."""
    from mbsgen.targets.c.symbols import write_own

    return [(text, write_own(tagged + text.removeprefix(name), tagged, "MBS_STAGES_NAME")) for text in texts]


def _list_declared(name: str, parts: Mapping[str, str]) -> tuple[str, ...]:
    from mbsgen.targets.c.symbols import find_declared

    return find_declared(name, (parts[f"{name}.h"], parts[f"{name}_tables.h"]))


def _list_options(problem: Problem) -> Iterator[_Option]:
    """List the options of the solver as `mbsrun solve` sets them; a limit of time is the caller's, with a clock."""
    solver = problem.solver
    given: dict[str, float | int | str] = {
        "tol": solver.tolerance,
        "acceptable_tol": max(solver.tolerance, 1e-6),
        "max_iter": solver.max_iterations,
    }
    if choose(solver) == METHOD:
        given |= {name: value for name, value in solver.options if name not in ("max_wall_time", LANES)}
    switches = {"yes": "1", "no": "0"}
    for name, value in given.items():
        yield _Option(name, switches.get(str(value), repr(value)), name.endswith("tol"))


def scale_cost(problem: Problem) -> float:
    """Return the factor of the cost, as `mbsrun solve` has it."""
    return problem.solver.objective_scaling or 1 / max(map(abs, problem.cost.weights))


def choose_barrier(problem: Problem, cost: float, share: float = BARRIER) -> float:
    """Return a barrier parameter for the solver, which minimises the scaled cost; 0 where the optimum is 0."""
    return float(f"{share * scale_cost(problem) * abs(cost):.6g}")


def write_short(x: float) -> str:
    """Write a number of the stored plan: rounded, so that roundings of machines do not show."""
    return write_real(float(f"{x:.5g}"))


def write_formulas(design: Design) -> dict[str, str]:
    """Write the functions that are made of expressions."""
    from mbsgen.targets.c.symbols import write_own

    return {
        f"{design.name}_formula{k}.c": formulas.write(function.formula, name, function.derivative).replace(
            f"int {name}(", f"int {write_own(name, design.symbols)}("
        )
        for k, (function, name) in enumerate(zip(design.tables.functions, name_functions(design), strict=True))
        if isinstance(function, FormulaFunction)
    }


def name_functions(design: Design) -> tuple[str, ...]:
    """Name the functions of the tables in C."""
    return tuple(
        f"{design.symbols}_formula{k}"
        if isinstance(function, FormulaFunction)
        else name_kernel(design.manifest.kernel(name_called(function)), design.manifest, design.kernel_symbols)
        for k, function in enumerate(design.tables.functions)
    )


# --- tables --------------------------------------------------------------------------------------------------------


def _write_tables(design: Design, common: Mapping[str, object], wrap: Wrap) -> dict[str, str]:
    from mbsgen.targets.layout import lay_out

    tables, sources, name = design.tables, design.sources, design.name
    arrays = Arrays(name, wrap)
    written = write_kinds(tables, arrays)
    kinds = [tables.kinds[k] for k in tables.kind_of_stage]
    counts, rows = [kind.nx + kind.nv for kind in kinds], [kind.ng for kind in kinds]
    ends = [
        *(split(part, counts) for part in (sources.lower, sources.upper)),
        *(split(part, rows) for part in (sources.least, sources.most)),
    ]
    bounds = repeat([np.concatenate(parts) for parts in zip(*ends, strict=True)], arrays)
    shapes = {number: (counts[k], rows[k]) for k, number in enumerate(bounds.of_stage)}
    places, place_of_stage = _find_places(design, counts, arrays)
    functions = [_call_function(name, design) for name in name_functions(design)]
    values = [design.sources.values[part] for part in (sources.lower, sources.upper, sources.least, sources.most)]
    lower, upper, least, most = (wrap(map(write_real, part)) if part.size else ("0",) for part in values)
    calls = [
        step.call for kind in tables.kinds for script in kind.scripts for step in script.steps if step.call is not None
    ]
    view = {
        **common,
        "numbers": sources.values.size,
        "data": sources.count,
        "variables": sum(counts),
        "inequalities": sum(rows),
        "functions": functions,
        "functions_lines": wrap(functions) if functions else ("NULL",),
        "arrays": arrays.declared,
        "kinds": written.kinds,
        "kind_of_stage": wrap(map(str, tables.kind_of_stage)),
        "stages": len(kinds),
        "stage_numbers": tables.numbers.shape[1],
        "most_arguments": max((len(call.arguments) for call in calls), default=0),
        "most_results": max((len(call.results) for call in calls), default=0),
        "work_integers": 0,
        "work_reals": 0,
        "sizes": [written.sizes[k] for k in tables.kind_of_stage],
        "lower": lower,
        "upper": upper,
        "least": least,
        "most": most,
        "scales": wrap(map(write_real, design.scales)) if (design.scales != 1).any() else (),
        "values": wrap(map(write_real, sources.values)),
        "parameter_from": wrap(map(str, sources.parameters)) if sources.parameters.size else ("0",),
        "bounds": [f"{shapes[i][0]}, {shapes[i][1]}, {array}" for i, array in enumerate(bounds.names)],
        "bound_of_stage": wrap(map(str, bounds.of_stage)),
        "places": places,
        "place_of_stage": wrap(map(str, place_of_stage)),
    }
    return {
        f"{name}_tables.h": lay_out("controller/tables.h", **view),
        f"{name}_tables.c": lay_out("controller/tables.c", **view),
    }


def _find_places(design: Design, counts: Sequence[int], arrays: Arrays) -> tuple[list[str], list[int]]:
    """Find where states and inputs are among the variables of each stage."""
    layout, added = design.transcription.layout, len(design.problem.states)
    every = np.concatenate((layout.mesh, layout.extras.states[:, :added]), axis=1)
    chosen, rows = _list_chosen(layout), []
    for k, variables in enumerate(split(design.tables.variables, counts)):
        place: dict[int, int] = {}
        for i, variable in enumerate(variables):
            place.setdefault(int(variable), i)
        state = arrays.integers(place[int(i)] for i in every[k])
        inputs = arrays.integers(place[int(i)] for i in chosen[k]) if k < len(chosen) else "NULL"
        horizon = -1 if layout.horizon is None else place[layout.horizon]
        rows.append(f"{state}, {inputs}, {horizon}")
    different = list(dict.fromkeys(rows))
    return different, [different.index(row) for row in rows]


def _list_chosen(layout: Layout) -> Indices:
    """List the variables (N, inputs) that a controller chooses, as `list_inputs` names them."""
    return np.concatenate((layout.inputs, layout.extras.controls), axis=1)


def _place_input(design: Design, i: int, stage: int) -> int:
    """Find where an input of a stage is among all variables."""
    variable = _list_chosen(design.transcription.layout)[stage, i]
    return int(np.flatnonzero(design.tables.variables == variable)[0])


# --- the model's own parameters and motion -------------------------------------------------------------------------


def _list_given(design: Design) -> Iterator[_Given]:
    """List the parts of the parameters that follow from the model's."""
    to = design.tables.parameters
    for part in design.tables.given:
        argument = next(a for a in design.manifest.kernel(part.kernel).inputs if a.name == part.name)
        is_setup = argument.role is Role.SETUP
        field = {Role.SETUP: MASSES, Role.PARAMETER: MASSES, Role.DESIGN: DESIGN}[argument.role]
        yield _Given(is_setup, to, design.sources.place(field), part.size)
        to += part.size


def _find_place(kernel: Kernel | None, role: Role) -> int:
    return next((k for k, a in enumerate(kernel.inputs) if a.role is role), 0) if kernel else 0


def _write_call(kernel: Kernel, design: Design, given: Sequence[_Given]) -> _Call:
    """Write the call of a kernel that gives accelerations, or rates of coordinates."""
    role = Role.ACCELERATION if kernel.giving(Role.ACCELERATION) else Role.RATE
    nq = design.transcription.layout.nq
    hidden = next((part for part in given if part.is_setup), None)

    def write(argument: Argument) -> str:
        texts = {
            Role.COORDINATE: "state",
            Role.VELOCITY: f"state + {nq}",
            Role.FORCE: "inputs",
            Role.SETUP: "NULL" if hidden is None else f"c->parameters + {hidden.to}",
        }
        if argument.role is Role.DESIGN:
            return f"c->numbers + {design.sources.place(DESIGN)}"
        return texts.get(argument.role, "NULL")

    result = next(k for k, a in enumerate(kernel.outputs) if a.role is role)
    to = nq if role is Role.ACCELERATION else 0
    return _Call(_call_kernel(kernel, design), tuple(map(write, kernel.inputs)), len(kernel.outputs), result, to)
