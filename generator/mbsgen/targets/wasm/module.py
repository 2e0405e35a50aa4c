"""Tapes -> one WebAssembly module, with the functions that the generated C has in CasADi's contract.

An exported function takes addresses in the module's memory: of an array of addresses of inputs, and of one of results.
An address 0 stands for zeros, or for a result that is not wanted. It returns 0, or the joint at which it fails; then it
stores nothing. Sums and products are rounded one by one, as in C without fused multiply-add.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import count

from mbsgen.tape.counts import count_uses, named_values
from mbsgen.tape.interpreter import FLOATS, find_threshold
from mbsgen.tape.types import Op, Tape
from mbsgen.targets.contract import Face, faces
from mbsgen.targets.unit import Unit
from mbsgen.targets.wasm.encoding import (
    F64,
    I32,
    MOST_LOCALS,
    Code,
    Function,
    Module,
    Signature,
    call,
    code,
    double,
    encode,
    get,
    integer,
    load,
    load_address,
    put,
    store,
    when,
)
from mbsgen.targets.wasm.functions import IMPORTED, import_function, write_sine_cosine

ZEROS = 16  # the address of zeros that missing inputs are read from
CONTRACT = Signature((I32,) * 5, (I32,))
_CODES = {
    Op.ADD: Code.F64_ADD,
    Op.SUB: Code.F64_SUB,
    Op.MUL: Code.F64_MUL,
    Op.DIV: Code.F64_DIV,
    Op.NEG: Code.F64_NEG,
    Op.SQRT: Code.F64_SQRT,
    Op.ABS: Code.F64_ABS,
}
_TURNS = (Op.SIN, Op.COS)


def write_wasm(unit: Unit) -> dict[str, bytes]:
    """Write the module of a unit, by its file name."""
    return {f"{unit.prefix}.wasm": write_module(x for family in unit.families for x in faces(family, unit.prefix))}


def write_module(found: Iterable[Face]) -> bytes:
    """Write a module that exports functions under their names in C; the same functions give the same bytes.

    Functions without a straight-line program are left out, and functions of more values than engines admit.
    """
    kernels = [(face, face.tape) for face in found if isinstance(face.tape, Tape)]
    used = {op for _, tape in kernels for op, _, _ in tape.operations}
    called = [op for op in IMPORTED if op in used or (op in _TURNS and used & {*_TURNS})]
    numbers: dict[Op | None, int] = {op: k for k, op in enumerate(called)}
    numbers[None] = len(called)  # sine and cosine together
    turning = (write_sine_cosine(numbers[Op.SIN], numbers[Op.COS]),) if Op.SIN in numbers else ()
    written = (_Writer(face, tape, numbers).write() for face, tape in kernels)
    functions = (x for x in written if sum(number for number, _ in x.locals) <= MOST_LOCALS)
    longest = max((slot.sparsity.nnz for face, _ in kernels for slot in face.inputs), default=0)
    return encode(Module(tuple(map(import_function, called)), (*turning, *functions), ZEROS + 8 * longest))


class _Writer:
    """Writes one function: named values of the tape are locals, other ones stand where they are used."""

    def __init__(self, face: Face, tape: Tape, numbers: Mapping[Op | None, int]) -> None:
        self._face, self._tape, self._numbers = face, tape, numbers
        self._uses, self._named = count_uses(tape), named_values(tape)
        self._addresses = [x.name for x in (*face.inputs, *face.outputs) if x.sparsity.nnz]  # their locals come first
        self._floats = 0  # locals in doubles so far
        self._turns: dict[int, dict[Op, int]] = {}  # of an angle, the locals of its sine and cosine

    def write(self) -> Function:
        """Write the function."""
        lines = [*self._read_addresses()]
        texts = [*self._read_inputs(lines), *(double(float(x)) for x in self._tape.literals)]
        for value, (op, a, b) in enumerate(self._tape.operations, self._tape.first_operation):
            texts.append(self._write_value(value, op, [texts[k] for k in (a, b)[: op.arity]], a, lines))
        lines += self._write_checks(texts)
        lines += self._write_results(texts)
        kinds = (len(self._addresses), I32), (self._floats, F64)
        return Function(CONTRACT, kinds, code(*lines, integer(0)), self._face.symbol)

    def _read_addresses(self) -> Iterator[bytes]:
        for array, slots in enumerate((self._face.inputs, self._face.outputs)):
            for k, slot in enumerate(slots):
                if not slot.sparsity.nnz:
                    continue
                own = self._address(slot.name)
                yield code(get(array), load_address(4 * k), put(own))
                if array == 0:
                    yield code(get(own), integer(ZEROS), get(own), Code.SELECT, put(own))

    def _address(self, name: str) -> int:
        return len(CONTRACT.arguments) + self._addresses.index(name)

    def _declare(self) -> int:
        """Take a new local for a double."""
        self._floats += 1
        return len(CONTRACT.arguments) + len(self._addresses) + self._floats - 1

    def _read_inputs(self, lines: list[bytes]) -> Iterator[bytes]:
        values = count()
        for source in self._tape.inputs:
            for k, value in zip(range(source.sparsity.nnz), values, strict=False):
                text = code(get(self._address(source.name)), load(8 * k))
                if self._uses[value] < 2:
                    yield text
                    continue
                own = self._declare()
                lines.append(code(text, put(own)))
                yield get(own)

    def _write_value(self, value: int, op: Op, operands: Sequence[bytes], angle: int, lines: list[bytes]) -> bytes:
        """Return the instructions that push a value; a named one is computed in a new line."""
        if not self._uses[value]:
            return b""
        if op in _TURNS:
            return get(self._turn(op, angle, operands[0], lines))
        text = self._compute(op, operands)
        if value not in self._named:
            return text
        own = self._declare()
        lines.append(code(text, put(own)))
        return get(own)

    def _turn(self, op: Op, angle: int, text: bytes, lines: list[bytes]) -> int:
        """Return the local of a sine or a cosine; both of an angle are computed together."""
        if angle not in self._turns:
            self._turns[angle] = {x: self._declare() for x in _TURNS}
            sine, cosine = self._turns[angle].values()
            lines.append(code(text, call(self._numbers[None]), put(cosine), put(sine)))
        return self._turns[angle][op]

    def _compute(self, op: Op, operands: Sequence[bytes]) -> bytes:
        if op in _CODES:
            return code(*operands, _CODES[op])
        if op is not Op.SIGN:
            return code(*operands, call(self._numbers[op]))
        own = self._declare()
        positive = code(get(own), double(0.0), Code.F64_GT)
        other = code(double(-1.0), get(own), get(own), double(0.0), Code.F64_LT, Code.SELECT)
        return code(*operands, put(own), double(1.0), other, positive, Code.SELECT)

    def _write_checks(self, texts: Sequence[bytes]) -> Iterator[bytes]:
        for guard in self._tape.guards:
            sign = (Code.F64_NEG,) if guard.negated else ()
            bound = code(double(find_threshold(guard.tolerance, FLOATS)), texts[guard.scale], Code.F64_MUL)
            holds = code(texts[guard.value], *sign, bound, Code.F64_GT)
            yield code(holds, Code.I32_EQZ, when(integer(guard.joint), Code.RETURN))

    def _write_results(self, texts: Sequence[bytes]) -> Iterator[bytes]:
        for output in self._tape.outputs:
            if output.values:
                own = self._address(output.name)
                entries = (code(get(own), texts[value], store(8 * k)) for k, value in enumerate(output.values))
                yield code(get(own), when(*entries))
