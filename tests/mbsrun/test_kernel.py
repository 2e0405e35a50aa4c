"""The NumPy face: the tape's values, for one state or many; misuse and failures reported; nothing else disturbed."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cffi
import numpy as np
import pytest

from mbsgen.tape.interpreter import DIGITS, evaluate
from mbsgen.tape.types import Tape
from mbsgen.targets.contract import Family
from mbsrun import load
from mbsrun.kernel import ArgumentError, KernelError, Kernels
from tests.mbsgen.targets.guarded import guarded_tape
from tests.mbsgen.targets.hostile import HOSTILE
from tests.mbsrun.sample_inputs import ROUNDING, draw, hidden
from tests.sample import PARAMETERS, sample_families, sample_tape, write_sample


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_sample(tmp_path_factory.mktemp("sample"))


@pytest.fixture(scope="module")
def k(folder: Path) -> Kernels:
    return load(folder)


def tapes() -> list[Tape]:
    own = sample_families()[1]
    return [tape for tape in (own.value, own.jac, own.adj1, own.jac_adj1) if tape is not None]


def exact(
    tape: Tape, inputs: dict[str, np.ndarray], parameters: dict[str, float] = PARAMETERS
) -> dict[str, np.ndarray]:
    """Evaluate the tape in 50 digits; expand its results."""
    given: dict[str, list[object]] = {"h": [DIGITS.literal(x) for x in hidden(parameters)]}
    for source in (i for i in tape.inputs if i.name != "h"):
        matrix = inputs[source.name].reshape((source.sparsity.rows, source.sparsity.cols))
        given[source.name] = [DIGITS.literal(matrix[place]) for place in source.sparsity.entries]
    results = {}
    for name, values in evaluate(tape, given, DIGITS).items():
        pattern = tape.output(name).sparsity
        full = np.zeros((pattern.rows, pattern.cols))
        for place, value in zip(pattern.entries, values, strict=True):
            full[place] = float(value)
        results[name] = full if name.startswith("jac_") or pattern.cols > 1 else full[:, 0]
    return results


def assert_close(found: dict[str, np.ndarray], expected: dict[str, np.ndarray], tolerance: float = ROUNDING) -> None:
    assert list(found) == list(expected)
    for name, value in expected.items():
        scale = max(1.0, np.abs(value).max(initial=0))
        np.testing.assert_allclose(found[name], value, rtol=0, atol=tolerance * scale, err_msg=name)


@pytest.mark.parametrize("tape", tapes(), ids=lambda tape: tape.name)
def test_every_kernel_computes_its_tape(k: Kernels, tape: Tape) -> None:
    inputs = draw(tape, 1)
    assert_close(k(tape.name, **inputs), exact(tape, inputs))


@pytest.mark.parametrize("tape", tapes(), ids=lambda tape: tape.name)
def test_a_batch_is_its_states(k: Kernels, tape: Tape) -> None:
    inputs = draw(tape, 2, states=5)
    found = k(tape.name, **inputs)
    for i in range(5):
        alone = k(tape.name, **{name: array[i] for name, array in inputs.items()})
        for name, value in alone.items():
            np.testing.assert_array_equal(found[name][i], value)
        batch_of_one = k(tape.name, **{name: array[i : i + 1] for name, array in inputs.items()})
        assert {name: value.shape for name, value in batch_of_one.items()} == {
            name: (1, *value.shape) for name, value in alone.items()
        }
        for name, value in alone.items():
            np.testing.assert_array_equal(batch_of_one[name][0], value)


def test_one_input_with_a_batch_axis_makes_a_batch_of_one(k: Kernels) -> None:
    """The next call without such an axis has none again."""
    inputs = draw(sample_tape(), 3)
    alone = k.impl(**inputs)
    batch = k.impl(**{**inputs, "x": inputs["x"][None]})
    again = k.impl(**inputs)
    for name, value in alone.items():
        np.testing.assert_array_equal(batch[name], value[None])
        assert again[name].shape == value.shape


def test_an_input_without_batch_axis_is_the_same_for_all_states(k: Kernels) -> None:
    inputs = draw(sample_tape(), 3)
    x = np.linspace(0.2, 1, 12).reshape((4, 3))
    found = k.impl(**{**inputs, "x": x})
    repeated = k.impl(**{name: np.tile(a, (4, 1)) for name, a in inputs.items() if name != "x"}, x=x)
    for name, value in repeated.items():
        np.testing.assert_array_equal(found[name], value)


def test_an_empty_batch_has_empty_results(k: Kernels) -> None:
    found = k.jac_impl(x=np.zeros((0, 3)), y=[1, 2], z=[0])
    assert found["jac_f_x"].shape == (0, 3, 3)
    assert found["jac_f_z"].shape == (0, 3, 1)


def test_arrays_of_any_layout_are_read_right(k: Kernels) -> None:
    inputs = draw(sample_tape(), 4, states=6)
    strange = {name: np.asfortranarray(array)[::-1] for name, array in inputs.items()}
    np.testing.assert_array_equal(k.impl(**strange)["f"][::-1], k.impl(**inputs)["f"])


def test_sparse_results_are_the_nonzeros(k: Kernels) -> None:
    inputs = draw(sample_tape(), 5)
    dense, nonzeros = k.jac_impl(**inputs), k.jac_impl(sparse=True, **inputs)
    for argument in k.manifest.kernel("jac_impl").outputs:
        expanded = np.zeros((argument.cols, argument.rows))
        colind = argument.colind or range(0, argument.nnz + 1, argument.rows)
        for c in range(argument.cols):
            rows = list(argument.row or list(range(argument.rows)) * argument.cols)[colind[c] : colind[c + 1]]
            expanded[c, rows] = nonzeros[argument.name][colind[c] : colind[c + 1]]
        np.testing.assert_array_equal(dense[argument.name], expanded.T)


def test_an_input_has_to_respect_its_pattern(k: Kernels) -> None:
    inputs = draw(tapes()[2], 6)
    inputs["adj_g"][0, 1] = 1.0
    with pytest.raises(ArgumentError, match="adj_g has entries that are not in its nonzero pattern"):
        k.adj1_impl(**inputs)


def test_all_misfits_are_told_at_once(k: Kernels) -> None:
    with pytest.raises(ArgumentError) as told:
        k.impl(x=[1, 2], y=np.zeros((2, 2, 2)), q=1)
    assert str(told.value).splitlines() == [
        "impl: q: there is no such input",
        "impl: x: shape (2,) given, (3,) or (batch, 3) expected",
        "impl: y: shape (2, 2, 2) given, (2,) or (batch, 2) expected",
        "impl: z: missing, shape (1,)",
    ]


@pytest.mark.parametrize("value", [[1j, 0, 0], ["1", "2", "3"], [[1], [2, 3]], [None, 1, 2], {"a": 1}])
def test_only_real_numbers_are_taken(k: Kernels, value: object) -> None:
    with pytest.raises(ArgumentError, match="x: not an array of real numbers"):
        k.impl(x=value, y=[1, 2], z=[0])


def test_masked_entries_have_no_numbers(k: Kernels) -> None:
    """NumPy would take what is below a mask; arrays whose masks hide nothing are arrays."""
    whole, part = np.ma.array([1.0, 2.0, 3.0]), np.ma.array([1.0, 2.0, 3.0], mask=[False, True, False])
    results = [k.impl(x=x, y=[1, 2], z=[0]) for x in (whole, whole.data)]
    assert [x.tobytes() for x in results[0].values()] == [x.tobytes() for x in results[1].values()]
    for x in (part, np.ma.stack([part, part])):
        with pytest.raises(ArgumentError, match="impl: x: some entries are masked"):
            k.impl(x=x, y=[1, 2], z=[0])


def test_words_of_batch_are_no_inputs(k: Kernels) -> None:
    with pytest.raises(ArgumentError, match="impl: threads: there is no such input; `batch` takes it"):
        k.impl(x=np.ones((2, 3)), y=[1, 2], z=[0], threads=2)


def test_batches_of_two_sizes_are_told(k: Kernels) -> None:
    with pytest.raises(ArgumentError, match=r"batches of \[2, 3\] states"):
        k.impl(x=np.ones((2, 3)), y=np.ones((3, 2)), z=[0])


def test_an_unknown_kernel_is_told(k: Kernels) -> None:
    with pytest.raises(ArgumentError, match="sample has no kernel 'gamma'; there are setup, impl, jac_impl"):
        k("gamma", x=1)
    with pytest.raises(AttributeError, match="no attribute or kernel 'gamma'"):
        k.gamma(x=1)
    assert {"impl", "jac_impl", "with_parameters"} <= set(dir(k))


def test_parameters_replace_the_defaults(k: Kernels, folder: Path) -> None:
    """As if the new values had been the model's; the kernels they came from keep their own."""
    tape, inputs = sample_tape(), draw(sample_tape(), 7)
    changed = {**PARAMETERS, "m-4": 0.5}
    assert_close(k.with_parameters(**{"m-4": 0.5}).impl(**inputs), exact(tape, inputs, changed))
    assert_close(load(folder, {"m-4": 0.5}).impl(**inputs), exact(tape, inputs, changed))
    assert_close(k.impl(**inputs), exact(tape, inputs))
    assert k.with_parameters(length=2).with_parameters(**{"m-4": 1}).parameters == {"length": 2.0, "m-4": 1.0}


