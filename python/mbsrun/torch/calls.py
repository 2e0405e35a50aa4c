"""Calls of kernels as an operator of PyTorch, `mbsrun::call`, with rules for gradients of gradients, vmap and compile.

The operator calls the kernel of an order: y(x), its Jacobian J(x), its adjoint J(x)T s, or its second derivatives
H(x, s) of sT y. Arrays are nonzeros, of shape (nnz,) or (*batch, nnz); arguments without the axes of the batch are the
same for all states. A program names its kernel by a number made from the content of the kernel's library.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch.autograd import forward_ad

from mbsgen.roles import Order
from mbsrun.binding import ArgumentError
from mbsrun.faces.operators import Block, Operator

Tensors = list[torch.Tensor]
ORDERS = tuple(Order)
PLAIN = (torch.Tensor, torch.nn.Parameter)
_entered: dict[int, Operator] = {}  # what programs name by numbers, as long as the process lives


def call(operator: Operator, order: Order, arrays: Sequence[torch.Tensor], *, with_status: bool = False) -> Tensors:
    """Call a kernel; return nonzeros, and last the statuses, if asked."""
    if _is_direct(arrays) and not find_moving(arrays):  # a third of the time
        return _compute(operator, order, arrays, with_status=with_status)
    number = ORDERS.index(order)
    if torch.compiler.is_compiling():  # which cannot read functions with a rule of forward mode
        found: Tensors = torch.ops.mbsrun.call(list(arrays), enter(operator), number, with_status)
        return found
    return list(_Called.apply(enter(operator), number, with_status, *arrays))


def _is_direct(arrays: Sequence[torch.Tensor]) -> bool:
    """Return whether PyTorch only computes: it neither transforms nor records, and tensors hold their numbers."""
    if torch._C._are_functorch_transforms_active() or torch._C._len_torch_dispatch_stack():
        return False
    return all([type(array) in PLAIN for array in arrays])  # noqa: C419 quicker than a generator


def find_moving(arrays: Sequence[torch.Tensor]) -> list[int]:
    """Return the numbers of the tensors by which derivatives may be asked for, in reverse or in forward mode."""
    is_reverse = torch.is_grad_enabled()
    is_forward = forward_ad._current_level >= 0 or torch._C._are_functorch_transforms_active()
    if not (is_reverse or is_forward):
        return []
    return [i for i, a in enumerate(arrays) if (is_reverse and a.requires_grad) or (is_forward and _has_tangent(a))]


def _has_tangent(array: torch.Tensor) -> bool:
    while torch._C._functorch.is_batchedtensor(array):  # vmap cannot pass the question on
        array = torch._C._functorch.get_unwrapped(array)
    return forward_ad.unpack_dual(array).tangent is not None


def enter(operator: Operator) -> int:
    """Enter an operator in the table, once; return its number."""
    return _entered.setdefault(operator.value.key, operator).value.key


def _find_batch(arrays: Sequence[torch.Tensor]) -> tuple[int, ...]:
    for array in arrays:
        if array.dim() > 1:
            return tuple(array.shape[:-1])
    return ()


def _compute(operator: Operator, order: Order, arrays: Sequence[torch.Tensor], *, with_status: bool) -> Tensors:
    found, batch = operator.call(order), _find_batch(arrays)
    states = math.prod(batch)
    rows = [_read(array) for array in arrays]
    strides = tuple([stride for _, _, stride in rows])
    results = [torch.from_numpy(np.empty((*batch, size))) for size in found.sizes]  # quicker than torch.empty
    status = torch.from_numpy(np.empty(batch, dtype=np.int32))
    layout = found.take_rows(states, strides)
    failures = layout.run([place for _, place, _ in rows], [x.data_ptr() for x in results], status.data_ptr())
    found.put_rows_back(states, strides, layout)
    if failures:
        for result in results:
            result.masked_fill_((status != 0)[..., None], torch.nan)
    return [*results, status] if with_status else results


def _read(array: torch.Tensor) -> tuple[torch.Tensor, int, tuple[int, int]]:
    """Return the rows of a tensor, their address, and strides from row to row, 0 for one, and from number to number.

    Raises ArgumentError for a batch of PyTorch's older vmap, which hides its numbers.
    """
    try:
        if array.is_neg():
            array = array.resolve_neg()
        if array.dim() > 2:
            array = array.reshape((-1, array.shape[-1]))
        place, strides = array.data_ptr(), array.stride()
    except RuntimeError:
        place, strides = 0, ()
    if not (place or array.numel() == 0):
        raise ArgumentError(
            "batches of gradients by is_grads_batched or vectorize=True do not reach kernels; take torch.func.vmap, "
            "torch.func.jacrev or torch.func.jacfwd"
        )
    return array, place, (strides[0] if len(strides) > 1 else 0, strides[-1])


def _run_call(arrays: list[torch.Tensor], key: int, order: int, with_status: bool) -> list[torch.Tensor]:
    return _compute(_entered[key], ORDERS[order], arrays, with_status=with_status)


_call: Any = torch.library.custom_op("mbsrun::call", _run_call, mutates_args=())


def _shape_call(arrays: list[torch.Tensor], key: int, order: int, with_status: bool) -> list[torch.Tensor]:
    batch, sizes = _find_batch(arrays), _entered[key].call(ORDERS[order]).sizes
    results = [torch.empty((*batch, size), dtype=torch.float64) for size in sizes]
    return results + [torch.empty(batch, dtype=torch.int32)] * with_status


_call.register_fake(_shape_call)


# --- batches -------------------------------------------------------------------------------------------------------


def _batch_call(
    info: Any, in_dims: Any, arrays: list[torch.Tensor], key: int, order: int, with_status: bool
) -> tuple[Tensors, list[int]]:
    results = call(_entered[key], ORDERS[order], _align(arrays, in_dims[0], info.batch_size), with_status=with_status)
    return results, [0] * len(results)


_call.register_vmap(_batch_call)


def _align(arrays: Sequence[torch.Tensor], axes: Sequence[int | None], size: int) -> Tensors:
    """Put a new axis of a batch first. Arguments have all axes of the batch, or none."""
    ranks = [a.dim() - 1 - (axis is not None) for a, axis in zip(arrays, axes, strict=True)]
    most = max(ranks)
    fronted = [a if axis is None else a.movedim(axis, 0) for a, axis in zip(arrays, axes, strict=True)]
    batch = next(a.shape[a.dim() - 1 - most : -1] for a, rank in zip(fronted, ranks, strict=True) if rank == most)
    aligned = []
    for array, axis, rank in zip(fronted, axes, ranks, strict=True):
        if rank != most or (axis is None and rank):
            lead, inner = (1,) if axis is None else (size,), tuple(batch) if rank else (1,) * most
            single = array.reshape((*lead, *inner, array.shape[-1]))
            aligned.append(array if axis is None and not rank else single.expand((size, *batch, array.shape[-1])))
        else:
            aligned.append(array)
    return aligned


# --- gradients -----------------------------------------------------------------------------------------------------


class _Called(torch.autograd.Function):  # type: ignore[misc]
    """A call with its rules: of vmap, of reverse mode and of forward mode."""

    @staticmethod
    def forward(key: int, order: int, with_status: bool, *arrays: torch.Tensor) -> tuple[torch.Tensor, ...]:
        if _is_direct(arrays):
            return tuple(_compute(_entered[key], ORDERS[order], arrays, with_status=with_status))
        return tuple(torch.ops.mbsrun.call(list(arrays), key, order, with_status))

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[torch.Tensor, ...]) -> None:
        ctx.key, ctx.order, ctx.with_status, *arrays = inputs
        ctx.shapes = [tuple(x.shape) for x in output]
        ctx.save_for_backward(*arrays)
        ctx.save_for_forward(*arrays)
        if ctx.with_status:
            ctx.mark_non_differentiable(output[-1])

    @staticmethod
    def vmap(
        info: Any, in_dims: tuple[Any, ...], key: int, order: int, with_status: bool, *arrays: torch.Tensor
    ) -> tuple[tuple[torch.Tensor, ...], tuple[int, ...]]:
        aligned = _align(arrays, in_dims[3:], info.batch_size)
        results = tuple(call(_entered[key], ORDERS[order], aligned, with_status=with_status))
        return results, (0,) * len(results)

    @staticmethod
    def backward(ctx: Any, *cotangents: torch.Tensor | None) -> tuple[Any, ...]:
        return None, None, None, *_pull(ctx, cotangents, ctx.needs_input_grad[3:])

    @staticmethod
    def jvp(ctx: Any, *tangents: Any) -> tuple[torch.Tensor | None, ...]:
        operator, order, arrays = _entered[ctx.key], ORDERS[ctx.order], ctx.saved_tensors
        n, moves = len(operator.value.given), tangents[3:]
        _refuse_nested(operator)
        differentiated = [port.argument.role.is_differentiated for port in operator.value.given]
        # of arguments that do not move, some are given as zeros
        directions = {i: x for i, x in enumerate(moves[:n]) if x is not None and differentiated[i]}
        operator.check_moving(tuple(directions))
        found = _choose(operator, order, PUSHES)(operator, arrays, directions)
        if any(x is not None for x in moves[n:]):
            changes = _fill([tuple(a.shape) for a in arrays[n:]], moves[n:])
            for k, term in enumerate(call(operator, order, [*arrays[:n], *changes])):
                found[k] = found[k] + term if k in found else term
        shapes = ctx.shapes[: len(ctx.shapes) - ctx.with_status]
        changes = [found[k] if k in found else arrays[0].new_zeros(s) for k, s in enumerate(shapes)]
        return (*changes, None) if ctx.with_status else tuple(changes)


# PyTorch reads it at every call, and makes it anew otherwise
_Called.forward.__signature__ = inspect.signature(_Called.forward)  # type: ignore[attr-defined]


def _refuse_nested(operator: Operator) -> None:
    """Refuse forward mode within forward mode, of which PyTorch returns zeros for functions that it does not know."""
    active = [interpreter.key() for interpreter in torch._C._functorch.get_interpreter_stack() or ()]
    if active.count(torch._C._functorch.TransformType.Jvp) > 1:
        raise ArgumentError(
            f"{operator.name}: PyTorch has no forward mode within forward mode for functions as this one; use reverse "
            "mode for one of them, as torch.func.hessian does"
        )


def _keep(ctx: Any, inputs: tuple[Any, ...], output: Tensors) -> None:
    arrays, ctx.key, ctx.order, ctx.with_status = inputs
    ctx.shapes = [tuple(x.shape) for x in output]
    ctx.save_for_backward(*arrays)


def _pull_compiled(ctx: Any, cotangents: Sequence[torch.Tensor | None]) -> tuple[Any, ...]:
    return _pull(ctx, cotangents, ctx.needs_input_grad[0]), None, None, None


_call.register_autograd(_pull_compiled, setup_context=_keep)


def _pull(ctx: Any, cotangents: Sequence[torch.Tensor | None], needs: Sequence[bool]) -> list[torch.Tensor | None]:
    operator, order, arrays = _entered[ctx.key], ORDERS[ctx.order], ctx.saved_tensors
    moving = [i for i, needed in enumerate(needs[: len(operator.value.given)]) if needed]
    operator.check_moving(moving)
    weights = _fill(ctx.shapes[: len(ctx.shapes) - ctx.with_status], cotangents[: len(ctx.shapes) - ctx.with_status])
    found = _choose(operator, order, PULLS)(operator, arrays, weights, moving)
    return [_fit(found.get(k), a, needs[k]) for k, a in enumerate(arrays)]


def _fill(shapes: Sequence[tuple[int, ...]], arrays: Sequence[torch.Tensor | None]) -> Tensors:
    """Put zeros in place of absent arrays."""
    return [torch.zeros(s, dtype=torch.float64) if x is None else x for s, x in zip(shapes, arrays, strict=True)]


def _choose(operator: Operator, order: Order, rules: Mapping[Order, Any]) -> Any:
    if order not in rules:
        raise ArgumentError(f"{operator.name}: a third derivative is taken; kernels have first and second derivatives")
    return rules[order]


def _fit(found: torch.Tensor | None, array: torch.Tensor, needed: bool) -> torch.Tensor | None:
    """Sum over the batch where an argument was the same for all states."""
    if not needed:
        return None
    if found is None:
        return torch.zeros_like(array)
    return found.sum(tuple(range(found.dim() - 1))) if found.dim() > array.dim() else found


def _pull_value(
    operator: Operator, arrays: Sequence[torch.Tensor], weights: Tensors, moving: Sequence[int]
) -> dict[int, torch.Tensor]:
    if not moving:
        return {}
    return dict(zip(operator.adjoint.inputs, call(operator, Order.ADJOINT, [*arrays, *weights]), strict=True))


def _pull_adjoint(
    operator: Operator, arrays: Sequence[torch.Tensor], weights: Tensors, moving: Sequence[int]
) -> dict[int, torch.Tensor]:
    """Return H(x, s) v for x, and J(x) v for the weights s."""
    n, directions = len(operator.value.given), dict(zip(operator.adjoint.inputs, weights, strict=True))
    found = _multiply(operator.jacobian.blocks, call(operator, Order.JACOBIAN, arrays[:n]), directions)
    pulled = {n + k: x for k, x in found.items()}
    if moving:
        pulled |= _multiply(operator.curvature.blocks, call(operator, Order.ADJOINT_JACOBIAN, arrays), directions)
    return pulled


def _pull_jacobian(
    operator: Operator, arrays: Sequence[torch.Tensor], weights: Tensors, moving: Sequence[int]
) -> dict[int, torch.Tensor]:
    """Return the sum of the results' Hessians, each times its row of the weights."""
    starts = np.cumsum([0, *operator.value.sizes])
    sums: dict[int, torch.Tensor] = {}
    for number, found in enumerate(_call_by_units(operator, arrays)):
        directions = {
            block.by: spread(block, weights[block.number])[..., number - starts[block.of], :]
            for block in operator.jacobian.blocks
            if starts[block.of] <= number < starts[block.of + 1]
        }
        for k, term in _multiply(operator.curvature.blocks, found, directions).items():
            sums[k] = sums[k] + term if k in sums else term
    return {k: x for k, x in sums.items() if k in moving}


