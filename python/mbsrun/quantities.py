"""The names of a motion's quantities in expressions: see `ocp.transcription.quantities`, `simulation.drive`.

A problem of optimal control adds names: its own states and controls, the components of open wrenches, and the forces
of driven joints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbsgen.expressions import Algebra, spell
from mbsgen.manifest import Manifest
from mbsrun.ocp.ground.memory import Memory

_AXES = ("x", "y", "z")
Array = NDArray[np.float64]


def _number(value: float) -> Array:
    return np.array([value])


ARRAYS: Algebra[Array] = Algebra(
    number=_number,
    constants={"pi": _number(np.pi)},
    negate=np.negative,
    operations={"+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide},
    power=lambda base, exponent: np.power(base, float(exponent)),
    functions={
        "sin": np.sin,
        "cos": np.cos,
        "tan": np.tan,
        "asin": np.arcsin,
        "acos": np.arccos,
        "atan": np.arctan,
        "atan2": np.arctan2,
        "sqrt": np.sqrt,
        "exp": np.exp,
        "log": np.log,
        "tanh": np.tanh,
        "abs": np.abs,
        "max": np.maximum,
    },
)


@dataclass(frozen=True)
class Quantity:
    """One number of a motion."""

    kind: str  # t, T, q, qd, qdd, u, or a key of SENSED; states, controls, w or tau, where a problem adds them
    index: int  # within its kind; positions and velocities of sensors follow each other


@dataclass(frozen=True)
class Sensed:
    """A kind of quantities that a kernel computes of coordinates and velocities."""

    kernel: str
    inputs: tuple[str, ...]
    result: str
    unit: str


SENSED: Mapping[str, Sensed] = {
    "position": Sensed("sensors", ("q",), "position", "m"),
    "v": Sensed("motion", ("q", "qd"), "v", "m/s"),
    "omega": Sensed("motion", ("q", "qd"), "omega", "rad/s"),
    "attitude": Sensed("attitudes", ("q",), "attitude", ""),
    "length": Sensed("lengths", ("q",), "length", "m"),
    "rate": Sensed("stretches", ("q", "qd"), "stretch", "m/s"),
}
RARE = ("omega", "attitude", "length", "rate")  # kinds that a list of all quantities leaves out


@dataclass(frozen=True)
class Added:
    """The names that a problem adds to the names of its model."""

    states: tuple[str, ...] = ()
    controls: tuple[str, ...] = ()
    unknowns: tuple[str, ...] = ()


def list_quantities(manifest: Manifest, added: Added | None = None) -> Mapping[str, Quantity]:
    """Return everything of a model, and of a problem, that an expression may use, by name."""
    if added is None:
        return _OWN.find(lambda: _list_own(manifest), manifest)
    known = dict(_WITH_FORCES.find(lambda: {**list_quantities(manifest), **_list_forces(manifest)}, manifest))
    for kind, own in (("states", added.states), ("controls", added.controls), ("unknowns", added.unknowns)):
        known |= {name: Quantity(kind, i) for i, name in enumerate(own)}
    return known


_OWN, _WITH_FORCES = Memory[Mapping[str, Quantity]](), Memory[Mapping[str, Quantity]]()


def _list_own(manifest: Manifest) -> dict[str, Quantity]:
    """Return everything of a model but its open forces."""
    coordinates = [c.name for c in manifest.coordinates]
    known = {"t": Quantity("t", 0), "T": Quantity("T", 0)}
    for kind, entries in (
        ("q", manifest.positions),
        ("qd", coordinates),
        ("qdd", coordinates),
        ("u", [coordinates[i] for i in manifest.actuated]),
    ):
        known |= {f"{kind}_{name}": Quantity(kind, i) for i, name in enumerate(spell(entries)) if name is not None}
    for i, name in enumerate(spell([frame.name for frame in manifest.frames if frame.sensor])):
        for k, axis in enumerate(_AXES if name is not None else ()):
            known[f"{axis}_{name}"] = Quantity("position", 3 * i + k)
            known[f"v{axis}_{name}"] = Quantity("v", 3 * i + k)
            known[f"w{axis}_{name}"] = Quantity("omega", 3 * i + k)
            known |= {f"{axis}{part}_{name}": Quantity("attitude", 9 * i + 3 * k + j) for j, part in enumerate(_AXES)}
    for i, x in enumerate(spell(manifest.elements)):
        known |= {} if x is None else {f"{kind}_{x}": Quantity(kind, i) for kind in ("length", "rate")}
    return known


def _list_forces(manifest: Manifest) -> dict[str, Quantity]:
    """Return open wrenches and signals, and forces of driven joints."""
    known = {name: Quantity("w", i) for i, name in enumerate(name_components(manifest)) if name is not None}
    driven = spell([manifest.coordinates[i].name for i in manifest.driven])
    return known | {f"tau_{name}": Quantity("tau", i) for i, name in enumerate(driven) if name is not None}


def find_unit(quantity: Quantity, manifest: Manifest) -> str:
    """Return the unit of a quantity; "" for none, and for numbers of a problem, which does not say."""
    entry = quantity.index
    match quantity.kind:
        case "t" | "T":
            return "s"
        case "q":
            units = {c.name: c.unit for c in manifest.coordinates}
            return units.get(manifest.positions[entry], "m" if manifest.positions[entry][-2:] in _PLACES else "")
        case "qd" | "qdd":
            return manifest.coordinates[entry].unit + ("/s" if quantity.kind == "qd" else "/s^2")
        case "u":
            return manifest.coordinates[manifest.actuated[entry]].force_unit
        case "tau":
            return manifest.coordinates[manifest.driven[entry]].force_unit
        case kind if kind in SENSED:
            return SENSED[kind].unit
        case "w":
            parts = [k for x in manifest.wrenches for k, is_open in enumerate((x.force, x.moment)) if is_open]
            return ("N", "N m")[parts[entry // 3]] if entry < 3 * len(parts) else ""
    return ""


def lay_out(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a result of a kernel in K states as vectors, column by column: (K, rows, cols) -> (K, rows cols)."""
    return values.swapaxes(1, 2).reshape(len(values), -1) if values.ndim == 3 else values


