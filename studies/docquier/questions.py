"""Questions that Docquier, Brüls and Fisette leave open: each is a declared list of tasks, and a section of answers.

guess         the share of the initial guess in the difference of formulations, and the cause of higher minima:
              inputs 0, and the inputs of the guessed motion
derivatives   generated sensitivities against algorithmic differentiation of the same equations
grids         other transcriptions: Radau and Legendre points, degrees 1 to 5, N from 25 to 200
repeats       the scatter of the iterations of one task, for targets that differ by rounding alone
systems       other systems
shooting      multiple shooting, on the study's problem and on the other systems
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mbsrun.measuring.sections import Cell, Picture, Section, Table
from mbsrun.ocp.ground.integrators import IntegratorName
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.problem.problem import Form, Problem, Representation, find_conflicts
from mbsrun.ocp.searching.attempts import is_higher
from mbsrun.ocp.searching.study import ONE, Place, Study, Weights
from mbsrun.ocp.searching.trials import Interpolation, Trial, list_interpolations
from mbsrun.ocp.solution.record import Attempt, Task
from studies.docquier.differentiated import WAYS, Way
from studies.docquier.figures import draw_parts, draw_ratios, draw_scatter, name_set
from studies.docquier.judgement import SHOWN
from studies.docquier.judges import COLLOCATION
from studies.docquier.results import Results

PROTOCOL = "question"  # of attempts outside the two protocols
REPEATS = 4  # of each task whose iterations are repeated
NUDGE = 2.0**-50  # relative, of the radius of the targets: a few units in the last place
ROUNDS = 3  # in which ways of differentiating are timed
GRIDS = tuple(
    (family, degree, intervals)
    for intervals in (25, 50, 100, 200)
    for family in (Family.RADAU, Family.LEGENDRE)
    for degree in range(1, 6)
)
QUICK_GRIDS = tuple((Family.RADAU, degree, intervals) for degree in (1, 2) for intervals in (5, 10))
APART = 0.01  # relative difference of costs from which on two transcriptions are in other minima
FORMULATIONS = tuple(
    r.value for r in (Representation.IMPL, Representation.EXP1_O, Representation.EXP1_A)
)  # see `answer_guess`
GRID_REPRESENTATIONS = (Representation.IMPL, Representation.EXP2_O)


@dataclass(frozen=True, eq=False)
class TaskList:
    """Trials of one study, on one model."""

    folder: Path  # with the generated kernels
    study: Study
    trials: tuple[Trial, ...]
    way: Way = "generated"  # the source of derivatives


@dataclass(frozen=True, eq=False)
class System:
    """A problem and the generated folder of its model."""

    problem: Problem
    folder: Path


def _alone(problem: Problem, representations: Iterable[Representation]) -> Study:
    """Return the study of one problem with its cost and target, in the representations that its form admits."""
    costs = ((problem.cost.inputs, problem.cost.input_rates),)
    return Study(problem, None, ONE, costs, _admit(problem, representations), ())


def _admit(problem: Problem, representations: Iterable[Representation]) -> tuple[Representation, ...]:
    return tuple(r for r in representations if not find_conflicts(replace(problem, representation=r)))


# --- guess ---------------------------------------------------------------------------------------------------------


def thin(study: Study) -> Study:
    """Keep every second azimuth, and the lowest and the highest place of each."""
    targets = study.targets
    a, b = targets.every
    last = max(j for _, j in targets.places)
    return replace(study, targets=replace(targets, every=(2 * a, last or b)))


def list_guesses(study: Study, folder: Path) -> list[TaskList]:
    """Start every task from the interpolation without inputs, as the paper's protocol does, and with its own inputs.

    The targets come by ever finer grids, so a part of the list covers the whole cylinder.
    """
    trials = (
        *list_interpolations(study, "paper", "paper", "zero"),
        *list_interpolations(study, PROTOCOL, "guess", "dynamic"),
    )
    order = {place: k for k, place in enumerate(study.targets.spread)}
    return [TaskList(folder, study, tuple(sorted(trials, key=lambda trial: order[trial.task.place])))]


WITHOUT, WITH = "0", "inverse dynamics"
_GUESSES = {("paper", "zero"): WITHOUT, ("guess", "dynamic"): WITH}
ByGuess = Mapping[tuple[str, str], Mapping[Place, Attempt]]  # attempts by representation and inputs of the guess


def answer_guess(results: Results) -> Section | None:
    """Compare guesses over the places at which both were tried, in all representations that were started from both."""
    rows: list[tuple[Cell, ...]] = []
    apart: list[tuple[Cell, ...]] = []
    sentences: list[str] = []
    for weights in results.study.costs:
        groups = _pair_guesses(results, weights)
        for (name, guess), found in groups.items():
            rows.append((name_set(weights), name, guess, len(found), *_count(list(found.values()), results)))
        shares = [_compare_guesses(groups), *(_compare_forms(groups, guess) for guess in (WITHOUT, WITH))]
        if groups and all(share.pairs for share in shares):
            apart += [(name_set(weights), *share.row) for share in shares]
            places = len(next(iter(groups.values())))
            sentences.append(_describe_shares(weights, shares, places, len(results.study.targets.places)))
    if not rows:
        return None
    columns: tuple[str, ...] = (
        "cost",
        "representation",
        "inputs of the guess",
        "tasks",
        "solved",
        "in a higher minimum",
    )
    columns += ("iterations, median", "CPU s, median", "CPU s, all")
    note = "The motion is the same interpolation; a higher minimum lies above the lowest cost of either guess."
    items: list[Table | Picture] = [Table("By the inputs of the guess", columns, tuple(rows), note)]
    if apart:
        columns = (
            "cost",
            "changed",
            "held",
            "pairs of solves",
            "in different minima %",
            "iterations, ratio",
            "CPU, ratio",
        )
        note = (
            "Each pair of solves has the same target and differs in one thing alone. Representations whose programs "
            "have the same solutions and sizes are one formulation here: IMPL for SEMI, EXP1-O for EXP2-O, EXP1-A for "
            "EXP2-A. Ratios are geometric means of the larger by the smaller number."
        )
        items.insert(0, Table("Guess and formulation, apart", columns, tuple(apart), note))
    exchanged = _count_exchanges(results)
    if exchanged:
        columns = ("cost", "representation", "in a higher minimum by itself", "from another's solution")
        columns += ("then in that minimum",)
        note = (
            "A representation that ended in a higher minimum was started again from the best motion of another. Where "
            "it stays in that motion's minimum, both programs have this minimum, and it is the way from the guess that "
            "differs, not the formulation's set of minima."
        )
        items.append(Table("Why higher minima", columns, tuple(exchanged), note))
    title = "The share of the initial guess, and the cause of higher minima"
    return Section("guess", title, " ".join(sentences), tuple(items))


def _pair_guesses(results: Results, weights: Weights) -> dict[tuple[str, str], dict[Place, Attempt]]:
    """Return the attempts at the places that all compared representations share, by representation and guess."""
    groups: dict[tuple[str, str], dict[Place, Attempt]] = {}
    for a in results.attempts:
        if (a.part, a.guess) in _GUESSES and a.task.weights == weights:
            groups.setdefault((a.task.representation, _GUESSES[a.part, a.guess]), {})[a.task.place] = a
    compared = [name for name in results.representations if {(name, WITHOUT), (name, WITH)} <= groups.keys()]
    keys = [(name, guess) for name in compared for guess in (WITHOUT, WITH)]
    if not keys:
        return {}
    common = sorted(set.intersection(*(set(groups[key]) for key in keys)))
    return {key: {place: groups[key][place] for place in common} for key in keys} if common else {}


@dataclass(frozen=True)
class Share:
    """The differences between pairs of solves that differ in the guess alone, or in the formulation alone."""

    changed: str
    held: str
    pairs: int
    different: float  # % of pairs in different minima
    iterations: float  # geometric mean of the larger by the smaller number
    cpu: float  # likewise

    @property
    def row(self) -> tuple[Cell, ...]:
        """Return the cells of a table."""
        numbers = (_round(self.different), _round(self.iterations), _round(self.cpu))
        return (self.changed, self.held, self.pairs, *numbers)


def _compare_guesses(groups: ByGuess) -> Share:
    """Compare the two guesses of each target in each formulation."""
    names = [name for name in FORMULATIONS if (name, WITH) in groups]
    pairs = [(a, groups[name, WITH][place]) for name in names for place, a in groups[name, WITHOUT].items()]
    return _share("inputs of the guess", "formulation", pairs)


def _compare_forms(groups: ByGuess, guess: str) -> Share:
    """Compare all pairs of formulations at each target, from one guess."""
    found = [groups[name, guess] for name in FORMULATIONS if (name, guess) in groups]
    pairs = [(a, two[place]) for one, two in itertools.combinations(found, 2) for place, a in one.items()]
    return _share("formulation", f"inputs of the guess: {guess}", pairs)


def _share(changed: str, held: str, pairs: Sequence[tuple[Attempt, Attempt]]) -> Share:
    solved = [(a, b, a.cost, b.cost) for a, b in pairs if a.cost is not None and b.cost is not None]
    different = sum(abs(x - y) > SHOWN * min(abs(x), abs(y)) for _, _, x, y in solved)

    def ratio(number: Callable[[Attempt], float]) -> float:
        logs = [abs(math.log(number(a) / number(b))) for a, b, _, _ in solved]
        return math.exp(float(np.mean(logs))) if logs else math.nan

    share = 100 * different / len(solved) if solved else math.nan
    iterations = ratio(lambda a: max(a.iterations, 1))
    return Share(changed, held, len(solved), share, iterations, ratio(lambda a: max(a.cpu_seconds, 1e-6)))


def _describe_shares(weights: Weights, shares: Sequence[Share], places: int, targets: int) -> str:
    guess, without, own = shares
    return (
        f"With {name_set(weights)}, at {places} of {targets} targets: other inputs of the guess lead a formulation to "
        f"another minimum in {guess.different:.3g}% of the tasks, and change its iterations by a factor of "
        f"{guess.iterations:.3g}. Another formulation, with the same guess, does so in {without.different:.3g}% of the "
        f"pairs, by a factor of {without.iterations:.3g}, without inputs, and in {own.different:.3g}%, by a factor of "
        f"{own.iterations:.3g}, with the inputs of the motion's inverse dynamics."
    )


def _count(attempts: Sequence[Attempt], results: Results) -> tuple[Cell, ...]:
    solved = [a for a in attempts if a.cost is not None]
    higher = sum(is_higher(a.cost, results.lowest[a.task.place, a.task.weights]) for a in solved)
    cpu = [a.cpu_seconds for a in solved]
    iterations = float(np.median([a.iterations for a in solved])) if solved else None
    return (len(solved), higher, iterations, _round(float(np.median(cpu))) if cpu else None, _round(sum(cpu)))


def _count_exchanges(results: Results) -> list[tuple[Cell, ...]]:
    rows: list[tuple[Cell, ...]] = []
    for weights in results.study.costs:
        for name in results.representations:
            own = [a for a in results.pick(weights, name, "robust") if a.part == "exchange"]
            if not own:
                continue
            first = [a for a in results.pick(weights, name, "robust") if a.part == "interpolation"]
            higher = sum(is_higher(a.cost, results.lowest[a.task.place, weights]) for a in first)
            reached = sum(not is_higher(a.cost, float(a.guess.split()[-1])) for a in own)
            rows.append((name_set(weights), name, higher, len(own), reached))
    return rows


# --- repeats -------------------------------------------------------------------------------------------------------


def list_repeats(study: Study, folder: Path) -> list[TaskList]:
    """Solve a small part of the targets again, by the paper's protocol, on cylinders whose radii differ by rounding."""
    few = thin(thin(study))
    lists = []
    for k in range(1, REPEATS + 1):
        radius = few.targets.radius * (1 + k * NUDGE)
        moved = replace(few, targets=replace(few.targets, radius=radius))
        lists.append(TaskList(folder, moved, tuple(list_interpolations(moved, PROTOCOL, "repeats", "zero"))))
    return lists


