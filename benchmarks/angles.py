"""Write CasADi's C with the sine and cosine of the generated kernels: all angles of a function together, in vectors.

CasADi writes a call of the C library for each sine and cosine. Here they become inputs of the function, and a wrapper
in the same file computes them by `csrc/mbs_sincos.h` before it calls the function, as generated kernels do.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import casadi as ca

_WRAPPER = """
#include "mbs_sincos.h"

__attribute__((visibility("default")))
int {outer}(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int mem)
{{
    casadi_real angles[MBS_PADDED({count})] = {{0}}, sines[MBS_PADDED({count})], cosines[MBS_PADDED({count})];
    const casadi_real *inner[{n_arg}];
    casadi_real *found[1];
    int i;
    for (i = 0; i < {n_in}; ++i)
        inner[i] = arg[i];
    found[0] = angles;
    casadi_f1(arg, found, iw, w, mem);
    mbs_sincos({count}, angles, sines, cosines);
    inner[{n_in}] = sines;
    inner[{n_in} + 1] = cosines;
    return casadi_f0(inner, res, iw, w, mem);
}}
"""


@dataclass(frozen=True)
class Separated:
    """A function of inputs, sines and cosines, and the function of the angles."""

    function: ca.Function
    angles: ca.Function
    count: int


def separate(function: ca.Function) -> Separated | None:
    """Turn sines and cosines into inputs of an SX function; return None without any, or if angles depend on sines."""
    inputs = function.sx_in()
    entries = [ca.vertsplit(x) for x in inputs]
    results: list[list[ca.SX]] = [[ca.SX(0)] * function.nnz_out(i) for i in range(function.n_out())]
    work: dict[int, ca.SX] = {}
    known: dict[int, int] = {}  # number of an angle, by its node in the graph
    angles: list[ca.SX] = []
    sines: list[ca.SX] = []
    cosines: list[ca.SX] = []
    for k in range(function.n_instructions()):
        operation, to, of = function.instruction_id(k), function.instruction_output(k), function.instruction_input(k)
        if operation == ca.OP_INPUT:
            work[to[0]] = entries[of[0]][of[1]]
        elif operation == ca.OP_OUTPUT:
            results[to[0]][to[1]] = work[of[0]]
        elif operation == ca.OP_CONST:
            work[to[0]] = ca.SX(function.instruction_constant(k))
        elif operation in (ca.OP_SIN, ca.OP_COS):
            angle = work[of[0]]
            number = known.setdefault(angle.element_hash(), len(angles))
            if number == len(angles):
                angles.append(angle)
                sines.append(ca.SX.sym(f"s{number}"))
                cosines.append(ca.SX.sym(f"c{number}"))
            work[to[0]] = (sines if operation == ca.OP_SIN else cosines)[number]
        elif len(of) == 1:
            work[to[0]] = ca.SX.unary(operation, work[of[0]])
        else:
            work[to[0]] = ca.SX.binary(operation, work[of[0]], work[of[1]])
    own = ca.vertcat(*inputs)
    if not angles or ca.depends_on(ca.vertcat(*angles), ca.vertcat(*sines, *cosines)):
        return None
    outputs = [
        ca.SX(function.sparsity_out(i), ca.vertcat(*found)) if found else ca.SX(function.sparsity_out(i))
        for i, found in enumerate(results)
    ]
    assert own.is_valid_input(), "inputs are symbols"
    given = [*inputs, ca.vertcat(*sines), ca.vertcat(*cosines)]
    core = ca.Function(f"{function.name()}_core", given, outputs)
    return Separated(core, ca.Function(f"{function.name()}_angles", inputs, [ca.vertcat(*angles)]), len(angles))


def write_source(separated: Separated, outer: str, folder: Path) -> Path:
    """Write the C of a function whose sines and cosines are the header's, under the name `outer`.

    -DCASADI_SYMBOL_EXPORT=static makes only the wrapper visible, so that the compiler inlines the functions.
    """
    generator = ca.CodeGenerator(f"{outer}.c")
    generator.add(separated.function)  # is static, as casadi_f0
    generator.add(separated.angles)
    generator.generate(f"{folder}/")
    path = folder / f"{outer}.c"
    text = path.read_text(encoding="utf-8")
    n_in = separated.angles.n_in()
    wrapper = _WRAPPER.format(outer=outer, count=separated.count, n_in=n_in, n_arg=separated.function.sz_arg())
    end = text.rindex("#ifdef __cplusplus")  # closes extern "C"
    path.write_text(text[:end] + wrapper + text[end:], encoding="utf-8")
    return path
