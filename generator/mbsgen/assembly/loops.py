"""Close the loops of a tree, once: Tree -> Tree with its `Closure`, or what keeps the loops from it.

1. a pose at which all equations hold, near the author's rough one
2. the rank of J along the mechanism, hence the redundant equations, and the degrees of freedom
3. the independent coordinates: the author's, or the coordinates that determine the others best

Everything is computed with the model's numbers. Where run-time parameters appear, redundancy is examined for other
numbers too: an equation that follows from others for one geometry alone may not be left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from sympy import Abs, Expr, Symbol, sign

from mbsgen.assembly.choice import REGULAR, choose_columns, choose_rows, measure
from mbsgen.assembly.mechanism import Array, Mechanism, place_roughly
from mbsgen.assembly.poses import NEAR, OPEN, Attempt, close, find_pose, rank, walk
from mbsgen.assembly.readings import Reading, is_weak, list_readings
from mbsgen.assembly.results import AssemblyError, release
from mbsgen.documents import Finding, Place, abbreviate
from mbsgen.model.symbols import exact, to_double
from mbsgen.model.tree import Closure, Cut, Kind, Tree, coordinate_symbol

PASSIVE, ACTIVE = 1.0, 0.2  # weights of the columns of joints without and with an actuator: the latter are independent
CHANGES = (1e-2, 1e-3, 1e-4)  # parts of run-time parameters, or sizes where they are 0; the first that lets loops close
GROWTH = 3.0  # of the residuals of equations that a reading leaves out, at other numbers
KINK, ASIDE, JUMP = 1e-12, 1e-6, 1e-3  # of a kink: how near it is, steps to both sides, the least change of a slope
BROKEN = 10 * OPEN  # residual of a redundant equation at other numbers; where it still holds, it is at most some OPEN


def assemble_loops(tree: Tree) -> Tree:
    """Return a tree with its closure. Raises AssemblyError.

    Where no equation restricts the joints, the loops and constraints are left out.
    """
    mechanism, rough = Mechanism(tree), place_roughly(tree)
    if undefined := _find_undefined(tree, rough):
        raise AssemblyError(tree.name, undefined)
    reading = _choose_reading(mechanism, rough)
    if len(reading.kept) < len(mechanism.equations):
        _check_redundancy(tree, mechanism, reading)
    if not reading.kept and mechanism.equations:
        free = release(tree)
        return assemble_loops(free) if free.is_constrained else free
    dependent = _choose_dependent(tree, reading.poses[0][list(reading.kept)])
    independent = tuple(i for i in range(mechanism.n) if i not in dependent)
    pose, kept = tuple(float(x) for x in reading.places[0]), reading.kept
    units = mechanism.size, mechanism.unit, *mechanism.choose_pulls(reading.places[0], kept)
    return replace(tree, closure=Closure(pose, kept, independent, dependent, reading.distance, *units))


def _choose_reading(mechanism: Mechanism, rough: Array) -> Reading:
    """Choose between all equations as exact as doubles, and readings by the digits of the file.

    Of the readings within the tolerance, it is the one with the fewest equations. Raises AssemblyError where none fits.
    """
    tree = mechanism.tree
    exactly, faults = _read_exactly(mechanism, rough)
    if exactly is not None and not is_weak(mechanism, exactly.poses, len(exactly.kept)):
        return exactly
    readings = [*list_readings(mechanism, rough, None if exactly is None else len(exactly.kept))]
    if fitting := [reading for reading in readings if reading.distance <= tree.loop_tolerance]:
        return fitting[-1]
    if readings and tree.loop_tolerance:
        raise AssemblyError(tree.name, _name_readings(mechanism, exactly, faults, readings[-1]))
    if exactly is None:
        raise AssemblyError(tree.name, faults)
    return exactly


def _read_exactly(mechanism: Mechanism, rough: Array) -> tuple[Reading | None, Sequence[Finding]]:
    """Return the reading with all equations, and what is wrong with it."""
    attempt = find_pose(mechanism, rough)
    if not attempt.is_closed:
        return None, _name_gaps(mechanism, attempt)
    if undefined := _find_undefined(mechanism.tree, attempt.q, kinks=True):
        raise AssemblyError(mechanism.tree.name, undefined)
    places = [*walk(mechanism, attempt.q)]
    poses = [mechanism.J(q) for q in places]
    ranks = [rank(J) for J in poses]
    if ranks[0] < max(ranks):
        return None, [_name_singularity(ranks[0], max(ranks))]
    kept = choose_rows([J for J, r in zip(poses, ranks, strict=True) if r == max(ranks)], max(ranks))
    if len(kept) == mechanism.n:
        finding = "the loops leave no joint free to move"
        return None, [Finding(_find_key(mechanism.tree), finding, "remove a loop, or give one with fewer equations")]
    return Reading(tuple(places), tuple(poses), kept, 0.0), ()


def _find_key(tree: Tree) -> Place:
    return ("loops",) if tree.loops else ("constraints",)


def _find_undefined(tree: Tree, q: Array, *, kinks: bool = False) -> list[Finding]:
    """Find constraints without a value or a derivative at a pose, such as the `kinks` of abs, min and max."""
    found = []
    for k, constraint in enumerate(tree.constraints, len(tree.loops)):
        alone = Mechanism(replace(tree, loops=(), constraints=(constraint,)))
        what = "no value" if not np.isfinite(alone.h(q)).all() else "no derivative"
        is_smooth = np.isfinite(alone.slopes(q)).all() and not (kinks and _has_kink(alone, q))
        if what == "no derivative" and is_smooth:
            continue
        names = [name for name in tree.coordinates if coordinate_symbol(name) in constraint.equation.free_symbols]
        pose = ", ".join(f"{abbreviate(x)} = {q[tree.coordinates.index(x)]:.6g}" for x in names)
        place, owner = _place(tree, k)
        finding = f"{owner}: {abbreviate(_show(constraint.equation, names))} has {what} at {pose}"
        remedy = "give a rough pose under `assembly:` at which it has one, and near which the loops close"
        found.append(Finding((*place, "equation"), finding, remedy))
    return found


def _has_kink(alone: Mechanism, q: Array) -> bool:
    """Return whether the slopes of a single constraint jump at a pose: where an abs or a sign changes its side."""
    (constraint,) = alone.tree.constraints
    for part in constraint.equation.atoms(Abs, sign):
        inner = Mechanism(replace(alone.tree, constraints=(replace(constraint, equation=part.args[0]),)))
        slopes = inner.slopes(q)[0]
        size = float(np.linalg.norm(slopes))
        if not 0.0 < size < math.inf or abs(inner.h(q)[0]) > KINK * size:
            continue
        aside = ASIDE * slopes / size * alone.steps
        one, other = alone.slopes(q + aside), alone.slopes(q - aside)
        if np.abs(one - other).max() > JUMP * max(np.abs(one).max(), np.abs(other).max()):
            return True
    return False


def _show(equation: Expr, names: Sequence[str]) -> str:
    """Write an equation with plain names."""
    return str(equation.xreplace({coordinate_symbol(name): Symbol(name) for name in names})).replace("Abs(", "abs(")


def _place(tree: Tree, number: int) -> tuple[Place, str]:
    """Return the place and the name of a loop or constraint, by its number among all.

    The place has its name: a file has more constraints than the tree, where some became followers.
    """
    if number < len(tree.loops):
        name = tree.loops[number].name
        return ("loops", name), f"loop {abbreviate(name)}"
    name = tree.constraints[number - len(tree.loops)].name
    return ("constraints", name), f"constraint {abbreviate(name)}"


def _name_gaps(mechanism: Mechanism, attempt: Attempt) -> list[Finding]:
    """Name the loops that stay open, and by how much."""
    tree, gaps = mechanism.tree, dict[int, float]()
    for (number, _), value in zip(mechanism.equations, attempt.h, strict=True):
        gaps[number] = max(gaps.get(number, 0.0), _measure_gap(tree, number, float(value)))
    found = []
    for number in (number for number, gap in gaps.items() if not gap <= OPEN):
        place, name = _place(tree, number)
        is_length = number < len(tree.loops) and tree.loops[number].cut in (Cut.ROD, Cut.BALL)
        size = f"{gaps[number]:.3g}{' m' if is_length else ''}"
        finding = f"{name} does not close: at the nearest pose found it stays open by {size}"
        found.append(Finding(place, finding, "give a rough pose under `assembly:`, or check lengths and frames"))
    if found:
        return found
    turned = next(k for k, x in zip(mechanism.senses_of, attempt.senses, strict=True) if not x > 0)
    place, name = _place(tree, turned)
    finding = f"{name} closes with its axes turned round only"
    return [Finding(place, finding, "turn the orientation of one end, or give a rough pose in `assembly:`")]


def _measure_gap(tree: Tree, number: int, value: float) -> float:
    """Return how far an equation is from holding; a rod's h = (d.d - L2) / (2 L) as the distance |d| - L."""
    if number >= len(tree.loops) or tree.loops[number].cut is not Cut.ROD or not math.isfinite(value):
        return abs(value)
    present = {p.symbol: exact(p.value) for p in tree.parameters}
    length = to_double(tree.loops[number].value.xreplace(present))
    return abs(math.sqrt(max(length * length + 2 * length * value, 0.0)) - length)


