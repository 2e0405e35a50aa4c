"""The numbers of a motion by name: what expressions read of it, and what follows from it by kernels.

    kinetic, potential, energy                       [J] of all bodies; potential is of gravity, energy their sum
    momentum_x, angular_momentum_x, com_x, ...       of all bodies: [kg m/s], [kg m2/s] about the origin, [m]
    power; power_JOINT                               [W] of all forces but gravity; of the input or drive of a joint
    wx_SENSOR, ax_SENSOR, wdx_SENSOR, ...            angular velocity, acceleration, angular acceleration of a sensor
    xx_SENSOR, xy_SENSOR, ..., zz_SENSOR             its axes: xy is the y component of its x axis
    roll_SENSOR, pitch_SENSOR, yaw_SENSOR            [rad] turns about x, then y, then z of the base, as in URDF
    length_FORCE, rate_FORCE, tension_FORCE          [m], [m/s], [N] of a spring, cable or muscle
    fibre_MUSCLE, pennation_MUSCLE                   [m], [rad] length of its fibres, and their angle with the tendon
    metabolic_MUSCLE; basal, metabolic               [W] rate of its metabolism; of the body at rest; the sum of all
    arm_FORCE_JOINT                                  [m] its moment arm: the tension times it is the joint's force
    gap_CONTACT, normal_CONTACT, fx_CONTACT, ...     [m], [N] of a point of contact: distance, force off the other side
    lam_LOOP_EQUATION                                [N, N m] the forces that close loops
    reaction_JOINT; reaction_x_JOINT, ...            [N] the size of the force in a joint; its components,
    reaction_mx_JOINT, ...                           [N m] and its moment about the body's origin, in the base frame

Dots and spaces of a name are written _. A force in a joint is the one by which the parent acts on the body.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cached_property
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbsgen.documents import abbreviate, nearest
from mbsgen.errors import MbsError
from mbsgen.expressions import FLOATS, Expression, ExpressionError, Program, evaluate, names, parse, spell
from mbsgen.manifest import Element, Fibres, Kernel, Manifest
from mbsrun.metabolics import BASAL, list_contracting, list_rates
from mbsrun.quantities import ARRAYS, RARE, SENSED, Quantity, find_unit, lay_out, list_multiplier_units

Array = NDArray[np.float64]

AXES = "xyz"
FIXED = ("T", "unknowns")  # kinds that do not change along a motion
_TAKEN = ("q", "qd", "qdd", "u", "w", "lam")  # inputs of kernels that are parts of a motion


class UnknownNameError(MbsError, KeyError):
    """A name that no quantity has."""

    def __str__(self) -> str:
        return str(self.args[0])


class Source(Protocol):
    """Kernels of one model, as far as they are called here."""

    @property
    def manifest(self) -> Manifest:
        """Describe the kernels."""

    def describe(self, name: str) -> Kernel:
        """Describe one kernel."""

    def __call__(self, name: str, /, *, sparse: bool = False, **inputs: ArrayLike) -> dict[str, Array]:
        """Evaluate a kernel in a batch of states."""


@dataclass(frozen=True)
class Result:
    """One number that follows from a motion: where it is found, and its unit."""

    group: str  # a key of GROUPS
    index: int
    unit: str


def list_results(manifest: Manifest) -> Mapping[str, Result]:
    """List all numbers that follow from a motion of a model, by name."""
    if not manifest.coordinates:
        return {}
    found: dict[str, Result] = {}
    for group, columns in _list_names(manifest):
        units = columns.values()
        spelled = spell(list(columns))
        found |= {
            name: Result(group, i, unit)
            for i, (name, unit) in enumerate(zip(spelled, units, strict=True))
            if name is not None
        }
    return found


def _list_names(manifest: Manifest) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield each group with the names and units of its columns."""
    joints = manifest.coordinates
    sensors = [frame.name for frame in manifest.frames if frame.sensor]
    powered = [joints[i].name for i in (*manifest.actuated, *manifest.driven)]
    yield "energy", {"kinetic": "J", "potential": "J", "energy": "J"}
    for name, unit in (("momentum", "kg m/s"), ("angular_momentum", "kg m2/s"), ("com", "m")):
        yield name, {f"{name}_{axis}": unit for axis in AXES}
    yield "power", {"power": "W", **{f"power_{name}": "W" for name in powered}}
    for group, letter, unit in (("acceleration", "a", "m/s^2"), ("alpha", "wd", "rad/s^2")):
        yield group, {f"{letter}{axis}_{name}": unit for name in sensors for axis in AXES}
    yield "turns", {f"{turn}_{name}": "rad" for name in sensors for turn in ("roll", "pitch", "yaw")}
    yield "tension", {f"tension_{name}": "N" for name in manifest.elements}
    muscles = [element.name for element, _ in list_muscles(manifest)]
    yield "fibre", {f"fibre_{name}": "m" for name in muscles}
    yield "pennation", {f"pennation_{name}": "rad" for name in muscles}
    rated = list_contracting(manifest)
    if rated:
        yield "metabolic", {**{f"metabolic_{x.name}": "W" for x, *_ in rated}, "basal": "W", "metabolic": "W"}
    arms = {f"arm_{force}_{c.name}": "m" if c.unit == "rad" else "" for force in manifest.elements for c in joints}
    yield "arm", arms
    stops = {point.name for point in manifest.rigid if point.is_stop}  # of numbers in any unit
    yield "gap", {f"gap_{name}": "" if name in stops else "m" for name in manifest.contacts}
    pairs = [pair.name for pair in manifest.meetings]
    yield "solid_gap", {f"gap_{name}": "m" for name in pairs}
    if len(manifest.rigid) in (0 if not pairs else len(manifest.contacts), len(manifest.contacts)):
        every = (*manifest.contacts, *pairs)  # no function has forces of both kinds of contacts
        yield "normal", {f"normal_{name}": "" if name in stops else "N" for name in every}
        placed = [name for name in every if name not in stops]
        yield "contact_force", {f"f{axis}_{name}": "N" for name in placed for axis in AXES}
    equations = zip(manifest.equations, list_multiplier_units(manifest), strict=True)
    yield "lam", {f"lam_{name}": unit for name, unit in equations}
    is_known = manifest.appearance is not None and not manifest.touching
    axles = [] if manifest.appearance is None or not is_known else [axle.name for axle in manifest.appearance.axles]
    yield "reaction", {f"reaction_{name}": "N" for name in axles}
    yield "reaction_force", {f"reaction_{axis}_{name}": "N" for name in axles for axis in AXES}
    yield "reaction_moment", {f"reaction_m{axis}_{name}": "N m" for name in axles for axis in AXES}


