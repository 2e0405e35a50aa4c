"""The names of a motion's quantities in expressions: see `mbsrun.ocp.quantities` and `mbsrun.simulation.drive`."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mbsgen.manifest import Manifest

_AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Quantity:
    """One number of a motion."""

    kind: str  # t, T, q, qd, qdd, u, position or v
    index: int  # within its kind; positions and velocities of sensors follow each other


def list_quantities(manifest: Manifest) -> Mapping[str, Quantity]:
    """Return everything of a model that an expression may use, by name."""
    coordinates = [c.name for c in manifest.coordinates]
    known = {"t": Quantity("t", 0), "T": Quantity("T", 0)}
    for kind, entries in (
        ("q", manifest.positions),
        ("qd", coordinates),
        ("qdd", coordinates),
        ("u", [coordinates[i] for i in manifest.actuated]),
    ):
        known |= {f"{kind}_{name}": Quantity(kind, i) for i, name in enumerate(_spell(entries)) if name is not None}
    for i, name in enumerate(_spell([frame.name for frame in manifest.frames if frame.sensor])):
        for k, axis in enumerate(_AXES if name is not None else ()):
            known[f"{axis}_{name}"] = Quantity("position", 3 * i + k)
            known[f"v{axis}_{name}"] = Quantity("v", 3 * i + k)
    return known


def _spell(names: Sequence[str]) -> list[str | None]:
    """Write names as identifiers; None for one that would equal another's."""
    spelled = [re.sub(r"\W", "_", name) for name in names]
    return [new if new == old or spelled.count(new) == 1 else None for old, new in zip(names, spelled, strict=True)]
