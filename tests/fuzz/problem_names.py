"""The names of a mechanism that problems read."""

from __future__ import annotations

from dataclasses import dataclass

from mbsgen.manifest import Manifest


def spell(name: str) -> str:
    """Write a coordinate's name as expressions do."""
    return name.replace(".", "_").replace(" ", "_")


@dataclass(frozen=True)
class Mechanical:
    """The names of a mechanism that a problem reads."""

    positions: tuple[str, ...]
    velocities: tuple[str, ...]
    inputs: tuple[str, ...]
    sensors: tuple[str, ...]
    wrenches: tuple[tuple[str, str], ...]  # name, force or moment
    signals: tuple[str, ...]
    parameters: tuple[tuple[str, float], ...]  # run-time ones
    design: tuple[tuple[str, float], ...]
    pose: tuple[float, ...]  # in which loops are closed
    independent: tuple[int, ...]  # velocities; none without loops
    dependent: tuple[int, ...]
    driven: tuple[int, ...]

    @staticmethod
    def of(manifest: Manifest) -> Mechanical:
        """Read the names off a manifest."""
        names = [c.name for c in manifest.coordinates]
        parts = [(x.name, part) for x in manifest.wrenches for part in ("force", "moment") if getattr(x, part)]
        return Mechanical(
            tuple(manifest.positions),
            tuple(names),
            tuple(names[i] for i in manifest.actuated),
            tuple(frame.name for frame in manifest.frames if frame.sensor),
            tuple(parts),
            tuple(name for name in manifest.signals if name.isidentifier() and name != "t"),
            tuple((x.name, x.value) for x in manifest.parameters),
            tuple((x.name, x.value) for x in manifest.design),
            tuple(manifest.pose) or tuple(float(x.endswith(".qw")) for x in manifest.positions),
            manifest.independent,
            manifest.dependent,
            manifest.driven,
        )

    @property
    def is_closed(self) -> bool:
        """Return whether there are closed loops."""
        return bool(self.dependent)

    @property
    def free(self) -> tuple[str, ...]:
        """List the velocities that determine all others, without driven ones."""
        every = self.independent if self.is_closed else range(len(self.velocities))
        return tuple(self.velocities[i] for i in every if i not in self.driven)

    @property
    def settled(self) -> tuple[str, ...]:
        """List the coordinates that a start gives, without quaternions: loops and motions give the others."""
        named = set(self.free)
        return tuple(x for x in self.positions if x in named and x not in self.turning)

    @property
    def turning(self) -> frozenset[str]:
        """List the entries of quaternions."""
        joints = [name.removesuffix(".qw") for name in self.positions if name.endswith(".qw")]
        return frozenset(f"{joint}.q{x}" for joint in joints for x in "xyzw")
