"""The motion of a model as a component of OpenMDAO, for the phases of Dymos.

    qdd = nu(q, qd, u),    x = sensors(q),    v = J(q) qd

at `num_nodes` points, with one variable for each name of expressions: `q_NAME`, `qd_NAME`, `u_NAME` are inputs,
`qdd_NAME`, `x_SENSOR`, `vx_SENSOR`, ... outputs. Partial derivatives are the kernels', so they are exact; at each point
an output depends on the inputs of that point alone.

    Phase = dymos.Phase(ode_class=make_component("cart_pole.yaml"), transcription=dymos.Radau(num_segments=20))
    phase.add_state("q_cart", rate_source="qd_cart", ...); phase.add_state("qd_cart", rate_source="qdd_cart", ...)
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen.roles import Order, name_derivative, name_kernel
from mbsrun.external import load_on_demand
from mbsrun.ocp.ground.plant import Plant
from mbsrun.peers.peer import PeerError, check_states
from mbsrun.quantities import Quantity, list_quantities

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Result:
    """A result of a kernel whose entries are outputs."""

    kernel: str
    name: str
    kind: str  # of quantities
    inputs: tuple[str, ...]
    role: str  # of its entries, in words


RESULTS = (
    Result("exp2", "qdd", "qdd", ("q", "qd", "u"), "accelerations"),
    Result("sensors", "position", "position", ("q",), "positions of sensors"),
    Result("motion", "v", "v", ("q", "qd"), "velocities of sensors"),
)


def make_component(model: str | Path | Plant, *, sensors: bool = True) -> type[Any]:
    """Return the class of an ExplicitComponent for a model file, a generated folder, or loaded kernels.

    Its option `num_nodes` is the number of points. Raises PeerError without OpenMDAO, or for a model with quaternions
    or closed loops, whose states are more than q and qd.
    """
    try:
        api = importlib.import_module("openmdao.api")
    except ImportError:
        raise PeerError("openmdao is not installed; run pip install dymos") from None
    plant = load_on_demand(Path(model)) if isinstance(model, str | Path) else model
    check_states(plant.manifest, "Dymos")
    known = list_quantities(plant.manifest)
    has_sensors = sensors and any(frame.sensor for frame in plant.manifest.frames)
    results = RESULTS if has_sensors else RESULTS[:1]
    inputs = [name for name, x in known.items() if x.kind in ("q", "qd", "u")]
    outputs = [name for name, x in known.items() if x.kind in {result.kind for result in results}]

    def setup(self: Any) -> None:
        points = self.options["num_nodes"]
        for name in inputs:
            self.add_input(name, shape=(points,))
        for name in outputs:
            self.add_output(name, shape=(points,))
        for of, by in _list_partials(plant, results, known):
            self.declare_partials(of, by, rows=np.arange(points), cols=np.arange(points))

    def compute(self: Any, given: Any, found: Any) -> None:
        del self
        for result in results:
            values = plant(result.kernel, **_gather(result, given, known))[result.name]
            values = _flatten(values)
            for name in outputs:
                if known[name].kind == result.kind:
                    found[name] = values[:, known[name].index]

    def compute_partials(self: Any, given: Any, partials: Any) -> None:
        del self
        for result in results:
            numbers = plant(name_kernel(result.kernel, Order.JACOBIAN), **_gather(result, given, known))
            for of, by in _list_partials(plant, (result,), known):
                block = numbers[name_derivative(result.name, known[by].kind)]
                partials[of, by] = block[:, known[of].index, known[by].index]

    methods = {
        "__doc__": f"Accelerations and sensors of {plant.manifest.model}.",
        "initialize": lambda self: self.options.declare("num_nodes", types=int),
        "setup": setup,
        "compute": compute,
        "compute_partials": compute_partials,
    }
    return type("Motion", (api.ExplicitComponent,), methods)


def _gather(result: Result, given: Any, known: Mapping[str, Quantity]) -> dict[str, Any]:
    """Return the inputs of a kernel, (points, size) each."""
    names = {kind: [name for name, x in known.items() if x.kind == kind] for kind in result.inputs}
    return {kind: np.stack([np.asarray(given[name]) for name in own], axis=1) for kind, own in names.items()}


def _list_partials(plant: Plant, results: tuple[Result, ...], known: Mapping[str, Quantity]) -> list[tuple[str, str]]:
    """List outputs and the inputs that they depend on."""
    pairs = []
    for result in results:
        blocks = {a.name: a for a in plant.describe(name_kernel(result.kernel, Order.JACOBIAN)).outputs}
        for kind in result.inputs:
            block = blocks[name_derivative(result.name, kind)]
            mask = np.ones((block.rows, block.cols), dtype=bool)
            if block.row is not None and block.colind is not None:
                mask[:] = False
                mask[list(block.row), np.repeat(np.arange(block.cols), np.diff(block.colind))] = True
            pairs += [
                (of, by)
                for of, x in known.items()
                if x.kind == result.kind
                for by, y in known.items()
                if y.kind == kind and mask[x.index, y.index]
            ]
    return pairs


def _flatten(values: Array) -> Array:
    """Return matrices (points, 3, sensors) as vectors, sensor by sensor."""
    return values.swapaxes(1, 2).reshape(len(values), -1) if values.ndim == 3 else values
