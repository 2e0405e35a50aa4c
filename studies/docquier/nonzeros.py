"""Variants of the program of Docquier, Brüls and Fisette that could explain the nonzeros of their Table 3.

The upper triangle of the Lagrangian's Hessian has five groups of nonzeros: products of variables of one collocation
point, in all points; squares of the inputs; products of inputs of neighbouring intervals; second derivatives of the
sensors at the end; and, in an ODE form, of the accelerations at the end. The first group is read from the programs of
this project. The others have variants. All combinations are counted, and compared with the three numbers of the paper:
of implicit forms, of explicit forms with accelerations as variables, and of explicit forms as ODE.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from mbsrun.measuring.sections import Section, Table
from mbsrun.ocp.ground.functions import Indices
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.problem.problem import Problem, Representation
from mbsrun.ocp.solving.solve import Solver
from studies.docquier.published import SIZES

HESSIAN = 3  # the place of its nonzeros in SIZES
COMPARED = (Representation.IMPL, Representation.EXP1_A, Representation.EXP1_O)
Counts = tuple[int, ...]  # for each of COMPARED
Pair = tuple[int, int]


@dataclass(frozen=True)
class Groups:
    """The nonzeros of a program, by group."""

    points: int  # products of variables of one collocation point
    inputs: int  # products of inputs
    end: frozenset[Pair]  # products of variables at the end
    last: frozenset[Pair]  # products of the states of the last collocation point and its inputs

    @property
    def total(self) -> int:
        """Return all nonzeros."""
        return self.points + self.inputs + len(self.end)


def count_groups(problem: Problem, plant: Plant) -> Groups:
    """Count the nonzeros of the Hessian of a problem's program, by group."""
    solver = Solver(problem, plant)
    layout, functions = solver.transcription.layout, solver.program.casadi
    pattern = np.array(functions.hessian.sparsity_out(0).get_triplet())
    at_end = np.isin(pattern, layout.mesh[-1]).any(axis=0)
    of_inputs = np.isin(pattern, layout.inputs).all(axis=0)
    return Groups(
        points=int((~at_end & ~of_inputs).sum()),
        inputs=int(of_inputs.sum()),
        end=_name_pairs(pattern, layout.mesh[-1], layout.inputs[-1]),
        last=_name_pairs(pattern, layout.points[-1, -1], layout.inputs[-1]),
    )


def _name_pairs(pattern: Indices, states: Indices, inputs: Indices) -> frozenset[Pair]:
    """Return the nonzeros of some states, by themselves and with inputs, as pairs of places in both lists."""
    place = {int(v): k for k, v in enumerate((*states, *inputs))}
    pairs = (sorted((place[a], place[b])) for a, b in pattern.T.tolist() if a in place and b in place)
    return frozenset((i, j) for i, j in pairs if i < len(states))


@dataclass(frozen=True)
class Variant:
    """A way to write the program, with the nonzeros outside the collocation points."""

    parts: tuple[str, ...]
    rest: Counts


def list_variants(problem: Problem, plant: Plant, groups: Mapping[Representation, Groups]) -> Iterator[Variant]:
    """Combine all variants of all groups."""
    N, m, n = problem.intervals, len(plant.manifest.actuated), len(plant.manifest.coordinates)
    sensed, accelerated = groups[COMPARED[1]].end, groups[COMPARED[2]].last
    squares = {"each input squared": m * N, "inputs of all intervals but one": m * (N - 1), "no squares": 0}
    differences = {
        "differences of neighbours": m * (N - 1),
        "differences that close a circle": m * N,
        "differences with an interval beyond the end": m * (N + 1),
        "differences of every second interval": m * (N // 2),
        "differences of one input alone": N - 1,
        "differences over two intervals, too": m * (2 * N - 3),
        "differences of all inputs of neighbours": m * m * (N - 1),
        "no differences": 0,
    }
    products = {"inputs apart": 0, "products of the inputs of an interval": N * m * (m - 1) // 2}
    sensors = {
        "sensors by the coordinates that they read": sensed,
        "sensors by all coordinates": _pair_all(n),
        "sensors by the whole state": _pair_all(2 * n),
        "sensors linear": frozenset[Pair](),
    }
    last = {"accelerations at the end apart": accelerated, "accelerations at the last point": frozenset[Pair]()}
    ways = product(product(squares.items(), differences.items(), products.items()), sensors.items(), last.items())
    for cost, (sensor, read), (way, end) in ways:
        common = sum(count for _, count in cost)
        rest = (common + len(read), common + len(read), common + len(read | end))
        yield Variant((*(name for name, _ in cost), sensor, way), rest)


def _pair_all(size: int) -> frozenset[Pair]:
    return frozenset((i, j) for i in range(size) for j in range(i, size))


def explain_nonzeros(problem: Problem, plant: Plant) -> Section | None:
    """Compare all variants with the paper's Table 3; None for a program of another size."""
    variables = Solver(replace(problem, representation=COMPARED[0]), plant).program.casadi.variables
    if variables != SIZES[COMPARED[0].value][0]:
        return None
    groups = {r: count_groups(replace(problem, representation=r), plant) for r in COMPARED}
    printed = tuple(SIZES[r.value][HESSIAN] for r in COMPARED)
    left = tuple(count - groups[r].points for r, count in zip(COMPARED, printed, strict=True))
    variants = list(list_variants(problem, plant, groups))
    fitting = sum(v.rest == left for v in variants)
    most = max(v.rest[2] - v.rest[1] for v in variants)
    rows = tuple(
        (r.value, groups[r].points, groups[r].inputs, len(groups[r].end), groups[r].total, count, rest)
        for r, count, rest in zip(COMPARED, printed, left, strict=True)
    )
    columns = ("representation", "points", "inputs", "end", "all", "paper", "paper, beside the points")
    extra = groups[COMPARED[0]].total - printed[0]
    text = (
        f"Forms with accelerations as variables have {extra} nonzeros of the Hessian more here than in the paper's "
        "Table 3. All Jacobians agree, and so do the Hessians of ODE forms. The table below divides the nonzeros: "
        "products of variables of one collocation point, squares and products of inputs, and products of variables at "
        "the end. The paper's text fixes the first group. For the other two, its numbers leave "
        f"{left[0]} with accelerations as variables, and {left[2]} in ODE forms. Both have the same cost and the same "
        f"sensors, and the accelerations at the end explain {most} of the difference at most. Of {len(variants)} ways "
        f"to write these terms, {'none gives' if not fitting else f'{fitting} give'} the paper's three numbers: its "
        f"program treats the two kinds of forms differently, in a way that the paper does not describe. The {extra} "
        "nonzeros change neither the equations nor the optimum."
    )
    table = Table("Nonzeros of the Hessian, by group", columns, rows, "Of the upper triangle.")
    return Section("nonzeros", "The nonzeros of Table 3", text, (table,))
