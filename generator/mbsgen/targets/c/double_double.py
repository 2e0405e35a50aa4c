"""A tape as C in double-double arithmetic: operations are calls of mbs_double_double.h.

Each argument is two arrays of doubles: `q` and `low_q`. Literals keep the digits that they have in the tape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import count

from mpmath import mpf

from mbsgen.roles import name_low
from mbsgen.tape.ordering import arrange
from mbsgen.tape.types import LITERALS, Op, Sparsity, Tape
from mbsgen.targets.parts import Division, Line, Store, Words, divide
from mbsgen.targets.statements import C, Check, Syntax, Turn, Turns, write_body, write_literal

HEADER = "mbs_double_double.h"
NUMBER = "mbs_dd"  # the type of a value
_WORDS = Words(f"const {NUMBER} {{name}}", "mbs_kept->{name}")
_CALLS = {op: f"mbs_dd_{op.name.lower()}" for op in Op}


def write_pair(value: mpf | float) -> str:
    """Write a literal as the sum of two doubles. Raises TapeError beyond the range of a double."""
    high = write_literal(value, _PLAIN)
    return f"mbs_dd_of({high}, {float(LITERALS.mpf(value) - LITERALS.mpf(float(value)))!r})"


_PLAIN = replace(C, literal="{}")


def divide_tape(tape: Tape, name: str, length: int) -> tuple[Division, tuple[str, ...]]:
    """Write a tape as the lines of functions of bounded length; return them, and the inputs that none of them reads."""
    given = {i.name for i in tape.inputs}

    def write_nonzeros(argument: str, pattern: Sparsity) -> list[str]:
        if argument not in given:
            return [f"{argument}[{k}]" for k in range(pattern.nnz)]
        return [f"mbs_dd_sum({argument}[{k}], {name_low(argument)}[{k}])" for k in range(pattern.nnz)]

    syntax = Syntax("{}", _CALLS, C.taken, write_nonzeros, turns=True, number=write_pair)
    body = write_body(arrange(tape), syntax)
    inputs = [part for i in tape.inputs for part in (i.name, name_low(i.name))]
    return divide(body, inputs, name, length, _WORDS), body.unused


def write_line(line: Line, number: str) -> list[str]:
    """Write a line of a function; `number` is different for each line."""
    match line:
        case Turns():
            return [text for k, turn in enumerate(line.turns, 1) for text in _write_turn(turn, f"mbs_turn{number}_{k}")]
        case Check():
            test = f"mbs_dd_stands({line.value}, {line.tolerance}, {line.scale})"
            return [f"if (!{test})", f"    return {line.joint};"]
        case Store():
            return [f"mbs_dd_store(&{line.target}, &{name_low(line.target)}, {line.expression});"]
        case _:
            return [f"{line.target} = {line.expression};"]


def write_lines(lines: Sequence[Line]) -> list[str]:
    """Write the lines of a function."""
    return [text for line, number in zip(lines, count(1), strict=False) for text in write_line(line, str(number))]


def _write_turn(turn: Turn, name: str) -> list[str]:
    parts = ((turn.sine, "sine"), (turn.cosine, "cosine"))
    return [
        f"const mbs_dd_turn {name} = mbs_dd_sincos({turn.angle});",
        *(f"{target} = {name}.{part};" for target, part in parts if target),
    ]