# --- derivatives ---------------------------------------------------------------------------------------------------


def list_derivatives(problem: Problem, folder: Path, representations: Sequence[Representation]) -> list[TaskList]:
    """Solve the problem itself with derivatives from three sources, in rounds."""
    study = _alone(problem, representations)
    task = {r: Task((0, 0), study.costs[0], r.value) for r in study.representations}
    start = Interpolation("dynamic")
    return [
        TaskList(
            folder,
            study,
            tuple(Trial(task[r], PROTOCOL, "derivatives", f"{way}, round {k}", start, k) for k in range(ROUNDS)),
            way,
        )
        for r in study.representations
        for way in WAYS
    ]


def answer_derivatives(attempts: Sequence[Attempt], ways: Mapping[str, Mapping[str, int]]) -> Section | None:
    """Compare the quickest rounds; `ways` are the flops of each kernel by the way it was written."""
    rows: list[tuple[Cell, ...]] = []
    found = _find_quickest(attempts)
    for name, quickest in found.items():
        ours = quickest.get(WAYS[0])
        for way, a in quickest.items():
            evaluating = 1e3 * a.cpu_seconds_evaluating / max(a.iterations, 1)
            rest = 1e3 * (a.cpu_seconds - a.cpu_seconds_evaluating) / max(a.iterations, 1)
            times = None
            if ours is not None:
                times = _round(evaluating / (1e3 * ours.cpu_seconds_evaluating / max(ours.iterations, 1)))
            row = (name, way, a.iterations, _round(evaluating), times)
            rows.append((*row, _round(rest), _round(a.cpu_seconds), a.cost))
    if not rows:
        return None
    columns: tuple[str, ...] = ("representation", "derivatives", "iterations", "evaluation ms per iteration", "by ours")
    columns += ("algebra ms per iteration", "CPU s", "cost")
    note = (
        f"The quickest of {ROUNDS} rounds, from the interpolation with the inputs of its inverse dynamics. The "
        "equations are the same; programs are assembled in the same way from Jacobians and adjoint Jacobians."
    )
    items: list[Table | Picture] = [draw_parts(_list_parts(found))]
    items.append(Table("Solves, by the source of derivatives", columns, tuple(rows), note))
    if ways:
        flops = tuple(
            (kernel, way, count, _round(count / min(by_way.values())))
            for kernel, by_way in ways.items()
            for way, count in by_way.items()
        )
        note = "tape: differentiated operation by operation, and simplified; the others: by mechanics."
        columns = ("kernel", "way", "flops", "by the least")
        items.append(Table("Flops of derivatives, by the way of writing them", columns, flops, note))
    title = "Generated sensitivities against algorithmic differentiation"
    return Section("derivatives", title, _compare_ways(found), tuple(items))


