"""The lowest optimum of every target and cost in a record, with a certificate of its optimality.

Others can compare their optima with these. A certificate checks the conditions of first and second order at the stored
motion, with its own multipliers: see `mbsrun.ocp.solving.certificate`. It shows a local minimum; a lower one may
exist. Motions
with whole turns of joints without limits are listed apart: the paper's motions make none. For all motions, the table
shows how far such joints go beyond their starts and ends, and come back.

A certificate takes a second or two. The record keeps each by a hash of problem, motion, kernels and code, so that a
page that is written again takes seconds.
"""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from functools import cache, partial
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter

from mbsrun import ocp
from mbsrun.measuring.sections import Cell, Section, Table
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.starts import list_turning
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.problem.structure import Structure, structure
from mbsrun.ocp.searching.attempts import INDEPENDENT, is_higher
from mbsrun.ocp.searching.search import LostMotionError, OutOfTimeError
from mbsrun.ocp.searching.study import Place, Study, Weights
from mbsrun.ocp.solution.record import Attempt, Record, Task
from mbsrun.ocp.solving.certificate import Certificate, certify_motion
from mbsrun.ocp.solving.solve import Solver

OPTIMA = "optima.csv"  # the file
UNCHECKED = "not checked"  # for want of time, or of the motion
STATIONARY = 1e-5  # largest remainder of the first-order conditions, relative to the largest entry of the gradient
FEASIBLE = 1e-7  # largest violation; IPOPT relaxes bounds by 1e-8
BEYOND = "beyond start and end [turns]"  # a column
FAR = 0.5  # turns


@dataclass(frozen=True)
class Optimum:
    """The lowest optimum of a target and a cost, without whole turns or with some."""

    task: Task  # in the representation that found it
    turns: str  # whole turns of joints without limits; "" without
    cost: float
    found: int  # representations whose solve by the paper's protocol ended in it
    tried: int  # representations that were solved by the paper's protocol
    hits: int  # random starts of the robust protocol, independent of each other, that ended in it
    starts: int  # these starts at the target: with turns, the starts that make some
    certificate: Certificate | None  # None: there was no time, or no motion
    beyond: float | None  # the most turns of a joint without limits beyond its start and its end; None: as above

    @property
    def is_certified(self) -> bool:
        """Return whether the conditions of optimality of both orders hold."""
        c = self.certificate
        return c is not None and c.is_minimum and c.stationarity <= STATIONARY * c.gradient and c.violation <= FEASIBLE


Recall = Callable[[Task, str, str], Trajectory | None]  # by task, protocol and turns, the motion of the best attempt


def list_optima(study: Study, record: Record, plant: Plant, recall: Recall, end: float = math.inf) -> Iterator[Optimum]:
    """Yield the optima of a record by cost and target: the lowest without whole turns, then the lowest with some.

    After `end`, a moment of the monotonic clock, no certificate begins. A restored attempt keeps the certificate of
    the page that it came from. Without one, `recall` solves it again.
    """
    by_target: dict[tuple[Place, Weights], list[Attempt]] = {}
    for a in record.attempts():
        by_target.setdefault((a.task.place, a.task.weights), []).append(a)
    solvers: dict[Structure, Solver] = {}
    for weights in study.costs:
        for place in study.targets.places:
            tried = by_target.get((place, weights), [])
            for is_turned in (False, True):
                found = _find_attempt(tried, is_turned=is_turned)
                if found is None or found.cost is None:
                    continue
                problem = study.state(found.task)
                kept = record.best_motion(found.task, found.protocol, turns=found.turns)
                motion = _Motion(kept, partial(recall, found.task, found.protocol, found.turns))
                key = _name(problem, kept, plant) if kept else name_known(found.task, found.turns, found.cost)
                paper = [a for a in tried if a.protocol == "paper" and a.cost is not None]
                parts = ("turns",) if is_turned else INDEPENDENT
                starts = [a for a in tried if a.protocol == "robust" and a.part in parts]

                def certify(problem: Problem = problem, motion: _Motion = motion) -> str:
                    kind = structure(problem)
                    if kind not in solvers:
                        solvers[kind] = Solver(problem, plant)
                    return json.dumps(asdict(certify_motion(problem, solvers[kind], motion.find())))

                def measure(problem: Problem = problem, motion: _Motion = motion) -> str:
                    return json.dumps(measure_beyond(motion.find(), list_turning(problem, plant.manifest)))

                certificate = _find_or_derive(record, key, certify, end)
                beyond = _find_or_derive(record, name_beyond(key), measure, end)
                yield Optimum(
                    found.task,
                    found.turns,
                    found.cost,
                    _count_hits(paper, found),
                    len(paper),
                    _count_hits(starts, found),
                    len(starts),
                    None if certificate is None else TypeAdapter(Certificate).validate_json(certificate),
                    None if beyond is None else float(json.loads(beyond)),
                )


