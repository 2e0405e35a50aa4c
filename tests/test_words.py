"""Prose is read once: it keeps to subject, verb and object, and repeats a noun instead of pointing back to it.

Each pattern below stands for a turn that makes a reader start the sentence again. The message gives the plain form.
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import pytest

from tests.prose import Text, find_files, read_sentences, read_texts

SELF = "tests/test_words.py"
LONGEST = 35  # words in a sentence of a document
PATTERNS = {
    r"\b(tells?(?! from)|told|telling)\b": "a function returns, a report shows, a table lists, a message says",
    r"\b(that|those) of\b": "repeat the noun: `the sum of these differs from the sum of those` is read twice",
    r"\bthose (that|which|who|whose|in|with|by|for|on)\b": "name the things: `the joints that`, not `those that`",
    r"\bthat there (is|are)\b": "`that exists`; `a cluster that there is not` is an unreachable one",
    r"\b(leaves?|(?<!the )left(?! of the d)|has|have|had|having|known) of\b": "name the amount or the property",
    r"\bof (its|their) own\b": "`its own function` or `a separate function`",
    r"\b(of|by|with|than|from|for|beside|on) what\b": "name the thing: `the values that`, not `of what`",
    r"(^|[.:;] |\"\"\")(What|How (many|much|far|long|often))\b(?![^.]*\?)": "make the thing itself the subject",
    r"\bbut for\b": "`except for`",
    r"\b(goes|go|went|going) by\b": "`uses`, `depends on`, `is found with`",
    r"\b(is|are|was|were|as|where|if) wanted\b": "`requested`",
    r"\bso (many|much|few)\b(?! (\w+ )?(that|as)\b)": "give the number, or `as many as`",
    r"\basks? of\b": "`requires`",
}
OPENINGS = {
    "Tell": "Return",
    "Give": "Return",
    "Say": "Return, or the verb for the output: print, describe",
    "What": "Return, List or Compute",
    "How": "Return, Count or Measure",
    "Let": "the verb itself",
}

# Files and folders that the rules above are not yet held against. Only to be shortened. The texts of `COPIED` are
# copied into generated folders, so changing them changes generated files.
COPIED = (
    "csrc/mbs_abi.h",
    "csrc/mbs_check.c",
    "csrc/mbs_columns.h",
    "csrc/mbs_sincos.h",
    "csrc/mbs_symmetric.h",
    "generator/mbsgen/procedure/elimination.py",
    "templates/",
)
UNSWEPT: tuple[str, ...] = (
    *COPIED,
    "python/mbsrun/ocp/solution/record.py",  # the name of a column of its files
)


def find_faults(text: Text) -> list[str]:
    """List the patterns that a text contains, with the plain form of each."""
    place = f"{text.path}:{text.line}"
    faults = []
    prose = CODE.sub("`code`", text.text)
    for pattern, plain in COMPILED.items():
        if match := pattern.search(prose):
            faults.append(f'{place}: "{match.group().strip()}": {plain}')
    opening = text.text.split(maxsplit=1)[0] if text.of == "function" and text.text.strip() else ""
    if opening in OPENINGS:
        faults.append(f'{place}: a docstring opens with "{opening}": {OPENINGS[opening]}')
    if text.of:
        faults += [f'{place}: a sentence without an end: "... {found[-60:]}"' for found in list_open_ends(text.text)]
    if text.path.endswith(".md"):
        for sentence in read_sentences(text.text):
            if len(sentence.split()) > LONGEST:
                faults.append(f"{place}: {len(sentence.split())} words in one sentence: {sentence[:60]}...")
    return faults


def list_open_ends(docstring: str) -> list[str]:
    """List the paragraphs of a docstring whose last sentence does not end, or breaks off before a noun.

    A sentence begins with a capital letter, or with code. Equations and examples are indented, or begin otherwise; one
    that follows ends a sentence, too. Lists and tables need no ends.
    """
    margin = docstring.rpartition("\n")[2] if "\n" in docstring else ""
    plain = docstring.replace("\n" + margin, "\n")
    paragraphs = [part.rstrip() for part in re.split(r"\n[ \t]*\n", plain) if part.strip()]
    return [
        part
        for part, after in zip(paragraphs, [*paragraphs[1:], ""], strict=True)
        if re.match(r"[A-Z`]", part)
        and not APART.match(part.splitlines()[-1])
        and not after.startswith(" ")
        and (not END.search(part) or BROKEN.search(part))
    ]


APART = re.compile(r" |\||- |\d+\. ")
END = re.compile(r"[.:?!…][)\"'`”]*$")
BROKEN = re.compile(r"\b(an|the|and|or|whose|than)[.:]$")
CODE = re.compile(r"`[^`\n]*`")
COMPILED = {re.compile(pattern): plain for pattern, plain in PATTERNS.items()}


@cache
def faults_by_file() -> dict[str, list[str]]:
    """Read all files once."""
    names = [name for name in find_files() if name != SELF]
    return {name: [fault for text in read_texts(name) for fault in find_faults(text)] for name in names}


def test_prose_is_read_once() -> None:
    faults = [fault for name, found in faults_by_file().items() if not name.startswith(UNSWEPT) for fault in found]
    assert not faults, "\n".join(faults)


def test_what_is_still_to_be_swept_has_faults() -> None:
    """A file or a folder without faults leaves the list."""
    faulty = [name for name, faults in faults_by_file().items() if faults]
    assert not [part for part in UNSWEPT if not any(name.startswith(part) for name in faulty)]


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("How many are lost where none fails tells a function of its own", 3),
        ("What the equations of motion leave of accelerations, by what these are sums of", 3),
        ("The kernel `condition` estimates the lost digits for states in which no pivot fails", 0),
        ("The defect in the summary shows whether the number of steps is sufficient", 0),
    ],
)
def test_dialect_is_found_and_plain_words_pass(text: str, count: int) -> None:
    assert len(find_faults(Text("x.py", 1, text))) == count


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("Return a motion, which has no trajectory that could be taken for a", 1),
        ("Return a motion. It is no trajectory of the.", 1),
        ("Return a motion\n\n        x(t)\n\n    of a body.\n    ", 0),
        ("Return a motion (of one body).\n\nThe others\n\nRaises ValueError.", 1),
        ("Return a motion:\n        q  a column\n        u  another\n    ", 0),
    ],
)
def test_sentences_of_docstrings_end(text: str, count: int) -> None:
    assert len(find_faults(Text("x.py", 1, text, "function"))) == count


def test_texts_have_their_lines(tmp_path: Path) -> None:
    """Docstrings, comments and messages of Python, paragraphs and items of Markdown, comments of C."""
    files = {
        "a.py": ('x = 1  # one\n\ndef f() -> str:\n    """Two."""\n    return "a b c d"\n', [4, 5, 1]),
        "b.md": ("# One\n\nTwo\nand more.\n\n```sh\nno prose\n```\n- three\n- four\n", [1, 3, 9, 10]),
        "c.h": ("/* one\n * more */\nint x; // two\n", [1, 3]),
    }
    for name, (source, lines) in files.items():
        (tmp_path / name).write_text(source)
        assert [text.line for text in read_texts(str(tmp_path / name))] == lines
