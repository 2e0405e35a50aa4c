"""The C of `csrc/stages` and `csrc/program`, compiled once and cached, with the declarations of its headers."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from functools import cache
from typing import Any

import cffi

from mbsgen import resources
from mbsrun.library import compile_library, find_compiler

_TIMED = "mbs_timed_program.c"
_SCALAR = "-fno-tree-slp-vectorize"  # a flag that is good for kernels; rows of the solver want vectors
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
    folders = [resources.folder("csrc") / name for name in ("stages", "program", "timing")]
    ffi = cffi.FFI()
    for folder, header in zip(folders, ("mbs_stages.h", "mbs_program.h", "mbs_timed_program.h"), strict=True):
        ffi.cdef(read_declarations((folder / header).read_text(encoding="utf-8")))
    names = sorted(file.name for folder in folders[:2] for file in folder.glob("*.c"))
    compiler = find_compiler(os.environ)
    compiler = replace(compiler, flags=tuple(flag for flag in compiler.flags if flag != _SCALAR))
    library = compile_library(folders[0], "mbs_stages", [*names, _TIMED], compiler, *folders[1:])
    return ffi, ffi.dlopen(str(library))