class _Motion:
    """The motion of an attempt, which is found when it is needed."""

    def __init__(self, kept: Trajectory | None, recall: Callable[[], Trajectory | None]) -> None:
        self._kept, self._recall = kept, recall

    def find(self) -> Trajectory:
        self._kept = self._kept or self._recall()
        assert self._kept is not None, "a record keeps every best attempt"
        return self._kept


def measure_beyond(motion: Trajectory, joints: Sequence[int]) -> float:
    """Return the most turns that some joints go beyond their starts and their ends."""
    q = motion.q[:, list(joints)]
    if q.size == 0:
        return 0.0
    above, below = q.max(axis=0) - np.maximum(q[0], q[-1]), np.minimum(q[0], q[-1]) - q.min(axis=0)
    return float(np.maximum(above, below).max() / (2 * np.pi))


def name_known(task: Task, turns: str, cost: float) -> str:
    """Name a certificate of a page, whose motion is not at hand."""
    return f"certificate of {task.row} {turns or 'none'} {cost!r}"


def name_beyond(key: str) -> str:
    """Name the turns beyond the ends of a motion, by the name of its certificate."""
    return f"beyond of {key}"


def _name(problem: Problem, motion: Trajectory, plant: Plant) -> str:
    """Return a hash of everything that a certificate depends on."""
    digest = hashlib.sha256(b"certificate 1" + _fingerprint_code())
    digest.update(plant.manifest.model_hash.encode())
    digest.update(TypeAdapter(Problem).dump_json(problem))
    for field in fields(motion):
        values = getattr(motion, field.name)
        digest.update(f"{field.name} {values.shape} {values.dtype}".encode() + values.tobytes())
    return digest.hexdigest()


@cache
def _fingerprint_code() -> bytes:
    """Return a hash of the modules that transcribe problems and check their optima."""
    digest = hashlib.sha256()
    for file in sorted(Path(ocp.__file__).parent.rglob("*.py")):
        digest.update(file.name.encode() + hashlib.sha256(file.read_bytes()).digest())
    return digest.digest()


def _find_or_derive(record: Record, key: str, derive: Callable[[], str], end: float) -> str | None:
    """Return a text of the record, or derive it where there is time, and where its motion is found again."""

    def derive_in_time() -> str:
        if time.monotonic() > end:
            raise OutOfTimeError
        return derive()

    try:
        return record.find_or_derive(key, derive_in_time)
    except (OutOfTimeError, LostMotionError):
        return None


def _find_attempt(attempts: Sequence[Attempt], *, is_turned: bool) -> Attempt | None:
    """Return the attempt with the lowest cost, with whole turns or without; of equal ones, the first of the record."""
    solved = [a for a in attempts if a.cost is not None and bool(a.turns) == is_turned]
    return min(solved, key=lambda a: a.cost or 0.0, default=None)


def _count_hits(attempts: Sequence[Attempt], found: Attempt) -> int:
    """Count the attempts that ended in the minimum that one found."""
    assert found.cost is not None, "attempts without a cost are left out"
    return sum(a.turns == found.turns and not is_higher(a.cost, found.cost) for a in attempts)


COLUMNS = (
    "azimuth [rad]",
    "height [m]",
    "k1",
    "k2",
    "cost",
    "representation",
    "whole turns",
    BEYOND,
    "found by",
    "of",
    "independent finds",
    "of starts",
    "stationarity",
    "gradient",
    "violation",
    "complementarity",
    "active bounds",
    "second order",
    "certified",
)


