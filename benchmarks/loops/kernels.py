"""Kernels of mechanisms with loops beside other programs: accelerations and their Jacobian, in one run.

Multipliers are results of our kernels and are not compared: each program has its own. MuJoCo's loops are soft, so its
accelerations differ, and the table says by how much. All numbers of a model are folded into our code alone.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.candidates import OURS
from benchmarks.loops.mechanism import find_obstacle
from benchmarks.loops.peers import Peer, describe, find_peers, write_files
from benchmarks.loops.states import Directions, draw_states, find_directions, project
from benchmarks.robots import remove_forces
from mbsgen.model.tree import Tree
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
TITLES = {"exp": "accelerations", "jac_exp": "accelerations and their Jacobian"}
NEEDED = ("exp1", "exp2", "loops", "loop_rates", "loop_jacobian")
LIBM = ", libm"


@dataclass(frozen=True)
class Timed:
    """One program's time for one function."""

    author: str
    way: str
    flops: int | None
    ns: float  # of the quickest round
    ns_median: float
    difference: float | None  # of its results from ours, relative; None: ours


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

    @property
    def quickest(self) -> Timed | None:
        """Return the quickest peer whose results agree."""
        able = [x for x in self.peers if x.difference is not None and x.difference <= TOLERANCE]
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


def write_without_forces(model: Path, folder: Path) -> Path:
    """Write a model file without laws of joints: the peers take forces as inputs alone."""
    path = folder / f"{model.stem}.yaml"
    path.write_text(write_model(remove_forces(read(model))), encoding="utf-8")
    return path


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
    for peer in peers:
        peer.load(folder)
        compared[peer.name] = _compare(_evaluate(codes[peer.name], pool), expected, ways)
        watches.append((peer.name, Watch(codes[peer.name], codes[peer.name].lay(pool))))
    times = _time(watches, {peer.name: peer for peer in peers}, rounds, folder)
    flops = {way: manifest.kernel(way.removesuffix(LIBM)).flops.arithmetic for way in ours}
    return Row(
        manifest.model,
        len(tree.bodies),
        len(manifest.dependent),
        function,
        tuple(_sum_up(OURS, way, flops[way], times[way], None) for way in ours),
        tuple(_sum_up(name, name, None, times[name], compared[name]) for name in codes),
        tuple(failures),
    )


def _load_peers(function: str, tree: Tree, folder: Path) -> tuple[list[Peer], list[str]]:
    obstacle = find_obstacle(tree)
    if obstacle is not None:
        return [], [obstacle]
    write_files(tree, folder)
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
    """Time all in turn; Pinocchio's settings are those of its last load, so it is loaded for each way."""
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


def list_lines(rows: Sequence[Row]) -> Iterator[tuple[str, ...]]:
    """Lay rows out as text."""
    for row in rows:
        quickest, own, libm = row.quickest, row.best(libm=False), row.best(libm=True)
        yield (
            row.mechanism,
            f"{row.joints}, {row.equations}",
            TITLES[row.function],
            f"{own.way}: {own.flops}",
            f"{own.ns:.0f} · {own.ns_median:.0f}",
            f"{libm.ns:.0f} · {libm.ns_median:.0f}",
            "; ".join(_write_peer(x) for x in row.peers) or "; ".join(row.failures) or "–",
            "–" if quickest is None else quickest.way,
            *(
                "–" if pair is None else f"{pair[0]:#.3g} · {pair[1]:#.3g}"
                for pair in (row.compare(False), row.compare(True))
            ),
        )


COLUMNS = (
    "",
    "joints, equations",
    "function",
    "ours: operations",
    "ns",
    "ns, C library's sines",
    "others: ns, difference",
    "quickest that agrees",
    "its time by ours",
    "same, C library's sines",
)


def _write_peer(timed: Timed) -> str:
    return f"{timed.way} {timed.ns:.0f} · {timed.ns_median:.0f}, {timed.difference:.0e}"


def describe_load() -> str:
    """Return the load of the machine."""
    return " ".join(f"{x:.1f}" for x in os.getloadavg())
