"""Checks of loops, constraints, and driven, independent and assembled joints of a Model.

Whether a loop can be closed, and which equations follow from others, is found where loops are assembled.
"""

from __future__ import annotations

import math
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from mbsgen.algebra.dense import Row, cross
from mbsgen.documents import Finding, Place, abbreviate, lies_under, nearest, write_path
from mbsgen.expressions import names, write
from mbsgen.model.expansion import Step
from mbsgen.model.following import list_joints
from mbsgen.model.model import BASE, UNITS, ZERO, Constraint, Loop, Model, Triple
from mbsgen.model.symbols import to_double
from mbsgen.model.topology import find_carriers
from mbsgen.model.tree import Cut, coordinate_symbol
from mbsgen.model.valuation import Valuation

MAX_EQUATIONS = 500  # loops and constraints
SHORTEST = 1e-150  # of a rod, whose square does not vanish, and of a pitch
LARGEST_TOLERANCE = 0.005  # of loops: beyond it, nothing is rounding
PARALLEL = 1e-9  # sine of the angle between the axes of a universal joint

WITH_AXIS = (Cut.HINGE, Cut.UNIVERSAL, Cut.CYLINDRICAL, Cut.HELICAL, Cut.PRISMATIC, Cut.PLANAR)


def check_loops(model: Model, valuation: Valuation, doubtful: Container[Place]) -> Iterator[Finding]:
    """Find what is wrong with the loops and constraints of a model, and with the joints named beside them."""
    count = len(model.loops) + len(model.constraints)
    if count > MAX_EQUATIONS:
        place = ("loops",) if model.loops else ("constraints",)
        yield Finding(place, f"{count} loops and constraints", f"give at most {MAX_EQUATIONS}")
        return
    for i, loop in enumerate(model.loops):
        yield from _check_loop(("loops", i), loop, valuation)
    yield from _check_ends(model, doubtful)
    yield from _check_twins(model, doubtful)
    joints = _Joints.of(model, doubtful)
    for i, constraint in enumerate(model.constraints):
        yield from _check_constraint(("constraints", i, "equation"), constraint, joints, valuation)
    yield from _check_driven(model, joints)
    yield from _check_independent(model, joints)
    yield from _check_assembly(model, joints, valuation)
    yield from _check_tolerance(model, valuation)


# --- loops -----------------------------------------------------------------------------------------------------------


def _check_loop(place: Place, loop: Loop, valuation: Valuation) -> Iterator[Finding]:
    for key, end in (("from", loop.first), ("to", loop.second)):
        valuation.placement((*place, key), end.placement)
    yield from _check_unused(place, loop)
    if loop.cut in WITH_AXIS:
        yield from _check_axes(place, loop, valuation)
    if loop.cut is Cut.ROD:
        yield from _check_length((*place, "length"), loop, valuation)
    if loop.cut is Cut.HELICAL:
        yield from _check_pitch((*place, "pitch"), loop, valuation)


def _check_unused(place: Place, loop: Loop) -> Iterator[Finding]:
    """Find axes, a length and a pitch that a loop of this type does not have."""
    is_universal, is_rod, is_screw = (loop.cut is cut for cut in (Cut.UNIVERSAL, Cut.ROD, Cut.HELICAL))
    given = (
        ("axis", loop.axis != UNITS["z"] and loop.cut not in WITH_AXIS, "an axis"),
        ("axis2", loop.axis2 != UNITS["x"] and not is_universal, "a second axis"),
        ("length", loop.length != ZERO and not is_rod, "a length"),
        ("pitch", loop.pitch != ZERO and not is_screw, "a pitch"),
    )
    owners = {"axis": ", ".join(cut.value for cut in WITH_AXIS), "axis2": "universal", "length": "rod"}
    owners["pitch"] = "helical"
    for key, is_wrong, what in given:
        if is_wrong:
            finding = f"{what} of a loop of type {loop.cut.value}"
            yield Finding((*place, key), finding, f"leave it out, or give one of these types: {owners[key]}")


def _check_axes(place: Place, loop: Loop, valuation: Valuation) -> Iterator[Finding]:
    axes = {"axis": loop.axis} | ({"axis2": loop.axis2} if loop.cut is Cut.UNIVERSAL else {})
    directions = {key: _read_direction((*place, key), axis, valuation) for key, axis in axes.items()}
    for key, direction in directions.items():
        if not any(direction):
            finding = f"[{', '.join(map(write, axes[key]))}] has no direction"
            yield Finding((*place, key), finding, "give a nonzero 3-vector, e.g. [0, 1, 0]")
    if len(directions) == 2 and all(map(any, directions.values())):
        one, other = (_normalise(direction) for direction in directions.values())
        sine = math.hypot(*cross(one, other))
        if sine <= PARALLEL:
            remedy = "give axes at an angle, or a loop of type hinge"
            yield Finding((*place, "axis2"), "the axes of a universal joint are parallel", remedy)


