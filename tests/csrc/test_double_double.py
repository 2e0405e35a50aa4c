"""Double-double arithmetic: each operation against 50 digits under each compiler, and what it refuses."""

from __future__ import annotations

import ctypes
import math
import subprocess
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpmath import MPContext
from numpy.typing import NDArray

from mbsgen.resources import folder

HEADER = folder("csrc") / "mbs_double_double.h"
BUILDS = {
    "fused": ("-O3", "-march=native", "-ffp-contract=fast"),
    "plain": ("-O2", "-ffp-contract=off"),
    "without": ("-O0",),
}
ONE = ("sqrt", "abs", "sign", "tan", "atan", "asin", "acos", "exp", "log", "tanh", "neg")
TWO = ("add", "sub", "mul", "div", "atan2")
PROGRAM = (
    '#include "mbs_double_double.h"\n'
    + "".join(f"mbs_dd of_{name}(mbs_dd x, mbs_dd y) {{ (void)y; return mbs_dd_{name}(x); }}\n" for name in ONE)
    + "".join(f"mbs_dd of_{name}(mbs_dd x, mbs_dd y) {{ return mbs_dd_{name}(x, y); }}\n" for name in TWO)
    + "mbs_dd of_sin(mbs_dd x, mbs_dd y) { (void)y; return mbs_dd_sincos(x).sine; }\n"
    + "mbs_dd of_cos(mbs_dd x, mbs_dd y) { (void)y; return mbs_dd_sincos(x).cosine; }\n"
    + "int stands(mbs_dd x, double t, mbs_dd y) { return mbs_dd_stands(x, t, y); }\n"
)
U = 2.0**-53
# Largest errors in u^2 of the result; the first ones are proved in the paper that the header names.
BOUNDS: Mapping[str, float] = {
    "neg": 0.0,
    "abs": 0.0,
    "sign": 0.0,
    "add": 3.1,
    "sub": 3.1,
    "mul": 5.1,
    "div": 15.1,
    "sqrt": 4.0,
    **dict.fromkeys(("sin", "cos", "tan", "atan", "asin", "acos", "atan2", "exp", "log", "tanh"), 100.0),
}
MP = MPContext()
MP.dps = 70
Array = NDArray[np.float64]


class Pair(ctypes.Structure):
    _fields_ = [("high", ctypes.c_double), ("low", ctypes.c_double)]

    def exact(self) -> Any:
        return MP.mpf(self.high) + MP.mpf(self.low)


def compile_program(compiler: str, flags: Sequence[str], place: Path) -> subprocess.CompletedProcess[str]:
    (place / "program.c").write_text(PROGRAM)
    strict = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fPIC", "-shared", f"-I{HEADER.parent}")
    command = [compiler, *strict, *flags, "program.c", "-lm", "-o", "lib.so"]
    return subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module", params=[(c, b) for c in ("gcc", "clang") for b in BUILDS], ids="-".join)
def library(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, requires: Callable[[str], str]
) -> ctypes.CDLL:
    compiler, build = request.param
    place = tmp_path_factory.mktemp("double_double")
    done = compile_program(requires(compiler), BUILDS[build], place)
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(place / "lib.so"))


def split(x: Any) -> Pair:
    high = float(x)
    return Pair(high, float(x - MP.mpf(high)))


def call(library: ctypes.CDLL, name: str, x: Pair, y: Pair | None = None) -> Pair:
    function = library[f"of_{name}"]
    function.restype, function.argtypes = Pair, [Pair, Pair]
    found: Pair = function(x, y or Pair(1.0, 0.0))
    return found


def draw(name: str, count: int) -> list[Any]:
    """Draw numbers of many sizes in the domain of an operation, with digits beyond a double."""
    rng = np.random.default_rng(len(name))
    signs, rest = rng.choice([-1, 1], count), rng.uniform(-1, 1, count)
    sizes = 10 ** rng.uniform(*{"exp": (-8, 2.5), "tanh": (-8, 1.5)}.get(name, (-12, 4)), count)
    if name in ("asin", "acos"):
        sizes = np.where(rng.random(count) < 0.5, np.minimum(sizes, 0.9), 1 - np.minimum(sizes, 0.5))
    if name == "log":  # and near 1, where digits of the logarithm cancel
        sizes = np.where(rng.random(count) < 0.5, sizes, 1 + signs * np.minimum(sizes / 10, 0.3))
    if name in ("sqrt", "log"):
        signs = np.ones(count)
    if name in ("sin", "cos", "tan"):  # and the doubles next to multiples of pi/2, where the remainder is smallest
        near = [float(k * MP.pi / 2) for k in range(1, 40)] + [float(10**k * MP.pi / 2) for k in range(2, 14)]
        return [MP.mpf(x) for x in near] + [
            MP.mpf(a * b) * (1 + c * U) for a, b, c in zip(signs, sizes, rest, strict=True)
        ]
    return [MP.mpf(a * b) * (1 + MP.mpf(c) * U) for a, b, c in zip(signs, sizes, rest, strict=True)]


