"""The kernels' own sine and cosine: their numbers, their errors up to the limit and beyond, what is no number."""

from __future__ import annotations

import ctypes
import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from mpmath import MPContext
from numpy.typing import NDArray

from mbsgen.resources import folder
from tests.csrc.minimax import DOUBLE, FLOAT, Numbers, find_numbers
from tests.mbsgen.targets.compilation import run

HEADER = folder("csrc") / "mbs_sincos.h"
LIMIT = {"double": 1e5, "float": 200.0}  # MBS_SINCOS_LIMIT
REAL = {"double": np.float64, "float": np.float32}
BOUNDS = {"double": 0.86, "float": 0.9}  # units in the last place; found by search: 0.828 and 0.849
BUILDS = {  # vectors with fused multiply-add, where the processor has them; neither; the C library's
    "vectors": ("-O3", "-march=native", "-ffp-contract=fast"),
    "plain": ("-O1", "-DMBS_SCALAR", "-ffp-contract=off"),
    "libm": ("-O2", "-DMBS_LIBM"),
}
PROGRAM = """
#include "mbs_sincos.h"
static void some(int n, const mbs_real *x, mbs_real *s, mbs_real *c)
{
    mbs_real angles[MBS_PADDED(7)] = {0}, sines[MBS_PADDED(7)], cosines[MBS_PADDED(7)];
    int i;
    for (i = 0; i < n; ++i)
        angles[i] = x[i];
    mbs_sincos(n, angles, sines, cosines);
    for (i = 0; i < n; ++i) {
        s[i] = sines[i];
        c[i] = cosines[i];
    }
}
void by_sevens(int n, const mbs_real *x, mbs_real *s, mbs_real *c)
{
    for (; n >= 7; n -= 7, x += 7, s += 7, c += 7)
        some(7, x, s, c);
    some(n, x, s, c);
}
void one_by_one(int n, const mbs_real *x, mbs_real *s, mbs_real *c)
{
    for (; n >= 1; --n, ++x, ++s, ++c)
        some(1, x, s, c);
}
"""
MP = MPContext()
MP.dps = 50
Array = NDArray[np.floating]
Sincos = Callable[[Array], tuple[Array, Array]]


@pytest.fixture(scope="module")
def sincos(
    tmp_path_factory: pytest.TempPathFactory, requires: Callable[[str], str]
) -> Callable[[str, str, str, str], Sincos]:
    """Compile it by a compiler, a build and a precision; give a function of arrays."""

    def compile_it(compiler: str, build: str, real: str, form: str = "by_sevens") -> Sincos:
        place = tmp_path_factory.mktemp("sincos")
        (place / "program.c").write_text(PROGRAM)
        flags = ("-std=c99", "-fPIC", "-shared", *BUILDS[build], f"-DMBS_REAL={real}", f"-I{HEADER.parent}")
        run(requires(compiler), *flags, "program.c", "-lm", "-o", "lib.so", cwd=place)
        function = getattr(ctypes.CDLL(str(place / "lib.so")), form)

        def call(x: Array) -> tuple[Array, Array]:
            x = np.ascontiguousarray(x, dtype=REAL[real])
            s, c = np.full_like(x, 7.0), np.full_like(x, 7.0)
            function(len(x), *(a.ctypes.data_as(ctypes.c_void_p) for a in (x, s, c)))
            return s, c

        return call

    return compile_it


def find_errors(x: Array, found: Array, exact: Callable[[object], Any]) -> Array:
    """Errors in units of the last place of the result."""
    exactly = [exact(MP.mpf(float(a))) for a in x]
    errors = [float(abs(value - float(b))) for value, b in zip(exactly, found, strict=True)]
    return np.array(errors) / np.spacing(np.abs(found)).astype(np.float64)


def draw_angles(real: str, count: int) -> Array:
    """Draw angles of all sizes to the limit, and those nearest to multiples of pi/4, where most digits cancel."""
    rng, limit = np.random.default_rng(4), LIMIT[real]
    last = int(limit / (math.pi / 4))
    multiples = np.unique(np.concatenate([np.arange(1, 200), rng.integers(1, last, count)]).clip(1, last - 1))
    nearest = np.array([float(k * MP.pi / 4) for k in multiples]).astype(REAL[real])
    spread = [rng.uniform(-size, size, count) for size in (1.0, 7.0, limit)]
    small = 10.0 ** rng.uniform(-320 if real == "double" else -44, 0, count)
    return np.concatenate([*spread, small, nearest, -np.nextafter(nearest, 0)]).astype(REAL[real])


@pytest.mark.parametrize("build", ["vectors", "plain"])
@pytest.mark.parametrize(("real", "bound"), BOUNDS.items())
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_errors_are_below_a_unit_in_the_last_place(
    compiler: str, real: str, bound: float, build: str, sincos: Callable[..., Sincos]
) -> None:
    """Against 50 digits, at angles of all sizes."""
    x = draw_angles(real, 400)
    s, c = sincos(compiler, build, real)(x)
    assert find_errors(x, s, MP.sin).max() < bound
    assert find_errors(x, c, MP.cos).max() < bound


