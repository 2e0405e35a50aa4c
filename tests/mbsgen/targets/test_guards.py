"""Guards in C: where a pivot is no more than rounding, the status is the joint's number and nothing is written."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mbsgen.tape.interpreter import find_failure
from mbsgen.targets.contract import Family
from mbsgen.targets.parts import LENGTH
from tests.mbsgen.targets.compilation import STRICT, Requires, name_in, run
from tests.mbsgen.targets.guarded import TOLERANCE, guarded_tape
from tests.sample import write_sample

STATES = {
    "sound": ([1.0, 2.0, 1.0], 0),
    "zero": ([0.0, 2.0, 1.0], 2),
    "negative": ([-1.0, 2.0, 1.0], 2),
    "not a number": ([math.nan, 2.0, 1.0], 2),
    "both": ([0.0, 0.0, 1.0], 2),
    "second": ([1.0, 0.0, 1.0], 3),
    "infinite scale": ([1.0, 2.0, math.inf], 3),
    "no scale": ([1.0, 2.0, math.nan], 3),
}


def compile_kernel(tmp_path: Path, compiler: str, *flags: str, part: int = LENGTH) -> Callable[..., int]:
    folder = write_sample(tmp_path, families=(Family(guarded_tape()),), part=part)
    library = tmp_path / "lib.so"
    run(compiler, *STRICT, *flags, "-fPIC", "-shared", folder / "sample_impl.c", "-lm", "-o", library)
    real = "float" if "-DMBS_REAL=float" in flags else "double"
    return ctypes.CDLL(str(library))[name_in(real, "sample_compute_impl")]


@pytest.mark.parametrize("length", [1000, 1])
@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_a_failed_guard_is_the_status_and_nothing_is_written(
    compiler: str, real: str, length: int, tmp_path: Path, requires: Requires
) -> None:
    """At full optimisation, with contraction; pivots of a few epsilon fail on one side of the tolerance alone."""
    flags = ("-O3", "-march=native", "-ffp-contract=fast", "-fno-math-errno", f"-DMBS_REAL={real}")
    kernel = compile_kernel(tmp_path, requires(compiler), *flags, part=length)  # as one function, or in parts
    number = np.float64 if real == "double" else np.float32
    rounding = TOLERANCE * float(np.finfo(number).eps)
    near = {"below": ([rounding, 1.0, 1.0], 2), "above": ([2 * rounding, 1.0, rounding], 0)}
    for name, (y, status) in {**STATES, **near}.items():
        x, f = np.array([3.0, 5.0], dtype=number), np.full(2, 7.0, dtype=number)
        found = kernel(*(a.ctypes.data_as(ctypes.c_void_p) for a in (x, np.array(y, dtype=number), f)))
        assert found == status, name
        expected = [7.0, 7.0] if status else [3.0 / y[0], 5.0 / (y[0] * y[1])]
        np.testing.assert_allclose(f, expected, rtol=4 * float(np.finfo(number).eps), err_msg=name)


@pytest.mark.parametrize("name", STATES)
def test_the_status_is_the_interpreters(name: str) -> None:
    y, status = STATES[name]
    assert find_failure(guarded_tape(), {"x": [3.0, 5.0], "y": y}) == status
