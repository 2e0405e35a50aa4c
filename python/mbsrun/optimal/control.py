"""Problems of optimal control in Python: values and names, with the keys and the checks of a problem file."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, overload

import casadi as ca

from mbsgen.documents import Data, abbreviate, read_document
from mbsgen.errors import Fault, InputError
from mbsrun.kernel import is_count
from mbsrun.ocp.cases.cases import AnyCase, Case, Outcome
from mbsrun.ocp.cases.programs import Programs
from mbsrun.ocp.ground.no_mechanism import NO_MECHANISM
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.recorded import find_guess
from mbsrun.ocp.optima.family import make_family
from mbsrun.ocp.problem.phases import PhasedProblem, Plants, list_one
from mbsrun.ocp.problem.problem import Problem, Symbolic
from mbsrun.ocp.searching.multistart import Wish, solve_from_many
from mbsrun.ocp.searching.refinement import refine
from mbsrun.ocp.solution.phases import Guess, list_solution
from mbsrun.ocp.solution.solution import Failure, Run, Starts, read_guess, read_solution
from mbsrun.ocp.solving.resimulation import resimulate
from mbsrun.ocp.solving.runs import Watch
from mbsrun.ocp.solving.solve import read_one, solve
from mbsrun.ocp.statement import statement
from mbsrun.ocp.statement.checks import ProblemError, check_problem
from mbsrun.ocp.statement.phases import has_phases, read_phased_problem
from mbsrun.optimal import display
from mbsrun.optimal.continuation import Continued, Stop, follow
from mbsrun.optimal.derivatives import Derivatives, differentiate_solution
from mbsrun.optimal.describing import describe_problem
from mbsrun.optimal.expressions import Expressions, Stretch, check_stretch
from mbsrun.optimal.guessing import GuessLike, read_motion
from mbsrun.optimal.layers import Differentiable, check_reads
from mbsrun.optimal.many import Family, Over, Show, SolvedMany, Way, list_cases, solve_family
from mbsrun.optimal.naming import Numbered, Source, list_left_out
from mbsrun.optimal.phases import PhasedControl, load, make_phases
from mbsrun.optimal.plain import make_plain, merge
from mbsrun.optimal.progress import show_progress
from mbsrun.optimal.quantities import Quantities
from mbsrun.optimal.result import Solved, Unsolved
from mbsrun.optimal.scenarios import name_scenarios, state_scenarios
from mbsrun.quantities import list_quantities
from mbsrun.recordings import references

DEFAULTS: Mapping[str, Data] = {"cost": {}, "start": {"pose": {}}}  # of problems in Python; a file states these itself


@dataclass(frozen=True, eq=False, repr=False)
class OptimalControl(Numbered):
    """A problem and its model. It does not change: `with_...` returns a changed copy.

    Programs are built once for all copies of one structure, so another start, target, bound, weight or constant costs
    no other build.
    """

    value: Problem  # with indices in place of names
    plant: Plant
    data: Mapping[str, Data]  # as a problem file holds it
    folder: Path  # that files of the problem are relative to
    programs: Programs
    model: Path | None = None  # the file of the model; None where kernels were given
    expressions: Expressions = field(default_factory=Expressions)  # in CasADi

    @property
    def functions(self) -> tuple[Symbolic, ...]:
        """List the expressions in CasADi."""
        return self.expressions.functions

    @property
    def name(self) -> str:
        """Return the name, which pictures and files show."""
        return self.value.name

    # --- copies with changes ---

    def with_changes(self, **changes: Any) -> OptimalControl:
        """Return a copy with other values of some keys of a problem file.

        Mappings are merged, at any depth; lists and numbers are replaced; None drops a key of the problem, which has
        its default then. Raises ProblemError with every fault of the result.
        """
        return self._restate(merge(self.data, make_plain(self.name, changes)))

    def with_target(self, sensor: str, **position: Any) -> OptimalControl:
        """Return a copy with another target of a sensor at the end: x, y, z, or radius, azimuth, height."""
        end = dict(_take_mapping(self.data, "end"))
        sensors = dict(_take_mapping(end, "sensors"))
        sensors[sensor] = make_plain(self.name, position)
        return self._restate({**self.data, "end": {**end, "sensors": sensors}})

    def with_constants(self, **constants: Any) -> OptimalControl:
        """Return a copy with other values of constants."""
        return self.with_changes(constants=constants)

    def with_solver(self, method: str, **settings: Any) -> OptimalControl:
        """Return a copy for another NLP method, with its tolerance, max_iterations and options."""
        solver = {"method": method, **make_plain(self.name, settings)}
        return self._restate({**self.data, "solver": solver})

    def with_cost(self, expression: Any, weight: Any = 1.0, *, at: Stretch = "path", name: str = "") -> OptimalControl:
        """Return a copy with another term of the cost: an integral over the horizon, or a value at the end.

        The expression is a text as in a problem file, or CasADi's in symbols of `quantities()`. As in a file, inputs
        cost nothing beside other terms unless `cost.inputs` gives a weight. Raises ProblemError.
        """
        check_stretch(at, self.name)
        if isinstance(expression, str):
            cost = dict(_take_mapping(self.data, "cost"))
            key = {"path": "running", "end": "terminal"}[at]
            added = make_plain(self.name, {"expression": expression, "weight": weight})
            cost[key] = [*_take_list(cost, key), added]
            return self._restate({**self.data, "cost": cost})
        return self._restate(expressions=self.expressions.with_cost(expression, weight, at, name, self.name))

    def with_constraint(
        self,
        expression: Any,
        lower: Any = -math.inf,
        upper: Any = math.inf,
        *,
        at: Literal["start", "path", "end"] = "path",
        name: str = "",
        soft: Any = None,
    ) -> OptimalControl:
        """Return a copy with another constraint: lower <= expression <= upper along the path, or at its start or end.

        The expression is a text as in a problem file, or CasADi's in symbols of `quantities()`, where each entry is a
        constraint; limits are numbers, or one for each entry. `soft` is the price of violating a text, as in a file.
        Raises ProblemError.
        """
        if isinstance(expression, str):
            limits = make_plain(self.name, {"range": [lower, upper]})["range"]
            added: dict[str, Data] = {"expression": expression, "range": limits, "at": at}
            if soft is not None:
                added |= make_plain(self.name, {"soft": soft})
            return self._restate({**self.data, "constraints": [*_take_list(self.data, "constraints"), added]})
        if soft is not None:
            remedy = "write the constraint as a text, or with a control that is its slack"
            raise ProblemError(self.name, [("constraint", "a soft expression of CasADi", remedy)])
        expressions = self.expressions.with_constraint(expression, lower, upper, at, name, self.name)
        return self._restate(expressions=expressions)

    def quantities(self, symbols: type[Any] = ca.SX) -> Quantities:
        """Return the quantities of the problem as CasADi symbols by name, for `with_cost` and `with_constraint`.

        `symbols` is casadi.SX; or casadi.MX, for expressions that call functions of CasADi.
        """
        manifest = self.plant.manifest
        known = list_quantities(manifest, self.value.added)
        constants = _take_mapping(self.data, "constants")
        numbers = (*constants, *references.list_names(self.value.references))
        return Quantities(manifest, known, numbers, self.model, dict(self.value.parameters), symbols)

    def _restate(self, data: Mapping[str, Data] | None = None, **changes: Any) -> OptimalControl:
        """Return a copy with other data or expressions, checked."""
        copy = replace(self, data=self.data if data is None else data, **changes)
        own = copy.expressions
        data = _drop_no_cost(copy.data) if own.terms else copy.data
        value = statement.state_problem(data, self.name, self.plant, self.folder, own.reads)
        if copy.functions:
            value = own.extend(value, prices_inputs=bool(_take_mapping(copy.data, "cost").get("inputs")))
            check_problem(value, self.plant.manifest)
        return replace(copy, value=value)

    # --- solving ---

    def solve(
        self,
        *,
        watch: Watch | bool = False,
        guess: GuessLike | None = None,
        check: bool = True,
    ) -> Solved | Unsolved:
        """Solve the problem, re-simulate the solution, and refine its grid if the problem asks for that.

        Without `check` the solution is neither re-simulated nor refined.

        `watch` is called in every iteration; True shows the iterations, in a notebook or on a terminal. `guess` is a
        solution, a file of one or of a recorded motion, arrays by name with the times `t`, a pandas frame, or a
        trajectory, on any grid; by default the problem's own. A solve without a solution is no exception: it returns an
        Unsolved. Raises ProblemError with every fault of the problem, InputError for a file that is no guess.
        """
        with show_progress() if watch is True else nullcontext(watch or None) as shown:
            start = self._find_guess(guess)
            outcome = solve(self.value, self.plant, shown, start, self.programs.find)
            if isinstance(outcome, Failure):
                return Unsolved(outcome)
            if check:
                outcome = resimulate(outcome, self.plant)
            if check and self.value.refine is not None:
                outcome = refine(outcome, self.plant, watch=shown)
        return Solved(outcome, self.plant)

    def solve_many(
        self,
        over: Over,
        *,
        guesses: Sequence[GuessLike | None] | None = None,
        threads: int = 1,
        neighbours: bool = False,
        watch: Show | None = None,
        check: bool = True,
    ) -> SolvedMany:
        """Solve the problem for many values of its keys, each from its own guess, with one program; see `solve`.

        `over` has a list of values for each key, all of one length, or is a list of mappings, one for each case. Keys
        are paths as in a problem file: `end.pose.cart`, `constants.k`, `parameters.l`, `constraints[0].range`. No
        result depends on other cases, nor on `threads`; a case without a solution is an Unsolved. `watch` sees the
        number and the outcome of each case as it ends. Raises ProblemError with the faults of the first cases.

        With `neighbours`, cases start from the solutions of cases nearby, in an order that depends on the set of cases
        alone; one that is not solved soon from there starts from its own guess. Where a problem has several minima, a
        case may end in another one.
        """
        return solve_family(self.family, over, guesses, Way(threads, neighbours, check), watch)

    def with_scenarios(self, over: Over) -> PhasedControl:
        """Return the problem of several scenarios that begin with the same inputs, for control that is robust.

        `over` has the values of keys in each scenario, as for `solve_many`. The cost is the sum of all costs. The first
        inputs, and controls, are unknowns `first_u_NAME`; each scenario goes on with its own. The solution of the first
        one is `solution["scenario0"]`. Raises ProblemError.
        """
        data, folder = dict(self.data), self.folder
        if "model" not in data and self.model is not None:
            data["model"], folder = str(self.model), Path()
        elif "model" not in data and self.plant is not NO_MECHANISM:
            remedy = "give the file of the model to `problem`"
            raise ProblemError(self.name, [("model", "loaded kernels, for a problem of scenarios", remedy)])
        stated = state_scenarios(self.name, data, self.value, self.plant.manifest, over)
        names = name_scenarios(len(list_cases(self.name, over)))
        return make_phases(stated, self.name, folder, dict.fromkeys(names, self.expressions) if self.functions else {})

    @property
    def family(self) -> Family:
        """Return how the problem becomes cases with other values of its keys."""

        def state(copy: OptimalControl, guess: GuessLike | None, check: bool) -> Case:
            start = copy._find_guess(guess)
            return Case(list_one(copy.value), None if start is None else Guess((start,)), check)

        def read(_: AnyCase, outcome: Outcome) -> Solved | Unsolved:
            found = read_one(outcome)
            return Unsolved(found) if isinstance(found, Failure) else Solved(found, self.plant)

        return Family(self.name, self.data, Plants((self.plant,)), self._restate, state, read, self.programs)

    def search(
        self,
        starts: int,
        *,
        seed: int = 0,
        hops: int = 0,
        minutes: float = math.inf,
        workers: int = 0,
        record: str | Path | None = None,
        watch: Callable[[Starts], None] | None = None,
    ) -> Solved | Unsolved:
        """Solve the problem from many starts; return the best solution, re-simulated, and refined if the problem asks.

        The arguments are the options of `mbsrun solve --starts`; `record` is the file that keeps every start, and
        `watch` sees the results so far. The solution's summary shows how often its cost was found. Raises ProblemError
        for expressions in CasADi with workers or a record, which know a problem by its file.
        """
        if self.functions and (workers or record is not None):
            finding = "the problem has expressions in CasADi, which no file holds"
            raise ProblemError(self.name, [("search", finding, "search without workers and record")])
        _check_counts(self.name, (("starts", starts, 1), ("hops", hops, 0), ("workers", workers, 0)))
        wish = Wish(starts, seed, 60 * minutes, workers, hops)
        with TemporaryDirectory() as folder:
            path = Path(folder) / "starts.sqlite" if record is None else Path(record)
            _, outcome = solve_from_many(self.value, self.plant, self.model, wish, path, watch or (lambda _: None))
        if outcome is None:
            run = Run("Out_Of_Time", 0, 0.0, 0.0)
            outcome = Failure(self.value, run, "no start ended within the time", "give more minutes")
        if isinstance(outcome, Failure):
            return Unsolved(outcome)
        outcome = resimulate(outcome, self.plant)
        if self.value.refine is not None:
            outcome = refine(outcome, self.plant)
        return Solved(outcome, self.plant)

    # --- derivatives of solutions ---

    def continue_to(
        self, name: str, value: float, *, guess: GuessLike | None = None, watch: Callable[[Stop], None] | None = None
    ) -> Continued:
        """Solve the problem, and go on to another value of a number, from each solution to the next.

        `watch` sees every solve on the way. Raises ProblemError for a name that is no number.
        """
        return follow(self, name, value, guess, watch)

    def with_numbers(self, numbers: Mapping[str, float]) -> OptimalControl:
        """Return a copy with other values of numbers, by the names of `numbers`. Raises ProblemError."""
        return self._restate(self._source.put(numbers))

    def derivatives(self, solution: Solved | Unsolved, by: Sequence[str] | None = None) -> Derivatives:
        """Return how a solution of this problem moves with its numbers, by name; by default with all of them.

        Names are places of the problem file, such as `constants.kerb`, `cost.inputs`, `start.pose.cart`,
        `bounds.inputs.motor.upper`, `parameters.mass` of a differentiated parameter of the model; see `numbers`. Raises
        ProblemError for a name that is none, and for a solution of another problem; NotSolvedError where there is none.
        """
        plants = Plants((self.plant,))
        return differentiate_solution(self._source, list_solution(solution.solution), plants, by, self.programs.find)

    def differentiable(
        self,
        numbers: Sequence[str],
        reads: Sequence[str] = ("u", "cost"),
        *,
        solution: Solved | None = None,
        threads: int = 1,
    ) -> Differentiable:
        """Return the optimal motion as a function of numbers, by the names of `numbers`, for programs that learn.

        `reads` are its results: `cost`, and parts of a motion: `q`, `qd`, `u`, `states`, `controls`, `unknowns`, `t`.
        The function solves from `solution`, by default from the problem's own one, the members of a batch on `threads`.
        Its methods `jax` and `torch` return it for these libraries. Raises ProblemError for names that are none, and
        for numbers that the program does not follow in straight lines; NotSolvedError where the problem has no
        solution.
        """
        known = check_reads(self.name, reads)
        _check_counts(self.name, [("threads", threads, 1)])
        found = self.solve(check=False) if solution is None else solution
        answer = self.derivatives(found, numbers).answer

        def state(values: Sequence[float]) -> PhasedProblem:
            names = (number.name for number in answer.numbers)
            return list_one(self.with_numbers(dict(zip(names, values, strict=True))).value)

        return Differentiable(self.name, make_family(answer, state), known, threads)

    @property
    def _source(self) -> Source:
        left_out = list_left_out(self.value, self.plant, self.data)
        return Source(self.name, self.data, left_out, lambda data: list_one(self._restate(data).value))

    def load(self, path: str | Path) -> Solved:
        """Read a solution of this problem's model from a file. Raises InputError for a file that is not one."""
        read_guess(Path(path), self.plant.manifest)
        return Solved(read_solution(Path(path)), self.plant)

    def _find_guess(self, guess: GuessLike | None) -> Trajectory | None:
        own = self.value.guess.solution
        if guess is None:
            return None if own is None else find_guess(self.folder / own, self.value, self.plant)
        return read_motion(guess, self.value, self.plant)

    # --- display ---

    def describe(self) -> dict[str, str]:
        """Return the parts of the problem by their names; the size of the program, too, once it is built."""
        rows, solver = describe_problem(self.value, self.plant.manifest), self.programs.look(list_one(self.value))
        if solver is not None:
            program = solver.transcription.program
            rows["program"] = f"{program.kept.size} variables, {program.kept_rows.size} constraints"
        return rows

    def __repr__(self) -> str:
        return display.write_text(f"problem {self.name}", self.describe())

    def _repr_html_(self) -> str:
        return display.write_table(f"problem {self.name}", self.describe())


