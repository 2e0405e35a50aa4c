"""Searches where rows bend: whole steps that a filter refuses, and steps that it cuts short again and again."""

from __future__ import annotations

import pytest

import mbsrun


def test_a_rider_of_peaks_comes_down_without_help() -> None:
    """Betts (2010), example 4.9. Without added curvature, the search is not over after 500 iterations."""
    problem = mbsrun.read_problem("models/classics/alp_rider.ocp.yaml").with_changes(intervals=100)
    own = problem.with_solver("mbs").solve(check=False)
    assert own.status == "Solve_Succeeded"
    assert 2030.85 < own.cost < 2100  # of fine grids
    peer = problem.with_solver("ipopt", options={"mu_init": 1e-6}).solve(guess=own, check=False)
    assert peer.cost == pytest.approx(own.cost, rel=1e-6)  # from there, IPOPT finds no lower cost


@pytest.mark.parametrize("intervals", [31, 50, 73])
def test_good_steps_are_taken_although_a_filter_refuses_them(intervals: int) -> None:
    """A swing-up of a cart-pole took 12 to 48 iterations without them, by the number of intervals."""
    problem = mbsrun.read_problem("models/classics/cart_pole.ocp.yaml").with_changes(intervals=intervals)
    solved = problem.with_solver("mbs").solve(check=False)
    assert solved.status == "Solve_Succeeded"
    assert solved.solution.run.iterations <= 12
    assert solved.cost == pytest.approx(58.81, abs=0.01)
