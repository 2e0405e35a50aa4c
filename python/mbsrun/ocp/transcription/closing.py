"""Closed loops in a program: the parts of a motion that are variables, and the blocks that loops add.

With h(q) = 0 the m equations of the loops and J its Jacobian, the form `multipliers` has at each point j

    sum_r D_jr q_kr - h qd_kj - J(q_kj)' mu_kj = 0            nq rows
    sum_r D_jr qd_kr - h z_kj = 0                             n rows
    Phi(q_kj, qd_kj, z_kj, u_k) - J(q_kj)' lam_kj = 0         n rows
    h(q_kj) = 0,  J(q_kj) qd_kj = 0                           2 m rows

(Gear, Leimkuhler, Gupta, "Automatic integration of Euler-Lagrange equations with constraints", 1985; Hairer, Wanner,
"Solving ordinary differential equations II", VII.2.) The corrections mu vanish with the error of the discretisation.
Without them, the loops could not be closed at all points and mesh points at once: a state at a mesh point would have
more conditions than unknowns, or the loops would drift open (Posa, Kuindersma, Tedrake, ICRA 2016; Bordalba,
Schoels, Ros, Porta, Diehl, IEEE Transactions on Robotics 39, 2023). Collocation points include the mesh points, so
loops are closed there too. Explicit forms give z and lam as functions of the state, and take a second correction:

    sum_r D_jr qd_kr - h qdd(q_kj, qd_kj, u_k) - J(q_kj)' nu_kj = 0

The form `reduced` carries on the independent coordinates y and their velocities alone; the dependent coordinates are
inner variables, found from h(q_kj) = 0 at every point and mesh point:

    sum_r D_jr y_kr - h yd_kj = 0,    sum_r D_jr yd_kr - h ydd_kj = 0,    Phi_red(q_kj, yd_kj, ydd_kj, u_k) = 0

Velocities of dependent coordinates are variables only where a problem reads them; J(q_kj) qd_kj = 0 gives them.

Driven joints have given coordinates, velocities and accelerations: collocation carries neither on, corrections leave
them alone, and independent coordinates are the others. The forces of driven joints are unknowns of the equations of
motion.

The integral form and shooting exist in the reduced form. Independent coordinates at the places of an interval are
linear in accelerations; dependent ones are inner variables at all stages, at points that are no stages, and at the
interval's end. There they are the ones at the mesh point before, plus shifts. Newton's method begins with shifts of 0,
so the mechanism stays assembled as it is.

Where joints have quaternions, q' = E(q) qd: the first rows have E qd_kj and E J' mu_kj. The rotation does not depend on
a quaternion's length. So h has no slope along it, and neither E qd nor E J' mu changes it. In the reduced form,
collocation carries on a quaternion whose three velocities are independent; where all three are dependent, h(q) = 0 and
|x|^2 = 1 give it. A joint of which only some velocities are independent has no coordinates for them to carry on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from mbsgen.manifest import Manifest
from mbsrun.ocp.ground import formulas
from mbsrun.ocp.ground.functions import Array, Indices, KernelResult
from mbsrun.ocp.ground.program import Block, Column
from mbsrun.ocp.ground.representations import Loops
from mbsrun.ocp.problem.problem import list_names
from mbsrun.ocp.problem.structure import Structure
from mbsrun.ocp.transcription.layout import Motions, Places
from mbsrun.quantities import list_quantities
from mbsrun.quaternions import list_entries, list_places, list_quaternions

POSITIONS = KernelResult("loops", ("q",), "gap")
RATES = KernelResult("loop_rates", ("q", "qd"), "hd")
FORCES = KernelResult("loop_forces", ("q", "lam"), "Q")


def list_motions(shape: Structure, manifest: Manifest) -> Motions:
    """List the parts of a motion that are variables of a program."""
    nq, every, m = len(manifest.positions), tuple(range(len(manifest.coordinates))), len(manifest.dependent)
    driven, driven_places = manifest.driven, tuple(list_entries(manifest, manifest.driven))
    moved = manifest.independent if shape.loops is Loops.REDUCED else every
    independent = tuple(i for i in moved if i not in driven)
    motions = Motions(
        nq,
        tuple(i for i in range(nq) if i not in driven_places),
        every,
        independent,
        moved=moved,
        driven=driven,
        driven_places=driven_places,
    )
    if shape.loops is None:
        return motions
    if shape.loops is Loops.REDUCED:
        places = tuple(list_entries(manifest, independent))
        velocities = every if _reads_dependent_velocities(shape, manifest) else manifest.independent
        lengths = tuple(x.first for x in list_quaternions(manifest) if x.first not in places)
        return replace(motions, places=places, velocities=velocities, lengths=lengths)
    equations = shape.representation.equations
    has_multipliers = equations.has_accelerations and not equations.is_explicit
    corrections = m * (2 if equations.is_explicit else 1)
    return replace(motions, multipliers=m * has_multipliers, corrections=corrections)


def _reads_dependent_velocities(shape: Structure, manifest: Manifest) -> bool:
    """Return whether a problem reads the velocities of dependent coordinates, by bounds, targets or expressions.

    The kernel `rates`, which models with quaternions need, reads all velocities.
    """
    if (
        manifest.configuration
        or shape.sensor_velocities
        or shape.contacts
        or set(manifest.dependent) & {*shape.known_velocities, *shape.velocities}
    ):
        return True
    known = list_quantities(manifest, shape.added)
    read = [known[name] for text in shape.expressions for name in list_names(text, shape.functions) if name in known]
    return any(x.kind in ("v", "omega") or (x.kind == "qd" and x.index in manifest.dependent) for x in read)


def correct(
    q: Column, corrections: Indices, rows: Indices, interval: Indices, entries: tuple[int, ...] | None = None
) -> Block:
    """Subtract J(q)' mu, or some entries of it, from rows at every point."""
    return Block(replace(FORCES, entries=entries), (q, corrections), rows, interval, scale=-1.0)


