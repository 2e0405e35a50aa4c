"""The package of a functional mock-up unit: sources, descriptions and tables, in one zip file.

Equal models give equal bytes. A library for one system can be added by whoever has a compiler.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping, Sequence

from mbsgen import resources
from mbsgen.manifest import Manifest
from mbsgen.targets.fmu.layout import Call, Layout
from mbsgen.targets.fmu.versions import VERSIONS, Version
from mbsgen.targets.layout import lay_out

STEP = 1e-3  # the longest step of co-simulation by default [s]
_WHEN = (1980, 1, 1, 0, 0, 0)  # of every file: equal models give equal bytes
_GENERAL = ("mbs_fmi.c", "mbs_fmi.h")
_FOLDER = "sources/"


def pack_source(manifest: Manifest, files: Mapping[str, str]) -> Mapping[str, bytes]:
    """Return a unit of FMI 3.0 with sources alone, name -> content, from the files of a generated folder."""
    return {f"{manifest.prefix}.fmu": pack(collect(manifest, files, VERSIONS["3.0"], STEP))}


def collect(manifest: Manifest, files: Mapping[str, str], version: Version, step: float) -> dict[str, bytes]:
    """Return the files of a unit without a library, path -> content; `step`: the longest of co-simulation [s].

    `files` are a generated folder's, by name. Raises FmuError for a mechanism without joints,
    and where functions are missing.
    """
    layout = Layout(manifest)
    sources = _collect_sources(layout, files, version, step)
    compilable = [name for name in sources if name.endswith(".c")]
    found = {f"{_FOLDER}{name}": text for name, text in sources.items()}
    found.update(version.describe(layout, step, compilable))
    return {name: text.encode() for name, text in found.items()}


def list_compilable(files: Mapping[str, bytes]) -> Mapping[str, bytes]:
    """Return the C files and headers of a unit, by their names."""
    return {name.removeprefix(_FOLDER): text for name, text in files.items() if name.endswith((".c", ".h"))}


def pack(files: Mapping[str, bytes]) -> bytes:
    """Return the zip file of these files."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as package:
        for name, text in files.items():
            entry = zipfile.ZipInfo(name, _WHEN)
            entry.external_attr = 0o644 << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            package.writestr(entry, text)
    return content.getvalue()


def _list_calls(layout: Layout) -> Sequence[Call]:
    return (*layout.calls.values(), *layout.slopes[0])


def _collect_sources(layout: Layout, files: Mapping[str, str], version: Version, step: float) -> dict[str, str]:
    """Return the C files: of the functions that are called, of FMI, and the mechanism's tables."""
    general = resources.folder("csrc") / "fmi"
    needed = dict.fromkeys(source for call in _list_calls(layout) for source in call.kernel.sources)
    headers = sorted(name for name in files if name.endswith(".h") and name != "mbs_check.h")
    found = {name: files[name] for name in (*needed, *headers)}
    found |= {name: (general / name).read_text(encoding="utf-8") for name in (*_GENERAL, version.interface)}
    return found | {"mbs_fmi_model.c": _write_tables(layout, step)}


def _write_tables(layout: Layout, step: float) -> str:
    slopes, entries, size = layout.slopes
    manifest = layout.manifest
    return lay_out(
        "c/fmi.c",
        header=manifest.header,
        token=manifest.model_hash,
        coordinates=len(manifest.positions),
        velocities=len(manifest.coordinates),
        states=layout.states,
        inputs=layout.inputs,
        driven=len(layout.driven),
        parameters=len(manifest.parameters),
        outputs=len(layout.outputs) + len(layout.driven),
        size=size,
        results=layout.results,
        parameter=layout.given - len(manifest.parameters) - len(manifest.design),
        closed=layout.closed,
        clock=layout.clock,
        start=[repr(x) for x in layout.start],
        step=repr(step),
        calls={**layout.calls, **{f"slope{k}": call for k, call in enumerate(slopes, 1)}},
        parts=("setup", "rates", "accelerations", "places", "close", "close_rates", "project"),
        slopes=[f"slope{k}" for k, _ in enumerate(slopes, 1)],
        independent=manifest.independent,
        entries=entries,
    )
