"""The formulations and other functions of a tree, by name: what can be generated, and what each is derived by."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType

from mbsgen.formulations import condition, coupling, energy, exp1, exp2, impl, ports, poses, rates, semi, velocities
from mbsgen.formulations.reductions import Reductions
from mbsgen.model.tree import Tree
from mbsgen.tape.ports import Port
from mbsgen.tape.types import Tape


@dataclass(frozen=True)
class Entry:
    """A function that a tree can be written to."""

    build: Callable[[Tree, Reductions], Tape]
    title: str  # for readers of the generated code
    results: tuple[Port, ...]
    differentiated: bool  # by all inputs but parameters
    of_sensors: bool = False  # a tree without sensors has no such function
    of_quaternions: bool = False  # nor one without quaternions
    of_dynamics: bool = False  # a form of the equations of motion: its derivatives may be written by mechanics


def _plainly(build: Callable[[Tree], Tape]) -> Callable[[Tree, Reductions], Tape]:
    """Take a function that no reduction concerns."""
    return lambda tree, _: build(tree)


_UNCOUPLED: Mapping[str, Entry] = MappingProxyType(
    {
        "impl": Entry(
            impl.build,
            "residual of the equations of motion, recursive Newton-Euler",
            results=(ports.RESIDUAL,),
            differentiated=True,
            of_dynamics=True,
        ),
        "semi": Entry(
            semi.build,
            "mass matrix and bias: M qdd + c = Q",
            results=(ports.MASS_MATRIX, ports.BIAS),
            differentiated=False,
        ),
        "semi_res": Entry(
            semi.build_residual,
            "residual by mass matrix and bias: M qdd + c - Q",
            results=(ports.RESIDUAL,),
            differentiated=True,
            of_dynamics=True,
        ),
        "exp1": Entry(
            exp1.build,
            "accelerations by elimination in the mass matrix",
            results=(ports.ACCELERATIONS,),
            differentiated=True,
            of_dynamics=True,
        ),
        "exp2": Entry(
            exp2.build,
            "accelerations by articulated bodies, order N",
            results=(ports.ACCELERATIONS,),
            differentiated=True,
            of_dynamics=True,
        ),
        "sensors": Entry(
            _plainly(poses.build_sensors),
            "places of the sensors",
            results=(ports.POSITION,),
            differentiated=True,
            of_sensors=True,
        ),
        "motion": Entry(
            _plainly(velocities.build_motion),
            "velocities of the sensors",
            results=(ports.VELOCITY, ports.ANGULAR_VELOCITY),
            differentiated=True,
            of_sensors=True,
        ),
        "jacobian": Entry(
            _plainly(velocities.build_jacobian),
            "Jacobians of the sensors",
            results=(ports.SENSOR_JACOBIAN,),
            differentiated=False,
            of_sensors=True,
        ),
        "condition": Entry(
            condition.build,
            "how many digits exp1 and exp2 lose at a position",
            results=(ports.ELIMINATION, ports.ARTICULATED),
            differentiated=False,
        ),
        "energy": Entry(
            _plainly(energy.build),
            "energy and momentum",
            results=(ports.KINETIC, ports.POTENTIAL, ports.MOMENTUM, ports.ANGULAR_MOMENTUM, ports.CENTRE_OF_MASS),
            differentiated=False,
        ),
        "power": Entry(
            _plainly(energy.build_power),
            "power of all forces but gravity",
            results=(ports.POWER,),
            differentiated=False,
        ),
        "rates": Entry(
            _plainly(rates.build),
            "time derivatives of the coordinates",
            results=(ports.RATES,),
            differentiated=True,
            of_quaternions=True,
        ),
        "frames": Entry(
            _plainly(poses.build_frames),
            "poses of all bodies and sensors",
            results=(ports.ORIGINS, ports.ROTATIONS),
            differentiated=False,
        ),
    }
)


FUNCTIONS: Mapping[str, Entry] = MappingProxyType(
    {name: replace(entry, build=partial(coupling.write, entry.build)) for name, entry in _UNCOUPLED.items()}
)


RESULTS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {name: tuple(port.name for port in entry.results) for name, entry in FUNCTIONS.items()}
)


def select_functions(tree: Tree) -> Mapping[str, Entry]:
    """Select the functions that a tree has: those of sensors and quaternions where there are any."""
    return {
        name: entry
        for name, entry in FUNCTIONS.items()
        if (tree.sensors or not entry.of_sensors) and (tree.quaternions or not entry.of_quaternions)
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
