"""The front of measured settings, and the sentences about it."""

from __future__ import annotations

import pytest

from mbsrun.measuring.fronts import Dot, Panel, find_front, find_stretches, state_finding, write_error, write_work
from mbsrun.measuring.panels import name_reduction


def dot(line: str, work: float | None, error: float | None, finding: str = "") -> Dot:
    return Dot(line, "", work, error, finding)


def orders(line: str, work: float, order: int) -> list[Dot]:
    """A method whose error falls by 2^order for twice the work."""
    return [Dot(line, f"step {k}", work * 2.0**k, 0.1 * 2.0 ** (-order * k)) for k in range(10)]


def test_no_dot_of_the_front_is_beaten_in_both() -> None:
    """A tie in work is decided by the error; failures and unknown numbers are on no front."""
    fast, tied, slow, worse = dot("a", 1, 1e-3), dot("b", 1, 1e-4), dot("c", 5, 1e-9), dot("d", 3, 1e-2)
    lost = [dot("e", None, 1e-12), dot("f", 0.1, None), dot("g", 0.1, 1e-15, "it stopped")]
    assert find_front([slow, worse, fast, tied, *lost]) == [tied, slow]
    assert find_front(lost) == []
    assert state_finding(lost) == "Nothing was measured here."


def test_a_high_order_wins_below_the_error_where_lines_cross() -> None:
    """Errors 0.1 (w/4)^-8 and 0.1 w^-2 are equal at w = 4^(4/3): the low order is the fastest above 0.0025."""
    low, high = orders("order 2", 1.0, 2), orders("order 8", 4.0, 8)
    first, second = find_stretches([*low, *high])
    assert (first.line, second.line) == ("order 2", "order 8")
    assert 1e-4 < second.largest < 1e-2
    assert state_finding([*low, *high]).startswith("Below ")
    assert "order 8 is the fastest; above" in state_finding([*low, *high])


def test_a_tenth_of_time_and_a_digit_of_error_do_not_decide() -> None:
    """Of two lines that are alike, one is named; a line that is dearer at every error never is."""
    first = orders("a", 1.0, 4)
    second = [Dot("b", "", 1.05 * d.place[0], 0.5 * d.place[1]) for d in first]
    dear = [Dot("c", "", 3 * d.place[0], d.place[1]) for d in first]
    assert state_finding([*first, *second, *dear]) in {f"{x} is the fastest at every error." for x in "ab"}
    assert state_finding(first) == "a is the only way that was measured."
    noisy = [*first, dot("d", 900.0, 1e-16), dot("d", 901.0, 1e-17)]
    assert state_finding(noisy, floor=first[-1].place[1]) == "a is the fastest at every error."


def test_savings_name_what_a_reader_acts_on() -> None:
    """A reduction without an error that saves nothing is not named; with errors, the one that saves the most is."""
    dots = (dot("sensor hand alone", 100.0, 0.0), dot("locking q5", 71.0, 0.04), dot("no gravity", 60.0, 0.9))
    nothing = Panel("", dots, "", "", "ns", 1e-6, None, whole=100.0)
    assert nothing.headline == (
        "No reduction with errors up to 1e-6 is 1.1 times faster; locking q5 is 1.4 times faster, with errors of 0.04."
    )
    assert nothing.choose_lines() == ["no gravity", "locking q5"]
    rough = Panel("", (*dots, dot("no forces", 80.0, 1e-16)), "", "", "ns", 0.1, None, whole=100.0)
    assert rough.headline == (
        "No forces is 1.2 times faster, without an error; locking q5 is 1.4 times faster, with errors of 0.04."
    )


def test_a_count_is_not_a_time() -> None:
    """Of grids, the finding names the one with the fewest intervals."""
    dots = (dot("Radau 5", 20, 1e-7), dot("Radau 2", 40, 1e-7))
    assert Panel("", dots, "intervals", "", "").headline == "Radau 5 needs the fewest intervals at every error."


def test_at_most_seven_lines_have_a_name_and_the_choice_is_one() -> None:
    lines = [orders(f"line {k}", 1.0 + k, 2) for k in range(12)]
    choice = lines[11][3]
    panel = Panel("", tuple(d for line in lines for d in line), "", "", asked=1e-2, choice=choice)
    names = panel.choose_lines()
    assert len(names) == 7
    assert {"line 0", "line 11"} <= {*names}
    assert panel.advice == "For errors up to 0.01: line 11, step 3, 96 s."
    assert Panel("", (), "", "", asked=1e-6).advice == "No measured setting has errors up to 1e-6."


@pytest.mark.parametrize(("work", "others"), [(96, "; B is as fast"), (120, "")])
def test_advice_names_the_line_of_the_headline_where_it_is_as_fast(work: float, others: str) -> None:
    """A is the more accurate one at 100 s, B goes on to more digits; beyond a tenth they are not equal."""
    dots = (Dot("A", "a", 100, 1e-8), Dot("B", "b", work, 1e-7), Dot("B", "c", 200, 1e-12), Dot("B", "d", 10, 1e-4))
    panel = Panel("", dots, "", "", asked=1e-6, choice=dots[0])
    slower = "Between 1e-4 and 1e-8, A is the fastest; below 1e-8, B."
    assert panel.headline == ("B is the fastest at every error." if work < 110 else slower)
    assert panel.advice == f"For errors up to 1e-6: A, a, 100 s{others}."


@pytest.mark.parametrize(
    ("error", "text"), [(1e-6, "1e-6"), (0.0, "0"), (0.0412, "0.04"), (2.6e-12, "3e-12"), (9.9e-4, "1e-3"), (1.0, "1")]
)
def test_errors_have_one_digit(error: float, text: str) -> None:
    assert write_error(error) == text


@pytest.mark.parametrize(
    ("work", "unit", "text"),
    [(48.2, "ns", "48 ns"), (999.9, "ns", "1 µs"), (3.7e-3, "s", "3.7 ms"), (83.0, "s", "83 s"), (40, "", "40")],
)
def test_times_have_the_unit_that_fits(work: float, unit: str, text: str) -> None:
    assert write_work(work, unit) == text


@pytest.mark.parametrize(
    ("reduction", "subject"),
    [
        ("q1 locked", "locking q1"),
        ("no velocities", "leaving out velocities"),
        ("tolerance 0.01", "a tolerance of 0.01"),
        ("sensor hand alone", "keeping sensor hand alone"),
        ("lift: sensors", "lift: sensors"),
    ],
)
def test_reductions_are_subjects_of_sentences(reduction: str, subject: str) -> None:
    assert name_reduction(reduction) == subject