def summarise_derivatives(attempts: Sequence[Attempt]) -> tuple[str, Picture] | None:
    """Answer the question about the source of derivatives in one sentence and one chart."""
    found = {name: quickest for name, quickest in _find_quickest(attempts).items() if WAYS[0] in quickest}
    rows = {
        name: {way: _evaluate(a) / _evaluate(quickest[WAYS[0]]) for way, a in quickest.items()}
        for name, quickest in found.items()
    }
    others = [way for way in WAYS[1:] if any(way in row for row in rows.values())]
    if not others:
        return None
    parts = []
    for way in others:
        ratios = [row[way] for row in rows.values() if way in row]
        pairs = [(quickest[WAYS[0]], quickest[way]) for quickest in found.values() if way in quickest]
        whole = [theirs.cpu_seconds / ours.cpu_seconds for ours, theirs in pairs]
        quicker = sum(ratio > 1 for ratio in ratios)
        parts.append(
            f"{way}, takes {_span(ratios)} times as long, and is slower in {quicker} of {len(ratios)} "
            f"representations (whole solves: {_span(whole)} times)"
        )
    least = min(min(row[way] for way in others if way in row) for row in rows.values())
    sentence = (
        "Are recursive sensitivities quicker than algorithmic differentiation of the same equations? "
        f"{'Yes' if least > 1 else 'Not always'}: beside the generated functions and derivatives, {'; '.join(parts)}."
    )
    return sentence, draw_ratios(rows, WAYS)


