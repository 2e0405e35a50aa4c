"""Kernels in lanes: each state as if it were alone; strides, threads and memory of the caller."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cffi
import numpy as np
import pytest

from mbsgen.pipeline import Options, generate
from mbsgen.roles import Order, Role
from mbsgen.targets.contract import Family
from mbsrun import load, many
from mbsrun.kernel import ArgumentError, Array, Kernels
from tests.mbsgen.targets.guarded import guarded_tape
from tests.mbsrun.many_inputs import draw
from tests.sample import write_sample

MODELS = Path(__file__).parents[2] / "models"
ROUNDING = 2e-13  # of results relative to their largest number, where products and sums are contracted differently
# Trees, balls and free bodies, run-time and differentiated parameters, closed loops, force elements.
KINDS = {
    "double_pendulum": Options(),
    "satellite": Options(),
    "cart_pole": Options(runtime=True),
    "four_bar": Options(),
    "slider_crank": Options(),
    "five_bar": Options(derivatives=1),
}


@pytest.fixture(autouse=True)
def _always(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take lanes for any number of states; compile quickly."""
    monkeypatch.setenv("CFLAGS", "-O0")
    monkeypatch.setattr(many, "FEWEST", 1)
    monkeypatch.setattr(many, "BYTES_PER_STATE", 1e9)


@pytest.fixture(scope="module", params=KINDS)
def kernels(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Kernels:
    folder = tmp_path_factory.mktemp("kind") / request.param
    generate(MODELS / f"{request.param}.yaml", folder, KINDS[request.param])
    return load(folder)


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory: pytest.TempPathFactory) -> Kernels:
    folder = tmp_path_factory.mktemp("pendulum") / "double_pendulum"
    generate(MODELS / "double_pendulum.yaml", folder, Options())
    return load(folder)


def compute_one_by_one(kernels: Kernels, name: str, inputs: dict[str, Array]) -> tuple[dict[str, Array], Array]:
    """Compute each state by a separate call."""
    states = len(next(iter(inputs.values())))
    found = [kernels.attempt(name, **{key: x[i] for key, x in inputs.items()}) for i in range(states)]
    return {key: np.array([r[key] for r, _ in found]) for key in found[0][0]}, np.array([s for _, s in found])


def assert_equal(found: dict[str, Array], expected: dict[str, Array], tolerance: float = ROUNDING) -> None:
    assert list(found) == list(expected)
    for name, value in expected.items():
        scale = np.abs(value[np.isfinite(value)]).max(initial=1.0)
        np.testing.assert_allclose(found[name], value, rtol=0, atol=tolerance * scale, err_msg=name)


def test_every_kernel_gives_in_lanes_what_it_gives_alone(kernels: Kernels) -> None:
    """Also where states fail, or hold what is no number or far from zero; statuses are the same."""
    in_lanes = computed = 0
    for kernel in kernels.manifest.kernels:
        inputs = draw(kernel, 21, seed=3, pose=kernels.manifest.pose)
        is_short = kernel.order in (Order.VALUE, Order.LINEARISATION) or kernel.name.endswith("exp1")
        if not (inputs and is_short):  # compiling takes its time
            continue
        first = next(iter(inputs.values()))
        first[4] *= 1e7
        first[9].flat[0] = np.nan
        expected, statuses = compute_one_by_one(kernels, kernel.name, inputs)
        found, status = kernels.batch(kernel.name, **inputs)
        np.testing.assert_array_equal(status, statuses, err_msg=kernel.name)
        assert_equal(found, expected)
        loop, _ = kernels._binder.choose_loop(kernels._binder.bind(kernel.name), 21)
        in_lanes += loop.width > 1
        computed += 1
        if kernel.name == "project":  # by Newton's method, which takes different numbers of steps
            assert np.count_nonzero(status == 0) > 10
    assert in_lanes == computed


@pytest.mark.parametrize("states", [0, 1, 7, 8, 9, 16, 33])
def test_any_number_of_states(pendulum: Kernels, states: int) -> None:
    """Groups that are not full are filled up; nothing behind the arrays is written."""
    inputs = draw(pendulum.describe("jac_impl"), states)
    found, status = pendulum.batch("jac_impl", **inputs)
    assert status.tolist() == [0] * states
    if states:
        assert_equal(found, compute_one_by_one(pendulum, "jac_impl", inputs)[0])


