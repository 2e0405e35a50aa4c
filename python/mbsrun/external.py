"""The CasADi face of generated kernels: functions with exact first and second derivatives, for use in an NLP."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from numpy.typing import ArrayLike

from mbsgen.manifest import Kernel, Manifest
from mbsgen.roles import ON_REQUEST, Order, Role, name_adjoint, name_derivative, name_unneeded, split_kernel
from mbsrun.binding import ArgumentError, Status
from mbsrun.kernel import Array, Kernels, document
from mbsrun.models import WHOLE, Extent, derive_equations, find_folder, is_model

if TYPE_CHECKING:
    import casadi as ca

INTEGER = "casadi_int"  # the integers of functions that CasADi can call
START = Extent(("impl", "frames"), 1)
SWITCHED = ("impl", "exp1", "exp2", "semi", "semi_res", "energy", "power", "frames")
FOLLOWED = Extent(
    SWITCHED,
    1,
    optional=("touching", "meetings", "distances", "rates", "loops", "loop_rates", "loop_jacobian", "loop_forces"),
)
LOOPS = ("loops", "loop_rates", "loop_jacobian", "loop_forces")  # short, and a program that needs one needs others


@dataclass(frozen=True)
class Origin:
    """The model file, and the part of it, that kernels are generated from."""

    path: Path
    extent: Extent


class Mechanism(Kernels):
    """The kernels of a generated folder, for NumPy and for CasADi; of a model file, also its equations."""

    def __init__(
        self, folder: str | Path, parameters: Mapping[str, float] | None = None, origin: Origin | None = None
    ) -> None:
        """Read the folder's manifest. `parameters` replace the model's values; the origin is the model's file."""
        super().__init__(folder, parameters)
        self._origin = origin
        self._more: dict[str, Mechanism] = {}  # functions and derivatives that were generated since

    def with_parameters(self, **parameters: float) -> Self:
        """Return the same kernels with other values of the named parameters."""
        other = super().with_parameters(**parameters)
        other._more = {name: more.with_parameters(**other.parameters) for name, more in self._more.items()}
        return other

    def __call__(self, name: str, /, *, sparse: bool = False, **inputs: ArrayLike) -> dict[str, Array]:
        """Call a kernel, as `Kernels.__call__` does; what is not there yet is generated at its first call."""
        more = self._find_more(name)
        return super().__call__(name, sparse=sparse, **inputs) if more is None else more(name, sparse=sparse, **inputs)

    def batch(
        self,
        name: str,
        /,
        *,
        sparse: bool = False,
        threads: int = 1,
        lanes: bool | None = None,
        out: Mapping[str, Array] | None = None,
        **inputs: ArrayLike,
    ) -> tuple[dict[str, Array], Status]:
        """Call a kernel, as `Kernels.batch` does."""
        more = self._find_more(name)
        batch = super().batch if more is None else more.batch
        return batch(name, sparse=sparse, threads=threads, lanes=lanes, out=out, **inputs)

    def list_missing(self, names: Iterable[str]) -> list[str]:
        """List the kernels among some that cannot be called, or generated at their first call."""
        bases = {name: split_kernel(name)[0] for name in super().list_missing(names)}
        requested = ON_REQUEST if self._origin is not None else ()
        return [name for name, base in bases.items() if not (self._is_bare(base) or base in requested)]

    def _is_bare(self, function: str) -> bool:
        """Return whether a function was written without its derivatives, which a call generates."""
        return self._origin is not None and function in self._origin.extent.values and function in self._binder.kernels

    def find_holder(self, name: str) -> Kernels:
        """Return the kernels of one folder, with a kernel among them."""
        return super().find_holder(name) if (more := self._find_more(name)) is None else more

    def describe(self, name: str) -> Kernel:
        """Describe a kernel, as `Kernels.describe` does."""
        more = self._find_more(name)
        return super().describe(name) if more is None else more.describe(name)

    def __getattr__(self, name: str) -> Callable[..., dict[str, Array]]:
        """Return a kernel as a function."""
        if not name.startswith("_") and self._find_more(name) is not None:
            return document(self, self.describe(name))
        return super().__getattr__(name)

    def _find_more(self, name: str, *, derived: bool = False) -> Mechanism | None:
        """Return the kernels that hold a function which this folder lacks; of a model file, they are generated.

        These are functions on request, and derivatives of functions that were written without; `derived` asks for the
        function with its derivatives.
        """
        if self._origin is None:
            return None
        base, extent = split_kernel(name)[0], self._origin.extent
        known = self._binder.kernels.get(base)
        base = base if known is None else known.base  # of a name for the quickest form
        is_bare = self._is_bare(base)
        if (name in self._binder.kernels and not (is_bare and derived)) or not (is_bare or base in ON_REQUEST):
            return None
        if base not in self._more:
            order = extent.derivatives if is_bare else 2
            alone = replace(extent, functions=(base,), derivatives=order, optional=(), values=())
            self._more[base] = Mechanism(find_folder(self._origin.path, alone), self.parameters)
        return self._more[base]

    def symbolic(self, *, numbers: bool = False) -> Any:
        """Return the equations of motion as SymPy's objects: an `mbsgen.equations.Motion` with the present parameters.

        Its matrices M, c, g, applied, h and J make M qdd + c + g = applied and, with loops, h = 0. Named parameters
        are symbols, with their numbers in `values`; numbers: only run-time and differentiated ones are. Long
        equations read the intermediate values in `named`. Raises ArgumentError for the kernels of a generated folder
        and for a file that has changed.
        """
        if self._origin is None:
            raise ArgumentError(f"{self.folder} holds code and no equations; load the file of its model")
        path, extent = self._origin.path, self._origin.extent
        equations, mechanism = derive_equations(path, extent, self.parameters, numbers=numbers)
        if mechanism != self.manifest.mechanism:
            raise ArgumentError(f"{path} has another mechanism than when it was loaded; load it again")
        return equations

    def casadi(self, name: str, *, design: bool = False) -> ca.Function:
        """Return a kernel as a CasADi function of the manifest's inputs, with the present parameters.

        design: differentiated parameters, `theta`, are an input.

        CasADi finds the generated `jac_`, `adj1_` and `jac_adj1_` kernels beside it, and uses them wherever it needs a
        derivative; it can be mapped, also over threads. A serialised function holds the library's path. Raises
        ArgumentError for an unknown kernel, and for kernels of acados, whose integers are not CasADi's.
        """
        more = self._find_more(name, derived=True)
        if more is not None:
            return more.casadi(name, design=design)
        kernel = self._binder.describe(name)  # a name that only libm knows would be found there
        if kernel.integer != INTEGER:
            forms = [x for role in (Role.RESIDUAL, Role.ACCELERATION) for x in self.manifest.list_giving(role)]
            raise ArgumentError(f"{name} is written for acados, not for CasADi; take {' or '.join(forms)}")
        orders = kernel.order.derivatives
        family = [found.name for order in orders if (found := self.manifest.find(kernel.base, order))]
        import casadi as ca  # takes long to load, and NumPy's users do without

        external = ca.external(kernel.symbol, str(self.compile(*family)))
        names, outputs = [a.name for a in kernel.inputs], [a.name for a in kernel.outputs]
        fixed = {a.name: self._hidden for a in kernel.inputs if a.role is Role.SETUP}
        if not design:
            fixed |= {a.name: self._design for a in kernel.inputs if a.role is Role.DESIGN}
        if external.name_in() == names and external.name_out() == outputs and not fixed:
            return external
        inputs = [name for name in names if name not in fixed]
        known = {found.order for found in map(self._binder.describe, family)}
        return _fix(external, inputs, outputs, fixed, kernel.order, known)

    def find_family(self, name: str) -> Mechanism:
        """Return the kernels that hold a function with all of its derivatives."""
        more = self._find_more(name, derived=True)
        self.describe(name)
        return self if more is None else more


