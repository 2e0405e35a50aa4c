"""Identification: a model file and recordings of motions with torques -> base parameters, bodies, residuals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsrun.external import Mechanism, load
from mbsrun.identification.equations import Samples, Setting, write_rows
from mbsrun.identification.estimation import Estimate, Part, compress, estimate, validate
from mbsrun.identification.physical import find_bodies
from mbsrun.identification.reading import read_samples
from mbsrun.identification.result import Base, Identification, Torque, Trace
from mbsrun.identification.settings import DEFAULT, ENCODER, FALL, LOSSES, IdentificationError, Settings
from mbsrun.identification.structure import Structure, find_structure
from mbsrun.identification.unknowns import FALLS, PARAMETER, Unknown, list_speeds, list_unknowns
from mbsrun.models import Extent, is_model, read_numbers
from mbsrun.recordings import Recording, read_recording
from mbsrun.recordings.splines import low_pass
from mbsrun.smoothness import demand_smooth

Array = NDArray[np.float64]
Report = Callable[[str, int, int], None]

LOOPS = ("rates", "loops", "loop_rates", "loop_jacobian", "loop_forces")
EXTENT = Extent(("impl", "frames", "regressor"), 1, optional=LOOPS)
STEP = 1e-6  # of central differences by nonlinear unknowns, relative to their sizes
ITERATIONS = 40  # of Gauss and Newton
SETTLED = 1e-9  # decrease of the sum of squares at which they end, relative
SHORTEST = 1e-4  # part of a step
FILTERED = 2.0  # samples in a period of a filter's cut-off, which are kept
SCALE = 1e-9  # of the equations, beyond which they hold where all unknown numbers are 0: forces have no scale then


def say_nothing(_: str, __: int, ___: int) -> None:
    """Ignore the progress."""


def identify(
    model: str | Path,
    recordings: Sequence[str | Path | Recording],
    settings: Settings = DEFAULT,
    *,
    torques: Sequence[str | Path | Recording] = (),
    report: Report = say_nothing,
) -> Identification:
    """Identify numbers of a model file from recordings of coordinates [rad, m] and torques [N m, N].

    `torques` are recordings of the torques alone, one for each recording, where these lack them. Raises InputError for
    files with faults, IdentificationError where nothing can be identified.
    """
    path = Path(model)
    _check(path, recordings, torques, settings)
    report("generating the regressor", 0, 3)
    mechanism = load(path, extent=EXTENT)
    demand_smooth(mechanism.manifest, "an identification", stops=False)
    if settings.parameters:
        mechanism = mechanism.with_parameters(**settings.parameters)
    numbers = read_numbers(path, settings.parameters)
    unknowns = list_unknowns(mechanism.manifest, numbers, settings)
    setting = prepare(mechanism, numbers, settings)
    structure = find_structure(setting, unknowns)
    report("reading recordings", 1, 3)
    read = [x if isinstance(x, Recording) else read_recording(Path(x)) for x in recordings]
    others = [x if isinstance(x, Recording) else read_recording(Path(x)) for x in torques] or read
    pairs = zip(read, others, strict=True)
    samples = [read_samples(x, y, mechanism, settings, setting.unmeasured) for x, y in pairs]
    report("estimating", 2, 3)
    return solve(Task(setting, settings, unknowns, structure, tuple(samples)))


def prepare(mechanism: Mechanism, numbers: Any, settings: Settings) -> Setting:
    """Return the mechanism as the equations need it."""
    manifest = mechanism.manifest
    names = [c.name for c in manifest.coordinates]
    hidden = tuple(i for i, name in enumerate(names) if name in settings.unmeasured)
    return Setting(mechanism, list_speeds(manifest, numbers, settings), hidden)


def _check(path: Path, recordings: Sequence[object], torques: Sequence[object], settings: Settings) -> None:
    if not is_model(path):
        determined = f"{path}: it holds code; an identification reads the inertias and frictions of a model file"
        raise IdentificationError(f"{determined}; give the model file")
    if not recordings:
        raise IdentificationError("no recording is given; give one at least")
    if torques and len(torques) != len(recordings):
        determined = f"{len(torques)} recordings of torques for {len(recordings)} of motions"
        raise IdentificationError(f"{determined}; give one for each")
    if settings.loss not in LOSSES:
        raise IdentificationError(f"no loss is named {settings.loss}; there are {', '.join(LOSSES)}")
    wrong = [f"noise of {name}" for name, x in settings.noise.items() if not x > 0]
    wrong += ["prior"] if settings.prior is not None and not settings.prior > 0 else []
    wrong += ["speed"] if not settings.speed > 0 else []
    if wrong:
        raise IdentificationError(f"{', '.join(wrong)} must be positive; give a number above 0")


@dataclass(frozen=True, eq=False)
class Task:
    """Everything that an estimate is made of."""

    setting: Setting
    settings: Settings
    unknowns: tuple[Unknown, ...]
    structure: Structure
    samples: tuple[Samples, ...]

    @property
    def nonlinear(self) -> tuple[Unknown, ...]:
        """List the unknowns by which the equations are not linear."""
        return tuple(x for x in self.unknowns if not x.is_linear)

    @property
    def given(self) -> dict[int, float]:
        """Return the known standard deviations, by row."""
        return {j: self.settings.noise[name] for j, name in enumerate(self.setting.rows) if name in self.settings.noise}


def solve(task: Task) -> Identification:
    """Estimate, and describe the result. Raises IdentificationError where nothing can be determined."""
    nonlinear = np.array([x.value for x in task.nonlinear])
    parts = _write_parts(task, nonlinear)
    _check_scale(task, parts)
    found = estimate(parts, task.given, task.settings.loss)
    if len(nonlinear):
        nonlinear, parts, found = _iterate(task, nonlinear, parts, found)
    if not found.determined:
        raise IdentificationError(
            "the recorded motion excites nothing: no torque in it depends on the unknown numbers; record a motion in "
            "which the joints move"
        )
    return _describe(task, nonlinear, parts, found)


def _check_scale(task: Task, parts: Sequence[Part]) -> None:
    """Refuse equations that numbers of 0 solve: without any known torque, mass or load, forces have no scale."""
    if any(samples.u.any() for samples in task.samples):
        return
    own = task.structure.evaluate(np.array([x.value for x in task.structure.unknowns]))
    left = np.concatenate([(part.A @ own + part.b).ravel() for part in parts])
    size = np.concatenate([part.b.ravel() for part in parts])
    if size.any() and np.linalg.norm(left) <= SCALE * np.linalg.norm(size):
        raise IdentificationError(
            "no torque is known and all forces are unknown, so recordings determine ratios alone; name the bodies "
            "whose inertia is unknown, give a motor's constant, or record a known load"
        )


# --- rows ---


def _write_parts(task: Task, nonlinear: Array) -> list[Part]:
    """Write the rows of all recordings, in parts for the cross validation; columns are base parameters."""
    parts: list[Part] = []
    pieces = 1 if len(task.samples) > 1 else max(1, task.settings.parts)
    for number, samples in enumerate(task.samples):
        A, b = _write(task, samples, nonlinear)
        known = np.isfinite(A).all(axis=(1, 2)) & np.isfinite(b).all(axis=1)
        A, b = A[known], b[known]
        if task.settings.treatment.cutoff is not None:
            A, b = _filter(samples.t[known], A, b, task.settings.treatment.cutoff)
        parts += [Part(number, A[k], b[k]) for k in np.array_split(np.arange(len(A)), pieces) if len(k)]
    if not parts:
        raise IdentificationError("at all recorded poses, torques do not determine the motion; record other ones")
    return parts


def _write(task: Task, samples: Samples, nonlinear: Array) -> tuple[Array, Array]:
    setting, moved, falls = _apply(task, samples, nonlinear)
    A, b = write_rows(setting, moved, task.structure.unknowns, falls)
    return A[:, :, list(task.structure.kept)], b


def _apply(task: Task, samples: Samples, nonlinear: Array) -> tuple[Setting, Samples, Array]:
    """Return mechanism, motion and speeds of the Stribeck effect with values of the nonlinear unknowns."""
    setting, manifest = task.setting, task.setting.manifest
    falls, q = np.full(len(manifest.coordinates), FALL), samples.q
    parameters: dict[str, float] = {}
    for x, value in zip(task.nonlinear, nonlinear.tolist(), strict=True):
        if x.kind == FALLS:
            falls[x.joint] = value
        elif x.kind == PARAMETER:
            parameters[x.owner] = value
        elif x.kind == ENCODER:
            q = q.copy()
            q[:, manifest.positions.index(x.owner)] -= value
    if parameters:
        setting = replace(setting, kernels=setting.kernels.with_parameters(**parameters))
    return setting, replace(samples, q=q), falls


def _filter(t: Array, A: Array, b: Array, cutoff: float) -> tuple[Array, Array]:
    """Filter rows as the coordinates, and keep as many as are independent then; the ends are left out."""
    step = float(np.median(np.diff(t)))
    every = max(1, int(1 / (FILTERED * cutoff * step)))
    end = int(1 / (cutoff * step)) + 1
    rows = np.concatenate((A.reshape(len(A), -1), b), axis=1)
    kept = low_pass(t, rows, cutoff)[end : len(t) - end : every]
    size = A.shape[1] * A.shape[2]
    return kept[:, :size].reshape(-1, *A.shape[1:]), kept[:, size:]


# --- nonlinear unknowns ---


def _iterate(task: Task, start: Array, parts: list[Part], first: Estimate) -> tuple[Array, list[Part], Estimate]:
    """Find the nonlinear unknowns by Gauss and Newton; the others follow by least squares at each step."""
    nonlinear, found = start, first
    cost = _measure(parts, found, first.sigma)
    for _ in range(ITERATIONS):
        wide = _add_slopes(task, nonlinear, parts, found)
        step = estimate(wide, dict(enumerate(found.sigma.tolist()))).x[len(found.x) :]
        length, better = 1.0, None
        while length > SHORTEST and better is None:
            tried = _limit(task, nonlinear + length * step)
            rows = _write_parts(task, tried)
            own = estimate(rows, dict(enumerate(first.sigma.tolist())), task.settings.loss)
            if (reached := _measure(rows, own, first.sigma)) < cost:
                better = tried, rows, own, reached
            length /= 2
        if better is None:
            break
        before = cost
        nonlinear, parts, found, cost = better
        if before - cost < SETTLED * before:
            break
    found = estimate(parts, task.given, task.settings.loss)
    return nonlinear, parts, _widen(task, nonlinear, parts, found)


def _limit(task: Task, values: Array) -> Array:
    """Keep speeds positive."""
    lowest = np.array([0.02 * FALL if x.kind == FALLS else -np.inf for x in task.nonlinear])
    return np.asarray(np.maximum(values, lowest))


def _measure(parts: Sequence[Part], found: Estimate, sigma: Array) -> float:
    return float(sum((((part.A @ found.x - part.b) / sigma) ** 2).sum() for part in parts))


def _add_slopes(task: Task, nonlinear: Array, parts: Sequence[Part], found: Estimate) -> list[Part]:
    """Add the derivatives of the residuals by the nonlinear unknowns as columns; b is what remains."""
    columns = []
    for k, x in enumerate(task.nonlinear):
        h = STEP * max(1.0, abs(nonlinear[k])) if x.kind != FALLS else STEP * nonlinear[k]
        ends = []
        for sign in (1, -1):
            moved = nonlinear.copy()
            moved[k] += sign * h
            ends.append([part.A @ found.x - part.b for part in _write_parts(task, moved)])
        columns.append([(a - b) / (2 * h) for a, b in zip(*ends, strict=True)])
    return [
        Part(
            part.recording,
            np.concatenate((part.A, np.stack([column[i] for column in columns], axis=2)), axis=2),
            part.b - part.A @ found.x,
        )
        for i, part in enumerate(parts)
    ]


def _widen(task: Task, nonlinear: Array, parts: Sequence[Part], found: Estimate) -> Estimate:
    """Return the estimate with the uncertainty of the nonlinear unknowns, which are its last entries."""
    sigma = dict(enumerate(found.sigma.tolist()))
    wide = estimate(_add_slopes(task, nonlinear, parts, found), sigma, task.settings.loss)
    x = np.concatenate((found.x, nonlinear))
    return replace(wide, x=x, sigma=found.sigma, correlation=found.correlation)


# --- the result ---


def _describe(task: Task, nonlinear: Array, parts: Sequence[Part], found: Estimate) -> Identification:
    structure, size = task.structure, len(task.structure.kept)
    unknowns = (*structure.unknowns, *task.nonlinear)
    G = np.zeros((size + len(nonlinear), len(unknowns)))
    G[:size, : len(structure.unknowns)] = structure.G
    G[size:, len(structure.unknowns) :] = np.eye(len(nonlinear))
    x0 = np.array([x.value for x in unknowns])
    before = G @ x0
    beta = np.concatenate((before[:size] + found.x[:size], nonlinear))
    settings = task.settings
    bodies = find_bodies(unknowns, G, x0, beta, found.covariance, settings.prior, free=settings.unphysical)
    deviations = np.sqrt(np.diag(found.covariance))
    names = (*structure.names, *(x.name for x in task.nonlinear))
    kept = (*(structure.unknowns[k] for k in structure.kept), *task.nonlinear)
    base = _list_base(names, [x.unit for x in kept], beta, before, deviations, found)
    linear = replace(found, x=found.x[:size])
    torques, groups, validation = _judge(task, parts, linear)
    return Identification(
        model=task.setting.manifest.model,
        base=base,
        correlations=_correlate(found.covariance),
        covariance=found.covariance,
        unfelt=structure.unfelt,
        undetermined=tuple(x.name for x in base if not x.is_determined),
        unknowns=unknowns,
        values=bodies.x,
        G=G,
        torques=torques,
        groups=groups,
        validation=validation,
        traces=tuple(_trace(task, nonlinear, samples, linear) for samples in task.samples),
        condition=_find_condition(parts, linear),
        distance=bodies.distance,
        is_moved=bodies.is_moved,
        freedom=found.freedom,
        speeds=dict(
            zip((c.name for c in task.setting.manifest.coordinates), task.setting.speeds.tolist(), strict=True)
        ),
        parameters={x.owner: float(v) for x, v in zip(task.nonlinear, nonlinear, strict=True) if x.kind == PARAMETER},
    )


def _list_base(
    names: Sequence[str], units: Sequence[str], beta: Array, before: Array, deviations: Array, found: Estimate
) -> tuple[Base, ...]:
    from scipy.stats import t as student  # takes long to load

    far = float(student.ppf(0.975, max(found.freedom, 1)))
    determined = set(found.determined)
    rows = zip(names, units, beta.tolist(), before.tolist(), deviations.tolist(), strict=True)
    return tuple(
        Base(name, unit, value, own, s, value - far * s, value + far * s)
        if k in determined
        else Base(name, unit, own, own, np.nan, np.nan, np.nan)
        for k, (name, unit, value, own, s) in enumerate(rows)
    )


def _correlate(covariance: Array) -> Array:
    sizes = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(covariance / np.outer(sizes, sizes))


def _judge(task: Task, parts: Sequence[Part], found: Estimate) -> tuple[tuple[Torque, ...], tuple[str, ...], Array]:
    """Describe the residuals of each row, and validate by leaving recordings out, or parts of the only one."""
    compressed = compress(parts)
    is_single = len(task.samples) == 1
    groups = list(range(len(parts))) if is_single else [part.recording for part in parts]
    present = list(dict.fromkeys(groups))
    names = [f"part {k + 1}" if is_single else task.samples[k].name for k in present]
    out, _ = validate(compressed, groups, task.given)
    counts = np.array([sum(len(p.A) for p, own in zip(parts, groups, strict=True) if own == k) for k in present])
    total = np.sqrt((out**2 * counts[:, None]).sum(axis=0) / counts.sum())
    if len(names) < 2:
        out, total = out * np.nan, total * np.nan
    own = np.sqrt(compressed.measure(found.x).sum(axis=0) / compressed.counts.sum(axis=0))
    before = np.sqrt(compressed.measure(np.zeros(len(found.x))).sum(axis=0) / compressed.counts.sum(axis=0))
    coordinates = {c.name: c for c in task.setting.manifest.coordinates}
    sizes = _find_sizes(task)
    torques = tuple(
        Torque(name, coordinates[name].force_unit, sizes[name], *numbers)
        for name, numbers in zip(
            task.setting.rows, np.stack((before, own, found.correlation, total), axis=1).tolist(), strict=True
        )
    )
    return torques, tuple(names), out


def _find_sizes(task: Task) -> dict[str, float]:
    """Return the root mean squares of measured torques, by joint; 0 of joints without one."""
    manifest = task.setting.manifest
    u = np.concatenate([samples.u for samples in task.samples])
    found = dict.fromkeys((c.name for c in manifest.coordinates), 0.0)
    for k, i in enumerate(manifest.actuated):
        found[manifest.coordinates[i].name] = float(np.sqrt(np.mean(u[:, k] ** 2)))
    return found


def _trace(task: Task, nonlinear: Array, samples: Samples, found: Estimate) -> Trace:
    """Return measured torques, and the ones that the found numbers give; of other rows, 0 and what is left."""
    A, b = _write(task, samples, nonlinear)
    manifest = task.setting.manifest
    places = {manifest.coordinates[i].name: k for k, i in enumerate(manifest.actuated)}
    zero = np.zeros(len(samples.t))
    columns = [samples.u[:, places[name]] if name in places else zero for name in task.setting.rows]
    measured = np.stack(columns, axis=1)
    return Trace(samples.name, samples.t, measured, measured + A @ found.x - b, samples.left_out)


def _find_condition(parts: Sequence[Part], found: Estimate) -> float:
    """Return the condition of the weighted columns, each of length 1."""
    R = (compress(parts).R / found.sigma[:, None, None]).reshape(-1, parts[0].A.shape[2] + 1)
    determined = [k for k in found.determined if k < parts[0].A.shape[2]]
    if not determined:
        return 1.0
    own = R[:, determined]
    values = np.linalg.svd(own / np.linalg.norm(own, axis=0), compute_uv=False)
    return float(values[0] / values[-1])
