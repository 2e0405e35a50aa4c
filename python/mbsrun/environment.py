"""The environment: versions, machine, compiler; kept with each measurement, and printed by `mbsrun --version`."""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import MappingProxyType

from mbsrun.cache import CacheError, cache_folder
from mbsrun.library import CompileError, Compiler, count_cores, find_compiler

PACKAGES = ("mbsgen", "casadi", "numpy", "scipy")  # CasADi brings the solvers
OPTIONAL = ("ziglang", "pin", "mujoco", "fmpy", "distributed", "pyarrow", "pandas")
_PROCESSORS = Path("/proc/cpuinfo")


@cache
def describe_environment() -> Mapping[str, str | int]:
    """Return the environment of this process. Raises CompileError where there is no compiler."""
    compiler = find_compiler(os.environ)
    return MappingProxyType(
        {
            **{name: version(name) for name in PACKAGES},
            "python": platform.python_version(),
            "system": f"{platform.system()} {platform.machine()}",
            "processor": _name_processor(),
            "cores": count_cores(),
            "compiler": _name_compiler(compiler),
            "flags": " ".join(compiler.flags),
        }
    )


def describe_installation() -> Mapping[str, str]:
    """Return the versions that were found, with the compiler, its flags and the cache's folder.

    A compiler or a cache that is missing is described by its message.
    """
    found = {"Python": f"{platform.python_version()} ({platform.system()} {platform.machine()})"}
    found |= {name: version(name) for name in PACKAGES[1:]}
    try:
        compiler = find_compiler(os.environ)
        found |= {"compiler": f"{' '.join(compiler.command)}: {_name_compiler(compiler)}"}
        found |= {"flags": " ".join(compiler.flags)}
    except CompileError as error:
        found |= {"compiler": f"none: {error}"}
    try:
        found |= {"cache": str(cache_folder(os.environ))}
    except CacheError as error:
        found |= {"cache": f"none: {error}"}
    return found | {name: _find_version(name) for name in OPTIONAL}


def _find_version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def _name_compiler(compiler: Compiler) -> str:
    found = re.search(r'#define __VERSION__ "([^"]*)"', compiler.macros)
    return found[1] if found else "unknown"


def _name_processor() -> str:
    if _PROCESSORS.exists():
        found = re.search(r"^model name\s*:\s*(.*)$", _PROCESSORS.read_text(encoding="utf-8"), re.MULTILINE)
        if found:
            return found[1]
    return platform.processor() or "unknown"
