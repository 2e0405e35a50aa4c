"""Cases on the workers of a Dask cluster: each gets the generated C of the models once, and returns what records keep.

As in `cluster`, a worker needs this program and a C compiler, but neither model files nor a shared file system.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

from mbsrun.cache import MODELS, find_or_make
from mbsrun.external import Mechanism
from mbsrun.ocp.cases.cases import Case, CaseSolver
from mbsrun.ocp.cases.told import Told, tell
from mbsrun.ocp.problem.phases import Plants
from mbsrun.ocp.searching.cluster import ClusterError, ClusterExecutor, Kit, pack_kit


@dataclass(frozen=True)
class Kits:
    """The generated files of all models of a problem."""

    kits: tuple[Kit, ...]  # of each model once
    phases: tuple[int, ...]  # the model of each phase
    impacts: tuple[int | None, ...]  # and of each link's impact

    @property
    def key(self) -> str:
        """Name the content."""
        return f"{[kit.key for kit in self.kits]} {self.phases} {self.impacts}"

    def load(self) -> Plants:
        """Compile and load the models, in a process of the cluster."""
        every = [Mechanism(find_or_make(PurePath(MODELS, kit.key), kit.unpack)) for kit in self.kits]
        impacts = (None if number is None else every[number] for number in self.impacts)
        return Plants(tuple(every[number] for number in self.phases), tuple(impacts))


def pack_plants(plants: Plants) -> Kits:
    """Read the files of the models. Raises ClusterError for a problem without one."""
    folders = [getattr(plant, "folder", None) for plant in plants.every]
    kits = tuple(pack_kit(folder) for folder in folders if isinstance(folder, Path))
    if len(kits) < len(folders):
        raise ClusterError("a problem without a mechanism has no model to send; take --workers or --threads")
    impacts = (None if plant is None else plants.number(plant) for plant in plants.impacts)
    return Kits(kits, tuple(plants.number(plant) for plant in plants.phases), tuple(impacts))


def solve_elsewhere(client: Any, plants: Plants, cases: Sequence[Case]) -> Iterator[tuple[int, Told]]:
    """Solve cases on the workers of a `distributed.Client`; yield number and outcome of each as it ends.

    Raises ClusterError where a worker fails.
    """
    return ClusterExecutor(client, pack_plants(plants), solve_there).carry_out(enumerate(cases))


def solve_there(kits: Kits, order: tuple[int, Case]) -> tuple[int, Told]:
    """Solve a case, in a process of the cluster."""
    number, case = order
    if kits.key not in _SOLVERS:
        _SOLVERS[kits.key] = CaseSolver(kits.load())
    return number, tell(_SOLVERS[kits.key].solve(case))


_SOLVERS: dict[str, CaseSolver] = {}  # in this process, by the key of the kits
