"""What is found wrong with a Model, and where."""

from __future__ import annotations

from dataclasses import dataclass

from mbsgen.documents import Place


@dataclass(frozen=True)
class Finding:
    """What is wrong at one place of a model, and what to do about it."""

    place: Place
    finding: str
    remedy: str
