"""Many problems of one kind in Python: a problem and the values of its keys -> a solution for each case, in order."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen.documents import Data, abbreviate
from mbsrun.kernel import is_count
from mbsrun.ocp.cases.cases import AnyCase, Case, Form, Found, LateCase, Outcome, solve_cases
from mbsrun.ocp.cases.layers import Place, find_starts
from mbsrun.ocp.cases.neighbours import solve_neighbours
from mbsrun.ocp.cases.placing import KEYS, choose_stated, find_special, is_plain, list_limits
from mbsrun.ocp.cases.programs import Programs, identify
from mbsrun.ocp.problem.phases import Plants
from mbsrun.ocp.solution.solution import Run
from mbsrun.ocp.solving.nearby import Late
from mbsrun.ocp.statement.checks import Line, ProblemError
from mbsrun.optimal import display
from mbsrun.optimal.naming import WrongPlaceError, put_at
from mbsrun.optimal.plain import make_plain
from mbsrun.optimal.result import Unsolved, import_pandas

Array = NDArray[np.float64]
Values = Mapping[str, Any]  # of keys, which are paths such as end.pose.cart or constraints[0].range
Over = Mapping[str, Sequence[Any]] | Sequence[Values]  # columns of values by key, or the values of each case
Show = Callable[[int, Any], None]  # the number and the outcome of a case

NAMED = 5  # cases with faults that an error names
_STEP = re.compile(r"([^.\[\]]+)|\[(\d+)\]")


@dataclass(frozen=True, eq=False)
class Deferred:
    """A solution whose motion is read when somebody looks at the case."""

    late: Late
    read: Callable[[Outcome], Any]

    @property
    def cost(self) -> float:
        """Return the whole cost."""
        return self.late.cost

    @cached_property
    def outcome(self) -> Any:
        """Return it as `solve` returns it."""
        return self.read(self.late.solution)


@dataclass(frozen=True, eq=False, repr=False)
class SolvedMany(Sequence[Any]):
    """The outcomes of cases in order: `found[3]` is what `solve` returns for case 3, Unsolved where that fails."""

    cases: tuple[Values, ...]
    kept: tuple[Any, ...]  # outcomes, some of them deferred

    @property
    def outcomes(self) -> tuple[Any, ...]:
        """Return all outcomes."""
        return tuple(map(_open, self.kept))

    def __getitem__(self, k: int | slice) -> Any:
        """Return the outcome of a case, or of several."""
        return tuple(map(_open, self.kept[k])) if isinstance(k, slice) else _open(self.kept[k])

    def __len__(self) -> int:
        """Count the cases."""
        return len(self.kept)

    @property
    def is_solved(self) -> NDArray[np.bool_]:
        """Return which cases have a solution, shape (cases,)."""
        return np.array([not isinstance(found, Unsolved) for found in self.kept], dtype=bool)

    @property
    def statuses(self) -> tuple[str, ...]:
        """Return the solver's word for each case."""
        return tuple(_read_run(found).status for found in self.kept)

    @property
    def cost(self) -> Array:
        """Return the whole cost of each case, shape (cases,); not a number where there is no solution."""
        return np.array([np.nan if isinstance(found, Unsolved) else found.cost for found in self.kept])

    @property
    def iterations(self) -> NDArray[np.int64]:
        """Return the iterations of each case, shape (cases,)."""
        return np.array([_read_run(found).iterations for found in self.kept], dtype=np.int64)

    @property
    def cpu_seconds(self) -> Array:
        """Return the solver's processor time of each case [s], shape (cases,)."""
        return np.array([_read_run(found).cpu_seconds for found in self.kept])

    @property
    def shortcomings(self) -> dict[int, list[str]]:
        """Return what is short of the problem's wishes in solutions, by the number of the case."""
        found = {k: x.shortcomings for k, x in enumerate(self.outcomes) if not isinstance(x, Unsolved)}
        return {k: texts for k, texts in found.items() if texts}

    def to_frame(self) -> Any:
        """Return a pandas frame: a row for each case, with its keys, status, cost and iterations.

        Raises MissingPackageError without pandas.
        """
        rows = [dict(case) for case in self.cases]
        numbers = {"status": self.statuses, "cost": self.cost, "iterations": self.iterations}
        return import_pandas().DataFrame(rows).assign(**numbers)

    def __repr__(self) -> str:
        return display.write_text("cases", self._rows)

    def _repr_html_(self) -> str:
        return display.write_table("cases", self._rows)

    @property
    def _rows(self) -> dict[str, str]:
        rows = {"solved": f"{int(self.is_solved.sum())} of {len(self)}"}
        if self.is_solved.any():
            rows["cost"] = f"{np.nanmin(self.cost):.8g} to {np.nanmax(self.cost):.8g}"
        if self.shortcomings:
            rows["short"] = f"{len(self.shortcomings)} of them, see shortcomings"
        for k, found in enumerate(self.kept):
            if isinstance(found, Unsolved) and len(rows) < NAMED + 2:
                rows[f"case {k}"] = f"{found.status}: {found.reason}"
        return rows


