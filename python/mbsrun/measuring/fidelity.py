"""Fidelity: the time that a reduction of a model saves in a kernel, against its error.

A reduction leaves something out: it locks joints (their bodies become one), or drops the mass of a body, forces of
joints, gravity, velocities, run-time parameters or sensors. Its kernels are compared with the kernels of the whole
model at random states, for the remaining joints and sensors:

    as supposed   locked joints stand at their locked place, and velocities that it drops are 0
    anywhere      any state

Either error is the largest over all states, relative to the largest entry of the result of the whole model.
"""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mbsgen.documents import Data, read_document
from mbsgen.errors import InputError, MbsError
from mbsgen.expressions import FLOATS, evaluate, parse
from mbsgen.manifest import Argument, Manifest
from mbsgen.roles import Axis
from mbsrun.forms import VALUES
from mbsrun.measuring.candidates import Candidate, add_hidden, compile_kernel
from mbsrun.measuring.functions import Variant
from mbsrun.measuring.mechanisms import CLOSING, Subject, draw_states
from mbsrun.measuring.points import Cost
from mbsrun.measuring.store import Store
from mbsrun.measuring.timing import Watch, measure_costs
from mbsrun.models import Extent

Array = NDArray[np.float64]
States = Mapping[str, Array]

KERNELS = (*VALUES, "sensors")
STATES = 256
FORCES = ("stiffness", "rest", "damping", "friction", "force")  # of a joint
PARTS = ("locked", "parameters", "gravity", "motion", "sensors", "wrenches", "tolerance")  # of scenes, for kernels
TOLERANCES = (1e-3, 1e-1)
WHOLE = "whole model"


@dataclass(frozen=True)
class FidelityPoint:
    """A kernel of a reduced model, beside the same kernel of the whole model."""

    mechanism: str
    reduction: str
    kernel: str
    flops: int | None  # None: there is no such kernel
    flops_whole: int
    ns: Cost | None
    ns_whole: Cost | None  # timed in turn with it
    error: float | None  # the largest at states that agree with the reduction
    error_anywhere: float | None
    states: int
    finding: str = ""  # the reason where numbers are missing


@dataclass(frozen=True)
class Reduction:
    """A reduction: by a change of the model file, or by a scene."""

    name: str
    model: Data  # the content of the reduced model file
    scene: Mapping[str, Data]


@dataclass(frozen=True)
class FidelityScope:
    """The amount of measurement."""

    rounds: int = 40
    judged: int = 64  # states for errors
    kernels: tuple[str, ...] = KERNELS
    seconds: float = math.inf  # no reduced model is generated later


QUICK = FidelityScope(3, 8, ("impl", "exp2", "sensors"))
FRONTS = FidelityScope(10, 16, ("impl", "exp2"), 30.0)


def list_reductions(model: Path, manifest: Manifest, scenes: Sequence[Path]) -> list[Reduction]:
    """List the reductions by scenes: each part of a scene, then the whole scene; without scenes, the usual reductions.

    Raises InputError for files that cannot be read, MbsError for a model that is not measured.
    """
    if manifest.configuration:
        raise MbsError(f"{manifest.model}: reductions of joints with quaternions are not measured")
    data = read_document(model).data
    if not scenes:
        return list(_list_usual(data, manifest))
    reductions = []
    for path in scenes:
        scene = read_document(path).data
        chosen = {key: value for key, value in scene.items() if key in PARTS} if isinstance(scene, dict) else {}
        parts = [Reduction(f"{path.stem}: {key}", data, {key: value}) for key, value in chosen.items()]
        reductions += [*(parts if len(parts) > 1 else []), Reduction(path.stem, data, chosen)]
    return reductions


def take_whole(model: Path, scope: FidelityScope) -> Subject:
    """Return the whole model, with the kernels that it can have. Raises InputError for an unreadable file."""
    data = read_document(model).data
    has_sensors = isinstance(data, dict) and bool(data.get("frames"))
    kernels = tuple(name for name in scope.kernels if name != "sensors" or has_sensors)
    return Subject(model, Extent(kernels, 0, optional=CLOSING[:3]))


def measure_fidelity(
    whole: Subject,
    reductions: Sequence[Reduction],
    folder: Path,
    scope: FidelityScope,
    report: Callable[[str, int, int], None],
) -> list[FidelityPoint]:
    """Measure all reductions, kernel by kernel; earlier measurements are read from the folder.

    Raises InputError for a model with faults.
    """
    store = Store(folder / "fidelity.jsonl", FidelityPoint)
    subjects: list[Subject | str] = []
    begin = time.monotonic()
    for done, reduction in enumerate(reductions):
        if time.monotonic() - begin > scope.seconds:
            break
        report(f"generating: {reduction.name}", done, len(reductions))
        subjects.append(_generate(reduction, whole.extent, folder / "models"))
    points: list[FidelityPoint] = []
    compiler = Variant().compiler()
    names, reductions = whole.extent.functions or (), reductions[: len(subjects)]
    for done, kernel in enumerate(names):
        report(f"measuring: {kernel}", done, len(names))
        about = (whole.manifest.generator, whole.manifest.model_hash, kernel, scope.rounds, scope.judged)
        facts = ("fidelity", *about, list(reductions), compiler.flags, compiler.macros)
        comparison = KernelComparison(whole, kernel, list(zip(reductions, subjects, strict=True)), scope)
        points += store.find_or_measure(facts, comparison.measure)
    return points


