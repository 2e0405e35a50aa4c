"""Generated folder -> shared library, compiled once: a cache addressed by content.

A library's name is made from the bytes of its sources, the compiler with its flags, and the processor that the
compiler sees, so a stale one is never met. Whoever finishes compiling renames the result into place; several processes
may do so at once.
"""

from __future__ import annotations

import hashlib
import os
import re
import shlex
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from mbsgen import manifest as manifests
from mbsgen import resources
from mbsgen.errors import MbsError
from mbsgen.manifest import Manifest

# ISO C, but contraction to fused multiply-add, which gcc's -std=c99 would turn off. Never fast-math: it drops NaN
# checks, reassociates, and makes the loading process flush denormals.
FLAGS = ("-std=c99", "-O3", "-march=native", "-ffp-contract=fast", "-fPIC", "-fno-math-errno")
ACCEPTED = re.compile(
    r"-O[0-3gs]?|-g[0-3]?|-pipe|-std=(c|gnu)(99|11|17|18|2x|23)|-ffp-contract=(off|on|fast)|-f(no-)?math-errno"
    r"|-m(arch|tune|cpu)=[\w.+-]+|-m(no-)?(sse[\w.]*|avx[\w.]*|fma|bmi2?)|-mprefer-vector-width=\w+|-fPIC"
    r"|-f(no-)?(unroll-loops|omit-frame-pointer|semantic-interposition|tree-vectorize|tree-slp-vectorize|plt)"
    r"|-fstack-protector(-strong|-all)?|-fstack-clash-protection|-fcf-protection(=\w+)?|-fdiagnostics-color(=\w+)?"
    r"|-W(no-)?[a-z][\w=+-]*|-D_FORTIFY_SOURCE=[0-3]|-U_FORTIFY_SOURCE|-D_GLIBCXX_ASSERTIONS"
)
_FILE = re.compile(r"[A-Za-z0-9_]+\.[ch]")
_FAST_MATH = re.compile(r"#define (__FAST_MATH__|__FINITE_MATH_ONLY__) 1\b")
_BATCH = ("mbs_batch.h", "mbs_batch.c")


class CompileError(MbsError):
    """A library that could not be compiled."""


@dataclass(frozen=True)
class Compiler:
    """A C compiler, ready to be run."""

    command: tuple[str, ...]
    flags: tuple[str, ...]
    macros: str  # all it predefines under these flags: its version, and what it knows of the processor


def compile_folder(folder: Path) -> Path:
    """Compile a generated folder and return its shared library; one compiled before is found in the cache.

    CC names another compiler than `cc`; CFLAGS adds to the flags, fast-math excepted. Raises CompileError with the
    command and what the compiler said, InputError for a folder without a manifest.
    """
    manifest = manifests.read(folder / manifests.FILE_NAME)
    files = _read_files(folder, manifest)
    compiler = find_compiler(os.environ)
    sources = [name for name in files if name.endswith(".c")]
    library = cache_folder(os.environ) / f"{manifest.prefix}-{_fingerprint(files, compiler)}.so"
    if not library.exists():
        with building_place(library.parent) as place:
            _build(compiler, files, sources, place).replace(library)
    return library


def cache_folder(environment: Mapping[str, str]) -> Path:
    """Tell where compiled libraries are kept: $XDG_CACHE_HOME/mbsgen, else ~/.cache/mbsgen."""
    base = Path(environment.get("XDG_CACHE_HOME", ""))
    return (base if base.is_absolute() else Path.home() / ".cache") / "mbsgen"


@contextmanager
def building_place(cache: Path) -> Iterator[Path]:
    """Give a folder to build in, from where a rename leads into the cache. CompileError if that cannot be written."""
    try:
        cache.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="building-", dir=cache) as place:
            yield Path(place)
    except OSError as error:
        raise CompileError(f"cannot write to the cache {cache}: {error}; set XDG_CACHE_HOME") from None


def find_compiler(environment: Mapping[str, str]) -> Compiler:
    """Take the compiler from CC and CFLAGS; CompileError if there is none, or if it would not keep IEEE arithmetic."""
    command = _split(environment, "CC") or ["cc"]
    flags = (*FLAGS, *_split(environment, "CFLAGS"))
    refused = [word for word in (*command[1:], *flags) if word.startswith("-") and not ACCEPTED.fullmatch(word)]
    if refused:
        raise CompileError(
            f"CC and CFLAGS: {' '.join(refused)} is not accepted; optimisation (-O3), the processor (-march=), "
            "-ffp-contract=, -g and warnings are; fast-math is not, since kernels must keep IEEE arithmetic"
        )
    macros = _run([*command, *flags, "-dM", "-E", "-x", "c", "-"])
    if _FAST_MATH.search(macros):
        raise CompileError(f"{' '.join(command)} compiles with fast-math; kernels must keep IEEE arithmetic")
    return Compiler(tuple(command), flags, macros)


def _split(environment: Mapping[str, str], name: str) -> list[str]:
    try:
        return shlex.split(environment.get(name, ""))
    except ValueError as error:
        raise CompileError(f"{name}: {error}; mend its quotes") from None


def _read_files(folder: Path, manifest: Manifest) -> dict[str, bytes]:
    """Read what is to be compiled, and the headers beside it; names out of a manifest are not trusted as paths."""
    names = (*manifest.sources, manifest.header, "mbs_abi.h")
    strange = [name for name in names if not _FILE.fullmatch(name)]
    if strange or not re.fullmatch(r"\w+", manifest.prefix, re.ASCII):
        raise CompileError(f"{folder / manifests.FILE_NAME}: {strange or manifest.prefix} cannot be a generated file")
    try:
        files = {name: (folder / name).read_bytes() for name in names}
        return files | {name: (resources.folder("csrc") / name).read_bytes() for name in _BATCH}
    except OSError as error:
        raise CompileError(f"{error.filename}: {error.strerror}; generate the folder again") from None


def _fingerprint(files: Mapping[str, bytes], compiler: Compiler) -> str:
    parts = [word.encode() for word in (*compiler.command, *compiler.flags, compiler.macros)]
    parts += [part for name, text in sorted(files.items()) for part in (name.encode(), text)]
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "big") + part)  # with its length: no two lists of parts look alike
    return digest.hexdigest()[:40]


def _build(compiler: Compiler, files: Mapping[str, bytes], sources: Sequence[str], place: Path) -> Path:
    """Compile in `place`, from a copy: what was hashed is what is compiled."""
    for name, text in files.items():
        (place / name).write_bytes(text)

    def compile_source(source: str) -> str:
        target = str(place / f"{source}.o")
        _run([*compiler.command, *compiler.flags, "-c", str(place / source), "-o", target])
        return target

    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        objects = list(pool.map(compile_source, sources))
    library = place / "library.so"
    _run([*compiler.command, *compiler.flags, "-shared", *objects, "-o", str(library), "-lm"])
    return library


def _run(command: Sequence[str]) -> str:
    try:
        done = subprocess.run(
            command, input="", capture_output=True, text=True, errors="replace", env={**os.environ, "LC_ALL": "C"}
        )
    except OSError as error:
        raise CompileError(
            f"cannot run {command[0]}: {error.strerror}; install a C compiler, or name one in CC"
        ) from None
    if done.returncode:
        raise CompileError(f"{shlex.join(command)}\nfailed with status {done.returncode}:\n{done.stderr.strip()}")
    return done.stdout