def list_muscles(manifest: Manifest) -> Iterator[tuple[Element, Fibres]]:
    """Yield the muscles whose fibres follow from lengths, rates and signals alone."""
    known = {"length", "rate", *manifest.signals}
    for element in () if manifest.appearance is None else manifest.appearance.elements:
        own = element.muscle
        if own is not None and names(parse(own.fibre)) | names(parse(own.cosine)) <= known:
            yield element, own


class Numbers:
    """The numbers of a motion at K times by name. Each kernel is called, and if need be generated, at its first use."""

    def __init__(
        self,
        plant: Source,
        known: Mapping[str, Quantity],
        parts: Mapping[str, Array],
        constant: Iterable[str] = FIXED,
        rates: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        """Take quantities, and their values (K, size) by kind: t, q, qd, qdd, u, w, lam, tau, and more.

        `rates` are metabolic rates of muscles that a problem states, over quantities, by their names in expressions.

        The plant has the parameters of the motion. Kinds in `constant` do not change along it, and have no values here.
        """
        self._plant, self._parts, self.stated_rates = plant, parts, rates
        constant = frozenset(constant)
        self._known = {name: x for name, x in known.items() if x.kind not in constant}
        self._found: dict[str, Array] = {}

    @cached_property
    def names(self) -> tuple[str, ...]:
        """List the names of quantities of expressions, except for rare ones, which are among the results."""
        return tuple(name for name, x in self._known.items() if x.kind not in RARE)

    @cached_property
    def _results(self) -> Mapping[str, Result]:
        found = list_results(self._plant.manifest)
        return MappingProxyType({name: x for name, x in found.items() if name not in self._known})

    @property
    def results(self) -> tuple[str, ...]:
        """List the names of the numbers that follow from the motion."""
        rare = (name for name, x in self._known.items() if x.kind in RARE)
        return (*rare, *self._results)

    def __contains__(self, name: object) -> bool:
        return name in self._known or name in self._results

    def __getitem__(self, name: str) -> Array:
        """Return a number at all times, (K,). Raises UnknownNameError, and ArgumentError for folders that lack it."""
        if name in self._known:
            quantity = self._known[name]
            return np.asarray(self.whole(quantity.kind)[:, quantity.index])
        result = self._results.get(name)
        if result is None:
            raise self.refuse(name)
        return np.asarray(self.whole(result.group)[:, result.index])

    def unit(self, name: str) -> str:
        """Return the unit of a number; "" where it has none, or a problem does not say. Raises UnknownNameError."""
        if name in self._known:
            return find_unit(self._known[name], self._plant.manifest)
        if name not in self._results:
            raise self.refuse(name)
        return self._results[name].unit

    def label(self, name: str) -> str:
        """Return a number's name with its unit, as a column has it. Raises UnknownNameError."""
        unit = self.unit(name)
        return f"{name} [{unit}]" if unit else name

    def select(self, patterns: Sequence[str]) -> tuple[str, ...]:
        """List the names that are among `patterns`: names, or patterns as of files. Raises UnknownNameError."""
        strange = [pattern for pattern in patterns if not self._match(pattern)]
        if strange:
            raise self.refuse(strange[0])
        return self.select_known(patterns)

    def select_known(self, patterns: Sequence[str]) -> tuple[str, ...]:
        """List the names that are among `patterns`, some of which may match nothing."""
        return tuple(dict.fromkeys(name for pattern in patterns for name in self._match(pattern)))

    def _match(self, pattern: str) -> list[str]:
        if pattern in self:
            return [pattern]
        return [name for name in (*self.names, *self.results) if fnmatchcase(name, pattern)]

    def whole(self, kind: str) -> Array:
        """Return all entries of a kind of quantities or of a group of results, (K, size)."""
        if kind in self._parts:
            return self._parts[kind]
        if kind not in self._found:
            self._found[kind] = _GROUPS[kind](self)
        return self._found[kind]

    def call(self, kernel: str, result: str) -> Array:
        """Call a kernel in all states; return one result, (K, ...)."""
        inputs = (a.name for a in self._plant.describe(kernel).inputs if a.nnz and a.name in _TAKEN)
        given: dict[str, Any] = {name: self._parts[name] for name in inputs}
        return self._plant(kernel, **given)[result]

    def evaluate(self, expression: Expression) -> Array:
        """Compute an expression of these numbers and of signals, (K,)."""
        signals = self.manifest.signals
        known = dict(zip(signals, self.whole("w")[:, -len(signals) :].T, strict=True)) if signals else {}
        known |= {name: self[name] for name in names(expression) if name not in known}
        with np.errstate(all="ignore"):
            found = Program((expression,), ARRAYS).evaluate(known)[0]
        return np.asarray(np.broadcast_to(found, len(self.whole("q"))))

    @property
    def manifest(self) -> Manifest:
        """Describe the model."""
        return self._plant.manifest

    @cached_property
    def rates(self) -> Array:
        """Return the time derivatives of q, (K, nq)."""
        return self.call("rates", "rate") if self.manifest.configuration else self._parts["qd"]

    def refuse(self, name: str) -> UnknownNameError:
        """Return the error of a name that nothing has."""
        known = (*self.names, *self.results)
        meant = nearest(name, list(known))
        remedy = f"did you mean {meant}?" if meant else f"there are {', '.join(known)}"
        return UnknownNameError(f"there is no quantity {abbreviate(name)}; {remedy}")


def _column(kernel: str, result: str) -> Callable[[Numbers], Array]:
    return lambda numbers: numbers.call(kernel, result)


def _vectors(kernel: str, result: str) -> Callable[[Numbers], Array]:
    return lambda numbers: lay_out(numbers.call(kernel, result))


def _find_energy(numbers: Numbers) -> Array:
    kinetic, potential = (numbers.call("energy", name) for name in ("kinetic", "potential"))
    return np.hstack((kinetic, potential, kinetic + potential))


def _find_power(numbers: Numbers) -> Array:
    """Find the power of all forces but gravity, then of inputs and drives; loops do no work."""
    manifest, qd = numbers.manifest, numbers.whole("qd")
    inputs = numbers.whole("u") * qd[:, list(manifest.actuated)]
    drives = numbers.whole("tau") * qd[:, list(manifest.driven)] if manifest.driven else np.zeros((len(qd), 0))
    whole = numbers.call("power", "power") + drives.sum(axis=1, keepdims=True)
    return np.hstack((whole, inputs, drives))


def _find_turns(numbers: Numbers) -> Array:
    """Find roll, pitch and yaw: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    R = numbers.whole("attitude").reshape(len(numbers.whole("q")), -1, 3, 3)  # times, sensors, axes, components
    x, y, z = (R[:, :, k] for k in range(3))
    pitch = np.arctan2(-x[..., 2], np.hypot(x[..., 0], x[..., 1]))
    found = np.arctan2(y[..., 2], z[..., 2]), pitch, np.arctan2(x[..., 1], x[..., 0])
    return np.stack(found, axis=2).reshape(len(R), -1)


def _find_arms(numbers: Numbers) -> Array:
    """Find the moment arms: less the derivatives of lengths by the velocities' coordinates."""
    slopes = _slope(numbers)
    if numbers.manifest.configuration:
        slopes = np.einsum("kij,kjl->kil", slopes, numbers.call("jac_rates", "jac_rate_qd"))
    return 0.0 - slopes.reshape(len(slopes), -1)  # no -0.0


def _find_fibres(numbers: Numbers) -> Array:
    return _compute_fibres(numbers, lambda muscle: muscle.fibre)


def _find_pennations(numbers: Numbers) -> Array:
    return np.arccos(_compute_fibres(numbers, lambda muscle: muscle.cosine))


def _compute_fibres(numbers: Numbers, choose: Callable[[Fibres], str]) -> Array:
    """Compute an expression of each muscle at all times; nan where it has no value."""
    manifest = numbers.manifest
    lengths, rates = numbers.whole("length"), numbers.whole("rate")
    signals = numbers.whole("w")[:, -len(manifest.signals) :].T if manifest.signals else ()
    columns = []
    for element, muscle in list_muscles(manifest):
        k = manifest.elements.index(element.name)
        own = {"length": lengths[:, k], "rate": rates[:, k], **dict(zip(manifest.signals, signals, strict=True))}
        columns.append(
            [
                _evaluate(parse(choose(muscle)), {key: float(x[i]) for key, x in own.items()})
                for i in range(len(lengths))
            ]
        )
    return np.array(columns).T.reshape(len(lengths), -1)


def _find_metabolic(numbers: Numbers) -> Array:
    """Find the metabolic rates of muscles, of the body at rest, and their sum; nan where a rate is not known."""
    manifest, count = numbers.manifest, len(numbers.whole("q"))
    columns = []
    for name, own in list_rates(manifest, numbers).items():
        stated = numbers.stated_rates.get(spell([name])[0] or "")
        rate = own if stated is None else parse(stated)
        columns.append(np.full(count, np.nan) if rate is None else numbers.evaluate(rate))
    masses = () if manifest.appearance is None else manifest.appearance.masses
    basal = np.full(count, BASAL * sum(x.mass for x in masses))
    return np.column_stack((*columns, basal, np.sum(columns, axis=0) + basal))


def _evaluate(expression: Expression, known: Mapping[str, float]) -> float:
    try:
        return evaluate(expression, known, FLOATS)
    except ExpressionError:
        return np.nan


def _slope(numbers: Numbers) -> Array:
    return numbers.call("jac_lengths", "jac_length_q")


def _find_reactions(numbers: Numbers) -> Array:
    forces = numbers.whole("reaction_force")
    return np.asarray(np.linalg.norm(forces.reshape(len(forces), -1, 3), axis=2))


_GROUPS: Mapping[str, Callable[[Numbers], Array]] = {
    **{kind: _vectors(x.kernel, x.result) for kind, x in SENSED.items()},
    "energy": _find_energy,
    "momentum": _column("energy", "momentum"),
    "angular_momentum": _column("energy", "angular_momentum"),
    "com": _column("energy", "com"),
    "power": _find_power,
    "acceleration": _vectors("accelerations", "acceleration"),
    "alpha": _vectors("accelerations", "alpha"),
    "turns": _find_turns,
    "tension": _column("tensions", "tension"),
    "fibre": _find_fibres,
    "pennation": _find_pennations,
    "metabolic": _find_metabolic,
    "arm": _find_arms,
    "gap": _column("distances", "distance"),
    "normal": _column("contact_forces", "normal"),
    "contact_force": _vectors("contact_forces", "contact_force"),
    "reaction": _find_reactions,
    "reaction_force": _vectors("reactions", "force"),
    "reaction_moment": _vectors("reactions", "moment"),
}