@pytest.mark.skipif(np.finfo(np.longdouble).nmant < 63, reason="the reference needs more digits than a double has")
@pytest.mark.parametrize("build", ["vectors", "plain"])
@pytest.mark.parametrize(("real", "bound"), BOUNDS.items())
def test_errors_are_largest_near_odd_multiples_of_an_eighth_turn(
    real: str, bound: float, build: str, sincos: Callable[..., Sincos]
) -> None:
    """Where a result of 0.7 has most of the square's rounding: 200,000 angles, and the worst ones that were found.

    The reference has 11 bits more than a double: it errs by no more than 0.001 units.
    """
    rng = np.random.default_rng(7)
    multiples = 2 * rng.integers(0, [3, int(LIMIT[real] / 2)], (100_000, 2)).ravel() + 1
    x = (multiples * (math.pi / 4) + rng.uniform(-0.01, 0.01, multiples.size)).astype(REAL[real])
    x = np.concatenate([x, np.array([0.78593786628248163, 0.78541235214584482, 0.78557687997817993], REAL[real])])
    errors = []
    for found, exact in zip(sincos("gcc", build, real)(x), (np.sin, np.cos), strict=True):
        difference = np.abs(found.astype(np.longdouble) - exact(x.astype(np.longdouble)))
        errors.append(float((difference / np.spacing(np.abs(found)).astype(np.longdouble)).max()))
    assert 0.79 < max(errors) < bound


@pytest.mark.parametrize("form", ["one_by_one", "by_sevens"])
@pytest.mark.parametrize("build", BUILDS)
@pytest.mark.parametrize("real", REAL)
def test_huge_angles_and_what_is_no_number_are_those_of_the_c_library(
    real: str, build: str, form: str, sincos: Callable[..., Sincos]
) -> None:
    """Also beside angles below the limit, which they must not disturb; sin(1e22) is F13's."""
    limit = LIMIT[real]
    special = [0.0, -0.0, math.inf, -math.inf, math.nan, 1e22, 1e15, -1e30, 1e38, 2 * limit, -limit, 5e-324, -1e-320]
    x = np.array([*special, *np.linspace(-3, 3, 10), *special], dtype=REAL[real])
    s, c = sincos("gcc", build, real, form)(x)
    expected = sincos("gcc", "libm", real, form)(x)
    unit = np.finfo(REAL[real]).eps
    for found, wanted in zip((s, c), expected, strict=True):
        np.testing.assert_allclose(found, wanted, rtol=unit, atol=0)
        assert np.signbit(found)[~np.isnan(found)].tolist() == np.signbit(wanted)[~np.isnan(found)].tolist()
    if real == "double":
        assert s[5] == -0.8522008497671888


def test_an_angle_has_one_sine_whatever_stands_beside_it(sincos: Callable[..., Sincos]) -> None:
    both = [sincos("gcc", "vectors", "double", form)(draw_angles("double", 50)) for form in ("one_by_one", "by_sevens")]
    np.testing.assert_array_equal(both[0], both[1])


def read_numbers(name: str) -> list[float]:
    """Read the numbers of a macro of the header; if it has arguments, the numbers in brackets behind them."""
    text = re.sub(r"\\\n", " ", HEADER.read_text())
    line = re.search(rf"#define {name}(?:\(z\) +MBS_POLYNOMIAL_\d\(z,)? *([^/\n]*)", text)
    assert line, name
    words = [word.strip(" ()f") for word in line[1].split(",")]
    return [float.fromhex(word) if "x" in word else float(word) for word in words]


@pytest.mark.parametrize(
    ("real", "wanted", "error"), [("double", DOUBLE, 2.0**-57.8), ("float", FLOAT, 2.0**-27.8)], ids=["double", "float"]
)
def test_the_numbers_are_those_that_remez_finds(
    real: str, wanted: tuple[type[np.floating], tuple[int, int], tuple[int, int]], error: float
) -> None:
    found: Numbers = find_numbers(*wanted)
    kind = REAL[real]
    for name, values in (("SINE", found.sine), ("COSINE", found.cosine)):
        assert [kind(x) for x in read_numbers(f"MBS_{name}_{real}")] == [kind(x) for x in values]
    for k, piece in enumerate(found.pieces, 1):
        assert read_numbers(f"MBS_HALF_PI_{k}_{real}") == [piece]
    assert read_numbers(f"MBS_TWO_OVER_PI_{real}") == [found.reciprocal]
    assert read_numbers(f"MBS_SINCOS_LIMIT_{real}") == [LIMIT[real]]
    assert found.error < error


@pytest.mark.parametrize(("real", "bits"), [("double", 53), ("float", 24)])
def test_multiples_of_the_first_pieces_are_exact(real: str, bits: int) -> None:
    """Up to the limit: bits of a piece and of the multiple are together no more than a number has."""
    largest = round(LIMIT[real] * 2 / math.pi)
    for k in (1, 2):
        mantissa, _ = math.frexp(read_numbers(f"MBS_HALF_PI_{k}_{real}")[0])
        length = next(n for n in range(54) if math.ldexp(mantissa, n).is_integer())
        assert length + largest.bit_length() <= bits