def test_unknown_parameters_and_values_are_told(k: Kernels, tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="no run-time parameter mass, m4; there are length, m-4"):
        k.with_parameters(mass=1, length=2, m4=3)
    with pytest.raises(ArgumentError, match="length = nan: a parameter must be a finite number"):
        k.with_parameters(length=float("nan"))
    plain = load(write_sample(tmp_path, families=sample_families(parametric=False)))
    with pytest.raises(ArgumentError, match="no run-time parameter length; the model has none"):
        plain.with_parameters(length=1)


def test_a_failing_state_is_named(tmp_path: Path) -> None:
    """A kernel returns k > 0 where it fails at joint k; no array comes back."""
    failing = load(write_sample(tmp_path, families=(Family(guarded_tape()),)))
    y = np.ones((4, 3))
    y[2:, 1] = np.nan
    with pytest.raises(KernelError, match=r"impl failed at joint joint 2, in state 2 \(from 0\)") as told:
        failing.impl(x=[1, 1], y=y)
    assert (told.value.kernel, told.value.joint, told.value.state) == ("impl", "joint 2", 2)
    np.testing.assert_array_equal(failing.impl(x=[3, 5], y=y[:2])["f"], [[3, 5], [3, 5]])


def test_every_state_of_a_batch_can_be_attempted(tmp_path: Path) -> None:
    """Each has its status, and no number where that is not 0; the others are as if they were alone."""
    failing = load(write_sample(tmp_path, families=(Family(guarded_tape()),)))
    y = np.ones((4, 3))
    y[1, 1] = np.nan
    y[3, 0] = 0
    results, status = failing.attempt("impl", x=[3, 5], y=y)
    assert status.tolist() == [0, 3, 0, 2]
    np.testing.assert_array_equal(results["f"], [[3, 5], [np.nan] * 2, [3, 5], [np.nan] * 2])
    for i in range(4):
        alone, alone_status = failing.attempt("impl", x=[3, 5], y=y[i])
        assert (alone_status.shape, int(alone_status)) == ((), status[i])
        np.testing.assert_array_equal(alone["f"], results["f"][i])
    with pytest.raises(KernelError, match=r"impl failed at joint joint 2, in state 0"):
        failing.impl(x=[3, 5], y=y[1])


