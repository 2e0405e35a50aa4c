"""Kernels inside JAX: values of the NumPy face, and derivatives that differences and other transformations confirm."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbsgen.targets.contract import Family
from mbsrun import Mechanism, load
from mbsrun.kernel import ArgumentError
from tests import late
from tests.mbsgen.targets.guarded import guarded_tape
from tests.mbsrun.face_cases import CASES, draw, load_case
from tests.sample import PARAMETERS, family, write_sample

jax, jnp, testing = (late.find(name, "jax") for name in ("jax", "jax.numpy", "jax.test_util"))
faces = late.find("mbsrun.jax", "jax")


@pytest.fixture(autouse=True, scope="module")
def compute_with_doubles() -> None:
    """Compute with numbers of 64 bits."""
    jax.config.update("jax_enable_x64", True)


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Mechanism:
    """The sample with run-time parameters; one of its results is a sparse matrix."""
    return load(write_sample(tmp_path_factory.mktemp("sample")))


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Mechanism:
    """A function that fails where y0 is 0, at joint 2, and where y0 y1 is small beside y2, at joint 3."""
    return load(write_sample(tmp_path_factory.mktemp("guarded"), "guarded", (family(guarded_tape()),)))


@pytest.fixture(scope="module", params=CASES)
def case(request: pytest.FixtureRequest) -> tuple[Mechanism, str]:
    return load_case(request.param)


def as_function(face: Any, name: str, inputs: dict[str, Any]) -> Callable[..., list[Any]]:
    return lambda *arrays: list(face(name, **dict(zip(inputs, arrays, strict=True))).values())


def test_values_are_those_of_numpy(case: tuple[Mechanism, str]) -> None:
    """Bit by bit, alone and in a batch, compiled or not."""
    kernels, name = case
    for batch in ((), (7,)):
        inputs = draw(kernels, name, 1, *batch)
        face, expected = faces.load(kernels), kernels(name, **inputs)
        for found in (face(name, **inputs), jax.jit(lambda x, face=face: face(name, **x))(inputs)):
            assert found.keys() == expected.keys()
            assert all(np.array_equal(found[key], expected[key]) for key in expected)


def test_first_and_second_derivatives_are_those_of_differences(case: tuple[Mechanism, str]) -> None:
    """In all inputs at once, theta included, in every order of forward and reverse mode."""
    kernels, name = case
    inputs = draw(kernels, name, 2)
    function = as_function(faces.load(kernels), name, inputs)
    testing.check_grads(function, tuple(map(jnp.asarray, inputs.values())), order=2, modes=["fwd", "rev"])


def test_derivatives_of_a_sparse_result_with_parameters(sample: Mechanism) -> None:
    inputs = draw(sample, "impl", 3)
    for face in (faces.load(sample), faces.load(sample).with_parameters(length=0.9)):
        function = as_function(face, "impl", inputs)
        assert function(*inputs.values())[1].shape == (2, 2)
        testing.check_grads(function, tuple(map(jnp.asarray, inputs.values())), order=2)


def test_all_ways_to_a_hessian_agree(sample: Mechanism) -> None:
    """Also with a batch inside and outside of the derivative, and with arguments that all its states share."""
    face, inputs = faces.load(sample), draw(sample, "impl", 4, 5)
    x, y, z = (jnp.asarray(inputs[name]) for name in "xyz")

    def energy(x: Any, y: Any, z: Any) -> Any:
        results = face.impl(x=x, y=y, z=z)
        return jnp.sum(jnp.sin(results["f"])) + jnp.sum(results["g"] ** 2)

    both = (0, 1)
    ways = [
        jax.hessian(energy, both),
        jax.jacrev(jax.grad(energy, both), both),
        jax.jacfwd(jax.jacfwd(energy, both), both),
    ]
    expected = jax.vmap(ways[0])(x, y, z)
    whole = jax.hessian(lambda x: energy(x, y, z))(x)  # of all states: its blocks off the diagonal are 0
    np.testing.assert_allclose(np.einsum("aibj->abij", whole)[range(5), range(5)], expected[0][0], rtol=1e-11)
    for way in ways[1:]:
        for a, b in zip(jax.tree.leaves(jax.jit(jax.vmap(way))(x, y, z)), jax.tree.leaves(expected), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-11, atol=1e-11)
    shared = jax.grad(lambda y: jnp.sum(jax.vmap(energy, (0, None, 0))(x, y, z)))(y[0])
    single = sum(jax.grad(energy, 1)(x[i], y[0], z[i]) for i in range(5))
    np.testing.assert_allclose(shared, single, rtol=1e-12)


def test_batches_of_batches_are_one_call(sample: Mechanism) -> None:
    """Nested vmap, along any axis, over some of the inputs: one call in the compiled program."""
    face, inputs = faces.load(sample), draw(sample, "impl", 5, 4)
    y = np.random.default_rng(6).uniform(0.5, 1.0, (2, 3))
    nested = jax.vmap(
        jax.vmap(lambda x, y, z: face.impl(x=x, y=y, z=z)["f"], (0, None, 0)), (None, 1, None), out_axes=1
    )
    found = nested(inputs["x"], y, inputs["z"])
    assert found.shape == (4, 3, 3)
    for i, j in np.ndindex(4, 3):
        expected = sample.impl(x=inputs["x"][i], y=y[:, j], z=inputs["z"][i])["f"]
        assert np.array_equal(found[i, j], expected)
    text = jax.jit(nested).lower(inputs["x"], y, inputs["z"]).as_text()
    assert text.count("custom_call @mbs_jax") == 1


def test_a_loop_carries_states(sample: Mechanism) -> None:
    """Scan and its gradient; the reference is the same loop, written out."""
    face, y, z = faces.load(sample), np.array([0.7, 1.1]), np.zeros(1)

    def step(x: Any) -> Any:
        return x + 0.1 * face.impl(x=x, y=y, z=z)["f"]

    def scanned(x: Any) -> Any:
        return jnp.sum(jax.lax.scan(lambda x, _: (step(x), None), x, None, length=4)[0] ** 2)

    def written(x: Any) -> Any:
        return jnp.sum(step(step(step(step(x)))) ** 2)

    x = jnp.array([0.4, 0.9, 1.3])
    for way in (lambda f: f, jax.grad, jax.hessian):
        np.testing.assert_allclose(jax.jit(way(scanned))(x), way(written)(x), rtol=1e-12)


def test_a_failed_state_is_not_a_number_and_has_its_status(guarded: Mechanism) -> None:
    """In values and derivatives, beside states that succeed."""
    face = faces.load(guarded)
    x, y = np.ones((3, 2)), np.array([[2.0, 1.0, 1.0], [0.0, 1.0, 1.0], [1.0, 1e-30, 1.0]])
    results, status = jax.jit(lambda x, y: face.attempt("impl", x=x, y=y))(x, y)
    assert status.tolist() == [0, 2, 3]
    assert np.array_equal(results["f"][0], [0.5, 0.5])
    assert np.isnan(results["f"][1:]).all()
    gradient = jax.grad(lambda x, y: jnp.sum(face.impl(x=x, y=y)["f"]))(x, y)
    hessian = jax.vmap(jax.hessian(lambda y, x: jnp.sum(face.impl(x=x, y=y)["f"])))(y, x)
    assert np.array_equal(gradient[0], [0.5, 0.5])
    assert np.isnan(gradient[1:]).all()
    assert np.isfinite(hessian[0]).all()
    assert np.isnan(hessian[1:, :2, :2]).all()  # f does not depend on y2, which scales a guard alone


def test_failures_in_a_large_batch_harm_no_other_state(guarded: Mechanism) -> None:
    """Several states are computed at once, and the batch in parts: 1003 states are no multiple of either."""
    face, rng = faces.load(guarded), np.random.default_rng(8)
    x, y = rng.uniform(1, 2, (1003, 2)), rng.uniform(1, 2, (1003, 3))
    wrong = rng.choice(1003, 50, replace=False)
    y[wrong, 0] = 0.0
    results, status = face.attempt("impl", x=x, y=y)
    assert np.flatnonzero(status).tolist() == sorted(wrong)
    assert np.array_equal(np.isnan(results["f"]).any(1), status != 0)
    expected, _ = guarded.attempt("impl", x=x, y=y)
    assert np.array_equal(results["f"], expected["f"], equal_nan=True)
    single = [guarded.attempt("impl", x=x[i], y=y[i])[0]["f"] for i in range(1003)]
    np.testing.assert_allclose(results["f"], single, rtol=4 * np.finfo(float).eps)


def test_values_of_run_time_parameters_are_an_input(sample: Mechanism) -> None:
    """`p` gives each state its own; the reference is the NumPy face with these parameters."""
    face, inputs = faces.load(sample), draw(sample, "impl", 7, 2)
    p = np.array([[0.7, 2.5], [1.2, 0.3]])
    found, status = face.attempt("impl", **inputs, p=p)
    assert status.tolist() == [0, 0]
    for i in range(2):
        kernels = sample.with_parameters(**dict(zip(PARAMETERS, p[i], strict=True)))
        assert np.array_equal(found["f"][i], kernels.impl(**{k: x[i] for k, x in inputs.items()})["f"])
    assert np.array_equal(face.p, list(PARAMETERS.values()))


def test_kernels_can_be_loaded_twice(sample: Mechanism) -> None:
    """Two faces of the same folder are the same function to JAX, and nothing is compiled again."""
    first, second = (faces.load(sample.folder) for _ in range(2))
    assert first._find("impl") == second._find("impl")
    assert hash(first._find("impl")) == hash(second._find("impl"))


KEPT = """
import sys
import jax
import jax.numpy as jnp
import mbsrun.jax

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_compilation_cache_dir", sys.argv[2])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
face = mbsrun.jax.load(sys.argv[1])
print(jax.jit(lambda x: face.impl(x=x, y=jnp.ones(2), z=jnp.ones(1))["f"])(jnp.ones(3)))
"""


def test_a_program_that_is_kept_finds_its_kernel_in_another_process(sample: Mechanism, tmp_path: Path) -> None:
    """The second process reads the compiled program, whose kernel has another address, and writes none."""
    outputs, kept = [], []
    for _ in range(2):
        command = [sys.executable, "-c", KEPT, str(sample.folder), str(tmp_path)]
        outputs.append(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
        kept.append(sorted(path.name for path in tmp_path.iterdir()))
    assert kept[0] == kept[1] != []
    assert outputs[0] == outputs[1] == f"{sample.impl(x=X, y=Y, z=Z)['f']}\n"


X, Y, Z = np.ones(3), np.ones(2), np.ones(1)
MISUSES: dict[str, tuple[Callable[[Any], object], str]] = {
    "shape": (lambda f: f.impl(x=np.ones(4), y=Y, z=Z), r"impl: x: shape (4,) given, (3,) or (batch, 3) expected"),
    "all at once": (lambda f: f.impl(x=np.ones(4), y=Y, q=X), r"impl: q: there is no such input"),
    "missing": (lambda f: f.impl(x=X, y=Y), "impl: z: missing, shape (1,)"),
    "python float": (lambda f: jax.jit(lambda x: f.impl(x=x, y=Y, z=Z))(0.5), "impl: x: shape () given"),
    "single precision": (
        lambda f: f.impl(x=jnp.ones(3, jnp.float32), y=Y, z=Z),
        "impl: x: float32 given, float64 expected; convert it by astype(jnp.float64)",
    ),
    "text": (lambda f: f.impl(x="abc", y=Y, z=Z), "impl: x: not an array of real numbers"),
    "batches": (lambda f: f.impl(x=np.ones((2, 3)), y=np.ones((3, 2)), z=Z), "batches of shapes (2,), (3,)"),
    "a derivative": (lambda f: f("jac_impl", x=X, y=Y, z=Z), "jac_impl is a derivative; call impl"),
    "unknown": (lambda f: f("exp7"), "has no kernel 'exp7'"),
    "both": (lambda f: f.impl(x=X, y=Y, z=Z, p=X[:2], h=X[:2]), "p and h are given"),
    "by p": (
        lambda f: jax.grad(lambda p: f.impl(x=X, y=Y, z=Z, p=p)["f"].sum())(jnp.ones(2)),
        "no derivatives by run-time parameters (p); declare the parameter `kind: differentiated`",
    ),
    "third": (
        lambda f: jax.grad(lambda x: jax.hessian(lambda x: f.impl(x=x, y=Y, z=Z)["f"].sum())(x).sum())(jnp.ones(3)),
        "impl: a third derivative is taken",
    ),
    "traced parameter": (
        lambda f: jax.grad(lambda m: f.with_parameters(length=m).impl(x=X, y=Y, z=Z)["f"].sum())(1.0),
        "length: with_parameters takes plain numbers; give arrays of JAX as the input theta or p",
    ),
}


@pytest.mark.parametrize(("misuse", "message"), MISUSES.values(), ids=MISUSES.keys())
def test_misuse_has_one_clear_sentence(sample: Mechanism, misuse: Callable[[Any], object], message: str) -> None:
    with pytest.raises(ArgumentError) as caught:
        misuse(faces.load(sample))
    assert message in str(caught.value)


def test_single_precision_by_default_is_refused(sample: Mechanism) -> None:
    face = faces.load(sample)
    with jax.enable_x64(False), pytest.raises(ArgumentError, match="jax_enable_x64"):
        face.impl(x=X, y=Y, z=Z)


def test_an_array_on_a_gpu_is_refused(sample: Mechanism, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faces.functions, "_find_platforms", lambda _: {"gpu"})
    with pytest.raises(ArgumentError, match=r"an array on gpu given; .* or compute batches on a GPU by mbsrun.cuda"):
        faces.load(sample).impl(x=X, y=Y, z=Z)


def test_derivatives_that_are_not_generated_are_named(tmp_path: Path) -> None:
    face = faces.load(write_sample(tmp_path, "bare", (Family(guarded_tape()),)))
    with pytest.raises(ArgumentError, match="bare: impl has no generated derivatives"):
        jax.grad(lambda x: face.impl(x=x, y=X)["f"].sum())(jnp.ones(2))


def test_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "jax", None)
    monkeypatch.delitem(sys.modules, "mbsrun.jax")
    with pytest.raises(ModuleNotFoundError, match="needs JAX; run in the folder of the project"):
        import_module("mbsrun.jax")


def test_functions_describe_themselves(sample: Mechanism) -> None:
    face = faces.load(sample)
    assert repr(face).startswith("mbsrun.jax.Functions(sample: coordinates")
    assert "impl" in dir(face)
    assert "x (3,)" in str(face.impl.__doc__)
    with pytest.raises(AttributeError, match="exp7"):
        _ = face.exp7
