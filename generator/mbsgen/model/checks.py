"""What is wrong with a Model that has the right shape.

What lies under a doubtful place has been found wrong already; its value is nan here, and nothing is concluded from it.
"""

from __future__ import annotations

import math
from collections.abc import Container, Iterator

import numpy as np

from mbsgen.documents import Place
from mbsgen.expressions import write
from mbsgen.model.findings import Finding
from mbsgen.model.idleness import check_idle_joints
from mbsgen.model.model import Body, Joint, Model, Placement
from mbsgen.model.naming import check_names
from mbsgen.model.topology import check_tree
from mbsgen.model.valuation import LARGEST, Valuation

MAX_BODIES = 1000
LIGHTEST = 1e-150  # the product of two masses does not vanish
INERTIA_TOLERANCE = 1e-9  # of the largest moment


def find_faults(model: Model, doubtful: Container[Place] = frozenset()) -> list[Finding]:
    """Find all that is wrong with a model. A model without findings makes a Tree."""
    if not 0 < len(model.bodies) <= MAX_BODIES:
        return [Finding(("bodies",), f"{len(model.bodies)} bodies", f"give at least one, and at most {MAX_BODIES}")]
    findings = [*check_names(model, doubtful), *check_tree(model, doubtful)]
    valuation = Valuation(model.parameters, doubtful)
    valuation.triple(("gravity",), model.gravity)
    for i, body in enumerate(model.bodies):
        findings += _check_joint(("bodies", i, "joint"), body.joint, valuation)
        findings += _check_body(("bodies", i), body, valuation, allow_unphysical=model.allow_unphysical)
    for i, frame in enumerate(model.frames):
        _check_placement(("frames", i), frame.placement, valuation)
    findings += valuation.findings
    return findings or list(check_idle_joints(model))


def _check_joint(place: Place, joint: Joint, valuation: Valuation) -> Iterator[Finding]:
    _check_placement(place, joint.placement, valuation)
    axis = [valuation.constant((*place, "axis"), component) for component in joint.axis]
    if axis == [0, 0, 0]:
        finding = f"[{', '.join(map(write, joint.axis))}] has no direction"
        yield Finding((*place, "axis"), finding, "give a nonzero 3-vector, e.g. [0, 1, 0]")
    lower, upper = (
        math.nan if limit is None else valuation.constant((*place, "limits", k), limit)
        for k, limit in enumerate((joint.lower, joint.upper))
    )
    if lower > upper:
        yield Finding((*place, "limits"), f"the lower limit {lower:g} is above the upper {upper:g}", "swap them")


def _check_placement(place: Place, placement: Placement, valuation: Valuation) -> None:
    valuation.triple((*place, "position"), placement.position)
    for k, rotation in enumerate(placement.orientation):
        valuation.number((*place, "orientation", k, "angle"), rotation.angle)


def _check_body(place: Place, body: Body, valuation: Valuation, *, allow_unphysical: bool) -> Iterator[Finding]:
    valuation.triple((*place, "com"), body.com)
    mass = valuation.number((*place, "mass"), body.mass)
    if mass < 0:
        yield Finding((*place, "mass"), f"a mass of {mass:g}", "give 0 or more")
    if 0 < mass < LIGHTEST:
        yield Finding((*place, "mass"), f"a mass of {mass:g}", f"give 0, or {LIGHTEST:g} to {LARGEST:g}")
    place = (*place, "inertia")
    inertia = np.array([[valuation.number(place, entry) for entry in row] for row in body.inertia.rows])
    if allow_unphysical or not np.isfinite(inertia).all():
        return
    if mass == 0 and inertia.any() and not valuation.changes(body.mass):
        yield Finding(place, "an inertia without a mass", "give the body a mass too, or set allow_unphysical: true")
    a, b, c = np.linalg.eigvalsh(inertia)
    if a + b < c - INERTIA_TOLERANCE * np.abs(inertia).max():
        finding = f"no body has the principal moments of inertia {a:.6g}, {b:.6g}, {c:.6g}"
        remedy = "none may be more than the sum of the others; mend them, or set allow_unphysical: true"
        yield Finding(place, finding, remedy)
