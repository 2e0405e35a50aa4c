"""Recordings for tests: motions of a few harmonics, with the torques that they take and white noise."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mbsrun.external import Mechanism, load
from mbsrun.identification.identify import EXTENT, Task, prepare, solve
from mbsrun.identification.reading import read_samples
from mbsrun.identification.settings import Settings
from mbsrun.identification.structure import find_structure
from mbsrun.identification.unknowns import list_unknowns
from mbsrun.models import read_numbers
from mbsrun.recordings import Recording
from mbsrun.recordings.recording import Column

Array = NDArray[np.float64]

ROOT = Path(__file__).parents[3]
TWO_LINK = ROOT / "models" / "recorded" / "two_link.yaml"
PANDA = ROOT / "benchmarks" / "models" / "panda.yaml"


def open_model(path: Path) -> Mechanism:
    """Load the kernels that an identification uses."""
    return load(path, extent=EXTENT)


def swing(joints: int, t: Array, seed: int, size: float = 0.5, harmonics: int = 5) -> tuple[Array, Array, Array]:
    """Return q, qd and qdd, (K, joints) each, of a period of 10 s."""
    rng, motion = np.random.default_rng(seed), np.zeros((3, t.size, joints))
    for k in range(1, harmonics + 1):
        w = 2 * np.pi * k / 10
        for a, wave in zip(rng.normal(size=(2, joints)) * size / np.sqrt(harmonics), (0.0, np.pi / 2), strict=True):
            motion[0] += a * np.sin(w * t + wave)[:, None]
            motion[1] += a * w * np.cos(w * t + wave)[:, None]
            motion[2] -= a * w**2 * np.sin(w * t + wave)[:, None]
    return motion[0], motion[1], motion[2]


def record(
    kernels: Mechanism,
    t: Array,
    motion: tuple[Array, Array, Array],
    noise: float,
    seed: int = 1,
    *,
    rates: bool = True,
    more: Array | float = 0.0,
    name: str = "made.csv",
) -> Recording:
    """Record a tree's motion with torques, `more` added, and noise relative to their root mean squares."""
    manifest, (q, qd, qdd) = kernels.manifest, motion
    free = np.zeros((t.size, len(manifest.actuated)))
    u = (np.asarray(kernels("impl", q=q, qd=qd, qdd=qdd, u=free)["Phi"]).reshape(qd.shape) + more)[:, manifest.actuated]
    u = u + noise * np.sqrt(np.mean(u**2, axis=0)) * np.random.default_rng(seed).standard_normal(u.shape)
    names = [c.name for c in manifest.coordinates]
    columns = [f"q[{x}]" for x in manifest.positions]
    columns += [f"{kind}[{x}]" for kind in ("qd", "qdd") for x in names] if rates else []
    columns += [f"u[{names[i]}]" for i in manifest.actuated]
    values = np.hstack((q, qd, qdd, u) if rates else (q, u))
    return Recording(name, t, tuple(map(Column, columns)), values)


@dataclass(frozen=True)
class Inside:
    """The part of recordings of which the truth lies in regions of 95 %."""

    ellipsoids: float  # of all base parameters together
    intervals: float  # of each


def count_inside(path: Path, motion: tuple[Array, Array, Array], noise: float, seeds: Iterable[int]) -> Inside:
    """Identify recordings of a motion of 10 s with different noise, and count."""
    from scipy.stats import chi2

    kernels, settings, numbers = open_model(path), Settings(), read_numbers(path, {})
    unknowns = list_unknowns(kernels.manifest, numbers, settings)
    setting = prepare(kernels, numbers, settings)
    structure, t = find_structure(setting, unknowns), np.linspace(0, 10, len(motion[0]))
    inside, single = list[bool](), list[bool]()
    for seed in seeds:
        made = record(kernels, t, motion, noise, seed)
        samples = read_samples(made, made, kernels, settings, ())
        found = solve(Task(setting, settings, unknowns, structure, (samples,)))
        d = np.array([x.value - x.before for x in found.base])
        inside.append(bool(d @ np.linalg.solve(found.covariance, d) < chi2.ppf(0.95, len(d))))
        single += [x.low < x.before < x.high for x in found.base]
    return Inside(float(np.mean(inside)), float(np.mean(single)))
