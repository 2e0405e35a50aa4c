"""Carry out the whole study of a problem, and collect its results.

This process alone writes every attempt to `study.sqlite` in the output folder, as soon as the attempt ends. So an
interrupted study continues.
"""

from __future__ import annotations

import fcntl
import json
import math
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from mbsgen.errors import Fault, InputError, MbsError
from mbsrun.closure import has_loops
from mbsrun.environment import describe_environment
from mbsrun.external import Mechanism
from mbsrun.measuring.sections import Cell, Section, Table
from mbsrun.models import Extent, find_folder, fingerprint_generator
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.problem.problem import Problem, Representation
from mbsrun.ocp.searching.executor import LocalExecutor
from mbsrun.ocp.searching.search import Executor, OutOfTimeError, Search
from mbsrun.ocp.searching.study import Study, Targets, Weights, describe, identify
from mbsrun.ocp.searching.trials import ProtocolName
from mbsrun.ocp.solution.record import Attempt, Record, Task, open_record
from mbsrun.ocp.statement.statement import read_problem
from studies.docquier import questions, spread
from studies.docquier.differentiated import WAYS, Differentiated
from studies.docquier.earlier import read_page
from studies.docquier.export import DIGITS, Row, list_rows
from studies.docquier.figures import draw_figures, name_set
from studies.docquier.growth import Growth, count_growth
from studies.docquier.judgement import SHOWN, judge_all
from studies.docquier.nonzeros import explain_nonzeros
from studies.docquier.optima import Optimum, list_optima
from studies.docquier.questions import GridPoint, System, TaskList, name_transcription
from studies.docquier.results import Effort, Results, find_shown_task
from studies.docquier.robustness import find_state, report_robust
from studies.docquier.summary import summarise_run
from studies.docquier.tables import tabulate, tabulate_claims, tabulate_spreads

COUNTED = Extent(counted=True, compared=True)  # the report shows the operations of formulations and derivatives
STORE = "study.sqlite"
QUESTIONS = ("repeats", "derivatives", "grids", "systems", "shooting", "guess")
SETS: tuple[Weights, ...] = ((1.0, 0.0), (1.0, 1e5))  # the paper's costs
Attempts = Sequence[tuple[Attempt, str]]  # with the environment of each

WHOLE = 231  # tasks of each set and representation in the paper


@dataclass(frozen=True, eq=False)
class Subject:
    """The content of a problem file, the file of its model, and the generated folder."""

    problem: Problem
    plant: Mechanism
    model: Path
    folder: Path

    @property
    def system(self) -> System:
        """Return problem and folder, for a list of tasks."""
        return System(self.problem, self.folder)


@dataclass(frozen=True, eq=False)
class Campaign:
    """The parts of a study: protocols, questions and systems."""

    subject: Subject
    study: Study
    protocols: tuple[ProtocolName, ...]
    questions: tuple[str, ...]
    systems: tuple[Subject, ...]
    is_quick: bool  # a small part of the questions


def read_subject(file: Path) -> Subject:
    """Read a problem file, and generate the folder of its model. Raises InputError."""
    paths: list[tuple[Path, Path]] = []

    def load(model: Path) -> Mechanism:
        paths.append((Path(model), find_folder(Path(model), COUNTED)))
        return Mechanism(paths[-1][1])

    problem, plant = read_problem(file, load)
    return Subject(problem, plant, *paths[-1])


def find_sensor(problem: Problem, file: Path) -> str:
    """Name the one sensor that has a target. Raises InputError."""
    names = [name for name, _ in problem.end.sensors]
    if len(names) != 1:
        finding = f"it has targets for {', '.join(names) or 'no sensor'}"
        raise InputError([Fault(str(file), 0, "end.sensors", finding, "give a problem with a target for one sensor")])
    return names[0]