def _normalise(v: Row) -> Row:
    largest = max(map(abs, v))
    length = math.hypot(*(x / largest for x in v))
    return tuple(x / largest / length for x in v)


def _read_direction(place: Place, axis: Triple, valuation: Valuation) -> Row:
    """Return the components of an axis; nan where they are unknown."""
    return tuple(valuation.constant(place, component) for component in axis)


def _check_length(place: Place, loop: Loop, valuation: Valuation) -> Iterator[Finding]:
    length = valuation.number(place, loop.length)
    if loop.length == ZERO:
        yield Finding(place, "a rod without a length", "give the distance of the two points, e.g. length: 0.3")
    elif length < SHORTEST:
        remedy = "give more than 0; a ball keeps two points together"
        yield Finding(place, f"a length of {length:g}", remedy)


def _check_pitch(place: Place, loop: Loop, valuation: Valuation) -> Iterator[Finding]:
    pitch = valuation.number(place, loop.pitch)
    if loop.pitch == ZERO:
        finding = "a helical joint without a pitch"
        yield Finding(place, finding, "give how far it moves for each radian, e.g. pitch: 0.01")
    elif abs(pitch) < SHORTEST:
        yield Finding(place, f"a pitch of {pitch:g}", "give another number than 0; a hinge has no shift along its axis")


def _check_ends(model: Model, doubtful: Container[Place]) -> Iterator[Finding]:
    """Find loops between bodies that cannot move against each other."""
    keys = ("name", "parent", "joint")
    is_known = not any(lies_under(("bodies", i, key), doubtful) for i in range(len(model.bodies)) for key in keys)
    carriers = find_carriers(model) if is_known else {}
    for i, loop in enumerate(model.loops):
        place: Place = ("loops", i, "to", "body")
        if any(lies_under(("loops", i, key, "body"), doubtful) for key in ("from", "to")):
            continue
        first, second = loop.first.body, loop.second.body
        remedy = "let a joint between two bodies move, or leave the loop out"
        if first == second:
            yield Finding(place, f"a loop between {abbreviate(first)} and itself", remedy)
        elif first in carriers and carriers[first] == carriers.get(second):
            if carriers[first] == BASE and BASE not in (first, second):
                finding = f"{abbreviate(first)} and {abbreviate(second)} are both fixed to {BASE}"
            else:
                finding = f"{abbreviate(first)} and {abbreviate(second)} are fixed to each other"
            yield Finding(place, finding, remedy)


def _check_twins(model: Model, doubtful: Container[Place]) -> Iterator[Finding]:
    """Find loops and constraints that are given twice."""
    seen: dict[object, int] = {}
    parts: tuple[Place, ...] = (("type",), ("from", "body"), ("to", "body"), ("axis",), ("length",), ("pitch",))
    for i, loop in enumerate(model.loops):
        if any(lies_under(("loops", i, *part), doubtful) for part in parts):
            continue
        other = seen.setdefault(replace(loop, name=""), i)
        if other != i:
            yield Finding(("loops", i), f"the same loop as {write_path(('loops', other))}", "leave one of them out")
    for i, constraint in enumerate(model.constraints):
        if lies_under(("constraints", i, "equation"), doubtful):
            continue
        other = seen.setdefault(constraint.equation, i)
        if other != i:
            finding = f"the same equation as in {write_path(('constraints', other))}"
            yield Finding(("constraints", i, "equation"), finding, "leave one of them out")


# --- joints ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Joints:
    """The joints of a model, and whether all their names are known."""

    by_name: Mapping[str, Step]
    parameters: frozenset[str]
    are_known: bool

    @classmethod
    def of(cls, model: Model, doubtful: Container[Place]) -> _Joints:
        steps = list_joints(model)
        places = [place for step in steps for place in ((*step.place, "name"), (*step.place[:2], "name"))]
        are_known = not any(lies_under(place, doubtful) for place in places)
        by_name = {step.name: step for step in steps}
        return cls(by_name, frozenset(p.name for p in model.parameters), are_known)

    def find(self, place: Place, name: str) -> Iterator[Finding]:
        """Find the faults of a name that should name a joint with one coordinate, which follows no other joint."""
        step = self.by_name.get(name)
        if step is None:
            if self.are_known:
                yield Finding(
                    place,
                    f"there is no joint {abbreviate(name)}",
                    self.suggest(name, takes_parts=place[:1] == ("assembly",)),
                )
        elif step.joint.follows is not None:
            leader = abbreviate(step.joint.follows.joint)
            finding = f"joint {abbreviate(name)} has no coordinate: it follows {leader}"
            yield Finding(place, finding, f"name {leader}")

    def suggest(self, name: str, *, takes_parts: bool) -> str:
        """Return the remedy for a name that no joint has; parts of a quaternion have rough coordinates alone."""
        known = [x.name for x in self.by_name.values() if takes_parts or not x.joint.floats]
        every = [step for step in self.by_name.values() if step.name.startswith(f"{name}.")]
        inside = [step for step in every if step.name in known]
        meant = nearest(name, known)
        if every and not inside:
            return "a quaternion turns this body, and its parts cannot be named: name another joint"
        if inside:
            shown = ", ".join(step.name for step in inside[:6])
            return f"the joints of this body are {shown}: name one of them"
        return f"did you mean {abbreviate(meant)}?" if meant else "name a joint of the model"


