"""The kernels of a model with derivatives by CasADi, instead of the generated derivatives of the same equations.

CasADi traces the equations that mbsgen writes as Python in its SX, and differentiates them twice. It interprets the
result, or writes C that is compiled as generated kernels are.
"""

from __future__ import annotations

import tempfile
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import Literal

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbsgen.manifest import Kernel, Manifest
from mbsrun.forms import DIFFERENTIATED
from mbsrun.library import compile_library
from mbsrun.measuring.candidates import load_equations, trace
from mbsrun.measuring.functions import Variant
from mbsrun.measuring.mechanisms import Subject
from mbsrun.models import Extent
from mbsrun.ocp.ground.plant import Plant, Unchangeable

Way = Literal["generated", "CasADi's AD, compiled", "CasADi's AD, interpreted"]
WAYS: tuple[Way, ...] = ("generated", "CasADi's AD, compiled", "CasADi's AD, interpreted")


class Differentiated(Unchangeable):
    """The kernels of a model; CasADi differentiates the kernels of the dynamics."""

    def __init__(self, plant: Plant, model: Path, is_compiled: bool) -> None:
        """Take the generated kernels, for all other functions, and their model file."""
        self._plant, self._is_compiled = plant, is_compiled
        self._subject = Subject(model, Extent(DIFFERENTIATED, 0, targets=("python",)))

    @property
    def manifest(self) -> Manifest:
        """Return the description of the kernels."""
        return self._plant.manifest

    def describe(self, name: str) -> Kernel:
        """Return the description of a generated kernel."""
        return self._plant.describe(name)

    def __call__(self, name: str, /, *, sparse: bool = False, **inputs: ArrayLike) -> dict[str, NDArray[np.float64]]:
        """Evaluate a generated kernel."""
        return self._plant(name, sparse=sparse, **inputs)

    def find_family(self, name: str) -> Differentiated:
        """Return the kernels that hold a function with all of its derivatives: these."""
        self.describe(name)
        return self

    def casadi(self, name: str, *, design: bool = False) -> ca.Function:
        """Return a kernel as a CasADi function; design: differentiated parameters are an input."""
        if name not in DIFFERENTIATED:
            return self._plant.casadi(name, design=design)
        function = trace(self._equations, self._subject.manifest.kernel(name))
        return self._compile(function) if self._is_compiled else function

    @cached_property
    def _equations(self) -> ModuleType:
        return load_equations(self._subject)

    def _compile(self, function: ca.Function) -> ca.Function:
        """Write a function and its requested derivatives as C of CasADi, and compile it."""
        prefix, x = self._subject.manifest.prefix, function.sx_in()
        name = f"casadi_{prefix}_{function.name()}"  # exp2 is a function of C
        function = ca.Function(name, x, function.call(x), function.name_in(), function.name_out())
        adjoint = function.reverse(1)
        with tempfile.TemporaryDirectory() as place:
            generator = ca.CodeGenerator(f"{name}.c")
            for each in (function, function.jacobian(), adjoint, adjoint.jacobian()):
                generator.add(each)
            generator.generate(f"{place}/")
            library = compile_library(Path(place), prefix, [f"{name}.c"], Variant().compiler())
        return ca.external(name, str(library))
