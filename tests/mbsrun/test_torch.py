"""Kernels inside PyTorch: values of the NumPy face, and derivatives that differences and other ways confirm."""

from __future__ import annotations

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

torch, faces = late.find("torch", "torch"), late.find("mbsrun.torch", "torch")

Tensors = dict[str, Any]


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


def as_tensors(arrays: dict[str, np.ndarray], *, moving: bool = False) -> Tensors:
    return {name: torch.tensor(array, requires_grad=moving) for name, array in arrays.items()}


def as_function(face: Any, name: str, inputs: Tensors) -> Callable[..., tuple[Any, ...]]:
    return lambda *arrays: tuple(face(name, **dict(zip(inputs, arrays, strict=True))).values())


def test_values_are_those_of_numpy(case: tuple[Mechanism, str]) -> None:
    """Bit by bit, alone and in batches of one and two axes."""
    kernels, name = case
    face = faces.load(kernels)
    for batch in ((), (6,)):
        inputs = draw(kernels, name, 1, *batch)
        expected, found = kernels(name, **inputs), face(name, **as_tensors(inputs))
        assert list(found) == list(expected)
        assert all(np.array_equal(found[key], expected[key]) for key in expected)
    folded = face(name, **{key: x.reshape((2, 3, -1)) for key, x in as_tensors(inputs).items()})
    assert all(np.array_equal(folded[key].reshape(found[key].shape), found[key]) for key in found)


def test_first_and_second_derivatives_are_those_of_differences(case: tuple[Mechanism, str]) -> None:
    """In all inputs at once, theta included; alone, and in a batch that shares its first input."""
    kernels, name = case
    for batch in ((), (2,)):
        inputs = as_tensors(draw(kernels, name, 2, *batch), moving=True)
        if batch:
            inputs |= as_tensors({"q": draw(kernels, name, 3)["q"]}, moving=True)
        function = as_function(faces.load(kernels), name, inputs)
        assert torch.autograd.gradcheck(function, tuple(inputs.values()), check_forward_ad=True)
        assert torch.autograd.gradgradcheck(function, tuple(inputs.values()))


def test_derivatives_of_a_sparse_result_with_parameters(sample: Mechanism) -> None:
    inputs = as_tensors(draw(sample, "impl", 3), moving=True)
    for face in (faces.load(sample), faces.load(sample).with_parameters(length=0.9)):
        function = as_function(face, "impl", inputs)
        assert function(*inputs.values())[1].shape == (2, 2)
        assert torch.autograd.gradcheck(function, tuple(inputs.values()))
        assert torch.autograd.gradgradcheck(function, tuple(inputs.values()))


def make_energy(face: Any) -> Callable[..., Any]:
    def energy(x: Any, y: Any, z: Any) -> Any:
        results = face.impl(x=x, y=y, z=z)
        return results["f"].sin().sum() + (results["g"] ** 2).sum()

    return energy


def test_all_ways_to_a_hessian_agree(sample: Mechanism) -> None:
    """Also in a batch, along any axis, with arguments that its states share; the reference is one state at a time."""
    energy, func = make_energy(faces.load(sample)), torch.func
    inputs = as_tensors(draw(sample, "impl", 4, 5))
    x, y, z = inputs["x"], inputs["y"][0], inputs["z"]
    ways = [func.hessian(energy), func.jacrev(func.jacrev(energy)), func.jacrev(func.jacfwd(energy))]
    expected = [torch.autograd.functional.hessian(lambda a, i=i: energy(a, y, z[i]), x[i]) for i in range(5)]
    for way in ways:
        found = func.vmap(way, (1, None, 0))(x.T, y, z)
        torch.testing.assert_close(found, torch.stack(expected), rtol=1e-11, atol=1e-11)
    shared = func.grad(lambda y: func.vmap(energy, (0, None, 0))(x, y, z).sum())(y)
    torch.testing.assert_close(shared, sum(func.grad(energy, 1)(x[i], y, z[i]) for i in range(5)))


