"""Kernels on a GPU of NVIDIA: `load(model)` returns functions of arrays that lie there, many states in one launch.

    import cupy, mbsrun.cuda

    arm = mbsrun.cuda.load("models/arm_pendulum.yaml")
    q, qd, qdd, u = (cupy.random.normal(size=(1_000_000, n)) for n in (6, 6, 6, 4))
    results, status = arm.batch("impl", q=q, qd=qd, qdd=qdd, u=u)
    Phi = cupy.asarray(results["Phi"])

Kernels are compiled when they are first called, by NVRTC: in the folder of the project, pip install '.[cuda]'.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from mbsrun.cuda.arrays import Array
from mbsrun.cuda.functions import Functions
from mbsrun.cuda.nvrtc import CudaError
from mbsrun.external import Mechanism, OnDemand

__all__ = ["Array", "CudaError", "Functions", "load"]


def load(
    model: str | Path | Mechanism | OnDemand, parameters: Mapping[str, float] | None = None, *, device: int = 0
) -> Functions:
    """Load a model file or a generated folder, or take what `mbsrun.load` has loaded; kernels are made when called.

    `parameters` replace values of run-time and differentiated parameters; `device` numbers the GPU. Raises InputError
    for a model with faults.
    """
    return Functions(model, parameters, device)
