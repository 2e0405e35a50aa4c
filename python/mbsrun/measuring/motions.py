"""Simulation: processor time against the global error, by formulation, method, and step or tolerance.

The error is the largest difference from a reference at the end of the motion. The reference is Gauss collocation with
six stages, which is not among the measured methods. Its difference from DOP853 at a tolerance of 1e-13 is its accuracy;
smaller errors have no meaning. The drift of energy needs no reference. With closed loops or driven joints, the
reference is Radau collocation with five stages, and only methods that keep loops closed are measured. With rigid stops
or dry friction, two pairs that go from event to event are the reference; time stepping is measured beside them.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mbsgen.errors import MbsError
from mbsgen.manifest import Manifest
from mbsrun.closure import Closure, has_loops
from mbsrun.external import Mechanism, load
from mbsrun.forms import FUNCTIONS
from mbsrun.measuring.functions import Variant
from mbsrun.measuring.mechanisms import CLOSING, draw_states, list_ranges
from mbsrun.measuring.points import MotionPoint
from mbsrun.measuring.store import Store
from mbsrun.measuring.timing import sum_up
from mbsrun.models import Extent, find_folder
from mbsrun.quaternions import neutral, normalise
from mbsrun.simulation.closing import close_start
from mbsrun.simulation.course import Course as Guide
from mbsrun.simulation.course import is_constrained
from mbsrun.simulation.drive import Drive, hold
from mbsrun.simulation.integration.methods import METHODS, Family, Formulation, complete_settings, find_refusals
from mbsrun.simulation.motion import Motion, Settings
from mbsrun.simulation.simulate import simulate
from mbsrun.simulation.statement import read_statement
from mbsrun.smoothness import demand_smooth

Array = NDArray[np.float64]

EXTENT = Extent((*FUNCTIONS, "energy", "power", "frames"), 1, optional=(*CLOSING[:3], "rates"))
TIGHT = 1e-13  # the tolerance of the check of the reference
ANGLE = 0.2  # the share of the range of a coordinate in which a motion starts

SWITCHED_TITLE = "DOP853 from event to event, against RK45, both at 1e-13"
CLOSED_TITLE = "Radau collocation, five stages, against DOP853 at 1e-13"

IMPL, SEMI, EXP1, EXP2 = Formulation
FAMILIES: tuple[tuple[str, Formulation], ...] = (
    *(("rk4", formulation) for formulation in Formulation),
    *(("dop853", formulation) for formulation in Formulation),
    *((method, EXP2) for method in ("euler", "symplectic-euler", "rk45", "lsoda", "bdf", "radau")),
    *((method, formulation) for method in ("gauss", "radau-iia") for formulation in Formulation),
    ("generalized-alpha", IMPL),
    ("variational", IMPL),
)


SWITCHING: tuple[tuple[str, Formulation], ...] = (  # of models whose joints switch; one formulation stands for all
    *((method, EXP2) for method in ("euler", "rk4", "rk45", "dop853")),
    ("moreau", IMPL),
)


class NoReferenceError(MbsError):
    """No method integrates a motion with the accuracy of a reference."""


@dataclass(frozen=True)
class Course:
    """A motion: mechanism, start, inputs and duration."""

    mechanism: Mechanism
    q: Array  # (n,)
    qd: Array  # (n,)
    drive: Drive
    duration: float  # s
    facts: str  # everything that start and inputs depend on, except the model
    guide: Guide | None = None  # the motion of driven joints; None: they stand still

    def integrate(self, settings: Settings) -> Motion:
        """Integrate with some settings."""
        settings = replace(settings, duration=self.duration, max_seconds=np.inf)  # slow methods are measured, too
        return simulate(self.mechanism, self.drive, self.q, self.qd, settings, course=self.guide)


@dataclass(frozen=True)
class Standard:
    """The reference of a motion."""

    state: Array  # at the end, (2 n,)
    accuracy: float  # by how much two methods differ
    steps: int  # of an adaptive method of order 8 at a tolerance of 1e-6: a measure of the motion's pace
    duration: float
    title: str = "Gauss collocation, six stages, against DOP853 at 1e-13"


@dataclass(frozen=True)
class MotionScope:
    """The amount of measurement."""

    families: tuple[tuple[str, Formulation], ...] = FAMILIES
    divisions: tuple[int, ...] = (1, 2, 4, 8, 16, 32, 64)  # of the pace, for implicit methods with fixed steps
    shorter: tuple[int, ...] = (1, 4, 16, 64, 256, 1024)  # for explicit ones, whose steps cost little
    tolerances: tuple[float, ...] = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11)
    rounds: int = 3
    patience: float = 5.0  # s; what takes longer is run once
    seconds: float = math.inf  # no family begins later


QUICK = MotionScope(
    (("rk4", EXP2), ("dop853", EXP2), ("gauss", IMPL), ("generalized-alpha", IMPL), ("variational", IMPL)),
    (1, 4),
    (1, 16, 64),
    (1e-4, 1e-8),
    1,
)
FRONTS = MotionScope(
    (
        *(("rk4", formulation) for formulation in (EXP2, EXP1, IMPL, SEMI)),
        *(("dop853", formulation) for formulation in (EXP2, EXP1, IMPL, SEMI)),
        *((method, EXP2) for method in ("rk45", "euler", "lsoda", "bdf", "radau")),
        *((method, IMPL) for method in ("gauss", "radau-iia", "variational", "generalized-alpha")),
        ("symplectic-euler", EXP2),
    ),
    (1, 2, 4, 8, 16),
    (1, 4, 16, 64, 256),
    patience=0.2,
    seconds=40.0,
)


def draw_course(mechanism: Mechanism, duration: float) -> Course:
    """Return the motion from a random but fixed pose, without inputs: at rest, or turning where there are quaternions.

    A model with quaternions may float where nothing would move it.
    """
    manifest = mechanism.manifest
    drawn = draw_states(mechanism, 1)
    q, qd = drawn["q"][0], drawn["qd"][0] if manifest.quaternions else np.zeros(len(manifest.coordinates))
    if has_loops(manifest):
        closure, pose = Closure(mechanism), np.array(manifest.pose)
        near = normalise(pose + ANGLE * (q - pose), manifest)
        places, speeds = closure.places_independent, closure.independent
        q = closure.spread(pose, places, near[None, places])[0]
        qd = closure.complete_velocities(q, speeds, qd[speeds])
    else:
        q = _move_within(ANGLE * q + (1 - ANGLE) * neutral(manifest), manifest)
    inputs = hold(np.zeros(len(manifest.inputs)))
    return Course(mechanism, q, qd, inputs, duration, "drawn")


def read_course(model: Path, file: Path | None, duration: float | None) -> Course:
    """Read the motion of a settings file, or draw one without a file. Raises InputError."""
    mechanism = load(model) if model.is_dir() else Mechanism(find_folder(model, EXTENT))
    _demand_reference(mechanism.manifest)
    if file is None:
        return draw_course(mechanism, duration or 2.0)
    statement = read_statement(file, {}, mechanism.manifest)
    mechanism = mechanism.with_parameters(**statement.parameters)
    facts = (file.read_text(encoding="utf-8"), tuple(statement.parameters.items()))
    settings = statement.settings
    q, qd, _ = close_start(mechanism, statement.start, statement.course)
    return Course(mechanism, q, qd, statement.drive, settings.duration, repr(facts), statement.course)


def _demand_reference(manifest: Manifest) -> None:
    """Refuse rigid contacts, friction by loads, and joints that switch beside driven ones.

    No two methods have all digits of these.
    """
    if manifest.touching or manifest.loaded or (manifest.switching and is_constrained(manifest)):
        demand_smooth(manifest, "a chart of methods", stops=True)


def measure_motions(
    course: Course,
    standard: Standard,
    scope: MotionScope,
    store: Store[MotionPoint],
    report: Callable[[str, int, int], None],
) -> list[MotionPoint]:
    """Integrate with all methods of `scope`; earlier measurements are read from the store."""
    points: list[MotionPoint] = []
    compiler = Variant().compiler()
    chosen = SWITCHING if course.mechanism.manifest.switching else scope.families
    families, begin = [x for x in chosen if _takes(x, course)], time.monotonic()
    for done, (method, formulation) in enumerate(families):
        if time.monotonic() - begin > scope.seconds:
            break
        report(f"{method}, {formulation.value}", done, len(families))
        levels = [(x, replace(s, formulation=formulation)) for x, s in _list_levels(method, standard, scope)]
        manifest, values = course.mechanism.manifest, dict(course.mechanism.parameters)
        facts = ("motions", manifest.generator, manifest.model_hash, values, course.facts, course.duration)
        settings = ([s for _, s in levels], scope.rounds, compiler.flags, compiler.macros)
        points += store.find_or_measure((*facts, *settings), MethodSeries(course, standard, scope, levels).measure)
    return points


def find_standard(course: Course) -> Standard:
    """Integrate with two methods as accurately as possible. Raises NoReferenceError."""
    pace = _reach(course, Settings(course.duration, rtol=1e-6, atol=1e-6)).effort.steps
    check = _reach(course, Settings(course.duration, rtol=TIGHT, atol=TIGHT))
    step, is_closed = course.duration / (4 * max(pace, 10)), is_constrained(course.mechanism.manifest)
    method, stages = ("radau-iia", 5) if is_closed else ("gauss", 6)
    manifest = course.mechanism.manifest
    if manifest.switching:
        other = _end(_reach(course, Settings(course.duration, "rk45", rtol=TIGHT, atol=TIGHT)), manifest)
        state = _end(check, manifest)
        accuracy = float(np.abs(other - state).max())
        return Standard(state, accuracy, max(pace, 10), course.duration, SWITCHED_TITLE)
    state = _end(_reach(course, Settings(course.duration, method, Formulation.IMPL, step, stages=stages)), manifest)
    standard = Standard(state, float(np.abs(state - _end(check, manifest)).max()), max(pace, 10), course.duration)
    return replace(standard, title=CLOSED_TITLE) if is_closed else standard


def _takes(family: tuple[str, Formulation], course: Course) -> bool:
    """Return whether a method takes a model, by a formulation that it does not replace."""
    method, formulation = family
    settings, manifest = Settings(course.duration, method, formulation), course.mechanism.manifest
    if manifest.quaternions and not METHODS[method].takes_quaternions:
        return False
    if not is_constrained(manifest):
        return True
    completed = complete_settings(settings, is_closed=True)
    return not list(find_refusals(settings, manifest)) and completed.formulation is formulation


class MethodSeries:
    """A method on a formulation, with several steps or tolerances."""

    def __init__(
        self, course: Course, standard: Standard, scope: MotionScope, levels: Sequence[tuple[float, Settings]]
    ) -> None:
        self.course, self.standard, self.scope, self.levels = course, standard, scope, levels

    def measure(self) -> list[MotionPoint]:
        """Integrate in rounds; slow integrations run once."""
        replace(self.course, duration=self.course.duration / 100).integrate(self.levels[0][1])  # compiles
        motions = [self.course.integrate(settings) for _, settings in self.levels]
        times = [[motion.effort.seconds] for motion in motions]
        for _ in range(self.scope.rounds - 1):
            for own, (_, settings) in zip(times, self.levels, strict=True):
                if own[0] < self.scope.patience:
                    own.append(self.course.integrate(settings).effort.seconds)
        return [
            self._judge(x, motion, np.array(own))
            for (x, _), motion, own in zip(self.levels, motions, times, strict=True)
        ]

    def _judge(self, value: float, motion: Motion, seconds: Array) -> MotionPoint:
        settings, energy = motion.settings, motion.energy
        is_adaptive = METHODS[settings.method].family is Family.ADAPTIVE
        manifest = self.course.mechanism.manifest
        error = np.abs(_end(motion, manifest) - self.standard.state).max() if motion.is_complete else np.nan
        drift = np.nan
        if energy is not None:
            drift = np.abs(energy.drift).max() / (np.ptp(energy.kinetic) + np.ptp(energy.potential) or 1.0)
        return MotionPoint(
            mechanism=manifest.model,
            method=settings.method,
            formulation=settings.formulation.value,
            setting="tolerance" if is_adaptive else "step",
            value=value,
            seconds=sum_up(seconds) if motion.is_complete else None,
            error=float(error) if np.isfinite(error) else None,
            drift=float(drift) if np.isfinite(drift) else None,
            evaluations=motion.effort.evaluations,
            finding="" if motion.halt is None else str(motion.halt),
        )


def _list_levels(method: str, standard: Standard, scope: MotionScope) -> list[tuple[float, Settings]]:
    if METHODS[method].family is Family.ADAPTIVE:
        return [(x, Settings(standard.duration, method, rtol=x, atol=x)) for x in scope.tolerances]
    is_cheap = METHODS[method].family is Family.EXPLICIT or METHODS[method].strikes
    divisions = scope.shorter if is_cheap else scope.divisions
    steps = [standard.duration / (standard.steps * x) for x in divisions]
    return [(x, Settings(standard.duration, method, step=x)) for x in steps]


def _reach(course: Course, settings: Settings) -> Motion:
    motion = course.integrate(settings)
    if motion.halt is not None:
        raise NoReferenceError(
            f"{course.mechanism.manifest.model}: there is no reference for this motion: {motion.halt}; "
            "a --settings file may start it elsewhere"
        )
    return motion


def _end(motion: Motion, manifest: Manifest) -> Array:
    return np.concatenate((normalise(motion.q[-1], manifest), motion.qd[-1]))


def _move_within(q: Array, manifest: Manifest) -> Array:
    """Return a pose within the limits of the coordinates."""
    return normalise(np.clip(q, *np.array(list_ranges(manifest)).T), manifest)