def _open(found: Any) -> Any:
    """Return an outcome as `solve` returns it."""
    return found.outcome if isinstance(found, Deferred) else found


def _read_run(found: Any) -> Run:
    if isinstance(found, Deferred):
        return found.late.run
    run: Run = found.failure.run if isinstance(found, Unsolved) else found.solution.run
    return run


def list_cases(name: str, over: Over) -> tuple[Values, ...]:
    """List the values of each case: columns of equal length by key, or a mapping for each case. Raises ProblemError."""
    if not isinstance(over, Mapping):
        return tuple(dict(case) for case in over) or _refuse(name, "over", "there is no case", "give at least one")
    for key, values in over.items():
        if isinstance(values, str) or not hasattr(values, "__len__"):
            _refuse(name, f"over.{key}", f"found {values!r}", "give a list of values, one for each case")
    lengths = {key: len(values) for key, values in over.items()}
    if not lengths or not max(lengths.values()):
        _refuse(name, "over", "there is no case", "give each key a list of values")
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"{key} {length}" for key, length in lengths.items())
        _refuse(name, "over", f"the keys have different numbers of values: {told}", "give all the same number")
    keys = tuple(over)
    return tuple(dict(zip(keys, row, strict=True)) for row in zip(*over.values(), strict=True))


def change(name: str, data: Mapping[str, Data], values: Values) -> dict[str, Data]:
    """Return the data of a problem with other values of some keys.

    None drops a key of the top, which has its default then. Raises ProblemError for a path that leads nowhere.
    """
    changed: Any = dict(data)
    for path, value in make_plain(name, values).items():
        changed = _put(name, path, changed, value)
    return {key: value for key, value in changed.items() if value is not None}


def _split(name: str, path: str) -> list[str | int]:
    """Split a path into keys and numbers: constraints[0].range -> constraints, 0, range."""
    steps: list[str | int] = [int(m[2]) if m[2] else m[1] for m in _STEP.finditer(path)]
    spelled = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps)
    if not steps or spelled[1:] != path:
        _refuse(name, path, "this is no path of keys", "write keys with dots and numbers in brackets: end.pose.cart")
    return steps


def _put(name: str, path: str, data: Mapping[str, Data], value: Data) -> Any:
    """Return data with a value put where a path leads; mappings on the way are made, lists are not."""
    try:
        return put_at(data, tuple(_split(name, path)), value)
    except WrongPlaceError as lack:
        found, key, remedy = abbreviate(lack.found), f"{lack.key}", "write a path of keys of the problem"
        if isinstance(lack.key, int):
            found = f"a list of {len(lack.found)}" if isinstance(lack.found, list) else "no list"
            key, remedy = f"[{key}]", "give the number of an entry, from 0"
        return _refuse(name, path, f"found {found} where the path has {key}", remedy)


