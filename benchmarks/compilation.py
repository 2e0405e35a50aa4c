"""Compile sources to shared libraries, once: a library is found again by its text and flags.

C is compiled by the compiler and with the flags of `mbsrun.library` (CC, CFLAGS), so that candidates differ in
their equations alone; C++ by CXX with the flags for speed.
"""

from __future__ import annotations

import hashlib
import os
import re
import shlex
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.metadata import version
from pathlib import Path

import casadi as ca

from benchmarks.candidates import Sines
from mbsgen import resources
from mbsrun.cache import cache_folder
from mbsrun.environment import describe_environment
from mbsrun.library import find_compiler

HERE = Path(__file__).parent
PROCESSORS = Path("/proc/cpuinfo")
CSRC = resources.folder("csrc")
HEADERS = tuple(CSRC / name for name in ("mbs_sincos.h", "mbs_abi.h"))  # what C may include
# CasADi's small functions are global: without these flags the compiler does not inline them.
EXPORTED = ("-fvisibility=hidden", "-DGCC_HASCLASSVISIBILITY")
# The flags are chosen for the kernels. C of CasADi is also compiled with gcc's vectors in straight-line code; the
# quicker one counts.
VECTORS = ", vectors"
VARIANTS: Mapping[str, tuple[str, ...]] = {"": (), VECTORS: ("-ftree-slp-vectorize",)}
FAST = ("-O3", "-march=native", "-ffp-contract=fast", "-fno-math-errno", "-fPIC", "-DNDEBUG")
# Settings of Boost for Pinocchio's lists of types, as in Pinocchio's CMake files; and `get` for a joint that a
# collection does not contain.
BOOST = (
    "-DBOOST_MPL_LIMIT_LIST_SIZE=30",
    "-DBOOST_MPL_LIMIT_VECTOR_SIZE=30",
    "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS",
    "-DBOOST_FUSION_INVOKE_MAX_ARITY=12",
    "-DBOOST_VARIANT_USE_RELAXED_GET_BY_DEFAULT",
)


def describe_machine() -> str:
    """Return the processor and the compiler that times depend on."""
    environment = describe_environment()
    return f"{environment['processor']}{_find_family()}, compiler {environment['compiler']}"


def _find_family() -> str:
    """Return the family of the processor, where its name does not say which one it is."""
    if not PROCESSORS.exists():
        return ""
    found = re.search(r"^cpu family\s*:\s*(\d+)$", PROCESSORS.read_text(encoding="utf-8"), re.MULTILINE)
    return f" of family {found[1]}" if found else ""


def describe_flags() -> str:
    """Return the compiler flags of generated C."""
    return " ".join(["-O3", *find_compiler(os.environ).flags])


class BuildError(Exception):
    """A peer or kernel does not compile; the message contains the output of the compiler."""


@dataclass(frozen=True)
class Workshop:
    """The folder and the compilers of candidates."""

    folder: Path
    includes: Path | None  # the headers of Pinocchio, Boost and Eigen; None where they are not installed

    @cached_property
    def c(self) -> tuple[str, ...]:
        """Command and flags for C."""
        compiler = find_compiler(os.environ)
        return (*compiler.command, *compiler.flags)

    @cached_property
    def cxx(self) -> tuple[str, ...]:
        """Command and flags for C++ with Pinocchio."""
        return (*shlex.split(os.environ.get("CXX", "c++")), "-std=c++17", *BOOST)

    def compile_c(self, source: Path, name: str, flags: Sequence[str] = ("-O3", *EXPORTED)) -> Path:
        """Compile one C file as a library, with further flags."""
        included = HEADERS if "mbs_sincos.h" in source.read_text(encoding="utf-8") else ()
        return self._build(name, (*self.c, *flags, "-shared"), (source, *included), ("-lm",), (CSRC,))

    def compile_pinocchio(self, sines: Sines = "libm") -> Path:
        """Compile Pinocchio's algorithms over doubles, in CasADi's contract, with the chosen sines."""
        chosen, included = (("-DMBS_SINES",), HEADERS) if sines == "header" else ((), ())
        sources = (HERE / "cpp" / "pinocchio.cpp", HERE / "cpp" / "mechanism.hpp", *included)
        return self._build("pinocchio", (*self.cxx, *FAST, *chosen, "-shared"), sources, (), (CSRC, *self._headers))

    def compile_tracer(self) -> Path:
        """Compile the program that traces Pinocchio's algorithms with CasADi's symbols."""
        casadi = Path(ca.__file__).resolve().parent
        sources = (HERE / "cpp" / "trace.cpp", HERE / "cpp" / "mechanism.hpp")
        link = (f"-L{casadi}", "-lcasadi", f"-Wl,-rpath,{casadi}")
        return self._build("trace", (*self.cxx, "-O0"), sources, link, (*self._headers, casadi / "include"))

    @property
    def _headers(self) -> tuple[Path, Path]:
        assert self.includes is not None, "called only where headers exist"
        return self.includes, self.includes / "eigen3"

    def _build(
        self, name: str, command: Sequence[str], sources: Sequence[Path], link: Sequence[str], search: Sequence[Path]
    ) -> Path:
        """Compile the first of `sources`; it includes the others, and `search` lists further folders of headers.

        The name of the library is a hash of all contents, so that checkouts share it.
        """
        packages = find_versions() if self.includes in search else ()
        digest = hashlib.sha256(repr((command, link, packages)).encode())
        for source in sources:
            digest.update(source.read_bytes())
        target = self.folder / f"{name}-{digest.hexdigest()[:16]}"
        if not target.exists():
            self.folder.mkdir(parents=True, exist_ok=True)
            unfinished = target.with_suffix(f".{os.getpid()}")
            include = [part for folder in search for part in ("-isystem", str(folder))]
            run((*command, *include, str(sources[0]), "-o", str(unfinished), *link))
            unfinished.replace(target)
        return target


def find_versions() -> tuple[str, ...]:
    """Return the versions of the packages that bring C++ headers."""
    return tuple(f"{name} {version(name)}" for name in ("pin", "cmeel-boost", "cmeel-eigen", "casadi"))


def find_cache() -> Path:
    """Return the folder of generated and compiled candidates, beside the user's cache."""
    return cache_folder(os.environ).with_name("mbsgen-benchmarks")


def find_includes() -> Path | None:
    """Find the headers that come with the packages pin and cmeel-eigen."""
    try:
        import pinocchio
    except ImportError:
        return None
    prefix = next((p for p in Path(pinocchio.__file__).resolve().parents if p.name == "cmeel.prefix"), None)
    include = prefix / "include" if prefix else None
    found = include and (include / "pinocchio" / "multibody.hpp").exists() and (include / "eigen3" / "Eigen").exists()
    return include if found else None


def run(command: Sequence[str]) -> str:
    """Run a program and return what it prints. Raises BuildError."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        raise BuildError(f"cannot run {command[0]}: {error.strerror}") from None
    if done.returncode:
        raise BuildError(f"{shlex.join(command)}\nfailed with status {done.returncode}:\n{done.stderr.strip()[-4000:]}")
    return done.stdout


def of_model(workshop: Workshop, name: str) -> Workshop:
    """Return the workshop with a separate folder."""
    return replace(workshop, folder=workshop.folder / name)
