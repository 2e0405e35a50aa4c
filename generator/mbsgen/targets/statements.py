"""The body of a function: Tape -> named statements and results, as text of C or of a similar language.

`tape.counts` chooses the named values. An operation inside another is in parentheses, so that the language associates
as the tape does; except on the left of a sum, where all languages begin.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import count

from mpmath import mpf

from mbsgen.errors import TapeError
from mbsgen.tape.counts import count_uses, find_sums, named_values
from mbsgen.tape.types import ADD, DIV, FUNCTIONS, MUL, NEG, SUB, Op, Sparsity, Tape
from mbsgen.targets.contract import arguments

_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_SUMS = (ADD, SUB)
_INFIX = {ADD: " + ", SUB: " - ", MUL: "*", DIV: "/"}


def write_nonzeros(name: str, pattern: Sparsity) -> list[str]:
    """Write the nonzeros of an argument that is an array of them."""
    return [f"{name}[{k}]" for k in range(pattern.nnz)]


@dataclass(frozen=True)
class Syntax:
    """The parts of a language that differ: literals, calls, arguments, and reserved names."""

    literal: str  # {} stands for the digits
    calls: Mapping[Op, str]
    taken: re.Pattern[str]
    nonzeros: Callable[[str, Sparsity], list[str]] = write_nonzeros  # of an argument of this name and pattern
    turns: bool = False  # sines and cosines side by side are computed together
    number: Callable[[mpf | float], str] | None = None  # writes a literal; None: as the nearest double


# Keywords of C, and possible macros of <math.h> or the ABI header, cannot name local variables.
C = Syntax(
    "MBS_C({})",
    {op: f"MBS_{op.name}" for op in FUNCTIONS},
    re.compile(
        "auto|break|case|char|const|continue|default|do|double|else|enum|extern|float|for|goto|if|inline|int|long|register|"
        "restrict|return|short|signed|sizeof|static|struct|switch|typedef|union|unsigned|void|volatile|while|"
        "(a?sin|a?cos|a?tan|atan2|tanh|exp|log|sqrt|fabs)f?|linux|unix|mbs_.*|NAN|INFINITY|NULL|EOF|"
        "(MBS|FP|M|HUGE|MATH|INT|UINT|LONG|DBL|FLT|LDBL|DECIMAL)_.*"
    ),
    turns=True,
)


@dataclass(unsafe_hash=True)  # as if frozen: many are made
class Statement:
    """`target = expression`."""

    target: str
    expression: str


@dataclass(frozen=True)
class Turn:
    """An angle, and the names of its sine and cosine; empty for an unused one."""

    angle: str
    sine: str
    cosine: str


@dataclass(frozen=True)
class Turns:
    """Angles whose sines and cosines are computed together."""

    turns: tuple[Turn, ...]


@dataclass(frozen=True)
class Check:
    """A guard: the kernel fails at `joint` unless value exceeds the rounding of scale."""

    place: int  # the number of statements after which it can be tested
    value: str
    scale: str
    tolerance: str
    joint: int


@dataclass(frozen=True)
class Result:
    """An output with a nonzero, and the statements of its nonzeros."""

    name: str
    statements: tuple[Statement, ...]
    places: tuple[int, ...]  # the number of the body's statements that must precede each


@dataclass(frozen=True)
class Body:
    """A function's body: statements for all results, the guards in the order of their tests, the results."""

    statements: tuple[Statement | Turns, ...]
    checks: tuple[Check, ...]
    results: tuple[Result, ...]
    unused: tuple[str, ...]  # inputs that are not read


def write_body(tape: Tape, syntax: Syntax = C) -> Body:
    """Write a tape's operations and results as expressions of a language; equal tapes give equal text."""
    uses, named = count_uses(tape), named_values(tape)
    going_on = find_sums(tape)
    names = _choose_names(tape, syntax)
    texts = _write_leaves(tape, syntax)  # of every value, ready as an operand
    places = [0] * len(texts)  # the number of statements after which a value is known
    statements: list[Statement | Turns] = []
    infix = {op: sign for op, sign in _INFIX.items() if op not in syntax.calls}
    turning: dict[str, dict[Op, str]] = {}  # of the angles of the next Turns, the names of sine and cosine
    taken = {*names.values(), *(x.name for x in arguments(tape))}
    free = (name for k in count(1) if (name := f"t{k}") not in taken)
    for value, (op, a, b) in enumerate(tape.operations, tape.first_operation):
        is_used, sign = value in uses, infix.get(op)
        is_turn = syntax.turns and sign is None and op in (Op.SIN, Op.COS) and is_used
        if turning and not (is_turn and places[a] <= len(statements)):  # an angle may be a sine of these
            statements.append(_write_turns(turning))
            turning = {}
        if is_turn:
            texts.append(names.get(value) or next(free))
            turning.setdefault(_bare(texts[a]), {})[op] = texts[value]
            places.append(len(statements) + 1)
            continue
        if op is ADD and b in going_on and b not in named:  # a sum that continues is first: sums commute
            a, b = b, a
        if sign is None:
            expression = _write(syntax, op, texts[a], texts[b] if op.arity == 2 else "")
        else:
            expression = f"{_bare(texts[a]) if op in _SUMS else texts[a]}{sign}{texts[b]}"
        if is_used and value not in named:
            texts.append(expression if op in syntax.calls else f"({expression})")
        elif is_used:
            name = names.get(value) or next(free)
            statements.append(Statement(name, expression))
            texts.append(name)
        else:
            texts.append("")
        places.append(len(statements))
    if turning:
        statements.append(_write_turns(turning))
    results = tuple(
        Result(
            o.name,
            tuple(
                Statement(x, _bare(texts[v]))
                for x, v in zip(syntax.nonzeros(o.name, o.sparsity), o.values, strict=True)
            ),
            tuple(places[v] for v in o.values),
        )
        for o in tape.outputs
        if o.values
    )
    return Body(tuple(statements), _write_checks(tape, syntax, texts, places), results, _unused_inputs(tape, uses))


