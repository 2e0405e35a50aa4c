"""Derivatives: against differences of fourth order, by Taylor's remainder, in symmetry and in pattern (F25)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen.roles import Order, name_adjoint, name_derivative, name_kernel
from mbsrun.external import Mechanism
from mbsrun.models import Extent, find_folder
from studies.laboratory.case import Finding, Workspace, check, demand, find_worst, show_failure
from studies.laboratory.digits import KERNELS, U
from studies.laboratory.mechanisms import describe_spatial, draw, write

Array = NDArray[np.float64]
State = Mapping[str, Any]

DIFFERENCES = (2e-3, 1e-3, 5e-4, 2.5e-4)  # steps of differences, of which the best is taken for each block
STEPS = tuple(3 * 10.0**-k for k in range(2, 8))  # of Taylor's remainder
POINTS = 20  # at which patterns are looked at
VARIABLES = {"IMPL": ("q", "qd", "qdd"), "SEMI": ("q", "qd", "qdd"), "EXP1": ("q", "qd", "u"), "EXP2": ("q", "qd", "u")}


def measure_derivatives(workspace: Workspace, size: int) -> list[Finding]:
    """F25: Jacobians to 1e-10 of differences, remainders of order 2, symmetric Hessians, no superfluous entry."""
    extent = Extent((*KERNELS.values(),), 2)
    plant = Mechanism(find_folder(write(workspace.folder, describe_spatial(size)), extent))
    findings = []
    for way, kernel in KERNELS.items():
        inputs = [a.name for a in plant.manifest.kernel(kernel).inputs]
        state = {name: x[0] for name, x in draw(size, [1]).items() if name in inputs}
        findings.append(check(way, "difference from 4th-order differences", _difference(plant, way, state), 1e-10))
        slope = _measure_slope(plant, way, state)
        findings.append(check(way, "slope of Taylor's remainder, off 2", abs(slope - 2), 0.05, f"slope {slope:.3f}"))
        findings.append(check(way, "asymmetry of the Hessian", _measure_asymmetry(plant, way, state), 1e-13))
        findings.append(_compare_pattern(plant, way))
        off = _difference_forward(plant, way, state)
        findings.append(show_failure(f"{way}, one-sided differences", "difference from the Jacobian", off, 1e-10))
    return findings


def _name_result(plant: Mechanism, way: str) -> str:
    (result,) = plant.manifest.kernel(KERNELS[way]).outputs
    return result.name


def _difference(plant: Mechanism, way: str, state: State) -> float:
    """Compare each block of the Jacobian with central differences of fourth order, by its largest entry."""
    kernel, result = KERNELS[way], _name_result(plant, way)
    jacobians, lost = plant.jac(kernel, **state), []
    for name in VARIABLES[way]:
        block, off = jacobians[name_derivative(result, name)], []
        for step in DIFFERENCES:
            columns = []
            for unit in step * np.eye(len(state[name])):
                at = [plant(kernel, **{**state, name: state[name] + k * unit})[result] for k in (1, -1, 2, -2)]
                columns.append((8 * (at[0] - at[1]) - (at[2] - at[3])) / (12 * step))
            off.append(float(np.abs(np.array(columns).T - block).max() / np.abs(block).max()))
        lost.append(min(off))
    return find_worst(lost)


def _difference_forward(plant: Mechanism, way: str, state: State) -> float:
    """Compare one-sided differences with the Jacobian by q; of several steps, the best."""
    kernel, result = KERNELS[way], _name_result(plant, way)
    block, value = plant.jac(kernel, **state)[name_derivative(result, "q")], plant(kernel, **state)[result]
    off = []
    for step in (1e-6, 1e-7, 1e-8, 1e-9):
        units = step * np.eye(len(state["q"]))
        moved = [plant(kernel, **{**state, "q": state["q"] + unit})[result] for unit in units]
        found = np.array([(x - value) / step for x in moved]).T
        off.append(float(np.abs(found - block).max() / np.abs(block).max()))
    return min(off)


def _measure_slope(plant: Mechanism, way: str, state: State) -> float:
    """Fit the order at which |f(x + h d) - f(x) - h J d| vanishes, where rounding does not hide it."""
    kernel, result = KERNELS[way], _name_result(plant, way)
    d = {name: np.random.default_rng(2).uniform(-1, 1, len(state[name])) for name in VARIABLES[way]}
    value, jacobians = plant(kernel, **state)[result], plant.jac(kernel, **state)
    slope = np.sum([jacobians[name_derivative(result, name)] @ d[name] for name in VARIABLES[way]], axis=0)
    kept = []
    for h in STEPS:
        at: dict[str, Any] = {**state, **{name: state[name] + h * d[name] for name in VARIABLES[way]}}
        moved = plant(kernel, **at)[result]
        rest = float(np.abs(moved - value - h * slope).max())
        if rest > 1e3 * U["float64"] * float(np.abs(value).max()):
            kept.append((np.log(h), np.log(rest)))
    h_, rest_ = np.array(kept).T
    return float(np.polyfit(h_, rest_, 1)[0])


def _measure_asymmetry(plant: Mechanism, way: str, state: State) -> float:
    kernel, result = KERNELS[way], _name_result(plant, way)
    weights: dict[str, Any] = {name_adjoint(result): np.random.default_rng(3).uniform(-1, 1, len(state["q"]))}
    blocks = plant.hess(kernel, **state, **weights)
    names = [name for name in VARIABLES[way] if _name_block(name, name) in blocks]
    size, lost = max(float(np.abs(block).max(initial=0.0)) for block in blocks.values()), []
    for a in names:
        for b in names:
            pair = blocks.get(_name_block(a, b)), blocks.get(_name_block(b, a))
            if pair[0] is not None and pair[1] is not None:
                lost.append(float(np.abs(pair[0] - pair[1].T).max(initial=0.0)) / size)
    return find_worst(lost)


def _name_block(row: str, col: str) -> str:
    """Name a block of second derivatives."""
    return name_derivative(name_adjoint(row), col)


def _compare_pattern(plant: Mechanism, way: str) -> Finding:
    """Count entries that the generated pattern has and that vanish at all of some random states."""
    kernel = plant.manifest.kernel(name_kernel(KERNELS[way], Order.JACOBIAN))
    names = [a.name for a in kernel.inputs]
    states = {name: x for name, x in draw(len(plant.manifest.coordinates), range(POINTS)).items() if name in names}
    found = plant.jac(KERNELS[way], sparse=True, **states)
    idle = sum(int((~np.any(values != 0, axis=0)).sum()) for values in found.values())
    entries = sum(values.shape[1] for values in found.values())
    return demand(
        way,
        "pattern holds nonvanishing entries alone",
        idle == 0 < entries,
        f"{entries} entries, {idle} of them vanish",
    )
