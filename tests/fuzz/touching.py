"""Random problems with a contact: one that stands for the whole horizon, or one that comes and goes, relaxed.

Such a contact is other sections in short: open components of its wrench, and constraints. A problem that has these
written out is compared with the program of the problem that names the contact. Conditions of a stand are added:
no velocity at points, and no way over an interval.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mbsgen.errors import InputError
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.solving.solve import Solver
from mbsrun.ocp.statement.checks import ProblemError
from tests.fuzz.formulas import Formula
from tests.fuzz.mechanisms import Tally
from tests.fuzz.own_links import AXES, POINT, Linking
from tests.fuzz.own_motion import NoMotionError
from tests.fuzz.own_problem import Problem
from tests.fuzz.own_sections import Demand, Sections
from tests.fuzz.phased import load_hit
from tests.fuzz.problem_derivatives import find_differing_backends, find_differing_tables, find_wrong_derivatives
from tests.fuzz.problem_drawing import Data, Drawing
from tests.fuzz.problem_names import Mechanical
from tests.fuzz.problems import SHARED, WITH_TABLES, Comparison, Drawn, keep_files, load_mechanism, state

ROUNDED = 1e-3  # N: of the apex of a cone, as `docs/problem.md` says
LAST = 1e-2  # of a relaxation


@dataclass(frozen=True)
class Touching:
    """A problem that names a contact, and the same one with its sections written out."""

    named: Drawn
    written: Drawn
    plant: Plant

    @property
    def contact(self) -> Data:
        """Return the contact."""
        (contact,) = self.named.data["contacts"]
        return dict(contact)


def draw(seed: int) -> Touching:
    """Draw a problem with a contact. Raises NoMotionError where the mechanism is closed, driven, or turns freely."""
    model, plant = load_mechanism(seed // SHARED)
    manifest = plant.manifest
    if manifest.configuration or manifest.dependent or manifest.driven:
        raise NoMotionError("contacts are drawn for trees without quaternions")
    hit, pick = load_hit(seed // SHARED), random.Random(f"{seed} touching")
    own = Mechanical.of(hit.manifest)
    data = {**Drawing(own, f"{seed} touching").problem(), "scheme": "radau"}
    axes = Linking(own, hit, pick).find_axes()
    if not axes:
        raise NoMotionError("the point does not move")
    contact: Data = {"sensor": POINT, "wrench": POINT, "axes": axes}
    if pick.random() < 0.5:
        contact = _draw_standing(contact, pick)
        data["start"].pop("velocity", None)  # it stands there, too
    else:
        contact = _draw_relaxed({**contact, "axes": axes[:2]}, pick)
        data["relaxation"] = {"first": 0.1, "last": LAST, "factor": 0.1}
    wrenches = {name: part for name, part in data["wrenches"].items() if name != POINT}
    named = {**data, "wrenches": wrenches, "contacts": [contact]}
    open_parts = {axis: {"range": [0, None]} if axis == contact["normal"] else {} for axis in contact["axes"]}
    wrenches = {**wrenches, POINT: {"force": [open_parts.get(axis, 0) for axis in AXES]}}
    constraints = [*data["constraints"], *_write_out(contact)]
    written = {**data, "wrenches": wrenches, "constraints": constraints}
    return Touching(Drawn(model, named, seed), Drawn(model, written, seed), hit)


def _draw_standing(contact: Data, pick: random.Random) -> Data:
    contact["normal"] = pick.choice([*contact["axes"], None])
    if contact["normal"] is not None and pick.random() < 0.6:
        contact["friction"] = 0.8
    return contact


def _draw_relaxed(contact: Data, pick: random.Random) -> Data:
    contact["normal"] = pick.choice(contact["axes"])
    if len(contact["axes"]) > 1:
        contact["friction"] = 0.7
    return contact | {"mode": "complementarity", "height": pick.choice([0, -0.2, 0.15])}


def _write_out(contact: Data) -> Iterator[Data]:
    """Write the constraints of a contact."""
    normal, across = contact["normal"], [axis for axis in contact["axes"] if axis != contact["normal"]]

    def ask(tree: Any, low: float | None, high: float | None) -> Data:
        return {"expression": Formula(tree), "range": [low, high]}

    if "friction" in contact and across:
        most, forces = ("*", contact["friction"], f"f{normal}_{POINT}"), [f"f{axis}_{POINT}" for axis in across]
        if len(across) == 1:
            yield from (ask((sign, most, forces[0]), 0, None) for sign in "+-")
        else:
            squares = ("+", ("+", ("**", forces[0], 2), ("**", forces[1], 2)), ROUNDED**2)
            yield ask(("-", ("+", most, ROUNDED), ("sqrt", squares)), 0, None)
    if "mode" in contact:
        gap = ("-", f"{normal}_{POINT}", contact["height"])
        yield ask(gap, 0, None)
        yield ask(("*", gap, f"f{normal}_{POINT}"), None, LAST)
        for axis in across:
            slip, force = f"v{axis}_{POINT}", f"f{axis}_{POINT}"
            yield ask(("*", slip, ("+", most, force)), None, LAST)
            yield ask(("neg", ("*", slip, ("-", most, force))), None, LAST)


class _Standing(Sections):
    """The sections of a problem, and what keeps a point standing along some axes."""

    axes: Sequence[str] = ()

    def list_demands(self) -> list[Demand]:
        """List all limits."""
        found, d = super().list_demands(), len(self.problem.nodes)
        for axis in self.axes:
            speeds = self.points[f"v{axis}_{POINT}"].reshape(-1, d)
            held = speeds if d == 1 else speeds[:, 1:]
            found.append(Demand(f"v{axis} of the contact", held.ravel(), (0.0, 0.0)))
            if d > 1:
                places = self.problem.at_mesh(self.motion, [*range(self.motion.intervals + 1)])[f"{axis}_{POINT}"]
                length = self.problem.fractions * (1 if self.problem.is_free else self.problem.T)
                found.append(Demand(f"the way along {axis} of the contact", np.diff(places) / length, (0.0, 0.0)))
            first = self.first[f"v{axis}_{POINT}"]
            found.append(Demand(f"v{axis} of the contact at the start", first, (0.0, 0.0), is_optional=True))
        return found


def examine(drawn: Touching, contact: Data | None = None) -> str:
    """Compare a problem with this program, which reads its contact or another; return what differs.

    Raises InputError where it is refused.
    """
    contact = contact or drawn.contact
    plant, named, written = drawn.plant, drawn.named, drawn.written
    stated, equipped = state(named, plant)
    own = Problem(written.data, Mechanical.of(plant.manifest), plant, written.seed)
    motion = own.move()
    sections = _Standing(own, motion, plant.manifest)
    sections.axes = () if "mode" in contact else tuple(contact["axes"])
    comparison = Comparison(stated, Solver(stated, equipped), motion)
    faults = [comparison.run(sections)]
    solver, x, rng = comparison.solver, comparison.x, np.random.default_rng(named.seed)
    bounds = solver.transcription.constraint_bounds(stated)
    faults += find_wrong_derivatives(solver.program.casadi, comparison.p, bounds, x, rng)
    faults += find_differing_backends(stated, solver, x, rng)
    if named.seed % WITH_TABLES == 0:
        faults += find_differing_tables(stated, solver, solver.plant, x, rng)
    return "; ".join(fault for fault in faults if fault)


def search(
    count: int, seed: int, keep: Path | None = None, show: Callable[[int, Tally], None] = lambda *_: None
) -> Tally:
    """Examine problems with contacts from a seed on."""
    tally = Tally()
    for number in range(seed, seed + count):
        drawn: Touching | None = None
        finding = ""
        try:
            drawn = draw(number)
            finding = examine(drawn)
        except (InputError, ProblemError, NoMotionError) as error:
            tally.refused.append((number, str(error).splitlines()[0]))
        except Exception as error:
            finding = f"{type(error).__name__}: {error}"
        else:
            tally.agreed += not finding
        if finding:
            tally.findings.append((number, finding))
            if keep is not None and drawn is not None:
                keep_files(keep, drawn.named, finding)
        show(number, tally)
    return tally
