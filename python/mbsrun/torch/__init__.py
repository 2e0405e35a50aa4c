"""Kernels inside PyTorch: `load(model)` returns functions of tensors with gradients of gradients, vmap and compile.

    import torch, mbsrun.torch

    arm = mbsrun.torch.load("models/arm_pendulum.yaml")
    q = torch.zeros(6, dtype=torch.float64, requires_grad=True)
    arm.sensors(q=q)["position"].sum().backward()

Derivatives are the kernels' own, exact ones; a batch is one call. Needs PyTorch: in the folder of the project,
pip install '.[torch]'.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

if find_spec("torch") is None:
    raise ModuleNotFoundError(
        "mbsrun.torch needs PyTorch; run in the folder of the project: pip install '.[torch]'", name="torch"
    )

from mbsrun.external import Mechanism, OnDemand
from mbsrun.torch.functions import Functions

__all__ = ["Functions", "load"]


def load(model: str | Path | Mechanism | OnDemand, parameters: Mapping[str, float] | None = None) -> Functions:
    """Load a model file or a generated folder, or take what `mbsrun.load` has loaded; functions are made when called.

    `parameters` replace values of run-time and differentiated parameters. Raises InputError for a model with faults.
    """
    return Functions(model, parameters)
