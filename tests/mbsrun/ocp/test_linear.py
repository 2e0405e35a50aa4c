"""The choice of IPOPT's linear solver: the project's own is loaded by versions of IPOPT that it is written for."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from pathlib import Path

import casadi as ca
import pytest

from mbsrun.ocp.ground import linear
from mbsrun.ocp.ground.linear import FIRST, LAST, MUMPS, OWN, Version, choose, read_version, set_up
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import solve
from tests.mbsrun.ocp.plants import push
from tests.mbsrun.peer import double_integrator


@pytest.fixture(autouse=True)
def forget() -> Iterator[None]:
    """IPOPT is asked once in a process; ask again here, and after what a test pretends."""
    linear._is_loadable.cache_clear()
    yield
    linear._is_loadable.cache_clear()


def test_version_is_of_the_header_that_casadi_ships() -> None:
    header = Path(ca.__file__).parent / "include" / "coin-or" / "IpoptConfig.h"
    (told,) = re.findall(r'#define IPOPT_VERSION "([\d.]+)"', header.read_text("utf-8"))
    assert read_version() == tuple(map(int, told.split(".")))


def test_a_version_that_it_is_written_for_loads_it(caplog: pytest.LogCaptureFixture) -> None:
    assert set_up(OWN)["linear_solver"] == "ma97"
    assert (choose(OWN), choose(MUMPS), caplog.messages) == (OWN, MUMPS, [])


OTHERS: dict[str, Version | None] = {
    "3.14.10": (3, 14, 10),
    "3.14.20": (3, 14, 20),
    "3.15": (3, 15),
    "4.0.0": (4, 0, 0),
    "unknown": None,
}


@pytest.mark.parametrize(("told", "version"), OTHERS.items(), ids=OTHERS.keys())
def test_mumps_replaces_it_in_another_version(
    told: str, version: Version | None, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The problem is solved, 12 / (1 - 1/N^2), and one sentence names the version found and those wanted."""
    monkeypatch.setattr(linear, "read_version", lambda: version)
    with caplog.at_level(logging.WARNING, "mbsrun"):
        outcomes = [solve(push(8), double_integrator()) for _ in range(2)]
    assert (choose(OWN), set_up(OWN)["linear_solver"]) == (MUMPS, "mumps")
    assert all(isinstance(x, Solution) and x.cost.total == pytest.approx(12 / (1 - 1 / 64)) for x in outcomes)
    (sentence,) = caplog.messages
    assert f"has version {told}," in sentence
    wanted = " to ".join(".".join(map(str, x)) for x in (FIRST, LAST))
    assert wanted in sentence
    assert sentence.endswith("MUMPS replaces it")
