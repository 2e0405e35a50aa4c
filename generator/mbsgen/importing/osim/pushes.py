"""Forces of OpenSim that act on bodies at a point, or between two frames -> wrenches of the model.

A bushing pushes its second frame back into its first one: with the turns about x, y, z in order and the shifts of the
second frame seen from the first one, each moment and force does work on the turn or the shift of its number alone.
Torque, point and body actuators have signals of their names; a body actuator has six, the moment's first. A prescribed
force is a function of the time.

Source: OpenSim's documentation of these classes and their defaults.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mbsgen.expressions import Expression, Name, Number, Operation, parse, substitute, write
from mbsgen.importing.closing import X
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.osim.forces import is_on
from mbsgen.importing.osim.frames import GROUND, Frames, Mount
from mbsgen.importing.osim.functions import FUNCTIONS, find_function, parse_sum, read_formula, read_function, write_over
from mbsgen.importing.osim.muscles import spell_signal
from mbsgen.importing.poses import Array, Pose
from mbsgen.model.bushings import SHIFTS, TURNS
from mbsgen.model.model import ORIGIN, ZERO, Triple

BUSHING, CURVED, WRITTEN = "BushingForce", "FunctionBasedBushingForce", "ExpressionBasedBushingForce"
BUSHINGS = (BUSHING, CURVED, WRITTEN)
TORQUE, POINT, BODY, PRESCRIBED = "TorqueActuator", "PointActuator", "BodyActuator", "PrescribedForce"
PUSHES = (*BUSHINGS, TORQUE, POINT, BODY, PRESCRIBED)
SETS = ("forceFunctions", "pointFunctions", "torqueFunctions")
_AXES = "xyz"
_SEEN = {f"theta_{k}": f"turn_{k}" for k in _AXES} | {f"delta_{k}": f"shift_{k}" for k in _AXES}
CURVES = (*(f"m_{k}_theta_{k}_function" for k in _AXES), *(f"f_{k}_delta_{k}_function" for k in _AXES))
FORMULAS = (*(f"M{k}_expression" for k in _AXES), *(f"F{k}_expression" for k in _AXES))
NUMBERS = ("rotational_stiffness", "translational_stiffness", "rotational_damping", "translational_damping")
_TIME = "t"


@dataclass(frozen=True, eq=False)
class Push:
    """A wrench at a frame of a body, along the axes of that frame, of the ground, or of another frame."""

    name: str
    element: Element
    mount: Mount
    force: Triple = ORIGIN
    moment: Triple = ORIGIN
    in_base: bool = True
    against: Mount | None = None
    by_turns: bool = False
    signals: tuple[str, ...] = ()


@dataclass
class Pushes:
    """Reads the wrenches of a file."""

    frames: Frames
    findings: Findings
    find_end: Callable[[Element, int], Mount | None]  # a frame of a force between two

    def read(self, element: Element) -> list[Push]:
        """Read a force of PUSHES; nothing, with a notice or faults, where there is none."""
        if not is_on(element):
            self.findings.tell(element, "it is switched off in the file: left out")
            return []
        readers: Mapping[str, Callable[[Element, str], list[Push]]] = {
            TORQUE: self._read_torque,
            POINT: self._read_point,
            BODY: self._read_body,
            PRESCRIBED: self._read_prescribed,
            **dict.fromkeys(BUSHINGS, self._read_bushing),
        }
        return readers[element.tag](element, element.attributes.get("name", "") or element.tag)

    # --- bushings ----------------------------------------------------------------------------------------------------

    def _read_bushing(self, element: Element, name: str) -> list[Push]:
        first, second = self.find_end(element, 1), self.find_end(element, 2)
        forces = self._read_elastic(element)
        if first is None or second is None or forces is None:
            return []
        damping = [x for tag in NUMBERS[2:] for x in self.frames.read_vector(element, tag)]
        parts = []
        for own, force, d in zip((*TURNS, *SHIFTS), forces, damping, strict=True):
            total: Expression = parse_sum([(-d, f"{own}_rate")])
            if force != ZERO:
                pushed = Operation("*", Number(-1.0), force)
                total = pushed if d == 0 else Operation("+", pushed, total)
            parts.append(parse(write(total)))
        if all(x == ZERO for x in parts):
            self.findings.tell(element, "it has no stiffness and no damping: left out")
            return []
        ax, ay, az, x, y, z = parts
        return [Push(name, element, second, (x, y, z), (ax, ay, az), against=first, by_turns=True)]

    def _read_elastic(self, element: Element) -> list[Expression] | None:
        """Read what a bushing resists with, over its turns and shifts; None with a warning."""
        if element.tag == BUSHING:
            k = [x for tag in NUMBERS[:2] for x in self.frames.read_vector(element, tag)]
            return [parse_sum([(x, own)]) for x, own in zip(k, (*TURNS, *SHIFTS), strict=True)]
        if element.tag == WRITTEN:
            found = [read_formula(element, _SEEN, self.findings, tag) for tag in FORMULAS]
            return None if None in found else [x for x in found if x is not None]
        curves = []
        for tag, own in zip(CURVES, (*TURNS, *SHIFTS), strict=True):
            held = element.first(tag)
            curve = ZERO if held is None else self._read_function(element, find_function(held), own)
            if curve is None:
                return None
            curves.append(curve)
        return curves

    # --- actuators ---------------------------------------------------------------------------------------------------

    def _read_torque(self, element: Element, name: str) -> list[Push]:
        first, second = (self.frames.find_named(element, tag) for tag in ("bodyA", "bodyB"))
        if first is None or second is None:
            return []
        if first.body == second.body:
            self.findings.tell(element, "both of its bodies are one: left out")
            return []
        signal = spell_signal(name)
        axis = self._read_direction(element, "axis", (0.0, 0.0, 1.0))
        size = self._number(element, "optimal_force", 1.0)
        torque, back = (_multiply(sign * size * axis, signal) for sign in (1, -1))
        if not _is_true(element, "torque_is_global", default=True):
            return [Push(name, element, second, moment=back, against=first, signals=(signal,))]
        pushes = [x for x in ((first, torque), (second, back)) if x[0].body != GROUND]
        return [Push(name, element, at, moment=x, signals=(signal,)) for at, x in pushes]

    def _read_point(self, element: Element, name: str) -> list[Push]:
        body = self.frames.find_named(element, "body")
        if body is None:
            return []
        signal = spell_signal(name)
        size = self._number(element, "optimal_force", 1.0)
        force = _multiply(size * self._read_direction(element, "direction", (1.0, 0.0, 0.0)), signal)
        place = tuple(map(Number, self.frames.read_vector(element, "point")))
        flags = _is_true(element, "point_is_global"), _is_true(element, "force_is_global")
        return self._apply(element, name, body, (force, ORIGIN, (place[0], place[1], place[2])), flags, (signal,))

    def _read_body(self, element: Element, name: str) -> list[Push]:
        body = self.frames.find(element.first("socket_body"), element)
        if body is None:
            return []
        word = spell_signal(name)
        signals = tuple(f"{word}_{kind}{axis}" for kind in "mf" for axis in _AXES)
        moment, force = (tuple(map(Name, signals[k : k + 3])) for k in (0, 3))
        place = tuple(map(Number, self.frames.read_vector(element, "point")))
        flags = _is_true(element, "point_is_global"), _is_true(element, "spatial_force_is_global", default=True)
        given = tuple((x[0], x[1], x[2]) for x in (force, moment, place))
        return self._apply(element, name, body, (given[0], given[1], given[2]), flags, signals)

    def _read_prescribed(self, element: Element, name: str) -> list[Push]:
        body, socket = element.first("body"), element.first("socket_frame")
        mount = self.frames.find_body(body, element) if socket is None else self.frames.find(socket, element)
        found = [self._read_three(element, key) for key in SETS]
        if mount is None or None in found:
            return []
        force, place, torque = (x for x in found if x is not None)
        flags = _is_true(element, "pointIsGlobal"), _is_true(element, "forceIsGlobal", default=True)
        return self._apply(element, name, mount, (force, torque, place), flags, ())

    def _apply(
        self,
        element: Element,
        name: str,
        body: Mount,
        given: tuple[Triple, Triple, Triple],
        flags: tuple[bool, bool],
        signals: tuple[str, ...],
    ) -> list[Push]:
        """Apply a force and a moment at a place; flags: the place, and force and moment, are in the ground's frame."""
        force, moment, place = given
        if all(x == ZERO for x in (*force, *moment)):
            self.findings.tell(element, "its force and its moment are 0: left out")
            return []
        is_placed, in_base = flags
        if not is_placed and all(isinstance(x, Number) for x in place):
            at = np.array([x.value for x in place if isinstance(x, Number)])
            mount = Mount(body.body, body.pose @ Pose(np.eye(3), at, ()))
            return [Push(name, element, mount, force, moment, in_base, signals=signals)]
        if is_placed == in_base:
            # the force acts at the frame's origin, with the moment of the place about it
            arm: list[Expression] = [*place]
            if is_placed:
                arm = [Operation("-", p, Name(s)) for p, s in zip(place, SHIFTS, strict=True)]
            turned = _cross(arm, force)
            x, y, z = (parse(write(Operation("+", a, b))) for a, b in zip(moment, turned, strict=True))
            against = Mount(GROUND) if is_placed else None
            return [Push(name, element, body, force, (x, y, z), in_base, against, signals=signals)]
        whose = ("the body's frame", "the ground's")
        text = f"its place is in {whose[is_placed]}, and its force in {whose[in_base]}, which is not read: left out"
        self.findings.warn(element, text)
        return []

    # --- parts -------------------------------------------------------------------------------------------------------

    def _read_three(self, element: Element, key: str) -> Triple | None:
        """Read three functions of the time; 0 where there are none, and None with a warning or a fault."""
        held = next((x for x in element.children if x.attributes.get("name") == key), element.first(key))
        objects = None if held is None else held.first("objects")
        functions = () if objects is None else objects.children
        if not functions:
            return ORIGIN
        if len(functions) != len(_AXES):
            self.findings.fault(held or element, f"{key} has {len(functions)} functions", "give three, or none")
            return None
        found = [self._read_function(element, x, _TIME) for x in functions]
        kept = [x for x in found if x is not None]
        return (kept[0], kept[1], kept[2]) if len(kept) == len(_AXES) else None

    def _read_function(self, element: Element, function: Element | None, name: str) -> Expression | None:
        """Read a function of one number; None with a warning."""
        if function is None:
            return ZERO
        if function.tag not in FUNCTIONS:
            self.findings.warn(element, f"its function {function.tag[:40]} is not read: its force is left out")
            return None
        curve = write_over(read_function(function, [X], self.findings))
        return curve if isinstance(curve, Number) else parse(write(substitute(curve, {X: Name(name)})))

    def _read_direction(self, element: Element, tag: str, default: tuple[float, ...]) -> Array:
        child = element.first(tag)
        given = np.array(default if child is None else self.frames.read_vector(element, tag))
        size = float(np.linalg.norm(given))
        if size == 0:
            self.findings.fault(child or element, f"{tag} has no direction", "give three numbers, not all 0")
            return given
        return np.asarray(given / size, np.float64)

    def _number(self, element: Element, tag: str, default: float) -> float:
        child = element.first(tag)
        return default if child is None else self.findings.number(child, tag, default, {tag: child.text})


def turn_triple(rotation: Array, triple: Triple) -> Triple:
    """Write the components of a vector along other axes."""
    if np.array_equal(rotation, np.eye(3)) or triple == ORIGIN:
        return triple
    rows = [[(float(c), x) for c, x in zip(row, triple, strict=True) if c and x != ZERO] for row in rotation]
    a, b, c = (parse_sum([(factor, f"({write(x)})") for factor, x in row]) for row in rows)
    return a, b, c


def _multiply(vector: Array, signal: str) -> Triple:
    a, b, c = (parse_sum([(float(x), signal)]) for x in vector)
    return a, b, c


def _cross(arm: Sequence[Expression], force: Sequence[Expression]) -> list[Expression]:
    found = list[Expression]()
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        one, other = Operation("*", arm[j], force[k]), Operation("*", arm[k], force[j])
        found.append(Operation("-", one, other))
    return found


def _find_text(element: Element, tag: str) -> str:
    child = element.first(tag)
    return "" if child is None else child.text


def _is_true(element: Element, tag: str, *, default: bool = False) -> bool:
    text = _find_text(element, tag).lower()
    return default if text == "" else text in ("true", "1")