def _evaluate(attempt: Attempt) -> float:
    """Return the time of functions and derivatives per iteration [s]."""
    return max(attempt.cpu_seconds_evaluating, 1e-9) / max(attempt.iterations, 1)


def _find_quickest(attempts: Sequence[Attempt]) -> dict[str, dict[str, Attempt]]:
    """Return the quickest solve by representation and by the source of derivatives."""
    found: dict[str, dict[str, Attempt]] = {}
    for a in attempts:
        if a.part == "derivatives" and a.cost is not None:
            quickest = found.setdefault(a.task.representation, {})
            way = a.guess.rpartition(", ")[0]
            if way not in quickest or a.cpu_seconds < quickest[way].cpu_seconds:
                quickest[way] = a
    return found


def _list_parts(found: Mapping[str, Mapping[str, Attempt]]) -> list[tuple[str, float, float]]:
    """Return the time of an iteration for evaluation and for the rest, in ms, by representation and source."""
    return [
        (f"{name}, {way}", scale * a.cpu_seconds_evaluating, scale * (a.cpu_seconds - a.cpu_seconds_evaluating))
        for name, quickest in found.items()
        for way, a in quickest.items()
        for scale in [1e3 / max(a.iterations, 1)]
    ]


def _compare_ways(found: Mapping[str, Mapping[str, Attempt]]) -> str:
    """Answer in one sentence: how much faster generated derivatives are, alone and in a whole solve."""
    parts = []
    for way in WAYS[1:]:
        pairs = [(quickest[WAYS[0]], quickest[way]) for quickest in found.values() if {WAYS[0], way} <= quickest.keys()]
        if pairs:
            alone = [theirs.cpu_seconds_evaluating / ours.cpu_seconds_evaluating for ours, theirs in pairs]
            whole = [theirs.cpu_seconds / ours.cpu_seconds for ours, theirs in pairs]
            parts.append(
                f"by {way}, functions and derivatives take {_span(alone)} times the time of the generated ones, and "
                f"the whole solve {_span(whole)} times"
            )
    return f"Of the same equations: {'; '.join(parts)}." if parts else ""