def test_arrays_are_read_with_their_strides(pendulum: Kernels) -> None:
    """By columns, backwards, every second one, shifted by a part of a number, of other types, one for all states."""
    inputs = draw(pendulum.describe("lin_exp1"), 40)
    expected, _ = pendulum.batch("lin_exp1", **inputs)
    table = np.zeros((2 * 40, 9))
    table[::2, 1:3] = inputs["q"]
    packed = np.zeros(40, dtype=[("flag", "u1"), ("qd", "f8", (2,))])
    packed["qd"] = inputs["qd"]
    for laid in ({"q": table[::2, 1:3], "qd": np.asfortranarray(inputs["qd"])}, {"q": inputs["q"], "qd": packed["qd"]}):
        assert_equal(pendulum.batch("lin_exp1", **laid)[0], expected, tolerance=0)
    backwards = {name: array[::-1].copy()[::-1] for name, array in inputs.items()}
    assert_equal(pendulum.batch("lin_exp1", **backwards)[0], expected, tolerance=0)
    common = {**inputs, "qd": inputs["qd"][5]}
    spread = {**inputs, "qd": np.broadcast_to(inputs["qd"][5], inputs["qd"].shape)}
    assert_equal(pendulum.batch("lin_exp1", **common)[0], pendulum.batch("lin_exp1", **spread)[0], tolerance=0)
    whole = {name: np.round(array).astype(np.int16) for name, array in inputs.items()}
    widened = {name: array.astype(np.float64) for name, array in whole.items()}
    assert_equal(pendulum.batch("lin_exp1", **whole)[0], pendulum.batch("lin_exp1", **widened)[0], tolerance=0)


def test_threads_change_no_bit(pendulum: Kernels) -> None:
    inputs = draw(pendulum.describe("lin_exp2"), 1003)
    alone = pendulum.batch("lin_exp2", **inputs)[0]
    for threads in (2, 7, 2000):
        assert_equal(pendulum.batch("lin_exp2", threads=threads, **inputs)[0], alone, tolerance=0)
    with pytest.raises(ArgumentError, match="0 threads; give a whole number, 1 or more"):
        pendulum.batch("lin_exp2", threads=0, **inputs)


def test_a_failure_changes_no_bit_of_its_neighbours(tmp_path: Path) -> None:
    failing = load(write_sample(tmp_path, families=(Family(guarded_tape()),)))
    rng = np.random.default_rng(1)
    x, y = rng.uniform(1, 2, (100, 2)), rng.uniform(1, 2, (100, 3))
    whole = failing.batch("impl", x=x, y=y)[0]["f"]
    for wrong in ([13], [0, 1, 2, 3, 4, 5, 6, 7], [5, 20, 21, 99]):
        broken = y.copy()
        broken[wrong, 0] = [0.0, np.nan, -1.0, np.inf, 0.0, 0.0, 0.0, 0.0][: len(wrong)]
        found, status = failing.batch("impl", x=x, y=broken)
        bad = np.flatnonzero(status)
        assert set(bad) <= set(wrong)
        assert wrong[0] in bad
        assert np.isnan(found["f"][bad]).all()
        good = np.setdiff1d(np.arange(100), wrong)
        np.testing.assert_array_equal(found["f"][good], whole[good])


def test_results_are_written_to_the_arrays_of_the_caller(pendulum: Kernels) -> None:
    inputs = draw(pendulum.describe("jac_exp1"), 50)
    first, _ = pendulum.batch("jac_exp1", **inputs)
    kept = {name: array.copy() for name, array in first.items()}
    for array in first.values():
        array[...] = np.nan
    second, _ = pendulum.batch("jac_exp1", out=first, **inputs)
    assert all(second[name] is first[name] for name in first)
    assert_equal(second, kept, tolerance=0)
    for wrong in (
        {},
        {name: array[:-1] for name, array in first.items()},
        {name: array.astype(np.float32) for name, array in first.items()},
        {name: np.asfortranarray(array) for name, array in first.items()},
        dict.fromkeys(first),
        [first],
    ):
        with pytest.raises(ArgumentError, match=r"jac_exp1: out must hold jac_qdd_q \(50, 2, 2\), .*: C-contiguous"):
            pendulum.batch("jac_exp1", out=wrong, **inputs)


def test_results_share_no_memory_with_inputs_or_each_other(pendulum: Kernels) -> None:
    """A state's inputs could be written over before they are read."""
    inputs = draw(pendulum.describe("exp1"), 20)
    with pytest.raises(ArgumentError, match="exp1: out: qdd and q share memory; give arrays apart from all others"):
        pendulum.batch("exp1", out={"qdd": inputs["q"]}, **inputs)
    room = np.zeros(200)
    out = {"M": room[:80].reshape(20, 2, 2), "c": room[79:119].reshape(20, 2)}
    inputs = draw(pendulum.describe("semi"), 20)
    with pytest.raises(ArgumentError, match="semi: out: M and c share memory"):
        pendulum.batch("semi", out=out, **inputs)
    with pytest.raises(ArgumentError, match="semi: lanes: 'yes'; give True or False, or leave it out"):
        pendulum.batch("semi", lanes="yes", **inputs)


