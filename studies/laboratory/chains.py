"""Chains: long ones, heavy and light bodies, single precision (F01 to F04, F15)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from studies.laboratory.case import Finding, Loss, Workspace, check, demand, show_failure
from studies.laboratory.digits import (
    ABOVE,
    KERNELS,
    RESIDUAL,
    Specimen,
    U,
    check_estimate,
    measure_losses,
    read,
    relate,
    specimen,
)
from studies.laboratory.interpretation import LongChain, eliminate
from studies.laboratory.mechanisms import States, describe_spatial, describe_straight, draw, round_to_single, write

ROUNDING, SINGLE = U["float64"], U["float32"]
RATIOS = (1e4, 1e8, 1e12)
NO_ALARM = 1e-11
SEEDS = range(6)  # of states in single precision
LIGHT, HEAVY = 1e-12, 1e12
LOST = 500  # links: elimination in M has lost digits there that articulated bodies keep
ALL = (*KERNELS.values(), "condition")  # of each chain, so that it is generated once for all cases
HARMLESS: Mapping[str, Sequence[float]] = {
    "a light tip": [1.0] * 9 + [LIGHT],
    "a heavy base": [1e8] + [1.0] * 9,
    "a light base": [1e-8] + [1.0] * 9,
    "heavy and light in turn": [HEAVY, 1.0] * 5,
    "light and heavy in turn": [1.0, HEAVY] * 5,
}
ALARMING = ("a light tip", "a heavy base", "heavy and light in turn")  # by the condition of M itself


def measure_chain(
    workspace: Workspace, mechanism: str, size: int, text: str, states: States
) -> tuple[Specimen, list[Loss]]:
    """Measure a chain of equal rods."""
    chosen = specimen(workspace, text, *ALL)
    return chosen, measure_losses(workspace, mechanism, size, chosen, states)


def measure_straight(workspace: Workspace, size: int) -> list[Finding]:
    """F01: EXP2 keeps 1e-12 at any length; EXP1 loses digits by the condition of M; residuals keep theirs."""
    states = draw(size, [size], q=0.0)
    chosen, losses = measure_chain(workspace, "straight chain", size, describe_straight(size), states)
    bounds = {"EXP1": 10 * ROUNDING * losses[0].condition, "EXP2": 1e-12}
    return [_check_error(x, bounds[x.way]) for x in losses] + _check_residuals(chosen, states)


def measure_long(workspace: Workspace, kind: str, size: int) -> list[Finding]:
    """F01, F02 beyond the size of generated C: EXP2 and IMPL interpreted; EXP1 and SEMI, with n^2 entries, in loops."""
    is_straight = kind == "straight"
    text = describe_straight(size) if is_straight else describe_spatial(size)
    chain = LongChain(write(workspace.folder, text), size)
    states = draw(size, [size], q=0.0 if is_straight else None)
    (exact,) = chain.find_exact(states)
    condition = float(np.linalg.cond(exact.M))
    remark = f"condition {condition:.1e}"
    bound = 1e-12 if is_straight else 100 * ROUNDING * np.sqrt(condition)
    (status,), (found,) = chain.evaluate("exp2", states)
    ways = {"EXP2, interpreted": (int(status), found.get("qdd"), bound)}
    bias = chain.evaluate("impl", {**states, "qdd": 0 * states["q"]})[1][0]["Phi"][:, 0]  # c - u
    looped = eliminate(exact.M, -bias)
    ways["EXP1, in loops"] = (looped.status, looped.x, 10 * ROUNDING * condition)
    findings = []
    for way, (failed, qdd, allowed) in ways.items():
        if failed or qdd is None:
            findings.append(demand(way, "error", False, f"status at {chain.joint(failed)}; {remark}"))
        else:
            findings.append(check(way, "error", relate(qdd.ravel(), exact.rounded), allowed, remark))
    if size >= LOST and looped.x is not None:
        error = relate(looped.x, exact.rounded)
        findings.append(show_failure("EXP1 by the bound of EXP2", "error", error, bound, remark))
    left = {"IMPL, interpreted": chain.evaluate("impl", {**states, "qdd": exact.rounded[None]})[1][0]["Phi"][:, 0]}
    left["SEMI, in loops"] = exact.M @ exact.rounded + bias
    scale = exact.scale(exact.qdd).max()
    for way, rest in left.items():
        share = float(np.abs(rest).max() / scale)
        findings.append(check(way, "residual at the exact accelerations", share, 10 * ROUNDING, remark))
    return findings


def measure_spatial(workspace: Workspace, size: int) -> list[Finding]:
    """F02: 100 u sqrt(cond M) for EXP2, 10 u cond M for EXP1."""
    states = draw(size, [size])
    chosen, losses = measure_chain(workspace, "spatial chain", size, describe_spatial(size), states)
    condition = losses[0].condition
    bounds = {"EXP1": 10 * ROUNDING * condition, "EXP2": 100 * ROUNDING * np.sqrt(condition)}
    return [_check_error(x, bounds[x.way]) for x in losses] + _check_residuals(chosen, states)


def weigh_tip(workspace: Workspace, size: int, ratio: float) -> list[Loss]:
    """Measure a chain whose last rod is `ratio` times as heavy."""
    chosen = specimen(workspace, describe_spatial(size, [1.0] * (size - 1) + [ratio]), *ALL)
    return measure_losses(workspace, "heavy tip", ratio, chosen, draw(size, [size]))


def measure_heavy_tip(workspace: Workspace, size: int, ratio: float) -> list[Finding]:
    """F03: errors as the scaled condition allows, small backward errors, and estimates of the lost digits."""
    findings = []
    for loss in weigh_tip(workspace, size, ratio):
        if loss.error is None:
            findings.append(_check_failure(loss))
            continue
        allowed = 10 * ROUNDING * loss.scaled
        findings.append(_check_error(loss, allowed))
        findings.append(check(loss.way, "backward error", read(loss.backward), 1e-14))
        findings.append(check_estimate(loss))
    chosen = specimen(workspace, describe_spatial(size, [1.0] * (size - 1) + [ratio]), *ALL)
    if ratio == RATIOS[-1]:
        findings.append(_invert(chosen, draw(size, [size])))
    return findings + _check_residuals(chosen, draw(size, [size]))


def _invert(chosen: Specimen, states: States) -> Finding:
    """Multiply by an inverse of M: unlike elimination, this leaves a residual of condition times rounding."""
    (exact,) = chosen.find_exact(states)
    bias = chosen.evaluate("impl", {**states, "qdd": 0 * states["q"]})[1][0]["Phi"][:, 0]
    left = exact.leave(np.linalg.inv(exact.M) @ -bias)
    return show_failure("M inverted, and multiplied", "backward error", left, 1e-14)


def _check_failure(loss: Loss) -> Finding:
    """Accept a status of EXP1 where a pivot is below n u 1000 of its entry of M: the estimate is then 1e-3 / n.

    Accept a status of EXP2 where an error may exceed 1e-3, by the estimate, and by the bound 10 u times the condition.
    """
    least = 1e-3 / loss.joints if loss.way == "EXP1" else 1e-3 / ABOVE
    is_lost = loss.estimate is None or loss.estimate >= least
    is_due = is_lost and loss.failed.startswith("q") and (loss.way == "EXP1" or 10 * ROUNDING * loss.scaled > 1e-3)
    estimate = "no digit" if loss.estimate is None else f"an error of {loss.estimate:.0e}"
    return demand(loss.way, "status where digits are gone", is_due, f"status at {loss.failed}; {estimate} is told")


def weigh_links(workspace: Workspace, factors: Sequence[float]) -> tuple[Specimen, States, list[Loss]]:
    """Measure a chain with light and heavy rods, where all accelerations are of order 1."""
    n = len(factors)
    chosen = specimen(workspace, describe_spatial(n, factors), *ALL)
    states = chosen.balance(draw(n, [3, 4, 5]))
    return chosen, states, measure_losses(workspace, "harmless ratio", max(factors) / min(factors), chosen, states)


def measure_harmless(workspace: Workspace, factors: Sequence[float], is_alarming: bool) -> list[Finding]:
    """F04: forces are such that all accelerations are of order 1; M is ill conditioned, but not when it is scaled.

    `is_alarming`: the condition of M itself predicts a loss, and no digit is lost.
    """
    chosen, states, losses = weigh_links(workspace, factors)
    findings = [_check_error(x, NO_ALARM) for x in losses]
    for x in losses:
        estimate = float("inf") if x.estimate is None else x.estimate
        findings.append(check(x.way, "false alarm", estimate, NO_ALARM, f"condition {x.condition:.0e}"))
    if is_alarming:
        alarm = ROUNDING * max(x.condition for x in losses)
        findings.append(show_failure("condition of M as an estimate", "false alarm", alarm, NO_ALARM))
    return findings + _check_residuals(chosen, states, bound=NO_ALARM)


def measure_single(workspace: Workspace, kind: str, size: int) -> list[Finding]:
    """F15: EXP2 has 1e-5; EXP1 has two digits, or a status."""
    text = describe_straight(size) if kind == "straight" else describe_spatial(size)
    chosen = specimen(workspace, text, *ALL)
    states = round_to_single(draw(size, SEEDS, q=0.0 if kind == "straight" else None))
    findings, lost = [], 0.0
    for loss in measure_losses(workspace, f"{kind} chain", size, chosen, states, "float32"):
        if loss.error is None:
            lost = np.inf
            is_right = loss.way.startswith("EXP1") and loss.failed.startswith("q")
            findings.append(demand(loss.way, "status", is_right, f"status at {loss.failed}"))
        else:
            findings.append(check(loss.way, "error", loss.error, 1e-2 if loss.way.startswith("EXP1") else 1e-5))
            lost = max(lost, loss.error if loss.way.startswith("EXP1") else 0.0)
    if kind == "straight" and size > 6:
        findings.append(show_failure("EXP1, float32, by the bound of EXP2", "error, or none", lost, 1e-5))
    return findings


def _check_error(loss: Loss, bound: float) -> Finding:
    if loss.error is None:
        return demand(loss.way, "error", False, f"status at {loss.failed}")
    return check(loss.way, "error", loss.error, bound, f"condition {loss.condition:.1e}, scaled {loss.scaled:.1e}")


def _check_residuals(
    chosen: Specimen, states: States, ways: Sequence[str] = tuple(RESIDUAL), bound: float = 10 * ROUNDING
) -> list[Finding]:
    """Return the residuals at exact accelerations, relative to the sum of the absolute values of their terms."""
    findings = []
    exact = chosen.find_exact(states)
    at = {**states, "qdd": np.array([x.rounded for x in exact])}
    for way in ways:
        for truth, found in zip(exact, chosen.evaluate(RESIDUAL[way], at)[1], strict=True):
            left = np.abs(found["Phi"]).max() / truth.scale(truth.qdd).max()
            findings.append(check(way, "residual at the exact accelerations", left, bound))
    return findings
