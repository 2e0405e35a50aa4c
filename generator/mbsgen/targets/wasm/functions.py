"""The functions that WebAssembly lacks: sine and cosine written out, all others from JavaScript's Math.

Sine and cosine compute as csrc/mbs_sincos.h, operation by operation, with the bits of the generated C without
fused multiply-add. Beyond LIMIT, Math.sin and Math.cos are called, as the C calls <math.h>.
"""

from __future__ import annotations

from mbsgen.tape.types import Op
from mbsgen.targets.wasm.encoding import (
    F64,
    I64,
    Code,
    Function,
    Import,
    Signature,
    call,
    code,
    double,
    get,
    long,
    put,
    tee,
    when,
)

UNARY, BINARY = Signature((F64,), (F64,)), Signature((F64, F64), (F64,))
IMPORTED = {
    Op.SIN: "sin",
    Op.COS: "cos",
    Op.TAN: "tan",
    Op.ASIN: "asin",
    Op.ACOS: "acos",
    Op.ATAN: "atan",
    Op.ATAN2: "atan2",
    Op.EXP: "exp",
    Op.LOG: "log",
    Op.TANH: "tanh",
}
LIMIT = 1e5
_INTEGER = float.fromhex("0x1.8p52")  # added to a number, it leaves an integer, in the last bits
_TWO_OVER_PI = float.fromhex("0x1.45f306dc9c883p-1")
_HALF_PI = tuple(
    map(float.fromhex, ("0x1.921fb5444p+0", "0x1.68c234c4cp-39", "0x1.98a2e03707345p-77"))
)  # in three pieces
_SINE = (
    *(-0.1666666666666663, 0.008333333333322009, -0.0001984126982949777),
    *(2.7557313588428564e-06, -2.505074243774969e-08, 1.58959124452268e-10),
)
_COSINE = (
    *(0.041666666666666595, -0.00138888888888729, 2.4801587288750676e-05),
    *(-2.7557314149360595e-07, 2.0875696675036095e-09, -1.1358315905576734e-11),
)


def import_function(op: Op) -> Import:
    """Import a function of JavaScript's Math."""
    return Import("math", IMPORTED[op], BINARY if op.arity == 2 else UNARY)


def write_sine_cosine(sine: int, cosine: int) -> Function:
    """Write the function of an angle that returns its sine and its cosine; beyond LIMIT it calls two functions."""
    x, k, near, r, excess, z, half, one = range(8)
    s, c, quarter, exchange, turned = range(8, 13)
    body = code(
        *(get(x), Code.F64_ABS, double(LIMIT), Code.F64_LE, Code.I32_EQZ),
        when(get(x), call(sine), get(x), call(cosine), Code.RETURN),
        *(get(x), double(_TWO_OVER_PI), Code.F64_MUL, double(_INTEGER), Code.F64_ADD, tee(k)),
        *(Code.TO_BITS, put(quarter), get(k), double(_INTEGER), Code.F64_SUB, put(k)),
        *(get(x), get(k), double(_HALF_PI[0]), Code.F64_MUL, Code.F64_SUB, tee(near)),
        *(get(k), double(_HALF_PI[1]), Code.F64_MUL, Code.F64_SUB, tee(r)),
        *(get(near), Code.F64_SUB, get(k), double(_HALF_PI[1]), Code.F64_MUL, Code.F64_ADD),
        *(get(k), double(_HALF_PI[2]), Code.F64_MUL, Code.F64_ADD, put(excess)),
        *(get(r), get(r), Code.F64_MUL, tee(z), double(0.5), Code.F64_MUL, put(half)),
        *(double(1.0), get(half), Code.F64_SUB, put(one)),
        # r - (excess one - (r z) S(z))
        *(get(r), get(excess), get(one), Code.F64_MUL, get(r), get(z), Code.F64_MUL, _polynomial(_SINE, z)),
        *(Code.F64_MUL, Code.F64_SUB, Code.F64_SUB, Code.TO_BITS, put(s)),
        # one + (((1 - one) - half) + ((z z) C(z) + r excess))
        *(get(one), double(1.0), get(one), Code.F64_SUB, get(half), Code.F64_SUB),
        *(get(z), get(z), Code.F64_MUL, _polynomial(_COSINE, z), Code.F64_MUL),
        *(get(r), get(excess), Code.F64_MUL, Code.F64_ADD, Code.F64_ADD, Code.F64_ADD, Code.TO_BITS, put(c)),
        # odd quarters exchange the two, and every second changes a sign
        *(get(s), get(c), Code.I64_XOR, long(0), get(quarter), long(1), Code.I64_AND, Code.I64_SUB, Code.I64_AND),
        *(put(exchange), get(quarter), long(1), Code.I64_ADD, put(turned)),
        *(get(s), get(exchange), Code.I64_XOR, _sign(quarter), Code.I64_XOR, Code.FROM_BITS),
        *(get(c), get(exchange), Code.I64_XOR, _sign(turned), Code.I64_XOR, Code.FROM_BITS),
    )
    return Function(Signature((F64,), (F64, F64)), ((7, F64), (5, I64)), body)


def _polynomial(coefficients: tuple[float, ...], z: int) -> bytes:
    """Push a polynomial in a local by Horner's rule, the innermost sum last: a + z (b + z (...))."""
    *outer, last = coefficients
    first = code(*(part for a in outer for part in (double(a), get(z))), double(last))
    return first + code(Code.F64_MUL, Code.F64_ADD) * len(outer)


def _sign(quarter: int) -> bytes:
    return code(get(quarter), long(2), Code.I64_AND, long(62), Code.I64_SHL)
