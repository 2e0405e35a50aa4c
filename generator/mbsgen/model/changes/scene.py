"""The scene: the part of a model that one use needs. Other parts are not generated.

A scene is a separate YAML file beside the model. It names functions, locked joints, sensors and wrenches, kinds of
parameters, whether there is gravity and motion, results, functions to be joined at one state, and the tolerance for
leaving out small effects.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pydantic import Field

from mbsgen.documents import Document, Place, Section, abbreviate, examine, expect, nearest, read_document, refuse
from mbsgen.errors import Fault
from mbsgen.expressions import Expression, names
from mbsgen.model.changes.locking import lock
from mbsgen.model.expansion import list_steps
from mbsgen.model.following import list_joints
from mbsgen.model.model import BASE, ORIGIN, Frame, Model
from mbsgen.model.quantities import find_moving, find_read_frames
from mbsgen.model.sections import NumberField
from mbsgen.model.slips import keep_slips
from mbsgen.model.topology import find_carriers
from mbsgen.model.tree import Kind
from mbsgen.roles import QUICKEST, RESERVED

NAME = re.compile(r"[a-z][a-z0-9_]{0,30}", re.ASCII)
TAKEN = ("setup", "check", "names", "default_parameters")  # of other files of a generated folder
LARGEST_TOLERANCE = 0.5  # half of the result: beyond, nothing meaningful remains


class SceneSection(Section):
    """The shape of a scene file."""

    functions: tuple[str, ...] | None = Field(None, examples=[["impl"]], description="only these; else all")
    derivatives: int = Field(2, ge=0, le=2, examples=[2], description="up to which order")
    locked: dict[str, NumberField] = Field({}, examples=[{"q1": 0.0}], description="joints that do not move, rad or m")
    parameters: dict[str, Kind] = Field({}, examples=[{}], description="kinds, in place of the model's")
    sensors: tuple[str, ...] | None = Field(None, examples=[["tip"]], description="only these frames; else all")
    wrenches: tuple[str, ...] | None = Field(None, examples=[["push"]], description="only these; else all")
    gravity: bool = Field(True, examples=[True], description="false: there is none")
    motion: bool = Field(True, examples=[True], description="false: velocities are zero, and no input")
    results: dict[str, tuple[str, ...]] = Field({}, examples=[{"energy": ["kinetic"]}], description="of functions")
    together: dict[str, tuple[str, ...]] = Field(
        {}, examples=[{"step": ["impl", "sensors"]}], description="functions of one state, as one function of this name"
    )
    tolerance: float | None = Field(
        None, ge=0, le=LARGEST_TOLERANCE, examples=[1e-3], description="relative error that may be made; else none"
    )


@dataclass(frozen=True)
class Scene:
    """The part of a model to generate; by default all."""

    functions: tuple[str, ...] | None = None
    derivatives: int = 2
    locked: tuple[tuple[str, Expression], ...] = ()
    parameters: tuple[tuple[str, Kind], ...] = ()
    sensors: tuple[str, ...] | None = None
    wrenches: tuple[str, ...] | None = None
    gravity: bool = True
    motion: bool = True
    results: tuple[tuple[str, tuple[str, ...]], ...] = ()
    together: tuple[tuple[str, tuple[str, ...]], ...] = ()
    tolerance: float | None = None  # of the functions, relative; None or 0: nothing is left out that is felt


EVERYTHING = Scene()


def read_scene(path: Path, model: Model, functions: Mapping[str, Sequence[str]]) -> Scene:
    """Read a scene file for a model; `functions` are the available functions, with their results.

    Raises InputError with every fault of the file.
    """
    document = read_document(path)
    expect(document, "scene")
    examination = examine(document, SceneSection)
    faults, section = list(examination.faults), examination.value
    if section is not None:
        faults += _Judgement(document, model, functions, examination.stand_ins).find_faults(section)
    if faults or section is None:
        raise refuse(faults)
    return Scene(
        functions=section.functions,
        derivatives=section.derivatives,
        locked=tuple(section.locked.items()),
        parameters=tuple(section.parameters.items()),
        sensors=section.sensors,
        wrenches=section.wrenches,
        gravity=section.gravity,
        motion=section.motion,
        results=tuple(section.results.items()),
        together=tuple(section.together.items()),
        tolerance=section.tolerance,
    )


def stage(model: Model, scene: Scene) -> Model:
    """Remove parts of a model that a scene does not need; with locked joints, also forces on bodies at rest.

    The rough coordinates of locked joints go, too, and so do equations between them that hold.
    """
    kept = lock(apply_kinds(model, scene), dict(scene.locked))
    carriers = find_carriers(kept)
    felt = [w for w in kept.wrenches if carriers[w.body] != carriers[BASE if w.against is None else w.against.body]]
    wrenches = tuple(w for w in felt if scene.wrenches is None or w.name in scene.wrenches)
    forces = tuple(x for x in kept.forces if len({carriers[body] for body in x.bodies}) > 1)
    contacts = tuple(x for x in kept.contacts if carriers[x.body] != carriers[x.other.body])
    bodies = keep_slips(kept.bodies, contacts)
    kept = replace(kept, bodies=bodies, wrenches=wrenches, forces=forces, contacts=contacts)
    kept = replace(kept, stops=tuple(x for x in kept.stops if find_moving(x.quantity, kept, carriers)))
    return replace(
        kept,
        gravity=kept.gravity if scene.gravity else ORIGIN,
        frames=tuple(_select_frames(kept, scene.sensors)),
    )


def _select_frames(model: Model, sensors: Sequence[str] | None) -> Iterator[Frame]:
    """Keep the sensors that a scene names, and, not as sensors, the frames that forces read."""
    read = find_read_frames(model)
    for frame in model.frames:
        is_sensor = frame.is_sensor and (sensors is None or frame.name in sensors)
        if is_sensor or frame.name in read:
            yield replace(frame, is_sensor=is_sensor)


def apply_kinds(model: Model, scene: Scene) -> Model:
    """Return a model whose parameters have the kinds that a scene chooses."""
    kinds = dict(scene.parameters)
    return replace(model, parameters=tuple(replace(p, kind=kinds.get(p.name, p.kind)) for p in model.parameters))


@dataclass(frozen=True)
class _Judgement:
    """Compares a scene with its model."""

    document: Document
    model: Model
    functions: Mapping[str, Sequence[str]]
    doubtful: frozenset[Place]

    def find_faults(self, section: SceneSection) -> list[Fault]:
        found = (*self._check_names(section), *self._check_locked(section), *self._check_together(section))
        return [fault for place, fault in found if place not in self.doubtful]

    def _check_names(self, section: SceneSection) -> Iterator[tuple[Place, Fault]]:
        steps = [step for i, body in enumerate(self.model.bodies) for step in list_steps(i, body)]
        joints, loose = [x.name for x in steps], [x.name for x in steps if x.joint.floats]
        lists: tuple[tuple[str, str, Sequence[str] | None, Sequence[str]], ...] = (
            ("functions", "function", section.functions, [*self.functions, QUICKEST]),
            ("sensors", "frame", section.sensors, [f.name for f in self.model.frames if f.is_sensor]),
            ("wrenches", "wrench", section.wrenches, [w.name for w in self.model.wrenches]),
        )
        for key, kind, given, known in lists:
            for k, name in enumerate(given or ()):
                yield from self._find((key, k), kind, name, known)
        for name in section.locked:
            if name in loose:
                finding = f"{abbreviate(name)} is part of a joint with a quaternion, which cannot be locked"
                yield self._tell(("locked", name), finding, "leave it out, or make the body fixed in the model")
            yield from self._find(("locked", name), "joint", name, joints)
        for name in section.parameters:
            yield from self._find(("parameters", name), "parameter", name, [p.name for p in self.model.parameters])
        for name, results in section.results.items():
            yield from self._find(("results", name), "function", name, list(self.functions))
            if not results:
                yield self._tell(("results", name), "no result is named", "name one, or leave the function out")
            for k, result in enumerate(results if name in self.functions else ()):
                yield from self._find(("results", name, k), "result", result, self.functions[name])

    def _check_locked(self, section: SceneSection) -> Iterator[tuple[Place, Fault]]:
        steps = list_joints(self.model)
        for step in steps:
            if step.joint.follows is not None and step.name in section.locked:
                finding = f"{abbreviate(step.name)} follows {abbreviate(step.joint.follows.joint)}"
                yield self._tell(("locked", step.name), finding, "lock that joint, and this one is where it is then")
        if {step.name for step in steps if step.joint.follows is None} <= set(section.locked):
            yield self._tell(("locked",), "no joint is left that moves", "leave one out")
        known = {p.name for p in self.model.parameters}
        for name, expression in section.locked.items():
            if strange := sorted(names(expression) - known):
                finding = f"the place of a locked joint depends on {', '.join(map(abbreviate, strange))}"
                yield self._tell(("locked", name), finding, "use numbers and parameters of the model")

    def _check_together(self, section: SceneSection) -> Iterator[tuple[Place, Fault]]:
        for name, parts in section.together.items():
            place: Place = ("together", name)
            if not NAME.fullmatch(name) or name in (*self.functions, *TAKEN) or name.startswith(RESERVED):
                remedy = "give small letters, digits and _, at most 31, and no name of a function or of its derivatives"
                yield self._tell(place, f"{abbreviate(name)} cannot be the name of a function", remedy)
            if len(parts) < 2 or len(set(parts)) < len(parts):
                yield self._tell(place, f"found {abbreviate(list(parts))}", "give two functions or more, each once")
            for k, part in enumerate(parts):
                yield from self._find((*place, k), "function", part, list(self.functions))
            results = [result for part in parts if part in self.functions for result in self.functions[part]]
            for result in sorted({r for r in results if results.count(r) > 1}):
                yield self._tell(place, f"more than one of them has a result {result}", "leave all but one out")

    def _find(self, place: Place, kind: str, name: str, known: Sequence[str]) -> Iterator[tuple[Place, Fault]]:
        if name in known:
            return
        meant = nearest(name, known)
        remedy = f"did you mean `{meant}`?" if meant else f"there are {', '.join(known) or 'none'}"
        yield self._tell(place, f"no {kind} {abbreviate(name)}", remedy)

    def _tell(self, place: Place, finding: str, remedy: str) -> tuple[Place, Fault]:
        return place, self.document.fault(place, finding, remedy)