JACOBIANS = {Order.VALUE: Order.JACOBIAN, Order.ADJOINT: Order.ADJOINT_JACOBIAN}


def _fix(
    function: ca.Function,
    inputs: Sequence[str],
    outputs: Sequence[str],
    fixed: Mapping[str, Array],
    order: Order,
    known: Set[Order],
) -> ca.Function:
    """Return a kernel as a function of some inputs; the others are fixed, in its generated derivatives as well.

    CasADi would differentiate the call instead, and multiply the generated derivatives by matrices of ones.
    """
    unneeded = [name_unneeded(name) for name in outputs]
    derivatives = {}
    if JACOBIANS.get(order) in known:
        blocks = [name_derivative(of, by) for of in outputs for by in inputs]
        jacobian = function.jacobian()
        derivatives["jac"] = _fix(jacobian, [*inputs, *unneeded], blocks, fixed, JACOBIANS[order], known)
    if order is Order.VALUE and Order.ADJOINT in known:
        given = [*inputs, *unneeded, *map(name_adjoint, outputs)]
        adjoint = function.reverse(1)
        derivatives["adj1"] = _fix(adjoint, given, [*map(name_adjoint, inputs)], fixed, Order.ADJOINT, known)
    import casadi as ca

    symbols = {name: ca.MX.sym(name, function.sparsity_in(name)) for name in inputs}
    results = function(**symbols, **fixed)
    cache = {f"{prefix}_{function.name()}": derivative for prefix, derivative in derivatives.items()}
    chosen = [results[name] for name in outputs]
    # else CasADi may take Jacobians, which it cannot differentiate, in place of adjoints
    options: dict[str, Any] = {"cache": cache, "jac_penalty": -1}
    return ca.Function(function.name(), list(symbols.values()), chosen, inputs, outputs, options)