def tabulate_optima(study: Study, optima: Sequence[Optimum]) -> Table:
    """Return a row for each optimum, with every digit of its cost."""
    rows = tuple(_write_row(study, optimum) for optimum in optima)
    note = (
        "Stationarity is the largest entry of the first-order conditions, beside the largest entry of the cost's "
        "gradient; both are divided by the largest weight. `found by` counts the representations whose solve by the "
        "paper's protocol ended in this optimum; `independent finds` counts random starts of the robust protocol. A "
        "target has a second row where motions with whole turns of a joint without limits were found."
    )
    return Table("Lowest optima", COLUMNS, rows, note, is_folded=True)


def _write_row(study: Study, optimum: Optimum) -> tuple[Cell, ...]:
    (i, j), (k1, k2), c = optimum.task.place, optimum.task.weights, optimum.certificate
    place = (study.targets.azimuths[i], study.targets.heights[j], k1, k2)
    checked: tuple[Cell, ...] = (None,) * 5 + (UNCHECKED,) * 2
    if c is not None:
        numbers = tuple(float(f"{x:.2g}") for x in (c.stationarity, c.gradient, c.violation, c.complementarity))
        checked = (*numbers, c.active, "yes" if c.is_minimum else "no", "yes" if optimum.is_certified else "no")
    return (
        *place,
        optimum.cost,
        optimum.task.representation,
        optimum.turns or "none",
        None if optimum.beyond is None else float(f"{optimum.beyond:.3f}"),
        optimum.found,
        optimum.tried,
        optimum.hits,
        optimum.starts,
        *checked,
    )


def describe_optima(study: Study, optima: Sequence[Optimum], file: str) -> Section:
    """Describe how many optima are certified, and how often they were found; `file` holds all of them."""
    sentences = [text for weights in study.costs for text in _describe_cost(weights, optima)]
    sentences.append(f"[{file}]({file}) lists all of them, for comparison with others.")
    table = tabulate_optima(study, optima)
    return Section("optima", "The lowest optimum of every target", " ".join(sentences), (table,))


def _describe_cost(weights: Weights, optima: Sequence[Optimum]) -> Iterator[str]:
    own = [o for o in optima if o.task.weights == weights and not o.turns]
    if not own:
        return
    name = f"With k1 = {weights[0]:g}, k2 = {weights[1]:g}"
    sure, alone = sum(o.is_certified for o in own), sum(o.found == 1 for o in own)
    yield (
        f"{name} and no whole turns, the conditions of both orders hold at {sure} of {len(own)} lowest optima"
        f"{_describe_unchecked(own)}; {alone} "
        "of them were found by a single representation of the paper's protocol."
    )
    yield from _describe_beyond(own)
    searched = [o for o in own if o.starts]
    if searched:
        never, all_starts = sum(not o.hits for o in searched), sum(o.starts for o in searched)
        yield (
            f"Independent random starts found them {sum(o.hits for o in searched)} times of {all_starts}, and never at "
            f"{never} of {len(searched)} targets."
        )
    turned = [o for o in optima if o.task.weights == weights and o.turns]
    if turned:
        without = {o.task.place: o.cost for o in own}
        lower = [o for o in turned if is_higher(without.get(o.task.place), o.cost)]
        yield (
            f"Motions with whole turns were found at {len(turned)} targets, and are lower at {len(lower)} of them; the "
            f"conditions of both orders hold at {sum(o.is_certified for o in turned)} of the {len(turned)}"
            f"{_describe_unchecked(turned)}."
        )


def _describe_beyond(optima: Sequence[Optimum]) -> Iterator[str]:
    """Describe joints that turn away and come back, which makes no whole turn."""
    far, unknown = sum(o.beyond is not None and o.beyond > FAR for o in optima), sum(o.beyond is None for o in optima)
    yield (
        f"In {far} of them a joint without limits goes more than half a turn beyond its start and its end, and comes "
        f"back{f' ({unknown} were not measured)' if unknown else ''}."
    )


def _describe_unchecked(optima: Sequence[Optimum]) -> str:
    unchecked = sum(o.certificate is None for o in optima)
    return f" ({unchecked} were not checked)" if unchecked else ""
