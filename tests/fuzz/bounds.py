"""Bounds of rounding errors in millions of states, in C: kernels with bounds beside the same tapes in long double.

The reference has a unit roundoff of 2^-64 instead of 2^-53 or 2^-24, and no guards. By the same analysis its errors are
at most 2^-11 of the bounds, which a violation must exceed by a thousandth. Ball arithmetic (Arb) checks the bounds and
the reference in some states, and in the state with the least ratio of bound to error.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import flint
import numpy as np
from numpy.typing import NDArray

from mbsgen.families import write_families
from mbsgen.manifest import Kernel
from mbsgen.model.tree import Kind, Tree
from mbsgen.pipeline import read_tree
from mbsgen.request import Request
from mbsgen.roles import Order, Role
from mbsgen.tape.interpreter import Numbers, evaluate
from mbsgen.tape.rounding import PREFIX, add_bounds, name_bound
from mbsgen.tape.types import FUNCTIONS, LITERALS, Op, Tape
from mbsgen.targets.c.files import write_c
from mbsgen.targets.contract import Family
from mbsgen.targets.unit import Unit
from mbsrun.library import find_compiler
from studies.laboratory.mechanisms import describe_elbow, describe_lock, describe_spatial, describe_straight

ROOT = Path(__file__).parents[2]
SHIPPED = ("arm_pendulum", "six_axis", "leg", "cart_pole", "satellite", "quadruped")
CLOSED = ("four_bar", "slider_crank", "five_bar", "wishbone")
FORMULATIONS = ("impl", "semi", "exp1", "exp2")
CHECKED = (Order.VALUE, Order.JACOBIAN, Order.ADJOINT)
PRECISION = 300  # bits of balls
CHUNK = 20_000  # states that are drawn at a time
SAMPLE = 5  # states of each function that are computed in balls
BINS, FINENESS, LOWEST = 4096, 16, -4  # of the histogram of log2(bound/error)
UNITS = {"double": 2.0**-53, "float": 2.0**-24}
TIES = """
name: laws
gravity: [0, 0, -9.81]
bodies:
  - name: sled
    joint: {name: x, type: prismatic, axis: x, force: "max(0, 40*q - 3*qd) - min(qd, 2*q) + abs(qd)*qd"}
    mass: 2
  - name: arm
    parent: sled
    joint:
      name: a
      type: revolute
      axis: y
      force: "softplus(q*qd - 1, 0.1) + step(q - qd, 0.2) + tanh(9*qd) + exp(-q) + max(q*qd, qd)"
    mass: 1
    com: [0, 0, -0.4]
    inertia: [0.1, 0.1, 0.02]
"""

Array = NDArray[Any]


@dataclass(frozen=True)
class Case:
    """A mechanism, and how its states are drawn."""

    name: str
    text: str
    near: Mapping[int, float]  # coordinates that are drawn near a number, by their place
    spread: float = 1.0  # of other coordinates
    functions: tuple[str, ...] = FORMULATIONS


@dataclass(frozen=True)
class Tally:
    """The outcomes of one function: `least` and `median` are of bounds by errors."""

    case: str
    kernel: str
    states: int
    refused: int
    compared: int  # results with an error that is not 0
    violated: int
    unbounded: int  # results whose bound overflows
    least: float
    median: float
    balls: str  # a finding of the check by ball arithmetic, or nothing

    @property
    def is_sound(self) -> bool:
        """Return whether every bound held."""
        return not self.violated and not self.balls

    def __str__(self) -> str:
        refused = f"{self.refused / self.states:.1%} refused"
        ratios = f"bound by error {self.least:.2f} at least, {self.median:.0f} in the median"
        overflown = f", {self.unbounded} bounds overflow" if self.unbounded else ""
        return (
            f"{self.case}: {self.kernel}: {self.violated} violated, {ratios}, {refused}{overflown} {self.balls}".strip()
        )


def list_cases() -> tuple[Case, ...]:
    """List shipped mechanisms, closed ones, laws of force with branches, and the laboratory's cases."""
    shipped = [Case(x, (ROOT / "models" / f"{x}.yaml").read_text(encoding="utf-8"), {}) for x in (*SHIPPED, *CLOSED)]
    lock = np.pi / 2
    return (
        *shipped,
        Case("force laws", TIES, {}),
        Case("force laws at ties", TIES, {0: 0.0}, 1e-6),
        Case("F01 straight chain", describe_straight(10), dict.fromkeys(range(10), 0.0), 1e-3),
        Case("F02 spatial chain", describe_spatial(10), {}),
        Case("F03 heavy tip", describe_spatial(10, [1.0] * 9 + [1e8]), {}),
        Case("F04 light base", describe_spatial(10, [1e-8] + [1.0] * 9), {}),
        Case("F04 heavy and light", describe_spatial(10, [1e12, 1.0] * 5), {}),
        Case("F05 Cardan lock", describe_lock("zyx"), {1: lock}),
        Case("F05 Euler lock", describe_lock("zxz"), {1: 0.0}),
        Case("F05 elbow", describe_elbow(), {1: 0.0}),
        Case("F08 tiny", describe_spatial(6, [1e-100] * 6), {}),
        Case("F08 huge", describe_spatial(6, [1e100] * 6), {}),
        Case("F12, F13 large angles", describe_straight(3), {}, 1e8),
    )