def test_forward_mode_passes_batches(sample: Mechanism) -> None:
    """Outside and inside of vmap, with run-time parameters for each state; reverse mode is the reference."""
    face, func = faces.load(sample), torch.func
    inputs, p = as_tensors(draw(sample, "impl", 9, 3)), torch.rand(3, 2, dtype=torch.float64) + 0.5
    y, z = inputs["y"], inputs["z"]

    def each(x: Any, y: Any, z: Any, p: Any) -> Any:
        return face.impl(x=x, y=y, z=z, p=p)["f"]

    direction = torch.ones_like(inputs["x"])
    slopes = func.vmap(func.jacrev(each))(inputs["x"], y, z, p)
    outside = func.jvp(lambda x: func.vmap(each)(x, y, z, p), (inputs["x"],), (direction,))[1]
    inside = func.vmap(lambda x, y, z, p, d: func.jvp(lambda x: each(x, y, z, p), (x,), (d,))[1])
    torch.testing.assert_close(outside, slopes.sum(-1))
    torch.testing.assert_close(inside(inputs["x"], y, z, p, direction), slopes.sum(-1))
    with torch.autograd.forward_ad.dual_level():
        dual = torch.autograd.forward_ad.make_dual(inputs["x"], direction)
        found = torch.autograd.forward_ad.unpack_dual(func.vmap(each)(dual, y, z, p)).tangent
    torch.testing.assert_close(found, slopes.sum(-1))


def test_compiled_functions_are_whole_graphs(sample: Mechanism) -> None:
    """Values, gradients and statuses, also of a function that was not called before."""
    face, inputs = faces.load(sample), as_tensors(draw(sample, "impl", 5, 3), moving=True)

    def energy(x: Any, y: Any, z: Any) -> Any:
        results, status = face.attempt("impl", x=x, y=y, z=z)
        return face.impl(x=x, y=y, z=z)["g"].sin().sum() + results["f"].sum() + status.sum()

    found = torch.compile(energy, fullgraph=True, backend="aot_eager")(*inputs.values())
    torch.testing.assert_close(found, energy(*inputs.values()))
    gradients = torch.autograd.grad(found, list(inputs.values()))
    for one, other in zip(gradients, torch.autograd.grad(energy(*inputs.values()), list(inputs.values())), strict=True):
        torch.testing.assert_close(one, other)


def test_the_operator_keeps_the_rules_of_operators(sample: Mechanism) -> None:
    """PyTorch's own check: schema, fake tensors, gradients, and what compilation makes of them."""
    from mbsrun.torch import calls

    operator = faces.load(sample)._find("impl")
    arrays = [torch.rand(2, port.argument.nnz, dtype=torch.float64) + 0.5 for port in operator.value.given]
    for moving in arrays[:3]:
        moving.requires_grad_()
    torch.library.opcheck(torch.ops.mbsrun.call.default, (arrays, calls.enter(operator), 0, False))


def test_a_failed_state_is_not_a_number_and_has_its_status(guarded: Mechanism) -> None:
    """In values and gradients, beside states that succeed."""
    face = faces.load(guarded)
    x = torch.ones(3, 2, dtype=torch.float64, requires_grad=True)
    y = torch.tensor([[2.0, 1.0, 1.0], [0.0, 1.0, 1.0], [1.0, 1e-30, 1.0]], dtype=torch.float64)
    results, status = face.attempt("impl", x=x, y=y)
    assert status.tolist() == [0, 2, 3]
    assert results["f"][0].tolist() == [0.5, 0.5]
    assert results["f"][1:].isnan().all()
    (gradient,) = torch.autograd.grad(results["f"].sum(), x)
    assert gradient[0].tolist() == [0.5, 0.5]
    assert gradient[1:].isnan().all()


