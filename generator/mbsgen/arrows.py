"""Forces of a model as text, for arrows in pictures: Model, Appearance -> an Appearance with expressions of forces.

A text is an expression of `mbsgen.expressions` over run-time parameters, numbers of the state (`q_NAME`, `vx_NAME`),
signals, and, for a force element, its length and rate. Constants enter by value. A parameter with a path for a name,
such as `forces.strut.stiffness`, is written with _ for its dots.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Protocol

from sympy import (
    Abs,
    Add,
    Expr,
    Float,
    ImmutableMatrix,
    Mul,
    Pow,
    Rational,
    S,
    Symbol,
    acos,
    asin,
    atan,
    atan2,
    cos,
    exp,
    log,
    sin,
    tanh,
)

from mbsgen.algebra.dense import Dense, Row, add, apply, list_columns
from mbsgen.expressions import (
    FLOATS,
    Call,
    Expression,
    ExpressionError,
    Name,
    Number,
    Operation,
    Power,
    evaluate,
    names,
    parse,
    spell,
    substitute,
    write,
)
from mbsgen.manifest import Appearance, Contraction, Element, Fibres, Formula, Given, Point, Reading, Touch
from mbsgen.model.elimination import eliminate
from mbsgen.model.following import find_rules, list_joints
from mbsgen.model.model import (
    BASE,
    HERE,
    LENGTH,
    LENGTH_RATE,
    ORIGIN,
    ZERO,
    Block,
    Body,
    Capsule,
    Contact,
    ForceElement,
    Model,
    Placement,
    Plane,
    Sphere,
    Triple,
    Visual,
    Wrench,
)
from mbsgen.model.muscles import COSINE, FIBRE, TENDON_RATE, Muscle
from mbsgen.model.placements import centre_inertia
from mbsgen.model.quantities import Quantity, list_quantities
from mbsgen.model.symbols import symbolic, to_double
from mbsgen.model.tree import Kind
from mbsgen.model.tree import Reading as Kinematics

_CALLS = {sin: "sin", cos: "cos", exp: "exp", log: "log", tanh: "tanh", asin: "asin", acos: "acos", atan: "atan"}
_CALLS |= {atan2: "atan2", Abs: "abs"}
_Place = tuple[str | int, ...]  # keys and indices in an appearance
OWN = frozenset((LENGTH, LENGTH_RATE))  # names of numbers of a force element itself


class Seat(Protocol):
    """Where a frame of the model stands, in a frame of the manifest."""

    @property
    def frame(self) -> int:
        """Return the index of the frame; -1: the base."""

    @property
    def position(self) -> Row:
        """Return the position [m], (3,)."""

    @property
    def axes(self) -> Dense:
        """Return the axes as columns, (3, 3)."""

    @property
    def place_symbols(self) -> ImmutableMatrix:
        """Return the position, (3, 1), over symbols of run-time parameters."""

    @property
    def axes_symbols(self) -> ImmutableMatrix:
        """Return the axes over symbols of run-time parameters."""


class Seats(Protocol):
    """Finds the seat of a placement on a body."""

    def find(self, body: str, placement: Placement = HERE) -> Seat:
        """Return the seat."""


def add_forces(found: Appearance, model: Model, coordinates: Sequence[str], texts: Texts, seats: Seats) -> Appearance:
    """Add further tensions, wrenches that the model gives, and numbers that depend on run-time parameters.

    `coordinates` names the entries of q. A force that no text can hold has no law, or is left out.
    """
    return _Writing(model, coordinates, texts, seats).complete(found)


class _Writing:
    """Collects formulas, and the readings of forces."""

    def __init__(self, model: Model, coordinates: Sequence[str], texts: Texts, seats: Seats) -> None:
        self._model, self._texts, self._seats = model, texts, seats
        self._entries = {name: k for k, name in enumerate(coordinates)}
        self._formulas: list[Formula] = []
        self._readings: dict[str, Reading] = {}
        self._moved: dict[str, list[Formula]] = {}  # places of readings

    def complete(self, found: Appearance) -> Appearance:
        """Return the appearance with its forces."""
        elements = [
            self._add_element(k, *x) for k, x in enumerate(zip(found.elements, self._model.forces, strict=True))
        ]
        contacts = [
            self._add_contact(k, *x) for k, x in enumerate(zip(found.contacts, self._model.contacts, strict=True))
        ]
        given: list[Given] = []
        for wrench in self._model.wrenches:
            with suppress(ExpressionError):
                self._add_given(wrench, given)
        for k, wrench in enumerate(x for x in self._model.wrenches if x.force is None or x.moment is None):
            with suppress(ExpressionError):
                self._formulas += self._write_point(("wrenches", k), wrench.body, HERE, wrench.position)
                self._formulas += self._write_axes(("wrenches", k), wrench)
        for k, name in enumerate(self._readings):
            moved = self._moved.get(name, [])
            self._formulas += [Formula(place=("readings", k, *x.place), text=x.text) for x in moved]
        if self._texts.are_changing:
            self._add_bodies(found)
        changes = {"elements": tuple(elements), "contacts": tuple(contacts), "given": tuple(given)}
        changes |= {"formulas": tuple(self._formulas), "readings": tuple(self._readings.values())}
        return found.model_copy(update=changes)

    def _add_bodies(self, found: Appearance) -> None:
        """Add the numbers of seats, masses and shapes of bodies that depend on parameters."""
        masses = {x.name: k for k, x in enumerate(found.masses)}
        drawing = 0
        for k, body in enumerate(self._model.bodies):
            seat = self._seats.find(body.name)
            with suppress(ExpressionError):
                points = [*self._write_point(("bodies", k), body.name, HERE)]
                self._formulas += [*points, *self._write_entries(("bodies", k, "axes"), seat.axes_symbols.T)]
            if body.name in masses:
                with suppress(ExpressionError):
                    self._formulas += self._write_mass(("masses", masses[body.name]), body, seat)
            for visual in body.visuals:
                with suppress(ExpressionError):
                    self._formulas += self._write_visual(("drawings", drawing), body.name, visual)
                drawing += 1

    def _write_mass(self, place: _Place, body: Body, seat: Seat) -> list[Formula]:
        """Write mass, centre of mass and inertia of a body in the frame that moves with it."""
        formulas = [*self._write_numbers(place, {"mass": body.mass})]
        centre = seat.place_symbols + seat.axes_symbols * self._symbolize(body.com)
        formulas += self._write_entries((*place, "com"), centre)
        own = ImmutableMatrix([[self._texts.symbolize(x) for x in row] for row in centre_inertia(body).rows])
        turned = seat.axes_symbols * own * seat.axes_symbols.T
        entries = [turned[r, c] for r, c in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        return [*formulas, *self._write_entries((*place, "inertia"), entries)]

    def _write_visual(self, place: _Place, body: str, visual: Visual) -> list[Formula]:
        """Write size, point and axes of a shape in the frame that moves with its body."""
        seat, own = self._seats.find(body), self._seats.find(BASE, visual.placement)
        formulas = [*self._write_numbers((*place, "size"), dict(enumerate(visual.size)))]
        at = seat.place_symbols + seat.axes_symbols * own.place_symbols
        formulas += self._write_entries((*place, "at"), at)
        return [*formulas, *self._write_entries((*place, "axes"), (seat.axes_symbols * own.axes_symbols).T)]

    def _symbolize(self, triple: Triple) -> ImmutableMatrix:
        return ImmutableMatrix([self._texts.symbolize(x) for x in triple])

    def _write_entries(self, place: _Place, numbers: Iterable[Expr]) -> Iterator[Formula]:
        """Write the numbers of a list that depend on parameters."""
        for i, x in enumerate(numbers):
            text = self._texts.find_changing_symbol(x)
            if text is not None:
                yield Formula(place=(*place, i), text=text)

    def _add_element(self, k: int, found: Element, element: ForceElement) -> Element:
        if element.muscle is not None:
            with suppress(ExpressionError):
                found = found.model_copy(update={"muscle": self._describe_muscle(element.muscle)})
        if element.via:
            return found
        try:
            force = "" if element.law == ZERO else self._read(element.law, OWN)
            laws: dict[str | int, Expression] = {
                "stiffness": element.stiffness,
                "rest": element.rest,
                "damping": element.damping,
            }
            if element.cable is not None:
                laws |= {"dissipation": element.cable.dissipation, "width": element.cable.width}
            formulas = [*self._write_numbers(("elements", k, "law"), laws)]
            for key, end in (("first", element.first), ("second", element.second)):
                formulas += self._write_point(("elements", k, key), end.body, end.placement)
        except ExpressionError:
            return found.model_copy(update={"law": None})
        self._formulas += formulas
        return found.model_copy(update={"force": force})

    def _describe_muscle(self, muscle: Muscle) -> Fibres:
        texts = {"activation": muscle.activation, "fibre": muscle.fibre_length, "cosine": muscle.cosine}
        if muscle.tendon_state is not None:
            texts |= {"tendon_state": muscle.tendon_state, "equilibrium": muscle.equilibrium}
            texts |= {} if muscle.settling is None else {"settling": muscle.settling}
        parts = {"active": muscle.active_force, "passive": muscle.passive_force, "isometric": muscle.isometric_force}
        parts |= {"velocity": muscle.fibre_velocity, "stretch": muscle.stretch}
        parts |= {"strength": muscle.strength, "best": muscle.fibre}
        own, forces = (
            {key: self._read(x, OWN | {TENDON_RATE, FIBRE, COSINE}) for key, x in given.items()}
            for given in (texts, parts)
        )
        return Fibres(**own, contraction=Contraction(**forces))

    def _add_contact(self, k: int, found: Touch, contact: Contact) -> Touch:
        if found.law is None:
            return found
        laws: dict[str | int, Expression] = {
            key: getattr(contact, key) for key in ("stiffness", "dissipation", "width")
        }
        if contact.friction is not None and contact.friction.speed is not None:
            laws |= {"coefficient": contact.friction.coefficient, "speed": contact.friction.speed}
        other = contact.other
        try:
            self._refuse_turned(contact)
            formulas = [*self._write_numbers(("contacts", k, "law"), laws)]
            formulas += self._write_numbers(("contacts", k), {"radius": contact.radius})
            if contact.size is not None:
                formulas += self._write_numbers(("contacts", k, "size"), dict(enumerate(contact.size)))
            for j, point in enumerate(contact.points):
                formulas += self._write_numbers(("contacts", k, "points", j), dict(enumerate(point)))
            formulas += self._write_point(("contacts", k, "centre"), contact.body, contact.placement)
            side: tuple[str, ...] = ("plane",)
            if isinstance(other, Sphere):
                side = ("sphere", "centre")
                formulas += self._write_numbers(("contacts", k, "sphere"), {"radius": other.radius})
            elif isinstance(other, Block):
                side = ("box", "centre")
                formulas += self._write_numbers(("contacts", k, "box", "size"), dict(enumerate(other.size)))
            elif isinstance(other, Capsule):
                side = ("capsule", "centre")
                numbers: dict[str | int, Expression] = {key: getattr(other, key) for key in ("radius", "length")}
                formulas += self._write_numbers(("contacts", k, "capsule"), numbers)
            # a plane and a sphere have a point in the axes of their body, a box and a capsule have their own axes
            at = (HERE, other.position) if isinstance(other, Plane | Sphere) else (other.placement, ORIGIN)
            formulas += self._write_point(("contacts", k, *side), other.body, *at)
        except ExpressionError:
            return found.model_copy(update={"law": None})
        self._formulas += formulas
        return found

    def _refuse_turned(self, contact: Contact) -> None:
        """Refuse sides that run-time parameters turn."""
        other = contact.other
        turned = [self._seats.find(other.body, other.placement if isinstance(other, Block | Capsule) else HERE)]
        turned += [self._seats.find(contact.body, contact.placement)] if contact.has_points else []
        if any(seat.axes_symbols.free_symbols for seat in turned):
            raise ExpressionError("axes that run-time parameters turn", "keep their angles constant")

    def _add_given(self, wrench: Wrench, given: list[Given]) -> None:
        """Add a wrench with components that the model gives, unless all are 0."""
        if wrench.against is not None:  # its axes turn with another body
            return
        parts = [("", "", "") if v is None else self._write_triple(v) for v in (wrench.force, wrench.moment)]
        if not any(map(any, parts)):
            return
        place = ("given", len(given))
        formulas = [*self._write_point((*place, "at"), wrench.body, HERE, wrench.position)]
        formulas += self._write_axes(place, wrench)
        seat = self._seats.find(wrench.body)
        own = [self._texts.present(c) for c in wrench.position]
        x, y, z = add(seat.position, apply(seat.axes, own))
        self._formulas += formulas
        given.append(
            Given(
                name=wrench.name,
                at=Point(frame=seat.frame, at=(x, y, z)),
                in_base=wrench.in_base,
                axes=list_columns(seat.axes),
                force=parts[0],
                moment=parts[1],
            )
        )

    def _write_triple(self, triple: Triple) -> tuple[str, str, str]:
        x, y, z = ("" if component == ZERO else self._read(component) for component in triple)
        return x, y, z

    def _write_numbers(self, place: _Place, numbers: Mapping[str | int, Expression]) -> Iterator[Formula]:
        for key, number in numbers.items():
            text = self._texts.find_changing(number)
            if text is not None:
                yield Formula(place=(*place, key), text=text)

    def _write_point(
        self, place: _Place, body: str, placement: Placement, position: Triple | None = None
    ) -> Iterator[Formula]:
        """Write the coordinates of a point that depend on parameters."""
        seat = self._seats.find(body, placement)
        at = seat.place_symbols + seat.axes_symbols * self._symbolize(position or ORIGIN)
        return self._write_entries((*place, "at"), at)

    def _write_axes(self, place: _Place, wrench: Wrench) -> Iterator[Formula]:
        """Write the axes of a wrench in its body's frame, as far as they depend on parameters."""
        axes = () if wrench.in_base else self._seats.find(wrench.body).axes_symbols.T
        return self._write_entries((*place, "axes"), axes)

    def _read(self, expression: Expression, own: frozenset[str] = frozenset()) -> str:
        """Write a force, and keep the numbers of the state that it reads. Raises ExpressionError for others."""
        text = self._texts.write_force(expression, own)
        known = self._texts.quantities
        readings = [self._describe(name, known[name]) for name in sorted(names(parse(text)) - own) if name in known]
        self._readings |= {x.name: x for x in readings if x is not None}
        return text

    def _describe(self, name: str, quantity: Quantity) -> Reading | None:
        """Describe a number of the state; None for a signal, which has its name in the manifest."""
        if quantity.is_given:
            return None
        if quantity.reading is None:
            if quantity.source not in self._entries:
                raise ExpressionError(f"{name} is a velocity beside a quaternion", "read a frame's velocity")
            return Reading(name=name, rate=name.startswith("qd_"), entry=self._entries[quantity.source])
        is_rate = quantity.reading is Kinematics.VELOCITY
        frame = next(x for x in self._model.frames if x.name == quantity.source)
        seat = self._seats.find(frame.body, frame.placement)
        x, y, z = seat.position
        self._moved[name] = [*self._write_point(("point",), frame.body, frame.placement)]
        return Reading(
            name=name, rate=is_rate, entry="xyz".index(name[is_rate]), point=Point(frame=seat.frame, at=(x, y, z))
        )


