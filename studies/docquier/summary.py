"""The first section of the page: the results of the run in a few sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbsrun.measuring.sections import Cell, Picture, Section, Table
from studies.docquier.figures import list_sets, name_set
from studies.docquier.judgement import SHOWN, Judgement
from studies.docquier.results import Results
from studies.docquier.robustness import describe_lower
from studies.docquier.tables import count_verdicts


def summarise_run(results: Results, judgements: Sequence[Judgement], answer: tuple[str, Picture] | None) -> Section:
    """Write the summary: the study's question, size, verdicts, and one row for each cost and representation.

    `answer` is the sentence and the chart about the sources of derivatives, where they were compared.
    """
    targets, names = len(results.study.targets.places), len(results.representations)
    text = (
        f"The paper's protocol on {targets} targets, {len(results.study.costs)} costs and {names} representations. "
        f"Claims of the paper: {count_verdicts(judgements)}. A higher minimum lies more than {SHOWN:.0%} above "
        f"the lowest cost of the solves that started as the paper's did. {describe_lower(results)}"
    ).rstrip()
    rows = tuple(row for weights in list_sets(results) for row in _list_rows(results.with_same(SHOWN), weights))
    columns = ("cost", "representation", "tasks", "solved", "in a higher minimum", "iterations, median")
    note = "The paper's protocol alone. Differences of medians count only beyond the scatter, which is listed below."
    table = Table("Summary", (*columns, "CPU s, median"), rows, note)
    items: list[Table | Picture] = [table] if rows else []
    if answer is not None:
        text = f"{answer[0]} {text}"
        items.insert(0, answer[1])
    return Section("summary", "Summary", text, tuple(items))


def _list_rows(results: Results, weights: tuple[float, float]) -> list[tuple[Cell, ...]]:
    rows: list[tuple[Cell, ...]] = []
    for name in results.representations:
        own = results.pick(weights, name)
        solved = [a for a in own if a.cost is not None]
        if not solved:
            continue
        medians = [float(np.median(results.values(weights, name, figure))) for figure in ("iterations", "cpu")]
        higher = len(results.higher(weights, name))
        rows.append((name_set(weights), name, len(own), len(solved), higher, *(float(f"{m:.3g}") for m in medians)))
    return rows
