"""The price of calling kernels inside JAX and PyTorch, and steps a second beside MuJoCo and MJX.

python -m benchmarks.learning [--quick] prints a table of ratios. A call in compiled JAX is one turn of a scan, minus an
empty turn; so it contains the kernel. A batch is compared with the same kernel, called by NumPy's face; all allocate
their results. All programs integrate the same cart-pole by RK4, in float64. `--quick` leaves MJX out, which compiles
for minutes.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import torch
from mujoco import rollout

import mbsrun.jax
import mbsrun.torch
from benchmarks.compilation import describe_machine
from mbsrun import Mechanism, load
from mbsrun.models import Extent

MODELS = Path(__file__).parents[1] / "models"
FUNCTIONS = {"cart_pole": "exp1", "arm_pendulum": "impl"}
BATCH, TURNS, ROUNDS = 4096, 2000, 15
CARTS, STEPS, H = 512, 100, 0.01
CART_POLE = """
<mujoco>
  <option timestep="0.01" integrator="RK4"><flag constraint="disable"/></option>
  <worldbody>
    <body>
      <joint name="cart" type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1e-9 1e-9 1e-9"/>
      <body>
        <joint name="pole" type="hinge" axis="0 -1 0"/>
        <inertial pos="0 0 -0.5" mass="0.3" diaginertia="1e-9 1e-9 1e-9"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="cart"/></actuator>
