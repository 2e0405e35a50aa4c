"""Generated C files -> objects -> shared libraries of the requested functions, each made once, addressed by content.

An object's name is a hash of its source, the headers that it includes, the compiler with its flags, and the processor
as seen by the compiler; a library's name is a hash of its objects. So a stale one is never found. The cache checks
entries by a hash: the loaded library is the compiled one.
"""

from __future__ import annotations

import hashlib
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, partial, wraps
from importlib.util import find_spec
from pathlib import Path, PurePath
from types import MappingProxyType
from typing import TypeVar, TypeVarTuple

from mbsgen.errors import MbsError
from mbsrun.cache import COMPILED, find_or_make
from mbsrun.stack import GRAPHS

# ISO C, except contraction to fused multiply-add, which gcc's -std=c99 would turn off. Never fast-math: it drops NaN
# checks, reassociates, and makes the loading process flush denormals. gcc's vectors in straight-line code, of numbers
# gathered from everywhere, would make it slower.
SCALAR = "-fno-tree-slp-vectorize"
FLAGS = ("-std=c99", "-march=native", "-ffp-contract=fast", "-fPIC", SCALAR, "-fno-math-errno")
COMPILERS = ("cc", "gcc", "clang")  # looked for in this order where CC names none
ZIG = ("-m", "ziglang", "cc")  # of Python: the compiler in the package ziglang
ZIG_FLAGS = ("-fno-sanitize=undefined",)  # which it would turn on below -O2
REMEDY = "run in the folder of the project: pip install '.[compiler]'"
INSTALL = f"install cc, gcc or clang, or {REMEDY}"
LARGE = 2_000_000  # bytes of a source; larger ones are compiled with less optimisation
ACCEPTED = re.compile(
    r"-O[0-3gs]?|-g[0-3]?|-pipe|-std=(c|gnu)(99|11|17|18|2x|23)|-ffp-contract=(off|on|fast)|-f(no-)?math-errno"
    r"|-m(arch|tune|cpu)=[\w.+-]+|-m(no-)?(sse[\w.]*|avx[\w.]*|fma|bmi2?)|-mprefer-vector-width=\w+|-fPIC"
    r"|-f(no-)?(unroll-loops|omit-frame-pointer|semantic-interposition|tree-vectorize|tree-slp-vectorize|plt)"
    r"|-fstack-protector(-strong|-all)?|-fstack-clash-protection|-fcf-protection(=\w+)?|-fdiagnostics-color(=\w+)?"
    r"|-fno-sanitize=undefined|-W(no-)?[a-z][\w=+-]*|-D_FORTIFY_SOURCE=[0-3]|-U_FORTIFY_SOURCE|-D_GLIBCXX_ASSERTIONS"
)
SHARED = "mbs"  # the part of the cache for C that serves every model: the names of its files begin with this
_FILE = re.compile(r"[A-Za-z0-9_]+\.(c|h|cu)", re.ASCII)
_INCLUDE = re.compile(rb'^[ \t]*#[ \t]*include[ \t]*"([^"\n]*)"', re.MULTILINE)
_FAST_MATH = re.compile(r"#define (__FAST_MATH__|__FINITE_MATH_ONLY__) 1\b")


class CompileError(MbsError):
    """A library that could not be compiled."""


_Given = TypeVarTuple("_Given")
_Made = TypeVar("_Made")


@dataclass(frozen=True)
class Compiler:
    """A C compiler, ready to be run."""

    command: tuple[str, ...]
    flags: tuple[str, ...]
    macros: str  # all macros that it predefines under these flags: its version, and the features of the processor


@dataclass(frozen=True)
class _Object:
    """An object file to be made: its name in the cache, and its parts."""

    name: PurePath
    files: Mapping[str, bytes]  # the source, then headers
    command: tuple[str, ...]


def compile_library(
    folder: Path,
    prefix: str,
    names: Iterable[str],
    compiler: Compiler,
    *beside: Path,
    rows: Collection[str] = (),
    given: Mapping[str, str] = MappingProxyType({}),
) -> Path:
    """Compile C files of a folder, as many at once as there are processors, and link them to one shared library.

    C files and headers that are not in the folder are looked for in the folders `beside` it; `given` are the texts of
    files that take the place of all of these. Files among `rows` work on rows of numbers, and are compiled without the
    flag that is good for straight-line code alone. Compiled files are found in the cache; `prefix` is the model's part
    of it, and files of SHARED are found for every model. Raises CompileError with the command and the compiler's
    message, or for a name that cannot be a generated file's; CacheError.
    """
    place, texts = _find_place(folder, prefix), {name: text.encode() for name, text in given.items()}
    vectors = replace(compiler, flags=tuple(flag for flag in compiler.flags if flag != SCALAR))
    objects = [
        _plan(read_source((folder, *beside), name, texts), place, vectors if name in rows else compiler)
        for name in dict.fromkeys(names)
    ]
    return _link(objects, place / prefix, compiler)


