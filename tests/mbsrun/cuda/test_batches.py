"""Kernels on an emulated GPU: each state as the scalar kernel computes it alone, in any arrays, on any stream."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbsrun.cuda
from mbsgen.manifest import Kernel
from mbsgen.pipeline import Options, generate
from mbsgen.roles import Order, Role
from mbsrun import load
from mbsrun.cuda import Functions
from mbsrun.kernel import Array, Kernels
from tests.mbsrun.cuda.emulation import Foreign, Gpu, Packed, emulate
from tests.mbsrun.many_inputs import draw
from tests.random_scenes import random_model

pytestmark = pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")
MODELS = Path(__file__).parents[3] / "models"
# Trees, balls and free bodies, run-time and differentiated parameters, closed loops, force elements.
KINDS = {
    "double_pendulum": Options(),
    "satellite": Options(),
    "cart_pole": Options(runtime=True),
    "design/lifting_arm": Options(derivatives=1),
    "four_bar": Options(),
    "slider_crank": Options(derivatives=1),
    "five_bar": Options(derivatives=1),
}


@pytest.fixture(scope="module", autouse=True)
def _rounding() -> Iterator[None]:
    """Round each operation of the scalar kernels, too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CFLAGS", "-ffp-contract=off -O0")
        yield


@pytest.fixture(scope="module")
def gpu(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Gpu]:
    with emulate(tmp_path_factory.mktemp("gpu")) as made:
        yield made


@pytest.fixture(scope="module", params=KINDS)
def kernels(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Kernels:
    folder = tmp_path_factory.mktemp("kind") / "folder"
    generate(MODELS / f"{request.param}.yaml", folder, KINDS[request.param])
    return load(folder)


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory: pytest.TempPathFactory) -> Kernels:
    folder = tmp_path_factory.mktemp("pendulum") / "double_pendulum"
    generate(MODELS / "double_pendulum.yaml", folder, Options(derivatives=1))
    return load(folder)


def compute(gpu: Gpu, functions: Functions, name: str, inputs: dict[str, Array], **more: Any) -> tuple[Any, Array]:
    """Copy inputs there, and results back."""
    found, status = functions.batch(name, **{key: gpu.put(np.asarray(x)) for key, x in inputs.items()}, **more)
    return {key: x.get() for key, x in found.items()}, status.get()


def assert_same(found: dict[str, Array], expected: dict[str, Array]) -> None:
    assert list(found) == list(expected)
    for name, value in expected.items():
        np.testing.assert_array_equal(found[name], value, err_msg=name)


def is_short(kernel: Kernel) -> bool:
    """Return whether it is tested for all models: compiling takes its time."""
    return kernel.order in (Order.VALUE, Order.LINEARISATION) or kernel.name.endswith(("exp1", "impl"))


def test_every_kernel_gives_the_bits_of_the_scalar_one(gpu: Gpu, kernels: Kernels) -> None:
    """Also where states fail, or hold what is no number or far from zero; statuses are the same."""
    functions = mbsrun.cuda.load(kernels)
    failed = 0
    for kernel in kernels.manifest.kernels:
        inputs = draw(kernel, 21, seed=3, pose=kernels.manifest.pose)
        if not (inputs and is_short(kernel)):
            continue
        first = next(iter(inputs.values()))
        first[4] *= 1e7
        first[9].flat[0] = np.nan
        expected, statuses = kernels.batch(kernel.name, lanes=False, **inputs)
        found, status = compute(gpu, functions, kernel.name, inputs)
        np.testing.assert_array_equal(status, statuses, err_msg=kernel.name)
        assert_same(found, expected)
        failed += np.count_nonzero(statuses)
    assert gpu.fake.fake_depth() == 0
    assert failed or not kernels.manifest.loops


def test_a_failed_state_has_no_result(gpu: Gpu, pendulum: Kernels) -> None:
    q = np.zeros((5, 2))
    q[2] = np.nan
    found, status = compute(gpu, mbsrun.cuda.load(pendulum), "exp1", {"q": q, "qd": np.ones((5, 2))})
    assert (status != 0).tolist() == [False, False, True, False, False]
    assert np.isnan(found["qdd"]).all(axis=1).tolist() == [False, False, True, False, False]
    assert np.isfinite(found["qdd"][[0, 1, 3, 4]]).all()


@pytest.mark.parametrize("seed", range(3))
def test_random_mechanisms(gpu: Gpu, seed: int, tmp_path: Path) -> None:
    """All joints, laws, rotors, sensors, wrenches; a parameter that differs by state."""
    generate(random_model(seed, 4), tmp_path / "folder", Options(functions=("impl", "exp1", "motion"), derivatives=1))
    kernels = load(tmp_path / "folder")
    functions = mbsrun.cuda.load(kernels)
    masses = np.linspace(0.5, 2, 150)[:, None]
    prepared, status = compute(gpu, functions, "setup", {"p": masses})
    assert_same(prepared, kernels.batch("setup", p=masses)[0])
    assert not status.any()
    for name in ("impl", "lin_exp1", "motion"):
        inputs = {**draw(kernels.describe(name), 150, seed), "h": prepared["h"]}
        if kernels.describe(name).taking(Role.SETUP) is None:
            del inputs["h"]
        assert_same(compute(gpu, functions, name, inputs)[0], kernels.batch(name, lanes=False, **inputs)[0])