def test_failures_in_a_large_batch_harm_no_other_state(guarded: Mechanism) -> None:
    """Several states are computed at once; 1003 states are no multiple of them."""
    face, rng = faces.load(guarded), np.random.default_rng(8)
    x, y = rng.uniform(1, 2, (1003, 2)), rng.uniform(1, 2, (1003, 3))
    y[rng.choice(1003, 50, replace=False), 0] = 0.0
    results, status = face.attempt("impl", x=torch.from_numpy(x), y=torch.from_numpy(y))
    expected, statuses = guarded.attempt("impl", x=x, y=y)
    assert np.array_equal(status, statuses)
    assert np.array_equal(results["f"], expected["f"], equal_nan=True)
    assert np.array_equal(results["f"].isnan().any(1), statuses != 0)


def test_tensors_lie_in_memory_in_any_way(sample: Mechanism) -> None:
    """Columns, parts of wider tensors, one row for all, negated views; the reference are contiguous copies."""
    face = faces.load(sample)
    for states in (0, 1, 7, 1001):
        x, y, z = (torch.from_numpy(a) for a in draw(sample, "impl", 11, states).values())
        wide = torch.cat([x, y, z], 1)
        negated = torch.complex(torch.zeros_like(x), -x).conj().imag
        ways = {
            "columns": (x.T.contiguous().T, y.T.contiguous().T, z),
            "parts": (wide[:, :3], wide[:, 3:5], wide[:, 5:]),
            "backwards": (torch.cat([x, x], 1)[:, ::2].clone(), torch.stack([y, y], 2)[..., 1], z),
            "parameters": (torch.nn.Parameter(x), y, z),
            "negated": (negated, y, z),
        }
        assert negated.is_neg()
        for given in ways.values():
            copies = [a.detach().resolve_neg().contiguous().numpy() for a in given]
            expected = sample.attempt("impl", **dict(zip("xyz", copies, strict=True)))[0]
            with torch.no_grad():
                found = face.impl(x=given[0], y=given[1], z=given[2])
            assert all(np.array_equal(found[name], expected[name]) for name in expected)
    shared = face.impl(x=x[:1].expand(1001, 3), y=y, z=z)
    assert np.array_equal(shared["f"], face.impl(x=x[0], y=y, z=z)["f"])


def test_tracing_records_calls(sample: Mechanism) -> None:
    """Under a mode of dispatch, too, where tensors keep their own type."""
    from torch.fx.experimental.proxy_tensor import make_fx

    face, inputs = faces.load(sample), as_tensors(draw(sample, "impl", 5, 3))
    graph = make_fx(lambda x, y, z: face.impl(x=x, y=y, z=z)["f"])(*inputs.values())
    other = [2 * x for x in inputs.values()]
    assert np.array_equal(graph(*other), face.impl(**dict(zip(inputs, other, strict=True)))["f"])


def test_values_of_run_time_parameters_are_an_input(sample: Mechanism) -> None:
    """`p` gives each state its own; the reference is the NumPy face with these parameters."""
    face, inputs = faces.load(sample), draw(sample, "impl", 7, 2)
    p = np.array([[0.7, 2.5], [1.2, 0.3]])
    found, status = face.attempt("impl", **as_tensors(inputs), p=torch.from_numpy(p))
    assert status.tolist() == [0, 0]
    for i in range(2):
        kernels = sample.with_parameters(**dict(zip(PARAMETERS, p[i], strict=True)))
        assert np.array_equal(found["f"][i], kernels.impl(**{k: x[i] for k, x in inputs.items()})["f"])


def ones(n: int) -> Any:
    return torch.ones(n, dtype=torch.float64)


