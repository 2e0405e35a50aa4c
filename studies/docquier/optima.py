"""The lowest optimum of every target and cost in a record, with a certificate of its optimality.

Others can compare their optima with these. A certificate checks the conditions of first and second order at the stored
motion, with its own multipliers: see `mbsrun.ocp.certificate`. It shows a local minimum; a lower one may exist.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from mbsrun.measuring.sections import Cell, Section, Table
from mbsrun.ocp.attempts import find_lowest, is_higher
from mbsrun.ocp.certificate import Certificate, certify_motion
from mbsrun.ocp.plant import Plant
from mbsrun.ocp.record import Attempt, Record, Task
from mbsrun.ocp.solve import Solver
from mbsrun.ocp.structure import Structure, structure
from mbsrun.ocp.study import Place, Study, Weights

STATIONARY = 1e-5  # largest remainder of the first-order conditions, relative to the largest entry of the gradient
FEASIBLE = 1e-7  # largest violation; IPOPT relaxes bounds by 1e-8


@dataclass(frozen=True)
class Optimum:
    """The lowest optimum of a target and a cost."""

    task: Task  # in the representation that found it
    cost: float
    found: int  # representations whose solve by the paper's protocol ended in it
    tried: int  # representations that were solved by the paper's protocol
    certificate: Certificate

    @property
    def is_certified(self) -> bool:
        """Return whether the conditions of optimality of both orders hold."""
        c = self.certificate
        return c.is_minimum and c.stationarity <= STATIONARY * c.gradient and c.violation <= FEASIBLE


def list_optima(study: Study, record: Record, plant: Plant) -> Iterator[Optimum]:
    """Yield the optima of a record without whole turns, by cost and target."""
    attempts = [a for a in record.attempts() if a.cost is not None and not a.turns]
    lowest = find_lowest(attempts)
    solvers: dict[Structure, Solver] = {}
    for weights in study.costs:
        for place in study.targets.places:
            found = _find_attempt(attempts, place, weights)
            if found is None:
                continue
            problem = study.state(found.task)
            motion = record.best_motion(found.task, found.protocol)
            solver = solvers.setdefault(structure(problem), Solver(problem, plant))
            assert motion is not None, "a record keeps the motion of every best attempt"
            own = [a for a in attempts if (a.task.place, a.task.weights, a.protocol) == (place, weights, "paper")]
            hits = sum(not is_higher(a.cost, lowest[place, weights]) for a in own)
            assert found.cost is not None, "attempts without a cost are left out"
            yield Optimum(found.task, found.cost, hits, len(own), certify_motion(problem, solver, motion))


def _find_attempt(attempts: Sequence[Attempt], place: Place, weights: Weights) -> Attempt | None:
    """Return the attempt with the lowest cost; of equal ones, the first of the record."""
    own = [a for a in attempts if (a.task.place, a.task.weights) == (place, weights)]
    return min(own, key=lambda a: a.cost or 0.0, default=None)


def tabulate_optima(study: Study, optima: Sequence[Optimum]) -> Table:
    """Return a row for each optimum, with every digit of its cost."""
    columns: tuple[str, ...] = ("azimuth [rad]", "height [m]", "k1", "k2", "cost", "representation", "found by", "of")
    columns += (
        "stationarity",
        "gradient",
        "violation",
        "complementarity",
        "active bounds",
        "second order",
        "certified",
    )
    rows = tuple(_write_row(study, optimum) for optimum in optima)
    note = (
        "Stationarity is the largest entry of the first-order conditions, beside the largest entry of the cost's "
        "gradient; both are divided by the largest weight. `found by` counts the representations whose solve by the "
        "paper's protocol ended in this optimum."
    )
    return Table("Lowest optima", columns, rows, note, is_folded=True)


def _write_row(study: Study, optimum: Optimum) -> tuple[Cell, ...]:
    (i, j), (k1, k2), c = optimum.task.place, optimum.task.weights, optimum.certificate
    place = (study.targets.azimuths[i], study.targets.heights[j], k1, k2)
    numbers = tuple(float(f"{x:.2g}") for x in (c.stationarity, c.gradient, c.violation, c.complementarity))
    verdicts = ("yes" if c.is_minimum else "no", "yes" if optimum.is_certified else "no")
    return (
        *place,
        optimum.cost,
        optimum.task.representation,
        optimum.found,
        optimum.tried,
        *numbers,
        c.active,
        *verdicts,
    )


def describe_optima(study: Study, optima: Sequence[Optimum], file: str) -> Section:
    """Describe how many optima are certified, and how often they were found; `file` holds all of them."""
    sentences = []
    for weights in study.costs:
        own = [o for o in optima if o.task.weights == weights]
        if own:
            sure, alone = sum(o.is_certified for o in own), sum(o.found == 1 for o in own)
            sentences.append(
                f"With k1 = {weights[0]:g}, k2 = {weights[1]:g} the conditions of both orders hold at {sure} of "
                f"{len(own)} lowest optima; {alone} of them were found by a single representation."
            )
    sentences.append(f"[{file}]({file}) lists all of them, for comparison with others.")
    return Section(
        "optima", "The lowest optimum of every target", " ".join(sentences), (tabulate_optima(study, optima),)
    )