def _refuse(name: str, place: str, finding: str, remedy: str) -> Any:
    raise ProblemError(name, [(place, finding, remedy)])


@dataclass(frozen=True)
class Numbers:
    """The numbers and the texts among the values of a case, by their paths."""

    names: tuple[str, ...]
    values: tuple[float, ...]
    parts: tuple[int, ...]  # of each number: of the key that it belongs to
    texts: tuple[tuple[str, str], ...]

    @property
    def kind(self) -> Hashable:
        """Return what cases of one kind share."""
        return self.names, self.texts


def list_places(values: Sequence[Values], cases: Sequence[AnyCase]) -> list[Place]:
    """Return what distinguishes cases: the numbers among their values; texts and structures make kinds."""
    return [_place(read_numbers(own), case) for own, case in zip(values, cases, strict=True)]


def _place(own: Numbers, case: AnyCase) -> Place:
    stated = case.form.cases[0] if isinstance(case, LateCase) else case
    return Place((own.names, own.texts, identify(stated.problem)), own.values, own.parts)


def read_numbers(values: Values) -> Numbers:
    """Read the numbers and the texts among the values of a case."""
    numbers, texts = dict[str, float](), dict[str, str]()
    parts: dict[str, int] = {}
    for part, (key, value) in enumerate(sorted(values.items())):
        for path, entry in _list_entries(key, value):
            is_number = isinstance(entry, int | float | np.number) and not isinstance(entry, bool)
            if is_number and math.isfinite(entry):
                numbers[path], parts[path] = float(entry), part
            else:
                texts[path] = repr(entry)
    names = sorted(numbers)
    found = tuple(numbers[name] for name in names)
    return Numbers(tuple(names), found, tuple(parts[name] for name in names), tuple(sorted(texts.items())))


def _list_entries(path: str, value: Any) -> Iterator[tuple[str, Any]]:
    """List the single values within a value, with their paths."""
    if isinstance(value, Mapping):
        parts = [(f"{path}.{key}", part) for key, part in value.items()]
    elif isinstance(value, list | tuple | np.ndarray) and np.ndim(value):
        parts = [(f"{path}[{k}]", part) for k, part in enumerate(value)]
    else:
        yield path, value
        return
    for inner, part in parts:
        yield from _list_entries(inner, part)