def _span(values: Sequence[float]) -> str:
    least, most = f"{min(values):.2g}", f"{max(values):.2g}"
    return least if least == most else f"{least} to {most}"


# --- grids ---------------------------------------------------------------------------------------------------------


def list_grids(problem: Problem, folder: Path, grids: Sequence[tuple[Family, int, int]]) -> list[TaskList]:
    """Solve the problem itself on many grids, and re-simulate."""
    lists = []
    for family, degree, intervals in grids:
        other = replace(problem, family=family, degree=degree, intervals=intervals)
        study = _alone(other, GRID_REPRESENTATIONS)
        trials = tuple(
            Trial(
                Task((0, 0), study.costs[0], r.value), PROTOCOL, "grids", "dynamic", Interpolation("dynamic"), 0, True
            )
            for r in study.representations
        )
        lists.append(TaskList(folder, study, trials))
    return lists


@dataclass(frozen=True)
class GridPoint:
    """A solve on a grid."""

    problem: Problem
    attempt: Attempt

    @property
    def series(self) -> str:
        """Return the name of a line in a chart: everything except N."""
        p = self.problem
        return f"{self.attempt.task.representation}, {p.family.value} {p.degree}"


def answer_grids(points: Sequence[GridPoint]) -> Section | None:
    """Chart CPU time against the defect, and against the error of the cost on the same control grid."""
    if not points:
        return None
    finest: dict[int, Attempt] = {}  # by N: the solve with the least defect, the reference of the others
    for p in points:
        if p.attempt.defect is not None and p.attempt.cost is not None:
            held = finest.get(p.problem.intervals)
            if held is None or held.defect is None or p.attempt.defect < held.defect:
                finest[p.problem.intervals] = p.attempt
    best = {n: a.cost for n, a in finest.items() if a.cost is not None}
    last = best[max(best)] if best else math.nan
    rows: list[tuple[Cell, ...]] = []
    errors: dict[int, float] = {}
    for k, p in enumerate(points):
        a, n = p.attempt, p.problem.intervals
        error = None
        if a.cost is not None and n in best and a is not finest[n]:
            error = errors[k] = abs(a.cost - best[n]) / abs(best[n])
        control = None if n not in best else abs(best[n] - last) / abs(last)
        row = (a.task.representation, p.problem.family.value, p.problem.degree, n, a.status, a.iterations)
        rows.append((*row, _round(a.cpu_seconds), a.cost, _round(error), _round(control), _round(a.defect)))
    columns: tuple[str, ...] = ("representation", "points", "degree", "N", "status", "iterations", "CPU s", "cost")
    columns += ("error of the cost", "error of the control grid", "defect")
    note = (
        "Inputs are constant over an interval, so N makes the control grid, too. The error of the cost is the "
        "difference from the solve with the least defect on the same control grid. The error of the grid itself is the "
        "difference of its best cost from the best cost on the finest grid. The defect is the largest error of an "
        "interval by re-simulation [rad, rad/s]."
    )
    attempts = [p.attempt for p in points]
    place = {id(p.attempt): (p, k) for k, p in enumerate(points)}

    def read(
        number: Callable[[GridPoint, int], float | None],
    ) -> Callable[[Attempt], tuple[float | None, float | None]]:
        return lambda a: (a.cpu_seconds if a.cost is not None else None, number(*place[id(a)]))

    def series(a: Attempt) -> str:
        return place[id(a)][0].series

    pictures = (
        draw_scatter(
            attempts,
            series,
            read(lambda p, _: p.attempt.defect),
            ("CPU time [s]", "largest defect of an interval [rad, rad/s]", "N grows along a line"),
            "CPU time against the defect",
            "Crosses: solved, but the integrator gave up. The table lists failed solves.",
        ),
        draw_scatter(
            attempts,
            series,
            read(lambda _, k: errors.get(k)),
            ("CPU time [s]", "relative error of the cost", "N grows along a line"),
            "CPU time against the error of the cost on the same control grid",
            "Crosses: the reference of the others.",
        ),
    )
    return Section("grids", "Other transcriptions", "", (*pictures, Table("Grids", columns, tuple(rows), note)))


