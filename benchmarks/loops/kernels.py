"""Kernels of mechanisms with loops beside other programs: accelerations and their Jacobian, in one run.

Multipliers are results of our kernels and are not compared: each program has its own. MuJoCo's loops are soft, so its
accelerations differ, and the table says by how much. All numbers of a model are folded into our code alone.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.candidates import OURS
from benchmarks.loops.mechanism import find_obstacle
from benchmarks.loops.peers import MUJOCO, Peer, describe, find_peers, write_files
from benchmarks.loops.states import Directions, draw_states, find_directions, project
from benchmarks.robots import remove_forces
from mbsgen.model.model import BASE, ZERO, Body, Carrier, Fixed, Joint
from mbsgen.model.tree import Kind, Tree
from mbsgen.model.writer import write_model
from mbsgen.pipeline import read, read_tree
from mbsrun import Mechanism
from mbsrun.library import compile_library
from mbsrun.measuring.functions import Code, Function, Variant, find_function
from mbsrun.measuring.timing import Watch, measure_rounds
from mbsrun.models import Extent, find_folder

Array = NDArray[np.float64]

STATES, CHECKED = 128, 3
TOLERANCE = 1e-6  # of peers' results, relative: proximal methods stop early
FUNCTIONS: Mapping[str, tuple[str, ...]] = {"exp": ("exp1", "exp2"), "jac_exp": ("lin_exp1", "lin_exp2")}
NEEDED = ("exp1", "exp2", "loops", "loop_rates", "loop_jacobian")
LIBM = ", libm"
SOFT = (MUJOCO,)


@dataclass(frozen=True)
class Timed:
    """One program's time for one function."""

    author: str
    way: str
    flops: int | None
    ns: float  # of the quickest round
    ns_median: float
    difference: float | None  # of its results from ours, relative; None: ours

    @property
    def agrees(self) -> bool:
        """Return whether its results are ours."""
        return self.difference is not None and self.difference <= TOLERANCE


@dataclass(frozen=True)
class Row:
    """One function of one mechanism."""

    mechanism: str
    joints: int
    equations: int
    function: str
    ours: tuple[Timed, ...]
    peers: tuple[Timed, ...]
    failures: tuple[str, ...]  # of peers that do not compute it
    load: tuple[float, float]  # of the machine, before and after

    @property
    def quickest(self) -> Timed | None:
        """Return the quickest peer whose results agree; where none agrees, the quickest of all with hard loops."""
        able = [x for x in self.peers if x.agrees] or [x for x in self.peers if x.author not in SOFT]
        return min(able, key=lambda x: x.ns, default=None)

    def best(self, libm: bool) -> Timed:
        """Return our quickest kernel with our sines, or with the C library's."""
        return min((x for x in self.ours if x.way.endswith(LIBM) == libm), key=lambda x: x.ns)

    def compare(self, libm: bool) -> tuple[float, float] | None:
        """Return the time of the quickest peer by ours: of shortest rounds, and of medians."""
        if self.quickest is None:
            return None
        own = self.best(libm)
        return self.quickest.ns / own.ns, self.quickest.ns_median / own.ns_median


def measure_model(model: Path, rounds: int, report: Callable[[str], None] = lambda _: None) -> list[Row]:
    """Compare our kernels with all peers that take the mechanism. Raises MbsError, ArithmeticError."""
    report("generating and compiling")
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        free = write_without_forces(model, folder)
        generated = find_folder(free, Extent(NEEDED, derivatives=1))
        kernels, tree = Mechanism(generated), read_tree(free)
        pool = draw_states(kernels, STATES)
        ours = _list_ours(kernels, generated)
        report("timing")
        return [_measure_function(name, kernels, tree, ours[name], pool, rounds, folder) for name in FUNCTIONS]


def hash_sources() -> str:
    """Name the files of this folder by their content: what is measured depends on them."""
    digest = hashlib.sha256()
    here = Path(__file__).parent
    for file in sorted([*here.glob("*.py"), *(here / "cpp").iterdir()]):
        if file.name != "table.py":
            digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def write_without_forces(model: Path, folder: Path) -> Path:
    """Write a model file with numbers alone, without laws of joints, rotors and wrenches: not all peers have them."""
    path, free = folder / f"{model.stem}.yaml", remove_forces(read(model))
    bodies = tuple(replace(body, joint=_remove_rotors(body.joint)) for body in free.bodies)
    parameters = tuple(replace(parameter, kind=Kind.CONSTANT) for parameter in free.parameters)
    content = replace(free, bodies=tuple(_order(bodies, BASE)), parameters=parameters, wrenches=())
    path.write_text(write_model(content), encoding="utf-8")
    return path


def _order(bodies: Sequence[Body], parent: str) -> Iterator[Body]:
    """Put the bodies of every branch together, as Pinocchio wants them."""
    for body in bodies:
        if body.parent == parent:
            yield body
            yield from _order(bodies, body.name)


