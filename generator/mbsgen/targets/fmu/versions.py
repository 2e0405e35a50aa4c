"""The versions of FMI: one entry each in VERSIONS."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from mbsgen.targets.fmu import fmi2, fmi3
from mbsgen.targets.fmu.layout import Layout


@dataclass(frozen=True)
class Version:
    """A version of the standard."""

    name: str
    interface: str  # the C file in csrc/fmi
    describe: Callable[[Layout, float, Sequence[str]], Mapping[str, str]]  # the XML files, path -> text
    platforms: Mapping[tuple[str, str], str]  # system and processor, as Python names them -> folder of its library


VERSIONS: Mapping[str, Version] = {
    "2.0": Version(
        "2.0",
        "mbs_fmi2.c",
        fmi2.describe,
        {
            ("Linux", "x86_64"): "linux64",
            ("Darwin", "x86_64"): "darwin64",
            ("Windows", "AMD64"): "win64",
        },
    ),
    "3.0": Version(
        "3.0",
        "mbs_fmi3.c",
        fmi3.describe,
        {
            ("Linux", "x86_64"): "x86_64-linux",
            ("Linux", "aarch64"): "aarch64-linux",
            ("Darwin", "x86_64"): "x86_64-darwin",
            ("Darwin", "arm64"): "aarch64-darwin",
            ("Windows", "AMD64"): "x86_64-windows",
        },
    ),
}
