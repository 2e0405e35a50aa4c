"""The mechanism of a page, with its C compiled to WebAssembly, and its controllers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mbsgen.machine import (
    FUNCTIONS,
    LOOPED,
    OPTIONAL,
    PlaygroundError,
    describe_mechanism,
    encode,
    list_functions,
    name_array,
    select_kernels,
)
from mbsgen.manifest import Manifest
from mbsrun.controllers.folder import read as read_controller
from mbsrun.kernel import Kernels
from mbsrun.linearisation import Linearisation
from mbsrun.quaternions import neutral
from mbsrun.webassembly import compile_module

__all__ = [
    "FUNCTIONS",
    "LOOPED",
    "OPTIONAL",
    "PlaygroundError",
    "describe_controller",
    "describe_machine",
    "describe_regulator",
    "list_functions",
    "name_array",
]

CONTROLLER = ("bytes", "create", "get_data", "solve", "prepare", "feedback", "get_plan", "get_period", "explain")


def describe_machine(kernels: Kernels) -> dict[str, Any]:
    """Return the mechanism for the script. Raises PlaygroundError for missing functions."""
    manifest = kernels.manifest
    used = list(select_kernels(manifest))
    sources = [source for kernel in used for source in kernel.sources]
    module = compile_module(kernels.folder, manifest.prefix, sources, [kernel.symbol for kernel in used])
    pose = np.array(manifest.pose) if manifest.pose else neutral(manifest)
    return describe_mechanism(manifest, used, module, pose.tolist(), kernels.parameters)


def describe_regulator(manifest: Manifest, found: Linearisation, weight: float) -> dict[str, Any]:
    """Return the feedback of `Linearisation.regulate`, u = u0 - gains (q - q0, qd).

    Raises PlaygroundError for quaternions, which are no such differences.
    """
    if manifest.configuration:
        raise PlaygroundError(f"{manifest.model} has quaternions; the page regulates joints that turn or slide alone")
    return {
        "kind": "regulator",
        "name": f"linear-quadratic regulator, weight {weight:g}",
        "pose": found.equilibrium.q.tolist(),
        "inputs": found.equilibrium.u.tolist(),
        "joints": list(manifest.independent or range(len(manifest.coordinates))),
        "gains": found.regulate(weight).tolist(),
    }


def describe_controller(folder: Path, manifest: Manifest) -> dict[str, Any]:
    """Return a generated controller, compiled. Raises PlaygroundError where it controls another model."""
    found = read_controller(folder)
    joints = [joint.name for joint in manifest.coordinates]
    names, rates = [state.name for state in found.states], [f"{name}'" for name in joints]
    places, velocities = names[: len(manifest.positions)], names[len(manifest.positions) :]
    inputs = [joints[i] for i in manifest.actuated]
    if (found.model, places, [u.name for u in found.inputs]) != (manifest.model, list(manifest.positions), inputs):
        raise PlaygroundError(
            f"{folder}: controls {found.model} with other coordinates or inputs than {manifest.model} has; write it "
            "for the same model"
        )
    added = [name for name in velocities if name not in rates]
    if added:
        raise PlaygroundError(
            f"{folder}: its problem adds the states {', '.join(added)}, which no page simulates; leave them out, or "
            "use `mbsrun track`"
        )
    module = compile_module(
        folder, found.prefix, found.sources, [f"{found.symbols}_{function}" for function in CONTROLLER]
    )
    return {
        "kind": "controller",
        "name": f"predictive controller {found.problem}",
        "prefix": found.symbols,
        "module": encode(module),
        "bytes": len(module),
        "fields": [field.name for field in found.data],
        "intervals": found.intervals,
        "states": len(found.states),
        "velocities": [rates.index(name) for name in velocities],
        "inputs": len(found.inputs),
    }