@overload
def problem(
    model: str | Path | None, *, phases: Sequence[Mapping[str, Any]], name: str | None = None, **keys: Any
) -> PhasedControl: ...


@overload
def problem(
    model: str | Path | None, *, links: Sequence[Mapping[str, Any]], name: str | None = None, **keys: Any
) -> PhasedControl: ...


@overload
def problem(model: str | Path | Plant | None, *, name: str | None = None, **keys: Any) -> OptimalControl: ...


def problem(
    model: str | Path | Plant | None, *, name: str | None = None, **keys: Any
) -> OptimalControl | PhasedControl:
    """Return a problem of a model: a model file, a generated folder, or loaded kernels; or without one.

    With `phases` or `links` it is a problem in phases, whose models are files.

    It takes the keys of a problem file. Values are numbers, texts, lists, arrays and mappings, by the names of
    coordinates and sensors. By default there are 50 intervals of 4 Radau points, a start at 0 and at rest, and the cost
    is the integral of |u|^2. Raises ProblemError with every fault, InputError for a model with faults.
    """
    if {"phases", "links"} & set(keys):
        return _make_phases(model, name, keys)
    plant = load(Path(model)) if isinstance(model, str | Path) else model or NO_MECHANISM
    known = name or (Path(model).stem if isinstance(model, str | Path) else plant.manifest.model)
    data = {**DEFAULTS, **make_plain(known, keys)}
    value = statement.state_problem(data, known, plant, Path())
    path = Path(model) if isinstance(model, str | Path) else None
    return OptimalControl(value, plant, data, Path(), Programs(), path)