</mujoco>
"""


@dataclass(frozen=True)
class Line:
    """A line of the table."""

    name: str
    value: float
    unit: str
    aim: str = ""

    def __str__(self) -> str:
        return f"{self.name:<58}{self.value:>12,.2f} {self.unit:<16}{self.aim}"


def measure(*functions: Callable[[], Any]) -> list[float]:
    """Return the shortest time of each function [s], called in turn."""
    for function in functions:
        function()
    times = [[float("inf")] for _ in functions]
    for _ in range(ROUNDS):
        for function, own in zip(functions, times, strict=True):
            begin = time.perf_counter()
            function()
            own.append(time.perf_counter() - begin)
    return [min(own) for own in times]


def draw(kernels: Mechanism, name: str, *batch: int) -> dict[str, Any]:
    """Draw inputs."""
    rng = np.random.default_rng(0)
    return {a.name: rng.uniform(-1, 1, (*batch, a.rows)) for a in kernels.describe(name).inputs if a.nnz}


def measure_calls(model: str, name: str) -> list[Line]:
    """Measure one call, a batch and its gradient."""
    kernels = load(MODELS / f"{model}.yaml", extent=Extent((name,)))
    inside, tensors = mbsrun.jax.load(kernels), mbsrun.torch.load(kernels)
    one, many = draw(kernels, name), draw(kernels, name, BATCH)
    result = kernels.describe(name).outputs[0].name

    def turn(call: bool) -> Any:
        def body(q: Any, _: Any) -> tuple[Any, None]:
            found = inside(name, **{**one, "q": q})[result] if call else jnp.asarray(one["qd"])
            return q + 1e-9 * found[: q.shape[0]], None

        return jax.jit(lambda q: jax.lax.scan(body, q, None, length=TURNS)[0])

    q, arrays = jnp.asarray(one["q"]), {key: jnp.asarray(x) for key, x in many.items()}
    calls = [turn(True), turn(False)]
    busy, idle = measure(*(lambda f=f: f(q).block_until_ready() for f in calls))

    batch = jax.jit(lambda x: inside(name, **x)[result])
    slope = jax.jit(jax.grad(lambda x: inside(name, **x)[result].sum()))
    seeds: dict[str, Any] = {f"adj_{a.name}": np.ones((BATCH, a.rows)) for a in kernels.describe(name).outputs}
    adjoint = f"adj1_{name}"
    given = {key: torch.from_numpy(x) for key, x in many.items()}
    with torch.no_grad():
        ours, plain, ours_slope, plain_slope, torches = measure(
            lambda: batch(arrays).block_until_ready(),
            lambda: kernels.batch(name, **many),
            lambda: jax.block_until_ready(slope(arrays)),
            lambda: kernels.batch(adjoint, **many, **seeds),
            lambda: tensors(name, **given),
        )
        single = {key: torch.from_numpy(x) for key, x in one.items()}
        (alone,) = measure(lambda: [tensors(name, **single) for _ in range(100)])
    title = f"{name} of {model}"
    return [
        Line(f"{title}: a call in compiled JAX", (busy - idle) / TURNS * 1e6, "us", "aim: 2 at most"),
        Line(f"{title}: {BATCH} states in JAX / NumPy", ours / plain, "times", "aim: 1.05 at most"),
        Line(f"{title}: {BATCH} gradients in JAX / NumPy's adjoint", ours_slope / plain_slope, "times"),
        Line(f"{title}: {BATCH} states in PyTorch / NumPy", torches / plain, "times", "aim: 1.05 at most"),
        Line(f"{title}: a call in PyTorch, not compiled", alone / 100 * 1e6, "us"),
    ]


def measure_steps() -> list[Line]:
    """Measure rollouts, and their gradients by the start."""
    carts = mbsrun.jax.load(load(MODELS / "cart_pole.yaml", extent=Extent(("exp1",))))
    q = jnp.tile(jnp.array([0.0, 0.3]), (CARTS, 1))

    def end(q: Any) -> Any:
        return carts.rollout(q, jnp.zeros_like(q), H, steps=STEPS, u=jnp.zeros(1))[0][-1]

    forward, backward = jax.jit(end), jax.jit(jax.grad(lambda q: end(q).sum()))
    model = mujoco.MjModel.from_xml_string(CART_POLE)
    memory, start = mujoco.MjData(model), np.zeros((CARTS, 5))
    start[:, 2] = 0.3
    still = np.zeros((CARTS, STEPS, 1))
    ours, slope, theirs = measure(
        lambda: forward(q).block_until_ready(),
        lambda: backward(q).block_until_ready(),
        lambda: rollout.rollout(model, memory, start, still),
    )
    found = rollout.rollout(model, memory, start, still)[0][0, -1, 1:3]
    assert np.allclose(forward(q)[0], found, atol=1e-6), "the programs integrate different mechanisms"
    millions = CARTS * STEPS / 1e6
    return [
        Line("cart-pole, RK4: steps in JAX", millions / ours, "million/s"),
        Line("cart-pole, RK4: steps with their gradient in JAX", millions / slope, "million/s"),
        Line("cart-pole, RK4: MuJoCo's rollout, one thread", millions / theirs, "million/s"),
        Line("steps / MuJoCo's", theirs / ours, "times"),
    ]


def measure_mjx() -> list[Line]:
    """Measure the same in MJX."""
    from mujoco import mjx

    model = mujoco.MjModel.from_xml_string(CART_POLE)
    on_device, data = mjx.put_model(model), mjx.make_data(model)
    q = jnp.tile(jnp.array([0.0, 0.3]), (CARTS, 1))

    def end(q: Any) -> Any:
        step = jax.checkpoint(lambda state, _: (mjx.step(on_device, state), None))
        return jax.lax.scan(step, data.replace(qpos=q), None, length=STEPS)[0].qpos

    forward, backward = jax.jit(jax.vmap(end)), jax.jit(jax.vmap(jax.grad(lambda q: end(q).sum())))
    theirs, slope = measure(lambda: forward(q).block_until_ready(), lambda: backward(q).block_until_ready())
    millions = CARTS * STEPS / 1e6
    return [
        Line("cart-pole, RK4: steps in MJX on the processor", millions / theirs, "million/s"),
        Line("cart-pole, RK4: steps with their gradient in MJX", millions / slope, "million/s"),
    ]


def main(arguments: Sequence[str]) -> None:
    """Measure and print."""
    jax.config.update("jax_enable_x64", True)
    print(f"{describe_machine()}; jax {jax.__version__}, torch {torch.__version__}, mujoco {mujoco.__version__}")
    for model, name in FUNCTIONS.items():
        print(*measure_calls(model, name), sep="\n")
    print(*measure_steps(), sep="\n")
    if "--quick" not in arguments:
        print(*measure_mjx(), sep="\n")


if __name__ == "__main__":
    main(sys.argv[1:])
