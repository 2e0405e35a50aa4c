"""Many problems of one kind: every way finds the same optima, and the page has their numbers."""

from __future__ import annotations

from benchmarks.ocp.many import flights, measure, reaches, swing_ups, targets, write


def test_a_family_is_measured_by_all_ways() -> None:
    found = measure(swing_ups(3))
    assert (found.count, found.solved) == (3, 3)
    assert min(found.alone, found.cases, found.threads, found.solver, found.ipopt) > 0
    page = write([found], "a machine", "It was busy.")
    assert "It was busy." in page
    assert "wrote this page: a machine." in page
    assert f"| cart-pole swing-ups | 3 | 3 | {found.variables} |" in page


def test_families_have_as_many_problems_as_asked_for() -> None:
    for make in (swing_ups, flights, reaches):
        assert make(5).count == 5
    whole = targets(231)
    assert whole.count == 231
    assert targets(4).count == 4
    (points,) = whole.over.values()
    assert len({tuple(point.values()) for point in points}) == 231


def test_no_search_leaves_for_where_there_is_no_return() -> None:
    """Steps that lowered the cost took these reaches to violations from which 500 iterations did not return."""
    family, numbers = reaches(64), (17, 37)
    (ends,) = family.over.values()
    found = family.problem.with_solver("mbs").solve_many({"end.pose": [ends[k] for k in numbers]}, check=False)
    assert found.is_solved.all()
    assert found.iterations.max() < 150
