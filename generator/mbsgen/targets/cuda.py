"""CUDA C beside a model's C: for each kernel, a file that includes its C and computes many states, a state a thread.

The files follow from the manifest alone, so that a folder without them has them, too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import PurePath

from mbsgen import resources
from mbsgen.manifest import Argument, Kernel, Manifest
from mbsgen.targets.c.symbols import write_own
from mbsgen.targets.layout import lay_out

HEADER = "mbs_cuda.h"  # in csrc
_WIDTH = 116  # of lines


@dataclass(frozen=True)
class _View:
    """An argument, ready to be laid out."""

    name: str
    declaration: str
    rows: int
    cols: int
    nnz: int
    lines: tuple[str, ...]  # that load its numbers, or store them


def pack_cuda(manifest: Manifest, _: Mapping[str, str]) -> Mapping[str, bytes]:
    """Return the CUDA C of all kernels, and the header that they share, name -> content."""
    files = {name_file(kernel): write_kernel(manifest, kernel) for kernel in manifest.kernels}
    return {name: text.encode() for name, text in (files | {HEADER: read_header()}).items()}


def read_header() -> str:
    """Return the header of all CUDA C."""
    return (resources.folder("csrc") / HEADER).read_text(encoding="utf-8")


def name_file(kernel: Kernel) -> str:
    """Name the file of a kernel."""
    return PurePath(kernel.sources[0]).with_suffix(".cu").name


def name_function(kernel: Kernel) -> str:
    """Name the function that computes many states."""
    return f"{kernel.function}_many"


def write_kernel(manifest: Manifest, kernel: Kernel) -> str:
    """Write a kernel for many states: its arguments that have entries, in the manifest's order, are arrays."""
    inputs = [_view(a, "const ", "LOAD") for a in kernel.inputs if a.nnz]
    outputs = [_view(a, "", "STORE") for a in kernel.outputs if a.rows * a.cols]
    return lay_out(
        "cuda/kernel.cu",
        kernel=kernel,
        name=name_function(kernel),
        own_function=_name_own(manifest, kernel),
        inputs=inputs,
        outputs=outputs,
        passed=[a for a in (*inputs, *outputs) if a.nnz],
        version=manifest.generator.removeprefix("mbsgen "),
        model_hash=manifest.model_hash,
    )


def _name_own(manifest: Manifest, kernel: Kernel) -> str:
    own = manifest.symbols or manifest.prefix
    return write_own(kernel.function.replace(manifest.prefix, own, 1), own)


def _view(argument: Argument, qualifier: str, verb: str) -> _View:
    calls = [f"MBS_{verb}({argument.name}, {r}, {c}, {k});" for k, (r, c) in enumerate(list_entries(argument))]
    if verb == "STORE":
        zeros = set(_list_all(argument)) - set(list_entries(argument))
        calls += [f"MBS_STORE_ZERO({argument.name}, {r}, {c});" for r, c in sorted(zeros)]
    declaration = f"{qualifier}mbs_real *MBS_RESTRICT {argument.name}"
    return _View(argument.name, declaration, argument.rows, argument.cols, argument.nnz, tuple(_fill(calls)))


def list_entries(argument: Argument) -> list[tuple[int, int]]:
    """List the rows and columns of the nonzeros, column by column."""
    if argument.row is None or argument.colind is None:
        return list(_list_all(argument))
    ends = zip(argument.colind, argument.colind[1:], strict=False)
    return [(r, c) for c, (first, end) in enumerate(ends) for r in argument.row[first:end]]


def _list_all(argument: Argument) -> Iterator[tuple[int, int]]:
    return ((r, c) for c in range(argument.cols) for r in range(argument.rows))


def _fill(calls: list[str]) -> Iterator[str]:
    """Join calls to lines of at most _WIDTH characters."""
    line = ""
    for call in calls:
        if line and len(line) + 1 + len(call) > _WIDTH:
            yield line
            line = ""
        line += f" {call}" if line else call
    if line:
        yield line