@pytest.mark.parametrize("states", [0, 1, 127, 128, 129])
def test_any_number_of_states(gpu: Gpu, pendulum: Kernels, states: int) -> None:
    """Nothing beside the arrays is written; no state, no launch."""
    functions = mbsrun.cuda.load(pendulum)
    inputs = draw(pendulum.describe("jac_exp1"), states)
    gpu.tell()
    found, status = compute(gpu, functions, "jac_exp1", inputs)
    assert sum("Launch" in call for call in gpu.tell()) == (states > 0)
    assert status.shape == (states,)
    assert_same(found, pendulum.batch("jac_exp1", lanes=False, **inputs)[0])
    gpu.fake.fake_blocks()


def test_a_single_state_has_no_axis_for_states(gpu: Gpu, pendulum: Kernels) -> None:
    inputs = {name: x[0] for name, x in draw(pendulum.describe("jac_exp1"), 1).items()}
    found, status = compute(gpu, mbsrun.cuda.load(pendulum), "jac_exp1", inputs)
    assert_same(found, pendulum("jac_exp1", **inputs))
    assert status.shape == ()


def test_single_precision(gpu: Gpu, pendulum: Kernels) -> None:
    """Some roundings of a float from the double results; of sines, whose errors stay below 0.9 units."""
    inputs = {name: x.astype(np.float32) for name, x in draw(pendulum.describe("lin_exp1"), 200).items()}
    found, _ = compute(gpu, mbsrun.cuda.load(pendulum), "lin_exp1", inputs)
    exact = {name: x.astype(np.float64) for name, x in inputs.items()}
    expected = pendulum.batch("lin_exp1", lanes=False, **exact)[0]
    for name, value in expected.items():
        assert found[name].dtype == np.float32
        np.testing.assert_allclose(found[name], value, rtol=0, atol=1e-5 * np.abs(value).max(initial=1), err_msg=name)


def test_double_double(gpu: Gpu, tmp_path: Path) -> None:
    """Both parts of the results; parts of inputs that are left out are 0."""
    options = Options(functions=("exp1",), derivatives=0, targets=("double-double",))
    generate(MODELS / "double_pendulum.yaml", tmp_path / "folder", options)
    kernels = load(tmp_path / "folder")
    inputs = draw(kernels.describe("dd_exp1"), 30)
    found, _ = compute(gpu, mbsrun.cuda.load(kernels), "dd_exp1", inputs)
    assert_same(found, kernels.batch("dd_exp1", **inputs)[0])


def test_nonzeros_alone(gpu: Gpu, pendulum: Kernels) -> None:
    inputs = draw(pendulum.describe("jac_sensors"), 40)
    found, _ = compute(gpu, mbsrun.cuda.load(pendulum), "jac_sensors", inputs, sparse=True)
    expected = pendulum.batch("jac_sensors", sparse=True, lanes=False, **inputs)[0]
    assert_same(found, expected)
    assert any(
        x.shape[1] < np.prod(pendulum("jac_sensors", **{k: v[0] for k, v in inputs.items()})[name].shape)
        for name, x in expected.items()
    )


def test_arrays_are_read_with_their_strides(gpu: Gpu, pendulum: Kernels) -> None:
    """By columns, backwards, every second one, one for all states; by either protocol."""
    functions = mbsrun.cuda.load(pendulum)
    inputs = draw(pendulum.describe("exp1"), 40)
    expected = pendulum.batch("exp1", lanes=False, **inputs)[0]
    q = gpu.put(inputs["q"], by_states=True)
    table = np.zeros((80, 5))
    table[::2, 1:3] = inputs["qd"]
    held = gpu.put(table)
    part = Foreign(held, shape=(40, 2), strides=(80, 8), data=(held.pointer + 8, True))
    flipped = gpu.put(inputs["q"][::-1])
    backwards = Foreign(flipped, strides=(-16, 8), data=(flipped.pointer + 39 * 16, False))
    packed = Packed(q)
    for given in (
        {"q": q, "qd": part},
        {"q": backwards, "qd": Packed(gpu.put(inputs["qd"]))},
        {"q": packed, "qd": part},
    ):
        found, _ = functions.batch("exp1", **given)
        assert_same({key: x.get() for key, x in found.items()}, expected)
    assert packed.streams == [1]
    alone, _ = functions.batch("exp1", q=q, qd=gpu.put(inputs["qd"][5]))
    common = pendulum.batch("exp1", lanes=False, q=inputs["q"], qd=inputs["qd"][5])[0]
    assert_same({key: x.get() for key, x in alone.items()}, common)
    contiguous = gpu.put(inputs["qd"])
    found, _ = functions.batch("exp1", q=q, qd=Foreign(contiguous, strides=None))
    assert_same({key: x.get() for key, x in found.items()}, expected)


