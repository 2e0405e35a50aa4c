"""Functional mock-up units (FMI) of generated folders, with a library for this machine's system.

`mbsgen.targets.fmu` writes the sources and the descriptions; this module compiles.
"""

from __future__ import annotations

import os
import platform
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from mbsgen.errors import MbsError
from mbsrun.kernel import Kernels
from mbsrun.library import compile_library, find_compiler

_SUFFIXES = {"Linux": ".so", "Darwin": ".dylib", "Windows": ".dll"}


class PlatformError(MbsError):
    """A system that FMI has no name for."""


def write_fmu(
    kernels: Kernels, out: Path, *, fmi: str = "3.0", step: float | None = None, compiled: bool = True
) -> Path:
    """Write a functional mock-up unit for model exchange and co-simulation, of FMI 2.0 or 3.0.

    It holds the sources and, where `compiled`, a library for this machine's system, for any processor of its kind.
    `step` is the longest step of co-simulation [s]. Raises FmuError, CompileError, PlatformError.
    """
    from mbsgen.targets.fmu import STEP, VERSIONS, collect, pack

    folder, version = kernels.folder, VERSIONS[fmi]
    texts = {file.name: file.read_text(encoding="utf-8") for file in folder.iterdir() if file.suffix in (".c", ".h")}
    files = collect(kernels.manifest, texts, version, STEP if step is None else step)
    if compiled:
        files |= _compile(kernels.manifest.prefix, files, _find_place(fmi, version.platforms))
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_bytes(pack(files))
    return out


def _find_place(fmi: str, platforms: Mapping[tuple[str, str], str]) -> tuple[str, str]:
    """Return the folder of this machine's libraries in a unit, and the suffix of their names."""
    system = (platform.system(), platform.machine())
    if system not in platforms:
        raise PlatformError(
            f"FMI {fmi} has no name for the system {' '.join(system)}; write the sources alone with --source-only"
        )
    return platforms[system], _SUFFIXES[system[0]]


def _compile(prefix: str, files: Mapping[str, bytes], place: tuple[str, str]) -> dict[str, bytes]:
    """Return the library, by its place in the package."""
    from mbsgen.targets.fmu import list_compilable

    folder, suffix = place
    sources = list_compilable(files)
    found = find_compiler(os.environ)
    portable = tuple(flag for flag in found.flags if flag != "-march=native")
    with tempfile.TemporaryDirectory(prefix="mbsrun-fmu-") as building:
        for name, text in sources.items():
            (Path(building) / name).write_bytes(text)
        compilable = [name for name in sources if name.endswith(".c")]
        library = compile_library(Path(building), prefix, compilable, replace(found, flags=portable))
        return {f"binaries/{folder}/{prefix}{suffix}": library.read_bytes()}
