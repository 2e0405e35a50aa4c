"""Tabulate the results of a run as in the paper, beside the numbers of the paper."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from mbsrun.measuring.sections import Cell, Table
from studies.docquier.figures import list_sets, name_set
from studies.docquier.judgement import DRAWS, SHOWN, SURE, VERDICTS, Judgement, write_thresholds
from studies.docquier.published import COMPLEXITY, EFFORTS, SIZES
from studies.docquier.results import FIGURES, Results, find_outliers
from studies.docquier.spread import Spread


def tabulate(results: Results) -> list[Table]:
    """Return all tables that have numbers."""
    makers = (_tabulate_complexity, _tabulate_sizes, _tabulate_efforts, _tabulate_success, _tabulate_boxes)
    return [table for make in makers if (table := make(results)) is not None]


def tabulate_claims(judgements: Sequence[Judgement]) -> Table:
    """List every claim of the paper with its verdict and the numbers that decide."""
    rows = tuple(
        (
            j.verdict,
            j.claim.words,
            j.numbers,
            write_thresholds(j),
            None if j.share is None else round(100 * j.share),
            j.claim.place,
            j.claim.meaning,
        )
        for j in judgements
    )
    columns: tuple[str, ...] = ("by this run", "what the paper says", "numbers", "where the verdict turns")
    columns += ("% of draws that confirm", "where", "read as")
    note = (
        f"{count_verdicts(judgements)}. The words are the paper's, shortened. Two minima count as one where their "
        f"costs differ by less than {SHOWN:.0%}, as the paper's box plots show them; the fourth column lists other "
        f"thresholds where they change the verdict. Statements about iterations are judged again on {DRAWS} draws from "
        f"the scatter of perturbed repeats: a verdict stands where {SURE:.0%} of the draws agree."
    )
    return Table("Claims of the paper", columns, rows, note)


def count_verdicts(judgements: Sequence[Judgement]) -> str:
    """Count the claims by verdict, as text."""
    counts = Counter(j.verdict for j in judgements)
    return "; ".join(f"{verdict}: {counts[verdict]}" for verdict in VERDICTS if counts[verdict])


def tabulate_spreads(spreads: Sequence[Spread]) -> Table | None:
    """Tabulate the scatter of iterations, by cost and representation."""
    if not spreads:
        return None
    rows = tuple(
        (name_set(s.weights), s.representation, s.tasks, s.solves, _round(s.deviation), _round(s.widest), s.apart)
        for s in spreads
    )
    columns: tuple[str, ...] = ("cost", "representation", "tasks", "solves", "deviation of ln(iterations)")
    columns += ("most by fewest, at worst", "tasks that end in different minima")
    note = (
        "Solves from the same guess that differ by rounding alone: repeats of a task for targets a few units in the "
        "last place apart; in a record without them, targets at opposite azimuths, which are mirror images."
    )
    return Table("Scatter of iterations", columns, rows, note)


def _tabulate_complexity(results: Results) -> Table | None:
    if not results.growth:
        return None
    sizes = [n for n, _ in results.growth[0].flops]
    rows = tuple(
        (
            g.formulation,
            COMPLEXITY[g.formulation],
            "none" if g.degree is None else g.degree,
            *(count for _, count in g.flops),
        )
        for g in results.growth
    )
    columns: tuple[str, ...] = ("formulation", "paper", "degree found", *(f"N = {n}" for n in sizes))
    note = "Flops of chains of N equal bodies with full inertias; the degree of the polynomial in N, by differences."
    return Table("Table 1: complexity", columns, rows, note)


def _tabulate_sizes(results: Results) -> Table | None:
    rows: list[tuple[Cell, ...]] = []
    for name in results.representations:
        size = results.size(name)
        if size is not None:
            rows.append((name, *(value for pair in zip(size, SIZES[name], strict=True) for value in pair)))
    if not rows:
        return None
    figures = ("variables", "constraints", "nonzeros of the Jacobian", "nonzeros of the Hessian")
    columns: tuple[str, ...] = ("representation", *(column for figure in figures for column in (figure, "paper")))
    return Table("Table 3: size of the NLP", columns, tuple(rows), "The paper's numbers are for N = 100, degree 4.")


def _tabulate_efforts(results: Results) -> Table | None:
    if not results.efforts:
        return None
    rows = tuple(
        (name, effort.flops, EFFORTS[name][0], effort.equations, EFFORTS[name][1]) for name, effort in results.efforts
    )
    note = "Φ; M and c; γ; ν, with every number of the model at run time and masses lumped; by the paper's counting."
    return Table("Table 4: operations", ("formulation", "flops", "paper", "equations", "paper"), rows, note)


def _tabulate_success(results: Results) -> Table | None:
    rows: list[tuple[Cell, ...]] = []
    for weights in list_sets(results):
        for name in results.representations:
            own = results.pick(weights, name)
            solved, higher = sum(a.cost is not None for a in own), len(results.higher(weights, name))
            rates = (_share(solved, len(own)), _share(solved - higher, len(own)))
            rows.append((name_set(weights), name, len(own), solved, rates[0], higher, rates[1]))
    if not rows:
        return None
    columns: tuple[str, ...] = (
        "cost",
        "representation",
        "tasks",
        "solved",
        "success %",
        "in a higher minimum",
        "in the lowest %",
    )
    note = "The lowest minimum is the lowest cost of the solves from the interpolation, in any representation."
    return Table("Success rates", columns, tuple(rows), note)


def _tabulate_boxes(results: Results) -> Table | None:
    """Tabulate the numbers of the box plots."""
    rows: list[tuple[Cell, ...]] = []
    for weights in list_sets(results):
        for figure in FIGURES:
            for name in results.representations:
                values = results.values(weights, name, figure)
                if values.size:
                    marks = np.percentile(values, (25, 50, 75))
                    numbers = (*marks, values.mean(), values.min(), values.max())
                    row = tuple(_round(float(x)) for x in numbers)
                    rows.append((name_set(weights), figure, name, values.size, *row, find_outliers(values).size))
    if not rows:
        return None
    columns: tuple[str, ...] = (
        "cost",
        "figure",
        "representation",
        "solved",
        "25 %",
        "median",
        "75 %",
        "mean",
        "least",
        "most",
    )
    note = "CPU in s, per iteration in ms. Evaluation covers functions and derivatives; the rest is linear algebra."
    return Table("Numbers of Fig. 9 to 11", (*columns, "outliers"), tuple(rows), note)


def _share(part: int, whole: int) -> float | None:
    return round(100 * part / whole, 1) if whole else None


def _round(value: float) -> float:
    return float(f"{value:.5g}")
