"""The mechanism as the script of a page calls it: the module, the functions with their arguments, the joints.

Arguments are passed by their roles: the script keeps one array for each role, and every function reads the same ones.
Velocities and accelerations of the independent joints of closed loops have separate arrays.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from mbsgen.errors import MbsError
from mbsgen.manifest import Argument, Coordinate, Kernel, Manifest
from mbsgen.roles import Order, Role

FUNCTIONS = ("impl", "semi", "exp1", "exp2", "frames", "energy")  # the page calls these
OPTIONAL = ("rates",)  # of quaternions
LOOPED = ("impl_red", "semi_red", "loops", "close", "close_rates", "project_plain")  # of closed loops
INDEPENDENT = {"yd": "independent_velocity", "ydd": "independent_acceleration"}  # the arrays of these arguments


class PlaygroundError(MbsError):
    """A mechanism, or a controller, that the page cannot show."""


def select_kernels(manifest: Manifest) -> Iterator[Kernel]:
    """Yield the functions that the page calls; the set-up of parameters comes first.

    Raises PlaygroundError for missing functions, and for forces that read signals.
    """
    if manifest.signals:
        raise PlaygroundError(
            f"{manifest.model} has forces that read {', '.join(manifest.signals)}, which the page lacks"
        )
    if manifest.setup is not None:
        yield manifest.setup
    for name in list_functions(manifest):
        kernel = manifest.find(name, Order.VALUE)
        if kernel is None:
            raise PlaygroundError(f"{manifest.model} was generated without {name}; give the model file, or generate it")
        yield kernel


def describe_mechanism(
    manifest: Manifest, used: Sequence[Kernel], module: bytes, start: Sequence[float], values: Mapping[str, float]
) -> dict[str, Any]:
    """Return the mechanism for the script: a module of some kernels, a pose, and the values of parameters."""
    return {
        "name": manifest.model,
        "module": encode(module),
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
        "start": [float(x) for x in start],
        "parameters": [{"name": p.name, "value": values[p.name]} for p in manifest.parameters],
        "design": [{"name": p.name, "value": values[p.name]} for p in manifest.design],
    }


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
    starts = list(argument.colind)
    columns = [c for c in range(argument.cols) for _ in range(starts[c], starts[c + 1])]
    return found | {"places": [r + argument.rows * c for r, c in zip(argument.row, columns, strict=True)]}


def _describe_position(manifest: Manifest, index: int) -> dict[str, Any]:
    name = manifest.positions[index]
    joint = next((joint for joint in manifest.coordinates if joint.name == name), None)
    if joint is None:  # of a quaternion
        return {"name": name, "unit": "", "lower": -1.0, "upper": 1.0, "turns": False}
    turns = joint.motion == "revolute"
    reach = math.pi if turns else 1.0
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


def encode(module: bytes) -> str:
    """Write bytes as text."""
    return base64.b64encode(module).decode("ascii")
