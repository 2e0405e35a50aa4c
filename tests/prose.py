"""The prose of the repository, by file and line: docstrings, comments, messages, help texts and Markdown."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = ("benchmarks", "csrc", "docs", "generator", "models", "python", "studies", "templates", "tests")
MADE = ("docs/study", "docs/laboratory", "benchmarks/results")  # written by programs, whose own texts are read
WORDS = 4  # a shorter string literal is a name, not a text
FENCE = re.compile(r"^```.*?^```$", re.DOTALL | re.MULTILINE)
C_COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)
# Strings, which may hold the sign of a comment, come first: `tokenize` takes six times as long.
PYTHON_COMMENT = re.compile(
    r'''"""(?:\\.|[^\\])*?"""|\'{3}(?:\\.|[^\\])*?\'{3}|"(?:\\.|[^"\\])*"|\'(?:\\.|[^\'\\])*\'|(#[^\n]*)''', re.DOTALL
)
COMMENTS: Mapping[str, re.Pattern[str]] = {
    ".c": C_COMMENT,
    ".h": C_COMMENT,
    ".hpp": C_COMMENT,
    ".cpp": C_COMMENT,
    ".j2": re.compile(r"\{#.*?#\}|/\*.*?\*/|^[%#] [^\n]*", re.DOTALL | re.MULTILINE),
    ".yaml": re.compile(r"(?:^|\s)# [^\n]*"),
    ".toml": re.compile(r"(?:^|\s)# [^\n]*"),
    "": re.compile(r"(?:^|\s)# [^\n]*"),
}

OWNERS: Mapping[type[ast.AST], str] = {  # of docstrings
    ast.FunctionDef: "function",
    ast.AsyncFunctionDef: "function",
    ast.ClassDef: "class",
    ast.Module: "module",
}


@dataclass(frozen=True)
class Text:
    """A piece of prose, and the file and the line where it starts."""

    path: str
    line: int
    text: str
    of: str = ""  # the docstring of a function, a class or a module; empty: another text


def find_files() -> list[str]:
    """List the files that hold prose, by their paths from the root."""
    known = {".py", ".md", *COMMENTS}
    names = ["Makefile", "pyproject.toml", *(path.name for path in ROOT.glob("*.md"))]
    for folder in FOLDERS:
        for path in (ROOT / folder).rglob("*"):
            name = path.relative_to(ROOT).as_posix()
            if path.is_file() and path.suffix in known and not name.startswith(MADE):
                names.append(name)
    return sorted(names)


def read_texts(name: str) -> list[Text]:
    """Return the prose of a file."""
    path = ROOT / name
    source = path.read_text(encoding="utf-8")
    match path.suffix:
        case ".py":
            return [*_read_python(name, source)]
        case ".md":
            return [*_read_markdown(name, source)]
    return [Text(name, _line(source, m.start()), m.group()) for m in COMMENTS[path.suffix].finditer(source)]


def read_sentences(text: str) -> list[str]:
    """Split a paragraph of Markdown into sentences; code and links count as words."""
    plain = re.sub(r"`[^`]*`", "code", re.sub(r"\]\([^)]*\)", "]", text))
    return [s for s in re.split(r"(?<=[.:;?!])[)\"*]*\s+|\|", " ".join(plain.split())) if s]


def _line(source: str, position: int) -> int:
    return source.count("\n", 0, position) + 1


def _read_python(name: str, source: str) -> Iterator[Text]:
    docstrings: dict[int, str] = {}
    for node in ast.walk(ast.parse(source)):  # a function comes before its docstring
        if isinstance(node, tuple(OWNERS)) and node.body and isinstance(node.body[0], ast.Expr):
            docstrings[id(node.body[0].value)] = OWNERS[type(node)]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            of = docstrings.get(id(node), "")
            if of == "function" or node.value.count(" ") >= WORDS - 1:
                yield Text(name, node.lineno, node.value, of)
    line, last = 1, 0
    for match in PYTHON_COMMENT.finditer(source):
        if match.group(1):
            line, last = line + source.count("\n", last, match.start()), match.start()
            yield Text(name, line, match.group(1))


def _read_markdown(name: str, source: str) -> Iterator[Text]:
    """Read paragraphs, items of lists and rows of tables; fenced and indented code is left out."""
    prose = FENCE.sub(lambda match: "\n" * match.group().count("\n"), source)
    start = 0
    for end in [m.start() for m in re.finditer(r"\n\s*\n|\n(?=\s*[-*|#] ?)|\n(?=\s*\d+\. )|\Z", prose)]:
        paragraph = prose[start:end]
        is_code = all(line.startswith("    ") for line in paragraph.splitlines() if line.strip())
        if not is_code:
            yield Text(name, _line(prose, start + len(paragraph) - len(paragraph.lstrip())), paragraph)
        start = end
