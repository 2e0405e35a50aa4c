"""The Panda on a GPU in frax, in MuJoCo's MJX and in MuJoCo Warp: functions that start work, and wait for it.

Each peer computes all states in one compiled call, from its own arrays on the device to others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.loops.mechanism import write_xml
from mbsgen.pipeline import read_tree

Numbers = NDArray[np.floating[Any]]
PANDA = Path(__file__).parent / "models" / "panda.yaml"
FREE = '<option><flag contact="disable" constraint="disable"/></option>'  # of contacts and limits, which there are not


@dataclass(frozen=True)
class Work:
    """A compiled call."""

    start: Callable[[], object]
    finish: Callable[[], object]
    read: Callable[[], Numbers]  # the results of the last start, a row for each state


Prepare = Callable[[str, Numbers, Numbers, Numbers], Work]  # of impl or exp2, at q, qd, and qdd or forces


def list_peers() -> Mapping[str, tuple[Prepare, tuple[str, ...]]]:
    """Return the peers that are installed and find a GPU, each with its precisions."""
    peers: dict[str, tuple[Prepare, tuple[str, ...]]] = {}
    if has_jax_gpu():
        if find_spec("frax") is not None:
            peers["frax"] = prepare_frax, ("float32", "float64")
        if find_spec("mujoco") is not None and find_spec("mujoco.mjx") is not None:
            peers["MJX"] = prepare_mjx, ("float32", "float64")
    if find_spec("mujoco_warp") is not None and import_module("warp").is_cuda_available():
        peers["MuJoCo Warp"] = prepare_warp, ("float32",)
    return peers


def has_jax_gpu() -> bool:
    """Return whether JAX is installed, and finds a GPU."""
    if find_spec("jax") is None:
        return False
    import jax

    try:
        return bool(jax.devices("gpu"))
    except RuntimeError:
        return False


def prepare_frax(function: str, q: Numbers, qd: Numbers, last: Numbers) -> Work:
    """Prepare frax's function, mapped over the states and compiled, in the precision of the arrays."""
    import jax

    jax.config.update("jax_enable_x64", q.dtype == np.float64)
    robot = import_module("frax.robots.franka_panda").load_panda()
    gravity = jax.numpy.array([0.0, 0.0, 0.0, 0.0, 0.0, 9.81], q.dtype)
    functions = {
        "impl": lambda q, v, a: robot.rnea(q, v, a, gravity, None),
        "exp2": lambda q, v, tau: robot.forward_dynamics(q, v, tau, None),
    }
    return _prepare_jax(functions[function], (q, qd, last))


def prepare_mjx(function: str, q: Numbers, qd: Numbers, last: Numbers) -> Work:
    """Prepare MJX's inverse or forward dynamics likewise."""
    import jax
    from mujoco import mjx

    jax.config.update("jax_enable_x64", q.dtype == np.float64)
    model = _make_model()
    there, data = mjx.put_model(model), mjx.make_data(model)

    def invert(q: Any, qd: Any, qdd: Any) -> Any:
        return mjx.inverse(there, data.replace(qpos=q, qvel=qd, qacc=qdd)).qfrc_inverse

    def accelerate(q: Any, qd: Any, force: Any) -> Any:
        return mjx.forward(there, data.replace(qpos=q, qvel=qd, qfrc_applied=force)).qacc

    return _prepare_jax({"impl": invert, "exp2": accelerate}[function], (q, qd, last))


def _prepare_jax(function: Callable[..., Any], arrays: tuple[Numbers, ...]) -> Work:
    import jax

    compute = jax.jit(jax.vmap(function))
    states = [jax.numpy.asarray(array) for array in arrays]
    results: list[Any] = [None]

    def start() -> None:
        results[0] = compute(*states)

    return Work(start, lambda: results[0].block_until_ready(), lambda: np.asarray(results[0]))


def prepare_warp(function: str, q: Numbers, qd: Numbers, last: Numbers) -> Work:
    """Prepare MuJoCo Warp's inverse or forward dynamics; on a GPU, its launches are one graph."""
    import mujoco_warp
    import warp

    model = _make_model()
    there, data = mujoco_warp.put_model(model), mujoco_warp.make_data(model, nworld=len(q))
    compute, field = {"impl": (mujoco_warp.inverse, "qacc"), "exp2": (mujoco_warp.forward, "qfrc_applied")}[function]
    for name, array in (("qpos", q), ("qvel", qd), (field, last)):
        getattr(data, name).assign(array)
    found = data.qfrc_inverse if function == "impl" else data.qacc
    compute(there, data)  # which compiles
    if not warp.get_device().is_cuda:
        return Work(lambda: compute(there, data), warp.synchronize, found.numpy)
    with warp.ScopedCapture() as capture:
        compute(there, data)
    return Work(lambda: warp.capture_launch(capture.graph), warp.synchronize, found.numpy)


def _make_model() -> Any:
    """Return MuJoCo's model of the Panda."""
    import mujoco

    text = write_xml(read_tree(PANDA)).replace("<worldbody>", f"{FREE}<worldbody>", 1)
    return mujoco.MjModel.from_xml_string(text)