def test_nonzeros_are_given_alone(pendulum: Kernels) -> None:
    inputs = draw(pendulum.describe("jac_impl"), 20)
    full, nonzeros = pendulum.batch("jac_impl", **inputs)[0], pendulum.batch("jac_impl", sparse=True, **inputs)[0]
    for name, array in full.items():
        matrix = pendulum.matrix("jac_impl", name, nonzeros[name][7])
        np.testing.assert_array_equal(matrix.toarray(), array[7])


def test_a_long_kernel_is_not_compiled_again_for_few_states(pendulum: Kernels, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(many, "FEWEST", 64)
    monkeypatch.setattr(many, "BYTES_PER_STATE", 100)
    entry = pendulum._binder.bind("jac_adj1_exp1")
    size = sum((pendulum.folder / source).stat().st_size for source in entry.kernel.sources)
    assert pendulum._binder.choose_loop(entry, size // 100 - 1)[0].width == 1
    assert pendulum._binder.choose_loop(entry, size // 100 + 1)[0].width > 1


def test_newton_steps_until_the_last_state_has_its_solution(tmp_path: Path) -> None:
    """The kernel for several states is called itself: a loop would compute states alone where it fails."""
    generate(MODELS / "five_bar.yaml", tmp_path / "five_bar", Options(derivatives=0))
    kernels = load(tmp_path / "five_bar")
    entry = kernels.bind("project")
    loop, several = kernels.choose_loop("project", 100)
    assert several is not None
    width, rng = loop.width, np.random.default_rng(6)
    ffi = cffi.FFI()
    memory, arg, res = [], ffi.new("void *[]", entry.n_in), ffi.new("void *[]", entry.n_out)
    q = np.array(kernels.manifest.pose) + rng.normal(size=(width, 1)) * np.linspace(0, 0.1, width)[:, None]
    for port, pointers in [*((p, arg) for p in entry.inputs), *((p, res) for p in entry.outputs)]:
        numbers = np.zeros(port.argument.nnz * width + 16)
        start = -(numbers.ctypes.data // 8) % 16  # vectors are aligned
        lanes = numbers[start : start + port.argument.nnz * width].reshape((-1, width))
        if port.argument.role is Role.COORDINATE and pointers is arg:
            lanes[:] = q.T
        memory.append((port, lanes))
        pointers[port.position] = ffi.cast("void *", lanes.ctypes.data)
    function = ffi.cast("int (*)(void **, void **, long long *, double *, int)", several.function)
    assert function(arg, res, ffi.NULL, ffi.NULL, 0) == 0
    expected, status = kernels.attempt("project", q=q, qd=np.zeros_like(q))
    assert not status.any()
    for port, lanes in memory[len(entry.inputs) :]:
        np.testing.assert_allclose(lanes.T, expected[port.argument.name], rtol=0, atol=1e-12)


def test_lanes_are_chosen_by_the_caller(pendulum: Kernels, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    choose = many.compute

    def compute(loop: many.Loop, *arguments: Any, **options: Any) -> Any:
        asked.append(loop.width)
        return choose(loop, *arguments, **options)

    monkeypatch.setattr(many, "compute", compute)
    monkeypatch.setattr(many, "FEWEST", 1000)
    inputs = draw(pendulum.describe("impl"), 16)
    few, _ = pendulum.batch("impl", **inputs)
    found, _ = pendulum.batch("impl", lanes=True, **inputs)
    assert asked[0] == 1
    assert asked[1] > 1
    assert_equal(found, few)


def test_arguments_of_equal_shapes_are_described_once(pendulum: Kernels) -> None:
    """Calls find the description of an earlier one; arrays of other strides or numbers have their own."""
    entry = pendulum.bind("impl")
    entry.laid.clear()
    inputs = draw(entry.kernel, 5, 2)
    first = pendulum("impl", **inputs)
    others = {name: np.asfortranarray(2 * x) for name, x in inputs.items()}
    for given in (inputs, others, {name: x[:3] for name, x in inputs.items()}):
        expected, _ = compute_one_by_one(pendulum, "impl", given)
        entry.laid.clear()
        for _ in range(2):
            found = pendulum("impl", **given)
            assert all(np.allclose(found[name], x, rtol=ROUNDING, atol=0) for name, x in expected.items())
        assert [len(kept) for kept in entry.laid.values()] == [1]
    assert all(np.array_equal(pendulum("impl", **inputs)[name], x) for name, x in first.items())
    for states in range(1, 4 * many.LAID):
        pendulum("impl", **draw(entry.kernel, states))
    assert len(entry.laid) <= many.LAID + 1
