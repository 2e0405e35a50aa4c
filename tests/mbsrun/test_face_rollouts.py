"""Steps and rollouts inside JAX and PyTorch: SciPy's integrator, and differences, are the references."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mbsrun import Mechanism, load
from mbsrun.kernel import ArgumentError
from mbsrun.models import Extent

MODELS = Path(__file__).parents[2] / "models"
FUNCTIONS = {
    "cart_pole": ("exp1",),
    "satellite": ("exp1", "rates"),
    "four_bar": ("exp1", "exp1_red", "close", "close_rates", "loops"),
}
HORIZON = 0.4


@cache
def load_model(name: str) -> Mechanism:
    return load(MODELS / f"{name}.yaml", extent=Extent(FUNCTIONS.get(name, ("loops",))))


def load_face(library: str, kernels: Any) -> Any:
    if library == "jax":
        jax = pytest.importorskip("jax")
        jax.config.update("jax_enable_x64", True)
        import mbsrun.jax

        return mbsrun.jax.load(kernels)
    pytest.importorskip("torch")
    import mbsrun.torch

    return mbsrun.torch.load(kernels)


def start(kernels: Mechanism) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a state with closed loops, and inputs."""
    manifest = kernels.manifest
    u = np.linspace(0.2, 0.5, len(manifest.inputs))
    if manifest.loops:
        q = np.array(manifest.pose)
        return q, kernels("close_rates", q=q, yd=np.array([3.0]))["qd"], u
    return np.linspace(0.3, 0.8, len(manifest.positions)), np.linspace(0.5, 2.0, len(manifest.coordinates)), u


def integrate(kernels: Mechanism) -> np.ndarray:
    """Return the coordinates at the end by SciPy, with all coordinates and the multipliers of loops."""
    q, qd, u = start(kernels)
    n = len(q)

    def rate(_: float, y: np.ndarray) -> np.ndarray:
        q, qd = y[:n], y[n:]
        rates = kernels("rates", q=q, qd=qd)["rate"] if kernels.manifest.quaternions else qd
        return np.concatenate([rates, kernels("exp1", q=q, qd=qd, u=u)["qdd"]])

    solution = solve_ivp(rate, (0, HORIZON), np.concatenate([q, qd]), "DOP853", rtol=1e-12, atol=1e-12)
    return np.array(solution.y[:n, -1])


@pytest.mark.parametrize("library", ["jax", "torch"])
@pytest.mark.parametrize("model", FUNCTIONS)
def test_the_error_falls_with_the_order(model: str, library: str) -> None:
    """Half the step leaves a sixteenth of rk4's error, half of Euler's, a quarter of the midpoint rule's.

    Loops stay closed to rounding, and quaternions keep their length by the midpoint rule.
    """
    kernels = load_model(model)
    face, (q, qd, u), exact = load_face(library, kernels), start(kernels), integrate(kernels)
    for method, steps, factor in (("rk4", 100, 16), ("euler", 400, 2), ("midpoint", 100, 4)):
        errors = []
        for count in (steps, 2 * steps):
            found, _ = face.rollout(q, qd, HORIZON / count, steps=count, method=method, u=u)
            assert found.shape == (count + 1, *q.shape)
            errors.append(np.abs(np.asarray(found[-1]) - exact).max())
            if kernels.manifest.loops:
                assert np.abs(kernels("loops", q=np.asarray(found))["gap"]).max() < 1e-14
            for first in kernels.manifest.quaternions if method == "midpoint" else ():
                lengths = np.linalg.norm(np.asarray(found)[:, first : first + 4], axis=1)
                np.testing.assert_allclose(lengths, lengths[0], rtol=1e-12)
        assert errors[1] < 1e-2
        assert errors[0] / errors[1] == pytest.approx(factor, rel=0.3)


@pytest.mark.parametrize("model", FUNCTIONS)
def test_rollouts_of_jax_have_the_derivatives_of_differences(model: str) -> None:
    """Of first and second order, through the start and the inputs, across a checkpoint."""
    kernels = load_model(model)
    face, (q, qd, u) = load_face("jax", kernels), start(kernels)
    check_grads = pytest.importorskip("jax.test_util").check_grads
    inputs = np.linspace(0.5, 1.5, 5)[:, None] * u

    def end(inputs: Any, qd: Any) -> Any:
        return face.rollout(q, qd, 0.05, along={"u": inputs})[0][-1]

    check_grads(
        pytest.importorskip("jax").jit(end),
        (inputs, qd if not kernels.manifest.loops else 0.0 * qd),
        order=2,
        modes=["rev"],
        rtol=1e-3,
    )


@pytest.mark.parametrize("model", FUNCTIONS)
def test_implicit_steps_have_the_derivatives_of_differences(model: str) -> None:
    """Of first and second order, though Newton's method is not differentiated; a tree in both libraries.

    Poses of loops do not move: differences would open them.
    """
    torch, kernels = pytest.importorskip("torch"), load_model(model)
    tensors, (q, qd, u) = load_face("torch", kernels), start(kernels)
    h = 0.2 if model == "cart_pole" else 0.02
    fixed, given = ((q,), (0.0 * qd, u)) if kernels.manifest.loops else ((), (q, qd, u))

    def step(face: Any, *given: Any) -> Any:
        q, qd, u = *fixed, *given
        return face.step(q, qd, h, method="midpoint", u=u)

    if model == "cart_pole":
        inside, check_grads = load_face("jax", kernels), pytest.importorskip("jax.test_util").check_grads
        check_grads(pytest.importorskip("jax").jit(partial(step, inside)), given, order=2, rtol=1e-3)
    moving = [torch.tensor(x, requires_grad=True) for x in given]
    assert torch.autograd.gradcheck(partial(step, tensors), moving)
    assert torch.autograd.gradgradcheck(partial(step, tensors), moving)


