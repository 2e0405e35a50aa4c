"""The examples of OpenSim Moco: one optimum of both programs, and the page."""

from __future__ import annotations

import os

import pytest

from benchmarks.moco.__main__ import AGREED, CASES, PEERS, SOLVED, Row, Run, ask, choose, write_motion, write_page
from mbsrun import load
from mbsrun.ocp.solution.solution import Solution
from mbsrun.ocp.solving.solve import solve
from mbsrun.ocp.statement.statement import read_problem


def test_moco_keeps_our_sliding_mass() -> None:
    """Hermite and Simpson's rule, linear controls: from our motion Moco finds our cost, in a few steps."""
    if "MBSGEN_OPENSIM" not in os.environ and not (PEERS / "opensim").exists():
        pytest.skip("python -m tests.peers build/peers installs OpenSim; MBSGEN_OPENSIM names a Python that has it")
    case = CASES[0]
    found = solve(*read_problem(case.file, load))
    assert isinstance(found, Solution), found
    theirs = ask(case, 1e-8, write_motion(case, found))
    assert theirs.cost == pytest.approx(found.cost.total, rel=1.5 * AGREED)  # its bounds give way by 1e-8 of 50 N
    assert theirs.iterations < 30


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_motions_have_all_numbers_of_the_grid(case: object) -> None:
    """A motion has as many places as the grid of Moco has, mesh points once."""
    own = next(x for x in CASES if x is case)
    found = solve(*read_problem(own.file, load))
    assert isinstance(found, Solution), found
    motion = write_motion(own, found)
    inner = 2 if found.problem.family.value == "lobatto" else 3
    assert len(motion["time"]) == 1 + inner * found.problem.intervals
    parts = [motion[part] for part in ("states", "controls", "derivatives")]
    assert all(len(values) == len(motion["time"]) for part in parts for values in part.values())


def test_the_page_shows_costs_and_the_ratio_of_times() -> None:
    near, alone = (
        Run(2.0000002, "Solve_Succeeded", 3, 1.0, 0.5),
        Run(2.002, "Maximum_Iterations", 300, 90.0, 80.0, "exact, central"),
    )
    page = write_page([Row(CASES[0], "50 intervals, lobatto 3", 2.0, 0.2, 0.1, 9, alone, near)])
    assert "Moco's cost is ours to 1e-06 in 1 of 1 problems" in page
    assert "| +1.0e-07 | 3 | +1.0e-03 | Maximum_Iterations, 300 |" in page
    assert "| 9 | 0.200 | 0.100 | 300 | 90.0 | 80.00 | 800 | exact, central |" in page


def test_the_quickest_options_that_end_near_our_cost_count() -> None:
    """One is quick and far, one is quick and unsolved, two end near; without any, Moco's defaults count."""
    far, unsolved = Run(2.1, SOLVED, 3, 1.0, 0.1), Run(2.0, "Maximum_Iterations", 300, 1.0, 0.1)
    slow, quick = Run(2.001, SOLVED, 9, 4.0, 3.0), Run(1.999, SOLVED, 9, 5.0, 2.0)
    assert choose([far, unsolved, slow, quick], 2.0) is quick
    assert choose([unsolved, far], 2.0) is unsolved
