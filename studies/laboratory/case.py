"""The parts of a case of the laboratory: trials, and the findings that they return.

A finding is a number with its bound, for one way to compute. A way is a formulation with its precision, a method of
integration, a representation of optimal control, or the responsible part of the program.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from mbsrun.measuring.store import Store

Report = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Loss:
    """The digits that an explicit formulation loses in one state."""

    mechanism: str  # its kind
    joints: int
    number: float  # the varied number: a ratio of masses, a distance from a lock [rad]
    state: int  # index of the random state
    way: str  # EXP1, EXP2
    condition: float  # of the mass matrix
    scaled: float  # the condition of the matrix scaled to a diagonal of ones
    estimate: float | None  # the error by the kernel `condition`; None: it promises no digit
    error: float | None  # of the accelerations, relative to the largest; None: the kernel returned a status
    backward: float | None  # residual relative to the sum of the absolute values of its terms
    failed: str = ""  # the joint of the status


@dataclass(frozen=True)
class Finding:
    """A result for one way, and whether it meets the criterion."""

    way: str
    quantity: str  # the meaning of the number
    value: float | None  # None: there is no number; the remark describes the event
    bound: float | None  # None: no number decides
    is_met: bool
    remark: str = ""
    case: str = ""
    trial: str = ""
    is_contrast: bool = False  # the way is known to fail: it must exceed the bound

    @property
    def excess(self) -> float:
        """Return the number over its bound: above 1 it misses the bound. Without a ratio, return 0 or infinity."""
        if self.value is None or not self.bound or not math.isfinite(self.value):
            return 0.0 if self.is_met and not self.is_contrast else math.inf
        return self.value / self.bound


@dataclass(frozen=True)
class Workspace:
    """The folder and the store of a trial."""

    folder: Path  # for model files
    losses: Store[Loss]
    program: str  # a hash of everything that findings depend on


@dataclass(frozen=True)
class Trial:
    """A part of a case that is measured and kept separately."""

    name: str
    measure: Callable[[Workspace], list[Finding]]
    is_long: bool = False


@dataclass(frozen=True)
class Case:
    """A way in which some method fails, and the criterion for this program."""

    id: str
    title: str
    setup: str  # the setup of the trials
    criterion: str
    trials: tuple[Trial, ...]
    exemption: str = ""  # the part that does not apply to this program


@dataclass(frozen=True)
class Verdict:
    """The verdict of a case about one way: the finding closest to its bound, or furthest beyond."""

    case: str
    way: str
    quantity: str
    value: float | None
    bound: float | None
    trial: str
    met: int  # findings that meet the criterion
    total: int
    remark: str
    is_contrast: bool = False

    @property
    def is_met(self) -> bool:
        """Return whether all findings meet the criterion."""
        return self.met == self.total


def check(way: str, quantity: str, value: float, bound: float, remark: str = "") -> Finding:
    """Demand that a number is at most `bound`; NaN fails."""
    return Finding(way, quantity, float(value), float(bound), bool(value <= bound), remark)


def show_failure(way: str, quantity: str, value: float, bound: float, remark: str = "") -> Finding:
    """Demand that a way which is known to fail exceeds `bound`; infinity does, NaN does not."""
    return Finding(way, quantity, float(value), float(bound), bool(value > bound), remark, is_contrast=True)


def find_worst(values: Iterable[float]) -> float:
    """Return the largest of some numbers; NaN where there is none, or where one of them is NaN."""
    found = [float(x) for x in values]
    return max(found) if found and not any(map(math.isnan, found)) else math.nan


def tell(way: str, quantity: str, value: float, remark: str = "") -> Finding:
    """Return a number without a bound."""
    return Finding(way, quantity, float(value), None, is_met=True, remark=remark)


def demand(way: str, quantity: str, is_met: object, remark: str) -> Finding:
    """Demand that something holds."""
    return Finding(way, quantity, None, None, bool(is_met), remark)


def judge(findings: Iterable[Finding]) -> list[Verdict]:
    """Sum up findings by case and way, in their order."""
    groups: dict[tuple[str, str], list[Finding]] = {}
    for finding in findings:
        groups.setdefault((finding.case, finding.way), []).append(finding)
    return [_sum_up(group) for group in groups.values()]


def _sum_up(findings: Sequence[Finding]) -> Verdict:
    worst = max(findings, key=lambda f: (not f.is_met, f.excess))
    met = sum(f.is_met for f in findings)
    return Verdict(
        worst.case,
        worst.way,
        worst.quantity,
        worst.value,
        worst.bound,
        worst.trial,
        met,
        len(findings),
        worst.remark,
        worst.is_contrast,
    )