GRADIENT = "no derivatives by run-time parameters (p); declare the parameter `kind: differentiated`"
MISUSES: dict[str, tuple[Callable[[Any], object], str]] = {
    "shape": (
        lambda f: f.impl(x=ones(2), y=ones(2), z=ones(1)),
        "impl: x: shape (2,) given, (3,) or (batch, 3) expected",
    ),
    "missing": (lambda f: f.impl(x=ones(3), y=ones(2)), "impl: z: missing, shape (1,)"),
    "single precision": (
        lambda f: f.impl(x=torch.ones(3), y=ones(2), z=ones(1)),
        "impl: x: torch.float32 given, torch.float64 expected; convert it by .double()",
    ),
    "an array of single precision": (
        lambda f: f.impl(x=np.ones(3, np.float32), y=ones(2), z=ones(1)),
        "impl: x: float32 given, float64 expected; convert it by astype(np.float64), if its digits suffice",
    ),
    "device": (
        lambda f: f.impl(x=ones(3).to("meta"), y=ones(2), z=ones(1)),
        "move it by .cpu(), or compute batches on a GPU by mbsrun.cuda",
    ),
    "sparse": (
        lambda f: f.impl(x=ones(3).to_sparse(), y=ones(2), z=ones(1)),
        "impl: x: a tensor of layout torch.sparse_coo given; convert it by .to_dense()",
    ),
    "text": (lambda f: f.impl(x="abc", y=ones(2), z=ones(1)), "impl: x: not a tensor or an array of real numbers: str"),
    "gradient by p": (lambda f: f.impl(x=ones(3), y=ones(2), z=ones(1), p=ones(2).clone().requires_grad_()), GRADIENT),
    "functional gradient by p": (
        lambda f: torch.func.grad(lambda p: f.impl(x=ones(3), y=ones(2), z=ones(1), p=p)["f"].sum())(ones(2)),
        GRADIENT,
    ),
    "forward mode by p": (
        lambda f: torch.func.jvp(lambda p: f.impl(x=ones(3), y=ones(2), z=ones(1), p=p)["f"], (ones(2),), (ones(2),)),
        GRADIENT,
    ),
    "third": (
        lambda f: torch.func.jacrev(torch.func.hessian(lambda x: f.impl(x=x, y=ones(2), z=ones(1))["f"].sum()))(
            ones(3)
        ),
        "impl: a third derivative is taken",
    ),
    "forward within forward": (
        lambda f: torch.func.jacfwd(torch.func.jacfwd(lambda x: f.impl(x=x, y=ones(2), z=ones(1))["f"]))(ones(3)),
        "PyTorch has no forward mode within forward mode",
    ),
    "older batches of gradients": (
        lambda f: torch.autograd.functional.jacobian(
            lambda x: f.impl(x=x, y=ones(2), z=ones(1))["f"], ones(3), vectorize=True
        ),
        "take torch.func.vmap, torch.func.jacrev or torch.func.jacfwd",
    ),
    "tensor for a number": (
        lambda f: f.with_parameters(length=torch.tensor(1.0)),
        "length: with_parameters takes plain numbers; give tensors as the input theta or p",
    ),
}


@pytest.mark.parametrize(("misuse", "message"), MISUSES.values(), ids=MISUSES.keys())
def test_misuse_has_one_clear_sentence(sample: Mechanism, misuse: Callable[[Any], object], message: str) -> None:
    with pytest.raises(ArgumentError) as caught:
        misuse(faces.load(sample))
    assert message in str(caught.value)


def test_kernels_of_numpy_refuse_tensors_that_require_a_gradient(sample: Mechanism) -> None:
    with pytest.raises(ArgumentError, match="x: not an array of real numbers"):
        sample.impl(x=torch.ones(3, requires_grad=True), y=[1, 2], z=[0])


def test_tensors_that_require_a_gradient_that_is_not_generated_are_refused(tmp_path: Path) -> None:
    face = faces.load(write_sample(tmp_path, "bare", (Family(guarded_tape()),)))
    x = torch.ones(2, dtype=torch.float64, requires_grad=True)
    with pytest.raises(ArgumentError, match="bare: impl has no generated derivatives"):
        face.impl(x=x, y=ones(3))
    assert face.impl(x=x.detach(), y=ones(3))["f"].tolist() == [1.0, 1.0]


def test_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "mbsrun.torch")
    with pytest.raises(ModuleNotFoundError, match="needs PyTorch; run in the folder of the project"):
        import_module("mbsrun.torch")


def test_functions_describe_themselves(sample: Mechanism) -> None:
    face = faces.load(sample)
    assert repr(face).startswith("mbsrun.torch.Functions(sample: coordinates")
    assert "x (3,)" in str(face.impl.__doc__)