def _call_by_units(operator: Operator, arrays: Sequence[torch.Tensor]) -> list[Tensors]:
    """Return the second derivatives of each result."""
    batch = _find_batch(arrays)
    found = []
    for units in zip(*map(torch.from_numpy, operator.list_units()), strict=True):
        wide = [unit.expand((*batch, unit.shape[0])) for unit in units]
        found.append(call(operator, Order.ADJOINT_JACOBIAN, [*arrays, *wide]))
    return found


PULLS = {Order.VALUE: _pull_value, Order.ADJOINT: _pull_adjoint, Order.JACOBIAN: _pull_jacobian}


def _push_value(
    operator: Operator, arrays: Sequence[torch.Tensor], directions: dict[int, torch.Tensor]
) -> dict[int, torch.Tensor]:
    return _multiply(operator.jacobian.blocks, call(operator, Order.JACOBIAN, arrays), directions)


def _push_adjoint(
    operator: Operator, arrays: Sequence[torch.Tensor], directions: dict[int, torch.Tensor]
) -> dict[int, torch.Tensor]:
    if not directions:
        return {}
    sums = _multiply(operator.curvature.blocks, call(operator, Order.ADJOINT_JACOBIAN, arrays), directions)
    return {k: sums[i] for k, i in enumerate(operator.adjoint.inputs) if i in sums}


