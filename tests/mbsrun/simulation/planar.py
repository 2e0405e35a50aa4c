"""Planar bodies with rigid contacts, for tests."""

from __future__ import annotations

import copy

from mbsrun import Mechanism
from mbsrun.models import Extent

NEEDED = Extent(("exp2", "impl", "semi", "semi_res", "energy", "power", "frames", "touching", "distances"), 1)
PLANAR = """
name: planar
gravity: [gx, 0, gz]
parameters: {{gx: {{value: 0, kind: runtime}}, gz: {{value: -9.81, kind: runtime}}}}
bodies:
  - name: body
    joint:
      - {{name: x, type: prismatic, axis: x, actuated: false}}
      - {{name: z, type: prismatic, axis: z, actuated: false}}
      - {{name: turn, type: revolute, axis: y, actuated: false}}
    mass: 1
    inertia: [1, {inertia}, 1]
contacts:
"""
POINT = (
    "  - {{name: {}, body: body, position: [{}, 0, {}], radius: {}, restitution: 0, friction: {{coefficient: 0}}}}\n"
)
HALF = 0.5  # of the rod
ROD = PLANAR.format(inertia=HALF**2 / 3) + POINT.format("tip", 0, -HALF, 0)


def grip(kernels: Mechanism, coefficient: float, restitution: float = 0.0) -> Mechanism:
    """Change the laws of all contacts, of which the kernels know nothing."""
    found, laws = copy.copy(kernels), {"coefficient": coefficient, "restitution": restitution}
    points = tuple(point.model_copy(update=laws) for point in kernels.manifest.rigid)
    found.manifest = kernels.manifest.model_copy(update={"rigid": points})
    return found