# --- the reference ---


def write_reference(tape: Tape) -> str:
    """Write a tape as C in long double, from nonzeros of the inputs in order to nonzeros of the outputs."""
    names = [f"x[{k}]" for k in range(tape.first_literal)]
    names += [
        f"{LITERALS.nstr(x, 25)}L" if "." in LITERALS.nstr(x, 25) else f"{LITERALS.nstr(x, 25)}.0L"
        for x in tape.literals
    ]
    lines = []
    for op, a, b in tape.operations:
        name = f"v{len(names)}"
        lines.append(f"    const T {name} = {_write(op, names[a], names[b] if b >= 0 else '')};")
        names.append(name)
    results = [v for o in tape.outputs for v in o.values]
    lines += [f"    y[{k}] = {names[v]};" for k, v in enumerate(results)]
    return "\n".join(["void reference(const mbs_real *x, T *y)", "{", *lines, "}"])


def _write(op: Op, a: str, b: str) -> str:
    if op is Op.SIGN:
        return f"({a} > 0) - ({a} < 0)"
    if op in FUNCTIONS:
        return f"{op.value[0]}l({a}{', ' + b if b else ''})"
    wide = f"(T){a}"
    return f"-{wide}" if op is Op.NEG else f"{wide} {op.value[0]} {b}"


_HARNESS = """
#include <math.h>
#include "{source}"
typedef long double T;
{reference}
int bounded(const mbs_real *x, mbs_real unit, mbs_real *z, mbs_real *e)
{{
    return {call};
}}
void check(long count, const mbs_real *states, mbs_real unit, double *tally, long *histogram)
{{
    long k;
    int i;
    for (k = 0; k < count; ++k) {{
        const mbs_real *x = states + k * {inputs};
        mbs_real z[{outputs}], e[{outputs}];
        T y[{outputs}];
        if (bounded(x, unit, z, e)) {{
            ++tally[0];
            continue;
        }}
        reference(x, y);
        for (i = 0; i < {outputs}; ++i) {{
            const T error = fabsl((T)z[i] - y[i]);
            const double ratio = (double)((T)e[i] / error);
            double bin = floor({fineness} * (log2(ratio) - ({lowest})));
            if (!isfinite(e[i])) {{
                ++tally[5];
                continue;
            }}
            if (!(error <= (T)e[i] * 1.001L)) ++tally[2];
            if (error == 0) continue;
            ++tally[1];
            if (ratio < tally[3]) {{
                tally[3] = ratio;
                tally[4] = (double)k;
            }}
            bin = bin < {bins} - 1 ? bin : {bins} - 1;
            ++histogram[bin > 0 ? (int)bin : 0];
        }}
    }}
}}
"""


def write_harness(tape: Tape, kernel: Kernel, folder: Path) -> str:
    """Write a C file that includes a kernel with bounds and the reference, and compares them."""
    sizes = [(i.name, i.sparsity.nnz) for i in tape.inputs]
    places = dict(zip([x for x, _ in sizes], np.cumsum([0, *(n for _, n in sizes)]).tolist(), strict=False))
    given = [("&unit" if i.name == "unit" else f"x + {places[i.name]}") for i in kernel.inputs if i.nnz]
    starts = np.cumsum([0, *(o.sparsity.nnz for o in tape.outputs)]).tolist()
    starts_of = {o.name: f"z + {n}" for o, n in zip(tape.outputs, starts, strict=False)}
    starts_of |= {name_bound(o.name): f"e + {n}" for o, n in zip(tape.outputs, starts, strict=False)}
    wanted = [starts_of[o.name] for o in kernel.outputs if o.nnz]
    return _HARNESS.format(
        source=folder / kernel.sources[0],
        reference=write_reference(tape),
        inputs=tape.first_literal,
        outputs=starts[-1],
        call=f"{kernel.function}({', '.join((*given, *wanted))})",
        bins=BINS,
        fineness=FINENESS,
        lowest=LOWEST,
    )


