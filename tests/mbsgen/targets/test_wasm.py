"""The WebAssembly module: its numbers are the C's to the last bit, where C asks no <math.h>, and right in 50 digits."""

from __future__ import annotations

import ctypes
import json
import math
import random
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
from mpmath import MPContext, mpf

from mbsgen.manifest import Kernel, Manifest
from mbsgen.pipeline import Options, generate
from mbsgen.tape.types import FUNCTIONS, Op
from mbsgen.targets.contract import Family, faces
from mbsgen.targets.wasm.module import write_module
from tests.mbsgen.targets.compilation import Requires, run
from tests.mbsgen.targets.every_function import functions_tape

MODELS = Path(__file__).parents[3] / "models"
CALLS = Path(__file__).parent / "wasm_calls.js"
UNTOUCHED = -7.0  # what wasm_calls.js puts where results go
ROUNDINGS = 2  # units in the last place: V8's functions err by less than one each


@dataclass(frozen=True)
class Call:
    """The arguments of a call; None stands for the address 0."""

    symbol: str
    inputs: Sequence[Sequence[float] | None]
    sizes: Sequence[int | None]


@dataclass(frozen=True)
class Answer:
    """The status of a call, and the numbers of its results."""

    status: int
    results: list[list[float] | None]


def _call(node: str, module: Path, calls: Sequence[Call]) -> list[Answer]:
    file = module.with_suffix(".json")
    file.write_text(json.dumps([vars(x) for x in calls]), encoding="utf-8")
    answers = json.loads(run(node, CALLS, module, file))
    return [
        Answer(x["status"], [None if bits is None else [_to_double(each) for each in bits] for bits in x["results"]])
        for x in answers
    ]


def _to_double(bits: str) -> float:
    (number,) = struct.unpack(">d", bytes.fromhex(bits))
    return float(number)


def _call_c(library: ctypes.CDLL, call: Call) -> Answer:
    inputs = [None if x is None else (ctypes.c_double * len(x))(*x) for x in call.inputs]
    results = [None if x is None else (ctypes.c_double * x)(*[UNTOUCHED] * x) for x in call.sizes]
    arrays = [(ctypes.c_void_p * len(x))(*map(_locate, x)) for x in (inputs, results)]
    status = getattr(library, call.symbol)(*arrays, None, None, 0)
    return Answer(status, [None if x is None else list(x) for x in results])


def _locate(numbers: ctypes.Array[ctypes.c_double] | None) -> int | None:
    return None if numbers is None else ctypes.addressof(numbers)


def _list_names(library: ctypes.CDLL, symbol: str, side: str) -> list[str]:
    """List the arguments of a function in CasADi's contract."""
    name = getattr(library, f"{symbol}_name_{side}")
    name.restype = ctypes.c_char_p
    return [name(ctypes.c_longlong(k)).decode() for k in range(getattr(library, f"{symbol}_n_{side}")())]


def _draw(library: ctypes.CDLL, kernel: Kernel, source: random.Random) -> Call:
    inputs = {x.name: [source.uniform(-2.0, 2.0) for _ in range(x.nnz)] for x in kernel.inputs}
    results = {x.name: x.nnz for x in kernel.outputs}
    return Call(
        kernel.symbol,
        [inputs.get(name) for name in _list_names(library, kernel.symbol, "in")],
        [results.get(name) for name in _list_names(library, kernel.symbol, "out")],
    )


@dataclass(frozen=True)
class Made:
    """A model's module, and its C as a library."""

    node: str
    manifest: Manifest
    module: Path
    library: ctypes.CDLL


@pytest.fixture(scope="module", params=["planar_arm"])
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, requires: Requires) -> Made:
    """Write a model with parameters of the run time; the C without fused operations and vectors."""
    node, folder = requires("node"), tmp_path_factory.mktemp(request.param)
    options = Options(runtime=True, targets=("wasm",), derivatives=1, count=False)
    manifest = generate(MODELS / f"{request.param}.yaml", folder, options).manifest
    flags = ("-std=c99", "-O1", "-ffp-contract=off", "-DMBS_SCALAR", "-fPIC", "-shared")
    run(requires("gcc"), *flags, *(folder / name for name in manifest.sources), "-lm", "-o", folder / "lib.so")
    return Made(node, manifest, folder / f"{manifest.prefix}.wasm", ctypes.CDLL(str(folder / "lib.so")))