def _remove_rotors(carrier: Carrier) -> Carrier:
    match carrier:
        case Fixed():
            return carrier
        case Joint():
            return replace(carrier, armature=ZERO)
    return tuple(replace(joint, armature=ZERO) for joint in carrier)


def _list_ours(kernels: Mechanism, folder: Path) -> dict[str, dict[str, Function]]:
    """Return our kernels by function and way, with sines of our header and of the C library."""
    manifest = kernels.manifest
    names = [name for group in FUNCTIONS.values() for name in group]
    sources = [source for name in names for source in manifest.kernel(name).sources]
    own = kernels.compile(*names)
    libm = compile_library(folder, manifest.prefix, sources, Variant(libm=True).compiler())
    return {
        function: {
            f"{name}{mark}": find_function(library, manifest.kernel(name).symbol)
            for name in group
            for mark, library in (("", own), (LIBM, libm))
        }
        for function, group in FUNCTIONS.items()
    }


def _measure_function(
    function: str,
    kernels: Mechanism,
    tree: Tree,
    ours: Mapping[str, Function],
    pool: Mapping[str, Array],
    rounds: int,
    folder: Path,
) -> Row:
    """Check and time one function: one peer is loaded at a time, for each holds one mechanism."""
    manifest = kernels.manifest
    own = {way: Code(found) for way, found in ours.items()}
    expected = _evaluate(next(iter(own.values())), pool)
    ways = [find_directions(kernels, pool["q"][k], pool["qd"][k]) for k in range(CHECKED)]
    peers, failures = _load_peers(function, tree, folder)
    codes = {peer.name: Code(describe(peer, len(tree.bodies))[function], blank=0.0) for peer in peers}
    compared: dict[str, float] = {}
    watches: list[tuple[str, Watch]] = [(way, Watch(code, code.lay(pool))) for way, code in own.items()]
    before = os.getloadavg()[0]
    for peer in peers:
        peer.load(folder)
        compared[peer.name] = _compare(_evaluate(codes[peer.name], pool), expected, ways)
        if np.isfinite(compared[peer.name]):
            watches.append((peer.name, Watch(codes[peer.name], codes[peer.name].lay(pool))))
        else:
            failures.append(f"{peer.name}: results that are not finite")
    times = _time(watches, {peer.name: peer for peer in peers}, rounds, folder)
    flops = {way: manifest.kernel(way.removesuffix(LIBM)).flops.arithmetic for way in ours}
    return Row(
        manifest.model,
        len(tree.bodies),
        len(manifest.dependent),
        function,
        tuple(_sum_up(OURS, way, flops[way], times[way], None) for way in ours),
        tuple(_sum_up(name, name, None, times[name], compared[name]) for name in codes if name in times),
        tuple(failures),
        (before, os.getloadavg()[0]),
    )


def _load_peers(function: str, tree: Tree, folder: Path) -> tuple[list[Peer], list[str]]:
    obstacle = find_obstacle(tree)
    if obstacle is not None:
        return [], [obstacle]
    try:
        write_files(tree, folder)
    except ValueError as error:
        return [], [str(error)]
    peers, failures = [], []
    for peer in find_peers():
        if function not in dict(peer.functions):
            continue
        try:
            peer.load(folder)
            peers.append(peer)
        except ValueError as error:
            failures.append(f"{peer.name}: {str(error).splitlines()[0].replace(str(folder), '')}")
    return peers, failures


def _time(
    watches: Sequence[tuple[str, Watch]], peers: Mapping[str, Peer], rounds: int, folder: Path
) -> dict[str, Array]:
    """Time all in turn; load each peer before its turn, as the last load sets Pinocchio's settings."""
    found: dict[str, list[float]] = {name: [] for name, _ in watches}
    for _ in range(rounds):
        for name, watch in watches:
            if name in peers:
                peers[name].load(folder)
            found[name] += [float(times[0]) for times in measure_rounds([watch], 1)]
    return {name: np.array(times) for name, times in found.items()}


def _evaluate(code: Code, pool: Mapping[str, Array]) -> list[dict[str, Array]]:
    statuses, results = code.call([x[:CHECKED] for x in code.lay(pool)])
    if statuses.any():
        raise ArithmeticError(f"{code.function.symbol}: status {statuses.max()}")
    return results


def _compare(
    found: Sequence[Mapping[str, Array]], expected: Sequence[Mapping[str, Array]], ways: Sequence[Directions]
) -> float:
    """Return the largest relative difference of results; of Jacobians, along directions in which loops stay closed."""
    worst = 0.0
    for own, other, way in zip(expected, found, ways, strict=True):
        pairs = [(own["qdd"], other["qdd"])] if "qdd" in other else []
        if "jac_qdd_q" in other:
            pairs.append((project(own, way), project(other, way)))
        for a, b in pairs:
            error = float(np.abs(a - b).max() / max(1.0, float(np.abs(a).max())))
            worst = max(worst, error if np.isfinite(error) else np.inf)
    return worst


def _sum_up(author: str, way: str, flops: int | None, times: Array, difference: float | None) -> Timed:
    return Timed(author, way, flops, float(times.min()), float(np.median(times)), difference)
