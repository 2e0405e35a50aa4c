"""The functions of a model on arrays of JAX, in any of its transformations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from mbsgen.roles import Order
from mbsrun.binding import ArgumentError
from mbsrun.faces import Face, Given
from mbsrun.jax import primitives
from mbsrun.operators import Operator

ENABLE = "jax.config.update('jax_enable_x64', True)"


class Functions(Face[Any]):
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
        return array

    def _run(self, operator: Operator, given: Given[Any], *, with_status: bool) -> tuple[Sequence[Any], Any | None]:
        results = primitives.call(operator, Order.VALUE, *given.arrays, with_status=with_status)
        return (results[:-1], results[-1]) if with_status else (results, None)

    def _take(self, array: Any, numbers: Any) -> Any:
        return primitives.take(array, numbers)

    def _merge(self, first: Any, second: Any) -> Any:
        return jnp.where(first != 0, first, second)