def _push_jacobian(
    operator: Operator, arrays: Sequence[torch.Tensor], directions: dict[int, torch.Tensor]
) -> dict[int, torch.Tensor]:
    """Return the change of the Jacobian's nonzeros: each row is a gradient, which changes by the result's Hessian."""
    units = _call_by_units(operator, arrays)
    rows = [_multiply(operator.curvature.blocks, found, directions) for found in units]
    starts, changes = np.cumsum([0, *operator.value.sizes]), {}
    for block in operator.jacobian.blocks:
        if block.by in rows[0]:
            gradients = torch.stack([row[block.by] for row in rows], -2)
            changes[block.number] = gradients[..., starts[block.of] + block.rows, block.cols]
    return changes


PUSHES = {Order.VALUE: _push_value, Order.ADJOINT: _push_adjoint, Order.JACOBIAN: _push_jacobian}


def _multiply(
    blocks: Sequence[Block], found: Sequence[torch.Tensor], directions: dict[int, torch.Tensor]
) -> dict[int, torch.Tensor]:
    """Multiply blocks by directions of inputs; return a sum for each argument that they are of."""
    sums: dict[int, torch.Tensor] = {}
    for block in blocks:
        if block.by in directions:
            term = (spread(block, found[block.number]) * directions[block.by][..., None, :]).sum(-1)
            sums[block.of] = sums[block.of] + term if block.of in sums else term
    return sums


def spread(block: Block, nonzeros: torch.Tensor) -> torch.Tensor:
    """Return the whole block."""
    if block.spread is None:
        return nonzeros.reshape((*nonzeros.shape[:-1], *block.shape))
    return take(nonzeros, block.spread)


def take(array: torch.Tensor, numbers: Any) -> torch.Tensor:
    """Take entries of the last axis; numbers past the end give 0."""
    padded = torch.cat([array, array.new_zeros((*array.shape[:-1], 1))], -1)
    return padded.index_select(-1, torch.as_tensor(numbers.ravel())).reshape((*array.shape[:-1], *numbers.shape))
