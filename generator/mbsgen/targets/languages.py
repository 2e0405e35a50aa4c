"""Target languages beside C: one entry each in TARGETS, a printer in its own file, and its templates.

C is always written, since the runtime and the check program use it. A target adds more files, or C functions made from
the others.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from mbsgen.manifest import Manifest
from mbsgen.request import OptionError
from mbsgen.targets.acados import add_acados
from mbsgen.targets.bounds import add_bounded
from mbsgen.targets.contract import Family
from mbsgen.targets.cpp import list_headers, write_cpp
from mbsgen.targets.double_double import add_double_double
from mbsgen.targets.lanes import WIDTHS, list_lane_headers, write_lanes
from mbsgen.targets.unit import Unit


def _write_python(unit: Unit) -> Mapping[str, str]:  # here and below: a language is loaded where it is asked for
    from mbsgen.targets.python.module import write_python

    return write_python(unit)


def _write_matlab(unit: Unit) -> Mapping[str, str]:
    from mbsgen.targets.matlab import write_matlab

    return write_matlab(unit)


def _write_rust(unit: Unit) -> Mapping[str, str]:
    from mbsgen.targets.rust.crate import write_rust

    return write_rust(unit)


def _write_julia(unit: Unit) -> Mapping[str, str]:
    from mbsgen.targets.julia import write_julia

    return write_julia(unit)


def _encode_wasm(unit: Unit) -> Mapping[str, bytes]:
    from mbsgen.targets.wasm.module import write_wasm

    return write_wasm(unit)


def _pack_cuda(manifest: Manifest, files: Mapping[str, str]) -> Mapping[str, bytes]:
    from mbsgen.targets.cuda import pack_cuda

    return pack_cuda(manifest, files)


def _pack_source(manifest: Manifest, files: Mapping[str, str]) -> Mapping[str, bytes]:
    from mbsgen.targets.fmu import pack_source

    return pack_source(manifest, files)


def _write_nothing(_: Unit) -> Mapping[str, str]:
    return {}


def _pack_nothing(_manifest: Manifest, _files: Mapping[str, str]) -> Mapping[str, bytes]:
    return {}


def _encode_nothing(_: Unit) -> Mapping[str, bytes]:
    return {}


def _list_nothing(_: str) -> tuple[str, ...]:
    return ()


def _add_nothing(_: Sequence[Family]) -> tuple[Family, ...]:
    return ()


@dataclass(frozen=True)
class Target:
    """A language, or a program, that functions are written for."""

    name: str  # of the option --NAME
    help: str  # of that option
    write: Callable[[Unit], Mapping[str, str]] = _write_nothing  # files of the folder, path -> text
    encode: Callable[[Unit], Mapping[str, bytes]] = _encode_nothing  # binary files of the folder, path -> content
    pack: Callable[[Manifest, Mapping[str, str]], Mapping[str, bytes]] = _pack_nothing  # of the files, name -> content
    add: Callable[[Sequence[Family]], tuple[Family, ...]] = _add_nothing  # functions in C; may raise OptionError
    headers: Callable[[str], tuple[str, ...]] = _list_nothing  # installed beside the model's header, by its prefix
    widths: tuple[int, ...] = ()  # states at once: the library holds the kernels for each of these too


TARGETS: tuple[Target, ...] = (
    Target("python", "Also write the kernels as a Python module, for any number type.", _write_python),
    Target(
        "cpp",
        "Also write a C++ class: a header on top of the C, for Eigen too.",
        write_cpp,
        headers=list_headers,
    ),
    Target("matlab", "Also write the kernels as functions for Matlab and GNU Octave.", _write_matlab),
    Target("rust", "Also write the kernels as a Rust crate, without C and without other crates.", _write_rust),
    Target(
        "wasm",
        "Also write a WebAssembly module of the kernels, for browsers, without a compiler.",
        encode=_encode_wasm,
    ),
    Target("julia", "Also write a Julia module that calls the C.", _write_julia),
    Target(
        "lanes",
        "Also write functions in C for many states, by the vectors of the processor that runs them.",
        write_lanes,
        headers=list_lane_headers,
        widths=WIDTHS,
    ),
    Target("cuda", "Also write CUDA C that computes many states on a GPU, a state a thread.", pack=_pack_cuda),
    Target(
        "fmu", "Also pack the sources as a functional mock-up unit (FMI 3.0), without a library.", pack=_pack_source
    ),
    Target(
        "bounds", "Also write the functions with a bound of the rounding error beside each result.", add=add_bounded
    ),
    Target(
        "double-double",
        "Also write the functions in double-double arithmetic, with some 31 digits, in C.",
        add=add_double_double,
    ),
    Target("acados", "Also write the functions that acados requires, under its names.", add=add_acados),
    Target(
        "acados-untimed",
        "The same for acados before 0.3, which passes no time.",
        add=partial(add_acados, timed=False),
    ),
)


def find_targets(names: Iterable[str]) -> tuple[Target, ...]:
    """Find targets by their names, in the order of the registry. Raises OptionError for unknown names."""
    known, wanted = {target.name: target for target in TARGETS}, tuple(names)
    faults = []
    for name in wanted:
        if name not in known:
            near = difflib.get_close_matches(name, known, 1)
            remedy = f"is {near[0]} meant?" if near else f"there are {', '.join(known)}"
            faults.append(f"targets: there is no target {name!r}; {remedy}")
    if faults:
        raise OptionError("\n".join(faults))
    return tuple(target for target in TARGETS if target.name in wanted)


def add_functions(families: Sequence[Family], targets: Sequence[Target]) -> tuple[Family, ...]:
    """Write the C functions that targets add; where two add one of the same name, the last counts."""
    added = {family.value.name: family for target in targets for family in target.add(families)}
    return tuple(added.values())