@dataclass(frozen=True, eq=False)
class Family:
    """A problem whose keys take many values: how it becomes one case."""

    name: str
    data: Mapping[str, Data]  # as a problem file holds it
    plants: Plants
    restate: Callable[[Mapping[str, Data]], Any]  # data -> a problem in Python. Raises ProblemError
    state: Callable[[Any, Any, bool], Case]  # a problem, a guess or None, whether it is checked -> a case
    read: Callable[[AnyCase, Outcome], Any]  # an outcome as `solve` returns it
    programs: Programs = field(default_factory=Programs)  # that were made before

    def list_cases(self, cases: Sequence[Values], guesses: Sequence[Any] | None = None, *, check: bool) -> list[Case]:
        """Return the case of each mapping of values. Raises ProblemError with the faults of the first."""
        if guesses is not None and len(guesses) != len(cases):
            _refuse(self.name, "guesses", f"there are {len(guesses)} for {len(cases)} cases", "give one for each")
        found, faults, wrong = list[Case](), list[Line](), 0
        for k, case in enumerate(cases):
            try:
                found.append(self.make_case(case, None if guesses is None else guesses[k], check=check))
            except ProblemError as error:
                wrong += 1
                own = [(f"case {k}: {place}", finding, remedy) for place, finding, remedy in error.findings]
                faults += own if wrong <= NAMED else []
        if wrong > NAMED:
            faults.append(("cases", f"{wrong - NAMED} more of {len(cases)} have faults", "mend these first"))
        if faults:
            raise ProblemError(self.name, faults)
        return found

    def make_case(self, values: Values, guess: Any | None, *, check: bool) -> Case:
        """State a case. Raises ProblemError."""
        return self.state(self.restate(change(self.name, self.data, values)), guess, check)

    def list_near_cases(self, cases: Sequence[Values], *, check: bool) -> list[AnyCase]:
        """Return the case of each mapping of values, to be solved from neighbours: most of large kinds are late.

        Raises ProblemError with the faults of the first.
        """
        kinds: dict[Hashable, list[int]] = {}
        numbers = [read_numbers(values) for values in cases]
        for k, own in enumerate(numbers):
            kinds.setdefault(own.kind, []).append(k)
        found: dict[int, AnyCase] = {}
        try:
            for chosen in kinds.values():
                every = np.array([numbers[k].values for k in chosen]).reshape(len(chosen), -1)
                found |= dict(zip(chosen, self._make_kind([cases[k] for k in chosen], every, check=check), strict=True))
        except ProblemError:
            return [*self.list_cases(cases, check=check)]
        return [found[k] for k in range(len(cases))]

    def _make_kind(self, cases: Sequence[Values], numbers: Array, *, check: bool) -> list[AnyCase]:
        """Return cases of one kind, with numbers (cases, n): late ones beside stated ones. Raises ProblemError."""

        def make(k: int) -> Case:
            return self.make_case(cases[k], None, check=check)

        chosen = choose_stated(numbers) if numbers.shape[1] and _has_open_keys(cases[0]) else [*range(len(cases))]
        stated = {k: make(k) for k in (chosen if 2 * len(chosen) <= len(cases) else range(len(cases)))}
        if len(stated) == len(cases):
            return [stated[k] for k in range(len(cases))]
        problems = [case.problem for case in stated.values()]
        special = find_special(numbers, list_limits(problems[0]))
        if not all(map(is_plain, problems)) or len({identify(problem) for problem in problems}) > 1:
            special = [*range(len(cases))]
        form = Form(tuple(stated.values()), numbers[list(stated)])
        stated |= {k: make(k) for k in special if k not in stated}
        late = {k: LateCase(form, numbers[k], partial(make, k), check) for k in range(len(cases)) if k not in stated}
        return [stated[k] if k in stated else late[k] for k in range(len(cases))]


def _has_open_keys(values: Values) -> bool:
    """Return whether all keys are among the ones whose numbers may be placed."""
    return all(re.split(r"[.\[]", key)[0] in KEYS for key in values)


@dataclass(frozen=True)
class Way:
    """How cases are solved."""

    threads: int = 1
    neighbours: bool = False  # from each other's solutions
    check: bool = True


def solve_family(family: Family, over: Over, guesses: Sequence[Any] | None, way: Way, watch: Show | None) -> SolvedMany:
    """Solve a problem for many values of its keys; see `OptimalControl.solve_many`."""
    values = list_cases(family.name, over)
    if not is_count(way.threads):
        _refuse(family.name, "threads", f"found {way.threads}", "give a whole number, 1 or more")
    if way.neighbours and guesses is not None:
        _refuse(family.name, "guesses", "cases start from their neighbours", "leave out guesses, or neighbours")
    found = dict[int, Any]()
    if way.neighbours:
        cases = family.list_near_cases(values, check=way.check)
    else:
        cases = [*family.list_cases(values, guesses, check=way.check)]
    with family.programs.lend() as programs:
        for k, outcome in _solve(family, values, cases, way, programs):
            read = partial(family.read, cases[k])
            found[k] = Deferred(outcome, read) if isinstance(outcome, Late) else read(outcome)
            if watch is not None:
                watch(k, _open(found[k]))
    return SolvedMany(values, tuple(found[k] for k in range(len(cases))))


def _solve(
    family: Family, values: Sequence[Values], cases: Sequence[AnyCase], way: Way, programs: Programs
) -> Iterator[tuple[int, Found]]:
    """Solve cases; yield the number and the outcome of each as it ends."""
    if not way.neighbours:
        return solve_cases(cases, family.plants, way.threads, programs)
    starts = find_starts(list_places(values, cases))
    return solve_neighbours(cases, starts, family.plants, way.threads, programs)