def write_graphs(
    folder: Path,
    prefix: str,
    names: Iterable[str],
    compiler: Compiler,
    given: Mapping[str, str] = MappingProxyType({}),
) -> list[str]:
    """Return the call graphs of C files of a folder, as GCC writes them; `stack` reads them.

    Graphs are found in the cache, as `compile_library` finds objects. Raises CompileError, also where the compiler
    writes no graphs; CacheError.
    """
    place, drawing = _find_place(folder, prefix), replace(compiler, flags=(*compiler.flags, GRAPHS))
    texts = {name: text.encode() for name, text in given.items()}
    items = [_plan(read_source((folder,), name, texts), place, drawing) for name in dict.fromkeys(names)]
    with ThreadPoolExecutor(count_cores()) as pool:
        return [path.read_text("utf-8") for path in pool.map(partial(_compile, suffix=".ci"), items)]


def find_compiler(environment: Mapping[str, str]) -> Compiler:
    """Return the compiler of CC and CFLAGS. Raises CompileError if there is none, or if it would not keep IEEE
    arithmetic.

    CC names a compiler; without it, the first of COMPILERS on the PATH is taken, else Zig's of the package ziglang.
    CFLAGS adds to the flags, except fast-math.
    """
    command = _split(environment, "CC") or list(_choose_command(environment))
    is_zig = tuple(command[1:4]) == ZIG
    flags = (*FLAGS, *(ZIG_FLAGS if is_zig else ()), *_split(environment, "CFLAGS"))
    given = (*command[4 if is_zig else 1 :], *flags)
    refused = [word for word in given if word.startswith("-") and not ACCEPTED.fullmatch(word)]
    if refused:
        raise CompileError(
            f"CC and CFLAGS: {' '.join(refused)} is not accepted; optimisation (-O3), the processor (-march=), "
            "-ffp-contract=, -g and warnings are; fast-math is not, since kernels must keep IEEE arithmetic"
        )
    macros = _list_macros((*command, *flags), _date(command[0]))
    if _FAST_MATH.search(macros):
        raise CompileError(f"{' '.join(command)} compiles with fast-math; kernels must keep IEEE arithmetic")
    return Compiler(tuple(command), flags, macros)


def _date(program: str) -> tuple[str | None, int]:
    """Return where a program is, and when it was changed."""
    found = shutil.which(program)
    return found, Path(found).stat().st_mtime_ns if found else 0


@cache
def _list_macros(command: tuple[str, ...], _date: tuple[str | None, int]) -> str:
    """Return the macros that a compiler predefines; one of another date is asked again."""
    return run_compiler([*command, "-dM", "-E", "-x", "c", "-"])


def once_per_compiler(make: Callable[[*_Given], _Made]) -> Callable[[*_Given], _Made]:
    """Return a function that compiles once for its arguments and the values of CC and CFLAGS at the call."""

    @cache
    def kept(_: tuple[str | None, ...], *given: *_Given) -> _Made:
        return make(*given)

    @wraps(make)
    def find(*given: *_Given) -> _Made:
        return kept(tuple(map(os.environ.get, ("CC", "CFLAGS"))), *given)

    return find


def find_zig() -> tuple[str, ...]:
    """Return the command of the C compiler in the package ziglang. Raises CompileError where it is not installed."""
    if find_spec(ZIG[1]) is None:
        raise CompileError(f"the package ziglang is not installed; {REMEDY}")
    return (sys.executable, *ZIG)


