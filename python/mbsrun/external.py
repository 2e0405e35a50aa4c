"""The CasADi face of generated kernels: functions with exact first and second derivatives, for use in an NLP."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import casadi as ca

from mbsrun.binding import DESIGN
from mbsrun.kernel import DERIVATIVES, HIDDEN, Kernels
from mbsrun.models import find_folder


class Mechanism(Kernels):
    """The kernels of a generated folder, for NumPy and for CasADi."""

    def casadi(self, name: str, *, design: bool = False) -> ca.Function:
        """Give a kernel as a CasADi function of the manifest's inputs, parameters at their present values.

        design: differentiated parameters, `theta`, are an input of it.

        CasADi finds the generated `jac_`, `adj1_` and `jac_adj1_` kernels beside it, and uses them wherever it needs a
        derivative; it can be mapped, over threads as well. A serialised function holds the library's path.
        Raises ArgumentError for a kernel that there is not.
        """
        kernel = self._binder.describe(name)  # a name that only libm knows would be found there
        family = [order + name for order in DERIVATIVES if order + name in self._binder.kernels]
        external = ca.external(kernel.symbol, str(self.compile(*family)))
        names, outputs = [a.name for a in kernel.inputs], [a.name for a in kernel.outputs]
        fixed = {HIDDEN: self._hidden} if HIDDEN in names else {}
        if DESIGN in names and not design:
            fixed[DESIGN] = self._design
        if external.name_in() == names and external.name_out() == outputs and not fixed:
            return external
        inputs = {name: ca.MX.sym(name, external.sparsity_in(name)) for name in names if name not in fixed}
        results = external(**inputs, **fixed)
        chosen = [results[name] for name in outputs]
        return ca.Function(kernel.symbol, list(inputs.values()), chosen, list(inputs), outputs)


def load(path: str | Path, parameters: Mapping[str, float] | None = None) -> Mechanism:
    """Load the kernels of a generated folder, or of a model file; what was made of it before is found again.

    `parameters` replace values of the model's run-time parameters, by the user's names.
    Raises InputError for a folder without a manifest or a model with faults, CompileError when the compiler fails.
    """
    return Mechanism(find_folder(Path(path)), parameters)