# --- shooting ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Transcription:
    """A way to turn equations of motion into constraints between mesh points."""

    name: str
    form: Form
    integrator: IntegratorName = "collocation"
    steps: int = 1

    def apply(self, problem: Problem) -> Problem:
        """Return the problem in this form."""
        return replace(problem, form=self.form, integrator=self.integrator, steps=self.steps)


TRANSCRIPTIONS = (
    Transcription(COLLOCATION, Form.STANDARD),
    Transcription("shooting, the collocation's method", Form.SHOOTING),
    Transcription("shooting, two steps of RK4", Form.SHOOTING, "rk4", 2),
)


def list_shooting(study: Study, folder: Path, systems: Sequence[System]) -> list[TaskList]:
    """Solve for the extreme targets and the middle, and other systems, by collocation and by multiple shooting."""
    i, j = len(study.targets.azimuths) - 1, len(study.targets.heights) - 1
    few = replace(study.targets, every=(max(i // 2, 1), max(j, 1)))
    cost = tuple(w for w in study.costs if w[1] > 0) or study.costs
    studies = [(folder, replace(study, targets=few, costs=cost))]
    studies += [(system.folder, _alone(system.problem, GRID_REPRESENTATIONS)) for system in systems]
    lists = []
    for place, each in studies:
        for way in TRANSCRIPTIONS:
            problem = way.apply(each.problem)
            own = replace(each, problem=problem, representations=_admit(problem, GRID_REPRESENTATIONS))
            lists.append(TaskList(place, own, tuple(list_interpolations(own, PROTOCOL, "shooting", "dynamic"))))
    return [tasks for tasks in lists if tasks.trials]


def name_transcription(problem: Problem) -> str:
    """Return the name of the transcription of a problem."""
    return next(way.name for way in TRANSCRIPTIONS if way.apply(problem) == problem)


def answer_shooting(found: Sequence[tuple[Problem, Sequence[Attempt]]]) -> Section | None:
    """Compare robustness and effort."""
    rows: list[tuple[Cell, ...]] = []
    lowest: dict[tuple[str, Place], float] = {}
    for problem, attempts in found:
        for a in attempts:
            key = (problem.name, a.task.place)
            lowest[key] = min(lowest.get(key, math.inf), math.inf if a.cost is None else a.cost)
    for problem, attempts in sorted(found, key=lambda x: x[0].name):
        for name in dict.fromkeys(a.task.representation for a in attempts):
            own = [a for a in attempts if a.task.representation == name]
            solved = [a for a in own if a.cost is not None]
            worse = sum(a.cost > (1 + APART) * lowest[problem.name, a.task.place] for a in solved if a.cost is not None)
            row = (problem.name, name_transcription(problem), name, len(own), len(solved), worse)
            numbers: tuple[Cell, ...] = (None, None, None, None)
            if solved:
                iterations, cpu = ([getattr(a, x) for a in solved] for x in ("iterations", "cpu_seconds"))
                each = [1e3 * s / max(i, 1) for s, i in zip(cpu, iterations, strict=True)]
                marks = [_round(float(np.median(x))) for x in (iterations, cpu, each)]
                numbers = (solved[0].variables, *marks)
            rows.append((*row, *numbers))
    if not rows:
        return None
    columns: tuple[str, ...] = ("problem", "transcription", "representation", "tasks", "solved", "in a higher minimum")
    columns += ("variables", "iterations, median", "CPU s, median", "CPU ms per iteration, median")
    note = (
        f"A higher minimum is one {APART:.1%} above the lowest of all rows: integrators of other accuracy have other "
        "costs. The balance of the pole has no constraint at its end."
    )
    return Section("shooting", "Multiple shooting", "", (Table("Multiple shooting", columns, tuple(rows), note),))


# --- systems -------------------------------------------------------------------------------------------------------


def list_systems(systems: Sequence[System]) -> list[TaskList]:
    """Solve other problems in all representations, from two guesses."""
    lists = []
    for system in systems:
        study = _alone(system.problem, Representation)
        trials = tuple(
            Trial(Task((0, 0), study.costs[0], r.value), PROTOCOL, "systems", inputs, Interpolation(inputs), 0, True)
            for inputs in ("zero", "dynamic")
            for r in study.representations
        )
        lists.append(TaskList(system.folder, study, trials))
    return lists


def answer_systems(found: Sequence[tuple[str, Sequence[Attempt]]]) -> Section | None:
    """List the effort for each system, in each representation, from each guess."""
    rows: list[tuple[Cell, ...]] = []
    for name, attempts in found:
        own = [a for a in attempts if a.part == "systems"]
        lowest = min((a.cost for a in own if a.cost is not None), default=math.nan)
        for a in own:
            verdict = "not solved" if a.cost is None else "higher minimum" if is_higher(a.cost, lowest) else "lowest"
            each = _round(1e3 * a.cpu_seconds / max(a.iterations, 1))
            row = (name, a.task.representation, a.guess, a.status, verdict, a.iterations, _round(a.cpu_seconds), each)
            rows.append((*row, a.cost, _round(a.defect)))
    if not rows:
        return None
    columns: tuple[str, ...] = (
        "problem",
        "representation",
        "inputs of the guess",
        "status",
        "minimum",
        "iterations",
        "CPU s",
    )
    columns += ("CPU ms per iteration", "cost", "defect")
    note = "The lowest minimum is the lowest cost of all attempts at the problem in this table."
    return Section("systems", "Other systems", "", (Table("Other systems", columns, tuple(rows), note),))


def _round(value: float | None) -> float | None:
    """Round to four digits: further digits are noise."""
    return None if value is None else float(f"{value:.4g}")
