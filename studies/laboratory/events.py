"""Sudden forces: pulses between steps, friction that is made smooth, hard contacts (F28, F29, F35)."""

from __future__ import annotations

from collections.abc import Mapping
from math import atanh, pi, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import BDF, DOP853, LSODA, RK45, Radau, solve_ivp

from mbsrun.external import Mechanism
from mbsrun.models import Extent, find_folder
from mbsrun.simulation import Motion, Settings, simulate
from mbsrun.simulation.drive import Drive, hold, hold_steps
from studies.laboratory.case import Finding, Workspace, check, demand, show_failure
from studies.laboratory.mechanisms import write

Array = NDArray[np.float64]

EXTENT = Extent(("exp2", "impl", "semi", "energy", "power", "frames"), 1)
START, WIDTH, FORCE = 0.5, 1e-3, 1e3  # s, s, N: a pulse of 1 N s
PLACE = 1 - START - WIDTH / 2  # m: where it has brought 1 kg after 1 s
METHODS = ("dop853", "rk45", "radau", "lsoda", "bdf", "rk4")
SOLVERS: Mapping[str, Any] = {"RK45": RK45, "DOP853": DOP853, "Radau": Radau, "BDF": BDF, "LSODA": LSODA}
LOAD, LIMIT = 4.0, 5.0  # N: on the block, and of its friction
SPEEDS = (1e-2, 1e-3)  # m/s: of smooth friction
STABLE = 2.785  # of RK4, by the step times the rate
HEIGHT, HARD, BALL = 0.5, 1e5, 0.2  # m, N/m, kg
BOUNCES = 3.0  # s

_BLOCK = """
name: block
gravity: [0, 0, 0]
bodies:
  - name: block
    joint: {{type: prismatic, axis: x{friction}}}
    mass: 1
"""
_BALL = f"""
name: ball
gravity: [0, 0, -9.81]
bodies:
  - name: ball
    joint: {{type: prismatic, axis: z, actuated: false}}
    mass: {BALL}
contacts:
  - {{name: ground, body: ball, radius: 0.03, stiffness: {HARD:g}, exponent: 1}}
"""


def measure_pulse(workspace: Workspace) -> list[Finding]:
    """F28: a pulse of 1 ms within 1 s is not stepped over; SciPy steps over it, asked without its times."""
    plant = _load(workspace, _BLOCK.format(friction=""))
    pulse = hold_steps([0, START, START + WIDTH, 1.0], [[0.0], [FORCE], [0.0]])
    findings = []
    for method in METHODS:
        motion = _run(plant, pulse, 0.0, Settings(1.0, method))
        miss = float(np.hypot(motion.q[-1, 0] - PLACE, motion.qd[-1, 0] - 1))
        findings.append(check(method, "error of place and speed", miss, 1e-8))
    for name, solver in SOLVERS.items():
        found = solve_ivp(_push, (0.0, 1.0), [0.0, 0.0], solver, rtol=1e-9)
        miss = float(np.hypot(found.y[0, -1] - PLACE, found.y[1, -1] - 1))
        findings.append(show_failure(f"solve_ivp, {name}", "error of place and speed", miss, 1e-8))
    return findings


def _push(t: float, y: Array) -> list[float]:
    return [float(y[1]), FORCE if START < t < START + WIDTH else 0.0]


def measure_friction(workspace: Workspace, speed: float) -> list[Finding]:
    """F29: under 4 N, smooth friction of 5 N lets a block creep at the speed of its law; it does not stick."""
    plant = _load(workspace, _BLOCK.format(friction=f", friction: {{torque: {LIMIT}, speed: {speed!r}}}"))
    creep = speed * atanh(LOAD / LIMIT)
    rate = LIMIT / speed  # 1/s, at rest
    findings = []
    runs: Mapping[str, dict[str, Any]] = {
        "dop853": {"method": "dop853"},
        "radau": {"method": "radau"},
        "radau-iia, h rate = 5": {"method": "radau-iia", "step": 5 / rate},
        "rk4, h rate = 1": {"method": "rk4", "step": 1 / rate},
    }
    for way, settings in runs.items():
        motion = _run(plant, hold([LOAD]), 0.0, Settings(1.0, **settings))
        off = abs(float(motion.qd[-1, 0]) / creep - 1) if motion.is_complete else np.inf
        findings.append(check(way, "error of the speed after 1 s", off, 1e-6, f"speed {creep:.2e} m/s"))
    slow = rate * (1 - (LOAD / LIMIT) ** 2)  # 1/s, of the creeping block
    coarse = _run(plant, hold([LOAD]), 0.0, Settings(1.0, "rk4", step=1.5 * STABLE / slow))
    off = abs(float(coarse.qd[-1, 0]) / creep - 1) if coarse.is_complete else np.inf
    findings.append(
        show_failure(
            "rk4, 1.5 times its stable step", "error of the speed after 1 s", off, 1e-2, str(coarse.halt or "")
        )
    )
    far = float(_run(plant, hold([LOAD]), 0.0, Settings(10.0, "radau")).q[-1, 0])
    remark = f"{far / creep:.4g} s of {creep:.2e} m/s; dry friction holds the block"
    return [*findings, show_failure("smooth friction that should stick", "path in 10 s [m]", far, speed, remark)]


def measure_bounces(workspace: Workspace) -> list[Finding]:
    """F35: a ball on hard ground without losses: its energy stays, or a warning says that it does not."""
    plant = _load(workspace, _BALL)
    touch = pi / sqrt(HARD / BALL)  # s: half a period of the contact
    energy = BALL * 9.81 * HEIGHT
    runs: Mapping[str, dict[str, Any]] = {
        "dop853": {"method": "dop853"},
        "radau": {"method": "radau"},
        "rk4, 50 steps in a contact": {"method": "rk4", "step": touch / 50},
        "rk4, 1 step in a contact": {"method": "rk4", "step": touch},
        "euler, 10 steps in a contact": {"method": "euler", "step": touch / 10},
    }
    findings = []
    for way, settings in runs.items():
        motion = _run(plant, hold(np.zeros(0)), 0.03 + HEIGHT, Settings(BOUNCES, **settings))
        assert motion.energy is not None, "the ball's energies do not overflow"
        off = float(np.abs(motion.energy.drift).max()) / energy
        is_coarse = "1 step" in way or "euler" in way
        judge = show_failure if is_coarse else check
        findings.append(judge(way, "energy error by the energy", off, 1e-3 if "50" in way or is_coarse else 1e-6))
        if is_coarse:
            is_told = motion.halt is not None or any("energy" in text for text in motion.warnings)
            findings.append(
                demand(f"warnings of {way}", "warning of the energy", is_told, "; ".join(motion.warnings) or "none")
            )
    return findings


def _load(workspace: Workspace, text: str) -> Mechanism:
    return Mechanism(find_folder(write(workspace.folder, text), EXTENT))


def _run(plant: Mechanism, drive: Drive, q: float, settings: Settings) -> Motion:
    return simulate(plant, drive, [q], [0.0], settings)