def test_results_go_where_they_are_wanted(gpu: Gpu, pendulum: Kernels) -> None:
    """Zeros of matrices are written, too."""
    functions = mbsrun.cuda.load(pendulum)
    inputs = draw(pendulum.describe("jac_sensors"), 40)
    there = {name: gpu.put(x) for name, x in inputs.items()}
    expected = pendulum.batch("jac_sensors", lanes=False, **inputs)[0]
    assert any(a.row is not None for a in pendulum.describe("jac_sensors").outputs)
    out = {name: gpu.put(np.full_like(x, 7.0)) for name, x in expected.items()}
    before = gpu.fake.fake_blocks()
    found, status = functions.batch("jac_sensors", out=out, **there)
    assert gpu.fake.fake_blocks() == before + 1  # the statuses
    assert all(found[name] is out[name] for name in out)
    assert_same({name: x.get() for name, x in found.items()}, expected)
    del status
    assert gpu.fake.fake_blocks() == before


def test_states_are_neighbours_in_memory(gpu: Gpu, pendulum: Kernels) -> None:
    inputs = {name: gpu.put(x) for name, x in draw(pendulum.describe("jac_exp1"), 40).items()}
    found, _ = mbsrun.cuda.load(pendulum).batch("jac_exp1", **inputs)
    assert found["jac_qdd_q"].__cuda_array_interface__["strides"] == (8, 2 * 40 * 8, 40 * 8)


def test_streams_are_put_in_order(gpu: Gpu, pendulum: Kernels) -> None:
    """A launch waits for the streams that write its inputs; results name the launch's stream."""
    functions = mbsrun.cuda.load(pendulum)
    q, qd = (gpu.put(x) for x in draw(pendulum.describe("exp1"), 8).values())
    functions.batch("exp1", q=q, qd=qd)  # which loads it

    class Stream:
        def __init__(self, **names: Any) -> None:
            self.__dict__ |= names

    class New:
        def __cuda_stream__(self) -> tuple[int, int]:
            return 0, 77

    for stream in (77, Stream(ptr=77), Stream(cuda_stream=77), New()):
        gpu.tell()
        found, _ = functions.batch("exp1", stream=stream, q=Foreign(q, stream=5), qd=Foreign(qd, stream=77))
        calls = [call for call in gpu.tell() if "on " in call]
        assert calls == ["cuEventRecord on 5", "cuStreamWaitEvent on 77", "cuLaunchKernel on 77"]
        assert found["qdd"].__cuda_array_interface__["stream"] == 77
    found["qdd"].get()
    assert "cuStreamSynchronize 77" in gpu.tell()
    found["qdd"].__dlpack__(stream=5)
    assert [call for call in gpu.tell() if "on " in call] == ["cuEventRecord on 77", "cuStreamWaitEvent on 5"]


def test_other_values_of_parameters(gpu: Gpu, tmp_path: Path) -> None:
    """Run-time and differentiated ones, in new functions and in a call."""
    generate(MODELS / "design" / "lifting_arm.yaml", tmp_path / "folder", Options(functions=("exp1",), derivatives=0))
    kernels = load(tmp_path / "folder")
    name = next(iter(kernels.parameters))
    changed = {name: 1.5 * kernels.parameters[name] + 0.1}
    inputs = draw(kernels.describe("exp1"), 9)
    functions = mbsrun.cuda.load(tmp_path / "folder")
    for ours, theirs in (
        (functions, kernels),
        (functions.with_parameters(**changed), kernels.with_parameters(**changed)),
    ):
        assert ours.parameters == theirs.parameters
        assert_same(compute(gpu, ours, "exp1", inputs)[0], theirs.batch("exp1", lanes=False, **inputs)[0])
    loaded = mbsrun.cuda.load(kernels, changed)
    assert_same(compute(gpu, loaded, "exp1", inputs)[0], kernels.with_parameters(**changed).exp1(**inputs))


def test_a_model_file_is_generated_and_compiled_once(gpu: Gpu) -> None:
    functions = mbsrun.cuda.load(MODELS / "double_pendulum.yaml", device=1)
    assert "double_pendulum" in repr(functions)
    q = gpu.put(np.zeros(2), device=1)
    first, _ = functions.batch("exp1", q=q, qd=q)
    gpu.tell()
    second, _ = functions.batch("exp1", q=q, qd=q)
    assert not any("Module" in call for call in gpu.tell())
    assert_same({"qdd": first["qdd"].get()}, {"qdd": second["qdd"].get()})