def compile_harness(text: str, folder: Path, name: str, precision: str) -> ctypes.CDLL:
    """Compile a comparison in one precision."""
    source, library = folder / f"{name}.c", folder / f"{name}_{precision}.so"
    source.write_text(text, encoding="utf-8")
    compiler = find_compiler(os.environ)
    command = [*compiler.command, "-std=gnu99", *(f for f in compiler.flags if not f.startswith("-std")), "-O1"]
    subprocess.run([*command, f"-DMBS_REAL={precision}", "-shared", str(source), "-o", str(library), "-lm"], check=True)
    return ctypes.CDLL(str(library))


# --- states ---


def draw_states(tape: Tape, setup: Tape | None, tree: Tree, case: Case, rng: np.random.Generator, count: int) -> Array:
    """Draw states: usual numbers in every second one; also large and small ones, zeros, and quarters of a turn.

    Run-time parameters are within a half of the file's; what `setup` computes of them is computed.
    """
    columns = []
    for given in tape.inputs:
        x = _mix(rng, (count, given.sparsity.nnz))
        if given.port.role is Role.COORDINATE:
            x = case.spread * _mix(rng, x.shape, np.pi / 2)
            for place, value in case.near.items():
                x[:, place] = value + _draw_powers(rng, count, -14, -1)
            _normalise(tree, x)
        elif given.port.role is Role.PARAMETER:
            values = [p.value for p in tree.parameters if p.kind is Kind.RUNTIME]
            x = np.array(values) * rng.uniform(0.5, 1.5, x.shape)
        elif given.port.role is Role.SETUP and setup is not None:
            x = _set_up(setup, draw_states(setup, None, tree, case, rng, count))
        columns.append(x)
    return np.concatenate(columns, axis=1)


def _set_up(setup: Tape, parameters: Array) -> Array:
    (values,) = evaluate(setup, {setup.inputs[0].port.name: [*parameters.T]}).values()
    return np.stack(np.broadcast_arrays(*values), axis=1)


def _mix(rng: np.random.Generator, shape: tuple[int, int], quarter: float = 1.0) -> Array:
    numbers = rng.uniform(-np.pi, np.pi, shape)
    numbers[1::2] = draw_numbers(rng, numbers[1::2].shape, quarter)
    return numbers


def draw_numbers(rng: np.random.Generator, shape: tuple[int, ...], quarter: float = 1.0) -> Array:
    """Draw usual numbers, most of them in (-pi, pi), and others."""
    kinds = rng.random(shape)
    numbers = rng.uniform(-np.pi, np.pi, shape)
    multiples = quarter * rng.integers(-4, 5, shape) + np.where(
        rng.random(shape) < 0.5, _draw_powers(rng, shape, -14, -1), 0
    )
    numbers = np.where(kinds < 0.15, multiples, numbers)
    numbers = np.where(kinds > 0.85, _draw_powers(rng, shape, -8, 3), numbers)
    return np.where(np.abs(kinds - 0.5) < 0.025, 0.0, numbers)


def _draw_powers(rng: np.random.Generator, shape: Any, low: float, high: float) -> Array:
    return np.asarray(rng.choice((-1.0, 1.0), shape) * 10.0 ** rng.uniform(low, high, shape))


def _normalise(tree: Tree, q: Array) -> None:
    """Replace quaternions by random ones of unit length."""
    beginnings, inside = {x.first: x for x in tree.quaternions}, {i for x in tree.quaternions for i in x.bodies}
    place = 0
    for i in range(1, len(tree.bodies) + 1):
        if i in beginnings:
            place += 3 * beginnings[i].is_free
            turn = q[:, place : place + 4]
            turn[:] = np.random.default_rng(i).normal(size=turn.shape)
            turn /= np.linalg.norm(turn, axis=1, keepdims=True)
            place += 4
        elif i not in inside and i not in tree.followers:
            place += 1


# --- the search ---


