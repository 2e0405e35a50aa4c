"""The formulations and other functions of a tree, by name: what can be generated, and what each is derived by."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from mbsgen.formulations import impl, poses
from mbsgen.formulations.links import PARAMETERS
from mbsgen.model.tree import Tree
from mbsgen.tape.types import Tape

SETUP = "h"  # what `setup` computes from the parameters


@dataclass(frozen=True)
class Entry:
    """A function that a tree can be written to."""

    build: Callable[[Tree], Tape]
    title: str  # for readers of the generated code
    differentiated: bool  # by all inputs but parameters


MEANINGS: Mapping[str, str] = MappingProxyType(
    {
        "q": "joint coordinates, rad or m",
        "qd": "joint velocities, rad/s or m/s",
        "qdd": "joint accelerations, rad/s2 or m/s2",
        "u": "forces of the actuated joints, in joint order, N m or N",
        PARAMETERS: "run-time parameters, in the manifest's order",
        SETUP: "what setup computes from the run-time parameters",
        "Phi": "residual Phi(q, qd, qdd) - Q(q, qd, u), N m or N",
        "position": "places of the sensors in the base frame, a column each, m",
        "frames.p": "origins of the frames in the base frame, a column each, m",
        "R": "axes of the frames as columns, in the base frame",
    }
)

FUNCTIONS: Mapping[str, Entry] = MappingProxyType(
    {
        "impl": Entry(impl.build, "residual of the equations of motion, recursive Newton-Euler", differentiated=True),
        "sensors": Entry(poses.build_sensors, "places of the sensors", differentiated=True),
        "frames": Entry(poses.build_frames, "poses of all bodies and sensors", differentiated=False),
    }
)

# What each formulation's row of the flop table counts: the dynamics alone, as in the paper's Table 4.
FORMULATIONS: Mapping[str, Callable[[Tree], Tape]] = MappingProxyType({"IMPL": impl.build})


def without_forces(tree: Tree) -> Tree:
    """Make every joint passive: what is left of the residual is Phi."""
    return replace(tree, bodies=tuple(replace(b, joint=replace(b.joint, actuated=False)) for b in tree.bodies))
