"""The C of `csrc/stages`, `program`, `cases` and `threads`, compiled once and cached, with the declarations of its
headers.
"""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

from mbsgen import resources
from mbsrun.binding import declare
from mbsrun.library import CompileError, compile_library, find_compiler, once_per_compiler

_TIMED, _CASES = "mbs_timed_program.c", "mbs_cases.c"
_COMMENTS = re.compile(r"/\*.*?\*/", re.DOTALL)
_CPLUSPLUS = re.compile(r"#ifdef __cplusplus.*?#endif", re.DOTALL)
_PRECISION = re.compile(r"#ifdef MBS_STAGES_FLOAT.*?#else(.*?)#endif", re.DOTALL)
_DIRECTIVES = re.compile(r"^#(?!define \w+ \d+$).*$", re.MULTILINE)


def read_declarations(text: str) -> str:
    """Return the declarations of a header for cffi, in double precision."""
    text = _PRECISION.sub(r"\1", _CPLUSPLUS.sub("", _COMMENTS.sub("", text)))
    return _DIRECTIVES.sub("", re.sub(r"[ \t]+$", "", text, flags=re.MULTILINE))


@once_per_compiler
def load() -> tuple[Any, Any]:
    """Compile and load the solver and the evaluator. Raises CompileError."""
    folders = [resources.folder("csrc") / name for name in ("stages", "program", "timing", "cases")]
    headers = ("mbs_stages.h", "mbs_program.h", "mbs_timed_program.h", "mbs_cases.h")
    paths = (*map(Path.joinpath, folders, headers), _find_threads() / "mbs_threads.h")
    ffi = declare("\n".join(read_declarations(path.read_text(encoding="utf-8")) for path in paths))
    names = sorted(file.name for folder in folders[:2] for file in folder.glob("*.c"))
    compiler = find_compiler(os.environ)
    compiler = replace(compiler, flags=(*compiler.flags, "-DMBS_PROGRAM_LANES"))
    library = compile_library(folders[0], "mbs_stages", [*names, _TIMED, _CASES], compiler, *folders[1:], rows=names)
    return ffi, ffi.dlopen(str(library))


@once_per_compiler
def load_threads(ffi: Any) -> Any:
    """Compile and load the team of threads, for the declarations that come with `load`. Raises CompileError."""
    compiler = find_compiler(os.environ)
    compiler = replace(compiler, flags=(*compiler.flags, "-pthread"))
    try:
        library = compile_library(
            _find_threads(), "mbs_threads", ["mbs_threads.c"], compiler, resources.folder("csrc") / "stages"
        )
    except CompileError as error:
        raise CompileError(f"solver.threads: more than one needs POSIX threads; leave it out. {error}") from None
    return ffi.dlopen(str(library))


def _find_threads() -> Path:
    return resources.folder("csrc") / "threads"