def search(case: Case, states: int, seed: int, precision: str = "double") -> Iterator[Tally]:
    """Compare the formulations of a mechanism and their first derivatives; yield a tally for each function."""
    with tempfile.TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        folder = Path(name)
        model = folder / "model.yaml"
        model.write_text(case.text, encoding="utf-8")
        tree = read_tree(model)
        tapes = [t for f in write_families(tree, Request(functions=case.functions, derivatives=1)) for t in f.tapes]
        families = tuple(Family(add_bounds(t), title=t.name) for t in tapes if t.function.order in CHECKED)
        sources = write_c(Unit("bounds", "", "", families, ()))
        for file, content in sources.files.items():
            (folder / file).write_text(content, encoding="utf-8")
        kernels = {k.name: k for k in sources.kernels}
        setup = next((t for t in tapes if t.name == "setup"), None)
        for tape in tapes:
            if tape.function.order in CHECKED:
                harness = write_harness(tape, kernels[PREFIX + tape.name], folder)
                library = compile_harness(harness, folder, f"check_{tape.name}", precision)
                draw = partial(draw_states, tape, setup, tree, case, np.random.default_rng(seed))
                yield compare(library, tape, case, draw, states, precision)


def compare(
    library: ctypes.CDLL, tape: Tape, case: Case, draw: Callable[[int], Array], states: int, precision: str
) -> Tally:
    """Run one comparison."""
    kind = np.float64 if precision == "double" else np.float32
    real = ctypes.c_double if precision == "double" else ctypes.c_float
    tally, histogram = np.array([0, 0, 0, np.inf, 0, 0], dtype=float), np.zeros(BINS, dtype=np.int64)
    checked: list[Array] = []
    for start in range(0, states, CHUNK):
        x = np.ascontiguousarray(draw(min(CHUNK, states - start)), dtype=kind)
        before = tally[3]
        library.check(ctypes.c_long(len(x)), _point(x), real(UNITS[precision]), _point(tally), _point(histogram))
        if tally[3] < before:
            checked = [*(checked[:SAMPLE] or x[:SAMPLE]), x[int(tally[4])]]
    findings = (check_by_balls(library, tape, x, precision) for x in checked)
    middle = int(np.searchsorted(np.cumsum(histogram), histogram.sum() / 2))
    refused, compared, violated, unbounded = (int(tally[k]) for k in (0, 1, 2, 5))
    median = 2.0 ** ((middle + 0.5) / FINENESS + LOWEST) if compared else np.nan
    balls = next(filter(None, findings), "")
    return Tally(case.name, tape.name, states, refused, compared, violated, unbounded, float(tally[3]), median, balls)


def _point(array: Array) -> ctypes.c_void_p:
    return array.ctypes.data_as(ctypes.c_void_p)


# --- balls ---


def _by_arb(name: str) -> Any:
    return lambda *x: getattr(flint.arb, name)(*x)


BALLS = Numbers(
    lambda x: flint.arb(LITERALS.nstr(x, 60)),
    {op: _by_arb(op.value[0]) for op in FUNCTIONS} | {Op.ABS: abs, Op.SIGN: _by_arb("sgn")},
    flint.arb(2) ** -PRECISION,
)


def check_by_balls(library: ctypes.CDLL, tape: Tape, x: Array, precision: str) -> str:
    """Return what is wrong in a state: a bound that is violated, or a reference that errs by 2^-10 of it."""
    count = sum(o.sparsity.nnz for o in tape.outputs)
    z, e, y = np.empty(count, x.dtype), np.empty(count, x.dtype), np.empty(count, np.longdouble)
    real = ctypes.c_double if precision == "double" else ctypes.c_float
    if library.bounded(_point(x), real(UNITS[precision]), _point(z), _point(e)):
        return ""
    library.reference(_point(x), _point(y))
    before, flint.ctx.prec = flint.ctx.prec, PRECISION
    try:
        sizes = np.cumsum([0, *(i.sparsity.nnz for i in tape.inputs)])
        parts = zip(tape.inputs, pairwise(sizes), strict=True)
        given = {i.name: [flint.arb(float(v)) for v in x[a:b]] for i, (a, b) in parts}
        exact = [v for values in evaluate(tape, given, BALLS).values() for v in values]
        for k, ball in enumerate(exact):
            bound = flint.arb(float(e[k]))
            if not abs(flint.arb(float(z[k])) - ball) <= bound:
                return f"result {k} is {z[k]!r}, its bound {e[k]!r}, the ball {ball}"
            high = float(y[k])
            wide = flint.arb(high) + flint.arb(float(y[k] - np.longdouble(high)))
            if not abs(wide - ball) <= bound / 1024:
                return f"the reference of result {k} is {y[k]!r}, the ball {ball}"
    finally:
        flint.ctx.prec = before
    return ""
