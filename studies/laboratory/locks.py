"""Joints that lock, and joints that move nothing (F05, F06)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mbsgen.errors import InputError
from mbsrun.models import Extent, find_folder
from studies.laboratory.case import Finding, Loss, Workspace, check, demand, show_failure
from studies.laboratory.digits import (
    ABOVE,
    EXPLICIT,
    KERNELS,
    RESIDUAL,
    Specimen,
    check_estimate,
    measure_losses,
    relate,
    specimen,
)
from studies.laboratory.interpretation import eliminate
from studies.laboratory.mechanisms import LOCKS, States, describe_elbow, describe_lock, draw, write

DISTANCES = (*(10.0**-k for k in range(1, 13)), 0.0)  # rad
SIX_DIGITS = 1e-6
SEEDS = range(5)
SAFE = 1e-12  # rad: how close to the lock of a Cardan joint or a wrist EXP2 has to get
TURNING = 2.0**-53  # rad: half a rounding of an angle near pi/2
FIRST = "q1"  # the joint that locks

_ARM = """
name: weightless
gravity: [0, -9.81, 0]
parameters: {{m: {{value: {value}, kind: {kind}}}}}
bodies:
  - name: arm
    joint: {{name: q1, type: revolute, axis: z}}
    mass: 1
    com: [0.5, 0, 0]
  - name: tip
    parent: arm
"""
WEIGHTLESS = {
    "a leaf without mass": """
    joint: {name: q2, type: revolute, axis: z, position: [1, 0, 0]}
    mass: m
    com: [0.2, 0, 0]
""",
    "a slide without mass": """
    joint: {name: q2, type: prismatic, axis: x}
    mass: m
""",
    "a point mass on its axis": """
    joint: {name: q2, type: revolute, axis: x}
    mass: 1
    com: [0.3, m, 0]
""",
}


def approach(workspace: Workspace, lock: str, distance: float) -> tuple[Specimen, States, list[Loss]]:
    """Measure five states with the second joint `distance` from where the first one locks."""
    is_elbow = lock == "elbow"
    text = describe_elbow() if is_elbow else describe_lock(LOCKS[lock])
    chosen = specimen(workspace, text, *EXPLICIT.values(), *RESIDUAL.values(), "condition")
    states = draw(2 if is_elbow else 3, SEEDS)
    states["q"][:, 1] = (np.pi / 2 if lock == "Cardan" else 0.0) - distance
    return chosen, states, measure_losses(workspace, lock, distance, chosen, states)


def measure_lock(workspace: Workspace, lock: str, distances: Sequence[float] = DISTANCES) -> list[Finding]:
    """F05: six digits, or a status that names the joint; residuals are finite and right."""
    findings = []
    for distance in distances:
        chosen, states, losses = approach(workspace, lock, distance)
        findings += [_check_loss(x) for x in losses]
        findings += [check_estimate(x) for x in losses if x.error is not None]
        if lock in LOCKS and distance >= SAFE:
            findings += [_check_safe(x) for x in losses if x.way == "EXP2"]
        findings += _check_residuals(chosen, states)
    return findings


def measure_small_bound(workspace: Workspace) -> list[Finding]:
    """F05: failing below n u 1000 of an entry of M, and no earlier, EXP1 would be wrong in silence near a lock."""
    chosen = specimen(workspace, describe_lock(LOCKS["Cardan"]), *EXPLICIT.values(), *RESIDUAL.values(), "condition")
    silent = []
    for distance in DISTANCES:
        states = draw(3, SEEDS)
        states["q"][:, 1] = np.pi / 2 - distance
        bias = chosen.evaluate("impl", {**states, "qdd": 0 * states["q"]})[1]
        for exact, found in zip(chosen.find_exact(states), bias, strict=True):
            solved = eliminate(exact.M, -found["Phi"][:, 0])
            if solved.x is not None and not solved.status:
                silent.append((relate(solved.x, exact.rounded), distance))
    error, distance = max(silent)
    remark = f"{distance:.0e} from the lock of the Cardan joint; the kernel fails there"
    way = "EXP1 by the bound n u 1000 alone"
    return [show_failure(way, "error without a status", error, SIX_DIGITS, remark)]


def measure_weightless(workspace: Workspace, name: str) -> list[Finding]:
    """F06: refused with the model, by the joint's name; where a run-time parameter makes it so, a status names it."""
    refused = write(workspace.folder, _ARM.format(value=0, kind="constant") + WEIGHTLESS[name])
    findings = [_check_refusal(refused)]
    text = _ARM.format(value=1, kind="runtime") + WEIGHTLESS[name]
    chosen = specimen(workspace, text, *KERNELS.values())
    pair = {x: np.array([[0.3, 0.2]]) for x in ("q", "qd", "qdd")} | {"u": np.array([[1.0, 0.5]])}
    setup = chosen.subject.manifest.setup
    assert setup is not None, "the value is a run-time parameter"
    hidden = chosen.subject.kernels(setup.name, p=[0.0])
    states = {**pair, **{key: value[None] for key, value in hidden.items()}}
    for way, kernel in EXPLICIT.items():
        status = int(chosen.evaluate(kernel, states)[0][0])
        remark = f"status {status}: joint {chosen.joint(status)}" if status else "status 0"
        findings.append(demand(way, "status at run time", chosen.joint(status) == "q2", remark))
    for way, kernel in RESIDUAL.items():
        values = chosen.evaluate(kernel, states)[1][0]["Phi"]
        findings.append(demand(way, "finite residual", np.isfinite(values).all(), "finite"))
    return [*findings, _eliminate_untested(chosen, states)]


