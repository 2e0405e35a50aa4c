"""The two sides of a link: the variables that its expressions read, by name.

    end_NAME, start_NAME      a quantity at the end of the phase before, at the start of the phase after

NAME is as in a problem: q_NAME, qd_NAME, u_NAME, x_SENSOR, vx_SENSOR, T. Impulses of an impact are jx_SENSOR to
jz_SENSOR, of stops j_JOINT. Maps read coordinates by their plain names.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from mbsgen.expressions import spell
from mbsgen.manifest import Manifest
from mbsrun.ocp.ground.functions import Indices
from mbsrun.ocp.ground.program import Column
from mbsrun.ocp.problem.phases import Blow
from mbsrun.ocp.problem.problem import Contact, Form, Problem
from mbsrun.ocp.transcription.addition import move_part
from mbsrun.ocp.transcription.layout import at_mesh
from mbsrun.ocp.transcription.transcription import Transcription
from mbsrun.quantities import SENSED, Added, Quantity, list_quantities
from mbsrun.quaternions import find_quaternion, list_quaternions

END, START = "end_", "start_"
IMPULSE = "j"  # before the axis and the name of a contact's sensor
READ = (
    "q",
    "qd",
    "qdd",
    "u",
    "w",
    "T",
    *SENSED,
    "states",
    "controls",
)  # kinds of quantities that a condition may read


def spell_coordinates(manifest: Manifest) -> dict[str, int]:
    """Return the entries of q by their names in maps."""
    return {name[2:]: x.index for name, x in list_quantities(manifest).items() if x.kind == "q"}


def spell_velocities(manifest: Manifest) -> dict[str, int]:
    """Return the entries of qd by their names in maps."""
    return {name[3:]: x.index for name, x in list_quantities(manifest).items() if x.kind == "qd"}


def list_readable(manifest: Manifest, problem: Problem) -> dict[str, Quantity]:
    """List the quantities of one side that a condition may read, by name; accelerations, where they are variables."""
    own = Added(tuple(state.name for state in problem.states), problem.added.controls)
    has_accelerations = not (problem.representation.is_ode or manifest.loops or problem.form is Form.SHOOTING)
    kinds = [kind for kind in READ if kind != "qdd" or has_accelerations]
    return {name: x for name, x in list_quantities(manifest, own).items() if x.kind in kinds}


def name_impulses(contacts: Sequence[Contact]) -> list[tuple[str, int, int]]:
    """Name the impulses of contacts: name, number of the contact, number among its axes."""
    spelled = spell([contact.sensor for contact in contacts])
    return [
        (f"{IMPULSE}{'xyz'[axis]}_{name}", i, k)
        for i, (name, contact) in enumerate(zip(spelled, contacts, strict=True))
        for k, axis in enumerate(contact.axes)
        if name is not None
    ]


def name_blows(blows: Sequence[Blow]) -> list[tuple[str, int]]:
    """Name the impulses of stops, j_JOINT, each with its number."""
    return [(f"{IMPULSE}_{x}", i) for i, x in enumerate(spell([blow.joint for blow in blows])) if x is not None]


def list_plain(manifest: Manifest) -> list[str]:
    """List the coordinates that are no entries of quaternions."""
    turning = list_quaternions(manifest)
    return [name for i, name in enumerate(manifest.positions) if find_quaternion(turning, i) is None]


@dataclass(frozen=True)
class State:
    """Coordinates and velocities of a mechanism as variables of a program."""

    manifest: Manifest
    plant: int
    q: Indices  # (nq,)
    qd: Indices  # (velocities,)
    velocities: tuple[int, ...]  # entries of qd that are variables
    added: Mapping[str, int] = field(default_factory=dict)  # the variables of states that the problem adds, by name

    @property
    def speeds(self) -> Mapping[str, int]:
        """Return the variables of velocities by the names of their coordinates."""
        names = [self.manifest.coordinates[i].name for i in self.velocities]
        return dict(zip(names, self.qd.tolist(), strict=True))

    @property
    def coordinates(self) -> Mapping[str, int]:
        """Return the variables of coordinates by name."""
        return dict(zip(self.manifest.positions, self.q.tolist(), strict=True))


@dataclass(frozen=True)
class Side:
    """The end or the start of a phase."""

    prefix: str
    state: State
    parts: Mapping[str, Column]  # of the variables, by the kinds of quantities
    readable: Mapping[str, Quantity]  # by the names in conditions
    horizon: int | float  # the variable, or the number where it is given


def read_side(
    part: Transcription, manifest: Manifest, plant: int, offset: int, problem: Problem, *, is_end: bool
) -> Side:
    """Return one side of a phase whose variables begin at `offset`."""
    layout = part.layout
    k = layout.grid.intervals if is_end else 0
    q, qd = layout.split(layout.mesh[k] + offset)
    names = [state.name for state in problem.states]
    states = layout.extras.states[k, : len(names)] + offset
    prefix, known = END if is_end else START, dict(zip(names, states.tolist(), strict=True))
    places = at_mesh(layout, part.integrator, [k]).parts
    return Side(
        prefix=prefix,
        state=State(manifest, plant, q, qd, layout.motions.velocities, known),
        parts={kind: move_part(places[kind], offset) for kind in READ if kind in places},
        readable={prefix + name: x for name, x in list_readable(manifest, problem).items()},
        horizon=problem.horizon if layout.horizon is None else layout.horizon + offset,
    )