def _name_singularity(found: int, expected: int) -> Finding:
    finding = f"the loops close at a singular pose: {found} of their equations are independent there, {expected} nearby"
    return Finding(("loops",), finding, "give a rough pose of another assembly under `assembly:`")


def _name_readings(
    mechanism: Mechanism, exactly: Reading | None, faults: Sequence[Finding], other: Reading
) -> list[Finding]:
    """Name two readings, between which the digits of the file do not decide."""
    place = faults[0].place if faults else _find_key(mechanism.tree)
    first = faults[0].finding if exactly is None else f"all equations as they stand leave {_count(exactly.freedoms)}"
    finding = (
        f"{first}; but {', '.join(other.name_redundant(mechanism))} follow from the others within "
        f"{other.distance:.1e} (rad, or of the loop's size), and without them there {_count(other.freedoms, verb=True)}"
    )
    enough = f"{1.2 * other.distance:.0e}" if float(f"{1.2 * other.distance:.0e}") > other.distance else str(NEAR)
    option = f"(--loop-tolerance {enough})"
    remedy = f"give `loop_tolerance: {enough}` {option} to leave them out, or mend the axes and lengths"
    if exactly is not None:
        remedy = f"give `loop_tolerance: {enough}` {option} to leave them out, `loop_tolerance: 0` to keep them"
    return [Finding(place, finding, remedy)]


