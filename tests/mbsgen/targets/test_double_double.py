"""Kernels in double-double: as exact as 50 digits to 1e-28, and right where doubles keep no digit."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbsgen.model.reader import ModelWarning
from mbsgen.pipeline import Options, generate, read_tree, write_families
from mbsgen.procedure.procedure import evaluate
from mbsgen.request import Request
from mbsgen.roles import Role, name_low, name_precise
from mbsgen.tape.interpreter import DIGITS
from mbsgen.tape.ports import Function
from mbsgen.tape.types import Tape
from mbsgen.targets.c.files import write_c
from mbsgen.targets.contract import Family
from mbsgen.targets.double_double import add_double_double
from mbsgen.targets.unit import Unit
from mbsrun.kernel import KernelError, Kernels
from mbsrun.measuring.reference import Reference
from studies.laboratory.mechanisms import LOCKS, describe_lock, describe_spatial
from tests.mbsgen.targets.compilation import STRICT, run
from tests.mbsgen.targets.every_function import functions_tape
from tests.shipped import FOLDER

FORMS = ("impl", "semi", "exp1", "exp2", "energy")
BOUND = 1e-28


def write_kernels(model: Path, place: Path, functions: Sequence[str] = FORMS, **options: Any) -> Kernels:
    """Generate functions, and the same in double-double."""
    chosen = Options(functions=tuple(functions), derivatives=0, targets=("double-double",), **options)
    generate(model, place, chosen)
    return Kernels(place)


def draw(tape: Tape, seed: int) -> tuple[dict[str, Any], dict[str, list[Any]]]:
    """Draw arguments in two parts; return them, and their sums in 50 digits."""
    rng = np.random.default_rng(seed)
    high = {i.name: rng.uniform(-2, 2, i.sparsity.nnz) for i in tape.inputs}
    low = {name_low(name): values * rng.uniform(-1, 1, values.size) * 2.0**-54 for name, values in high.items()}
    sums = {name: [DIGITS.literal(float(x)) for x in values] for name, values in {**high, **low}.items()}
    whole = {name: [a + b for a, b in zip(sums[name], sums[name_low(name)], strict=True)] for name in high}
    return {**high, **low}, whole


def find_error(found: Mapping[str, Any], exact: Mapping[str, Sequence[Any]]) -> float:
    """Return the largest error, relative to the largest entry of its result."""
    worst = 0.0
    for name, values in exact.items():
        pairs = zip(np.ravel(found[name]), np.ravel(found[name_low(name)]), values, strict=True)
        errors = [abs(DIGITS.literal(float(a)) + DIGITS.literal(float(b)) - x) for a, b, x in pairs]
        worst = max(worst, float(max(errors, default=0) / max(map(abs, values), default=1)))
    return worst


def test_the_forms_of_the_arm_keep_28_digits(tmp_path: Path) -> None:
    """Against their own equations in 50 digits, at arguments with digits beyond a double; the double keeps 16."""
    model = FOLDER / "arm_pendulum.yaml"
    kernels = write_kernels(model, tmp_path / "out")
    for family in write_families(read_tree(model), Request(functions=FORMS, derivatives=0)):
        (tape,) = family.tapes
        for seed in range(3):
            arguments, whole = draw(tape, seed)
            exact = evaluate(tape, whole, DIGITS)
            assert find_error(kernels(name_precise(tape.name), sparse=True, **arguments), exact) < BOUND
            plain = {i.name: arguments[i.name] for i in tape.inputs}
            usual = kernels(tape.name, sparse=True, **plain)
            zeros = {name_low(name): 0 * value for name, value in usual.items()}
            assert find_error({**usual, **zeros}, exact) > 1e-18


def test_accelerations_are_exact_to_28_digits(tmp_path: Path) -> None:
    """Against the textbook's recursion in 50 digits, which shares no equation with the kernels."""
    model = FOLDER / "arm_pendulum.yaml"
    kernels = write_kernels(model, tmp_path / "out", ("impl", "exp1", "exp2"))
    rng = np.random.default_rng(4)
    state = {name: rng.uniform(-2, 2, size) for name, size in (("q", 6), ("qd", 6), ("qdd", 6), ("u", 4))}
    moment = Reference(model).at(state)
    given = {name: state[name] for name in ("q", "qd", "u")}
    for name in ("dd_exp1", "dd_exp2"):
        assert find_error(kernels(name, **given), {"qdd": moment.qdd}) < BOUND
    assert find_error(kernels("dd_impl", **state), {"Phi": moment.residual()}) < BOUND