def test_results_are_those_of_the_c_to_the_last_bit(made: Made) -> None:
    """Sums, products and roots are rounded one by one in both, and sines by the same polynomials."""
    source = random.Random(1)
    calls = [_draw(made.library, kernel, source) for kernel in made.manifest.kernels for _ in range(3)]
    found, expected = _call(made.node, made.module, calls), [_call_c(made.library, x) for x in calls]
    assert len(calls) > 30
    for call, one, other in zip(calls, found, expected, strict=True):
        if call.symbol != f"{made.manifest.prefix}_condition":  # it asks <math.h>
            assert repr(one) == repr(other), call.symbol


def test_missing_inputs_are_zeros_and_missing_results_stay_away(made: Made) -> None:
    """An address 0 means in the module what it means in C."""
    source = random.Random(2)
    kernels = [kernel for kernel in made.manifest.kernels if len(kernel.outputs) > 1]
    full = [_draw(made.library, kernel, source) for kernel in kernels]
    some = [Call(x.symbol, [None, *x.inputs[1:]], [*x.sizes[:-1], None]) for x in full]
    zeros = [Call(x.symbol, [[0.0] * len(x.inputs[0] or ()), *x.inputs[1:]], x.sizes) for x in full]
    found, expected = _call(made.node, made.module, some), _call(made.node, made.module, zeros)
    assert found
    for one, other in zip(found, expected, strict=True):
        assert repr((one.status, one.results)) == repr((other.status, [*other.results[:-1], None]))  # NaN too


def test_a_lost_pivot_is_the_status_of_the_c_and_stores_nothing(made: Made) -> None:
    """Pivots beyond the range of doubles pass no guard."""
    kernel = next(x for x in made.manifest.kernels if x.name == "exp1")
    drawn = _draw(made.library, kernel, random.Random(4))
    call = Call(kernel.symbol, [x and [1e300] * len(x) for x in drawn.inputs], drawn.sizes)
    (found,) = _call(made.node, made.module, [call])
    assert found.status == _call_c(made.library, call).status > 0
    assert found.results == [[UNTOUCHED] * (size or 0) for size in call.sizes]


@pytest.mark.parametrize("size", [1.0, 30.0, 9e4, 3e5])
def test_functions_agree_with_fifty_digits(size: float, tmp_path: Path, requires: Requires) -> None:
    """Each function errs by at most two roundings; sine and cosine by one, far from zero too."""
    digits, source = MPContext(), random.Random(3)
    digits.dps = 50
    module = tmp_path / "functions.wasm"
    (face,) = faces(Family(functions_tape()), "model")
    module.write_bytes(write_module([face]))
    pairs = [(source.uniform(0.1, size), source.uniform(-1.0, 1.0) * size) for _ in range(200)]
    answers = _call(requires("node"), module, [Call("model_impl", [pair], [len(FUNCTIONS)]) for pair in pairs])
    seen = set()
    for (positive, any_sign), answer in zip(pairs, answers, strict=True):
        (results,) = answer.results
        assert results is not None
        for op, found in zip(FUNCTIONS, results, strict=True):
            exact = _compute(digits, op, positive, any_sign)
            if exact is None or not 1e-300 < abs(exact) < 1e300:
                continue
            bound = (1 if op in (Op.SIN, Op.COS) else ROUNDINGS) * math.ulp(float(exact))
            assert abs(digits.mpf(found) - exact) <= bound, (op, positive, any_sign)
            seen.add(op)
    assert seen >= ({*FUNCTIONS} if size == 1.0 else {Op.SIN, Op.COS, Op.TAN})  # others may have no value


def _compute(digits: MPContext, op: Op, positive: float, any_sign: float) -> mpf | None:
    """Return the value in 50 digits; None where there is none."""
    x = digits.mpf(positive if op in (Op.SQRT, Op.LOG) else any_sign)
    if op is Op.SIGN:
        return digits.mpf(math.copysign(1.0, any_sign))
    found = digits.atan2(x, digits.mpf(positive)) if op is Op.ATAN2 else getattr(digits, op.value[0])(x)
    return found if isinstance(found, mpf | type(digits.mpf(0))) else None


def test_a_module_is_the_same_bytes_each_time() -> None:
    """The same functions give the same module."""
    assert len({write_module(faces(Family(functions_tape()), "model")) for _ in range(2)}) == 1
