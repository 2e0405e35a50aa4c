"""Kernels inside JAX: `load(model)` returns functions that jit, vmap, grad, hessian and scan take as their own.

    import jax, mbsrun.jax

    jax.config.update("jax_enable_x64", True)
    arm = mbsrun.jax.load("models/arm_pendulum.yaml")
    qdd = jax.jit(lambda q, qd, u: arm.exp1(q=q, qd=qd, u=u)["qdd"])

Derivatives are the kernels' own, exact ones; a batch is one call. Needs JAX: in the folder of the project,
pip install '.[jax]'.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

if find_spec("jax") is None:
    raise ModuleNotFoundError(
        "mbsrun.jax needs JAX; run in the folder of the project: pip install '.[jax]'", name="jax"
    )

from mbsrun.external import Mechanism, OnDemand
from mbsrun.jax.functions import Functions

__all__ = ["Functions", "load"]


def load(model: str | Path | Mechanism | OnDemand, parameters: Mapping[str, float] | None = None) -> Functions:
    """Load a model file or a generated folder, or take what `mbsrun.load` has loaded; functions are made when called.

    `parameters` replace values of run-time and differentiated parameters. Raises InputError for a model with faults.
    """
    return Functions(model, parameters)
