"""Integrators: drift off constraints, energy and phase over long times, stiffness (F16 to F18).

The pendulum is IFToMM's A01: 1 kg on 1 m, let go horizontally: sin(q/2) = k cd(w t, k) with k = sin(pi/4),
w = sqrt(g/l).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import cos, hypot, inf, pi, sin, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ellipj

from mbsrun.external import Mechanism
from mbsrun.forms import FUNCTIONS
from mbsrun.models import Extent, find_folder
from mbsrun.simulation.drive import hold
from mbsrun.simulation.integration.methods import Formulation
from mbsrun.simulation.motion import Motion, Settings
from mbsrun.simulation.simulate import simulate
from studies.laboratory.case import Finding, Workspace, check, demand, show_failure, tell
from studies.laboratory.mechanisms import SLIDER_AND_BOB, write

Array = NDArray[np.float64]

EXTENT = Extent((*FUNCTIONS, "energy", "power", "sensors", "frames"), 1)
LEVEL = (pi / 2, 0.0, 0.0)  # the pendulum's start
CREEP = (1.0, 0.01, 0.0)  # where the stiff slider starts
STILL = (0.0, 0.0, 0.0)
STIFF = {"k": 8e5, "c": 4e4}
EIGENVALUE = 1.33e5  # 1/s: of c = 4e4 N s/m on 0.3 kg
GAINS = (0.0, 1.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 270.0)  # alpha of Baumgarte's method, at h = 1e-2 s [1/s]
DEFAULT_GAIN = 5.0  # 1/s
UNSTABLE_GAIN = 2.7  # h alpha: with a double eigenvalue -alpha, RK4 is stable below 2.785
STAYS = 1e-2  # m: a drift that is no divergence
DRIFTS = {  # m, in 10 s: by an independent program, for each step and alpha
    1e-2: {0.0: 3.6e-5, 5.0: 1.0e-7, 100.0: 4.8e-5, 200.0: 7.4e-4},
    1e-3: {0.0: 3.6e-9, 5.0: 1.0e-11, 1000.0: 4.8e-7},
}
FINEST_LOSS, FINEST_MISS = 4.8e-9, 3.3e-7  # J and m: RK4 in 2000 s, by the same program
ORDERS: tuple[tuple[str, dict[str, Any], int, float], ...] = (
    ("explicit Euler", {"method": "euler"}, 1, 2e-3),
    ("symplectic Euler", {"method": "symplectic-euler"}, 1, 2e-3),
    ("RK4", {"method": "rk4"}, 4, 0.02),
    ("generalised alpha", {"method": "generalized-alpha"}, 2, 0.01),
    ("implicit Euler", {"method": "radau-iia", "stages": 1}, 1, 2e-3),
    ("Radau IIA, 2 stages", {"method": "radau-iia", "stages": 2}, 3, 0.02),
    ("Radau IIA, 3 stages", {"method": "radau-iia", "stages": 3}, 5, 0.05),
    ("midpoint rule", {"method": "gauss", "stages": 1}, 2, 0.01),
    ("Gauss, 2 stages", {"method": "gauss", "stages": 2}, 4, 0.04),
    ("Gauss, 3 stages", {"method": "gauss", "stages": 3}, 6, 0.08),
)


def swing(t: Array | float) -> Array:
    """Return the angle of the pendulum after a start at rest from pi/2."""
    k = sqrt(0.5)
    _, cn, dn, _ = ellipj(sqrt(9.81) * np.asarray(t), k**2)
    return np.asarray(2 * np.arcsin(k * cn / dn))


def measure_baumgarte(_: Workspace, step: float) -> list[Finding]:
    """F16: in x and y, on a constraint that Baumgarte's method stabilises: how far off the rod, and off the place."""
    gains = sorted({*(x / (100 * step) for x in GAINS), DEFAULT_GAIN})
    swings = {gain: swing_freely(gain, step) for gain in gains}
    free, default = swings[0.0], swings[DEFAULT_GAIN]
    known = DRIFTS[step]
    findings = []
    for gain, swung in swings.items():
        way, remark = f"Baumgarte, h alpha = {gain * step:g}", f"h = {step:g} s, alpha = {gain:g} 1/s"
        judge = show_failure if gain * step >= UNSTABLE_GAIN else check
        findings.append(judge(way, "drift off the rod [m]", swung.drift, STAYS, remark))
        if gain in known:
            off = abs(swung.drift / known[gain] - 1)
            findings.append(check(way, "drift, off the drift of an independent program", off, 0.05, remark))
    way, remark = f"Baumgarte, h alpha = {DEFAULT_GAIN * step:g}", f"h = {step:g} s, {free.miss:.1e} m without"
    findings.append(check(way, "drift off the rod, by the drift without", default.drift / free.drift, 0.1, remark))
    findings.append(check(way, "error of the place [m]", default.miss, 2 * free.miss, remark))
    return findings


