"""The models that other programs take: their states are q and qd, of an ordinary differential equation."""

from __future__ import annotations

from mbsgen.errors import MbsError
from mbsgen.manifest import Manifest


class PeerError(MbsError, ValueError):
    """A model that another program cannot take, or a program that is not installed."""


def check_states(manifest: Manifest, peer: str) -> None:
    """Raise PeerError for a model whose state is more than q and qd, or whose motion needs more than u."""
    for found, what in (
        (manifest.quaternions, "quaternions"),
        (manifest.loops, "closed loops"),
        (manifest.driven, "driven joints"),
        (manifest.wrenches, "open wrenches"),
        (manifest.signals, f"forces that read {', '.join(manifest.signals)}"),
    ):
        if found:
            raise PeerError(f"{manifest.model} has {what}, and {peer} gives it q, qd and u alone; model it without")
