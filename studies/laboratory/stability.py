"""Where the formulations of a model hold: near its worst pose, at ratios of masses, and at steps of a simulation.

    poses    the pose with the worst condition that a search finds, and poses at a distance from it [rad, m]
    masses   a body at an end of the tree, with its inertia, times a factor
    steps    a motion from a drawn pose, by methods with fixed steps [s]

Errors of kernels are relative to the largest result, against 50 digits. Errors of motions are of the end [rad, m;
rad/s, m/s]. A kernel that gives up returns a status. With closed loops or quaternions, poses are drawn ones, from the
best condition to the worst.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from mbsgen.documents import Data, read_document
from mbsgen.errors import InputError
from mbsrun.closure import has_loops
from mbsrun.kernel import find_place
from mbsrun.measuring import motions
from mbsrun.measuring.candidates import add_hidden, compile_kernel
from mbsrun.measuring.fronts import write_error
from mbsrun.measuring.functions import Variant
from mbsrun.measuring.kernels import ACCELERATIONS, RESIDUAL, KernelScope, KernelTask
from mbsrun.measuring.mechanisms import Subject, draw_states, list_ranges
from mbsrun.measuring.points import MotionPoint
from mbsrun.measuring.store import Store
from mbsrun.models import Extent
from mbsrun.simulation.course import is_constrained
from mbsrun.simulation.integration.methods import Formulation
from studies.laboratory.case import Report

Array = NDArray[np.float64]
States = dict[str, Array]

POSES, MASSES, STEPS = "distance from the worst pose [rad, m]", "mass of {body}, times", "step of a motion [s]"
DISTANCES = (*(10.0**-k for k in range(0, 13, 2)), 0.0)
FACTORS = tuple(10.0**k for k in (-9, -6, -3, 0, 3, 6, 9, 12))
WAYS = {"IMPL": ("impl", RESIDUAL), "SEMI": ("semi_res", RESIDUAL)} | {
    name: (name.lower(), ACCELERATIONS) for name in ("EXP1", "EXP2")
}
EXTENT = Extent(("impl", "semi", "semi_res", "exp1", "exp2"), 0, optional=("loops", "loop_rates", "loop_jacobian"))
TRIED, STARTS, TURNS = 300, 4, 400  # poses that are drawn, from which a search starts, and its evaluations
JUDGED = 3  # states of one number
ENDS = 2  # bodies whose mass varies
SILENT = 1e-3  # a larger error without a status is a silent one
FAMILIES: tuple[tuple[str, Formulation], ...] = (
    *(("rk4", formulation) for formulation in Formulation),
    ("gauss", Formulation.IMPL),
    ("radau-iia", Formulation.IMPL),
)
SCOPE = motions.MotionScope(FAMILIES, (1, 4, 16), (1, 4, 16, 64, 256), (), 1, seconds=40.0)


@dataclass(frozen=True)
class Spot:
    """A formulation, or a method on one, at one number of a sweep."""

    sweep: str
    number: float
    way: str
    error: float | None  # the largest over the states; None: a status in some state, or no end
    status: str = ""  # where it gave up

    @property
    def digits(self) -> int | None:
        """Return the digits that are right; None with a status."""
        if self.error is None:
            return None
        return 16 if self.error == 0 else max(0, min(16, math.floor(-math.log10(self.error))))

    @property
    def is_silent(self) -> bool:
        """Return whether fewer than three digits are right without a status."""
        return self.error is not None and self.error > SILENT


def measure_stability(model: Path, folder: Path, report: Report, *, quick: bool = False) -> list[Spot]:
    """Measure all sweeps; earlier measurements are read from the folder. Raises InputError for a model with faults."""
    store = Store(folder / "stability.jsonl", Spot)
    subject = Subject(model, EXTENT)
    report("poses", 0, 3)
    spots = _keep(store, subject, "poses", lambda: list(_vary_poses(subject, quick=quick)))
    report("masses", 1, 3)
    for body, changed in _list_masses(model, folder / "models", quick=quick):
        for factor, path in changed:
            spots += _vary_mass(body, factor, Subject(path, EXTENT), store)
    report("steps", 2, 3)
    return [*spots, *_vary_steps(model, folder, quick=quick)]


def describe_stability(spots: Sequence[Spot]) -> list[str]:
    """State for each sweep where each way holds, in one sentence; ways that agree share it."""
    sentences = []
    for sweep in dict.fromkeys(spot.sweep for spot in spots):
        own = [spot for spot in spots if spot.sweep == sweep]
        told: dict[str, list[str]] = {}
        for way in dict.fromkeys(spot.way for spot in own):
            text = _tell([spot for spot in own if spot.way == way], is_motion=sweep == STEPS)
            told.setdefault(text, []).append(way)
        sentences += [f"{sweep}: {', '.join(ways)}: {text}" for text, ways in told.items()]
    return sentences


def _tell(spots: Sequence[Spot], *, is_motion: bool) -> str:
    known = [spot for spot in spots if spot.error is not None]
    lost = [write_error(spot.number) for spot in spots if spot.error is None]
    parts = [f"gives up at {', '.join(lost)}"] if lost else []
    if not known:
        return parts[0]
    worst, best = max(known, key=_rate), min(known, key=_rate)
    if is_motion:
        errors = [f"an error of {write_error(_rate(x))} at {write_error(x.number)}" for x in (best, worst)]
        return "; ".join([" to ".join(errors), *parts])
    silent = ", without a status" if worst.is_silent else ""
    where = "" if worst.digits == best.digits else f" or more, the fewest at {write_error(worst.number)}{silent}"
    return "; ".join([f"{worst.digits} right digits{where}", *parts])


def _rate(spot: Spot) -> float:
    return spot.error or 0.0


def _keep(store: Store[Spot], subject: Subject, sweep: str, measure: Callable[[], list[Spot]]) -> list[Spot]:
    manifest = subject.manifest
    return store.find_or_measure(("stability", manifest.generator, manifest.model_hash, sweep, JUDGED), measure)


def _vary_poses(subject: Subject, *, quick: bool) -> Iterator[Spot]:
    """Approach the worst pose of a tree on a line from the best drawn one; else order drawn poses by condition."""
    manifest = subject.manifest
    drawn = draw_states(subject.kernels, TRIED)
    conditions = _find_conditions(subject, drawn)
    order = np.argsort(conditions)
    few = {name: values[:JUDGED] for name, values in drawn.items()}
    if has_loops(manifest) or manifest.quaternions or manifest.driven:
        for share in (0.0, 0.5, 1.0):
            k = int(order[round(share * (len(order) - 1))])
            states = {name: values[k : k + 1] for name, values in drawn.items()}
            yield from _judge(subject, "drawn poses, condition", float(conditions[k]), states)
        return
    best = drawn["q"][order[0]]
    worst = _search_worst(subject, few, [drawn["q"][k] for k in order[::-1][:STARTS]])
    way = (best - worst) / max(float(np.abs(best - worst).max()), 1e-3)
    for distance in (*DISTANCES[:-1:3], 0.0) if quick else DISTANCES:
        states = {**few, "q": np.tile(worst + distance * way, (JUDGED, 1))}
        yield from _judge(subject, POSES, distance, states)


def _find_conditions(subject: Subject, states: States) -> Array:
    """Compute the condition of M, scaled to a diagonal of ones, in each state; infinity where M is not a number."""
    found = compile_kernel(subject, "semi", Variant()).evaluate(add_hidden(subject, states))[1]
    return np.array([_scale_condition(x["M"]) if x else math.inf for x in found])


def _scale_condition(M: Array) -> float:
    with np.errstate(all="ignore"):
        root = np.sqrt(np.abs(np.diag(M)))
        scaled = M / np.outer(root, root)
    return float(np.linalg.cond(scaled)) if np.isfinite(scaled).all() else math.inf


def _search_worst(subject: Subject, states: States, starts: Sequence[Array]) -> Array:
    """Search for the pose with the worst condition, within the limits of the joints."""
    lower, upper = np.array(list_ranges(subject.manifest)).T

    def rate(q: Array) -> float:
        inside = np.clip(q, lower, upper)
        one = {name: values[:1] for name, values in states.items()} | {"q": inside[None]}
        condition = _find_conditions(subject, one)[0]
        return -math.log(min(condition, 1e30))

    found = [minimize(rate, q, method="Nelder-Mead", options={"maxfev": TURNS, "xatol": 1e-14}) for q in starts]
    best = min(found, key=lambda x: float(x.fun))
    return np.clip(np.asarray(best.x), lower, upper)


def _judge(subject: Subject, sweep: str, number: float, states: States) -> Iterator[Spot]:
    """Evaluate all formulations in the states of one number."""
    count = len(states["q"])
    scope = KernelScope((), (), 1, count)
    tasks = {task: KernelTask(subject, task, scope, states) for task in (RESIDUAL, ACCELERATIONS)}
    for way, (kernel, task) in WAYS.items():
        outcomes = tasks[task].judge_states(kernel)
        failed = next((status for status, error in outcomes if error is None), None)
        status = "" if failed is None else "not a number" if failed <= 0 else str(find_place(subject.manifest, failed))
        errors = [error for _, error in outcomes if error is not None]
        yield Spot(sweep, number, way, None if failed is not None else max(errors), status)


def _list_masses(model: Path, folder: Path, *, quick: bool) -> Iterator[tuple[str, list[tuple[float, Path]]]]:
    """Yield bodies at ends of the tree, with model files in which their masses are multiplied."""
    data = read_document(model).data
    bodies = data.get("bodies") if isinstance(data, dict) else None
    if not isinstance(data, dict) or not isinstance(bodies, list):
        return
    parents = {body.get("parent") for body in bodies if isinstance(body, dict)}
    ends = [body for body in bodies if isinstance(body, dict) and body.get("mass") and body.get("name") not in parents]
    for body in ends[-1:] if quick else ends[-ENDS:]:
        factors = FACTORS[::3] if quick else FACTORS
        yield str(body.get("name")), [(x, _write(_weigh(data, bodies, body, x), folder)) for x in factors]


def _weigh(data: Mapping[str, Data], bodies: Sequence[Data], body: Mapping[str, Data], factor: float) -> Data:
    parts = {key: _multiply(body[key], factor) for key in ("mass", "inertia") if key in body}
    return {**data, "bodies": [{**body, **parts} if other is body else other for other in bodies]}


def _multiply(value: Data, factor: float) -> Data:
    """Multiply numbers and expressions; entries of a mapping or a list alike."""
    if isinstance(value, dict):
        return {key: _multiply(x, factor) for key, x in value.items()}
    if isinstance(value, list):
        return [_multiply(x, factor) for x in value]
    return value if value is None or isinstance(value, bool) else f"{factor!r}*({value})"


def _write(data: Data, folder: Path) -> Path:
    text = json.dumps(data, indent=1) + "\n"
    place = folder / f"{hashlib.sha256(text.encode()).hexdigest()[:16]}.yaml"
    folder.mkdir(parents=True, exist_ok=True)
    place.write_text(text, encoding="utf-8")
    return place


def _vary_mass(body: str, factor: float, subject: Subject, store: Store[Spot]) -> list[Spot]:
    sweep = MASSES.format(body=body)
    try:
        states = draw_states(subject.kernels, JUDGED)
    except InputError as error:  # a model whose body is too light is refused
        return [Spot(sweep, factor, way, None, error.faults[0].finding) for way in WAYS]
    return _keep(store, subject, f"{sweep} {factor!r}", lambda: list(_judge(subject, sweep, factor, states)))


def _vary_steps(model: Path, folder: Path, *, quick: bool) -> list[Spot]:
    """Integrate a motion from a drawn pose with several steps."""
    course = motions.read_course(model, None, 1.0)
    try:
        standard = motions.find_standard(course)
    except motions.NoReferenceError:
        return []
    store = Store(folder / "simulation.jsonl", MotionPoint)
    families = FAMILIES if is_constrained(course.mechanism.manifest) else FAMILIES[:-1]
    scope = replace(SCOPE, families=families)
    scope = replace(scope, families=families[3:], divisions=(1, 16), shorter=(1, 64)) if quick else scope
    points = motions.measure_motions(course, standard, scope, store, lambda *_: None)
    return [Spot(STEPS, p.value, f"{p.method} on {p.formulation.upper()}", p.error, p.finding) for p in points]