def count_cores() -> int:
    """Return the number of processors that this process may use, or has where the system does not say."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def _choose_command(environment: Mapping[str, str]) -> tuple[str, ...]:
    """Return a compiler of the PATH, else of the package ziglang. Raises CompileError where there is neither."""
    for name in COMPILERS:
        if shutil.which(name, path=environment.get("PATH")):
            return (name,)
    if find_spec(ZIG[1]) is None:
        raise CompileError(f"there is no C compiler on the PATH; {INSTALL}")
    return find_zig()


def choose_level(source: bytes) -> str:
    """Choose the level of optimisation, which CFLAGS may replace.

    gcc 12 compiles functions in parts a third faster with -O1 than with -O3, but they run slower: a quadruped's
    Jacobian (500 kB) by a quarter, a humanoid's (700 kB) by a half. Larger ones are still compiled within minutes.
    """
    return "-O1" if len(source) >= LARGE else "-O3"


def _split(environment: Mapping[str, str], name: str) -> list[str]:
    try:
        return shlex.split(environment.get(name, ""))
    except ValueError as error:
        raise CompileError(f"{name}: {error}; mend its quotes") from None


def read_source(folders: Sequence[Path], name: str, given: Mapping[str, bytes]) -> dict[str, bytes]:
    """Read a C file, which comes first, and the headers that it includes; names are not trusted."""
    files: dict[str, bytes] = {}
    wanted = [name]
    while wanted:
        file = wanted.pop()
        if not _FILE.fullmatch(file):
            raise CompileError(f"{folders[0]}: {file!r} cannot be a generated file; generate the folder again")
        if file not in files:
            folder = next((folder for folder in folders if (folder / file).exists()), folders[0])
            try:
                files[file] = given[file] if file in given else (folder / file).read_bytes()
            except OSError as error:
                raise CompileError(f"{folder / file}: {error.strerror}; generate the folder again") from None
            wanted += [found.decode(errors="replace") for found in _INCLUDE.findall(files[file])]
    return files


def _plan(files: Mapping[str, bytes], place: PurePath, compiler: Compiler) -> _Object:
    """Name an object by a hash of everything that decides its bytes; the source comes first."""
    source = next(iter(files))
    command = (*compiler.command, choose_level(files[source]), *compiler.flags)
    told = [word.encode() for word in (*command, compiler.macros)]
    name = _name([*told, *(part for item in files.items() for part in (item[0].encode(), item[1]))])
    if source.startswith(f"{SHARED}_"):
        place = place.with_name(SHARED)
    return _Object(place / f"{Path(source).stem}-{name}.o", files, command)


def _find_place(folder: Path, prefix: str) -> PurePath:
    """Return the model's part of the cache. Raises CompileError for a prefix that no model has."""
    if not re.fullmatch(r"\w+", prefix, re.ASCII):
        raise CompileError(f"{folder}: {prefix!r} cannot be the prefix of generated names")
    return PurePath(COMPILED, prefix)


def _compile(item: _Object, suffix: str = ".o") -> Path:
    """Compile a source from a copy, so that the hashed text is the compiled one; return a file that this makes."""
    source = next(iter(item.files))

    def make(building: Path) -> Path:
        for name, text in item.files.items():
            (building / name).write_bytes(text)
        made = building / f"{source}.o"
        run_compiler([*item.command, "-c", str(building / source), "-o", str(made)])
        if not made.with_suffix(suffix).exists():
            raise CompileError(f"{shlex.join(item.command)} writes no file {suffix}")
        return made.with_suffix(suffix)

    return find_or_make(item.name.with_suffix(suffix), make)


def _link(objects: Sequence[_Object], stem: PurePath, compiler: Compiler) -> Path:
    """Link objects; compile them unless the library exists."""

    def make(building: Path) -> Path:
        with ThreadPoolExecutor(count_cores()) as pool:
            compiled = [str(path) for path in pool.map(_compile, objects)]
        made = building / "library.so"
        run_compiler([*compiler.command, *compiler.flags, "-shared", *compiled, "-o", str(made), "-lm"])
        return made

    name = _name([item.name.name.encode() for item in objects])
    return find_or_make(stem.with_name(f"{stem.name}-{name}.so"), make)


def _name(parts: Iterable[bytes]) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "big") + part)  # with its length: no two lists of parts give the same bytes
    return digest.hexdigest()[:40]


def run_compiler(command: Sequence[str], place: Path | None = None) -> str:
    """Run a compiler in a folder, and return its output. Raises CompileError with its message."""
    try:
        done = subprocess.run(
            command,
            cwd=place,
            input="",
            capture_output=True,
            text=True,
            errors="replace",
            env={**os.environ, "LC_ALL": "C"},
        )
    except OSError as error:
        raise CompileError(
            f"cannot run {command[0]}: {error.strerror}; name another compiler in CC, or unset CC and {INSTALL}"
        ) from None
    if done.returncode:
        raise CompileError(f"{shlex.join(command)}\nfailed with status {done.returncode}:\n{done.stderr.strip()}")
    return done.stdout