@pytest.mark.parametrize("lock", LOCKS)
@pytest.mark.parametrize("distance", [1e-7, 1e-10])
def test_elimination_keeps_its_digits_near_a_lock(lock: str, distance: float, tmp_path: Path) -> None:
    """In doubles EXP1 keeps no digit there, and returns a status; condition 1/d^2 leaves 31 digits 10 at least."""
    model = tmp_path / "lock.yaml"
    model.write_text(describe_lock(LOCKS[lock]), encoding="utf-8")
    kernels = write_kernels(model, tmp_path / "out", ("exp1", "impl"))
    state = {name: np.array([0.3, 0.7, -0.4]) for name in ("q", "qd", "u")}
    state["q"][1] = (np.pi / 2 if lock == "Cardan" else 0.0) - distance
    with pytest.raises(KernelError):
        kernels.exp1(**state)
    exact = Reference(model).at({**state, "qdd": np.zeros(3)}).qdd
    assert find_error(kernels.dd_exp1(**state), {"qdd": exact}) < 100 * 2.0**-104 / distance**2


def test_elimination_keeps_its_digits_with_a_heavy_tip(tmp_path: Path) -> None:
    """Ten links, the last 1e12 times as heavy: in doubles EXP1 fails, in double-double 15 digits remain."""
    model = tmp_path / "rods.yaml"
    model.write_text(describe_spatial(10, [1.0] * 9 + [1e12]), encoding="utf-8")
    kernels = write_kernels(model, tmp_path / "out", ("exp1", "impl"))
    rng = np.random.default_rng(10)
    state = {name: rng.uniform(-1, 1, 10) for name in ("q", "qd", "u")}
    with pytest.raises(KernelError):
        kernels.exp1(**state)
    exact = Reference(model).at({**state, "qdd": np.zeros(10)}).qdd
    assert find_error(kernels.dd_exp1(**state), {"qdd": exact}) < 1e-15


def test_a_lock_is_a_status(tmp_path: Path) -> None:
    """At the lock itself no digits help: the kernel returns the joint, and stores no result."""
    model = tmp_path / "lock.yaml"
    model.write_text(describe_lock(LOCKS["wrist"]), encoding="utf-8")
    kernels = write_kernels(model, tmp_path / "out", ("exp1", "impl"))
    state = {name: np.zeros(3) for name in ("q", "qd", "u")}
    results, status = kernels.attempt("dd_exp1", **state)
    assert status == kernels.attempt("exp1", **state)[1] > 0
    assert all(np.isnan(x).all() for x in results.values())


def test_results_are_normalised_and_batches_agree(tmp_path: Path) -> None:
    """The first part of a result is the double next to it; without second parts of inputs these are 0."""
    kernels = write_kernels(FOLDER / "leg.yaml", tmp_path / "out", ("impl",))
    q = np.random.default_rng(0).uniform(-1, 1, (4, 3))
    state = {"q": q, "qd": 2 * q, "qdd": 3 * q, "u": 0 * q}
    found = kernels.dd_impl(**state)
    assert (found["Phi"] + found["low_Phi"] == found["Phi"]).all()
    zeros = {name_low(name): np.zeros(3) for name in state}
    assert (kernels.dd_impl(**state, **zeros)["low_Phi"] == found["low_Phi"]).all()
    one = {name: values[2] for name, values in state.items()}
    assert (kernels.dd_impl(**one)["low_Phi"] == found["low_Phi"][2]).all()


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_every_operation_is_printed_and_parts_agree(
    compiler: str, tmp_path: Path, requires: Callable[[str], str]
) -> None:
    """Strict C, whole or in parts of two lines; each function of a tape has its call."""
    sums = functions_tape()
    found = {}
    for part in (2, 300):
        place = tmp_path / f"part{part}"
        place.mkdir()
        written = write_c(Unit("m", "1", "hash", add_double_double([Family(sums)]), part=part))
        for name, text in written.files.items():
            (place / name).parent.mkdir(exist_ok=True)
            (place / name).write_text(text, encoding="utf-8")
        run(requires(compiler), *STRICT, "-fPIC", "-shared", "m_dd_impl.c", "-lm", "-o", "lib.so", cwd=place)
        found[part] = call_once(place / "lib.so", len(sums.outputs[0].values))
        assert ("mbs_part2" in (place / "m_dd_impl.c").read_text(encoding="utf-8")) is (part == 2)
    assert found[2] == found[300]
    x = [DIGITS.literal(0.25), DIGITS.literal(-0.75)]
    exact = evaluate(sums, {"x": x}, DIGITS)["f"]
    for (high, low), value in zip(found[2], exact, strict=True):
        assert abs(DIGITS.literal(high) + DIGITS.literal(low) - value) <= 1e-29 * abs(value)


def call_once(library: Path, size: int) -> list[tuple[float, float]]:
    """Call the kernel at x = (0.25, -0.75)."""
    import ctypes

    function = ctypes.CDLL(str(library)).m_compute_dd_impl
    high, low = (ctypes.c_double * size)(), (ctypes.c_double * size)()
    assert function((ctypes.c_double * 2)(0.25, -0.75), (ctypes.c_double * 2)(), high, low) == 0
    return list(zip(high, low, strict=True))