class Texts:
    """Writes the expressions of one model."""

    def __init__(self, model: Model, values: Mapping[str, float]) -> None:
        """Take a checked model, and its parameters by their present values."""
        self.quantities: Mapping[str, Quantity] = list_quantities(model)
        self._values = values
        self._known: dict[str, Expression] = {}  # constants, spelled parameters, coordinates of followers
        self._symbols: dict[str, Expr] = {}
        changing = [p.name for p in model.parameters if p.kind is not Kind.CONSTANT]
        self.are_changing = bool(changing)
        spelled = dict(zip(changing, spell(changing), strict=True))
        for p in model.parameters:
            if p.name not in spelled:
                self._known[p.name] = self._fold(p.value, values[p.name])
                self._symbols[p.name] = evaluate(p.value, self._symbols, symbolic({}))
            else:
                self._known[p.name] = Name(self._accept(p.name, spelled[p.name]))
                self._symbols[p.name] = Symbol(p.name)
        self._follow(model)

    def _accept(self, name: str, spelled: str | None) -> str:
        """Return the word for a parameter; its name, which no text can hold, where the word has another meaning."""
        return name if spelled is None or spelled in self.quantities else spelled

    def _fold(self, value: Expression, present: float) -> Expression:
        """Return a constant as a number, unless it stands for an expression over run-time parameters."""
        written = substitute(value, self._known)
        return written if names(written) else Number(present)

    def _follow(self, model: Model) -> None:
        """Express coordinates and velocities of followers by their leaders'."""
        words = {(x.source, key.partition("_")[0]): key for key, x in self.quantities.items() if x.joint}
        for name, rule in find_rules(list_joints(eliminate(model))).items():
            for kind in ("q", "qd"):
                own, leader = words.get((name, kind)), words.get((rule.joint, kind))
                if own and leader and own not in self._known:
                    product = Operation("*", substitute(rule.ratio, self._known), Name(leader))
                    offset = substitute(rule.offset, self._known)
                    self._known[own] = Operation("+", product, offset) if kind == "q" else product

    def write_changing(self, points: Mapping[_Place, Sequence[Expr]]) -> tuple[Formula, ...]:
        """Write the components of points that depend on parameters, by the places of the points.

        A point that no text can hold keeps its numbers.
        """
        found: list[Formula] = []
        for place, point in points.items():
            with suppress(ExpressionError):
                texts = [self.find_changing_symbol(x) for x in point]
                found += [Formula(place=(*place, i), text=text) for i, text in enumerate(texts) if text is not None]
        return tuple(found)

    def present(self, expression: Expression) -> float:
        """Return a number at the present parameters."""
        return float(evaluate(expression, self._values, FLOATS))

    def find_changing(self, expression: Expression) -> str | None:
        """Write a number that depends on run-time parameters; None for another one. Raises ExpressionError."""
        written = substitute(expression, self._known)
        return _check(written) if names(written) else None

    def write_force(self, expression: Expression, own: frozenset[str] = frozenset()) -> str:
        """Write a force over numbers of the state and its own numbers. Raises ExpressionError for one too long."""
        return _check(substitute(expression, {key: x for key, x in self._known.items() if key not in own}))

    def symbolize(self, expression: Expression) -> Expr:
        """Return a number as an expression of SymPy over run-time parameters."""
        return evaluate(expression, self._symbols, symbolic({}))

    def find_changing_symbol(self, number: Expr) -> str | None:
        """Write an expression of SymPy that depends on run-time parameters; None for a number."""
        if not number.free_symbols:
            return None
        return _check(substitute(_convert(number), self._known))


