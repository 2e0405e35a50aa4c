"""A problem as a function of some of its numbers, for programs that learn: values -> parts of the optimal motion.

Forward is a solve of each member of a batch, from the solution in the middle with its multipliers; no member depends on
the others, nor on the number of threads. Backward is the adjoint of each optimum, one solve with its factors. Where a
solve fails, or an optimum has no derivative, numbers are NaN; `find_statuses` returns why.
"""

from __future__ import annotations

import importlib
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.optima.family import Family, Member
from mbsrun.ocp.optima.movement import Movement
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.optimal import display
from mbsrun.optimal.derivatives import PARTS, Derivatives, read_weights
from mbsrun.optimal.result import MissingPackageError

COST = "cost"
KEPT = 4096  # solves that are remembered

Kept = TypeVar("Kept")


@dataclass(frozen=True, eq=False, repr=False)
class Differentiable:
    """The optimal motion as a function of numbers, with its adjoint.

    Values have the shape (..., numbers), in the order of `names`. Results are arrays by the names of `reads`, with the
    shapes of a trajectory at mesh points behind the leading axes.
    """

    name: str  # of the problem
    family: Family
    reads: tuple[str, ...]
    threads: int = 1  # of solves
    _solves: OrderedDict[bytes, Member] = field(default_factory=OrderedDict, init=False)
    _movements: OrderedDict[bytes, Movement] = field(default_factory=OrderedDict, init=False)

    @property
    def names(self) -> tuple[str, ...]:
        """List the names of the numbers."""
        return tuple(number.name for number in self.family.answer.numbers)

    @property
    def values(self) -> Array:
        """Return the values that the problem has, (numbers,)."""
        return self.family.values

    @property
    def shapes(self) -> MappingProxyType[str, tuple[int, ...]]:
        """Return the shape of each result of one solve."""
        motion = self._motion
        return MappingProxyType({name: () if name == COST else getattr(motion, name).shape for name in self.reads})

    def __call__(self, values: Any) -> dict[str, Array]:
        """Solve at values of the numbers; NaN where there is no solution. Raises ProblemError for a wrong shape."""
        rows, leading = self._split(values)
        found = [self._read(member) for member in self.solve_all(rows)]
        return {
            name: np.array([part[name] for part in found]).reshape((*leading, *shape))
            for name, shape in self.shapes.items()
        }

    def solve(self, values: Array) -> Member:
        """Solve at one vector of values; the latest solves are remembered."""
        return self.solve_all([values])[0]

    def solve_all(self, rows: Iterable[Array]) -> list[Member]:
        """Solve at several vectors of values, each of them once; the latest solves are remembered."""
        given = [(_name(row), row) for row in rows]
        keys = [key for key, _ in given]
        found = {key: self._solves[key] for key in keys if key in self._solves}
        lacking = {key: row for key, row in given if key not in found}
        found |= zip(lacking, self.family.solve_all([*lacking.values()], self.threads), strict=True)
        for key, member in found.items():
            _keep(self._solves, key, member)
        return [found[key] for key in keys]

    def pull(self, values: Any, weights: Mapping[str, Any]) -> Array:
        """Return the derivatives of sums of weights times results by the numbers, (..., numbers).

        They are NaN where there are none. Raises ProblemError for weights of other names and shapes.
        """
        rows, leading = self._split(values)
        given = read_weights(self.name, weights, {name: (*leading, *shape) for name, shape in self.shapes.items()})
        parts = {name: x.reshape((len(rows), *self.shapes[name])) for name, x in given.items()}
        members = enumerate(zip(rows, self.solve_all(rows), strict=True))
        found = [self._pull(row, member, {name: x[k] for name, x in parts.items()}) for k, (row, member) in members]
        return np.array(found).reshape((*leading, len(self.names)))

    def find_statuses(self, values: Any) -> NDArray[np.object_]:
        """Return the status of each vector of a batch, with the shape of its leading axes; see `find_status`."""
        rows, leading = self._split(values)
        self.solve_all(rows)
        return np.array([self.find_status(row) for row in rows], dtype=object).reshape(leading)

    def find_status(self, values: Array) -> str:
        """Return the status of one vector of values: of the solve where it fails, of the derivatives otherwise."""
        rows, _ = self._split(values)
        if len(rows) != 1:
            raise ProblemError(self.name, [("values", f"{len(rows)} vectors", "give one, or take find_statuses")])
        (row,) = rows
        member = self.solve(row)
        return self._move(row, member).status if member.is_solved else member.outcome.run.status

    def jax(self) -> Callable[[Any], Any]:
        """Return it as a function of JAX: (..., numbers) -> a dictionary of arrays.

        Reverse mode, `jit` and `vmap` work. Raises MissingPackageError without JAX.
        """
        jax = _import("jax", "jax")

        def shape(values: Any) -> dict[str, Any]:
            leading = values.shape[:-1]
            return {name: jax.ShapeDtypeStruct((*leading, *own), values.dtype) for name, own in self.shapes.items()}

        def go(values: Any) -> dict[str, Array]:
            return {name: x.astype(values.dtype) for name, x in self(np.asarray(values)).items()}

        def back(values: Any, weights: Mapping[str, Any]) -> Array:
            return self.pull(np.asarray(values), {k: np.asarray(x) for k, x in weights.items()}).astype(values.dtype)

        def call(values: Any) -> Any:
            return jax.pure_callback(go, shape(values), values, vmap_method="broadcast_all")

        function = jax.custom_vjp(call)

        def forward(values: Any) -> Any:
            return call(values), values

        def backward(values: Any, weights: Any) -> Any:
            own = jax.ShapeDtypeStruct(values.shape, values.dtype)
            return (jax.pure_callback(back, own, values, weights, vmap_method="broadcast_all"),)

        function.defvjp(forward, backward)
        return function  # type: ignore[no-any-return]

    def torch(self) -> Callable[[Any], dict[str, Any]]:
        """Return it as a function of PyTorch: (..., numbers) -> a dictionary of tensors, with reverse mode.

        Raises MissingPackageError without PyTorch.
        """
        torch, layer = _import("torch", "torch"), self

        class Solve(torch.autograd.Function):  # type: ignore[name-defined, misc]
            @staticmethod
            def forward(context: Any, values: Any) -> Any:
                context.save_for_backward(values)
                found = layer(values.detach().cpu().numpy())
                return tuple(torch.as_tensor(found[name]).to(values) for name in layer.reads)

            @staticmethod
            def backward(context: Any, *weights: Any) -> Any:
                (values,) = context.saved_tensors
                given = {k: w.detach().cpu().numpy() for k, w in zip(layer.reads, weights, strict=True)}
                return torch.as_tensor(layer.pull(values.detach().cpu().numpy(), given)).to(values)

        return lambda values: dict(zip(layer.reads, Solve.apply(values), strict=True))

    def __repr__(self) -> str:
        rows = {"numbers": ", ".join(self.names), "results": ", ".join(self.reads)}
        return display.write_text(f"differentiable {self.name}", rows)

    @property
    def _motion(self) -> Trajectory:
        return self.family.answer.guess.trajectories[0]

    def _split(self, values: Any) -> tuple[Array, tuple[int, ...]]:
        try:
            given = np.asarray(values, dtype=np.float64)
        except (TypeError, ValueError):
            raise ProblemError(self.name, [("values", "no array of numbers", "give one")]) from None
        if given.ndim == 0 or given.shape[-1] != len(self.names):
            remedy = f"give (..., {len(self.names)}): {', '.join(self.names)}"
            raise ProblemError(self.name, [("values", f"the shape {given.shape}", remedy)])
        return given.reshape(-1, len(self.names)), given.shape[:-1]

    def _read(self, member: Member) -> dict[str, Any]:
        """Read results off a solve."""
        if not member.is_solved:
            return {name: np.full(shape, np.nan) for name, shape in self.shapes.items()}
        solver, x = self.family.answer.solver, member.outcome.x
        (motion,) = solver.transcription.unpack(solver.program.numpy.complete(x))
        found = {name: getattr(motion, name) for name in self.reads if name != COST}
        if COST in self.reads:
            found[COST] = solver.program.numpy.objective(x, member.instance.parameters)
        count = self.shapes["unknowns"][0] if "unknowns" in self.reads else 0
        return found | ({"unknowns": motion.unknowns[:count]} if "unknowns" in self.reads else {})

    def _move(self, values: Array, member: Member) -> Movement:
        key = _name(values)
        movement = self._movements.get(key) or self.family.differentiate(member)
        _keep(self._movements, key, movement)
        return movement

    def _pull(self, values: Array, member: Member, weights: Mapping[str, Array]) -> Array:
        if not member.is_solved:
            return np.full(len(self.names), np.nan)
        movement = self._move(values, member)
        derivatives = Derivatives(self.name, replace(self.family.answer, movement=movement))
        motion = {name: x for name, x in weights.items() if name != COST and x.any()}
        found = np.zeros(len(self.names))
        if motion:
            found = found + np.array([*derivatives.pull(motion).values()])
        if COST in weights:
            found = found + float(weights[COST]) * movement.find_costs()
        return found


def check_reads(name: str, reads: Sequence[str]) -> tuple[str, ...]:
    """Return the results that are asked for. Raises ProblemError for others."""
    others = [x for x in reads if x not in (*PARTS, COST)]
    if others:
        remedy = f"give {', '.join((COST, *PARTS))}"
        raise ProblemError(name, [(x, "no part of a motion that a function may read", remedy) for x in others])
    return tuple(dict.fromkeys(reads))


def _name(values: Array) -> bytes:
    return np.ascontiguousarray(values, dtype=np.float64).tobytes()


def _keep(known: OrderedDict[bytes, Kept], key: bytes, found: Kept) -> None:
    known[key] = found
    known.move_to_end(key)
    while len(known) > KEPT:
        known.popitem(last=False)


def _import(name: str, extra: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError:
        remedy = f"run in the folder of the project: pip install '.[{extra}]'"
        raise MissingPackageError(f"{name} is not installed; {remedy}") from None