def _check_constraint(place: Place, constraint: Constraint, joints: _Joints, valuation: Valuation) -> Iterator[Finding]:
    given = names(constraint.equation)
    own = {name for name in given if name in joints.by_name and not joints.by_name[name].joint.floats}
    if valuation.is_doubtful(place):
        return
    if shared := sorted(own & joints.parameters):
        finding = f"{abbreviate(shared[0])} is the name of a joint and of a parameter"
        yield Finding(place, finding, "give one of them another name")
        return
    unknown = sorted(given - own - joints.parameters)
    for name in unknown:
        if joints.are_known:
            meant = nearest(name, [*joints.by_name, *joints.parameters])
            remedy = f"did you mean {abbreviate(meant)}?" if meant else "use names of joints and parameters"
            yield Finding(place, f"there is neither a joint nor a parameter {abbreviate(name)}", remedy)
    if unknown:
        return
    symbols = {name: coordinate_symbol(name) for name in own}
    form = valuation.form(place, constraint.equation, symbols)
    if form is not None and form.free_symbols.isdisjoint(symbols.values()):
        left = f", and {to_double(form):g} remains" if form.is_number and form != 0 else ""
        finding = f"the equation depends on no joint{left}" if not own else f"its joints cancel{left}"
        yield Finding(place, finding, "give an equation between coordinates of joints, or leave it out")


def _check_driven(model: Model, joints: _Joints) -> Iterator[Finding]:
    yield from _check_list("driven", model.driven, joints)
    for k, name in enumerate(model.driven):
        step = joints.by_name.get(name)
        if step is not None and step.joint.actuated and not step.joint.floats:
            finding = f"joint {abbreviate(name)} is driven, and has an input u"
            yield Finding(("driven", k), finding, "give the joint actuated: false; its force is a result")


def _check_independent(model: Model, joints: _Joints) -> Iterator[Finding]:
    yield from _check_list("independent", model.independent, joints)
    if model.independent and not (model.loops or model.constraints):
        finding = "independent coordinates without loops and constraints"
        yield Finding(("independent",), finding, "leave them out: all coordinates are independent")


def _check_list(key: str, given: Sequence[str], joints: _Joints) -> Iterator[Finding]:
    """Find names in a list that name no joint with one coordinate, or one that was named before."""
    for k, name in enumerate(given):
        yield from joints.find((key, k), name)
        step = joints.by_name.get(name)
        if name in given[:k]:
            yield Finding((key, k), f"joint {abbreviate(name)} is named twice", "leave it out once")
        elif step is not None and step.joint.floats:
            finding = f"{abbreviate(name)} is part of a joint with a quaternion"
            yield Finding((key, k), finding, "name joints that turn about, or slide along, one axis")


def _check_tolerance(model: Model, valuation: Valuation) -> Iterator[Finding]:
    if model.loop_tolerance is None:
        return
    place: Place = ("loop_tolerance",)
    value = valuation.constant(place, model.loop_tolerance)
    if not (model.loops or model.constraints):
        yield Finding(place, "a tolerance without loops and constraints", "leave it out")
    elif not math.isnan(value) and not 0 <= value <= LARGEST_TOLERANCE:
        finding = f"{value:g} is no tolerance of loops"
        yield Finding(place, finding, f"give 0, for equations as exact as doubles, up to {LARGEST_TOLERANCE:g}")


def _check_assembly(model: Model, joints: _Joints, valuation: Valuation) -> Iterator[Finding]:
    if model.assembly and not (model.loops or model.constraints):
        finding = "rough coordinates without loops and constraints"
        yield Finding(("assembly",), finding, "leave them out: there is nothing to assemble")
    for k, (name, coordinate) in enumerate(model.assembly):
        place: Place = ("assembly", name)
        valuation.number(place, coordinate)
        yield from joints.find(place, name)
        if any(other == name for other, _ in model.assembly[:k]):  # only in a model made in Python
            yield Finding(place, f"joint {abbreviate(name)} is named twice", "leave it out once")