def write_lines(body: Body, assignment: str, check: str) -> tuple[str, ...]:
    """Merge statements and checks into one order, each check as early as possible.

    The forms name the fields of a Statement, {target} and {expression}, and of a Check.
    """
    lines, done = [], 0
    for c in body.checks:
        lines += [assignment.format_map(vars(s)) for s in body.statements[done : c.place]]
        lines.append(check.format_map(vars(c)))
        done = c.place
    return (*lines, *(assignment.format_map(vars(s)) for s in body.statements[done:]))


def write_literal(value: mpf | float, syntax: Syntax = C) -> str:
    """Write the nearest double, in the fewest digits that give it. Raises TapeError beyond the range of a double."""
    number = float(value)
    if not math.isfinite(number):
        raise TapeError(f"the number {value} is beyond the range of a double")
    return syntax.literal.format(repr(number))


def _write_number(value: mpf | float, syntax: Syntax) -> str:
    return syntax.number(value) if syntax.number else write_literal(value, syntax)


def _write(syntax: Syntax, op: Op, a: str, b: str) -> str:
    if op is NEG and op not in syntax.calls:
        return f"-{a}"
    return f"{syntax.calls[op]}({', '.join(map(_bare, (a, b)[: op.arity]))})"


def _write_turns(turning: Mapping[str, Mapping[Op, str]]) -> Turns:
    return Turns(tuple(Turn(angle, names.get(Op.SIN, ""), names.get(Op.COS, "")) for angle, names in turning.items()))


def _write_checks(tape: Tape, syntax: Syntax, texts: Sequence[str], places: Sequence[int]) -> tuple[Check, ...]:
    checks, place = [], 0
    for g in tape.guards:
        place = max(place, places[g.value], places[g.scale])  # no guard is tested before an earlier one
        tolerance = write_literal(g.tolerance, syntax)
        value = _write(syntax, NEG, texts[g.value], "") if g.negated else _bare(texts[g.value])
        checks.append(Check(place, value, texts[g.scale], tolerance, g.joint))
    return tuple(checks)


def _bare(text: str) -> str:
    """Remove the parentheses of an operand."""
    return text[1:-1] if text.startswith("(") else text


def _write_leaves(tape: Tape, syntax: Syntax) -> list[str]:
    texts = [x for i in tape.inputs for x in syntax.nonzeros(i.name, i.sparsity)]
    return texts + [_write_number(x, syntax) for x in tape.literals]


def _unused_inputs(tape: Tape, uses: Mapping[int, int]) -> tuple[str, ...]:
    unused, first = [], 0
    for source in tape.inputs:
        values = range(first, first := first + source.sparsity.nnz)
        if values and not any(uses.get(v) for v in values):
            unused.append(source.name)
    return tuple(unused)


def _choose_names(tape: Tape, syntax: Syntax) -> dict[int, str]:
    """Choose the labels that can name a variable: valid in the language, used once, different from all arguments."""
    taken = {x.name for x in arguments(tape)}
    assert all(_is_free(x, syntax) for x in taken), (
        f"{tape.name}: arguments {sorted(taken)} must be fit to name variables"
    )
    given = Counter(tape.labels.values())
    return {
        value: label
        for value, label in tape.labels.items()
        if value >= tape.first_operation and given[label] == 1 and label not in taken and _is_free(label, syntax)
    }


def _is_free(name: str, syntax: Syntax) -> bool:
    return bool(_IDENTIFIER.fullmatch(name)) and not syntax.taken.fullmatch(name)


def wrap(words: Iterable[str], width: int = 100) -> tuple[str, ...]:
    """Join words by commas, in lines of at most `width` characters."""
    lines: list[str] = []
    for word in words:
        if lines and len(lines[-1]) + len(word) + 2 <= width:
            lines[-1] += f", {word}"
        else:
            lines.append(word)
    return tuple(f"{line}," for line in lines[:-1]) + tuple(lines[-1:])
