"""Numbers of the state that forces read, by the names that problem files have for them: Model -> names, symbols.

    q_NAME, qd_NAME                                       of a joint: coordinate and velocity
    x_NAME, y_NAME, z_NAME, vx_NAME, vy_NAME, vz_NAME     of a frame: position and velocity of its origin, in the base

    t                                                     the time
    NAME                                                  of a signal: a number that a use of the model gives

Dots and blanks of a name are written _. A joint with a quaternion has velocities only.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from sympy import Symbol

from mbsgen.expressions import Expression, Name, names, spell
from mbsgen.manifest import TIME
from mbsgen.model.following import list_joints
from mbsgen.model.model import BASE, Model
from mbsgen.model.tree import Reading, coordinate_symbol, rate_symbol, signal_symbol

_READINGS: Mapping[str, Reading] = {"": Reading.POSITION, "v": Reading.VELOCITY}


@dataclass(frozen=True)
class Quantity:
    """One number of the state."""

    symbol: Symbol
    source: str  # the joint, the frame or the signal
    reading: Reading | None = None  # of a frame
    is_given: bool = False  # of a signal, or the time

    @property
    def joint(self) -> str | None:
        """The joint that it is a coordinate or velocity of."""
        return self.source if self.reading is None and not self.is_given else None


def list_quantities(model: Model) -> dict[str, Quantity]:
    """Return every number of the state that a force may read, by name."""
    steps = list_joints(model)
    scalars = [step.name for step in steps if not step.joint.floats]
    found = {
        f"{kind}_{name}": Quantity(symbol(joint), joint)
        for kind, symbol, joints in (
            ("q", coordinate_symbol, scalars),
            ("qd", rate_symbol, [step.name for step in steps]),
        )
        for joint, name in zip(joints, spell(joints), strict=True)
        if name is not None
    }
    frames = [frame.name for frame in model.frames]
    for frame, name in zip(frames, spell(frames), strict=True):
        for sign, reading in _READINGS.items() if name is not None else ():
            for axis, symbol in zip("xyz", probe_symbols(frame, reading), strict=True):
                found[f"{sign}{axis}_{name}"] = Quantity(symbol, frame, reading)
    return found | {name: Quantity(signal_symbol(name), name, is_given=True) for name in _list_given(model)}


def _list_given(model: Model) -> tuple[str, ...]:
    """Name the signals, and the time; a parameter of a name takes it."""
    taken = {p.name for p in model.parameters}
    return tuple(name for name in (*model.signals, TIME) if name not in taken)


def probe_symbols(name: str, reading: Reading) -> tuple[Symbol, Symbol, Symbol]:
    """Return the symbols that a probe reads: of a frame, or of a part of a force."""
    x, y, z = (Symbol(f"{reading.value}[{name}].{axis}", real=True) for axis in "xyz")
    return x, y, z


def list_laws(model: Model) -> Iterator[Expression]:
    """List all expressions of a model that may read the state."""
    for body in model.bodies:
        yield from (joint.law.force for joint in body.joints)
    for wrench in model.wrenches:
        yield from (component for vector in (wrench.force, wrench.moment) for component in vector or ())
    for element in model.forces:
        yield element.law
        for point in element.path:
            yield from point.shift
            yield from () if point.presence is None else (Name(point.presence.number),)


def find_stopped(model: Model) -> frozenset[str]:
    """Return all names in the quantities that stops limit."""
    return frozenset[str]().union(*(names(x.quantity) for x in model.stops))


def name_lengths(elements: Sequence[str]) -> dict[str, str]:
    """Return the force elements by the names that stops have for their lengths."""
    return {f"length_{word}": own for own, word in zip(elements, spell(elements), strict=True) if word is not None}


def list_poses(model: Model) -> dict[str, Quantity]:
    """Return the numbers of the state that are of the pose alone: coordinates, and places of frames."""
    return {
        name: x
        for name, x in list_quantities(model).items()
        if x.reading is Reading.POSITION or (x.joint is not None and x.symbol == coordinate_symbol(x.joint))
    }


def find_moving(quantity: Expression, model: Model, carriers: Mapping[str, str]) -> bool:
    """Return whether a number of the pose may change; `carriers` are the bodies that move others."""
    own, poses, frames = names(quantity), list_poses(model), {x.name: x.body for x in model.frames}
    found = [poses[name] for name in own & poses.keys()]
    lengths = name_lengths([x.name for x in model.forces])
    return any(x.joint or carriers.get(frames[x.source]) != BASE for x in found) or not own.isdisjoint(lengths)


def find_read_frames(model: Model) -> frozenset[str]:
    """Name the frames that forces read."""
    known = list_quantities(model)
    read = find_stopped(model).union(*map(names, list_laws(model)))
    return frozenset(known[name].source for name in read & known.keys() if known[name].reading is not None)


def find_read_signals(model: Model) -> tuple[str, ...]:
    """Name the signals that forces read, in the model's order, and then the time if they read it."""
    read = frozenset[str]().union(*map(names, list_laws(model)))
    return tuple(name for name in _list_given(model) if name in read)


def find_ambiguous(expression: Expression, parameters: Iterable[str], others: Iterable[str]) -> list[str]:
    """Find the names in an expression that mean both a parameter and something else."""
    return sorted(names(expression) & frozenset(parameters) & frozenset(others))