def test_derivatives_are_called_by_the_name_of_their_function(k: Kernels) -> None:
    own = sample_families()[1]
    for call, tape in ((k.jac, own.jac), (k.adj, own.adj1), (k.hess, own.jac_adj1)):
        assert tape is not None
        inputs = draw(tape, 10)
        assert_close(call("impl", **inputs), k(tape.name, **inputs), tolerance=0)
    with pytest.raises(ArgumentError, match="no kernel 'jac_setup'"):
        k.jac("setup", p=[1, 2])


def test_a_sparse_matrix_is_the_dense_one(k: Kernels) -> None:
    """Of results with a pattern, and of dense ones; weights with a pattern are read."""
    for name, tape in (("jac_impl", tapes()[1]), ("jac_adj1_impl", tapes()[3])):
        inputs = draw(tape, 11)
        dense, nonzeros = k(name, **inputs), k(name, sparse=True, **inputs)
        for key, value in dense.items():
            found = k.matrix(name, key, nonzeros[key])
            np.testing.assert_array_equal(found.toarray(), value)
            assert found.nnz == nonzeros[key].size
    with pytest.raises(ArgumentError, match="jac_impl has no result 'jac_f'; there are jac_f_x"):
        k.matrix("jac_impl", "jac_f", np.zeros(1))
    with pytest.raises(ArgumentError, match=r"jac_f_x has 7 nonzeros; an array of shape \(3,\) is given"):
        k.matrix("jac_impl", "jac_f_x", np.zeros(3))


