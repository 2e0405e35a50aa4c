"""Findings on a Model, with their places."""

from __future__ import annotations

from dataclasses import dataclass

from mbsgen.documents import Place


@dataclass(frozen=True)
class Finding:
    """A finding at one place of a model, and the remedy."""

    place: Place
    finding: str
    remedy: str
