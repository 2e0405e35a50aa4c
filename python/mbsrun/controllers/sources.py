"""The files that a controller is compiled from beside its own: kernels of its model, and the solver of `csrc`.

The solver's files get names that begin with `mbs_`, as nothing of a model does, so that all files can share one folder.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from mbsgen import resources
from mbsgen.errors import MbsError
from mbsgen.manifest import Kernel, Manifest

ABI = "mbs_abi.h"
PRIVATE = "mbs_private.h"  # as in `mbsgen.targets.c.symbols`
PLAIN = {PRIVATE: ""}  # with this one in its place, the solver is compiled once for all controllers
THREADS = "mbs_threads.c"
INTERFACE = "mbs_stages.h"
_INCLUDE = re.compile(r'^([ \t]*#[ \t]*include[ \t]*")([^"\n]*)(")', re.MULTILINE)
_FILE = re.compile(r"[A-Za-z0-9_]+\.[ch]", re.ASCII)
_BEFORE = """\
#define MBS_WITHOUT_PLAIN_NAMES
#if defined(MBS_STAGES_FLOAT) && !defined(MBS_REAL)
#define MBS_REAL float
#endif
"""


def read_solver() -> dict[str, str]:
    """Read the solver, the evaluator of tables and the team of threads, and rename them.

    Each C file includes first a header that gives functions the symbols of one folder.
    """
    folder = resources.folder("csrc")
    found = [file for part in ("stages", "program", "threads") for file in sorted((folder / part).glob("*.[ch]"))]
    names = {file.name: _rename(file.name) for file in found}

    def include(match: re.Match[str]) -> str:
        return f"{match[1]}{names.get(match[2], match[2])}{match[3]}"

    files = {names[file.name]: _INCLUDE.sub(include, file.read_text(encoding="utf-8")) for file in found}
    files |= {THREADS: _guard(files[THREADS]), INTERFACE: _identify(files[INTERFACE])}
    return {name: f'#include "{PRIVATE}"\n{text}' if name.endswith(".c") else text for name, text in files.items()}


def list_shared() -> tuple[str, ...]:
    """List the functions of the solver, the evaluator of tables and the team of threads."""
    from mbsgen.targets.c.symbols import find_declared

    headers = (text for name, text in read_solver().items() if name.endswith(".h"))
    return find_declared("mbs", headers)


def identify_solver() -> str:
    """Return the tag of the solver's interface: headers of two folders agree where it is the same."""
    from mbsgen.targets.c.symbols import hash_text

    return hash_text((resources.folder("csrc") / "stages" / INTERFACE).read_text(encoding="utf-8"))


def _identify(interface: str) -> str:
    """Write the tag of the solver's interface into it."""
    begin = "#define MBS_STAGES_H\n"
    assert interface.count(begin) == 1, "the guard of the header"
    return interface.replace(begin, f"{begin}#define MBS_STAGES_CONTENT 0x{identify_solver()}\n")


def _guard(threads: str) -> str:
    """Leave the C of threads out where a controller has none: its system may have none, either."""
    begin = "#include <pthread.h>\n"
    assert threads.count(begin) == 1, "the first header of the system"
    return threads.replace(begin, f"#ifdef MBS_STAGES_WORKERS\n{begin}") + "#endif\n"


def _rename(name: str) -> str:
    return name if name.startswith("mbs_") else f"mbs_stages_{name}"


def read_kernels(folder: Path, manifest: Manifest, kernels: Iterable[Kernel], own: str) -> dict[str, str]:
    """Read the C files of kernels, with the headers that they include; their symbols begin with `own`.

    Raises MbsError where one cannot be read.
    """
    files: dict[str, str] = {}
    wanted = [ABI, "mbs_sincos.h", manifest.header, *(name for kernel in kernels for name in kernel.sources)]
    while wanted:
        name = wanted.pop()
        if name in files:
            continue
        if not _FILE.fullmatch(name):
            raise MbsError(f"{folder}: {name!r} cannot be a generated file; generate the folder again")
        files[name] = _read(folder, name)
        wanted += [match[2] for match in _INCLUDE.finditer(files[name])]
    files = {name: text.replace(manifest.symbols, own) for name, text in files.items()}
    return files | {ABI: _BEFORE + files[ABI]}


def name_kernel(kernel: Kernel, manifest: Manifest, own: str) -> str:
    """Name a kernel whose symbols begin with `own`."""
    order = kernel.order.prefix if kernel.symbol.startswith(f"{kernel.order.prefix}{manifest.prefix}_") else ""
    return order + own + kernel.symbol.removeprefix(order + manifest.prefix)


def _read(folder: Path, name: str) -> str:
    common = resources.folder("csrc") / name
    path = folder / name
    try:
        return (path if path.exists() or not common.exists() else common).read_text(encoding="utf-8")
    except OSError as error:
        raise MbsError(f"{path}: {error.strerror}; generate the folder again") from None


def merge(*parts: Mapping[str, str]) -> dict[str, str]:
    """Put files together; no two of one name."""
    files: dict[str, str] = {}
    for part in parts:
        for name, text in part.items():
            assert files.setdefault(name, text) == text, f"two files are called {name}"
    return files
