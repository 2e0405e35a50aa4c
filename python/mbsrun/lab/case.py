"""What a case of the laboratory is made of: trials, and the findings that they give.

A finding is one number of one way to compute, and what it must not exceed. A way is a formulation with its precision, a
method of integration, a representation of optimal control, or the part of the program that has to answer.
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
    """How many digits an explicit formulation loses in one state."""

    mechanism: str  # the kind of it
    joints: int
    number: float  # what is varied: a ratio of masses, a distance from a lock [rad]
    state: int  # which of those drawn
    way: str  # EXP1, EXP2
    condition: float  # of the mass matrix
    scaled: float  # the same, of the matrix scaled to a diagonal of ones
    told: float | None  # the error to expect, by the kernel `condition`; None: it says that no digit is left
    error: float | None  # of the accelerations, by the largest; None: a status came instead
    backward: float | None  # by how much the forces would have to be others, by what they are sums of
    failed: str = ""  # the joint that the status names


@dataclass(frozen=True)
class Finding:
    """What was found of one way, and whether that meets the criterion."""

    way: str
    quantity: str  # what the number is
    value: float | None  # None: there is no number, and the remark tells what happened
    bound: float | None  # what it must not exceed; None: no number decides
    is_met: bool
    remark: str = ""
    case: str = ""
    trial: str = ""
    is_contrast: bool = False  # the way is known to fail: it must exceed the bound, beside the one that does not

    @property
    def excess(self) -> float:
        """Return the number over its bound: beyond 1 it misses the bound. What has no such ratio is 0, or infinite."""
        if self.value is None or not self.bound or not math.isfinite(self.value):
            return 0.0 if self.is_met and not self.is_contrast else math.inf
        return self.value / self.bound


@dataclass(frozen=True)
class Workspace:
    """Where a trial works."""

    folder: Path  # for model files
    losses: Store[Loss]
    program: str  # names the version of everything that findings depend on


@dataclass(frozen=True)
class Trial:
    """A part of a case that is measured, and kept, by itself."""

    name: str
    measure: Callable[[Workspace], list[Finding]]
    is_long: bool = False


@dataclass(frozen=True)
class Case:
    """Something that goes wrong with some method, and what is demanded here."""

    id: str
    title: str
    setup: str  # what is done
    criterion: str
    trials: tuple[Trial, ...] = ()
    exemption: str = ""  # what of it does not apply to this program, and why


@dataclass(frozen=True)
class Verdict:
    """What the findings of a case say of one way: the one closest to its bound, or furthest beyond."""

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
        """Tell whether all findings meet the criterion."""
        return self.met == self.total


def check(way: str, quantity: str, value: float, bound: float, remark: str = "") -> Finding:
    """Demand that a number is at most `bound`; what is not a number is not."""
    return Finding(way, quantity, float(value), float(bound), bool(value <= bound), remark)


def show_failure(way: str, quantity: str, value: float, bound: float, remark: str = "") -> Finding:
    """Demand that a way which is known to fail exceeds `bound`; infinity does, and what is not a number does not."""
    return Finding(way, quantity, float(value), float(bound), bool(value > bound), remark, is_contrast=True)


def find_worst(values: Iterable[float]) -> float:
    """Return the largest of some numbers; not a number where there is none, or where one of them is not."""
    found = [float(x) for x in values]
    return max(found) if found and not any(map(math.isnan, found)) else math.nan


def tell(way: str, quantity: str, value: float, remark: str = "") -> Finding:
    """Give a number of which nothing is demanded."""
    return Finding(way, quantity, float(value), None, is_met=True, remark=remark)


def demand(way: str, quantity: str, is_met: object, remark: str) -> Finding:
    """Demand that something holds."""
    return Finding(way, quantity, None, None, bool(is_met), remark)


def judge(findings: Iterable[Finding]) -> list[Verdict]:
    """Sum up by case and way, in the order in which they come."""
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
