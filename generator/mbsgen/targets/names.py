"""Mangling: any name of a model -> a C identifier that every symbol and file name of the model starts with.

Different names give different prefixes, and no symbol of one model is a symbol of another, so that the generated C of
several models can be linked into one program. `Z` opens an escape: `ZZ` is a Z, `Z2dz` the character U+002D.
"""

from __future__ import annotations

import hashlib
import re

MAX_LENGTH = 34  # with the name of any kernel, 63: the most that Matlab reads
_KEPT = re.compile(r"[A-Ya-z0-9_]")
# Words that stand around the prefix in symbols (`jac_arm_impl`, `arm_compute_impl`, `mbs_abi.h`): as a part of a
# prefix they would make `jac_arm` + `impl` and `jac_` + `arm_impl` the same symbol, or `arm_IDX` + `_q` and `arm` +
# `_IDX_q`.
_RESERVED = frozenset({"jac", "adj1", "fwd1", "compute", "check", "mbs", "casadi", "IDX", "NUM", "NAMES"})
# A model of such a name would hide a header of C or POSIX (`math.h` from <math.h>), a library (`libm` from -lm), or a
# target of CMake's own; on some file systems in capitals too.
_HIDING = re.compile(
    "aio|assert|complex|cpio|ctype|dirent|dlfcn|errno|fcntl|fenv|float|fmtmsg|fnmatch|ftw|glob|grp|iconv|"
    "inttypes|iso646|langinfo|libgen|limits|locale|malloc|math|memory|monetary|mqueue|ndbm|netdb|poll|pthread|"
    "pwd|regex|sched|search|semaphore|setjmp|signal|spawn|stdalign|stdarg|stdatomic|stdbit|stdbool|stdckdint|"
    "stddef|stdint|stdio|stdlib|stdnoreturn|string|strings|stropts|syslog|tar|termios|tgmath|threads|time|"
    "trace|uchar|ulimit|unistd|utime|utmpx|wchar|wctype|wordexp|"
    "c|dl|gcc|m|rt|stdc|util|"
    "all|all_build|clean|edit_cache|help|install|package|package_source|preinstall|rebuild_cache|run_tests|test|zero_check",
    re.IGNORECASE,
)


def mangle(name: str) -> str:
    """Return the C prefix of a model called `name`: an identifier of at most MAX_LENGTH characters.

    It neither starts with a digit or an underscore nor ends with an underscore, and holds no two underscores in a row
    (such names are reserved in C and C++). A longer name is cut, and begins with 128 bits of its SHA-256.
    """
    assert name, "a model without a name is refused when it is read"
    text = "_".join(map(_escape_part, _escape(name).split("_")))
    if _HIDING.fullmatch(text):
        text = escape(text[0]) + text[1:]
    if len(text) <= MAX_LENGTH:
        return text
    digest = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:32]
    return f"Zs{digest}_{text}"[:MAX_LENGTH].rstrip("_")


def _escape(name: str) -> str:
    """Escape each character that an identifier cannot have at its position."""
    last = len(name) - 1
    return "".join(
        escape(c)
        if not _KEPT.fullmatch(c) or (c == "_" and (i in (0, last) or name[i - 1] == "_")) or (i == 0 and c.isdigit())
        else c
        for i, c in enumerate(name)
    )


def _escape_part(part: str) -> str:
    return escape(part[0]) + part[1:] if part in _RESERVED else part


def escape(character: str) -> str:
    """Write a character that an identifier cannot have there."""
    return "ZZ" if character == "Z" else f"Z{ord(character):x}z"
