"""The front of a chart, and the sentence about it."""

from __future__ import annotations

from mbsrun.measuring.fronts import Mark, describe_front, find_front
from mbsrun.measuring.points import Cost


def mark(series: str, time: float | None, error: float | None, *, failed: bool = False) -> Mark:
    cost = None if time is None else Cost(time, 2 * time, 0.1, 5)
    return Mark(series, "label", cost, error, is_failure=failed)


def test_no_mark_of_the_front_is_beaten_in_both() -> None:
    """A tie in time is decided by the error; failures and unknown numbers are on no front."""
    fast, tied, slow, worse = mark("a", 1, 1e-3), mark("b", 1, 1e-4), mark("c", 5, 1e-9), mark("d", 3, 1e-2)
    lost = [mark("e", None, 1e-12), mark("f", 0.1, None), mark("g", 0.1, 1e-15, failed=True)]
    assert find_front([slow, worse, fast, tied, *lost]) == [tied, slow]
    assert describe_front([slow, tied], "ns") == (
        "Fastest: b (label), 1 ns with an error of 1e-04; most accurate: c (label), 5 ns with an error of 1e-09."
    )
    assert describe_front([slow], "s").startswith("c (label) is both the fastest and the most accurate: 5 s")
    assert describe_front(lost, "s") == "Nothing was measured here."


def test_a_label_that_names_its_series_is_the_name() -> None:
    assert Mark("no gravity", "no gravity, 43%", None, None).name == "no gravity, 43%"
    assert Mark("exp1", "", None, None).name == "exp1"
