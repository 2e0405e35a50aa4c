"""Refusals of models with forces that no kernel has: dry friction, rigid contacts and stops. Simulations take them."""

from __future__ import annotations

from mbsgen.errors import Fault, InputError
from mbsgen.manifest import Manifest

FRICTION = "smooth it by a speed: friction: {torque: 1, speed: 0.01}"
LOADS = "give a torque in place of load, and smooth it by a speed: friction: {torque: 1, speed: 0.01}"
CONTACTS = "give contacts a stiffness in place of a restitution"
STOPS = "give the stops a stiffness in place of a restitution, or leave them out"


def find_hidden(manifest: Manifest, *, stops: bool) -> tuple[str, str] | None:
    """Return which joints or contacts have forces that no kernel has, and the remedy; with `stops` stops count too."""
    dry = [c.name for c in manifest.coordinates if c.friction is not None]
    if dry:
        return f"dry friction of joints {', '.join(dry)}, which is in no kernel", LOADS if manifest.loaded else FRICTION
    if manifest.touching:
        names = ", ".join(manifest.touching)
        return f"forces of rigid contacts {names}, which are in no kernel", CONTACTS
    if stops and manifest.switching:
        return f"rigid stops of joints {', '.join(manifest.switching)}, which are in no kernel", STOPS
    return None


def demand_smooth(manifest: Manifest, use: str, *, stops: bool) -> None:
    """Refuse a model with such forces. `use` is what needs all forces, as `a linearisation`. Raises InputError."""
    hidden = find_hidden(manifest, stops=stops)
    if hidden is not None:
        finding, remedy = hidden
        raise InputError([Fault(f"model {manifest.model}", 0, "", f"{use} would miss {finding}", remedy)])