def measure_place(workspace: Workspace, step: float) -> list[Finding]:
    """F16: in the joint's coordinate no drift is possible; the place errs no more than in x and y without gains."""
    plant, findings = _load(workspace), []
    free = swing_freely(0.0, step)
    for formulation in Formulation:
        motion = _run(plant, LEVEL, duration=10.0, method="rk4", step=step, formulation=formulation)
        bound, way = 2 * free.miss, formulation.value.upper()
        findings.append(check(way, "error of the place [m]", _miss(motion), bound, f"h = {step:g} s"))
    return findings


@dataclass(frozen=True)
class Swing:
    """The result of the pendulum in x and y; infinite where it diverged."""

    drift: float  # the largest distance off the rod [m]
    miss: float  # of the place at the end [m]


def swing_freely(gain: float, step: float, duration: float = 10.0) -> Swing:
    """Swing the pendulum in x and y by RK4; the constraint g = (r.r - 1) / 2 has g'' + 2 alpha g' + alpha^2 g = 0."""
    state: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
    drift = 0.0
    for _ in range(round(duration / step)):
        a = _fall(state, gain)
        b = _fall(_add(state, a, step / 2), gain)
        c = _fall(_add(state, b, step / 2), gain)
        d = _fall(_add(state, c, step), gain)
        mean = tuple((p + 2 * q + 2 * r + s) / 6 for p, q, r, s in zip(a, b, c, d, strict=True))
        state = _add(state, mean, step)
        drift = max(drift, abs(hypot(state[0], state[1]) - 1))
        if not drift < 1:
            return Swing(inf, inf)
    q = float(swing(duration))
    return Swing(drift, hypot(state[0] - sin(q), state[1] + cos(q)))


def _fall(state: tuple[float, ...], gain: float) -> tuple[float, ...]:
    """Differentiate x, y and their velocities: r'' = f - multiplier r, by g'' = r'.r' + r.r''."""
    x, y, vx, vy = state
    square = x * x + y * y
    g, rate = (square - 1) / 2, x * vx + y * vy
    multiplier = (vx * vx + vy * vy - 9.81 * y + 2 * gain * rate + gain * gain * g) / square
    return vx, vy, -multiplier * x, -9.81 - multiplier * y


def _add(state: tuple[float, ...], rate: tuple[float, ...], step: float) -> tuple[float, ...]:
    return tuple(a + step * b for a, b in zip(state, rate, strict=True))


def measure_orders(workspace: Workspace) -> list[Finding]:
    """F17: halving the step divides the error by 2^order, to a tenth of an order."""
    plant, findings = _load(workspace), []
    for way, settings, order, step in ORDERS:
        pair = [_run(plant, LEVEL, duration=0.8, step=h, **settings) for h in (step, step / 2)]
        errors = [abs(float(x.q[-1, 0] - swing(0.8))) for x in pair]
        found = float(np.log2(errors[0] / errors[1]))
        findings.append(check(way, "order missing", order - found, 0.1, f"order {found:.2f} of {order}"))
    return findings