class OnDemand:
    """The kernels of a model file, each function generated at its first use.

    The residual, its Jacobian and poses are generated at the start, since every optimal control problem needs them for
    guesses and checks. Any other function is generated with the derivatives of its use.
    """

    manifest: Manifest  # of the start

    def __init__(self, path: Path, *, opened: bool = False) -> None:
        """Generate the functions of the start. Raises InputError for a model with faults.

        opened: the forces of rigid stops, dry friction and rigid points of contact are inputs.
        """
        self._path, self._opened = path, opened
        self._start = Mechanism(find_folder(path, replace(START, opened=opened)))
        self._mechanisms: dict[str, Mechanism] = {}
        self.manifest = self._start.manifest
        self._started = frozenset(kernel.name for kernel in self.manifest.kernels)

    def __repr__(self) -> str:
        """Return the model, and that functions are generated at their first use."""
        return repr(self._start).replace("Mechanism(", "OnDemand(", 1)

    @property
    def folder(self) -> Path:
        """The generated folder of all functions, which is made where there is none."""
        return find_folder(self._path, Extent(opened=self._opened))

    def open_forces(self) -> OnDemand:
        """Return the same kernels with the forces of rigid stops, dry friction and rigid points as inputs."""
        return OnDemand(self._path, opened=True).with_parameters(**self.parameters)

    def load_closed(self) -> Mechanism:
        """Load the kernels of the model as its file describes it that a simulation from event to event needs."""
        return load(self._path, self.parameters, FOLLOWED)

    @property
    def parameters(self) -> Mapping[str, float]:
        """The run-time and differentiated parameters in use."""
        return self._start.parameters

    def with_parameters(self, **parameters: float) -> Self:
        """Return the same kernels with other values of the named parameters."""
        other = copy.copy(self)
        other._start = self._start.with_parameters(**parameters)
        other._mechanisms = {}
        return other

    def find_holder(self, name: str) -> Kernels:
        """Return the kernels of one folder, with a kernel among them."""
        return self._find(name)

    def describe(self, name: str) -> Kernel:
        """Describe a kernel, as `Kernels.describe` does."""
        return self._find(name).describe(name)

    def __call__(self, name: str, /, *, sparse: bool = False, **inputs: ArrayLike) -> dict[str, Array]:
        """Call a kernel, as `Kernels.__call__` does."""
        return self._find(name)(name, sparse=sparse, **inputs)

    def _find(self, name: str) -> Mechanism:
        """Find the kernels that contain one, by its own name or as a derivative."""
        if name in self._started:
            return self._start
        return self._load(split_kernel(name)[0])

    def casadi(self, name: str, *, design: bool = False) -> ca.Function:
        """Return a function with its exact derivatives, as `Mechanism.casadi` does."""
        return self._load(name).casadi(name, design=design)

    def find_family(self, name: str) -> Mechanism:
        """Return the kernels that hold a function with all of its derivatives."""
        return self._load(name)

    def _load(self, function: str) -> Mechanism:
        if function not in self._mechanisms:
            together = LOOPS if function in LOOPS else (function,)
            mechanism = Mechanism(find_folder(self._path, Extent(together, opened=self._opened)), self.parameters)
            self._mechanisms |= dict.fromkeys(together, mechanism)
        return self._mechanisms[function]


def load_on_demand(path: Path) -> Mechanism | OnDemand:
    """Load functions of a model file on demand, or a generated folder as it is.

    Raises InputError as `load` does.
    """
    return OnDemand(path) if is_model(path) else load(path)


def load(path: str | Path, parameters: Mapping[str, float] | None = None, extent: Extent = WHOLE) -> Mechanism:
    """Load the kernels of a generated folder, or of a model file; earlier results are found in the cache.

    `extent` is the part of a model file to generate. `parameters` replace values of the model's run-time parameters, by
    the user's names. Raises InputError for a folder without a manifest or a model with faults, CompileError when the
    compiler fails.
    """
    path = Path(path)
    origin = Origin(path.absolute(), extent) if is_model(path) else None
    return Mechanism(find_folder(path, extent), parameters, origin)
