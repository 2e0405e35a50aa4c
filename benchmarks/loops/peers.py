"""Other programs for mechanisms with loops: compiled, loaded with a mechanism, and described in CasADi's contract.

| | what it is | loops |
|---|---|---|
| Pinocchio | `constraintDynamics` and its analytic derivatives, in C++ | 3-D and 6-D; proximal if redundant |
| Simbody | articulated bodies and a rank-revealing solve, in C++ | balls, angles, welds, rods |
| MuJoCo | `mj_forward`, in C | soft: it computes something else |

Each is left out where its headers are missing: `pip install '.[bench]'`, and Debian's `libsimbody-dev`.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.compilation import BOOST, FAST, find_cache, find_includes, find_versions, run
from benchmarks.loops.mechanism import write_loops, write_xml
from mbsgen.model.tree import Cut, Tree
from mbsrun.measuring.functions import Face, Function, dense

Array = NDArray[np.float64]

HERE = Path(__file__).parent / "cpp"
SIMBODY = Path("/usr/include/simbody")  # where Debian puts it
PINOCCHIO, SIMTK, MUJOCO = "Pinocchio", "Simbody", "MuJoCo"
PROXIMAL = (1e-8, 1e-12, 20)  # mu, accuracy and iterations of Pinocchio's method where equations are redundant
DIRECT = (0.0, 1e-12, 1)
PROGRAMS = ("pinocchio_loops.cpp", "pinocchio_motion.cpp")


@dataclass(frozen=True)
class Peer:
    """A program, its library, and how the library takes a mechanism."""

    name: str
    library: Path
    functions: tuple[tuple[str, str], ...]  # the compared function, and the symbol
    load: Callable[[Path], None]
    is_soft: bool = False


def compile_library(source: Path, command: Sequence[str], link: Sequence[str], packages: Sequence[str] = ()) -> Path:
    """Compile a source of `cpp/` to a library, once: it is found again by its text, flags and packages."""
    digest = hashlib.sha256(repr((command, link, packages)).encode())
    for file in (source, *sorted(HERE.glob("*.hpp")), HERE.parents[1] / "cpp" / "mechanism.hpp"):
        digest.update(file.read_bytes())
    target = find_cache() / "loops" / f"{source.stem}-{digest.hexdigest()[:16]}.so"
    if not target.exists():
        target.parent.mkdir(parents=True, exist_ok=True)
        unfinished = target.with_suffix(f".{os.getpid()}")
        run((*command, "-shared", str(source), "-o", str(unfinished), *link))
        unfinished.replace(target)
    return target


def compile_pinocchio(name: str) -> Path | None:
    """Compile a program of Pinocchio; None where its headers are missing. It takes minutes."""
    headers = find_includes()
    if headers is None:
        return None
    search = ("-isystem", str(headers), "-isystem", str(headers / "eigen3"))
    command = (*_find_cxx(), "-w", *BOOST, *FAST, *search)
    return compile_library(HERE / name, command, (), find_versions())


def compile_simbody() -> Path | None:
    """Compile Simbody's program; None where its headers are missing."""
    headers = find_includes()
    if headers is None or not SIMBODY.exists():
        return None
    search = ("-isystem", str(SIMBODY), "-isystem", str(headers / "eigen3"))
    link = ("-lSimTKsimbody", "-lSimTKmath", "-lSimTKcommon")
    return compile_library(HERE / "simbody_loops.cpp", (*_find_cxx(), *FAST, *search), link)


def compile_mujoco() -> Path | None:
    """Compile MuJoCo's program; None where the package is missing."""
    found = find_spec("mujoco")
    if found is None or found.origin is None:
        return None
    folder = Path(found.origin).parent
    library = next(iter(sorted(folder.glob("libmujoco.so*"))), None)
    if library is None:
        return None
    command = (*shlex.split(os.environ.get("CC", "cc")), *FAST, "-I", str(folder / "include"))
    return compile_library(HERE / "mujoco_loops.c", command, (str(library), f"-Wl,-rpath,{folder}"))


