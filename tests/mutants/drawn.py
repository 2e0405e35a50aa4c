"""Faults drawn by machine: operators, comparisons, constants and branches of a source file, changed one at a time.

A seed decides which; `sights` says which tests execute the function of a change. Comments, strings, lines of imports,
assertions of `zip` and examples of keys are left alone, and so are sizes -1 of `reshape` that become other negative
ones: NumPy takes any for the size that is left. A change that leaves the meaning as it is may survive: such
faults, once judged, stand in `equivalent.toml`.
"""

from __future__ import annotations

import io
import random
import re
import tokenize
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from keyword import iskeyword
from pathlib import Path

from tests.mutants.faults import ROOT, Fault, list_files
from tests.mutants.sights import choose

SWAPS = {
    "+": ("-",),
    "-": ("+",),
    "*": ("/",),
    "/": ("*",),
    "<": ("<=", ">"),
    "<=": ("<", ">"),
    ">": (">=", "<"),
    ">=": (">", "<"),
    "==": ("!=",),
    "!=": ("==",),
    "+=": ("-=",),
    "-=": ("+=",),
    "*=": ("/=",),
    "/=": ("*=",),
    "&&": ("||",),
    "||": ("&&",),
    "and": ("or",),
    "or": ("and",),
    "min": ("max",),
    "max": ("min",),
    "True": ("False",),
    "False": ("True",),
}
_RESHAPED = re.compile(r"\breshape\((?:(?:[^()]|\([^()]*\))*, )?-$")  # before a 1
_C_TOKEN = re.compile(
    r"""/\*.*?\*/ | //[^\n]* | "(?:\\.|[^"\\])*" | '(?:\\.|[^'\\])*' | ^[ \t]*\#[^\n]*(?:\\\n[^\n]*)* |
    (?P<number>(?<![\w.])(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?\b) | [A-Za-z_]\w* |
    ->|\+\+|--|<<|>>|(?P<sign>&&|\|\||[-+*/<>=!]=|(?<=\ )[-+*/<>](?=\ ))""",
    re.VERBOSE | re.DOTALL | re.MULTILINE,
)


@dataclass(frozen=True)
class Change:
    """One token, and what takes its place."""

    start: int  # of characters
    end: int
    token: str
    other: str
    line: int


def draw(only: str, seed: int) -> Iterator[Fault]:
    """Draw faults one after the other in the files whose path has `only` in it; each in proportion to its size."""
    found = [(file, change) for file in list_files(only) for change in list_changes(ROOT / file)]
    random.Random(seed).shuffle(found)
    for file, change in found:
        yield _write(file, change)


def list_changes(path: Path) -> list[Change]:
    """List all changes that can be drawn of a file."""
    text = path.read_text(encoding="utf-8")
    tokens = _read_python(text) if path.suffix == ".py" else _read_c(text)
    return [
        Change(start, start + len(token), token, other, text.count("\n", 0, start) + 1)
        for start, token in tokens
        for other in _list_others(token)
        if not (other == "10" and _RESHAPED.search(text, text.rfind("\n", 0, start) + 1, start))
    ]


def _list_others(token: str) -> Sequence[str]:
    if token in SWAPS:
        return SWAPS[token]
    if not token[0].isdigit():
        return ()
    return ("1",) if float(token) == 0 else ("0", f"{token}0" if token.isdigit() else f"{float(token) * 10:g}")


def _read_c(text: str) -> Iterator[tuple[int, str]]:
    for match in _C_TOKEN.finditer(text):
        if match["number"] or match["sign"]:
            yield match.start(), match[0]


def _read_python(text: str) -> Iterator[tuple[int, str]]:
    begins = [0]
    for line in text.splitlines(keepends=True):
        begins.append(begins[-1] + len(line))
    before, last = "", ""
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        line, ahead, last, before = token.line.lstrip(), last, before, token.string
        if line.startswith(("import ", "from ", "@")) or not token.string:
            continue
        if token.string in ("*", "/") and (iskeyword(last) or not re.search(r"[\w\])'\"]$", last)):
            continue  # of arguments, not a product
        if (ahead, last) == ("strict", "="):
            continue  # of zip: an assertion
        if 0 <= token.line.find("examples=[") < token.start[1]:
            continue  # of a key in the description of files
        is_number = token.type == tokenize.NUMBER and re.fullmatch(r"[\d.]+(?:[eE][-+]?\d+)?", token.string)
        if is_number or (token.string in SWAPS and token.type in (tokenize.OP, tokenize.NAME)):
            yield begins[token.start[0] - 1] + token.start[1], token.string


def _write(file: str, change: Change) -> Fault:
    """Take as many lines around the change as make its text unique."""
    text = (ROOT / file).read_text(encoding="utf-8")
    first, last = text.rfind("\n", 0, change.start) + 1, text.find("\n", change.end)
    while text.count(text[first:last]) > 1:
        first = text.rfind("\n", 0, max(first - 1, 0)) + 1
        last = text.find("\n", last + 1) if text.find("\n", last + 1) >= 0 else len(text)
    find = text[first:last]
    replace = text[first : change.start] + change.other + text[change.end : last]
    name = f"{file}:{change.line}: {change.token} becomes {change.other}"
    return Fault(name, file, find, replace, choose(file, change.line))
