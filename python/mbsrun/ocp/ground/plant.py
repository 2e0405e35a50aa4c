"""The kernels of a model as optimal control needs them: loaded kernels, or anything with the same methods."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbsgen.manifest import Kernel, Manifest

if TYPE_CHECKING:
    import casadi as ca

    from mbsrun.kernel import Kernels


class Plant(Protocol):
    """Kernels of one model."""

    @property
    def manifest(self) -> Manifest:
        """Describe the kernels."""

    @property
    def parameters(self) -> Mapping[str, float]:
        """Return the values of run-time and differentiated parameters, by name."""

    def with_parameters(self, **parameters: float) -> Self:
        """Return the same kernels with other values of the named parameters."""

    def describe(self, name: str) -> Kernel:
        """Describe one kernel, which the manifest need not list yet; raises ArgumentError where there is none."""

    def __call__(self, name: str, /, *, sparse: bool = False, **inputs: ArrayLike) -> dict[str, NDArray[np.float64]]:
        """Evaluate a kernel; a leading batch axis on all inputs is allowed; sparse: only the nonzeros."""

    def casadi(self, name: str, *, design: bool = False) -> ca.Function:
        """Return a kernel as a CasADi function with its exact derivatives; design: `theta` is an input."""

    def find_family(self, name: str) -> Plant:
        """Return the kernels that hold a function with all of its derivatives."""


@runtime_checkable
class Openable(Protocol):
    """Kernels that can be had with switching forces as inputs."""

    def open_forces(self) -> Plant:
        """Return the same kernels with the forces of rigid stops, dry friction and rigid points as inputs."""

    def load_closed(self) -> Kernels:
        """Load the kernels of the model as its file describes it, for a simulation."""


class Unchangeable:
    """A plant whose parameters keep their values."""

    @property
    def parameters(self) -> Mapping[str, float]:
        """Return no parameters."""
        return {}

    def with_parameters(self, **parameters: float) -> Self:
        """Return the same. Raises ValueError for values."""
        if parameters:
            raise ValueError(f"these kernels have no parameters {', '.join(parameters)}")
        return self
