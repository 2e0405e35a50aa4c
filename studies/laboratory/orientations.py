"""Orientations: quaternions that are not of length 1, locks of three angles, angles beyond a turn (F26, F27, F34).

A symmetric top without forces turns as R(t) = exp(t L/I1) R(0) exp(t s e3), with its angular momentum L, constant in
space, and s = w3 (I1 - I3)/I1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from mbsrun.external import Mechanism
from mbsrun.forms import DIFFERENTIATED
from mbsrun.models import Extent, find_folder
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.guessing.guess import interpolate
from mbsrun.ocp.problem.problem import Bounds, Constraint, Cost, End, Problem, Range, Representation
from mbsrun.ocp.solution.solution import Failure
from mbsrun.ocp.solving.solve import Solver
from mbsrun.simulation import Motion, Settings, simulate
from mbsrun.simulation.drive import hold
from studies.laboratory.case import Finding, Workspace, check, demand, show_failure
from studies.laboratory.digits import EXPLICIT, RESIDUAL
from studies.laboratory.mechanisms import write

Array = NDArray[np.float64]

FREE: Range = (-np.inf, np.inf)
GRAVITY = np.array([0, 0, -9.81])
INERTIA = (0.2, 0.3, 0.4)
MOVING = ("exp2", "impl", "energy", "power", "frames")
LENGTHS = (1.0, -1.0, 1 + 1e-6, 0.5, 1e-3, 1e3, 1e-100, 1e100)  # of the quaternion; -1 is the opposite sign
TOP = (1.0, 1.0, 2.0)
SPIN = (0.01, 2.0, 0.3)  # rad/s: the pitch passes close to pi/2
DURATION = 10.0  # s
TURN, TURN_TIME, TURN_INTERVALS = 350.0, 1.0, 20  # degrees, s

_BODY = """
name: body
gravity: [0, 0, -9.81]
bodies:
  - {{name: body, joint: {joint}, mass: 2, inertia: {inertia}}}
"""
_ARM = """
name: arm
gravity: [0, 0, 0]
bodies:
  - {name: arm, joint: {type: revolute, axis: z}, mass: 1, com: [0, 0, 0], inertia: [1, 1, 1]}