def _list_usual(data: Data, manifest: Manifest) -> Iterator[Reduction]:
    """Yield the reductions that apply to the model, one thing after the other."""
    bodies = data.get("bodies") if isinstance(data, dict) else None
    if not isinstance(data, dict) or not isinstance(bodies, list):
        return
    is_open = not (manifest.loops or manifest.driven)  # else other joints would move with a locked one
    if len(manifest.coordinates) > 1 and is_open:
        for c in manifest.coordinates:
            place = min(max(0.0, -np.inf if c.lower is None else c.lower), np.inf if c.upper is None else c.upper)
            yield Reduction(f"{c.name} locked", data, {"locked": {c.name: float(place)}})
    for k, body in enumerate(bodies):
        if isinstance(body, dict) and "mass" in body:
            light = {key: value for key, value in body.items() if key not in ("mass", "com", "inertia")}
            yield Reduction(
                f"{body.get('name')} without mass", {**data, "bodies": [*bodies[:k], light, *bodies[k + 1 :]]}, {}
            )
    loose = [_drop_forces(body) for body in bodies]
    if loose != bodies:
        yield Reduction("no forces of joints", {**data, "bodies": loose}, {})
    yield Reduction("no gravity", data, {"gravity": False})
    yield Reduction("no velocities", data, {"motion": False})
    if kinds := [p.name for p in (*manifest.parameters, *manifest.design)]:
        yield Reduction("constant parameters", data, {"parameters": dict.fromkeys(kinds, "constant")})
    sensors = [frame.name for frame in manifest.frames if frame.sensor]
    if len(sensors) > 1:
        yield from (Reduction(f"sensor {name} alone", data, {"sensors": [name]}) for name in sensors)
    if is_open:  # errors of other mechanisms are not estimated
        yield from (Reduction(f"tolerance {tolerance:g}", data, {"tolerance": tolerance}) for tolerance in TOLERANCES)


def _drop_forces(body: Data) -> Data:
    """Drop the forces of the joints of a body."""
    if isinstance(body, list):
        return [_drop_forces(x) for x in body]
    if not isinstance(body, dict):
        return body
    return {key: _drop_forces(value) for key, value in body.items() if key not in FORCES}


def _generate(reduction: Reduction, extent: Extent, folder: Path) -> Subject | str:
    """Generate the reduced model, or return the faults that prevent it."""
    text, chosen = json.dumps(reduction.model, indent=1), json.dumps(dict(reduction.scene), indent=1)
    place = folder / hashlib.sha256((text + chosen).encode()).hexdigest()[:16]
    place.mkdir(parents=True, exist_ok=True)
    model, scene = place / "model.yaml", place / "scene.yaml"
    model.write_text(text + "\n", encoding="utf-8")
    scene.write_text(chosen + "\n", encoding="utf-8")
    subject = Subject(model, replace(extent, scene=scene if reduction.scene else None))
    try:
        assert subject.manifest.coordinates, "a mechanism has joints"
    except InputError as error:
        return "; ".join(f"{fault.path}: {fault.finding}" for fault in error.faults)
    return subject


