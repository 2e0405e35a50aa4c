"""What optimal control needs of a model: loaded kernels, or anything that offers the same."""

from __future__ import annotations

from typing import Protocol

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbsgen.manifest import Manifest


class Plant(Protocol):
    """Kernels of one model."""

    @property
    def manifest(self) -> Manifest:
        """Describe the kernels."""

    def __call__(self, name: str, /, *, sparse: bool = False, **inputs: ArrayLike) -> dict[str, NDArray[np.float64]]:
        """Evaluate a kernel; a leading batch axis on all inputs is allowed; sparse: only the nonzeros."""

    def casadi(self, name: str) -> ca.Function:
        """Give a kernel as a CasADi function with its exact derivatives."""
