"""Inputs that do not fit, and machines without a GPU: one sentence each."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbsrun.cuda
from mbsgen.pipeline import Options, generate
from mbsrun.binding import ArgumentError
from mbsrun.cuda import Array, CudaError, Functions, driver, nvrtc
from tests.mbsrun.cuda.emulation import Foreign, Gpu, emulate

ON_HOST = "this ndarray lies in the memory of the host; copy it to the GPU, as by cupy.asarray"
ELSEWHERE = "it lies on GPU 1, the functions are loaded for GPU 0; copy it, or load the functions with device=1"
EXPECTED = "(3, 2) of float64, to be written, expected"
MODEL = Path(__file__).parents[3] / "models" / "double_pendulum.yaml"
needs_compiler = pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")
Make = Callable[[Gpu], Any]


@pytest.fixture(scope="module")
def gpu(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Gpu]:
    with emulate(tmp_path_factory.mktemp("gpu")) as made:
        yield made


@pytest.fixture(scope="module")
def pendulum() -> Functions:
    return mbsrun.cuda.load(MODEL)


class Tensor:
    """A tensor of PyTorch that requires a gradient."""

    @property
    def __cuda_array_interface__(self) -> object:
        raise RuntimeError("Can't get __cuda_array_interface__ on Variable that requires grad.")


def put(shape: tuple[int, ...], dtype: str = "float64", device: int = 0) -> Make:
    return lambda gpu: gpu.put(np.zeros(shape, dtype), device=device)


def on_host(gpu: Gpu) -> Foreign:
    numbers = np.zeros((3, 2))
    return Foreign(gpu.put(numbers), data=(numbers.ctypes.data, False), host=numbers)


@needs_compiler
@pytest.mark.parametrize(
    ("q", "message"),
    [
        (
            lambda _: np.zeros((3, 2)),
            f"q: {ON_HOST}",
        ),
        (lambda _: [0.0, 0.0], "q: a list is not an array on a GPU; give an array of CuPy, PyTorch or JAX"),
        (lambda _: Tensor(), "q: Can't get __cuda_array_interface__ on Variable that requires grad.; give x.detach()"),
        (on_host, "q: it lies in the memory of the host; copy it to the GPU"),
        (put((3, 3)), "q: shape (3, 3) given, (2,) or (batch, 2) expected"),
        (put((1, 3, 2)), "q: shape (1, 3, 2) given, (2,) or (batch, 2) expected"),
        (put((3, 2), "float32"), "q float32, qd float64; give all inputs in float64, or all in float32"),
        (put((3, 2), "int64"), "q int64, qd float64; give all inputs in float64, or all in float32"),
        (put((4, 2)), "the inputs have batches of [3, 4] states; give all the same number"),
        (
            put((3, 2), device=1),
            f"q: {ELSEWHERE}",
        ),
    ],
)
def test_inputs_that_do_not_fit(gpu: Gpu, pendulum: Functions, q: Make, message: str) -> None:
    with pytest.raises(ArgumentError) as found:
        pendulum.batch("exp1", q=q(gpu), qd=gpu.put(np.zeros((3, 2))))
    assert str(found.value) == f"exp1: {message}"


@needs_compiler
def test_all_faults_together(gpu: Gpu, pendulum: Functions) -> None:
    with pytest.raises(ArgumentError) as found:
        pendulum.batch("exp1", q=gpu.put(np.zeros(3)), u=1)
    assert str(found.value).splitlines() == [
        "exp1: u: there is no such input",
        "exp1: q: shape (3,) given, (2,) or (batch, 2) expected",
        "exp1: qd: missing, shape (2,)",
    ]


@needs_compiler
@pytest.mark.parametrize(
    ("out", "message"),
    [
        (lambda _: {}, "out must hold qdd (3, 2); it holds nothing"),
        (
            lambda gpu: {"qdd": gpu.put(np.zeros(2))},
            f"out qdd: (2,) of float64 given; {EXPECTED}",
        ),
        (
            lambda _: {"qdd": np.zeros((3, 2))},
            f"out qdd: {ON_HOST}",
        ),
        (
            lambda gpu: {"qdd": Foreign(x := gpu.put(np.zeros((3, 2))), data=(x.pointer, True))},
            f"out qdd: (3, 2) of float64, which is read-only given; {EXPECTED}",
        ),
        (
            lambda gpu: {"qdd": Foreign(gpu.put(np.zeros(2)), shape=(3, 2), strides=(0, 8))},
            "out qdd: some of its entries lie at one place; give an array without a stride of 0",
        ),
        (
            lambda gpu: {"qdd": gpu.put(np.zeros((3, 2)), device=1)},
            f"out qdd: {ELSEWHERE}",
        ),
    ],
)
def test_results_that_do_not_fit(gpu: Gpu, pendulum: Functions, out: Make, message: str) -> None:
    state = gpu.put(np.zeros((3, 2)))
    with pytest.raises(ArgumentError) as found:
        pendulum.batch("exp1", q=state, qd=state, out=out(gpu))
    assert str(found.value) == f"exp1: {message}"
    assert gpu.fake.fake_depth() == 0


@needs_compiler
def test_double_double_in_single_precision(gpu: Gpu, tmp_path: Path) -> None:
    generate(MODEL, tmp_path / "folder", Options(functions=("exp1",), derivatives=0, targets=("double-double",)))
    state = gpu.put(np.zeros((3, 2), "float32"))
    with pytest.raises(ArgumentError, match="dd_exp1 computes in double-double: give all inputs in float64"):
        mbsrun.cuda.load(tmp_path / "folder").batch("dd_exp1", q=state, qd=state)


@needs_compiler
def test_what_is_no_stream_or_no_device(gpu: Gpu, pendulum: Functions) -> None:
    state = gpu.put(np.zeros((3, 2)))
    with pytest.raises(ArgumentError, match="stream: a str is no stream; give a handle, or one of CuPy or PyTorch"):
        pendulum.batch("exp1", q=state, qd=state, stream="first")
    with pytest.raises(CudaError, match="there is no GPU 5: there are 2, counted from 0"):
        mbsrun.cuda.load(MODEL, device=5).batch("exp1", q=state, qd=state)


@needs_compiler
def test_a_driver_that_fails(gpu: Gpu, pendulum: Functions) -> None:
    """Its own words are passed on, and the context is left as it was."""
    state = gpu.put(np.zeros((3, 2)))
    pendulum.batch("exp1", q=state, qd=state)
    with gpu.driver.using(0):
        gpu.fake.fake_fail(2)
        with pytest.raises(CudaError, match="the GPU's driver fails in cuMemAllocAsync: out of memory"):
            gpu.driver.allocate(8, 0)
        gpu.fake.fake_fail(222)
        with pytest.raises(CudaError, match="driver is older than the compiler NVRTC"):
            gpu.driver.load(b"\0", "f")
    assert gpu.fake.fake_depth() == 0


@needs_compiler
def test_arrays_read_by_dlpack_elsewhere(gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> None:
    """NumPy reads the same numbers from the capsule, which says that they are the host's, as they are here."""
    numbers = np.arange(24.0).reshape(2, 3, 4)
    array = gpu.put(numbers, by_states=True)
    monkeypatch.setattr(Array, "__dlpack_device__", lambda _: (1, 0))
    before = gpu.fake.fake_blocks()
    read = np.from_dlpack(array)
    array.__dlpack__()  # which nobody reads
    del array
    np.testing.assert_array_equal(read, numbers)
    assert gpu.fake.fake_blocks() == before
    del read
    assert gpu.fake.fake_blocks() == before - 1


def test_a_machine_without_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    driver.find_driver.cache_clear()
    monkeypatch.setattr(driver, "LIBRARY", "libno_such_driver.so.1")
    with pytest.raises(CudaError) as found:
        mbsrun.cuda.load(MODEL).batch("exp1", q=None, qd=None)
    assert str(found.value) == (
        "there is no GPU here: libno_such_driver.so.1, the driver of NVIDIA's GPUs, cannot be loaded"
    )


def test_a_machine_without_the_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    nvrtc.find_nvrtc.cache_clear()
    monkeypatch.setattr(nvrtc, "_NAMES", ())
    monkeypatch.setattr(nvrtc, "_list_installed", lambda: iter(()))
    with pytest.raises(CudaError, match=r"NVRTC, the compiler for GPUs, is not installed; .* pip install '.\[cuda\]'"):
        nvrtc.find_nvrtc()