def test_results_are_the_callers_own(k: Kernels) -> None:
    """No later call changes the results or the inputs of a call."""
    inputs = {name: array.copy() for name, array in draw(sample_tape(), 12).items()}
    first = k.impl(**inputs)
    kept = {name: value.copy() for name, value in first.items()}
    k.impl(**draw(sample_tape(), 13))
    for name, value in kept.items():
        np.testing.assert_array_equal(first[name], value)
    for name, array in draw(sample_tape(), 12).items():
        np.testing.assert_array_equal(inputs[name], array)


def test_numbers_of_other_types_are_converted(k: Kernels) -> None:
    """Whole numbers, other orders of bytes, lists; strides of any kind."""
    expected = k.impl(x=np.array([1.0, 2.0, 3.0]), y=np.array([4.0, 5.0]), z=np.zeros(1))
    for kind in (np.int64, np.uint8, ">f8", list):
        make = list if kind is list else (lambda v, kind=kind: np.array(v, dtype=kind))
        assert_close(k.impl(x=make([1, 2, 3]), y=make([4, 5]), z=make([0])), expected, tolerance=0)
    backwards = np.array([3.0, 2.0, 1.0])[::-1]
    assert_close(k.impl(x=backwards, y=[4, 5], z=[0]), expected, tolerance=0)


@pytest.mark.parametrize("kind", [np.float16, np.float32, np.longdouble])
def test_numbers_of_other_digits_are_refused(k: Kernels, kind: type) -> None:
    """In one state and in many: what was rounded before, or would be, is not taken for float64."""
    y, z = np.zeros(2), np.zeros(1)
    for x in (np.ones(3, kind), np.ones((2, 3), kind), [kind(1)] * 3):
        with pytest.raises(ArgumentError, match=rf"impl: x: {np.dtype(kind)} given, float64 expected; .*astype"):
            k.impl(x=x, y=y, z=z)
    with pytest.raises(ArgumentError, match=rf"{np.dtype(kind)} given"):
        k.batch("impl", x=np.ones((2, 3), kind), y=y, z=z)


def test_kernels_may_be_called_by_many_threads(folder: Path) -> None:
    """With different parameters, and each with different inputs."""
    lengths = [0.5 + i for i in range(4)]
    variants = [load(folder, {"length": length}) for length in lengths]
    shared = load(folder)
    states = draw(sample_tape(), 14, states=400)

    def call(which: int) -> list[np.ndarray]:
        k = variants[which % 4] if which < 4 else shared.with_parameters(length=lengths[which % 4])
        return [k.impl(**{name: array[i] for name, array in states.items()})["f"] for i in range(400)]

    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(call, range(8)))
    for which in range(8):
        np.testing.assert_array_equal(found[which], variants[which % 4].impl(**states)["f"])


def test_null_means_zeros_in_and_not_wanted_out(k: Kernels) -> None:
    """CasADi's contract, for every kernel: any arg[k] and any res[k] may be NULL."""
    ffi = cffi.FFI()
    for kernel in k.manifest.kernels:
        ffi.cdef(f"int {kernel.symbol}(const double **, double **, long long *, double *, int);")
        ffi.cdef(f"long long {kernel.symbol}_n_in(void); long long {kernel.symbol}_n_out(void);")
    lib = ffi.dlopen(str(k.compile(*(kernel.name for kernel in k.manifest.kernels))))
    for kernel in k.manifest.kernels:
        function = getattr(lib, kernel.symbol)
        n_in, n_out = (getattr(lib, kernel.symbol + end)() for end in ("_n_in", "_n_out"))
        nothing, zeros = ffi.new("const double *[]", n_in), ffi.new("double[]", 64)
        given = ffi.new("const double *[]", [zeros] * n_in)
        assert function(nothing, ffi.new("double *[]", n_out), ffi.NULL, ffi.NULL, 0) == 0
        results = []
        for arg in (given, nothing):
            blocks = [ffi.new("double[]", [7.0] * 64) for _ in range(n_out)]
            assert function(arg, ffi.new("double *[]", blocks), ffi.NULL, ffi.NULL, 0) == 0
            results.append([list(block) for block in blocks])
        np.testing.assert_array_equal(*results)


