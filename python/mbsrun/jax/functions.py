"""The functions of a model on arrays of JAX, in any of its transformations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from mbsgen.roles import Order
from mbsrun.binding import ArgumentError
from mbsrun.faces.face import Given
from mbsrun.faces.operators import Operator
from mbsrun.faces.stepping import Policy, SteppingFace, choose_slopes, divide
from mbsrun.jax import primitives

ENABLE = "jax.config.update('jax_enable_x64', True)"


class Functions(SteppingFace[Any]):
    """The functions of a model on arrays of JAX, under jit, vmap, jvp, vjp, jacfwd, jacrev, hessian and scan."""

    place = "mbsrun.jax"
    kind = "arrays of JAX"

    def _read(self, value: Any) -> Any:
        if not jax.config.jax_enable_x64:
            raise ArgumentError(f"kernels compute in float64; call {ENABLE} before arrays are made")
        try:
            array = jnp.asarray(value)
        except (TypeError, ValueError):
            raise ArgumentError(f"not an array of real numbers: {type(value).__name__}") from None
        if jnp.issubdtype(array.dtype, jnp.integer):
            array = array.astype(jnp.float64)
        if array.dtype != jnp.float64:
            raise ArgumentError(f"{array.dtype} given, float64 expected; convert it by astype(jnp.float64)")
        if elsewhere := _find_platforms(array) - {"cpu"}:
            raise ArgumentError(
                f"an array on {', '.join(elsewhere)} given; kernels run on the processor here: move it by "
                "jax.device_put(x, jax.devices('cpu')[0]), or compute batches on a GPU by mbsrun.cuda"
            )
        return array

    def _run(self, operator: Operator, given: Given[Any], *, with_status: bool) -> tuple[Sequence[Any], Any | None]:
        results = primitives.call(operator, Order.VALUE, *given.arrays, with_status=with_status)
        return (results[:-1], results[-1]) if with_status else (results, None)

    def _still(self, array: Any) -> Any:
        return jax.lax.stop_gradient(array)

    def _slope(self, name: str, inputs: Mapping[str, Any], by: Sequence[str]) -> tuple[Any, ...]:
        operator, arrays = self._lay(name, inputs)
        found = primitives.call(operator, Order.JACOBIAN, *map(jax.lax.stop_gradient, arrays))
        wide = [primitives.spread(block, found[block.number]) for block in operator.jacobian.blocks]
        return choose_slopes(operator, wide, by, jnp.zeros)

    def _solve(self, matrices: Any, vectors: Any) -> Any:
        return jnp.linalg.solve(matrices, vectors[..., None])[..., 0]

    def _keep(self, is_right: Any, array: Any) -> Any:
        return jnp.where(is_right[..., None], array, jnp.nan)

    def _take(self, array: Any, numbers: Any) -> Any:
        return primitives.take(array, numbers)

    def _merge(self, first: Any, second: Any) -> Any:
        return jnp.where(first != 0, first, second)

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
    ) -> tuple[Any, Any]:
        """Return q and qd at the start and after each of some steps, along a leading axis: see `SteppingFace`."""
        rows = {name: jnp.asarray(array) for name, array in (along or {}).items()}
        count = self._count_steps(steps, rows, inputs)

        def advance(state: tuple[Any, Any], row: tuple[Any, Mapping[str, Any]]) -> tuple[Any, Any]:
            number, given = row
            further = {} if policy is None else policy(number, *state)
            after = self.step(*state, h, method=method, dynamics=dynamics, **{**inputs, **given, **further})
            return after, after

        start = (self._read(q), self._read(qd))
        blocks, length, _ = divide(count)
        whole = (jnp.arange(count), rows)
        first = jax.tree.map(lambda a: a[: blocks * length].reshape((blocks, length, *a.shape[1:])), whole)
        state, found = jax.lax.scan(jax.checkpoint(partial(jax.lax.scan, advance)), start, first)
        _, rest = jax.lax.scan(advance, state, jax.tree.map(lambda a: a[blocks * length :], whole))

        def join(start: Any, blocks: Any, rest: Any) -> Any:
            return jnp.concatenate([start[None], blocks.reshape((-1, *start.shape)), rest])

        return join(start[0], found[0], rest[0]), join(start[1], found[1], rest[1])


def _find_platforms(array: Any) -> set[str]:
    """Return where an array lies; nothing for one that is traced."""
    return set() if isinstance(array, jax.core.Tracer) else {device.platform for device in array.devices()}