def list_input_units(manifest: Manifest) -> list[str]:
    """List the units of all inputs: of u, then of w; signals have none."""
    count = len(manifest.actuated)
    own = [Quantity("u", i) for i in range(count)]
    own += [Quantity("w", i) for i in range(len(manifest.inputs) - count)]
    return [find_unit(quantity, manifest) for quantity in own]


def list_multiplier_units(manifest: Manifest) -> list[str]:
    """List the units of the multipliers: of forces along distances, of moments; expressions have none."""
    return [_MULTIPLIERS.get(name, "N m") for loop in manifest.loops for name in loop.equations]


def label_multipliers(manifest: Manifest) -> list[str]:
    """Name the columns of multipliers, with units, as in tables."""
    pairs = zip(manifest.equations, list_multiplier_units(manifest), strict=True)
    return [f"lam[{name}] [{unit or '-'}]" for name, unit in pairs]


def label_motion(manifest: Manifest, *, rates: int) -> list[str]:
    """Name the columns of coordinates and of their first derivatives, as many as `rates`, with units, as in tables."""
    units = {c.name: c.unit for c in manifest.coordinates}
    kinds = (("qd", "/s"), ("qdd", "/s^2"))[:rates]
    positions = [f"q[{name}] [{units.get(name, '-')}]" for name in manifest.positions]  # quaternions have no unit
    return positions + [f"{kind}[{name}] [{unit}{per}]" for kind, per in kinds for name, unit in units.items()]


def label_forces(manifest: Manifest, kind: str, entries: Sequence[int]) -> list[str]:
    """Name the columns of a kind of forces of some coordinates, with units, as in tables."""
    return [f"{kind}[{c.name}] [{c.force_unit}]" for c in (manifest.coordinates[i] for i in entries)]


_PLACES = (".x", ".y", ".z")  # ends of the names of coordinates of a free body
_MULTIPLIERS = {**dict.fromkeys(("x", "y", "z", "distance", "screw"), "N"), "equation": ""}


def name_quantities(kind: str, entries: Sequence[str]) -> list[str]:
    """Return the names of entries of a kind in expressions; entries without one keep theirs."""
    return [entry if name is None else f"{kind}_{name}" for entry, name in zip(entries, spell(entries), strict=True)]


SIGNAL = -1  # the component of a signal, which has one number


def find_component(manifest: Manifest, wrench: str, component: int) -> int | None:
    """Return the entry of w that is a component of a wrench (0 to 2: force, 3 to 5: moment), or SIGNAL; else None."""
    i = 0
    for known in manifest.wrenches:
        for k, is_open in ((0, known.force), (3, known.moment)):
            if is_open and known.name == wrench and k <= component < k + 3:
                return i + component - k
            i += 3 * is_open
    return i + manifest.signals.index(wrench) if component == SIGNAL and wrench in manifest.signals else None


def name_components(manifest: Manifest) -> list[str | None]:
    """Name the entries of w: fx_NAME to fz_NAME and mx_NAME to mz_NAME of open wrenches, signal_NAME of signals."""
    names = spell([wrench.name for wrench in manifest.wrenches])
    components = [
        None if name is None else f"{part}{axis}_{name}"
        for wrench, name in zip(manifest.wrenches, names, strict=True)
        for part, is_open in (("f", wrench.force), ("m", wrench.moment))
        if is_open
        for axis in _AXES
    ]
    return [*components, *(f"signal_{name}" for name in manifest.signals)]