def _check_counts(name: str, counts: Sequence[tuple[str, object, int]]) -> None:
    """Raise ProblemError for values that are no whole numbers, or too small; each has a name and a least value."""
    wrong = [(what, value, least) for what, value, least in counts if not is_count(value, least)]
    if wrong:
        lines = [(what, f"found {value!r}", f"give a whole number, {least} or more") for what, value, least in wrong]
        raise ProblemError(name, lines)


def _make_phases(model: str | Path | Plant | None, name: str | None, keys: Mapping[str, Any]) -> PhasedControl:
    known = name or (Path(model).stem if isinstance(model, str | Path) else "phases")
    if not (model is None or isinstance(model, str | Path)):
        remedy = "give the files of models"
        raise ProblemError(known, [("model", "loaded kernels, for a problem in phases", remedy)])
    own: dict[str, Data] = {} if model is None else {"model": str(model)}
    data = {**own, **make_plain(known, keys)}
    return make_phases(data, known, Path())


def read_problem(path: str | Path) -> OptimalControl | PhasedControl:
    """Read a problem file and its models. Raises InputError with every fault of all files."""
    file = Path(path)
    data = read_document(file).data
    if has_phases(file):
        phased, plants = read_phased_problem(file, load)
        return PhasedControl(phased, plants, data if isinstance(data, dict) else {}, file.parent)
    value, plant = statement.read_problem(file, load, NO_MECHANISM)
    if not isinstance(data, dict):
        raise InputError([Fault(str(file), 0, "", f"found {abbreviate(data)}", "give a mapping of keys")])
    return OptimalControl(value, plant, data, file.parent, Programs(), _find_model(file, data))


def _find_model(file: Path, data: Mapping[str, Data]) -> Path | None:
    model = data.get("model")
    return file.parent / model if isinstance(model, str) else None


def _take_list(data: Mapping[str, Data], key: str) -> list[Data]:
    found = data.get(key)
    return found if isinstance(found, list) else []


def _drop_no_cost(data: Mapping[str, Data]) -> Mapping[str, Data]:
    """Leave a weight 0 of inputs out, which is an error where no text gives another term."""
    cost = _take_mapping(data, "cost")
    return data if cost.get("inputs") != 0 else {**data, "cost": {k: x for k, x in cost.items() if k != "inputs"}}


def _take_mapping(data: Mapping[str, Data], key: str) -> Mapping[str, Data]:
    """Return the mapping of a key; an empty one where it has none."""
    found = data.get(key)
    return found if isinstance(found, dict) else {}
