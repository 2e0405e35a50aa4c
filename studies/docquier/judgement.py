"""Judge the claims of the paper on a run, for several thresholds of one minimum and for the scatter of iterations.

A verdict that changes with the threshold of "the same minimum" is a property of the threshold, not of the paper. A
verdict that changes when iterations are drawn again from their scatter is inside the scatter. The report names both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from studies.docquier.claims import CLAIMS, Claim
from studies.docquier.judges import CONFIRMED, REFUTED
from studies.docquier.results import Results

UNMEASURED = "not measured"
TURNS = "depends on the threshold"
INSIDE = "inside the scatter"
VERDICTS = (CONFIRMED, REFUTED, TURNS, INSIDE, UNMEASURED)

SHOWN = 1e-2  # relative difference of two costs that is visible in the paper's box plots
THRESHOLDS = (1e-6, 1e-4, 1e-3, SHOWN, 5e-2)
DRAWS = 200  # of all iterations
SURE = 0.95  # share of the draws that must agree


@dataclass(frozen=True)
class Judgement:
    """The verdict of a run about one claim."""

    claim: Claim
    verdict: str  # one of VERDICTS
    numbers: str  # at the threshold SHOWN
    by_threshold: tuple[str, ...] = ()  # the verdict at each of THRESHOLDS
    share: float | None = None  # of the draws that confirm; None where iterations do not matter, or have no spread


def judge_all(results: Results) -> list[Judgement]:
    """Judge every claim, in the paper's order."""
    by_threshold = [results.with_same(same) for same in THRESHOLDS]
    source, shown = np.random.default_rng(0), results.with_same(SHOWN)
    draws = [shown.resample(source) for _ in range(DRAWS)] if results.spreads else []
    return [_judge(claim, by_threshold, draws) for claim in CLAIMS]


def _judge(claim: Claim, by_threshold: Sequence[Results], draws: Sequence[Results]) -> Judgement:
    findings = [claim.judge(results) for results in by_threshold]
    found = findings[THRESHOLDS.index(SHOWN)]
    if found is None:
        return Judgement(claim, UNMEASURED, "")
    verdicts = tuple(UNMEASURED if f is None else f.verdict for f in findings)
    share = _share(claim, draws) if claim.scatters and draws else None
    verdict = found.verdict
    if len(set(verdicts)) > 1:
        verdict = TURNS
    elif share is not None and not (share >= SURE or share <= 1 - SURE):
        verdict = INSIDE
    return Judgement(claim, verdict, found.numbers, verdicts, share)


def _share(claim: Claim, draws: Sequence[Results]) -> float:
    findings = [claim.judge(results) for results in draws]
    return sum(f is not None and f.verdict == CONFIRMED for f in findings) / len(findings)


def write_thresholds(judgement: Judgement) -> str:
    """Describe the thresholds at which the verdict changes; return "" where it never does."""
    if len(set(judgement.by_threshold)) < 2:
        return ""
    return "; ".join(f"{same:g}: {verdict}" for same, verdict in zip(THRESHOLDS, judgement.by_threshold, strict=True))
