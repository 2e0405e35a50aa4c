"""The plant of a problem without a mechanism: no coordinates, no kernels."""

from __future__ import annotations

from typing import TYPE_CHECKING, NoReturn

from mbsgen.errors import MbsError
from mbsgen.manifest import FORMAT, Kernel, Manifest
from mbsrun.ocp.ground.plant import Plant, Unchangeable

if TYPE_CHECKING:
    import casadi as ca
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

NAME = "no mechanism"


class NoKernelError(MbsError):
    """A kernel of no mechanism."""


class NoMechanism(Unchangeable):
    """A plant with no coordinates."""

    manifest = Manifest(
        format=FORMAT,
        generator="",
        model=NAME,
        prefix="",
        model_hash="",
        header="",
        sources=(),
        coordinates=(),
        parameters=(),
        frames=(),
        kernels=(),
    )

    def describe(self, name: str) -> Kernel:
        """Describe no kernel."""
        _refuse(name)

    def __call__(
        self,
        name: str,
        /,
        *,
        sparse: bool = False,  # noqa: ARG002  # of any arguments
        **inputs: ArrayLike,  # noqa: ARG002
    ) -> dict[str, NDArray[np.float64]]:
        """Evaluate no kernel."""
        _refuse(name)

    def casadi(self, name: str, *, design: bool = False) -> ca.Function:  # noqa: ARG002
        """Return no kernel."""
        _refuse(name)

    def find_family(self, name: str) -> NoMechanism:  # noqa: ARG002  # of any name
        """Return this plant."""
        return self


NO_MECHANISM: Plant = NoMechanism()


def _refuse(name: str) -> NoReturn:
    raise NoKernelError(f"a problem without a mechanism has no kernel {name}; give it a model")
