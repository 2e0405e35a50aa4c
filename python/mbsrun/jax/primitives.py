"""Calls of kernels as primitives of JAX, with rules for batches and for derivatives of first and second order.

`call_p` calls the kernel of an order: y(x), its Jacobian J(x), its adjoint J(x)T s, or its second derivatives H(x, s)
of sT y. `push_p` is J(x) dx, whose transpose is the adjoint's kernel: so reverse mode evaluates no Jacobian. Arrays are
nonzeros, of shape (nnz,) or (*batch, nnz); arguments without the axes of the batch are the same for all states.

Where a batch is over directions alone, as in jax.jacfwd, the matrix is computed once, and multiplied by all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from mbsgen.roles import Order
from mbsrun.binding import ArgumentError
from mbsrun.faces.operators import Block, Operator
from mbsrun.jax import foreign

Values = list[Any]  # arrays of JAX, or what stands for them while a program is traced


def call(operator: Operator, order: Order, *arrays: Any, with_status: bool = False) -> Values:
    """Call a kernel; return nonzeros, and last the statuses, if asked."""
    return list(call_p.bind(*arrays, operator=operator, order=order, with_status=with_status))


def push(operator: Operator, moving: tuple[int, ...], *arrays: Any) -> Values:
    """Return J(x) dx; the arrays are x, and then a direction for each input that is `moving`, by their numbers."""
    return list(push_p.bind(*arrays, operator=operator, moving=moving))


# --- matrices times vectors ----------------------------------------------------------------------------------------


def take(array: Any, numbers: Any) -> Any:
    """Take entries of the last axis; numbers past the end give 0."""
    if np.max(numbers, initial=-1) >= array.shape[-1]:
        array = jnp.concatenate([array, jnp.zeros((*array.shape[:-1], 1))], axis=-1)
    return array[..., numbers]


def spread(block: Block, nonzeros: Any) -> Any:
    """Return the whole block."""
    if block.spread is None:
        return nonzeros.reshape((*nonzeros.shape[:-1], *block.shape))
    return take(nonzeros, block.spread)


def multiply(blocks: Sequence[Block], found: Sequence[Any], directions: dict[int, Any]) -> dict[int, Any]:
    """Multiply blocks by directions of inputs; return a sum for each argument that they are of."""
    sums: dict[int, Any] = {}
    for block in blocks:
        if block.by in directions:
            term = (spread(block, found[block.number]) * directions[block.by][..., None, :]).sum(-1)
            sums[block.of] = sums[block.of] + term if block.of in sums else term
    return sums


def _push_by_matrix(operator: Operator, moving: tuple[int, ...], *arrays: Any) -> Values:
    n = len(operator.value.given)
    x, directions = arrays[:n], dict(zip(moving, arrays[n:], strict=True))
    sums = multiply(operator.jacobian.blocks, call(operator, Order.JACOBIAN, *x), directions)
    batch = _find_batch(arrays)
    return [sums[k] if k in sums else jnp.zeros((*batch, size)) for k, size in enumerate(operator.value.sizes)]


def _call_by_units(operator: Operator, x: Sequence[Any]) -> Values:
    """Return the second derivatives of each result: nonzeros of blocks with a leading axis, one row for each result."""
    batch = _find_batch(x)
    units = operator.list_units()
    wide = [jnp.broadcast_to(unit[:, *[None] * len(batch), :], (len(unit), *batch, unit.shape[1])) for unit in units]
    many = [jnp.broadcast_to(a, (operator.length, *a.shape)) if a.ndim > 1 else a for a in x]
    return call(operator, Order.ADJOINT_JACOBIAN, *many, *wide)


# --- shapes --------------------------------------------------------------------------------------------------------


def _find_batch(arrays: Sequence[Any]) -> tuple[int, ...]:
    return next((tuple(a.shape[:-1]) for a in arrays if len(a.shape) > 1), ())


def _fit(array: Any, shape: tuple[int, ...]) -> Any:
    """Sum over the batch where an argument was the same for all states; spread where it was not."""
    if len(shape) < array.ndim:
        return array.sum(tuple(range(array.ndim - len(shape))))
    return jnp.broadcast_to(array, shape)


def _align(arrays: Sequence[Any], axes: Sequence[int | None], size: int) -> Values:
    """Put a new axis of a batch first. Arguments have all axes of the batch, or none."""
    fronted = _front(arrays, axes)
    ranks = [a.ndim - 1 - (axis is not None) for a, axis in zip(fronted, axes, strict=True)]
    most = max(ranks)
    batch = next(a.shape[a.ndim - 1 - most : -1] for a, rank in zip(fronted, ranks, strict=True) if rank == most)
    aligned = []
    for array, axis, rank in zip(fronted, axes, ranks, strict=True):
        if (axis is None and rank == 0) or (axis is not None and rank == most):
            aligned.append(array)
        else:
            lead = (size,) if axis is not None else (1,)
            inner = batch if rank else (1,) * most
            single = array.reshape((*lead, *inner, array.shape[-1]))
            aligned.append(jnp.broadcast_to(single, (size, *batch, array.shape[-1])))
    return aligned


def _front(arrays: Sequence[Any], axes: Sequence[int | None]) -> Values:
    return [a if axis is None else jnp.moveaxis(a, axis, 0) for a, axis in zip(arrays, axes, strict=True)]


def _widen(results: Sequence[Any], batch: tuple[int, ...]) -> Values:
    return [jnp.broadcast_to(result, (*batch, result.shape[-1])) for result in results]


def _size(arrays: Sequence[Any], axes: Sequence[int | None]) -> int:
    return next(int(a.shape[axis]) for a, axis in zip(arrays, axes, strict=True) if axis is not None)


def _is_still(tangent: Any) -> bool:
    return type(tangent) is ad.Zero


def _zero(array: Any) -> Any:
    return ad.Zero(jax.typeof(array).to_tangent_aval())


def _move(tangents: Sequence[Any]) -> dict[int, Any]:
    return {k: t for k, t in enumerate(tangents) if not _is_still(t)}


@lru_cache(maxsize=4096)
def _compile(primitive: Any, **parameters: Any) -> Callable[..., Values]:
    compiled: Callable[..., Values] = jax.jit(partial(primitive.bind, **parameters))
    return compiled


def _define(name: str) -> Any:
    primitive = Primitive(name)
    primitive.multiple_results = True
    primitive.def_impl(lambda *arrays, **parameters: _compile(primitive, **parameters)(*arrays))
    return primitive


call_p = _define("mbs_call")
push_p = _define("mbs_push")


# --- rules of calls ------------------------------------------------------------------------------------------------


def _shape_call(*arrays: Any, operator: Operator, order: Order, with_status: bool) -> Values:
    batch = _find_batch(arrays)
    results = [jax.core.ShapedArray((*batch, size), np.dtype(np.float64)) for size in operator.call(order).sizes]
    return results + [jax.core.ShapedArray(batch, np.dtype(np.int32))] * with_status


call_p.def_abstract_eval(_shape_call)


def _write_call(*arrays: Any, operator: Operator, order: Order, with_status: bool) -> Values:
    return foreign.call(operator.call(order), _find_batch(arrays), arrays, with_status=with_status)


mlir.register_lowering(call_p, mlir.lower_fun(_write_call, multiple_results=True))


def _batch_call(
    arrays: Sequence[Any], axes: Sequence[int | None], *, operator: Operator, order: Order, with_status: bool
) -> tuple[Values, list[int]]:
    size, n = _size(arrays, axes), len(operator.value.given)
    if order is Order.ADJOINT and all(axis is None for axis in axes[:n]):  # many weights of one state
        results = _pull_by_matrix(operator, arrays[:n], _front(arrays[n:], axes[n:]))
        return _widen(results, _find_batch(_align(arrays, axes, size))), [0] * len(results)
    results = call_p.bind(*_align(arrays, axes, size), operator=operator, order=order, with_status=with_status)
    return results, [0] * len(results)


batching.primitive_batchers[call_p] = _batch_call


def _pull_by_matrix(operator: Operator, x: Sequence[Any], weights: Sequence[Any]) -> Values:
    """Return J(x)T s for all inputs of the adjoint."""
    found = call(operator, Order.JACOBIAN, *x)
    sums: dict[int, Any] = {}
    for block in operator.jacobian.blocks:
        term = (spread(block, found[block.number]) * weights[block.of][..., :, None]).sum(-2)
        sums[block.by] = sums[block.by] + term if block.by in sums else term
    sizes = operator.adjoint.call.sizes
    batch = _find_batch([*sums.values(), *weights])
    return [sums.get(i, jnp.zeros((*batch, size))) for i, size in zip(operator.adjoint.inputs, sizes, strict=True)]


def _push_call(
    primals: Sequence[Any], tangents: Sequence[Any], *, operator: Operator, order: Order, with_status: bool
) -> tuple[Values, Values]:
    results = call_p.bind(*primals, operator=operator, order=order, with_status=with_status)
    n = len(operator.value.given)
    moving, weights = _move(tangents[:n]), _move(tangents[n:])
    if moving:
        operator.check_moving(tuple(moving))
    sums: dict[int, Any] = {}
    for term in (
        _push_inputs(operator, order, primals, moving) if moving else {},
        _push_weights(operator, order, primals, tangents) if weights else {},
    ):
        sums |= {k: sums[k] + x if k in sums else x for k, x in term.items()}
    return results, [sums[k] if k in sums else _zero(result) for k, result in enumerate(results)]


ad.primitive_jvps[call_p] = _push_call


def _push_weights(operator: Operator, order: Order, primals: Sequence[Any], tangents: Sequence[Any]) -> dict[int, Any]:
    """Return the change with the weights, in which adjoints are linear."""
    n = len(operator.value.given)
    changes = [jnp.zeros(jnp.shape(s)) if _is_still(t) else t for s, t in zip(primals[n:], tangents[n:], strict=True)]
    return dict(enumerate(call(operator, order, *primals[:n], *changes)))


def _push_value(operator: Operator, primals: Sequence[Any], moving: dict[int, Any]) -> dict[int, Any]:
    return dict(enumerate(push(operator, tuple(moving), *primals, *moving.values())))


def _push_jacobian(operator: Operator, primals: Sequence[Any], moving: dict[int, Any]) -> dict[int, Any]:
    """Return the change of the Jacobian's nonzeros: each row is a gradient, which changes by the result's Hessian."""
    by_result = multiply(operator.curvature.blocks, _call_by_units(operator, primals), moving)
    starts = np.cumsum([0, *operator.value.sizes])
    changes = {}
    for block in operator.jacobian.blocks:
        if block.by in by_result:
            gradients = jnp.moveaxis(by_result[block.by], 0, -2)
            changes[block.number] = gradients[..., starts[block.of] + block.rows, block.cols]
    return changes


def _push_adjoint(operator: Operator, primals: Sequence[Any], moving: dict[int, Any]) -> dict[int, Any]:
    sums = multiply(operator.curvature.blocks, call(operator, Order.ADJOINT_JACOBIAN, *primals), moving)
    return {k: sums[i] for k, i in enumerate(operator.adjoint.inputs) if i in sums}


def _push_inputs(operator: Operator, order: Order, primals: Sequence[Any], moving: dict[int, Any]) -> dict[int, Any]:
    """Return the change of a call with its inputs."""
    pushes = {Order.VALUE: _push_value, Order.JACOBIAN: _push_jacobian, Order.ADJOINT: _push_adjoint}
    if order not in pushes:
        raise ArgumentError(f"{operator.name}: a third derivative is taken; kernels have first and second derivatives")
    return pushes[order](operator, primals, moving)


def _pull_call(cotangents: Sequence[Any], *arrays: Any, operator: Operator, order: Order, with_status: bool) -> Values:  # noqa: ARG001
    """Return the cotangents of weights, in which adjoints are linear."""
    n = len(operator.value.given)
    x, weights = arrays[:n], arrays[n:]
    if order is Order.ADJOINT:
        moving = {i: ct for i, ct in zip(operator.adjoint.inputs, cotangents, strict=True) if not _is_still(ct)}
        found = push(operator, tuple(moving), *x, *moving.values()) if moving else None
    else:
        found = _pull_curvature(operator, x, cotangents)
    return [None] * n + [
        _fit(found[k], s.aval.shape) if found is not None and ad.is_undefined_primal(s) else None
        for k, s in enumerate(weights)
    ]


ad.primitive_transposes[call_p] = _pull_call


def _pull_curvature(operator: Operator, x: Sequence[Any], cotangents: Sequence[Any]) -> Values:
    found = _call_by_units(operator, x)
    terms = [(h * ct).sum(-1) for h, ct in zip(found, cotangents, strict=True) if not _is_still(ct)]
    whole = jnp.moveaxis(sum(terms[1:], terms[0]), 0, -1)
    return jnp.split(whole, np.cumsum(operator.value.sizes)[:-1], axis=-1)


# --- rules of J(x) dx ----------------------------------------------------------------------------------------------


def _shape_push(*arrays: Any, operator: Operator, moving: tuple[int, ...]) -> Values:  # noqa: ARG001
    batch = _find_batch(arrays)
    return [jax.core.ShapedArray((*batch, size), np.dtype(np.float64)) for size in operator.value.sizes]


push_p.def_abstract_eval(_shape_push)


def _write_push(*arrays: Any, operator: Operator, moving: tuple[int, ...]) -> Values:
    return _push_by_matrix(operator, moving, *arrays)


mlir.register_lowering(push_p, mlir.lower_fun(_write_push, multiple_results=True))


def _batch_push(
    arrays: Sequence[Any], axes: Sequence[int | None], *, operator: Operator, moving: tuple[int, ...]
) -> tuple[Values, list[int]]:
    size, n = _size(arrays, axes), len(operator.value.given)
    aligned = _align(arrays, axes, size)
    if all(axis is None for axis in axes[:n]):  # many directions at one state
        found = _push_by_matrix(operator, moving, *arrays[:n], *_front(arrays[n:], axes[n:]))
        results = _widen(found, _find_batch(aligned))
    else:
        results = push(operator, moving, *aligned)
    return results, [0] * len(results)


batching.primitive_batchers[push_p] = _batch_push


def _push_push(
    primals: Sequence[Any], tangents: Sequence[Any], *, operator: Operator, moving: tuple[int, ...]
) -> tuple[Values, Values]:
    results, n = push(operator, moving, *primals), len(operator.value.given)
    changing, turning = _move(tangents[:n]), _move(tangents[n:])
    sums: dict[int, Any] = {}
    if changing:
        operator.check_moving(tuple(changing))
        changes = _push_jacobian(operator, primals[:n], changing)
        blocks = [block for block in operator.jacobian.blocks if block.number in changes]
        found = [changes.get(k) for k in range(len(operator.jacobian.call.wanted))]
        sums = multiply(blocks, found, dict(zip(moving, primals[n:], strict=True)))
    if turning:
        chosen = tuple(moving[k] for k in turning)
        terms = dict(enumerate(push(operator, chosen, *primals[:n], *turning.values())))
        sums = {k: sums[k] + x if k in sums else x for k, x in terms.items()}
    return results, [_fit(sums[k], r.shape) if k in sums else _zero(r) for k, r in enumerate(results)]


ad.primitive_jvps[push_p] = _push_push


def _pull_push(cotangents: Sequence[Any], *arrays: Any, operator: Operator, moving: tuple[int, ...]) -> Values:
    """Return J(x)T s, by the kernel of the adjoint."""
    n = len(operator.value.given)
    x, directions = arrays[:n], arrays[n:]
    weights = [ad.instantiate_zeros(ct) for ct in cotangents]
    found = dict(zip(operator.adjoint.inputs, call(operator, Order.ADJOINT, *x, *weights), strict=True))
    pulled = []
    for i, direction in zip(moving, directions, strict=True):
        shape = direction.aval.shape if ad.is_undefined_primal(direction) else None
        pulled.append(None if shape is None else _fit(found[i], shape) if i in found else jnp.zeros(shape))
    return [None] * n + pulled


ad.primitive_transposes[push_p] = _pull_push
