"""Long bodies in parts: C functions of bounded length, since compilers take more than linear time for one.

Each part computes some of the statements. What later parts or the results read of them is kept in a struct, by name.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from mbsgen.targets.statements import Body, Statement

# Statements of a part, at least. gcc 12 takes 19 s for a body of 9000 statements, most of it to allocate registers, and
# a third of that for parts of 500 to 1000; the kernel is as fast.
LENGTH = 1000
_WORD = re.compile(r"\b[A-Za-z]\w*")


@dataclass(frozen=True)
class Part:
    """A function for a part of the statements."""

    name: str
    inputs: tuple[str, ...]  # of the kernel's, those that it reads
    statements: tuple[Statement, ...]  # their targets with what declares them


@dataclass(frozen=True)
class Division:
    """A body in parts, with what remains for the kernel itself; a body of no great length remains whole."""

    parts: tuple[Part, ...]
    kept: tuple[str, ...]  # values that outlive their part
    rest: Body


def divide(body: Body, inputs: Sequence[str]) -> Division:
    """Divide the body of a kernel with the given inputs, once it has the length of two parts."""
    count = len(body.statements) // LENGTH
    if count < 2:
        return Division((), (), body)
    size = -(-len(body.statements) // count)
    slices = [body.statements[k : k + size] for k in range(0, len(body.statements), size)]
    kept = _find_kept(body, slices)
    parts = tuple(_write_part(f"mbs_part{k}", statements, kept, inputs) for k, statements in enumerate(slices, 1))
    return Division(parts, tuple(s.target for s in body.statements if s.target in kept), _write_rest(body, kept))


def _find_kept(body: Body, slices: Sequence[Sequence[Statement]]) -> set[str]:
    """Find the values that are read outside the part that computes them."""
    kept = _read(s.expression for r in body.results for s in r.statements)
    kept |= _read(text for c in body.checks for text in (c.value, c.scale))
    for statements in slices:
        kept |= _read(s.expression for s in statements) - {s.target for s in statements}
    return kept & {s.target for s in body.statements}


def _write_part(name: str, statements: Sequence[Statement], kept: set[str], inputs: Sequence[str]) -> Part:
    read = _read(s.expression for s in statements)
    written = tuple(
        Statement(
            f"mbs_kept->{s.target}" if s.target in kept else f"const mbs_real {s.target}",
            _take(s.expression, kept, "mbs_kept->"),
        )
        for s in statements
    )
    return Part(name, tuple(x for x in inputs if x in read), written)


def _write_rest(body: Body, kept: set[str]) -> Body:
    """Write what comes after the parts."""

    def take(text: str) -> str:
        return _take(text, kept, "mbs_kept.")

    return replace(
        body,
        statements=(),
        checks=tuple(replace(c, value=take(c.value), scale=take(c.scale)) for c in body.checks),
        results=tuple(
            replace(r, statements=tuple(replace(s, expression=take(s.expression)) for s in r.statements))
            for r in body.results
        ),
    )


def _read(expressions: Iterable[str]) -> set[str]:
    """Collect the names in expressions."""
    return {name for text in expressions for name in _WORD.findall(text)}


def _take(expression: str, names: set[str], source: str) -> str:
    """Read the named values from where they are kept."""
    return _WORD.sub(lambda found: source + found[0] if found[0] in names else found[0], expression)