def test_no_kernel_writes_beyond_its_results(k: Kernels) -> None:
    """The place after the last nonzero of each block keeps what was there."""
    ffi = cffi.FFI()
    symbol = "jac_adj1_sample_impl"
    ffi.cdef(f"int {symbol}(const double **, double **, long long *, double *, int); long long {symbol}_n_out(void);")
    ffi.cdef(f"const long long *{symbol}_sparsity_out(long long); long long {symbol}_n_in(void);")
    lib = ffi.dlopen(str(k.compile("jac_adj1_impl")))
    n_in, n_out = getattr(lib, f"{symbol}_n_in")(), getattr(lib, f"{symbol}_n_out")()
    blocks = [ffi.new("double[]", [7.0] * 64) for _ in range(n_out)]
    arg = ffi.new("const double *[]", n_in)
    assert getattr(lib, symbol)(arg, ffi.new("double *[]", blocks), ffi.NULL, ffi.NULL, 0) == 0
    for i, block in enumerate(blocks):
        pattern = getattr(lib, f"{symbol}_sparsity_out")(i)
        rows, cols, first = pattern[0], pattern[1], pattern[2]
        nnz = rows * cols if first == 1 else pattern[2 + cols]
        assert list(block[nnz:64]) == [7.0] * (64 - nnz)


def test_denormals_of_the_host_survive(k: Kernels) -> None:
    """F14: a library linked with fast-math would have switched them off in this process."""
    k.impl(x=[1, 1, 1], y=[1, 1], z=[0])
    tiny = np.array([1e-310])
    assert float(tiny[0]) * 0.5 != 0.0
    assert (tiny * 0.5)[0] != 0.0


@pytest.mark.parametrize("flags", ["-O0 -ffp-contract=off", "-O2 -ffp-contract=on", "-O1 -mtune=native"])
def test_flags_change_no_more_than_rounding(
    flags: str, k: Kernels, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CFLAGS", flags)
    other = load(folder)
    assert other.compile("impl") != k.compile("impl")
    for tape in tapes():
        inputs = draw(tape, 8, states=20)
        assert_close(other(tape.name, **inputs), k(tape.name, **inputs), tolerance=2 * ROUNDING)


def test_models_of_any_name_work_side_by_side(tmp_path: Path) -> None:
    """Each folder has its own literals; none answers for another."""
    names = ["gamma", "sin", "int", "jac_arm", "../../x", "*/ x /*", "a\nb", "机械臂", "$(id)", "a" * 300]
    assert set(names[:4]) < {*HOSTILE, "gamma", "sin", "int"}
    inputs = draw(sample_tape(), 9)
    for i, name in enumerate(names):
        folder = write_sample(tmp_path / str(i), name, sample_families())
        found = load(folder, {"length": 1.0 + i})
        assert_close(found.impl(**inputs), exact(sample_tape(), inputs, {**PARAMETERS, "length": 1.0 + i}))


DISAGREE = "the manifest and the C files disagree"
MISFITS = {
    "libm's": (("symbol",), "gamma", r"names \['gamma'\], which cannot be its C functions"),
    "absent": (("symbol",), "sample_absent", DISAGREE),
    "size": (("inputs", 0, "rows"), 2, DISAGREE),  # memory would be read beyond the caller's array
    "pattern": (("outputs", 1, "row"), [0, 1, 0], DISAGREE),
    "name": (("outputs", 0, "name"), "e", DISAGREE),
}


@pytest.mark.parametrize(("path", "value", "told"), MISFITS.values(), ids=MISFITS)
def test_a_manifest_that_does_not_fit_its_library_is_told(
    path: tuple[str | int, ...], value: object, told: str, tmp_path: Path
) -> None:
    folder = write_sample(tmp_path, families=sample_families(parametric=False))
    manifest = json.loads((folder / "manifest.json").read_text())
    place = manifest["kernels"][0]
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    (folder / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(ArgumentError, match=told):
        load(folder)(manifest["kernels"][0]["name"], x=[1, 1, 1], y=[1, 1], z=[0])


def test_each_state_of_a_batch_may_have_its_parameters(k: Kernels) -> None:
    """A batch of `setup` gives `h` for each state, as a loop over objects with these parameters computes."""
    values = np.array(list(k.parameters.values()))
    batch = values * np.array([[1.0], [1.1], [0.9]])
    h = k.setup(p=batch)["h"]
    given = draw(sample_tape(), 3, states=3)
    found = k("impl", **given, h=h)
    for i, row in enumerate(batch):
        own = k.with_parameters(**dict(zip(k.parameters, map(float, row), strict=True)))
        state = {name: array[i] for name, array in given.items()}
        alone, by_hand = own("impl", **state), k("impl", **state, h=h[i])
        for name, array in found.items():
            np.testing.assert_array_equal(array[i], alone[name])
            np.testing.assert_array_equal(by_hand[name], alone[name])
    with pytest.raises(ArgumentError, match=r"impl: h: shape \(1,\) given"):
        k("impl", **given, h=[1.0])
