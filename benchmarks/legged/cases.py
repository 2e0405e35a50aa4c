"""The problems: a file for ours, a program in plain CasADi on the same mesh, and the published optimum."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType

from benchmarks.legged import biped, carrier, quadruped, walker
from benchmarks.legged.chains import Mechanism
from benchmarks.legged.collocation import Graph

FOLDER = Path(__file__).parents[2] / "models" / "legged"


@dataclass(frozen=True)
class Case:
    """A problem: its file, the plain program, and the mechanism that impacts concern."""

    file: Path
    write: Callable[[], Graph]
    struck: Callable[[], Mechanism] | None = None


CASES: Mapping[str, Case] = MappingProxyType(
    {
        "walker": Case(FOLDER / "walker.ocp.yaml", partial(walker.write, walker.Step(), 25, 3), walker.describe_free),
        "pick and place": Case(FOLDER / "pick_and_place.ocp.yaml", partial(carrier.write, 20, 3)),
        "jump": Case(FOLDER / "jump.ocp.yaml", partial(biped.write, 20, 3), biped.describe_biped),
        "bound": Case(FOLDER / "bound.ocp.yaml", partial(quadruped.write, 5, 3), quadruped.describe_quadruped),
    }
)
