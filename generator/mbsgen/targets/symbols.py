"""Symbols: the names in the object files of a folder, each with a tag that is a hash of the folder's C.

Two folders may have one name and other content, or the same C files of this project. A linker takes the first of two
definitions in libraries, so a program would compute with the wrong one, without a word. With the tag, each definition
has its own symbol. A header of macros maps the documented names to them, so that no program sees the tag.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping

from mbsgen.request import OptionError
from mbsgen.targets.names import MAX_LENGTH, mangle

DIGITS = 8  # of the tag, hexadecimal
OPEN = "t" * DIGITS  # stands for the tag until the content is known
_DECLARED = re.compile(r"^(?!static\b|typedef\b|return\b)[A-Za-z_][\w \t*]*?\b(mbs_\w+)\(", re.MULTILINE)
_VARIABLES = re.compile(r"^extern (?!\")[^;(]*;", re.MULTILINE)


def check_prefix(prefix: str) -> str:
    """Return a prefix that a user gives. Raises OptionError where names cannot begin with it."""
    if not prefix or mangle(prefix) != prefix:
        finding = f"{prefix!r} cannot begin the names in C"
        remedy = f"give at most {MAX_LENGTH} letters, digits and single underscores, such as left_arm, and no word of C"
        raise OptionError(f"prefix: {finding}; {remedy}")
    return prefix


def describe_mangling(name: str, prefix: str) -> str:
    """Return a notice where the names in C do not begin with the name as written; else an empty text."""
    if name == prefix or mangle(name) != prefix:
        return ""
    finding = f"names in C begin with {prefix}, since {name!r} cannot begin them"
    return f"{finding}; choose other ones by --prefix"


def tag(prefix: str) -> str:
    """Return the prefix with the place of the tag, which `seal` fills in."""
    return f"{prefix}_{OPEN}"


def seal(files: Mapping[str, str], prefix: str) -> tuple[dict[str, str], str]:
    """Fill in the tag, a hash of all C files. Return the files, and the tagged prefix."""
    digest = hashlib.sha256()
    for name, text in sorted(files.items()):
        if name.endswith((".c", ".h")):
            digest.update(f"{name}\0{text}\0".encode())
    sealed = f"{prefix}_{digest.hexdigest()[:DIGITS]}"
    return {name: _fill_in(text, prefix, sealed) for name, text in files.items()}, sealed


def _fill_in(text: str, prefix: str, sealed: str) -> str:
    number = sealed.removeprefix(f"{prefix}_")
    return text.replace(tag(prefix), sealed).replace(f"0x{OPEN}", f"0x{number}")


def find_functions(headers: Iterable[str]) -> tuple[str, ...]:
    """Find the functions and variables of this project that headers in C declare, in their order."""
    found = dict[str, None]()
    for text in headers:
        found |= dict.fromkeys(_DECLARED.findall(text))
        found |= dict.fromkeys(name for line in _VARIABLES.findall(text) for name in re.findall(r"\*(mbs_\w+)", line))
    return tuple(found)