def correct_places(
    q: Column, corrections: Indices, rows: Indices, interval: Indices, manifest: Manifest, moved: Sequence[int]
) -> list[Block]:
    """Subtract E(q) J(q)' mu from the rows of the coordinates at every point: (nq, places), without driven ones.

    `moved` are the entries of q that have rows.
    """
    if not manifest.configuration:
        return [correct(q, corrections, rows, interval, None if len(moved) == len(manifest.positions) else (*moved,))]
    row_of = {entry: row for row, entry in enumerate(moved)}
    pairs = list_places(manifest)
    slides = [(places[0], speeds[0]) for places, speeds in pairs if len(places) == 1 and places[0] in row_of]
    blocks = []
    if slides:
        own, speeds = zip(*slides, strict=True)
        blocks.append(correct(q, corrections, rows[[row_of[i] for i in own]], interval, speeds))
    turns = list_quaternions(manifest)
    floating = [(places, speeds) for places, speeds in pairs if len(places) == len(speeds) == 3]
    function = formulas.turn(
        [(x.entries, x.spins) for x in turns],
        [(next(x.entries for x in turns if x.first == places[0] + 3), speeds) for places, speeds in floating],
        (len(manifest.positions), len(manifest.dependent)),
        FORCES,
    )
    entries = [*(i for x in turns for i in x.entries), *(i for places, _ in floating for i in places)]
    return [*blocks, Block(function, (q, corrections), rows[[row_of[i] for i in entries]], interval, scale=-1.0)]


def close(places: Places, rows: Sequence[Indices], stages: Indices, scale: Array | float = 1.0) -> list[Block]:
    """Write h, and its rate where there are rows for it, at some places."""
    columns: list[tuple[Column, ...]] = [(places.q,), (places.q, places.qd)]
    functions = (POSITIONS, RATES)
    return [
        Block(function, parts, row, stages, scale=scale)
        for function, parts, row in zip(functions, columns, rows, strict=False)
    ]
