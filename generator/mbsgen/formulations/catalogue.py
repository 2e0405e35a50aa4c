"""The catalogue: the functions that a tree can be written to. A function is added by one entry.

The equations of motion stand in four forms, after Docquier, Bruls and Fisette (2019):

    impl        Phi(q, qd, qdd) - Q = 0       recursive Newton-Euler
    semi        M(q) qdd + c(q, qd) = Q       composite bodies; `semi_res` is their residual
    exp1        qdd = M^-1 (Q - c)            elimination in M
    exp2        qdd                           articulated bodies

An entry says which trees have the function, how it is differentiated, and whether the report counts it. The function is
verified, compared with others and judged by the roles of its results.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

from mbsgen.formulations import closure, condition, coupling, exp1, exp2, impl, ports, rates, semi, tables
from mbsgen.formulations.loops import closing, projection, reduced
from mbsgen.formulations.planning import dynamics_alone
from mbsgen.formulations.reductions import Reductions
from mbsgen.formulations.results import elements, energy, meetings, poses, reactions, regressor, touching, velocities
from mbsgen.model.tree import Tree
from mbsgen.procedure.procedure import Computation, Procedure, straight
from mbsgen.roles import Role
from mbsgen.tape.ports import Port
from mbsgen.tape.types import Tape

Build = Callable[[Tree, Reductions], Computation]


@dataclass(frozen=True)
class Need:
    """A property of the trees that have a function."""

    holds: Callable[[Tree], bool]
    refusal: str  # of another tree; {name} and {tree} stand for names


SENSORS = Need(lambda tree: bool(tree.sensors), "{name} is of sensors, and {tree} has none; name some under `frames:`")
CONTACTS = Need(
    lambda tree: bool(tree.distances), "{name} is of contacts, and {tree} has none; name some under `contacts:`"
)
RIGID = Need(
    lambda tree: bool(tree.rigid), "{name} is of rigid contacts, and {tree} has none; give some a `restitution`"
)
MEETINGS = Need(
    lambda tree: bool(tree.meetings),
    "{name} is of solids in rigid contact, and {tree} has none; give boxes or hulls that touch a `restitution`",
)
COMPLIANT = Need(
    lambda tree: not (tree.rigid or tree.meetings),
    "{name} misses the forces of rigid contacts, which {tree} has; simulations find them",
)
ELEMENTS = Need(
    lambda tree: bool(tree.elements), "{name} is of springs and cables, and {tree} has none; name some under `forces:`"
)
QUATERNIONS = Need(
    lambda tree: bool(tree.quaternions),
    "{name} is of quaternions, and {tree} has none; the rates of its coordinates are qd",
)
OPEN = Need(
    lambda tree: not tree.is_constrained,
    "{name} does not estimate what loops and driven joints lose, and {tree} has some; leave it out",
)
LOOPS = Need(
    lambda tree: bool(tree.loops or tree.constraints),
    "{name} is of loops, and {tree} has none; close some under `loops:`",
)


@dataclass(frozen=True)
class Row:
    """A formulation's row of the flop table: the dynamics alone, as in the paper's Table 4."""

    driven: bool  # every joint has a force that is given; else none has
    longest: int  # the bodies of the longest chain that the command `scaling` counts


@dataclass(frozen=True)
class Entry:
    """A function that a tree can be written to.

    A form of the equations of motion gives a residual or accelerations. Its derivatives may be written by mechanics,
    from the derivatives of the function REFERENCE, whatever its own recursion is.
    """

    build: Build  # of any tree, see `project`; a procedure is differentiated by `iterated` alone
    title: str  # for readers of the generated code
    results: tuple[Port, ...]
    order: int = 0  # up to which it is differentiated, by all inputs but parameters
    needs: tuple[Need, ...] = ()
    is_form: bool = False  # of the equations of motion
    row: Row | None = None
    iterated: Callable[[Tree], Procedure] | None = None  # the same by iterations, if this is to be differentiated
    by_adjoint: bool = False  # of its derivatives the adjoint alone is written: others would be long
    same_as: str = ""  # another entry that computes the same, and is judged in its place
    by_tables: Callable[[Tree, Reductions], Procedure] | None = None  # the same of a large tree, with loops over tables

    def gives(self, role: Role) -> bool:
        """Return whether a result has a role."""
        return any(port.role is role for port in self.results)


def project(build: coupling.Build, coupled: coupling.Build | None = None) -> coupling.Build:
    """Return a function of any tree, from one that ignores couplings; `coupled` writes trees that have some.

    Without `coupled`, the results are projected by virtual power: none of them may be accelerations.
    """
    return partial(coupling.write, build, coupled)


def _plainly(build: Callable[[Tree], Tape]) -> coupling.Build:
    """Return a function that no reduction concerns."""
    return project(lambda tree, _: build(tree))


def is_by_tables(entry: Entry, tree: Tree, size: int) -> bool:
    """Return whether a function of a tree is written with loops over tables, from `size` pairs of bodies on."""
    return entry.by_tables is not None and tables.can_loop(tree, size)


REFERENCE = "impl"  # the form of the equations of motion that all others are compared with

# In the order of the generated files. A plain dictionary, so that a test may add an entry.
FUNCTIONS: Mapping[str, Entry] = {
    "impl": Entry(
        project(impl.build),
        "residual of the equations of motion, recursive Newton-Euler",
        results=(ports.RESIDUAL,),
        order=2,
        is_form=True,
        row=Row(driven=False, longest=100),
    ),
    "semi": Entry(
        project(semi.build),
        "mass matrix and bias: M qdd + c = Q",
        results=(ports.MASS_MATRIX, ports.BIAS),
        row=Row(driven=False, longest=50),
        by_tables=tables.write_semi,
    ),
    "semi_res": Entry(
        project(semi.build_residual),
        "residual by mass matrix and bias: M qdd + c - Q",
        results=(ports.RESIDUAL,),
        order=2,
        is_form=True,
        same_as="impl",
    ),
    "exp1": Entry(
        project(exp1.build, coupling.write_exp1),
        "accelerations by elimination in the mass matrix",
        results=(ports.ACCELERATIONS,),
        order=2,
        is_form=True,
        row=Row(driven=True, longest=50),
        same_as="exp2",
    ),
    "exp2": Entry(
        project(exp2.build, coupling.write_exp2),
        "accelerations by articulated bodies, order N",
        results=(ports.ACCELERATIONS,),
        order=2,
        is_form=True,
        row=Row(driven=True, longest=100),
    ),
    "sensors": Entry(
        _plainly(poses.build_sensors), "places of the sensors", results=(ports.POSITION,), order=2, needs=(SENSORS,)
    ),
    "motion": Entry(
        _plainly(velocities.build_motion),
        "velocities of the sensors",
        results=(ports.VELOCITY, ports.ANGULAR_VELOCITY),
        order=2,
        needs=(SENSORS,),
    ),
    "accelerations": Entry(
        _plainly(velocities.build_accelerations),
        "accelerations of the sensors",
        results=(ports.ACCELERATION, ports.ANGULAR_ACCELERATION),
        order=2,
        needs=(SENSORS,),
    ),
    "attitudes": Entry(
        _plainly(poses.build_attitudes),
        "rotations of the sensors",
        results=(ports.ATTITUDE,),
        order=2,
        needs=(SENSORS,),
    ),
    "jacobian": Entry(
        _plainly(velocities.build_jacobian),
        "Jacobians of the sensors",
        results=(ports.SENSOR_JACOBIAN,),
        needs=(SENSORS,),
    ),
    "distances": Entry(
        _plainly(poses.build_distances),
        "distances of points of contact",
        results=(ports.DISTANCE,),
        order=2,
        needs=(CONTACTS,),
    ),
    "touching": Entry(
        _plainly(touching.build),
        "distances, normals and velocities of rigid contacts",
        results=(ports.CLEARANCE, ports.CONTACT_NORMAL, ports.CONTACT_JACOBIAN),
        order=1,
        needs=(RIGID,),
    ),
    "meetings": Entry(
        _plainly(meetings.build),
        "poses and relative velocities of solids in rigid contact",
        results=(ports.SOLID_PLACES, ports.SOLID_AXES, ports.SOLID_TWISTS),
        order=1,
        needs=(MEETINGS,),
    ),
    "lengths": Entry(
        _plainly(elements.build_lengths),
        "lengths of springs and cables",
        results=(ports.LENGTH,),
        order=2,
        needs=(ELEMENTS,),
    ),
    "stretches": Entry(
        _plainly(elements.build_rates),
        "rates of the lengths of springs and cables",
        results=(ports.STRETCH,),
        order=2,
        needs=(ELEMENTS,),
    ),
    "tensions": Entry(
        _plainly(elements.build_tensions),
        "tensions of springs and cables",
        results=(ports.TENSION,),
        needs=(ELEMENTS,),
    ),
    "contact_forces": Entry(
        _plainly(elements.build_contacts),
        "forces of contacts",
        results=(ports.NORMAL_FORCE, ports.CONTACT_FORCE),
        needs=(CONTACTS, COMPLIANT),
    ),
    "reactions": Entry(
        _plainly(reactions.build),
        "forces and moments in the joints",
        results=(ports.REACTION_FORCE, ports.REACTION_MOMENT),
        needs=(COMPLIANT,),
    ),
    "regressor": Entry(
        _plainly(regressor.build),
        "regressor of the bodies' inertias",
        results=(ports.REGRESSOR,),
        order=1,
        by_adjoint=True,
    ),
    "condition": Entry(
        project(condition.build, coupling.write_condition),
        "how many digits exp1 and exp2 lose at a position",
        results=(ports.ELIMINATION, ports.ARTICULATED),
        needs=(OPEN,),
    ),
    "energy": Entry(
        _plainly(energy.build),
        "energy and momentum",
        results=(
            ports.KINETIC,
            ports.POTENTIAL,
            ports.MOMENTUM,
            ports.ANGULAR_MOMENTUM,
            ports.CENTRE_OF_MASS,
        ),
    ),
    "power": Entry(_plainly(energy.build_power), "power of all forces but gravity", results=(ports.POWER,)),
    "rates": Entry(
        _plainly(rates.build),
        "time derivatives of the coordinates",
        results=(ports.RATES,),
        order=2,
        needs=(QUATERNIONS,),
    ),
    "loops": Entry(
        _plainly(closure.build), "what is left open of loops", results=(ports.CLOSURE,), order=2, needs=(LOOPS,)
    ),
    "loop_rates": Entry(
        _plainly(closure.build_rates),
        "rates at which loops open",
        results=(ports.CLOSURE_RATE,),
        order=2,
        needs=(LOOPS,),
    ),
    "loop_accelerations": Entry(
        _plainly(closure.build_accelerations),
        "accelerations at which loops open",
        results=(ports.CLOSURE_ACCELERATION,),
        order=2,
        needs=(LOOPS,),
    ),
    "loop_forces": Entry(
        _plainly(closure.write_forces),
        "joint forces of multipliers",
        results=(ports.JOINT_FORCES,),
        order=2,
        needs=(LOOPS,),
    ),
    "loop_jacobian": Entry(
        _plainly(closure.build_jacobian),
        "Jacobian of loops, and the bias of their accelerations",
        results=(ports.CLOSURE_JACOBIAN, ports.CLOSURE_BIAS),
        needs=(LOOPS,),
    ),
    "close": Entry(
        lambda tree, _: closing.build(tree),
        "coordinates with all loops closed, from the independent ones",
        results=(ports.CLOSED,),
        order=2,
        iterated=closing.build_iterated,
        needs=(LOOPS,),
    ),
    "close_rates": Entry(
        lambda tree, _: closing.build_rates(tree),
        "velocities that keep loops closed, from the independent ones",
        results=(ports.CLOSED_VELOCITIES,),
        order=2,
        needs=(LOOPS,),
    ),
    "close_accelerations": Entry(
        lambda tree, _: closing.build_accelerations(tree),
        "accelerations that keep loops closed, from the independent ones",
        results=(ports.CLOSED_ACCELERATIONS,),
        order=2,
        needs=(LOOPS,),
    ),
    "project": Entry(
        partial(projection.build, weighted=True),
        "coordinates and velocities with all loops closed, by the least change of kinetic energy",
        results=(ports.CLOSED, ports.PROJECTED_VELOCITIES),
        needs=(LOOPS,),
    ),
    "project_plain": Entry(
        partial(projection.build, weighted=False),
        "coordinates and velocities with all loops closed, by the least change of either",
        results=(ports.CLOSED, ports.PROJECTED_VELOCITIES),
        needs=(LOOPS,),
    ),
    "impl_red": Entry(
        reduced.build_residual,
        "residual of the independent coordinates, recursive Newton-Euler",
        results=(ports.REDUCED_RESIDUAL,),
        order=2,
        needs=(LOOPS,),
    ),
    "semi_red": Entry(
        reduced.build_terms,
        "mass matrix and bias of the independent coordinates: M ydd + c = ZT Q",
        results=(ports.REDUCED_MASS_MATRIX, ports.REDUCED_BIAS),
        needs=(LOOPS,),
    ),
    "exp1_red": Entry(
        reduced.build_accelerations,
        "accelerations of the independent coordinates",
        results=(ports.INDEPENDENT_ACCELERATIONS,),
        order=2,
        needs=(LOOPS,),
    ),
    "frames": Entry(
        _plainly(poses.build_frames), "poses of all bodies and sensors", results=(ports.ORIGINS, ports.ROTATIONS)
    ),
}


def list_results() -> Mapping[str, tuple[str, ...]]:
    """List the names of the results of every function."""
    return {name: tuple(port.name for port in entry.results) for name, entry in FUNCTIONS.items()}


def list_rows() -> Mapping[str, Row]:
    """List the rows of the flop table by their names: IMPL, SEMI, EXP1, EXP2."""
    return {name.upper(): entry.row for name, entry in FUNCTIONS.items() if entry.row}


def write_row(name: str, tree: Tree, reductions: Reductions) -> Tape:
    """Write the function of a row of the flop table: the dynamics of a tree alone."""
    driven = list_rows()[name].driven
    return straight(FUNCTIONS[name.lower()].build(dynamics_alone(tree, driven=driven), reductions))


def list_giving(role: Role) -> tuple[str, ...]:
    """Name the functions that have a result of a role."""
    return tuple(name for name, entry in FUNCTIONS.items() if entry.gives(role))


def select_functions(tree: Tree) -> Mapping[str, Entry]:
    """Select the functions that a tree has."""
    return {name: entry for name, entry in FUNCTIONS.items() if all(need.holds(tree) for need in entry.needs)}


def refuse(name: str, tree: Tree) -> str:
    """Return why a tree does not have a function of the catalogue."""
    need = next(need for need in FUNCTIONS[name].needs if not need.holds(tree))
    return need.refusal.format(name=name, tree=tree.name)