def measure_runge_kutta(workspace: Workspace, *, long: bool) -> list[Finding]:
    """F17: the energy that RK4 loses goes with T h^5, and a small loss does not imply a right phase."""
    plant, T = _load(workspace), 2000.0 if long else 200.0
    runs = [_run(plant, LEVEL, duration=t, method="rk4", step=h) for t, h in ((T, 1e-2), (T / 2, 1e-2), (T, 5e-3))]
    whole, half, fine = (_drift(motion) for motion in runs)
    way = "RK4"
    findings = [
        check(way, "loss by T, off 2", abs(whole / half / 2 - 1), 0.05, f"{whole:.1e} J in {T:g} s"),
        check(way, "loss by h^5, off 32", abs(whole / fine / 32 - 1), 0.1, f"{fine:.1e} J with half the step"),
        tell(way, "error of the place [m]", _miss(runs[0]), f"in {T:g} s: {_miss(runs[0]) / whole:.0f} m per J"),
    ]
    if long:
        finest = _run(plant, LEVEL, duration=T, method="rk4", step=2e-3)
        remark = "h = 2e-3 s, 2000 s"
        findings.append(check(way, "loss of energy [J]", _drift(finest), 2 * FINEST_LOSS, remark))
        findings.append(check(way, "error of the place [m]", _miss(finest), 2 * FINEST_MISS, remark))
    return findings


def measure_midpoint(workspace: Workspace, duration: float = 20.0) -> list[Finding]:
    """F17: Gauss collocation bounds the energy error at any time, while the place is off by more and more."""
    motion = _run(_load(workspace), LEVEL, duration=duration, method="gauss", stages=1, step=1e-2)
    assert motion.energy is not None, "the pendulum's energies do not overflow"
    drift = np.abs(motion.energy.total - motion.energy.total[0])
    middle = len(motion.t) // 2
    errors = np.abs(motion.q[:, 0] - swing(motion.t))
    way, remark = "midpoint rule", f"{duration:g} s"
    grown = drift[middle:].max() / drift[:middle].max() - 1
    return [
        check(way, "growth of the energy error", grown, 0.05, remark),
        check(way, "energy error [J]", drift.max(), 6e-4, remark),
        tell(way, "error of the angle [rad]", errors.max(), f"{errors[:middle].max():.1e} in the first half"),
    ]


def measure_damping(workspace: Workspace) -> list[Finding]:
    """F17: implicit Euler takes energy out; where it stands beside the midpoint rule, of ten times the step."""
    runs = {
        "implicit Euler, h = 1e-3 s": {"method": "radau-iia", "stages": 1, "step": 1e-3},
        "midpoint rule, h = 1e-2 s": {"method": "gauss", "stages": 1, "step": 1e-2},
    }
    findings = []
    for way, settings in runs.items():
        motion = _run(_load(workspace), LEVEL, duration=10.0, **settings)
        judge = show_failure if way.startswith("implicit") else check
        findings.append(
            judge(way, "error of the place in 10 s [m]", _miss(motion), 1e-2, f"energy off by {_lose(motion):.1e} J")
        )
    return findings


