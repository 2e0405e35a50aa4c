"""Impossible inertias, and sizes whose products overflow (F07, F08); distant origins (F09)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mbsgen.errors import InputError
from mbsrun.measuring.functions import Precision
from mbsrun.models import Extent, find_folder
from studies.laboratory.case import Finding, Workspace, check, demand, show_failure
from studies.laboratory.digits import EXPLICIT, KERNELS, RESIDUAL, U, relate, specimen
from studies.laboratory.mechanisms import describe_spatial, draw, round_to_single, write

TINY, HUGE = 1e-150, 1e150
SIZES: Mapping[str, Sequence[float]] = {
    "tiny": [TINY] * 6,
    "huge": [HUGE] * 6,
    "tiny between others": [TINY, 1.0] * 3,
    "huge between others": [HUGE, 1.0] * 3,
}
TEXTBOOK = (
    "regroup",
    "share_frames",
    "lump",
    "absolute",
    "meet",
    "together",
    "factor",
    "share",
)  # reductions to switch off for it
OFFSETS_OF: Mapping[Precision, Sequence[float]] = {  # m, up to where all of the body's own inertia is lost in m c2
    "float64": tuple(10.0**k for k in range(9)),
    "float32": tuple(10.0**k for k in range(5)),
}

# The loss from which on a status is due: EXP1 keeps six digits at joints whose own body has no inertia, or fails.
LEAST = {"EXP1": 1e-6, "EXP2": 1e-3, "IMPL": np.inf, "SEMI": np.inf}

_BODY = """
name: strange
gravity: [0, 0, -9.81]
bodies:
  - name: body
    joint: {{name: q1, type: revolute, axis: z}}
    mass: {mass}
    com: [0.1, 0, 0]
    inertia: {inertia}
"""
STRANGE = {
    "a negative mass": {"mass": "-1", "inertia": "[1, 1, 1]"},
    "a negative moment of inertia": {"mass": "1", "inertia": "[-1, 1, 1]"},
    "moments against the triangle": {"mass": "1", "inertia": "[1, 1, 3]"},
    "products too large": {"mass": "1", "inertia": "{xx: 1, yy: 1, zz: 1, xy: 2}"},
    "a mass that is not a number": {"mass": ".nan", "inertia": "[1, 1, 1]"},
    "an infinite mass": {"mass": ".inf", "inertia": "[1, 1, 1]"},
    "a mass below 1e-150": {"mass": "1e-310", "inertia": "[1e-310, 1e-310, 1e-310]"},
    "a mass above 1e150": {"mass": "1e200", "inertia": "[1e200, 1e200, 1e200]"},
}
ALLOWED = "moments against the triangle"  # where the file says so
_OFFSET = """
name: offset
gravity: [0, -9.81, 0]
bodies:
  - name: x
    joint: {{type: prismatic, axis: x}}
  - name: y
    parent: x
    joint: {{type: prismatic, axis: y}}
  - name: body
    parent: y
    joint: {{type: revolute, axis: z}}
    mass: 1
    com: [{c}, {c}/3, {c}/7]
    inertia: [1, 1, 1]
"""


def measure_strange(workspace: Workspace, name: str) -> list[Finding]:
    """F07: refused with line and path."""
    try:
        find_folder(write(workspace.folder, _BODY.format(**STRANGE[name])), Extent(("impl",), 0))
    except InputError as error:
        fault = error.faults[0]
        return [demand("check of models", "refusal", fault.line > 0 and "bodies[0]" in fault.path, fault.finding)]
    return [demand("check of models", "refusal", False, "the model is accepted")]


def measure_definite(_: Workspace) -> list[Finding]:
    """F07: a tensor against the triangle is positive definite, so Cholesky's decomposition takes it."""
    taken = np.isfinite(np.linalg.cholesky(np.diag([1.0, 1.0, 3.0]))).all()
    return [show_failure("Cholesky's decomposition as a test", "impossible bodies taken", float(taken), 0)]


def measure_allowed(workspace: Workspace) -> list[Finding]:
    """F07: inertias of published robots that break a rule are accepted where the file says so."""
    text = _BODY.format(**STRANGE[ALLOWED]) + "allow_unphysical: true\n"
    found = specimen(workspace, text, "exp2").evaluate("exp2", draw(1, [1]))[1][0]
    return [demand("check of models", "consent", np.isfinite(found["qdd"]).all(), f"{ALLOWED}: accepted")]


def measure_sizes(workspace: Workspace, name: str) -> list[Finding]:
    """F08: from 1e-150 to 1e150 kg nothing overflows, and no status mistakes light for lost."""
    chosen = specimen(workspace, describe_spatial(6, SIZES[name]), *KERNELS.values())
    states = chosen.balance(draw(6, [1, 2, 3]))
    exact = chosen.find_exact(states)
    findings = []
    for way, kernel in EXPLICIT.items():
        for status, found, truth in zip(*chosen.evaluate(kernel, states), exact, strict=True):
            if status:
                findings.append(demand(way, "error", False, f"status at {chosen.joint(int(status))}"))
            else:
                findings.append(check(way, "error", relate(found["qdd"][:, 0], truth.rounded), 1e-12))
    for way, kernel in RESIDUAL.items():
        results = chosen.evaluate(kernel, states)[1]
        findings += [demand(way, "finite residual", np.isfinite(x["Phi"]).all(), "finite") for x in results]
    if name in ("tiny", "huge"):
        with np.errstate(all="ignore"):
            wrong = sum(not 0 < np.linalg.det(x.M) < np.inf for x in exact)
        findings.append(show_failure("determinants of M", "states in which they are 0 or infinite", wrong, 0))
    return findings


def measure_offset(workspace: Workspace, offset: float, precision: Precision = "float64") -> list[Finding]:
    """F09: with a centre of mass at c, I loses 4 u (1 + m c2 / I) within m c2, with reductions and without."""
    square = offset**2 * (1 + 1 / 9 + 1 / 49)
    bound = 4 * U[precision] * (1 + square)
    findings = []
    for label, without in (("", ()), (", unreduced", TEXTBOOK)):
        chosen = specimen(workspace, _OFFSET.format(c=offset), *KERNELS.values(), without=without)
        states = draw(3, range(5))
        states = round_to_single(states) if precision == "float32" else states
        exact = chosen.find_exact(states)
        for way, kernel in KERNELS.items():
            statuses, results = chosen.evaluate(kernel, states, precision)
            way_ = way + label + ("" if precision == "float64" else ", float32")
            for status, found, truth in zip(statuses, results, exact, strict=True):
                if status:
                    remark = f"status at {chosen.joint(int(status))}; {bound:.0e} may be lost"
                    findings.append(demand(way_, "status where digits are gone", bound > LEAST[way], remark))
                elif way in EXPLICIT:
                    findings.append(check(way_, "error", relate(found["qdd"][:, 0], truth.rounded), bound))
                else:
                    left = np.array([[float(x)] for x in truth.moment.residual()])
                    findings.append(check(way_, "error", relate(found["Phi"], left), bound))
    if offset == OFFSETS_OF[precision][-1]:
        number = np.dtype(precision).type
        lost = abs(float((number(1) + number(square)) - number(square)) - 1)
        way = f"I from the origin's less m c2, {precision}"
        findings.append(show_failure(way, "loss of I", lost, 1e-6, f"c = {offset:.0e} m"))
    return findings
