"""Report the results of the robust protocol by cost, and the effort of its parts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from mbsrun.measuring.sections import Cell, Section, Table
from mbsrun.ocp.guessing.starts import describe_turns
from mbsrun.ocp.searching.attempts import count_finds, find_lowest, is_higher, list_turned, summarise
from mbsrun.ocp.searching.search import Progress, find_progress
from mbsrun.ocp.searching.study import Place, Study, Targets, Weights
from mbsrun.ocp.searching.trials import COUNTS
from mbsrun.ocp.solution.record import SAME, Attempt, Record, Task
from studies.docquier.figures import name_set
from studies.docquier.judgement import SHOWN
from studies.docquier.results import ROBUST, Results

PARTS = ("interpolation", *COUNTS, "neighbours", "mirror", "hops", "exchange")  # in their order
Row = tuple[Cell, ...]

TEXT = (
    "A search for lower minima: random starts, neighbours, mirror images, hops, other representations. It finds "
    "minima, and cannot show that no lower one exists. The number of independent starts that found the lowest known "
    "cost is a measure of trust. A task is left in a higher minimum if any attempt in the record, of this protocol "
    f"or another, in this representation or another, found a cost that is lower by more than {SAME:g} of it. "
    "Motions with whole turns of joints without limits compete among themselves, and are listed on their own; all "
    "statements are about motions without. A joint may also turn away and back, which counts as no turn. "
    "The optima count here, not the times, so solves take the "
    "project's own method, mbs. The paper's protocol and the questions take IPOPT, since their times are compared with "
    "the paper's. The table of environments counts attempts by method and linear solver."
)


@dataclass(frozen=True)
class State:
    """The progress of the search for a cost, and its finished targets: all, a slice of them, or none."""

    progress: Progress
    done: Targets | None


def find_state(study: Study, record: Record) -> State:
    """Return the progress of the search for a study of one cost, with the largest finished slice of targets."""
    for targets in list_slices(study.targets):
        progress = find_progress(replace(study, targets=targets), record)
        if progress.is_through:
            return State(find_progress(study, record), targets)
    return State(find_progress(study, record), None)


def list_slices(targets: Targets) -> list[Targets]:
    """List the slices of targets with both ends of azimuths and heights, the largest slice first."""
    ends = [count - 1 for count in (len(targets.azimuths), len(targets.heights))]
    i, j = (
        [k for k in range(step, max(end, step) + 1, step) if end % k == 0]
        for step, end in zip(targets.every, ends, strict=True)
    )
    slices = [replace(targets, every=every) for every in product(i, j)]
    return sorted(slices, key=lambda found: -len(found.places))


def report_robust(results: Results, states: Mapping[Weights, State]) -> Section | None:
    """Report the remaining tasks and the effort for each cost."""
    own: dict[Weights, list[Attempt]] = {}
    for weights in results.study.costs:
        found = [a for a in results.attempts if a.protocol == "robust" and a.task.weights == weights]
        if found:
            own[weights] = found
    if not own:
        return None
    texts = [describe_outcome(results, weights, attempts, states[weights]) for weights, attempts in own.items()]
    balance = tuple(_balance(results, weights, attempts, states[weights]) for weights, attempts in own.items())
    columns: tuple[str, ...] = ("cost", "targets", "tasks", "tried", "solved", "in a higher minimum", "by at most %")
    columns += ("attempts", "CPU s", "CPU s by task tried", "the search", "through for targets")
    left = Table("Remaining tasks", columns, balance, "A task is a target in one representation.")
    columns = ("cost", "part", "attempts", "solved", "first in the lowest minimum, targets", "iterations, median")
    columns += ("CPU s, median", "CPU s, all", "% of it")
    note = (
        "Random starts, neighbours, mirror images and hops are tried in the first representation alone; the others get "
        "what it found by exchange. "
        "A part is first in the lowest minimum of a target if no part before it, in this round or an earlier one, was."
    )
    rows = tuple(row for weights, attempts in own.items() for row in _list_parts(results, weights, attempts))
    every = [attempt for attempts in own.values() for attempt in attempts]
    turned = (_tabulate_turns(every),) if list_turned(every) else ()
    lower = (_tabulate_lower(results, every),) if _list_lower(results, every) else ()
    parts = Table("Effort of the parts", columns, rows, note)
    return Section(
        "robust",
        "The robust protocol",
        " ".join((TEXT, *texts)),
        (left, *lower, parts, _tabulate_all(results), *turned),
    )


def describe_outcome(results: Results, weights: Weights, attempts: Sequence[Attempt], state: State) -> str:
    """Describe the remaining tasks."""
    name, progress = f"With {name_set(weights)}", state.progress
    if state.done is None:
        return f"{name} {_describe_progress(progress)}."
    places = set(state.done.places)
    best = {task: cost for task, cost in _find_best(attempts).items() if task.place in places}
    tasks, higher = len(places) * len(results.representations), len(_list_higher(results, best))
    solved = f"all {tasks} tasks are solved" if len(best) == tasks else f"{len(best)} of {tasks} tasks are solved"
    left = f"{higher or 'none'} {'is' if higher < 2 else 'are'} left in a higher minimum"
    finds = _describe_finds(attempts)
    text = f"{solved}, and {left} than another start in this record found; lower ones may exist; {finds}"
    if progress.is_through:
        return f"{name} {text}."
    whole = len(results.study.targets.places)
    return (
        f"{name} {_describe_progress(progress)}; for a slice of {len(places)} of {whole} targets it is through: {text}."
    )


def _describe_finds(attempts: Sequence[Attempt]) -> str:
    """Describe the number of independent starts that found the lowest cost of a target."""
    finds = count_finds(attempts)
    if not finds:
        return "no independent start found any"
    shares, starts = [find.found for find in finds], sorted(find.starts for find in finds)
    return (
        f"of {starts[0]} to {starts[-1]} independent starts at a target, {min(shares)} to {max(shares)} found its "
        f"lowest cost known, none at {sum(share == 0 for share in shares)} of {len(finds)} targets"
    )


def _list_lower(results: Results, attempts: Sequence[Attempt]) -> list[Row]:
    """List the targets at which the robust protocol found a minimum lower than the solves from the interpolation."""
    finds = {(f.place, f.weights): f for f in count_finds(attempts)}
    turned: dict[tuple[Place, Weights], float] = {}
    for t in list_turned(attempts):
        turned[t.place, t.weights] = min(t.cost, turned.get((t.place, t.weights), t.cost))
    rows: list[Row] = []
    for (place, weights), cost in sorted(find_lowest([a for a in attempts if not a.turns]).items()):
        before = results.lowest.get((place, weights))
        if before is not None and cost < (1 - SHOWN) * before:
            own = [a for a in attempts if (a.task.place, a.task.weights, a.cost, a.turns) == (place, weights, cost, "")]
            find, turn = finds.get((place, weights)), turned.get((place, weights))
            row = (name_set(weights), f"{place[0]},{place[1]}", _round(before), _round(cost), own[0].part, own[0].round)
            numbers = (None, None) if find is None else (find.found, find.starts)
            rows.append((*row, *numbers, None if turn is None else _round(turn)))
    return rows


def _tabulate_lower(results: Results, attempts: Sequence[Attempt]) -> Table:
    columns: tuple[str, ...] = ("cost", "target", "from the interpolation", "robust protocol", "found by", "in round")
    columns += ("independent finds", "of starts", "with whole turns")
    note = (
        f"Targets at which the robust protocol found a cost lower by more than {SHOWN:.0%}: azimuth and height as "
        "numbers of the grid; the lowest of the solves that started as the paper's did; the lowest of the robust "
        "protocol without whole turns, and with some."
    )
    return Table("Minima below the paper's protocol", columns, tuple(_list_lower(results, attempts)), note)


def _tabulate_turns(attempts: Sequence[Attempt]) -> Table:
    """List the lowest costs with whole turns."""
    rows = tuple(
        (
            name_set(t.weights),
            f"{t.place[0]},{t.place[1]}",
            describe_turns(t.turns),
            _round(t.cost),
            None if t.lowest is None else _round(t.lowest),
        )
        for t in list_turned(attempts)
    )
    columns = ("cost", "target", "whole turns", "lowest cost with them", "lowest without")
    return Table(
        "Whole turns of joints without limits", columns, rows, "The search found these costs; lower ones may exist."
    )


def _describe_progress(progress: Progress) -> str:
    return f"the search is under way, in round {progress.round}, with {progress.done} of {progress.trials} attempts"


def _balance(results: Results, weights: Weights, attempts: Sequence[Attempt], state: State) -> Row:
    best, places, progress = _find_best(attempts), results.study.targets.places, state.progress
    tasks = len(places) * len(results.representations)
    higher = _list_higher(results, best)
    above = [100 * (best[task] / results.known[task.place, weights] - 1) for task in higher]
    cpu = sum(a.cpu_seconds for a in attempts)
    progress_text = (
        "through" if progress.is_through else f"round {progress.round}: {progress.done} of {progress.trials}"
    )
    tried = len({a.task for a in attempts})
    through = 0 if state.done is None else len(state.done.places)
    numbers = (tried, len(best), len(higher), _round(max(above)) if above else None, len(attempts))
    return (name_set(weights), len(places), tasks, *numbers, _round(cpu), _round(cpu / tried), progress_text, through)


def describe_lower(results: Results) -> str:
    """Describe how far below the solves from the interpolation the robust protocol found minima, by cost."""
    texts = []
    for weights in results.study.costs:
        own = [a for a in results.attempts if a.protocol == ROBUST and a.task.weights == weights and not a.turns]
        found = {place: cost for (place, _), cost in find_lowest(own).items()}
        ratios = [cost / results.lowest[p, weights] for p, cost in found.items() if (p, weights) in results.lowest]
        lower = sorted(ratio for ratio in ratios if ratio < 1 - SHOWN)
        if ratios:
            least = f", down to {lower[0]:.2g} of it" if lower else ""
            tried = sorted(Counter(a.task.place for a in own).values())
            texts.append(
                f"With {name_set(weights)}, the robust protocol found minima lower by more than {SHOWN:.0%} at "
                f"{len(lower)} of {len(ratios)} targets{least}, by {tried[0]} to {tried[-1]} attempts at each."
            )
    return " ".join(texts)


def _list_parts(results: Results, weights: Weights, attempts: Sequence[Attempt]) -> list[Row]:
    first: dict[Place, Attempt] = {}
    for a in sorted(attempts, key=lambda a: (a.round, PARTS.index(a.part))):
        if not a.turns and not is_higher(a.cost, results.known.get((a.task.place, weights), np.inf)):
            first.setdefault(a.task.place, a)
    whole = sum(a.cpu_seconds for a in attempts)
    rows: list[Row] = []
    for part in PARTS:
        own = [a for a in attempts if a.part == part]
        solved = [a for a in own if a.cost is not None]
        if own:
            found = sum(a.part == part for a in first.values())
            iterations = float(np.median([a.iterations for a in solved])) if solved else None
            cpu = sum(a.cpu_seconds for a in own)
            median = _round(float(np.median([a.cpu_seconds for a in own])))
            row = (name_set(weights), part, len(own), len(solved), found, iterations, median, _round(cpu))
            rows.append((*row, round(100 * cpu / whole, 1)))
    return rows


def _tabulate_all(results: Results) -> Table:
    """Sum up the parts by representation."""
    rows: list[Row] = []
    for s in summarise([a for a in results.attempts if a.protocol == "robust"]):
        least, median, most = s.iterations
        row = (name_set(s.weights), s.representation, s.part, s.attempts, s.solved, s.higher)
        rows.append((*row, median, least, most, _round(s.cpu_median), _round(s.cpu_seconds)))
    columns: tuple[str, ...] = ("cost", "representation", "part", "attempts", "solved", "in a higher minimum")
    columns += ("iterations, median", "least", "most", "CPU s, median", "CPU s, all")
    note = '"result" is the best of all parts for each target; a higher minimum lies above the cost of another attempt.'
    return Table("Robust protocol, by representation", columns, tuple(rows), note)


def _find_best(attempts: Sequence[Attempt]) -> dict[Task, float]:
    best: dict[Task, float] = {}
    for a in attempts:
        if a.cost is not None and not a.turns:
            best[a.task] = min(a.cost, best.get(a.task, a.cost))
    return best


def _list_higher(results: Results, best: Mapping[Task, float]) -> list[Task]:
    return [task for task, cost in best.items() if is_higher(cost, results.known[task.place, task.weights])]


def _round(value: float) -> float:
    return float(f"{value:.4g}")
