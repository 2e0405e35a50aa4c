"""Candidates -> times: check that all compute the same, then time all of them in turn."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.candidates import PINOCCHIO, Call, Candidate
from benchmarks.compilation import Workshop
from benchmarks.preparation import Prepared, load_mechanism
from benchmarks.timing import Stopwatch, draw_states, find_disagreements, measure_rounds, one_core

STATES = 512  # 100 kB for an arm: more than the first cache holds, less than the second
CHECKED = 5  # states at which all must agree


@dataclass(frozen=True)
class Measurement:
    """What was found of one candidate."""

    candidate: Candidate
    times: NDArray[np.float64] | None  # ns per call, by round; None: it was counted only


@dataclass(frozen=True)
class Study:
    """What was found on one mechanism."""

    model: str
    measurements: tuple[Measurement, ...]


class DisagreementError(Exception):
    """Candidates that do not compute the same: their times mean nothing."""


def measure(
    prepared: Prepared, workshop: Workshop, rounds: int, report: Callable[[str], None] = lambda _: None
) -> Study:
    """Check that candidates agree, then time them in turn. Raises DisagreementError, ArithmeticError, BuildError."""
    pool = draw_states(prepared.sizes, STATES)
    coded: Sequence[tuple[Candidate, Call]] = [
        (candidate, Call(candidate, candidate.code, pool)) for candidate in prepared.candidates if candidate.code
    ]
    for library in {c.code.library for c in prepared.candidates if c.code and c.author == PINOCCHIO}:
        load_mechanism(library, prepared.mechanism)
    report("checking that all agree")
    together = defaultdict(list)
    for candidate, call in coded:
        together[candidate.function].append(call)
    faults = [fault for state in range(CHECKED) for fault in find_disagreements(together, state)]
    if faults:
        raise DisagreementError("\n".join(faults))
    stopwatch = Stopwatch(workshop.compile_timing())
    found = []
    with one_core():
        for k, times in enumerate(measure_rounds(stopwatch, [call for _, call in coded], rounds), 1):
            found.append(times)
            report(f"timing: round {k} of {rounds}")
    times_of = dict(zip((id(candidate) for candidate, _ in coded), np.array(found).T, strict=True))
    return Study(prepared.model, tuple(Measurement(c, times_of.get(id(c))) for c in prepared.candidates))