@pytest.mark.parametrize("library", ["jax", "torch"])
def test_implicit_steps_bear_stiff_springs(library: str) -> None:
    """Beside a step, the period of the shoulder's spring is short: the implicit rule keeps the amplitude, rk4 explodes.

    A state that is not a number has no solution.
    """
    kernels = load(MODELS / "design" / "lifting_arm.yaml", extent=Extent(("exp1",)))
    face = load_face(library, kernels)
    theta = np.array([0.35, 1e9, 0.0])  # length, stiffness, rest
    inputs = {"theta": theta, "u": np.zeros(2)}
    q, qd = np.array([[1e-6, 0.5], [np.nan, 0.5]]), np.zeros((2, 2))
    found = face.rollout(q, qd, 0.01, steps=20, method="midpoint", **inputs)
    explicit = face.rollout(q, qd, 0.01, steps=20, method="rk4", **inputs)
    assert np.abs(np.asarray(found[0])[:, 0, 0]).max() < 1.1e-6
    assert not np.abs(np.asarray(explicit[0])[-1, 0, 0]) < 1
    assert np.isnan(np.asarray(found[0])[1:, 1]).all()


@pytest.mark.parametrize("model", FUNCTIONS)
def test_rollouts_of_torch_have_the_derivatives_of_differences(model: str) -> None:
    kernels = load_model(model)
    torch, face = pytest.importorskip("torch"), load_face("torch", kernels)
    q, qd, u = map(torch.from_numpy, start(kernels))
    inputs = (torch.linspace(0.5, 1.5, 5, dtype=torch.float64)[:, None] * u).requires_grad_()

    def end(inputs: Any) -> Any:
        return face.rollout(q, qd, 0.05, along={"u": inputs})[0][-1]

    assert torch.autograd.gradcheck(end, inputs)
    assert torch.autograd.gradgradcheck(end, inputs)


def test_reverse_mode_keeps_the_root_of_the_steps() -> None:
    """Sixteen times the steps keep some four times the numbers."""
    jax = pytest.importorskip("jax")
    kernels = load_model("cart_pole")
    face, (q, qd, u) = load_face("jax", kernels), start(kernels)

    def count(steps: int) -> int:
        def end(q: Any) -> Any:
            return face.rollout(q, qd, 0.01, steps=steps, u=u)[0][-1]

        return sum(leaf.size for leaf in jax.tree.leaves(jax.vjp(end, q)[1]))

    assert count(1600) / count(100) < 5


@pytest.mark.parametrize("library", ["jax", "torch"])
def test_a_policy_sees_the_state_of_its_step(library: str) -> None:
    """In a batch; a loop of single steps is the reference."""
    kernels = load_model("cart_pole")
    face = load_face(library, kernels)
    q, qd = np.array([[0.1, 0.2], [0.3, -0.4]]), np.zeros((2, 2))

    def decide(number: Any, q: Any, qd: Any) -> dict[str, Any]:
        return {"u": (0.1 * number - 2 * q - qd)[..., :1]}

    found = face.rollout(q, qd, 0.02, steps=7, policy=decide)
    state = (q, qd)
    for number in range(7):
        state = face.step(*state, 0.02, **decide(number, *map(face._read, state)))
    for one, other in zip(found, state, strict=True):
        np.testing.assert_allclose(np.asarray(one[-1]), np.asarray(other), rtol=1e-13)


Q = np.zeros(2)
MISUSES: dict[str, tuple[Callable[[Any], object], str]] = {
    "method": (
        lambda f: f.step(Q, Q, 0.1, method="leapfrog", u=[0.0]),
        "method: 'leapfrog' given; there are euler, rk4, midpoint",
    ),
    "loops with quaternions": (
        lambda f: type(f)(load_model("spatial/ball_crank")).step(np.zeros(6), np.zeros(5), 0.1, u=[0.0]),
        "ball_crank: steps of driven joints, and of closed loops with quaternions, are not made",
    ),
    "dynamics": (lambda f: f.step(Q, Q, 0.1, dynamics="sensors", u=[0.0]), "sensors gives no acceleration"),
    "negative steps": (lambda f: f.rollout(Q, Q, 0.1, steps=-3, u=[0.0]), "steps: -3; give a whole number, 0 or more"),
    "half a step": (lambda f: f.rollout(Q, Q, 0.1, steps=2.5, u=[0.0]), "steps: 2.5; give a whole number, 0 or more"),
    "input twice": (
        lambda f: f.rollout(Q, Q, 0.1, u=[0.0], along={"u": np.zeros((4, 1))}),
        "u: given for all steps, and along them; give one of the two",
    ),
    "no steps": (lambda f: f.rollout(Q, Q, 0.1, u=[0.0]), "give the number of steps, or inputs along them"),
    "lengths": (
        lambda f: f.rollout(Q, Q, 0.1, steps=3, along={"u": np.zeros((4, 1))}),
        "the lengths differ: along['u'] 4, steps 3",
    ),
}


@pytest.mark.parametrize("library", ["jax", "torch"])
@pytest.mark.parametrize(("misuse", "message"), MISUSES.values(), ids=MISUSES.keys())
def test_misuse_has_one_clear_sentence(misuse: Callable[[Any], object], message: str, library: str) -> None:
    face = load_face(library, load(MODELS / "cart_pole.yaml", extent=Extent(("exp1", "sensors"))))
    with pytest.raises(ArgumentError) as caught:
        misuse(face)
    assert message in str(caught.value)