def _eliminate_untested(chosen: Specimen, states: States) -> Finding:
    """Solve the equations of two joints by elimination without a test of pivots."""
    many = {name: np.repeat(x, 3, axis=0) for name, x in states.items()}
    many["qdd"] = np.vstack((np.zeros((1, 2)), np.eye(2)))
    bias, first, second = (found["Phi"][:, 0] for found in chosen.evaluate("impl", many)[1])
    M = np.column_stack((first - bias, second - bias))
    with np.errstate(all="ignore"):
        share = M[0, 1] / M[1, 1]
        qdd = (-bias[0] + share * bias[1]) / (M[0, 0] - share * M[1, 0])
        qdd = np.array([qdd, (-bias[1] - M[1, 0] * qdd) / M[1, 1]])
    lost = int(np.count_nonzero(~np.isfinite(qdd)))
    return show_failure("elimination without a test", "accelerations that are no number", lost, 0)


def _check_refusal(model: Path) -> Finding:
    try:
        find_folder(model, Extent(("impl",), 0))
    except InputError as error:
        return demand("check of models", "refusal", "q2" in str(error), error.faults[0].finding)
    return demand("check of models", "refusal", False, "the model is accepted")


def _check_loss(loss: Loss) -> Finding:
    where = f"{loss.number:.0e} from the lock"
    if loss.error is None:
        is_sure = loss.estimate is not None and ABOVE * loss.estimate <= SIX_DIGITS
        is_due = not is_sure or loss.number <= TURNING
        estimate = "no digit" if loss.estimate is None else f"an error of {loss.estimate:.0e}"
        remark = f"{where}: status at {loss.failed}, {estimate} is told"
        return demand(loss.way, "status where six digits are not sure", loss.failed == FIRST and is_due, remark)
    return check(loss.way, "error without a status", loss.error, SIX_DIGITS, where)


def _check_safe(loss: Loss) -> Finding:
    where = f"{loss.number:.0e} from the lock"
    if loss.error is None:
        return demand(loss.way, "status not too early", False, where)
    return check(loss.way, "error down to 1e-12", loss.error, 1e-11, where)


def _check_residuals(chosen: Specimen, states: States) -> list[Finding]:
    """Compare residuals with residuals in 50 digits."""
    findings = []
    moments = [chosen.reference.at({name: x[k] for name, x in states.items()}) for k in range(len(states["q"]))]
    for way, kernel in RESIDUAL.items():
        for moment, found in zip(moments, chosen.evaluate(kernel, states)[1], strict=True):
            exact = np.array([[float(x)] for x in moment.residual()])
            findings.append(check(way, "error of the residual", relate(found["Phi"], exact), 1e-14))
    return findings