def rotate(axis: int, angle: Expr) -> ImmutableMatrix:
    """Return the rotation by an angle about a coordinate axis."""
    cosine, sine = (symbolic({}).functions[name](angle) for name in ("cos", "sin"))
    j, k = (axis + 1) % 3, (axis + 2) % 3
    entries = {(axis, axis): S.One, (j, j): cosine, (k, k): cosine, (j, k): -sine, (k, j): sine}
    return ImmutableMatrix(3, 3, lambda r, c: entries.get((r, c), S.Zero))


def _check(expression: Expression) -> str:
    """Write an expression that can be read again. Raises ExpressionError where it cannot."""
    text = write(expression)
    parse(text)
    return text


def _convert(number: Expr) -> Expression:
    """Convert an expression of SymPy. Raises ExpressionError for a function without a name here."""
    if isinstance(number, Symbol):
        return Name(number.name)
    if isinstance(number, Rational | Float):
        return Number(to_double(number))
    if isinstance(number, Pow):
        return _convert_power(number)
    parts = [_convert(x) for x in number.args]
    if isinstance(number, Add | Mul):
        joint, result = "+" if isinstance(number, Add) else "*", parts[0]
        for part in parts[1:]:
            result = Operation(joint, result, part)  # type: ignore[arg-type]  # one of the four
        return result
    name = _CALLS.get(number.func)
    if name is None:
        raise ExpressionError(f"{number.func} has no name in expressions", "keep to functions that have")
    return Call(name, tuple(parts))


def _convert_power(power: Expr) -> Expression:
    base, exponent = power.args
    twice = 2 * exponent
    if not twice.is_integer:
        raise ExpressionError(f"{power} is neither whole nor a root", "keep to those")
    whole = exponent.is_integer
    root = _convert(base) if whole else Call("sqrt", (_convert(base),))
    count = int(exponent if whole else twice)
    raised = root if abs(count) == 1 else Power(root, abs(count))
    return raised if count > 0 else Operation("/", Number(1.0), raised)