@pytest.mark.parametrize("name", BOUNDS)
def test_errors_are_below_their_bounds(name: str, library: ctypes.CDLL) -> None:
    """Against 70 digits; sums of two near numbers cancel, and lose nothing by it."""
    xs = list(map(split, draw(name, 400)))
    ys = list(map(split, draw(f"{name} y", len(xs))))
    if name in ("add", "sub"):
        ys[::2] = [
            split(x.exact() * (-1 if name == "add" else 1) * (1 + MP.mpf(k) * U / 7)) for k, x in enumerate(xs[::2])
        ]
    own = {"abs": abs, "neg": lambda x: -x, "add": MP.fadd, "sub": MP.fsub, "mul": MP.fmul, "div": MP.fdiv}
    exact = own.get(name) or getattr(MP, name)
    worst = 0.0
    for x, y in zip(xs, ys, strict=True):
        found = call(library, name, x, y)
        expected = exact(x.exact(), y.exact()) if name in TWO else exact(x.exact())
        assert abs(found.low) <= 1.01 * np.spacing(abs(found.high))
        worst = max(worst, float(abs(found.exact() - expected) / abs(expected)) / U**2 if expected else abs(found.high))
    assert worst <= BOUNDS[name]


@pytest.mark.parametrize(
    ("name", "x", "y", "expected"),
    [
        ("sqrt", 0.0, 1.0, 0.0),
        ("sqrt", -1.0, 1.0, math.nan),
        ("asin", 1.0, 1.0, math.pi / 2),
        ("acos", 1.0, 1.0, 0.0),
        ("acos", -1.0, 1.0, math.pi),
        ("asin", 1.5, 1.0, math.nan),
        ("atan2", 0.0, 0.0, 0.0),
        ("atan2", 0.0, -2.0, math.pi),
        ("atan2", -3.0, 0.0, -math.pi / 2),
        ("exp", 0.0, 1.0, 1.0),
        ("exp", -1e4, 1.0, 0.0),
        ("exp", 1e4, 1.0, math.inf),
        ("log", 1.0, 1.0, 0.0),
        ("log", 0.0, 1.0, -math.inf),
        ("log", -1.0, 1.0, math.nan),
        ("tanh", 1e4, 1.0, 1.0),
        ("tanh", -1e4, 1.0, -1.0),
        ("tanh", 0.0, 1.0, 0.0),
        ("sign", 0.0, 1.0, 0.0),
        ("sign", math.nan, 1.0, math.nan),
        ("sin", 0.0, 1.0, 0.0),
        ("cos", 0.0, 1.0, 1.0),
        ("sin", 1e16, 1.0, math.nan),
        ("cos", math.inf, 1.0, math.nan),
        ("add", math.inf, 1.0, math.nan),
        ("div", 1.0, 0.0, math.nan),
    ],
)
def test_edges_of_domains(name: str, x: float, y: float, expected: float, library: ctypes.CDLL) -> None:
    """There is an exact number, or no number, but none that is merely plausible."""
    found = call(library, name, Pair(x, 0.0), Pair(y, 0.0))
    assert found.high == expected or (math.isnan(found.high) and math.isnan(expected))


def test_pivots_stand_out_of_rounding(library: ctypes.CDLL) -> None:
    """The threshold is the tolerance times 2^-104, at most 3e-5; what is no number does not stand."""
    library.stands.argtypes = [Pair, ctypes.c_double, Pair]

    def stands(pivot: float, tolerance: float) -> bool:
        return bool(library.stands(Pair(pivot, 0.0), tolerance, Pair(2.0, 0.0)))

    assert stands(2.1e3 * 2.0**-104, 1e3)
    assert not stands(1.9e3 * 2.0**-104, 1e3)
    assert stands(6.1e-5, 1e300)
    assert not stands(5.9e-5, 1e300)
    assert not stands(math.nan, 1e3)


@pytest.mark.parametrize(
    ("flag", "finding"),
    [
        ("-ffast-math", "fast-math drops the low halves"),
        ("-Ofast", "fast-math drops the low halves"),
        ("-DMBS_REAL=float", "need -DMBS_REAL=double"),
        ("-mfpmath=387", "rounded after each operation"),
    ],
)
def test_flags_that_break_it_are_refused(
    flag: str, finding: str, tmp_path: Path, requires: Callable[[str], str]
) -> None:
    done = compile_program(requires("gcc"), [flag], tmp_path)
    assert done.returncode != 0
    assert finding in done.stderr