def choose_steps(targets: Targets, sample: int) -> tuple[int, int]:
    """Return the steps of azimuths and heights for a slice of about `sample` targets, evenly and with both ends.

    Among slices of the same difference, the one with more azimuths is returned.
    """
    counts = (len(targets.azimuths), len(targets.heights))
    steps = [[s for s in range(1, max(n, 2)) if (n - 1) % s == 0] for n in counts]
    taken = [((counts[0] - 1) // a + 1, (counts[1] - 1) // b + 1, a, b) for a in steps[0] for b in steps[1]]
    _, _, a, b = min(taken, key=lambda t: (abs(t[0] * t[1] - sample), -t[0]))
    return a, b


@contextmanager
def hold(folder: Path) -> Iterator[None]:
    """Lock a folder against other studies. Raises MbsError where another study holds it."""
    folder.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError:
        raise MbsError(f"{folder}: another study is at work there; wait for its end, or give another folder") from None
    finally:
        os.close(descriptor)


# --- solving -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Step:
    """The state of the work, for an observer."""

    title: str
    trials: int  # of the current list
    done: int
    last: Attempt | None = None


Watch = Callable[[Step], None]


class Runner:
    """Carries out a campaign."""

    def __init__(
        self, campaign: Campaign, record: Record, executor_for: Callable[[Path], Executor], watch: Watch, seconds: float
    ) -> None:
        """Take a function that returns the executor for a generated folder, and the available time."""
        self.campaign, self.record, self.executor_for, self.watch = campaign, record, executor_for, watch
        self.end = time.monotonic() + seconds
        self._executors: dict[Path, Executor] = {}

    def run(self) -> None:
        """Do all of it. Raises OutOfTimeError."""
        campaign = self.campaign
        if "paper" in campaign.protocols:
            self._follow("paper")
        for name in campaign.questions:
            self._try_all(name, list_tasks(campaign, name))
        if "robust" in campaign.protocols:
            self._follow("robust")

    def _follow(self, protocol: ProtocolName) -> None:
        study, subject = self.campaign.study, self.campaign.subject
        count = _Count(self.watch, f"{protocol} protocol")
        record = self._record(study, subject.plant)
        self._search(study, record, self._executor(subject.folder), count).run(protocol, count.plan)

    def _try_all(self, title: str, lists: Sequence[TaskList]) -> None:
        records = [self._record(tasks.study, self._own_subject(tasks).plant) for tasks in lists]
        done = sum(r.find(trial.key) for r, tasks in zip(records, lists, strict=True) for trial in tasks.trials)
        count = _Count(self.watch, title)
        count.plan(sum(len(tasks.trials) for tasks in lists), done)
        for record, tasks in zip(records, lists, strict=True):
            own = self._own_subject(tasks)
            if title == "derivatives":  # times are compared, so this process solves one after the other
                plant = own.plant
                is_compiled = tasks.way == WAYS[1]
                by = plant if tasks.way == WAYS[0] else Differentiated(plant, own.model, is_compiled)
                executor: Executor = LocalExecutor(by, describe_environment())
            else:
                executor = self._executor(tasks.folder)
            self._search(tasks.study, record, executor, count).try_all(tasks.trials)

    def _own_subject(self, tasks: TaskList) -> Subject:
        subjects = (self.campaign.subject, *self.campaign.systems)
        return next(s for s in subjects if s.folder == tasks.folder)

    def _executor(self, folder: Path) -> Executor:
        if folder not in self._executors:
            self._executors[folder] = self.executor_for(folder)
        return self._executors[folder]

    def _record(self, study: Study, plant: Mechanism) -> Record:
        return self.record.of(identify(study, plant.manifest), describe(study, plant.manifest))

    def _search(self, study: Study, record: Record, executor: Executor, count: _Count) -> Search:
        return Search(study, executor, record, count.step, max(0.0, self.end - time.monotonic()))


class _Count:
    """Counts the finished trials."""

    def __init__(self, watch: Watch, title: str) -> None:
        self.watch, self.title, self.trials, self.done = watch, title, 0, 0

    def plan(self, trials: int, done: int) -> None:
        self.trials, self.done = trials, done
        self.watch(Step(self.title, self.trials, self.done))

    def step(self, attempt: Attempt, _: bool) -> None:
        self.done += 1
        self.watch(Step(self.title, self.trials, self.done, attempt))


def list_tasks(campaign: Campaign, question: str) -> list[TaskList]:
    """List the tasks of a question, with the linear solver of the campaign."""
    linear = campaign.study.linear_solver
    return [replace(t, study=replace(t.study, linear_solver=linear)) for t in _list_tasks(campaign, question)]


def _list_tasks(campaign: Campaign, question: str) -> list[TaskList]:
    subject, study = campaign.subject, campaign.study
    if question == "derivatives":
        return questions.list_derivatives(subject.problem, subject.folder, study.representations)
    if question == "grids":
        grids = questions.QUICK_GRIDS if campaign.is_quick else questions.GRIDS
        return questions.list_grids(subject.problem, subject.folder, grids)
    if question == "systems":
        return questions.list_systems([s.system for s in campaign.systems])
    if question == "shooting":
        open_chains = [s.system for s in campaign.systems if not has_loops(s.plant.manifest)]  # shooting takes no loops
        return questions.list_shooting(study, subject.folder, open_chains)
    if question == "repeats":
        return questions.list_repeats(study, subject.folder)
    return questions.list_guesses(study, subject.folder)


def carry_out(
    campaign: Campaign, out: Path, executor_for: Callable[[Path], Executor], watch: Watch, seconds: float
) -> bool:
    """Make the attempts that the record lacks, and return whether all are made. Raises ClusterError, InputError."""
    with _open(campaign, out) as record:
        try:
            Runner(campaign, record, executor_for, watch, seconds).run()
        except OutOfTimeError:
            return False
    return True


@contextmanager
def _open(campaign: Campaign, out: Path) -> Iterator[Record]:
    study, manifest = campaign.study, campaign.subject.plant.manifest
    with open_record(out / STORE, identify(study, manifest), describe(study, manifest)) as record:
        yield record


# --- results -----------------------------------------------------------------------------------------------


def list_attempts(campaign: Campaign, out: Path) -> list[Row]:
    """List every attempt of the campaign, and of its questions, as rows."""
    rows: list[Row] = []
    with _open(campaign, out) as record:
        for study, own in _list_records(campaign, record):
            rows += list_rows(study, own.identity, own.list_all())
    return rows


def _list_records(campaign: Campaign, record: Record) -> Iterator[tuple[Study, Record]]:
    """Yield the record of the campaign, and the records of the questions."""
    yield campaign.study, record
    yield from _list_own_records(campaign, record)


def restore(campaign: Campaign, out: Path, folder: Path) -> str:
    """Take attempts and certificates from a page of an earlier run into the record; return a sentence about it.

    Raises InputError.
    """
    earlier = read_page(folder, campaign.study.targets)
    with _open(campaign, out) as record:
        own = {r.identity[:DIGITS]: r for _, r in _list_records(campaign, record)}
        taken = 0
        for identity, attempt, environment in earlier.attempts:
            if identity in own:
                own[identity].restore(attempt, environment)
                taken += 1
        for key, certificate in earlier.certificates.items():
            record.find_or_derive(key, partial(json.dumps, asdict(certificate)))
        for key, turns in earlier.beyond.items():
            record.find_or_derive(key, partial(json.dumps, turns))
    rest = len(earlier.attempts) - taken
    left = f"; {rest} belong to systems that are not given, or to other targets" if rest else ""
    return f"{folder}: {taken} attempts and {len(earlier.certificates)} certificates are in the record{left}"


def _recall(campaign: Campaign, record: Record) -> Callable[[Task, str, str], Trajectory | None]:
    """Return a function that finds the motion of a best attempt; it solves again for one that was restored."""
    plant = campaign.subject.plant
    search = Search(campaign.study, LocalExecutor(plant, describe_environment()), record)
    return lambda task, protocol, turns: search.find_motion(task, protocol, turns=turns)


def _list_own_records(campaign: Campaign, record: Record) -> Iterator[tuple[Study, Record]]:
    """Yield the records of the questions, except the record of the campaign itself."""
    subjects = (campaign.subject, *campaign.systems)
    own = identify(campaign.study, campaign.subject.plant.manifest)
    seen = {own}
    for question in QUESTIONS:
        for tasks in list_tasks(campaign, question):
            manifest = next(s for s in subjects if s.folder == tasks.folder).plant.manifest
            identity = identify(tasks.study, manifest)
            if identity not in seen:
                seen.add(identity)
                yield tasks.study, record.of(identity, describe(tasks.study, manifest))


def gather(
    campaign: Campaign, record: Record, growth: tuple[Growth, ...], own: Sequence[tuple[Study, Attempts]]
) -> Results:
    """Collect the results of the study proper."""
    study, report = campaign.study, _read_report(campaign.subject.folder)
    attempts = tuple(a for a in record.attempts() if _is_part(a, study))
    motions, recall = [], _recall(campaign, record)
    for weights in study.costs:
        motion = recall(find_shown_task(study, weights), "paper", "")
        if motion is not None:
            motions.append((weights, motion))
    efforts = tuple(
        (name, Effort(found["flops"]["paper"], found["equations"]))
        for name, found in report.get("formulations", {}).items()
    )
    shots: dict[str, list[Attempt]] = {}
    for each, found in ((study, attempts), *((s, [a for a, _ in rows]) for s, rows in own if s.sensor is not None)):
        for a in found:
            if a.part == "shooting":
                shots.setdefault(name_transcription(each.problem), []).append(a)
    shooting = tuple((name, tuple(found)) for name, found in shots.items())
    repeats = [a for _, rows in own for a, _ in rows if a.part == "repeats"]
    compared = [a for a in attempts if a.protocol == "paper"]
    repeats = repeats or spread.pair_mirrored(compared, study.targets)
    spreads = spread.measure(compared, repeats, SHOWN)
    return Results(study, attempts, tuple(motions), efforts, growth, shooting, spreads)


def list_lowest(campaign: Campaign, out: Path, seconds: float = math.inf) -> list[Optimum]:
    """List the lowest optimum of every target and cost in the record, with the certificates that the time allows."""
    end = time.monotonic() + seconds
    with _open(campaign, out) as record:
        return list(list_optima(campaign.study, record, campaign.subject.plant, _recall(campaign, record), end))


def describe_extent(campaign: Campaign, out: Path) -> list[str]:
    """Describe the part of the paper's protocol that the record holds, with its solver; one sentence for each cost."""
    study, texts = campaign.study, []
    with _open(campaign, out) as record:
        rows = [(a, text) for a, text in record.list_all() if a.protocol == "paper"]
    names = len(study.representations)
    for weights in study.costs:
        own = [a for a, _ in rows if a.task.weights == weights and _is_part(a, study)]
        whole = Counter(a.task.place for a in own)
        full, targets = sum(count == names for count in whole.values()), len(study.targets.places)
        state = "complete" if full == targets else "not complete"
        texts.append(
            f"With {name_set(weights)} the record is {state}: {len(own)} of {names * targets} solves, "
            f"{full} of {targets} targets in all {names} representations."
        )
    solvers = Counter(json.loads(text).get("linear_solver") for _, text in rows if text)
    used = [f"{_name_solver(name)} ({count} solves)" for name, count in sorted(solvers.items(), key=str)]
    return [*texts, f"Solved by {', '.join(used)}." if used else "It holds no solve."]


def _name_solver(linear: str | None) -> str:
    """Name what solves a task, by the linear solver that the record gives."""
    return "mbs" if linear == "mbs" else f"IPOPT with {linear or 'its own linear solver'}"


def _is_part(attempt: Attempt, study: Study) -> bool:
    """Return whether an attempt belongs to the requested targets, costs and representations."""
    task = attempt.task
    names = [r.value for r in study.representations]
    return task.place in study.targets.places and task.weights in study.costs and task.representation in names


def report(campaign: Campaign, out: Path) -> list[Section]:
    """Return all sections of the report that have numbers."""
    study = campaign.study
    with _open(campaign, out) as record:
        own = [(s, tuple(r.list_all())) for s, r in _list_own_records(campaign, record)]
        results = gather(campaign, record, _find_growth(out), own)
        states = {weights: find_state(replace(study, costs=(weights,)), record) for weights in study.costs}
        counts = Counter(text for rows in (record.list_all(), *(rows for _, rows in own)) for _, text in rows)
    judgements, scatter = judge_all(results), tabulate_spreads(results.spreads)
    derivatives = [a for _, attempts in _select(campaign, results, own, "derivatives") for a in attempts]
    sections = [
        summarise_run(results, judgements, questions.summarise_derivatives(derivatives)),
        Section(
            "statements",
            "Claims of the paper, and verdicts of this run",
            "Each claim of section 4.3 and of the conclusion, beside the numbers of the paper's protocol: one "
            "stated guess for all representations, the interpolation with inputs 0, and no restart."
            + describe_missing(results),
            (tabulate_claims(judgements), *([scatter] if scatter else [])),
        ),
        Section("tables", "The paper's tables", "", tuple(tabulate(results))),
        *(found for found in (explain_nonzeros(campaign.subject.problem, campaign.subject.plant),) if found),
        Section("figures", "The paper's figures", "", tuple(draw_figures(results, campaign.subject.plant))),
    ]
    run = Section("run", "The run", "", (_tabulate_run(results, own), *_tabulate_environments(counts)))
    rest = (report_robust(results, states), *_answer(campaign, results, own, derivatives))
    return sections + [section for section in (*rest, run) if section is not None]


def describe_missing(results: Results) -> str:
    """Describe the costs whose verdicts are of a part of the targets."""
    whole = len(results.study.targets.places)
    return "".join(
        f" Verdicts with {name_set(weights)} are of {len(places)} of {whole} targets, since the record is not complete."
        for weights, places in results.compared.items()
        if len(places) < whole
    )


def _select(
    campaign: Campaign, results: Results, own: Sequence[tuple[Study, Attempts]], question: str
) -> list[tuple[Study, list[Attempt]]]:
    """Select the attempts of a question: one study may serve several questions."""
    part = [(s, [a for a, _ in rows if a.part == question]) for s, rows in own]
    part.append((campaign.study, [a for a in results.attempts if a.part == question]))
    return [(s, attempts) for s, attempts in part if attempts]


def _answer(
    campaign: Campaign, results: Results, own: Sequence[tuple[Study, Attempts]], derivatives: Sequence[Attempt]
) -> list[Section | None]:
    ways = _read_report(campaign.subject.folder).get("ways", {})
    select = partial(_select, campaign, results, own)
    grids = [GridPoint(s.problem, a) for s, attempts in select("grids") for a in attempts]
    systems = [(s.problem.name, attempts) for s, attempts in select("systems")]
    return [
        questions.answer_guess(results),
        questions.answer_derivatives(derivatives, ways),
        questions.answer_grids(grids),
        questions.answer_systems(systems),
        questions.answer_shooting([(s.problem, attempts) for s, attempts in select("shooting")]),
    ]


def _tabulate_run(results: Results, own: Sequence[tuple[Study, Attempts]]) -> Table:
    """Tabulate the size of the run."""
    groups: dict[str, list[Attempt]] = {}
    for a in results.attempts:
        groups.setdefault(f"{a.protocol} protocol" if a.protocol in ("paper", "robust") else a.part, []).append(a)
    for a in (a for _, rows in own for a, _ in rows):
        groups.setdefault(a.part, []).append(a)
    sets, names = len(SETS), len(Representation)
    whole = WHOLE * sets * names
    table: list[tuple[Cell, ...]] = []
    for name, attempts in groups.items():
        tasks = {a.task for a in attempts}
        share = round(100 * len(tasks) / whole, 1) if name == "paper protocol" else None
        solved, cpu = sum(a.cost is not None for a in attempts), round(sum(a.cpu_seconds for a in attempts), 1)
        table.append((name, len(attempts), len(tasks), share, solved, cpu))
    columns = ("part", "attempts", "tasks", "% of the paper's", "solved", "CPU s")
    note = f"The paper's study has {whole} tasks: {WHOLE} targets, {sets} costs, {names} representations."
    return Table("How large the run is", columns, tuple(table), note)


def _tabulate_environments(counts: Mapping[str, int]) -> Iterator[Table]:
    """Tabulate the environments and their numbers of attempts; a record may contain several versions."""
    environments = [(json.loads(text), count) for text, count in sorted(counts.items()) if text]
    if environments:
        columns = tuple(dict.fromkeys(key for each, _ in environments for key in each))
        rows = tuple((count, *(each.get(key) for key in columns)) for each, count in environments)
        note = (
            "CPU times are of the processor, in one thread. Other programs on the machine lengthen them. The "
            "column `generated` shows the beginning of the hash of the code, which depends on the version of mbsgen."
        )
        yield Table("Versions and machines", ("attempts", *columns), rows, note, is_folded=True)


def _find_growth(out: Path) -> tuple[Growth, ...]:
    """Count the operations of chains, or read the counts of the same generator."""
    path, own = out / "growth.json", fingerprint_generator().hex()
    if path.exists():
        found = json.loads(path.read_text(encoding="utf-8"))
        if found.get("generator") == own:
            return tuple(Growth(g["formulation"], tuple(map(tuple, g["flops"])), g["degree"]) for g in found["growth"])
    growth = count_growth()
    counts = [{"formulation": g.formulation, "flops": g.flops, "degree": g.degree} for g in growth]
    path.write_text(json.dumps({"generator": own, "growth": counts}) + "\n", encoding="utf-8")
    return growth


def _read_report(folder: Path) -> dict[str, Any]:
    """Read the report of the generator, if it exists."""
    path = folder / "report.json"
    found = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    return found if isinstance(found, dict) else {}


def restrict(study: Study, sample: int | None) -> Study:
    """Take a slice of the targets."""
    if sample is None:
        return study
    return replace(study, targets=replace(study.targets, every=choose_steps(study.targets, sample)))
