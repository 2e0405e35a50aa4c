"""The formulations and other functions of a tree, by name: what can be generated, and what each is derived by."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType

from mbsgen.formulations import condition, coupling, energy, exp1, exp2, impl, poses, rates, semi, velocities
from mbsgen.formulations.links import DESIGN, PARAMETERS
from mbsgen.formulations.reductions import Reductions
from mbsgen.model.tree import Tree
from mbsgen.tape.types import Tape

SETUP = "h"  # what `setup` computes from the parameters


@dataclass(frozen=True)
class Entry:
    """A function that a tree can be written to."""

    build: Callable[[Tree, Reductions], Tape]
    title: str  # for readers of the generated code
    results: tuple[str, ...]
    differentiated: bool  # by all inputs but parameters
    of_sensors: bool = False  # a tree without sensors has no such function
    of_quaternions: bool = False  # nor one without quaternions
    of_uncoupled: bool = False  # nor one with joints that follow others
    of_dynamics: bool = False  # a form of the equations of motion: its derivatives may be written by mechanics


def _plainly(build: Callable[[Tree], Tape]) -> Callable[[Tree, Reductions], Tape]:
    """Take a function that no reduction concerns."""
    return lambda tree, _: build(tree)


MEANINGS: Mapping[str, str] = MappingProxyType(
    {
        "q": "joint coordinates, rad or m",
        "qd": "joint velocities, rad/s or m/s",
        "qdd": "joint accelerations, rad/s2 or m/s2",
        "u": "forces of the actuated joints, in joint order, N m or N",
        "w": "external forces and moments that the model leaves open, in its order, N and N m",
        DESIGN: "differentiated parameters, in the manifest's order",
        PARAMETERS: "run-time parameters, in the manifest's order",
        SETUP: "what setup computes from the run-time parameters",
        "Phi": "residual Phi(q, qd, qdd) - Q(q, qd, u), N m or N",
        "M": "mass matrix, kg m2, kg m or kg",
        "c": "bias: the joints' forces at qdd = 0, N m or N",
        "position": "places of the sensors in the base frame, a column each, m",
        "v": "velocities of the sensors in the base frame, a column each, m/s",
        "omega": "angular velocities of the sensors in the base frame, a column each, rad/s",
        "J": "six rows for each sensor: J qd is its velocity, then its angular velocity, in the base frame",
        "elimination": "by joint, what rounding is multiplied by in exp1: M_ii times the same entry of M^-1",
        "articulated": "by joint, what rounding is multiplied by in exp2: |inertia| times |what it gives way|",
        "kinetic": "kinetic energy, J",
        "potential": "potential energy of gravity, 0 with all mass at the base's origin, J",
        "power": "power of all forces but gravity, W",
        "momentum": "momentum in the base frame, kg m/s",
        "angular_momentum": "moment of momentum about the base's origin, in the base frame, kg m2/s",
        "com": "centre of mass in the base frame, m",
        "frames.p": "origins of the frames in the base frame, a column each, m",
        "R": "axes of the frames as columns, in the base frame",
        "rate": "time derivatives of q",
    }
)

_UNCOUPLED: Mapping[str, Entry] = MappingProxyType(
    {
        "impl": Entry(
            impl.build,
            "residual of the equations of motion, recursive Newton-Euler",
            results=("Phi",),
            differentiated=True,
            of_dynamics=True,
        ),
        "semi": Entry(semi.build, "mass matrix and bias: M qdd + c = Q", results=("M", "c"), differentiated=False),
        "semi_res": Entry(
            semi.build_residual,
            "residual by mass matrix and bias: M qdd + c - Q",
            results=("Phi",),
            differentiated=True,
            of_dynamics=True,
        ),
        "exp1": Entry(
            exp1.build,
            "accelerations by elimination in the mass matrix",
            results=("qdd",),
            differentiated=True,
            of_dynamics=True,
        ),
        "exp2": Entry(
            exp2.build,
            "accelerations by articulated bodies, order N",
            results=("qdd",),
            differentiated=True,
            of_dynamics=True,
        ),
        "sensors": Entry(
            _plainly(poses.build_sensors),
            "places of the sensors",
            results=("position",),
            differentiated=True,
            of_sensors=True,
        ),
        "motion": Entry(
            _plainly(velocities.build_motion),
            "velocities of the sensors",
            results=("v", "omega"),
            differentiated=True,
            of_sensors=True,
        ),
        "jacobian": Entry(
            _plainly(velocities.build_jacobian),
            "Jacobians of the sensors",
            results=("J",),
            differentiated=False,
            of_sensors=True,
        ),
        "condition": Entry(
            condition.build,
            "how many digits exp1 and exp2 lose at a position",
            results=("elimination", "articulated"),
            differentiated=False,
            of_uncoupled=True,
        ),
        "energy": Entry(
            _plainly(energy.build),
            "energy and momentum",
            results=("kinetic", "potential", "momentum", "angular_momentum", "com"),
            differentiated=False,
        ),
        "power": Entry(
            _plainly(energy.build_power),
            "power of all forces but gravity",
            results=("power",),
            differentiated=False,
        ),
        "rates": Entry(
            _plainly(rates.build),
            "time derivatives of the coordinates",
            results=("rate",),
            differentiated=True,
            of_quaternions=True,
        ),
        "frames": Entry(
            _plainly(poses.build_frames), "poses of all bodies and sensors", results=("p", "R"), differentiated=False
        ),
    }
)


FUNCTIONS: Mapping[str, Entry] = MappingProxyType(
    {name: replace(entry, build=partial(coupling.write, entry.build)) for name, entry in _UNCOUPLED.items()}
)


def select_functions(tree: Tree) -> Mapping[str, Entry]:
    """Select the functions that a tree has: those of sensors, quaternions and uncoupled joints where there are any."""
    return {
        name: entry
        for name, entry in FUNCTIONS.items()
        if (tree.sensors or not entry.of_sensors)
        and (tree.quaternions or not entry.of_quaternions)
        and not (tree.couplings and entry.of_uncoupled)
    }


@dataclass(frozen=True)
class Row:
    """A formulation's row of the flop table: the dynamics alone, as in the paper's Table 4."""

    build: Callable[[Tree, Reductions], Tape]
    driven: bool  # every joint has a force that is given; else none has


FORMULATIONS: Mapping[str, Row] = MappingProxyType(
    {
        "IMPL": Row(partial(coupling.write, impl.build), driven=False),  # Phi
        "SEMI": Row(partial(coupling.write, semi.build), driven=False),  # M, one triangle, and c
        "EXP1": Row(partial(coupling.write, exp1.build), driven=True),  # gamma(q, qd, Q)
        "EXP2": Row(partial(coupling.write, exp2.build), driven=True),  # nu(q, qd, Q)
    }
)
