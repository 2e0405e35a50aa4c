"""The kernels of a closed loop: of the true mechanism, whose numbers may differ, and of predictions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from mbsgen.manifest import Manifest
from mbsrun.external import Mechanism, load, load_on_demand
from mbsrun.models import INTEGRATED, Extent
from mbsrun.ocp.problem.design import equip
from mbsrun.ocp.problem.problem import Problem
from mbsrun.smoothness import demand_smooth

SIMULATED = ("exp2", "impl", "energy", "power", "frames")  # as the simulation needs them, without loops


def load_simulated(model: Path, *, is_released: bool = False) -> Mechanism:
    """Load the kernels that a simulation and its measurements need.

    `is_released` makes every number of the model a run-time parameter. Parameters of the file keep their names, and
    other numbers have their paths, such as `link7.mass`. Raises InputError with every fault of the model.
    """
    manifest = load_on_demand(model).manifest
    demand_smooth(manifest, "a closed loop", stops=True)
    return load(model, extent=_choose(manifest, is_released=is_released))


def build_plant(plant: Mechanism, problem: Problem, numbers: Mapping[str, float], *, is_other: bool) -> Mechanism:
    """Return the true mechanism with the numbers of a problem: with all of its parameters, or the ones that were found.

    The file of another model has the other numbers itself.
    """
    if not is_other:
        return equip(plant, problem)
    known = {name: value for name, value in numbers.items() if name in plant.parameters}
    return plant.with_parameters(**known)


def _choose(manifest: Manifest, *, is_released: bool) -> Extent:
    """Choose the functions to generate: few where no loops are to be closed."""
    if manifest.loops or manifest.driven:
        return replace(INTEGRATED, runtime=is_released)
    sensors = ("sensors", "motion") if any(frame.sensor for frame in manifest.frames) else ()
    rates = ("rates",) if manifest.configuration else ()
    return Extent((*SIMULATED, *sensors, *rates), INTEGRATED.derivatives, runtime=is_released, values=("exp2",))