"""


def measure_lengths(workspace: Workspace) -> list[Finding]:
    """F26: accelerations of a free body in closed form, whatever the length and the sign of its quaternion."""
    text = _BODY.format(joint="{type: free}", inertia=list(INERTIA))
    plant = _load(workspace, text, (*EXPLICIT.values(), *RESIDUAL.values()))
    rng, I = np.random.default_rng(26), np.array(INERTIA)
    findings = []
    for length in LENGTHS:
        worst: dict[str, float] = {}
        for _ in range(5):
            p, v, w = rng.normal(size=4), rng.normal(size=3), rng.normal(size=3)
            p /= np.linalg.norm(p)
            weight = turn(p).T @ GRAVITY
            exact = np.concatenate((weight - np.cross(w, v), np.cross(I * w, w) / I))
            state: dict[str, Any] = {
                "q": np.concatenate((rng.normal(size=3), length * p)),
                "qd": np.concatenate((v, w)),
                "u": [],
            }
            for way, kernel in EXPLICIT.items():
                off = float(np.abs(plant(kernel, **state)["qdd"].ravel() - exact).max() / np.abs(exact).max())
                worst[way] = max(off, worst.get(way, 0.0))
            for way, kernel in RESIDUAL.items():
                left = np.abs(plant(kernel, **state, qdd=exact)["Phi"]).max() / (2 * np.abs(exact).max())
                worst[way] = max(float(left), worst.get(way, 0.0))
        findings += [check(way, "error", off, 1e-14, f"length {length:g}") for way, off in worst.items()]
    long = np.sqrt(1.001) * np.array([0.5, 0.5, 0.5, 0.5])
    off = float(np.abs(_turn_unscaled(long) - turn(long)).max())
    remark = "1 - 2 (y^2 + z^2), ... at a length 5e-4 off 1"
    return [*findings, show_failure("matrix of a quaternion as it is", "error", off, 1e-6, remark)]


def turn(p: Array) -> Array:
    """Return the rotation matrix of a quaternion x, y, z, w of any length."""
    x, y, z, w = p / np.linalg.norm(p)
    v = np.array([x, y, z])
    return np.asarray((w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * _cross(v))


def _turn_unscaled(p: Array) -> Array:
    v, w = p[:3], p[3]
    return np.asarray((1 - 2 * v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * _cross(v))


def _cross(v: Array) -> Array:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def measure_lock(workspace: Workspace) -> list[Finding]:
    """F27: a top whose pitch passes by pi/2: right with a quaternion; with three angles, coarse steps are wrong."""
    exact = expm(DURATION * _cross(np.array(TOP) * np.array(SPIN))) @ expm(
        DURATION * SPIN[2] * (1 - TOP[2]) * _cross(np.eye(3)[2])
    )
    runs: Mapping[str, tuple[str, dict[str, Any], float]] = {
        "quaternion, dop853": ("{type: free}", {"method": "dop853", "rtol": 1e-11, "atol": 1e-11}, 1e-8),
        "quaternion, rk4, h = 1e-2 s": ("{type: free}", {"method": "rk4", "step": 1e-2}, 1e-5),
        "angles, dop853": ("{type: floating}", {"method": "dop853", "rtol": 1e-11, "atol": 1e-11}, 1e-6),
        "angles, rk4, h = 1e-2 s": ("{type: floating}", {"method": "rk4", "step": 1e-2}, 1e-5),
    }
    findings = []
    for way, (joint, settings, bound) in runs.items():
        is_free = "free" in joint
        plant = _load(
            workspace, _BODY.format(joint=joint, inertia=list(TOP)), (*MOVING, "rates") if is_free else MOVING
        )
        q = np.array([0, 0, 0, 0, 0, 0, 1.0]) if is_free else np.zeros(6)
        # at zero angles, their rates about z, y, x are the components of the angular velocity, last first
        qd = np.concatenate((np.zeros(3), SPIN if is_free else SPIN[::-1]))
        motion = simulate(plant, hold(np.zeros(0)), q, qd, Settings(DURATION, **settings))
        judge = show_failure if way.startswith("angles, rk4") else check
        off = float(np.abs(_find_turn(motion, is_free=is_free) - exact).max()) if motion.is_complete else np.inf
        findings.append(judge(way, "error of the orientation in 10 s", off, bound, str(motion.halt or "complete")))
    return [*findings, *_start_at_lock(workspace)]


def _start_at_lock(workspace: Workspace) -> list[Finding]:
    """Compute accelerations at a pitch of pi/2: a status that names a turn of the base, from explicit forms."""
    plant = _load(workspace, _BODY.format(joint="{type: floating}", inertia=list(INERTIA)), tuple(EXPLICIT.values()))
    q, qd = np.array([0, 0, 0, 0.3, pi / 2, 0.2]), np.ones(6)
    findings = []
    for way, kernel in EXPLICIT.items():
        try:
            plant(kernel, q=q, qd=qd, u=[])
        except Exception as error:  # its type is not what matters here
            findings.append(
                demand(f"{way}, angles", "status names the turn that locks", "body.rz" in str(error), str(error))
            )
        else:
            findings.append(demand(f"{way}, angles", "status names the turn that locks", False, "status 0"))
    return findings


def _find_turn(motion: Motion, *, is_free: bool) -> Array:
    q = motion.q[-1]
    if is_free:
        return turn(q[3:])
    z, y, x = q[3:]
    e = np.eye(3)
    return np.asarray(expm(z * _cross(e[2])) @ expm(y * _cross(e[1])) @ expm(x * _cross(e[0])))


def measure_turns(workspace: Workspace) -> list[Finding]:
    """F34: turn an arm to 350 degrees: by the value of the angle it goes the long way, by its direction the short."""
    plant = _load(workspace, _ARM, (*DIFFERENTIATED, "frames"), order=2)
    target = float(np.deg2rad(TURN))
    short = _price(target - 2 * pi)
    stated = Problem(
        name="turn",
        horizon=TURN_TIME,
        intervals=TURN_INTERVALS,
        family=Family.RADAU,
        degree=3,
        cost=Cost(1.0),
        start_q=(0.0,),
        start_qd=(0.0,),
        bounds=Bounds((FREE,), (FREE,), (FREE,)),
        end=End(velocity_zero=True),
    )
    direction = (
        Constraint(f"sin(q_arm - {target!r})", (0.0, 0.0), "end"),
        Constraint(f"cos(q_arm - {target!r})", (0.5, np.inf), "end"),
    )
    value = replace(stated, end=End(coordinates=((0, target),), velocity_zero=True))
    findings = []
    for representation in Representation:
        way, remark = representation.value, f"{short:.6g} is the least"
        cost = _solve(plant, replace(stated, constraints=direction, representation=representation))
        findings.append(check(f"{way}, by direction", "cost, off the short way's", abs(cost / short - 1), 1e-7, remark))
        cost = _solve(plant, replace(value, representation=representation))
        findings.append(check(f"{way}, by value", "cost, off the value's own", abs(cost / _price(target) - 1), 1e-7))
        findings.append(show_failure("the angle's value as target", "cost by the short way's", cost / short, 1.01, way))
    return findings


def _price(angle: float) -> float:
    """Return the least integral of squared inputs, constant in intervals, that turn 1 kg m2 from rest to rest."""
    h = TURN_TIME / TURN_INTERVALS
    middles = h * (np.arange(TURN_INTERVALS) + 0.5)
    rows = h * np.array([np.ones(TURN_INTERVALS), TURN_TIME - middles])
    u = np.linalg.lstsq(rows, np.array([0.0, angle]), rcond=None)[0]
    return float(h * u @ u)


def _solve(plant: Mechanism, problem: Problem) -> float:
    solver = Solver(problem, plant)
    outcome = solver.solve(problem, interpolate(problem, solver.transcription.scheme, np.zeros(1)))
    return float("nan") if isinstance(outcome, Failure) else outcome.cost.total


def _load(workspace: Workspace, text: str, functions: tuple[str, ...], order: int = 1) -> Mechanism:
    return Mechanism(find_folder(write(workspace.folder, text), Extent(functions, order)))