def test_functions_that_iterate_are_left_out_with_a_warning(tmp_path: Path) -> None:
    """Loops are closed by Newton's method; equations of motion with the forces of loops are straight-line programs."""
    options = Options(functions=("impl", "loops", "close"), derivatives=0, targets=("double-double",))
    with pytest.warns(
        ModelWarning, match="in double-double arithmetic: close is left out, as it is no straight-line program"
    ):
        generate(FOLDER / "wishbone.yaml", tmp_path / "out", options)
    names = {kernel.name for kernel in Kernels(tmp_path / "out").manifest.kernels}
    assert {"close", "impl", "dd_impl", "loops", "dd_loops"} <= names
    assert "dd_close" not in names


def test_derivatives_fall_out(tmp_path: Path) -> None:
    """Jacobians and second derivatives are straight-line programs as well, and keep 28 digits."""
    model = FOLDER / "double_pendulum.yaml"
    options = Options(functions=("exp1",), derivatives=2, targets=("double-double",))
    generate(model, tmp_path / "out", options)
    kernels = Kernels(tmp_path / "out")
    (family, *_) = write_families(read_tree(model), Request(functions=("exp1",), derivatives=2))
    for tape in family.tapes:
        arguments, whole = draw(tape, 1)
        found = kernels(name_precise(tape.name), sparse=True, **arguments)
        assert find_error(found, evaluate(tape, whole, DIGITS)) < BOUND


def test_run_time_parameters_are_computed_with(tmp_path: Path) -> None:
    """They are inputs in two parts, and no setup comes before."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        kernels = write_kernels(FOLDER / "leg.yaml", tmp_path / "out", ("impl",), runtime=True)
    kernel = kernels.describe("dd_impl")
    assert not any(a.role is Role.SETUP for a in kernel.inputs)
    values = [p.value for p in kernels.manifest.parameters]
    state = {"q": [0.1, 0.2, 0.3], "qd": [1, 2, 3], "qdd": [3, 2, 1], "u": [0, 0, 0]}
    found, usual = kernels("dd_impl", **state, p=values), kernels("impl", **state)
    assert found["Phi"] == pytest.approx(usual["Phi"], rel=1e-13)
    more = kernels("dd_impl", **state, p=values, low_p=[x * 1e-20 for x in values])
    assert not math.isclose(float(more["low_Phi"][0]), float(found["low_Phi"][0]), rel_tol=1e-6)


def test_the_check_program_leaves_them_out(tmp_path: Path, requires: Callable[[str], str]) -> None:
    """It draws all inputs alike, so second parts would be as large as the first; the folder compiles as a whole."""
    write_kernels(FOLDER / "leg.yaml", tmp_path, ("impl", "exp1", "exp2"))
    sources = sorted(path.name for path in tmp_path.glob("*.c"))
    run(requires("gcc"), "-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", *sources, "-lm", "-o", "check", cwd=tmp_path)
    report = run(tmp_path / "check")
    assert "exp1" in report
    assert "dd_" not in report


def test_other_languages_leave_them_out(tmp_path: Path) -> None:
    """Their doubles would drop the second parts in silence."""
    options = Options(functions=("impl",), derivatives=0, targets=("double-double", "python", "rust", "cpp"))
    product = generate(FOLDER / "leg.yaml", tmp_path / "out", options)
    assert "leg_dd_impl.c" in product.files
    others = [text for name, text in product.files.items() if name.endswith((".py", ".rs", ".hpp"))]
    assert others
    assert not any("dd_impl" in text for text in others)


def test_arguments_have_two_parts_in_any_numbers() -> None:
    """In 50 digits, as verification computes: the sums of both parts go in."""
    tape = functions_tape()
    (family,) = add_double_double([Family(tape)])
    given, whole = draw(tape, 3)
    exact = evaluate(tape, whole, DIGITS)
    found = evaluate(
        family.value, {name: [DIGITS.literal(float(x)) for x in values] for name, values in given.items()}, DIGITS
    )
    for name, values in exact.items():
        assert found[name] == values
        assert not any(found[name_low(name)])


def test_flops_count_operations_of_doubles() -> None:
    """x + y costs 20 and x y 13, with 4 of two fused operations."""
    from mbsgen.procedure.procedure import count
    from mbsgen.tape.builder import Builder

    builder = Builder()
    a, b = builder.vector("x", 2)
    builder.output_dense("z", [[a + b * a]])
    (family,) = add_double_double([Family(builder.build(Function("f")))])
    assert count(family.value).arithmetic == 20 + 12
    assert count(family.value).paper == 20 + 13
