"""Faults drawn by machine: operators, comparisons, constants and branches of a source file, changed one at a time.

A seed decides which; each file of the map below has the tests that should see a change of it. Comments, strings and
lines of imports are left alone. A change that leaves the meaning as it is may survive: the aim is 95 %, not all.
"""

from __future__ import annotations

import io
import random
import re
import tokenize
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.mutants.faults import ROOT, Fault

STAGES = ("tests/csrc/test_laws.py", "tests/csrc/test_stages.py", "tests/csrc/test_stages_inner.py")
OCP, MOTIONS = "tests/mbsrun/ocp", "tests/mbsrun/simulation"
SIGHTS: tuple[tuple[str, tuple[str, ...]], ...] = (  # the first pattern that a file matches decides
    ("csrc/stages/realtime.c", ("tests/csrc/test_laws.py", "tests/csrc/test_realtime.py")),
    ("csrc/stages/*.c", STAGES),
    ("csrc/mbs_least.c", ("tests/csrc/test_least.py", f"{MOTIONS}/test_loops.py")),
    ("csrc/mbs_variational.c", (f"{MOTIONS}/test_variational.py",)),
    ("csrc/mbs_cone.c", ("tests/csrc/test_laws.py", f"{MOTIONS}/test_stepping.py")),
    ("csrc/mbs_stepping.c", (f"{MOTIONS}/test_stepping.py",)),
    (
        "csrc/mbs_explicit.c",
        ("tests/csrc/test_least.py", *(f"{MOTIONS}/test_{name}.py" for name in ("loops", "simulate", "switching"))),
    ),
    ("csrc/mbs_radau.c", (f"{MOTIONS}/test_loops.py", f"{MOTIONS}/test_simulate.py")),
    ("csrc/program/*.c", ("tests/mbsrun/ocp/stages", "tests/mbsrun/controllers/test_controllers.py")),
    ("python/mbsrun/tracking/compiled.py", ("tests/mbsrun/tracking/test_compiled.py",)),
    ("python/mbsrun/tracking/*.py", ("tests/mbsrun/tracking",)),
    ("python/mbsrun/controllers/*.py", ("tests/mbsrun/controllers",)),
    ("python/mbsrun/simulation/**/*.py", (MOTIONS,)),
    ("python/mbsrun/linearisation/*.py", ("tests/mbsrun/linearisation",)),
    ("python/mbsrun/recordings/*.py", ("tests/mbsrun/recordings",)),
    ("python/mbsrun/ocp/evaluation/stages/*.py", (f"{OCP}/stages", f"{OCP}/test_methods.py")),
    ("python/mbsrun/ocp/*/*phase*.py", (f"{OCP}/phases",)),
    ("python/mbsrun/ocp/*/**/*.py", (OCP,)),
)

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


def draw(count: int, only: str, seed: int) -> list[Fault]:
    """Draw faults in the files whose path has `only` in it; each in proportion to its size."""
    found = [(file, tests, change) for file, tests in list_files(only) for change in list_changes(ROOT / file)]
    chosen = random.Random(seed).sample(found, min(count, len(found)))
    return [_write(file, tests, change) for file, tests, change in sorted(chosen, key=lambda x: (x[0], x[2].start))]


def list_files(only: str = "") -> list[tuple[str, tuple[str, ...]]]:
    """List the files that have tests, with these; a file counts by the first pattern that it matches."""
    known: dict[str, tuple[str, ...]] = {}
    for pattern, tests in SIGHTS:
        for path in sorted(ROOT.glob(pattern)):
            known.setdefault(path.relative_to(ROOT).as_posix(), tests)
    return [(file, tests) for file, tests in sorted(known.items()) if only in file]


def list_changes(path: Path) -> list[Change]:
    """List all changes that can be drawn of a file."""
    text = path.read_text(encoding="utf-8")
    tokens = _read_python(text) if path.suffix == ".py" else _read_c(text)
    return [
        Change(start, start + len(token), token, other, text.count("\n", 0, start) + 1)
        for start, token in tokens
        for other in _list_others(token)
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
    before = ""
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        line, last = token.line.lstrip(), before
        before = token.string
        if line.startswith(("import ", "from ", "@")) or not token.string:
            continue
        if token.string in ("*", "/") and not re.search(r"[\w\])'\"]$", last):
            continue  # of arguments, not a product
        is_number = token.type == tokenize.NUMBER and re.fullmatch(r"[\d.]+(?:[eE][-+]?\d+)?", token.string)
        if is_number or (token.string in SWAPS and token.type in (tokenize.OP, tokenize.NAME)):
            yield begins[token.start[0] - 1] + token.start[1], token.string


def _write(file: str, tests: tuple[str, ...], change: Change) -> Fault:
    """Take as many lines around the change as make its text unique."""
    text = (ROOT / file).read_text(encoding="utf-8")
    first, last = text.rfind("\n", 0, change.start) + 1, text.find("\n", change.end)
    while text.count(text[first:last]) > 1:
        first = text.rfind("\n", 0, max(first - 1, 0)) + 1
        last = text.find("\n", last + 1) if text.find("\n", last + 1) >= 0 else len(text)
    find = text[first:last]
    replace = text[first : change.start] + change.other + text[change.end : last]
    return Fault(f"{file}:{change.line}: {change.token} becomes {change.other}", file, find, replace, tests)
