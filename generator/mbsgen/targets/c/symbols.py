"""Symbols: the names in the object files of a folder, each with a tag that is a hash of the folder's C.

Two folders may have one name and other content, or the same C files of this project. A linker takes the first of two
definitions in libraries, so a program would compute with the wrong one, without a word. With the tag, each definition
has its own symbol. Symbols of single precision say so, since one folder may be compiled for both. A header of macros
maps the documented names to them, so that no program sees the tag.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Collection, Iterable, Mapping

from mbsgen.request import OptionError
from mbsgen.targets.names import MAX_LENGTH, mangle

PRIVATE = "mbs_private.h"  # gives the functions of C files that folders share the symbols of one folder
DIGITS = 8  # of the tag, hexadecimal
OPEN = "t" * DIGITS  # stands for the tag until the content is known
_FUNCTION = r"^(?!static\b|typedef\b|return\b)[A-Za-z_][\w \t*]*?\b({}_\w+)\("
_VARIABLES = re.compile(r"^extern [^\";(]*;", re.MULTILINE)


def check_prefix(prefix: str, taken: str = "", words: Collection[str] = ()) -> str:
    """Return a prefix that a user gives, other than one that is taken, and than words of the C around it.

    Raises OptionError where names cannot begin with it.
    """
    if taken and prefix == taken:
        raise OptionError(f"prefix: names of the model begin with {taken}; give another one to the controller")
    if not prefix or mangle(prefix) != prefix or prefix in words:
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


def write_own(symbol: str, end: str, macro: str = "MBS_OWN") -> str:
    """Write a symbol in C: a macro puts the precision behind `end`, the tagged part of it or the prefix."""
    head, found, tail = symbol.partition(end)
    assert found, f"{symbol} has no {end}"
    return f"{macro}({head}{end}, {tail})"


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


def find_declared(prefix: str, headers: Iterable[str]) -> tuple[str, ...]:
    """Find the functions and variables that headers in C declare, and whose names begin with a prefix, in order."""
    function, variable = re.compile(_FUNCTION.format(prefix), re.MULTILINE), rf"[ *]({prefix}_\w+)(?=[,;\[])"
    found = dict[str, None]()
    for text in headers:
        found |= dict.fromkeys(function.findall(text))
        found |= dict.fromkeys(name for line in _VARIABLES.findall(text) for name in re.findall(variable, line))
    return tuple(found)


def hash_text(text: str) -> str:
    """Return the tag of a text."""
    return hashlib.sha256(text.encode()).hexdigest()[:DIGITS]