def _find_cxx() -> tuple[str, ...]:
    return (*shlex.split(os.environ.get("CXX", "c++")), "-std=c++17")


def compile_all() -> list[str]:
    """Compile every program; return the names of the peers whose headers are missing."""
    libraries = {
        PINOCCHIO: [compile_pinocchio(name) for name in PROGRAMS],
        SIMTK: [compile_simbody()],
        MUJOCO: [compile_mujoco()],
    }
    return [name for name, found in libraries.items() if None in found]


@cache
def find_peers() -> tuple[Peer, ...]:
    """Compile every peer whose headers are there."""
    return tuple(_list_peers())


def _list_peers() -> Iterator[Peer]:
    pinocchio, simbody, mujoco = compile_pinocchio(PROGRAMS[0]), compile_simbody(), compile_mujoco()
    if pinocchio is not None:
        names = (("exp", "pinl_exp1"), ("jac_exp", "pinl_jac_exp1"))
        for label, settings in (("direct", DIRECT), ("proximal", PROXIMAL)):
            yield Peer(f"{PINOCCHIO}, {label}", pinocchio, names, _load_pinocchio(pinocchio, settings))
    if simbody is not None:
        yield Peer(SIMTK, simbody, (("exp", "sbl_exp2"),), _load_simbody(simbody))
    if mujoco is not None:
        yield Peer(MUJOCO, mujoco, (("exp", "mjl_exp1"),), _load_mujoco(mujoco), is_soft=True)


def _load_pinocchio(library: Path, settings: tuple[float, float, int]) -> Callable[[Path], None]:
    mu, accuracy, iterations = settings

    def load(folder: Path) -> None:
        path, accepted = os.fsencode(folder / "mechanism.txt"), ctypes.CDLL(str(library)).pinl_load
        if accepted(path, ctypes.c_double(mu), ctypes.c_double(accuracy), iterations):
            raise ValueError(f"it cannot read {folder / 'mechanism.txt'}")

    return load


def _load_simbody(library: Path) -> Callable[[Path], None]:
    def load(folder: Path) -> None:
        if ctypes.CDLL(str(library)).sbl_load(os.fsencode(folder / "mechanism.txt")):
            raise ValueError(f"it cannot read {folder / 'mechanism.txt'}")

    return load


def _load_mujoco(library: Path) -> Callable[[Path], None]:
    def load(folder: Path) -> None:
        numbers = [int(text) for text in (folder / "actuated.txt").read_text("utf-8").split()]
        path, joints = folder / "mechanism.xml", (ctypes.c_int * len(numbers))(*numbers)
        if not path.exists():
            raise ValueError("it takes no bodies without mass, and no rods")
        if ctypes.CDLL(str(library)).mjl_load(os.fsencode(path), joints, len(numbers)):
            raise ValueError(f"it cannot read {path}")

    return load


def write_files(tree: Tree, folder: Path) -> None:
    """Write a mechanism for all peers. Raises ValueError for parts that they lack; MuJoCo may lack more."""
    (folder / "mechanism.txt").write_text(write_loops(tree), encoding="utf-8")
    numbers = [str(k) for k, body in enumerate(tree.bodies) if body.joint.actuated]
    (folder / "actuated.txt").write_text(" ".join(numbers), encoding="utf-8")
    (folder / "mechanism.xml").unlink(missing_ok=True)
    if all(body.mass != 0 for body in tree.bodies) and all(loop.cut is not Cut.ROD for loop in tree.loops):
        (folder / "mechanism.xml").write_text(write_xml(tree), encoding="utf-8")


def describe(peer: Peer, joints: int) -> dict[str, Function]:
    """Describe a peer's functions in CasADi's contract."""
    forward = ("q", "qd", "u")
    faces = {
        "exp": Face(forward, (dense("qdd", joints, 1),)),
        "jac_exp": Face(forward, tuple(dense(f"jac_qdd_{x}", joints, joints) for x in ("q", "qd"))),
    }
    return {name: Function(peer.library, symbol, faces[name]) for name, symbol in peer.functions}
