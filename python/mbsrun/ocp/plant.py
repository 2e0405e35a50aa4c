"""The kernels of a model as optimal control needs them: loaded kernels, or anything with the same methods."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbsgen.manifest import Kernel, Manifest

if TYPE_CHECKING:
    import casadi as ca


class Plant(Protocol):
    """Kernels of one model."""

    @property
    def manifest(self) -> Manifest:
        """Describe the kernels."""

    def describe(self, name: str) -> Kernel:
        """Describe one kernel, which the manifest need not list yet; raises ArgumentError where there is none."""

    def __call__(self, name: str, /, *, sparse: bool = False, **inputs: ArrayLike) -> dict[str, NDArray[np.float64]]:
        """Evaluate a kernel; a leading batch axis on all inputs is allowed; sparse: only the nonzeros."""

    def casadi(self, name: str) -> ca.Function:
        """Return a kernel as a CasADi function with its exact derivatives."""

    def find_family(self, name: str) -> Plant:
        """Return the kernels that hold a function with all of its derivatives."""