class KernelComparison:
    """Compares a kernel of the whole model with the same kernel of all reductions."""

    def __init__(
        self, whole: Subject, kernel: str, reduced: Sequence[tuple[Reduction, Subject | str]], scope: FidelityScope
    ) -> None:
        self.whole, self.kernel, self.reduced, self.scope = whole, kernel, reduced, scope
        self.states = draw_states(whole.kernels, STATES)

    def measure(self) -> list[FidelityPoint]:
        """Evaluate and compare all, then time all in turn."""
        candidate = compile_kernel(self.whole, self.kernel, Variant())
        good = candidate.evaluate(add_hidden(self.whole, self.states))[0] == 0
        self.states = {name: values[good] for name, values in self.states.items()}
        flops = self.whole.manifest.kernel(self.kernel).flops.paper
        first = FidelityPoint(
            self.whole.manifest.model, WHOLE, self.kernel, flops, flops, None, None, None, None, int(good.sum())
        )
        if not good.any():
            return [replace(first, finding="it fails in all states")]
        drafts = [self._judge(reduction, subject, first, candidate) for reduction, subject in self.reduced]
        watches = [Watch(candidate.code, candidate.code.lay(add_hidden(self.whole, self.states)))]
        watches += [watch for _, watch in drafts if watch is not None]
        costs = iter(measure_costs(watches, self.scope.rounds))
        whole = next(costs)
        points = [replace(first, ns=whole, ns_whole=whole)]
        for point, watch in drafts:
            points.append(replace(point, ns=None if watch is None else next(costs), ns_whole=whole))
        return points

    def _judge(
        self, reduction: Reduction, subject: Subject | str, first: FidelityPoint, whole: Candidate
    ) -> tuple[FidelityPoint, Watch | None]:
        point = replace(first, reduction=reduction.name, flops=None)
        if isinstance(subject, str):
            return replace(point, finding=subject), None
        if self.kernel not in {k.name for k in subject.manifest.kernels}:
            return replace(point, finding="the reduced model has no such kernel"), None
        candidate = compile_kernel(subject, self.kernel, Variant())
        judged = {name: values[: self.scope.judged] for name, values in self.states.items()}
        supposed = self._suppose(judged, reduction)
        errors = [self._compare(whole, candidate, subject, states) for states in (supposed, judged)]
        states = _reduce(self.states, self.whole.manifest, subject)
        statuses = candidate.evaluate(states)[0]
        point = replace(
            point,
            flops=subject.manifest.kernel(self.kernel).flops.paper,
            error=errors[0],
            error_anywhere=errors[1],
            finding="it fails in some states" if statuses.any() else "",
        )
        good = {name: values[statuses == 0] for name, values in states.items()}
        return point, Watch(candidate.code, candidate.code.lay(good)) if (statuses == 0).any() else None

    def _suppose(self, states: States, reduction: Reduction) -> dict[str, Array]:
        """Move states so that they agree with a reduction: joints at their locked place, velocities 0."""
        supposed = {name: values.copy() for name, values in states.items()}
        locked = reduction.scene.get("locked")
        for name, value in locked.items() if isinstance(locked, dict) else ():
            k = [c.name for c in self.whole.manifest.coordinates].index(name)
            supposed["q"][:, k] = evaluate(parse(str(value)), {}, FLOATS)
            supposed["qd"][:, k] = supposed["qdd"][:, k] = 0.0
        if reduction.scene.get("motion") is False:
            supposed["qd"][:] = 0.0
        return supposed

    def _compare(self, whole: Candidate, reduced: Candidate, subject: Subject, states: States) -> float | None:
        """Return the largest error over results and states; None where one of both kernels fails."""
        expected = whole.evaluate(add_hidden(self.whole, states))[1]
        found = reduced.evaluate(_reduce(states, self.whole.manifest, subject))[1]
        if not all(expected) or not all(found):
            return None
        worst = 0.0
        for result in self.whole.manifest.kernel(self.kernel).outputs:
            pairs = [
                (values[result.name], _pick(result, results[result.name], self.whole.manifest, subject.manifest))
                for values, results in zip(found, expected, strict=True)
            ]
            off = max(float(np.abs(a - b).max(initial=0.0)) for a, b in pairs)
            size = max(float(np.abs(b).max(initial=0.0)) for _, b in pairs)
            worst = max(worst, off / size if size else off)
        return worst


def _reduce(states: States, whole: Manifest, subject: Subject) -> dict[str, Array]:
    """Return the states of the reduced model: a selection from states of the whole model."""
    manifest = subject.manifest
    kept = _find([c.name for c in whole.coordinates], [c.name for c in manifest.coordinates])
    driven = [whole.coordinates[i].name for i in whole.actuated]
    reduced = {name: states[name][:, kept] for name in ("q", "qd", "qdd")}
    reduced["u"] = states["u"][:, _find(driven, [manifest.coordinates[i].name for i in manifest.actuated])]
    entries, left = (x.inputs[len(x.actuated) :] for x in (whole, manifest))
    reduced["w"] = states["w"][:, _find(entries, left)]
    for name, axis in (("lam", Axis.CONSTRAINTS), ("tau", Axis.DRIVEN), ("a", Axis.DRIVEN)):
        if name in states:
            reduced[name] = states[name][:, _find(_name_entries(whole, axis), _name_entries(manifest, axis))]
    values = subject.kernels.parameters
    for name, given in (("p", manifest.parameters), ("theta", manifest.design)):
        reduced[name] = np.tile([values[p.name] for p in given], (len(states["q"]), 1))
    return add_hidden(subject, reduced)


def _pick(result: Argument, values: Array, whole: Manifest, reduced: Manifest) -> Array:
    """Return the rows and columns of a result that the reduced model also has."""
    for k, axis in enumerate((result.row_axis, result.col_axis)[: values.ndim]):
        if axis is not None:
            values = np.take(values, _find(*(_name_entries(x, axis) for x in (whole, reduced))), axis=k)
    return values


def _name_entries(manifest: Manifest, axis: Axis) -> list[str]:
    names = {
        Axis.VELOCITIES: [joint.name for joint in manifest.coordinates],
        Axis.SENSORS: [frame.name for frame in manifest.frames if frame.sensor],
        Axis.CONTACTS: list(manifest.contacts),
        Axis.CONSTRAINTS: list(manifest.equations),
        Axis.DRIVEN: [manifest.coordinates[i].name for i in manifest.driven],
    }
    return names[axis]


def _find(names: Sequence[str], wanted: Sequence[str]) -> list[int]:
    return [names.index(name) for name in wanted]
