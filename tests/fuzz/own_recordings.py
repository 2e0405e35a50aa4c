"""Random recordings: samples of cubic polynomials, which splines of degree 3 and 5 through them equal, with a gap.

So a recorded value is known in closed form: the polynomial, and 0 or 1 for whether there is one.
"""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from tests.fuzz.formulas import Formula, draw_quantity
from tests.fuzz.problem_names import Mechanical, spell

Array = NDArray[np.float64]
Data = dict[str, Any]

NAME = "walk"
MARKER = "mark"
GAPPED = "lift"  # the column with a gap
COLUMNS = {GAPPED: "lift", **{f"{axis}_{MARKER}": f"{axis}[{MARKER}]" for axis in "xyz"}}  # as expressions name them
SAMPLES = 25
GAP = (9, 15)  # the samples at its ends
BEYOND = 3.5  # the duration of a recording over a horizon's guess


@dataclass(frozen=True)
class Recorded:
    """A recording: cubic polynomials by column, and its entry in a problem file."""

    polynomials: Mapping[str, Polynomial]
    times: Array
    entry: Mapping[str, Any]
    span: tuple[float, float] | None  # the times that are the start and the end of the horizon; None: from 0 on

    def write(self, folder: Path) -> Data:
        """Write the file; return the section of the problem file."""
        lines = [",".join(["t", *COLUMNS.values()])]
        for k, t in enumerate(self.times):
            cells = [
                "" if name == GAPPED and GAP[0] < k < GAP[1] else f"{self.polynomials[name](t)}" for name in COLUMNS
            ]
            lines.append(",".join([f"{t}", *cells]))
        (folder / self.entry["file"]).write_text("\n".join(lines) + "\n", encoding="utf-8")
        return {NAME: dict(self.entry)}

    def name_values(self, t: Array, T: float) -> dict[str, Array]:
        """Name the recorded values at times of the problem, and whether they are known."""
        if self.span is not None:
            t = self.span[0] + (self.span[1] - self.span[0]) * t / T
        is_known = ~((t > self.times[GAP[0]]) & (t < self.times[GAP[1]]))
        found = {f"ref_{NAME}_{name}": polynomial(t) for name, polynomial in self.polynomials.items()}
        found |= {f"known_{NAME}_{name}": np.ones_like(t) for name in COLUMNS}
        return found | {f"known_{NAME}_{GAPPED}": is_known.astype(float)}


def draw_recording(pick: random.Random, T: float, *, is_free: bool) -> Recorded:
    """Draw a recording for a horizon of about T; a free one is the whole of a part of it."""
    times = np.linspace(0, round(BEYOND * T, 3), SAMPLES)
    scale = 1 / times[-1]
    polynomials = {name: Polynomial([round(pick.uniform(-1, 1), 2) * scale**k for k in range(4)]) for name in COLUMNS}
    entry: Data = {"file": f"{NAME}.csv", "gap": 1e-4, "degree": pick.choice([3, 5])}
    if not is_free and pick.random() < 0.5:
        return Recorded(polynomials, times, entry, None)
    start, end = (round(float(times[-1]) * pick.uniform(*part), 4) for part in ((0.1, 0.3), (0.7, 0.9)))
    return Recorded(polynomials, times, entry | {"time": "normalised", "start": start, "end": end}, (start, end))


def draw_track(pick: random.Random, own: Mechanical, states: Sequence[str]) -> tuple[list[Data], list[Data]]:
    """Draw an entry of `cost.track`, and running terms that read recorded values."""
    places = [x for x in own.positions if x not in own.turning]
    track: Data = {"reference": NAME, "weight": pick.choice([1, 0.4, "c0"])}
    if places:
        track["coordinates"] = {pick.choice(places): GAPPED}
    if own.sensors and (not places or pick.random() < 0.5):
        track["markers"] = {own.sensors[-1]: MARKER}
        track["weights"] = {own.sensors[-1]: 0.6}
    read = draw_quantity(pick, [*states, *[f"ref_{NAME}_{name}" for name in COLUMNS] * 3]).tree
    return [track], [{"expression": Formula(("*", f"known_{NAME}_{GAPPED}", read)), "weight": 0.8}]


def list_squares(track: Data) -> dict[str, Any]:
    """Return the tree of each squared distance of an entry of `cost.track`, by the name that has the weight."""
    found: dict[str, Any] = {}
    for name, column in track.get("coordinates", {}).items():
        found[name] = ("*", f"known_{NAME}_{column}", ("**", ("-", f"q_{spell(name)}", f"ref_{NAME}_{column}"), 2))
    for name, marker in track.get("markers", {}).items():
        parts = [("**", ("-", f"{axis}_{spell(name)}", f"ref_{NAME}_{axis}_{marker}"), 2) for axis in "xyz"]
        found[name] = ("+", ("+", parts[0], parts[1]), parts[2])
    return found
