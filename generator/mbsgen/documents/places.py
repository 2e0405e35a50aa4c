"""Places in a document, their paths for users, and the display of values and words."""

from __future__ import annotations

import difflib
import json
import math
import re
from collections.abc import Container, Sequence
from dataclasses import dataclass

from mbsgen.errors import Fault, InputError

MAX_FAULTS = 100  # shown of one file
MAX_CANDIDATES = 200  # words that a misspelt one is compared with

Data = dict[str, "Data"] | list["Data"] | str | int | float | bool | None
Place = tuple[str | int, ...]  # keys and indices from the top of a document


@dataclass(frozen=True)
class Finding:
    """One finding at one place of a document, or of a value that was read from it, and the remedy."""

    place: Place
    finding: str
    remedy: str


def lies_under(place: Place, places: Container[Place]) -> bool:
    """Return whether a place is one of `places` or inside one."""
    return any(place[:i] in places for i in range(len(place) + 1))


def write_path(place: Place) -> str:
    """Return a place as a path: `bodies[2].joint.axis`."""
    path = ""
    for step in place:
        if isinstance(step, int):
            path += f"[{step}]"
        elif re.fullmatch(r"\w[\w-]{0,63}", step):
            path += f".{step}" if path else step
        else:
            path += f"[{abbreviate(step)}]"
    return path


def abbreviate(data: Data) -> str:
    """Return a value in at most about sixty characters."""
    match data:
        case None:
            return "nothing"
        case dict() if len(data) > 0:
            return f"a mapping of {', '.join(abbreviate(k) for k in list(data)[:3])}{', ...' if len(data) > 3 else ''}"
        case list() if len(data) > 6:
            return f"a list of {len(data)}"
        case list():
            inner = ", ".join(abbreviate(x) for x in data)
            return f"[{inner}]" if len(inner) < 60 else f"a list of {len(data)}"
        case str():
            return json.dumps(data if len(data) <= 40 else data[:37] + "...", ensure_ascii=False)
        case float() if not math.isfinite(data):
            return str(data)
    return json.dumps(data)


def nearest(word: str, words: Sequence[str]) -> str | None:
    """Return the word that was probably meant."""
    known = {known.casefold(): known for known in words[:MAX_CANDIDATES]}
    return next((known[found] for found in difflib.get_close_matches(word[:100].casefold(), known, 1)), None)


def refuse(faults: Sequence[Fault]) -> InputError:
    """Make the error of a file that is not accepted; of very many faults, it lists the first."""
    ordered = sorted(set(faults))
    if len(ordered) > MAX_FAULTS:
        last = ordered[MAX_FAULTS - 1]
        rest = Fault(last.file, last.line, last.path, "there are more faults after this", "mend these first")
        ordered = [*ordered[:MAX_FAULTS], rest]
    return InputError(ordered)
