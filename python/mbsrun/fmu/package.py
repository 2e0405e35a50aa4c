"""The package: sources, descriptions and, unless it is left out, the library of this machine, in one zip file."""

from __future__ import annotations

import os
import platform
import tempfile
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from mbsgen import resources
from mbsrun.fmu.description import describe_build, describe_model, describe_terminals
from mbsrun.fmu.layout import FmuError, Layout
from mbsrun.kernel import Kernels
from mbsrun.library import compile_library, find_compiler

WHEN = (1980, 1, 1, 0, 0, 0)  # of every file: equal models give equal bytes
STEP = 1e-3  # the longest step of co-simulation by default [s]
_GENERAL = ("mbs_fmi.c", "mbs_fmi.h")
_PLATFORMS = {
    ("Linux", "x86_64"): ("x86_64-linux", ".so"),
    ("Linux", "aarch64"): ("aarch64-linux", ".so"),
    ("Darwin", "x86_64"): ("x86_64-darwin", ".dylib"),
    ("Darwin", "arm64"): ("aarch64-darwin", ".dylib"),
    ("Windows", "AMD64"): ("x86_64-windows", ".dll"),
}


def write_fmu(kernels: Kernels, out: Path, *, step: float = STEP, compiled: bool = True) -> Path:
    """Write a functional mock-up unit of FMI 3.0 for model exchange and co-simulation.

    It holds the sources and, where `compiled`, a library for this machine's system, for any processor of its kind.
    Raises FmuError for closed loops, CompileError.
    """
    layout = Layout(kernels)
    sources = _collect_sources(layout, kernels, step)
    files = {f"sources/{name}": text for name, text in sources.items()}
    compilable = [name for name in sources if name.endswith(".c")]
    files["sources/buildDescription.xml"] = describe_build(layout.manifest, compilable).encode()
    files["modelDescription.xml"] = describe_model(layout, step).encode()
    files["terminalsAndIcons/terminalsAndIcons.xml"] = describe_terminals(layout, step).encode()
    if compiled:
        files |= _compile(layout.manifest.prefix, sources, compilable)
    _pack(files, out)
    return out


def _collect_sources(layout: Layout, kernels: Kernels, step: float) -> dict[str, bytes]:
    """Return the C files: of the functions that are called, of FMI, and the mechanism's tables."""
    calls = [*(call for call in layout.calls.values() if call), *layout.slopes[0]]
    needed = dict.fromkeys(source for call in calls for source in call.kernel.sources)
    general = resources.folder("csrc") / "fmi"
    found = {name: (kernels.folder / name).read_bytes() for name in needed}
    found |= {name: (kernels.folder / name).read_bytes() for name in sorted(_list_headers(kernels.folder))}
    found |= {name: (general / name).read_bytes() for name in _GENERAL}
    found["mbs_fmi_model.c"] = _write_tables(layout, step).encode()
    return found


def _list_headers(folder: Path) -> Iterator[str]:
    return (file.name for file in folder.glob("*.h") if file.name != "mbs_check.h")


def _write_tables(layout: Layout, step: float) -> str:
    from mbsgen.targets.layout import lay_out

    slopes, entries, size = layout.slopes
    manifest = layout.manifest
    calls = {name: call for name, call in layout.calls.items() if call}
    return lay_out(
        "c/fmi.c",
        token=manifest.model_hash,
        coordinates=len(manifest.positions),
        velocities=len(manifest.coordinates),
        inputs=layout.inputs,
        parameters=len(manifest.parameters),
        outputs=len(layout.outputs),
        size=size,
        results=layout.results,
        parameter=layout.given - len(manifest.parameters) - len(manifest.design),
        start=[repr(x) for x in layout.start],
        step=repr(step),
        calls=calls,
        slopes=slopes,
        symbols=sorted({call.kernel.symbol for call in (*calls.values(), *slopes)}),
        entries=entries,
        is_known=lambda name: name in calls,
    )


def _compile(prefix: str, sources: dict[str, bytes], compilable: Sequence[str]) -> dict[str, bytes]:
    """Return the library, by its place in the package."""
    system = (platform.system(), platform.machine())
    if system not in _PLATFORMS:
        raise FmuError(f"FMI has no name for the system {' '.join(system)}; write the sources alone with --source-only")
    folder, suffix = _PLATFORMS[system]
    found = find_compiler(os.environ)
    portable = tuple(flag for flag in found.flags if flag != "-march=native")
    with tempfile.TemporaryDirectory(prefix="mbsrun-fmu-") as building:
        for name, text in sources.items():
            (Path(building) / name).write_bytes(text)
        library = compile_library(Path(building), prefix, compilable, replace(found, flags=portable))
        return {f"binaries/{folder}/{prefix}{suffix}": library.read_bytes()}


def _pack(files: dict[str, bytes], out: Path) -> None:
    out.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as package:
        for name, content in files.items():
            entry = zipfile.ZipInfo(name, WHEN)
            entry.external_attr = 0o644 << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            package.writestr(entry, content)
