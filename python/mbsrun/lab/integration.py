"""Integrators: drift off constraints, energy and phase over long times, stiffness (F16 to F18).

The pendulum is IFToMM's A01: 1 kg on 1 m, let go horizontally: sin(q/2) = k cd(w t, k) with k = sin(pi/4),
w = sqrt(g/l).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, pi, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ellipj

from mbsrun.external import Mechanism
from mbsrun.lab.case import Bench, Finding, check, demand, tell
from mbsrun.lab.mechanisms import BENCH, write
from mbsrun.models import Extent, find_folder
from mbsrun.simulation.drive import hold
from mbsrun.simulation.methods import Formulation
from mbsrun.simulation.motion import Motion, Settings
from mbsrun.simulation.simulate import simulate

Array = NDArray[np.float64]

EXTENT = Extent(("impl", "semi", "semi_res", "exp1", "exp2", "energy", "power", "sensors", "frames"), 1)
LEVEL = (pi / 2, 0.0, 0.0)  # the pendulum's start
CREEP = (1.0, 0.01, 0.0)  # where the stiff slider starts
STILL = (0.0, 0.0, 0.0)
STIFF = {"k": 8e5, "c": 4e4}
EIGENVALUE = 1.33e5  # 1/s: of c = 4e4 N s/m on 0.3 kg
CARTESIAN = 3.6e-5  # m: how far RK4 drifts off the rod in 10 s in Cartesian coordinates, by an independent program
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
    """Give the angle of the pendulum that is let go at pi/2."""
    k = sqrt(0.5)
    _, cn, dn, _ = ellipj(sqrt(9.81) * np.asarray(t), k**2)
    return np.asarray(2 * np.arcsin(k * cn / dn))


def measure_rod(bench: Bench) -> list[Finding]:
    """F16: joint coordinates cannot leave the rod, in any formulation; the place is no worse than the bound there."""
    plant, findings = _load(bench), []
    for formulation in Formulation:
        motion = _run(plant, LEVEL, duration=10.0, method="rk4", step=1e-2, formulation=formulation)
        tips = plant("sensors", q=motion.q)["position"][:, :, 0]
        drift = float(np.abs(np.linalg.norm(tips, axis=1) - 1).max())
        way = formulation.value.upper()
        findings.append(check(way, "drift off the rod [m]", drift, 4 * np.finfo(np.float64).eps))
        findings.append(check(way, "error of the place [m]", _miss(motion), 2 * CARTESIAN))
    return findings


def measure_orders(bench: Bench) -> list[Finding]:
    """F17: halving the step divides the error by 2^order, to a tenth of an order."""
    plant, findings = _load(bench), []
    for way, settings, order, step in ORDERS:
        pair = [_run(plant, LEVEL, duration=0.8, step=h, **settings) for h in (step, step / 2)]
        errors = [abs(float(x.q[-1, 0] - swing(0.8))) for x in pair]
        found = float(np.log2(errors[0] / errors[1]))
        findings.append(check(way, "order missing", order - found, 0.1, f"order {found:.2f} of {order}"))
    return findings


def measure_runge_kutta(bench: Bench, *, long: bool) -> list[Finding]:
    """F17: the energy that RK4 loses goes with T h^5, and a small one does not tell that the phase is right."""
    plant, T = _load(bench), 2000.0 if long else 200.0
    runs = [_run(plant, LEVEL, duration=t, method="rk4", step=h) for t, h in ((T, 1e-2), (T / 2, 1e-2), (T, 5e-3))]
    whole, half, fine = (_drift(motion) for motion in runs)
    way = "RK4"
    return [
        check(way, "loss by T, off 2", abs(whole / half / 2 - 1), 0.05, f"{whole:.1e} J in {T:g} s"),
        check(way, "loss by h^5, off 32", abs(whole / fine / 32 - 1), 0.1, f"{fine:.1e} J with half the step"),
        tell(way, "error of the place [m]", _miss(runs[0]), f"in {T:g} s: {_miss(runs[0]) / whole:.0f} m per J"),
    ]


def measure_midpoint(bench: Bench) -> list[Finding]:
    """F17: Gauss collocation bounds the energy error at any time, while the place is off by more and more."""
    motion = _run(_load(bench), LEVEL, duration=20.0, method="gauss", stages=1, step=1e-2)
    assert motion.energy is not None, "the pendulum's energies do not overflow"
    drift = np.abs(motion.energy.total - motion.energy.total[0])
    middle = len(motion.t) // 2
    errors = np.abs(motion.q[:, 0] - swing(motion.t))
    way = "midpoint rule"
    return [
        check(way, "growth of the energy error", drift[middle:].max() / drift[:middle].max() - 1, 0.05),
        check(way, "energy error [J]", drift.max(), 6e-4),
        tell(way, "error of the angle [rad]", errors.max(), f"{errors[:middle].max():.1e} in the first half"),
    ]


def measure_explicit(bench: Bench) -> list[Finding]:
    """F18: explicit methods need steps of 2.8 / lambda, and say that the motion is stiff where they pay for it."""
    plant = _load(bench).with_parameters(**STIFF)
    stable = _run(plant, CREEP, duration=0.05, method="rk4", step=2.0e-5)
    unstable = _run(plant, CREEP, duration=0.5, method="rk4", step=2.2e-5)
    adaptive = _run(plant, CREEP, duration=0.02, method="rk45")
    expected = 0.02 * EIGENVALUE / 3.3 * 6
    return [
        demand("RK4", "stable steps of 2.0e-5 s", stable.is_complete, "complete"),
        demand("RK4", "halt at 2.2e-5 s", unstable.halt is not None, str(unstable.halt)),
        demand("RK4", "warning", any("stiff" in x for x in unstable.warnings), "; ".join(unstable.warnings)),
        check("RK45", "evaluations, off t lambda / 3.3 steps", abs(adaptive.effort.evaluations / expected - 1), 0.5),
        demand("RK45", "warning", any("stiff" in x for x in adaptive.warnings), "; ".join(adaptive.warnings)),
    ]


def measure_implicit(bench: Bench) -> list[Finding]:
    """F18: implicit methods take long steps through stiff motion; the slider creeps back as exp(-k/c t)."""
    plant = _load(bench).with_parameters(**STIFF)
    runs = [_run(plant, CREEP, duration=10.0, method="radau", rtol=x, atol=x) for x in (2e-6, 2e-7)]
    findings = [
        check("Radau (scipy)", "evaluations in 10 s", runs[0].effort.evaluations, 2000),
        check(
            "Radau (scipy)",
            "change by a tolerance ten times as tight",
            np.abs(runs[0].q[-1] - runs[1].q[-1]).max(),
            1e-6,
        ),
    ]
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


def _load(bench: Bench) -> Mechanism:
    return Mechanism(find_folder(write(bench.folder, BENCH), EXTENT))


def _run(plant: Mechanism, start: Sequence[float], **settings: Any) -> Motion:
    """Let things go, with no inputs."""
    return simulate(plant, hold(np.zeros(4)), list(start), list(STILL), Settings(max_seconds=inf, **settings))


def _drift(motion: Motion) -> float:
    assert motion.energy is not None, "the pendulum's energies do not overflow"
    return float(np.abs(motion.energy.drift).max())


def _miss(motion: Motion) -> float:
    """Tell how far the pendulum's tip is from where it should be at the end [m]."""
    q, exact = motion.q[-1, 0], float(swing(motion.t[-1]))
    return float(np.hypot(np.sin(q) - np.sin(exact), np.cos(q) - np.cos(exact)))
