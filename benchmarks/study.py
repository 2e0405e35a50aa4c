"""Candidates -> times: check that all compute the same, then time all of them in turn."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.candidates import PINOCCHIO, Candidate
from benchmarks.preparation import Prepared, Sizes, load_mechanism
from mbsrun.measuring.functions import Array, Code, Numbers
from mbsrun.measuring.timing import Watch, measure_rounds

STATES = 512  # 100 kB for an arm: more than the first cache holds, less than the second
CHECKED = 5  # states at which all must agree


@dataclass(frozen=True)
class Measurement:
    """The times of one candidate."""

    candidate: Candidate
    times: NDArray[np.float64] | None  # ns per call, by round; None: it was counted only


@dataclass(frozen=True)
class Study:
    """The measurements on one mechanism."""

    model: str
    measurements: tuple[Measurement, ...]


class DisagreementError(Exception):
    """Candidates compute different results: their times have no meaning."""


@dataclass(frozen=True)
class Entry:
    """A candidate, loaded, and its inputs for all states."""

    candidate: Candidate
    code: Code
    inputs: list[Numbers]

    @property
    def name(self) -> str:
        """Return author and way."""
        return f"{self.candidate.author}, {self.candidate.way}"

    def evaluate(self, state: int) -> dict[str, Array]:
        """Return the results for one state, as dense matrices. Raises ArithmeticError."""
        (status,), (results,) = self.code.call([x[state : state + 1] for x in self.inputs])
        if status:
            raise ArithmeticError(f"{self.name}: status {status} in state {state}")
        return results


def load(candidate: Candidate, pool: Mapping[str, Array]) -> Entry | None:
    """Load a candidate for states; return None for one that was counted only."""
    if candidate.code is None:
        return None
    blank = 0.0 if candidate.author == PINOCCHIO else np.nan  # it expects zeros where branches do not meet
    code = Code(candidate.code, blank=blank)
    return Entry(candidate, code, code.lay(pool))


def draw_states(sizes: Sizes, states: int, seed: int = 1) -> dict[str, Array]:
    """Draw states: an array (states, size) for each input by name."""
    rng = np.random.default_rng(seed)
    n, m = sizes.joints, sizes.driven
    return {
        "q": rng.uniform(-np.pi, np.pi, (states, n)),
        "qd": rng.uniform(-3, 3, (states, n)),
        "qdd": rng.uniform(-10, 10, (states, n)),
        "u": rng.uniform(-20, 20, (states, m)),
        "adj_Phi": rng.uniform(-1, 1, (states, n)),
        "adj_qdd": rng.uniform(-1, 1, (states, n)),
    }


def measure(prepared: Prepared, rounds: int, report: Callable[[str], None] = lambda _: None) -> Study:
    """Check that candidates agree, then time them in turn. Raises DisagreementError, ArithmeticError, BuildError."""
    pool = draw_states(prepared.sizes, STATES)
    for library in {c.code.library for c in prepared.candidates if c.code and c.author == PINOCCHIO}:
        load_mechanism(library, prepared.mechanism)
    entries = [entry for candidate in prepared.candidates if (entry := load(candidate, pool)) is not None]
    report("checking that all agree")
    together = defaultdict(list)
    for entry in entries:
        together[entry.candidate.function].append(entry)
    faults = [fault for state in range(CHECKED) for fault in find_disagreements(together, state)]
    if faults:
        raise DisagreementError("\n".join(faults))
    found = []
    for k, times in enumerate(measure_rounds([Watch(e.code, e.inputs) for e in entries], rounds), 1):
        found.append(times)
        report(f"timing: round {k} of {rounds}")
    times_of = dict(zip((id(entry.candidate) for entry in entries), np.array(found).T, strict=True))
    return Study(prepared.model, tuple(Measurement(c, times_of.get(id(c))) for c in prepared.candidates))


def find_disagreements(entries: Mapping[str, Sequence[Entry]], state: int, tolerance: float = 1e-9) -> list[str]:
    """Compare results of each function with its first entry, relative to the largest number of a result."""
    faults = []
    for function, (first, *others) in entries.items():
        reference = first.evaluate(state)
        for other in others:
            for name, value in other.evaluate(state).items():
                expected = reference.get(name)
                if expected is None or not value.size:
                    continue
                error = float(np.abs(value - expected).max() / max(1.0, float(np.abs(expected).max())))
                if not error <= tolerance:
                    faults.append(f"{function}: {name} of {other.name}: off by {error:.1e}")
    return faults
