"""Mechanisms to measure: a model of the user, and chains of any length."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mbsgen.errors import Fault, InputError
from mbsgen.manifest import Manifest
from mbsrun.closure import Closure, has_loops
from mbsrun.external import Mechanism
from mbsrun.kernel import Kernels
from mbsrun.models import Extent, find_folder
from mbsrun.quaternions import list_quaternions, normalise

Array = NDArray[np.float64]

AXES = "zyx"  # of a chain's joints, in turn
RANGES = {"qd": 3.0, "qdd": 10.0, "u": 20.0, "w": 10.0, "lam": 20.0, "tau": 20.0, "a": 10.0}  # drawn from [-x, x]
CLOSING = ("loops", "loop_rates", "loop_jacobian", "impl_red", "semi_red", "exp1_red")  # what loops are measured with


@dataclass(frozen=True)
class Subject:
    """A model file and its generated folder."""

    model: Path
    extent: Extent

    @cached_property
    def folder(self) -> Path:
        """Return the generated folder."""
        if self.model.is_dir():
            finding = "it is a folder; errors of kernels are measured against a model file"
            raise InputError([Fault(str(self.model), 0, "", finding, "give the model file")])
        return find_folder(self.model, self.extent)

    @cached_property
    def kernels(self) -> Mechanism:
        """Return the kernels."""
        return Mechanism(self.folder)

    @property
    def manifest(self) -> Manifest:
        """Return the description of the kernels."""
        return self.kernels.manifest


def write_chain(size: int, folder: Path) -> Path:
    """Write the model file of a chain of equal bodies: axes z, y, x in turn, links along x, full inertias."""
    lines = [f"name: chain{size}", "gravity: [0, 0, -9.81]", "bodies:"]
    for i in range(1, size + 1):
        place = ", position: [0.7, 0, 0]" if i > 1 else ""
        lines += [
            f"  - name: body{i}",
            *([f"    parent: body{i - 1}"] if i > 1 else []),
            f"    joint: {{name: q{i}, type: revolute, axis: {AXES[(i - 1) % 3]}{place}}}",
            "    mass: 1.3",
            "    com: [0.3, 0.1, 0.2]",
            "    inertia: {xx: 0.3, yy: 0.4, zz: 0.5, xy: 0.01, xz: 0.02, yz: 0.03}",
        ]
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"chain{size}.yaml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def draw_states(kernels: Kernels, count: int, seed: int = 1) -> dict[str, Array]:
    """Draw states: an array (count, size) for each input of a residual; u and w as well, parameters at their values.

    With closed loops, independent coordinates are drawn, or go as far to a drawn value as the loops can follow; all
    velocities and accelerations belong to the independent ones, which are `yd` and `ydd`. All numbers except the
    parameters and quaternions are exact in single precision, so that kernels of both precisions get the same; loops are
    closed to that precision. Quaternions have length 1, which few numbers in single precision do.
    """
    manifest = kernels.manifest
    rng = np.random.default_rng(seed)
    n = len(manifest.coordinates)
    sizes = {"qd": n, "qdd": n, "u": len(manifest.actuated), "w": manifest.open_entries}
    sizes |= {"lam": len(manifest.owners)} if manifest.owners else {}
    sizes |= {"tau": len(manifest.driven), "a": len(manifest.driven)} if manifest.driven else {}
    q = _draw_coordinates(manifest, rng, count)
    states = {"q": q} | {name: rng.uniform(-RANGES[name], RANGES[name], (count, k)) for name, k in sizes.items()}
    states = {name: values.astype(np.float32).astype(np.float64) for name, values in states.items()}
    states["q"] = normalise(states["q"], manifest)
    if has_loops(manifest):
        states |= _close(Closure(kernels), states)
    for name, given in (("p", manifest.parameters), ("theta", manifest.design)):
        states[name] = np.tile([kernels.parameters[p.name] for p in given], (count, 1))
    return states


def _draw_coordinates(manifest: Manifest, rng: np.random.Generator, count: int) -> Array:
    """Draw coordinates (count, nq); every direction of a quaternion is as likely."""
    if not manifest.configuration:
        return np.column_stack([rng.uniform(*_range(c.motion, c.lower, c.upper), count) for c in manifest.coordinates])
    known = {c.name: c for c in manifest.coordinates}
    turns = {i for x in list_quaternions(manifest) for i in x.entries}
    return np.column_stack(
        [
            rng.normal(size=count) if i in turns else rng.uniform(*_range(c.motion, c.lower, c.upper), count)
            for i, c in enumerate(known.get(name, manifest.coordinates[0]) for name in manifest.positions)
        ]
    )


def _close(closure: Closure, states: Mapping[str, Array]) -> dict[str, Array]:
    """Return closed states with the independent coordinates, velocities and accelerations of the given ones."""
    y, places = closure.independent, closure.places_independent
    q = closure.spread(np.array(closure.manifest.pose), places, states["q"][:, places])
    q = normalise(q.astype(np.float32).astype(np.float64), closure.manifest)
    qd = closure.complete_velocities(q, y, states["qd"][:, y])
    qdd = closure.complete_accelerations(q, qd, y, states["qdd"][:, y])
    closed = {"qd": qd, "qdd": qdd, "yd": qd[:, y], "ydd": qdd[:, y]}
    return {"q": q} | {name: values.astype(np.float32).astype(np.float64) for name, values in closed.items()}


def _range(motion: str, lower: float | None, upper: float | None) -> tuple[float, float]:
    """Return the range of a coordinate: its limits; one turn or two metres where a limit is missing."""
    width = 2 * np.pi if motion == "revolute" else 2.0
    if lower is not None:
        return lower, lower + width if upper is None else upper
    if upper is not None:
        return upper - width, upper
    return -width / 2, width / 2


def list_ranges(manifest: Manifest) -> list[tuple[float, float]]:
    """List the limits of all entries of q; infinite ones where there are none."""
    known = {c.name: (c.lower, c.upper) for c in manifest.coordinates}
    limits = [known.get(name, (None, None)) for name in manifest.positions]
    return [(-np.inf if low is None else low, np.inf if high is None else high) for low, high in limits]
