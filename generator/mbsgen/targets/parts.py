"""The lines of a function of C or Rust; long functions are divided into parts of bounded length.

Compilers take more than linear time for one function. Values that one part computes and a later one reads are kept: in
C in a struct, by name; in Rust in an array.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from mbsgen.targets.statements import Body, Check, Statement, Turn, Turns

# Least lines of a part. gcc 12 takes 19 s for a body of 9000 statements, most of it for register allocation, and a
# third of that in parts of 500 to 1000. Parts are also quicker to run where the code is about as large as the
# instruction cache: in parts of 300 the Hessian of an arm's EXP1 (4254 operations) takes 460 ns, whole 850; a Panda's
# Jacobian 470 instead of 880.
LENGTH = 300
_WORD = re.compile(r"\b[A-Za-z]\w*")
_AROUND_WORDS = re.compile(r"(\b[A-Za-z]\w*)")


@dataclass(frozen=True)
class Words:
    """How a language declares a value, and refers to one that is kept; {name} is the value's, {place} its number."""

    declared: str
    kept: str


C_WORDS = Words("const mbs_real {name}", "mbs_kept->{name}")


@dataclass(frozen=True)
class Store:
    """A nonzero of a result: `target = expression`."""

    result: str
    target: str
    expression: str


Line = Statement | Turns | Check | Store


@dataclass(frozen=True)
class Part:
    """Lines that form one function, or the whole body. Targets are written with their declarations."""

    name: str
    inputs: tuple[str, ...]  # the kernel's inputs that it reads
    results: tuple[str, ...]  # the kernel's results whose nonzeros it writes
    keeps: bool  # whether it reads or writes kept values
    lines: tuple[Line, ...]


@dataclass(frozen=True)
class Division:
    """A body in parts, to be run in turn; a short body is a single part."""

    parts: tuple[Part, ...]
    kept: tuple[str, ...]  # values that outlive their part


def divide(
    body: Body, inputs: Sequence[str], name: str = "mbs_part", length: int = LENGTH, words: Words = C_WORDS
) -> Division:
    """Divide the body of a function with the given inputs, once it has the length of two parts, named with numbers."""
    lines = order_lines(body)
    count = max(1, len(lines) // length)
    size = max(1, -(-len(lines) // count))
    slices = [lines[k : k + size] for k in range(0, len(lines), size)] or [()]
    read = [[_read(_texts(line)) for line in part] for part in slices]
    kept = _find_kept(slices, read)
    texts = {value: words.kept.format(name=value, place=k) for k, value in enumerate(kept)}
    parts = (
        _write_part(f"{name}{k}", part, own, texts, words, inputs)
        for k, (part, own) in enumerate(zip(slices, read, strict=True), 1)
    )
    return Division(tuple(parts), tuple(kept))


def order_lines(body: Body) -> tuple[Line, ...]:
    """Order all lines of a body: each check as early as possible, and nonzeros likewise after the last check."""
    last = max((c.place for c in body.checks), default=0)
    others: list[tuple[int, Line]] = [(c.place, c) for c in body.checks]
    others += [
        (max(place, last), Store(r.name, s.target, s.expression))
        for r in body.results
        for s, place in zip(r.statements, r.places, strict=True)
    ]
    lines: list[Line] = []
    done = 0
    for place, line in sorted(others, key=lambda other: other[0]):  # checks and nonzeros keep their order
        lines += body.statements[done:place]
        lines.append(line)
        done = place
    return (*lines, *body.statements[done:])


def _find_kept(slices: Sequence[Sequence[Line]], read: Sequence[Sequence[set[str]]]) -> dict[str, None]:
    """Find the values that other parts read, in the order in which they are computed; `read` has the names in lines."""
    if len(slices) == 1:
        return {}
    defined = [{name: None for line in part for name in _names(line)} for part in slices]
    outside: set[str] = set()
    for names, own in zip(read, defined, strict=True):
        outside |= set[str]().union(*names) - own.keys()
    return {name: None for own in defined for name in own if name in outside}


def _write_part(
    name: str,
    lines: Sequence[Line],
    names: Sequence[set[str]],
    kept: Mapping[str, str],
    words: Words,
    inputs: Sequence[str],
) -> Part:
    read = set[str]().union(*names)
    results = dict.fromkeys(line.result for line in lines if isinstance(line, Store))
    return Part(
        name,
        inputs=tuple(x for x in inputs if x in read),
        results=tuple(results),
        keeps=not kept.keys().isdisjoint(read.union(*map(_names, lines))),
        lines=tuple(_write_line(line, own, kept, words) for line, own in zip(lines, names, strict=True)),
    )


def _write_line(line: Line, names: set[str], kept: Mapping[str, str], words: Words) -> Line:
    """Declare the values that a line computes, or store them where they are kept; read kept values from there."""
    reads_kept = not kept.keys().isdisjoint(names)

    def declare(name: str) -> str:
        return name and (kept.get(name) or words.declared.format(name=name))

    def take(text: str) -> str:
        if not reads_kept:
            return text
        pieces = _AROUND_WORDS.split(text)
        pieces[1::2] = [kept.get(word, word) for word in pieces[1::2]]
        return "".join(pieces)

    match line:
        case Statement():
            return Statement(declare(line.target), take(line.expression))
        case Turns():
            return Turns(tuple(Turn(take(t.angle), declare(t.sine), declare(t.cosine)) for t in line.turns))
        case Check():
            return replace(line, value=take(line.value), scale=take(line.scale))
        case Store():
            return replace(line, expression=take(line.expression)) if reads_kept else line


def _names(line: Line) -> tuple[str, ...]:
    """List the values that a line computes."""
    match line:
        case Statement():
            return (line.target,)
        case Turns():
            return tuple(name for turn in line.turns for name in (turn.sine, turn.cosine) if name)
    return ()


def _texts(line: Line) -> tuple[str, ...]:
    """List the expressions of a line."""
    match line:
        case Turns():
            return tuple(turn.angle for turn in line.turns)
        case Check():
            return (line.value, line.scale)
        case _:
            return (line.expression,)


def _read(expressions: Iterable[str]) -> set[str]:
    """Collect the names in expressions."""
    return set(_WORD.findall(" ".join(expressions)))
