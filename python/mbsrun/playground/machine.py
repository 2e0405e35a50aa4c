"""The mechanism as the page's script calls it: the module, the functions with their arguments, the joints.

Arguments are passed by their roles: the script keeps one array for each role, and every function reads the same ones.
Velocities and accelerations of the independent joints of closed loops have separate arrays.
"""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbsgen.errors import MbsError
from mbsgen.manifest import Argument, Coordinate, Kernel, Manifest
from mbsgen.roles import Order, Role
from mbsrun.controllers.folder import read as read_controller
from mbsrun.kernel import Kernels
from mbsrun.linearisation import Linearisation
from mbsrun.quaternions import neutral
from mbsrun.webassembly import compile_module

FUNCTIONS = ("impl", "semi", "exp1", "exp2", "frames", "energy")  # the page calls these
OPTIONAL = ("rates",)  # of quaternions
LOOPED = ("impl_red", "semi_red", "loops", "close", "close_rates", "project_plain")  # of closed loops
INDEPENDENT = {"yd": "independent_velocity", "ydd": "independent_acceleration"}  # the arrays of these arguments
CONTROLLER = ("bytes", "create", "get_data", "solve", "prepare", "feedback", "get_plan", "get_period", "explain")


class PlaygroundError(MbsError):
    """A mechanism, or a controller, that the page cannot show."""


def describe_machine(kernels: Kernels) -> dict[str, Any]:
    """Return the mechanism for the script. Raises PlaygroundError for missing functions."""
    manifest = kernels.manifest
    if manifest.signals:
        raise PlaygroundError(
            f"{manifest.model} has forces that read {', '.join(manifest.signals)}, which the page lacks"
        )
    used = list(_select(manifest))
    sources = [source for kernel in used for source in kernel.sources]
    module = compile_module(kernels.folder, manifest.prefix, sources, [kernel.symbol for kernel in used])
    pose = np.array(manifest.pose) if manifest.pose else neutral(manifest)
    return {
        "name": manifest.model,
        "module": _encode(module),
        "bytes": len(module),
        "sizes": _count(used),
        "functions": {kernel.name: _describe(kernel) for kernel in used},
        "positions": [_describe_position(manifest, i) for i in range(len(manifest.positions))],
        "joints": [_describe_joint(joint) for joint in manifest.coordinates],
        "quaternions": list(manifest.quaternions),
        "loops": [loop.name for loop in manifest.loops],
        "equations": list(manifest.equations),
        "independent": list(manifest.independent),
        "driven": list(manifest.driven),
        "start": [float(x) for x in pose],
        "parameters": [{"name": p.name, "value": kernels.parameters[p.name]} for p in manifest.parameters],
        "design": [{"name": p.name, "value": kernels.parameters[p.name]} for p in manifest.design],
    }


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
        "module": _encode(module),
        "bytes": len(module),
        "fields": [field.name for field in found.data],
        "intervals": found.intervals,
        "states": len(found.states),
        "velocities": [rates.index(name) for name in velocities],
        "inputs": len(found.inputs),
    }


def _select(manifest: Manifest) -> Iterator[Kernel]:
    """Yield the functions that the page calls; the set-up of parameters comes first."""
    if manifest.setup is not None:
        yield manifest.setup
    for name in list_functions(manifest):
        kernel = manifest.find(name, Order.VALUE)
        if kernel is None:
            raise PlaygroundError(f"{manifest.model} was generated without {name}; give the model file, or generate it")
        yield kernel


def list_functions(manifest: Manifest) -> tuple[str, ...]:
    """Name the functions that the page of a model calls."""
    return (*FUNCTIONS, *(OPTIONAL if manifest.configuration else ()), *(LOOPED if manifest.loops else ()))


def name_array(argument: Argument) -> str:
    """Return the name of the script's array for an argument."""
    return INDEPENDENT.get(argument.name, argument.role.value)


def _count(kernels: Sequence[Kernel]) -> Mapping[str, int]:
    """Return the size of each role's array."""
    return {name_array(argument): argument.nnz for kernel in kernels for argument in kernel.inputs}


def _describe(kernel: Kernel) -> dict[str, Any]:
    totals = kernel.flops.model_dump()
    return {
        "symbol": kernel.symbol,
        "arguments": [name_array(argument) for argument in kernel.inputs],
        "results": [_describe_result(argument) for argument in kernel.outputs],
        "flops": {name: totals[name] for name in ("add", "mul", "div", "neg", "sqrt", "trig", "other", "paper")},
    }


def _describe_result(argument: Argument) -> dict[str, Any]:
    found: dict[str, Any] = {"name": argument.name, "rows": argument.rows, "cols": argument.cols}
    if argument.role is Role.SETUP:
        found["role"] = argument.role.value
    if argument.row is None or argument.colind is None:
        return found
    columns = np.repeat(np.arange(argument.cols), np.diff(argument.colind))
    return found | {"places": [int(r + argument.rows * c) for r, c in zip(argument.row, columns, strict=True)]}


def _describe_position(manifest: Manifest, index: int) -> dict[str, Any]:
    name = manifest.positions[index]
    joint = next((joint for joint in manifest.coordinates if joint.name == name), None)
    if joint is None:  # of a quaternion
        return {"name": name, "unit": "", "lower": -1.0, "upper": 1.0, "turns": False}
    turns = joint.motion == "revolute"
    reach = np.pi if turns else 1.0
    lower = -reach if joint.lower is None else joint.lower
    upper = reach if joint.upper is None else joint.upper
    return {"name": name, "unit": joint.unit, "lower": float(lower), "upper": float(upper), "turns": turns}


def _describe_joint(joint: Coordinate) -> dict[str, Any]:
    return {
        "name": joint.name,
        "unit": joint.unit,
        "force": joint.force_unit,
        "actuated": joint.actuated,
        "speed": joint.max_speed,
        "strength": joint.max_force,
    }


def _encode(module: bytes) -> str:
    return base64.b64encode(module).decode("ascii")