def measure_explicit(workspace: Workspace, durations: Sequence[float] = (0.025, 0.05, 0.1)) -> list[Finding]:
    """F18: explicit methods need steps of 2.8 / lambda, and say that the motion is stiff where they pay for it."""
    plant = _load(workspace).with_parameters(**STIFF)
    stable = _run(plant, CREEP, duration=0.05, method="rk4", step=2.0e-5)
    unstable = _run(plant, CREEP, duration=0.5, method="rk4", step=2.2e-5)
    findings = [
        demand("RK4", "stable steps of 2.0e-5 s", stable.is_complete, "complete"),
        demand("RK4", "halt at 2.2e-5 s", unstable.halt is not None, str(unstable.halt)),
        demand("RK4", "warning", any("stiff" in x for x in unstable.warnings), "; ".join(unstable.warnings)),
    ]
    counts = []
    for duration in durations:
        motion = _run(plant, CREEP, duration=duration, method="rk45")
        expected = 6 * duration * EIGENVALUE / 3.3  # six evaluations in a step
        counts.append(motion.effort.evaluations)
        off, remark = abs(counts[-1] / expected - 1), f"{counts[-1]} in {duration:g} s"
        findings.append(check("RK45", "evaluations, off evaluations of t lambda / 3.3 steps", off, 0.25, remark))
        is_warned = any("stiff" in x for x in motion.warnings)
        findings.append(demand("RK45", "warning", is_warned, "; ".join(motion.warnings)))
    for first, second in pairwise(counts):
        remark = f"{first}, then {second} in twice the time"
        findings.append(
            check("RK45", "growth of evaluations with time, off 2", abs(second / first / 2 - 1), 0.05, remark)
        )
    most, remark = 10.0 / durations[-1] * counts[-1], f"by evaluations in {durations[-1]:g} s; Radau takes fewer"
    findings.append(show_failure("RK45 for 10 s", "evaluations", most, 2000, remark))
    return findings


def measure_implicit(workspace: Workspace) -> list[Finding]:
    """F18: implicit methods take long steps through stiff motion; the slider creeps back as exp(-k/c t)."""
    plant = _load(workspace).with_parameters(**STIFF)
    findings = []
    for method in ("radau", "bdf"):
        runs = [_run(plant, CREEP, duration=10.0, method=method, rtol=x, atol=x) for x in (1.2e-6, 1.2e-7)]
        way, judge = f"{method} (scipy)", check if method == "radau" else show_failure
        change = float(np.abs(runs[0].q - runs[1].q).max())  # at all outputs, which are at the same times
        findings.append(check(way, "evaluations in 10 s", runs[0].effort.evaluations, 2000))
        findings.append(judge(way, "change by a tolerance ten times as tight", change, 1e-6))
    start = (pi / 2, 0.01, 0.0)
    for method, formulation in (
        *(("radau-iia", formulation) for formulation in Formulation),
        ("generalized-alpha", Formulation.IMPL),
    ):
        settings: dict[str, Any] = {"method": method, "formulation": formulation, "step": 1e-2, "rho": 0.0}
        motion = _run(plant, start, duration=0.5, **settings)
        way = f"{method}, {formulation.value.upper()}"
        if motion.halt is not None:
            findings.append(demand(way, "stiff motion with steps of 1e-2 s", False, str(motion.halt)))
            continue
        slider = abs(motion.q[-1, 1] - 0.01 * np.exp(-20 * 0.5))
        findings.append(check(way, "error of the slider [m]", slider, 1e-4))
        findings.append(check(way, "error of the angle [rad]", abs(motion.q[-1, 0] - float(swing(0.5))), 2e-3))
    return findings


def _load(workspace: Workspace) -> Mechanism:
    return Mechanism(find_folder(write(workspace.folder, SLIDER_AND_BOB), EXTENT))


def _run(plant: Mechanism, start: Sequence[float], **settings: Any) -> Motion:
    """Simulate without inputs."""
    return simulate(plant, hold(np.zeros(4)), list(start), list(STILL), Settings(max_seconds=inf, **settings))


def _drift(motion: Motion) -> float:
    assert motion.energy is not None, "the pendulum's energies do not overflow"
    return float(np.abs(motion.energy.drift).max())


def _lose(motion: Motion) -> float:
    assert motion.energy is not None, "the pendulum's energies do not overflow"
    return float(np.abs(motion.energy.total - motion.energy.total[0]).max())


def _miss(motion: Motion) -> float:
    """Return the error of the place of the pendulum's tip at the end [m]."""
    q, exact = motion.q[-1, 0], float(swing(motion.t[-1]))
    return float(np.hypot(np.sin(q) - np.sin(exact), np.cos(q) - np.cos(exact)))
