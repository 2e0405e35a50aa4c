"""Advice for one model: the fastest of the measured options that are accurate enough.

Advice depends on measurements of the model alone, not on other mechanisms or counts of operations. It lists the things
that were not measured.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from mbsrun.measuring.kernels import (
    ACCELERATIONS,
    EXACT,
    REDUCED_A,
    REDUCED_R,
    RESIDUAL,
    SLOPES_A,
    SLOPES_R,
    SLOPES_RA,
    SLOPES_RR,
)
from mbsrun.measuring.motions import Course, Standard
from mbsrun.measuring.points import Cost, KernelPoint, MotionPoint, SolvePoint

ALIKE = 1.1  # times count as equal within a tenth
NEEDS = {
    RESIDUAL: "torques for a motion",
    ACCELERATIONS: "motion under torques",
    SLOPES_R: "derivatives of the torques",
    SLOPES_A: "derivatives of the accelerations",
    REDUCED_R: "torques for a motion of independent joints",
    REDUCED_A: "motion of independent joints under torques",
    SLOPES_RR: "derivatives of the torques by independent joints",
    SLOPES_RA: "derivatives of the accelerations of independent joints",
}


@dataclass(frozen=True)
class Option:
    """A measured way to compute something."""

    need: str  # the purpose; options of one need compete
    choices: tuple[tuple[str, str], ...]  # formulation, precision, method, …: name and value
    cost: Cost | None
    unit: str  # of the cost
    error: float | None
    finding: str = ""  # why it failed

    def meets(self, accuracy: float) -> bool:
        """Return whether its measured error is small enough and nothing failed."""
        return self.cost is not None and self.error is not None and self.error <= accuracy and not self.finding

    @property
    def digits(self) -> float:
        """Return the order of the error, in thirds of a decade; smaller differences do not count."""
        return -math.inf if not self.error else round(3 * math.log10(self.error))

    @property
    def price(self) -> float:
        """Return the shortest time of the rounds: other programs lengthen the others."""
        return math.inf if self.cost is None else self.cost.shortest


@dataclass(frozen=True)
class Advice:
    """The best options for each need, and the measurements behind them."""

    model: str
    task: str
    accuracy: float
    meaning: str  # of an error
    options: tuple[Option, ...]
    unmeasured: tuple[str, ...]

    @property
    def needs(self) -> tuple[str, ...]:
        """List the needs of all options."""
        return tuple(dict.fromkeys(option.need for option in self.options))

    def choose(self, need: str) -> Option | None:
        """Return the most accurate option among the fastest that are accurate enough; None where none is."""
        good = [o for o in self.options if o.need == need and o.meets(self.accuracy)]
        limit = ALIKE * min((o.price for o in good), default=0.0)
        return min((o for o in good if o.price <= limit), key=lambda o: (o.digits, o.price), default=None)

    def shortlist(self, need: str) -> list[Option]:
        """Return one option of each series: the chosen one, or the fastest accurate one, or the most accurate one."""
        chosen = self.choose(need)

        def rank(option: Option) -> tuple[bool, float]:
            good = option.meets(self.accuracy)
            return not good, option.price if good else math.inf if option.error is None else option.error

        series: dict[tuple[tuple[str, str], ...], list[Option]] = {}
        for option in self.options:
            if option.need == need:
                series.setdefault(option.choices[:-1], []).append(option)
        first = (chosen if chosen in own else min(own, key=rank) for own in series.values())
        return sorted((option for option in first if option is not None), key=rank)

    @property
    def is_complete(self) -> bool:
        """Return whether every need has an option."""
        return all(self.choose(need) is not None for need in self.needs)


def advise_simulation(course: Course, standard: Standard, points: Sequence[MotionPoint], accuracy: float) -> Advice:
    """Choose formulation, method, and step or tolerance."""
    trusted = standard.accuracy <= accuracy / 2
    options = [
        Option(
            "motion",
            (
                ("formulation", p.formulation),
                ("precision", "float64"),
                ("method", p.method),
                (p.setting, f"{p.value:.3g}"),
            ),
            p.seconds,
            "s",
            p.error,
            p.finding or ("" if trusted else f"the reference is only known to {standard.accuracy:.0e}"),
        )
        for p in points
    ]
    motion = "the settings file's" if course.facts != "drawn" else "one that starts in a drawn pose, without inputs"
    return Advice(
        course.mechanism.manifest.model,
        "simulate",
        accuracy,
        f"the largest error at the end of {course.duration:g} s [rad, m; rad/s, m/s]; the reference is known to "
        f"{standard.accuracy:.0e}",
        tuple(options),
        (
            f"other motions than this: {motion}; errors grow with the time, and in chaotic motion exponentially",
            "single precision: simulation computes in double precision",
            "other steps and tolerances than the ones in the table",
        ),
    )


def advise_control(model: str, points: Sequence[KernelPoint], accuracy: float, judged: int) -> Advice:
    """Choose kernels and their precision for a loop that calls them; errors are of `judged` states."""
    options = [
        Option(
            NEEDS[p.task],
            (("kernel", p.way), ("precision", p.precision), ("flags", p.flags)),
            p.ns,
            "ns",
            p.error,
            p.finding,
        )
        for p in points
        if p.task in NEEDS and p.precision != EXACT
    ]
    states = max((p.states for p in points), default=0)
    return Advice(
        model,
        "control",
        accuracy,
        "the largest of a result or a block of derivatives, by its largest entry, over states that were drawn",
        tuple(options),
        (
            f"states other than the drawn ones, {judged} for errors and {states} for failures: near a lock digits are "
            "lost, and the kernel `condition` estimates how many",
            "the processor of the target: times are of this machine",
            "errors of the model itself, and errors that a controller makes with these numbers",
        ),
    )


def advise_optimisation(model: str, problem: str, points: Sequence[SolvePoint], accuracy: float) -> Advice:
    """Choose representation, collocation and grid."""
    options = [
        Option(
            "solve",
            (
                ("representation", p.representation),
                ("precision", "float64"),
                ("scheme", p.family),
                ("degree", str(p.degree)),
                ("intervals", str(p.intervals)),
            ),
            p.seconds,
            "s",
            p.defect,
            p.finding,
        )
        for p in points
    ]
    return Advice(
        model,
        "optimise",
        accuracy,
        "the largest defect of an interval, by re-simulation [rad, m; rad/s, m/s]",
        tuple(options),
        (
            f"problems other than {problem}: iterations, and so times, depend on problem and guess",
            "representations on other grids than the cheapest one; other solvers; the integral form",
            "the price of the control grid: inputs are constant over an interval, so a coarser grid has a higher cost",
        ),
    )
