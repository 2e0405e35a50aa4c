"""C files -> one WebAssembly module that imports nothing.

Zig's compiler (the package ziglang) brings the C library musl, whose `sin`, `exp` and the like are compiled into the
module. So it computes as C does in double precision, without fused multiply-add, and no browser's functions
change them.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Sequence
from importlib.metadata import version
from pathlib import Path, PurePath

from mbsrun.cache import COMPILED, find_or_make
from mbsrun.library import CompileError, find_zig, read_source, run_compiler

HEAP = "__heap_base"  # the address behind everything that the module itself uses
FLAGS = (
    *("-target", "wasm32-wasi", "-mexec-model=reactor", "-std=c99", "-O2", "-ffp-contract=off", "-fno-math-errno"),
    *("-fno-sanitize=undefined", "-DMBS_SCALAR"),
)
LINK = ("--no-entry", "--strip-all", f"--export={HEAP}")
_NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)


def compile_module(folder: Path, prefix: str, sources: Iterable[str], exports: Sequence[str]) -> bytes:
    """Compile C files of a folder to a module that exports the named functions, `memory` and HEAP.

    The same files give the same bytes. Raises CompileError where ziglang is not installed, with the compiler's message,
    or for names that cannot be generated ones.
    """
    zig = find_zig()
    strange = [name for name in (prefix, *exports) if not _NAME.fullmatch(name)]
    if strange:
        raise CompileError(f"{folder}: {strange[0]!r} cannot be a generated name; generate the folder again")
    names = tuple(dict.fromkeys(sources))
    files = {name: text for source in names for name, text in read_source((folder,), source, {}).items()}
    linking = ",".join(("-Wl", *LINK, *(f"--export={name}" for name in exports)))

    def make(building: Path) -> Path:
        for name, text in files.items():
            (building / name).write_bytes(text)
        run_compiler([*zig, *FLAGS, linking, *names, "-o", "module.wasm", "-lm"], building)
        return building / "module.wasm"

    digest = hashlib.sha256(repr((version("ziglang"), FLAGS, linking, sorted(files.items()))).encode()).hexdigest()[:40]
    return find_or_make(PurePath(COMPILED, prefix, f"{prefix}-{digest}.wasm"), make).read_bytes()
