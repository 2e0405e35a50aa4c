"""The C of `csrc/stages` and `csrc/program`, compiled once and cached, with the declarations of its headers."""

from __future__ import annotations

import os
import re
from functools import cache
from typing import Any

import cffi

from mbsgen import resources
from mbsrun.library import compile_library, find_compiler

_COMMENTS = re.compile(r"/\*.*?\*/", re.DOTALL)
_CPLUSPLUS = re.compile(r"#ifdef __cplusplus.*?#endif", re.DOTALL)
_PRECISION = re.compile(r"#ifdef MBS_STAGES_FLOAT.*?#else(.*?)#endif", re.DOTALL)
_DIRECTIVES = re.compile(r"^#(?!define \w+ \d+$).*$", re.MULTILINE)


def read_declarations(text: str) -> str:
    """Return the declarations of a header for cffi, in double precision."""
    text = _PRECISION.sub(r"\1", _CPLUSPLUS.sub("", _COMMENTS.sub("", text)))
    return _DIRECTIVES.sub("", re.sub(r"[ \t]+$", "", text, flags=re.MULTILINE))


@cache
def load() -> tuple[Any, Any]:
    """Compile and load the solver and the evaluator. Raises CompileError."""
    stages, program = (resources.folder("csrc") / name for name in ("stages", "program"))
    ffi = cffi.FFI()
    for header in (stages / "mbs_stages.h", program / "mbs_program.h"):
        ffi.cdef(read_declarations(header.read_text(encoding="utf-8")))
    names = sorted(file.name for folder in (stages, program) for file in folder.glob("*.c"))
    library = compile_library(stages, "mbs_stages", names, find_compiler(os.environ), program)
    return ffi, ffi.dlopen(str(library))
