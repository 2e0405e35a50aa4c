"""The environment of a measurement, kept with it: versions, machine, compiler."""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType

from mbsrun.library import find_compiler

PACKAGES = ("mbsgen", "casadi", "numpy", "scipy")  # CasADi brings the solvers
_PROCESSORS = Path("/proc/cpuinfo")


@cache
def describe_environment() -> Mapping[str, str | int]:
    """Return the environment of this process. Raises CompileError where there is no compiler."""
    compiler = find_compiler(os.environ)
    found = re.search(r'#define __VERSION__ "([^"]*)"', compiler.macros)
    return MappingProxyType(
        {
            **{name: version(name) for name in PACKAGES},
            "python": platform.python_version(),
            "system": f"{platform.system()} {platform.machine()}",
            "processor": _name_processor(),
            "cores": len(os.sched_getaffinity(0)),
            "compiler": found[1] if found else "unknown",
            "flags": " ".join(compiler.flags),
        }
    )


def _name_processor() -> str:
    if _PROCESSORS.exists():
        found = re.search(r"^model name\s*:\s*(.*)$", _PROCESSORS.read_text(encoding="utf-8"), re.MULTILINE)
        if found:
            return found[1]
    return platform.processor() or "unknown"