def _count(freedoms: int, *, verb: bool = False) -> str:
    text = f"{freedoms} degree{'' if freedoms == 1 else 's'} of freedom"
    return f"{'is' if freedoms == 1 else 'are'} {text}" if verb else text


def _check_redundancy(tree: Tree, mechanism: Mechanism, reading: Reading) -> None:
    """Refuse equations that are redundant for the present numbers of run-time parameters alone.

    The kept equations are solved at other numbers, from several poses: at one pose, a number may have no effect. Near
    the ends of a mechanism's range only small changes leave its loops closed. Where none does, nothing shows whether
    the redundant equations hold, and they are refused too.
    """
    own = [p for p in tree.parameters if p.kind is not Kind.CONSTANT]
    if not own:
        return
    kept, places = reading.kept, reading.places
    broken = max(BROKEN, GROWTH * max(float(np.abs(mechanism.h(q)).max(initial=0.0)) for q in places))
    parts = np.random.default_rng(2).uniform(-1, 1, len(own))
    for change in CHANGES:
        other = Mechanism(
            tree, [p.value * (1 + change * x) if p.value else change * x for p, x in zip(own, parts, strict=True)]
        )
        found = [np.abs(close(other, q, kept).h) for q in places]
        closed = [left for left in found if left[list(kept)].max(initial=0.0) <= OPEN]
        if closed:
            left = np.max(closed, axis=0)
            if left.max(initial=0.0) > broken:
                raise AssemblyError(tree.name, [_name_redundancy(mechanism, int(left.argmax()), "")])
            return
    first = next(k for k in range(len(mechanism.equations)) if k not in kept)
    extent = f", as far as is known: no loops close at numbers changed by {CHANGES[-1]:.2%}"
    raise AssemblyError(tree.name, [_name_redundancy(mechanism, first, extent)])


def _name_redundancy(mechanism: Mechanism, row: int, extent: str) -> Finding:
    tree, (number, name) = mechanism.tree, mechanism.equations[row]
    place, owner = _place(tree, number)
    equation = f"its equation {name}" if number < len(tree.loops) else "its equation"
    finding = f"{owner}: {equation} follows from the others for the present lengths alone{extent}"
    remedy = "make the lengths constants, zeros too, or take a kind of loop with fewer equations"
    return Finding(place, finding, remedy)


def _choose_dependent(tree: Tree, J: Array) -> tuple[int, ...]:
    """Choose the velocities that the others determine. Raises AssemblyError where there is no such choice."""
    names = [joint.name for joint in tree.joints]
    places = {body.joint.name: i for i, body in enumerate(tree.bodies, 1)}
    numbers = [places[name] for name in names]
    free = len(names) - J.shape[0]
    if len(tree.driven) > free:
        finding = f"{len(tree.driven)} driven joints, where {free} determine all others"
        raise AssemblyError(tree.name, [Finding(("driven",), finding, "drive fewer joints")])
    if tree.chosen:
        return _take_choice(tree, J, numbers, free)
    weights = np.array([ACTIVE if joint.actuated else PASSIVE for joint in tree.joints])
    weights[[number in tree.driven for number in numbers]] = 0.0
    found = choose_columns([J], weights)
    if measure(J, found) < REGULAR:
        finding = "the driven joints do not leave the loops closed: they depend on each other"
        raise AssemblyError(tree.name, [Finding(("driven",), finding, "drive other joints")])
    return found


def _take_choice(tree: Tree, J: Array, numbers: Sequence[int], free: int) -> tuple[int, ...]:
    """Take the author's independent joints, with the driven ones."""
    chosen = {*tree.chosen, *tree.driven}
    dependent = tuple(i for i, number in enumerate(numbers) if number not in chosen)
    if len(chosen) != free:
        finding = f"{len(chosen)} independent joints, driven ones included, where {free} determine all others"
        raise AssemblyError(tree.name, [Finding(("independent",), finding, f"name {free}, or none")])
    if measure(J, dependent) < REGULAR:
        finding = "the independent joints do not determine the others where the loops close"
        raise AssemblyError(tree.name, [Finding(("independent",), finding, "name other joints, or none")])
    return dependent
