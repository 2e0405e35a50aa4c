"""The functions of a model on tensors of PyTorch."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Self

import numpy as np
import torch
from torch.utils.checkpoint import checkpoint

from mbsgen.roles import Order, Role
from mbsrun.binding import ROUNDED, ArgumentError, is_exact
from mbsrun.faces.face import Given
from mbsrun.faces.operators import Operator
from mbsrun.faces.stepping import Policy, SteppingFace, choose_slopes, divide
from mbsrun.torch import calls

_entered: list[Functions] = []


def _enter(face: Functions) -> int:
    _entered.append(face)
    return len(_entered) - 1


def _call_plainly(number: int, name: str, inputs: Mapping[str, Any]) -> dict[str, torch.Tensor]:
    return super(Functions, _entered[number]).__call__(name, **inputs)


def _attempt_plainly(number: int, name: str, inputs: Mapping[str, Any]) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
    return super(Functions, _entered[number]).attempt(name, **inputs)


# torch.compile takes calls as they are, and does not read the code that checks them
_call_number = torch._dynamo.nonstrict_trace(_call_plainly)
_attempt_number = torch._dynamo.nonstrict_trace(_attempt_plainly)


@dataclass(frozen=True)
class _Slot:
    """An input that is a vector: its length, and the value that it has where none is given."""

    name: str
    size: int
    filled: torch.Tensor | None


class Functions(SteppingFace[torch.Tensor]):
    """The functions of a model on tensors: gradients of gradients, torch.func.vmap, and torch.compile."""

    place = "mbsrun.torch"
    kind = "tensors"

    def rollout(
        self,
        q: Any,
        qd: Any,
        h: float,
        *,
        steps: int | None = None,
        along: Mapping[str, Any] | None = None,
        policy: Policy | None = None,
        method: str = "rk4",
        dynamics: str | None = None,
        **inputs: Any,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return q and qd at the start and after each of some steps, along a leading axis: see `SteppingFace`."""
        rows = {name: self._read(array) for name, array in (along or {}).items()}
        count = self._count_steps(steps, rows, inputs)

        def advance(first: int, last: int, q: torch.Tensor, qd: torch.Tensor) -> list[torch.Tensor]:
            states = [(q, qd)]
            for number in range(first, last):
                given = {name: array[number] for name, array in rows.items()}
                further = {} if policy is None else policy(number, *states[-1])
                states.append(
                    self.step(*states[-1], h, method=method, dynamics=dynamics, **{**inputs, **given, **further})
                )
            return [torch.stack(x) for x in zip(*states, strict=True)]

        keeps_all = not torch.is_grad_enabled() or torch._C._are_functorch_transforms_active()
        _, length, _ = (0, count, 0) if keeps_all else divide(count)
        parts = [[x[None] for x in (self._read(q), self._read(qd))]]
        for first in range(0, count, max(length, 1)):
            given = first, min(first + length, count), *(x[-1] for x in parts[-1])
            block = advance(*given) if keeps_all else checkpoint(advance, *given, use_reentrant=False)
            parts.append([x[1:] for x in block])
        qs, qds = (torch.cat(x) for x in zip(*parts, strict=True))
        return qs, qds

    def _read(self, value: Any) -> torch.Tensor:
        if not isinstance(value, torch.Tensor):
            return torch.from_numpy(_read_numbers(value))
        if value.dtype != torch.float64:
            raise ArgumentError(f"{value.dtype} given, torch.float64 expected; convert it by .double()")
        if value.layout is not torch.strided:
            raise ArgumentError(f"a tensor of layout {value.layout} given; convert it by .to_dense()")
        if value.device.type != "cpu":
            raise ArgumentError(
                f"a tensor on {value.device.type} given; kernels run on the processor here: move it by .cpu(), or "
                "compute batches on a GPU by mbsrun.cuda"
            )
        return value

    def __init__(self, model: Any, parameters: Mapping[str, float] | None = None) -> None:
        """Load a model, as the other faces do."""
        super().__init__(model, parameters)
        self._number = _enter(self)
        self._slots: dict[str, tuple[_Slot, ...]] = {}  # of functions whose inputs are all vectors

    def with_parameters(self, **parameters: float) -> Self:
        """Return the same functions with other values of the named parameters, which are plain numbers."""
        other = super().with_parameters(**parameters)
        other._number, other._slots = _enter(other), {}
        return other

    def __getattr__(self, name: str) -> Callable[..., dict[str, torch.Tensor]]:
        """Return a function of the model."""
        if torch.compiler.is_compiling():
            return partial(self.__call__, name)
        return super().__getattr__(name)

    def __call__(self, name: str, /, **inputs: Any) -> dict[str, torch.Tensor]:
        """Call a function, as the other faces do."""
        if torch.compiler.is_compiling():
            return dict(_call_number(self._number, name, inputs))
        return super().__call__(name, **inputs)

    def attempt(self, name: str, /, **inputs: Any) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
        """Call a function, as the other faces do, and return statuses, too."""
        if torch.compiler.is_compiling():
            results, status = _attempt_number(self._number, name, inputs)
            return dict(results), status
        return super().attempt(name, **inputs)

    def _collect(self, operator: Operator, inputs: Mapping[str, Any]) -> Given[torch.Tensor]:
        """Pair the operator's inputs with tensors, as the other faces do; vectors that fit take a third of the time."""
        return self._collect_vectors(operator, inputs) or super()._collect(operator, inputs)

    def _collect_vectors(self, operator: Operator, inputs: Mapping[str, Any]) -> Given[torch.Tensor] | None:
        """Pair vectors with tensors that fit; None for anything else."""
        arrays, batch, taken = [], None, 0
        for slot in self._find_slots(operator):
            array = inputs.get(slot.name, slot.filled)
            if type(array) not in calls.PLAIN or array.dtype is not torch.float64 or not array.is_cpu:
                return None
            shape = array.shape
            if array.layout is not torch.strided or not shape or shape[-1] != slot.size:
                return None
            if len(shape) > 1:
                if batch not in (None, shape[:-1]):
                    return None
                batch = shape[:-1]
            taken += slot.name in inputs
            arrays.append(array)
        return Given(tuple(arrays), tuple(batch or ())) if arrays and taken == len(inputs) else None

    def _find_slots(self, operator: Operator) -> tuple[_Slot, ...]:
        """List the inputs with entries in the operator's order; nothing where one is a matrix."""
        if operator.name not in self._slots:
            filled = {name: torch.from_numpy(np.array(x)) for name, x in self._fill(operator).items()}
            filled |= {
                port.argument.name: torch.zeros(port.argument.nnz, dtype=torch.float64)
                for port in operator.value.given
                if port.argument.role is Role.REMAINDER
            }
            slots = [_Slot(p.argument.name, p.argument.nnz, filled.get(p.argument.name)) for p in operator.value.given]
            is_plain = all(port.is_vector and port.places is None for port in operator.value.given)
            self._slots[operator.name] = tuple(slots) if is_plain else ()
        return self._slots[operator.name]

    def _run(
        self, operator: Operator, given: Given[torch.Tensor], *, with_status: bool
    ) -> tuple[Sequence[torch.Tensor], torch.Tensor | None]:
        operator.check_moving(calls.find_moving(given.arrays))
        results = calls.call(operator, Order.VALUE, given.arrays, with_status=with_status)
        return (results[:-1], results[-1]) if with_status else (results, None)

    def _still(self, array: torch.Tensor) -> torch.Tensor:
        return array.detach()

    def _slope(self, name: str, inputs: Mapping[str, Any], by: Sequence[str]) -> tuple[Any, ...]:
        operator, arrays = self._lay(name, inputs)
        found = calls.call(operator, Order.JACOBIAN, [array.detach() for array in arrays])
        wide = [calls.spread(block, found[block.number]) for block in operator.jacobian.blocks]
        return choose_slopes(operator, wide, by, lambda shape: torch.zeros(shape, dtype=torch.float64))

    def _solve(self, matrices: torch.Tensor, vectors: torch.Tensor) -> torch.Tensor:
        solution: torch.Tensor = torch.linalg.solve_ex(matrices, vectors[..., None])[0][..., 0]
        return solution

    def _keep(self, is_right: Any, array: torch.Tensor) -> torch.Tensor:
        return torch.where(is_right[..., None], array, torch.nan)

    def _take(self, array: torch.Tensor, numbers: Any) -> torch.Tensor:
        return calls.take(array, numbers)

    def _merge(self, first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
        return torch.where(first != 0, first, second)


def _read_numbers(value: Any) -> Any:
    try:
        array = np.asarray(value)
    except (TypeError, ValueError):
        array = np.array(None)
    if array.dtype.kind not in "fiu":
        raise ArgumentError(f"not a tensor or an array of real numbers: {type(value).__name__}")
    if not is_exact(array):
        raise ArgumentError(ROUNDED.format(array.dtype))
    return array.astype(np.float64)
