"""The community's motions: certificates agree with each other and with the engine, and the page ranks programs."""

from __future__ import annotations

import numpy as np
import pytest
from flint import arb, ctx

from benchmarks.community.ours import list_community
from benchmarks.community.page import write_page
from benchmarks.community.problems import MODELS, TITLES, make_problem, read_certificates
from benchmarks.loops.mechanism import find_massless, write_xml
from benchmarks.loops.motions import Diagram, Point
from benchmarks.loops.problems import PROBLEMS
from tests.motion_references import MOTIONS, collocate, make_pendulum, make_slider_crank, read_vector


def test_every_motion_was_found_twice_with_15_digits() -> None:
    """The file has each motion, and both methods' difference, relative where numbers are larger than 1."""
    certificates = read_certificates()
    assert list(certificates) == list(MOTIONS) == [*TITLES, "bicycle"]
    assert all(float(x["difference"]) < 1e-15 for x in certificates.values())


def test_a_pendulum_moves_as_its_certificate_says() -> None:
    """By a third method and other steps: Gauss's collocation against Jacobi's functions and Gragg's rule."""
    certificate, before = read_certificates()["pendulum"], ctx.prec
    ctx.prec = 100
    try:
        found = collocate(
            make_pendulum(), read_vector(" ".join(certificate["start"])), arb(10), 40, stages=8, solved="1e-20"
        )
        error = max(abs(x - arb(y)).mid() for x, y in zip(found, certificate["end"], strict=True))
    finally:
        ctx.prec = before
    assert error < 1e-10


def test_the_base_frames_equations_are_the_published_ones() -> None:
    """Of the slider-crank at rest: m rdd = -m l2 b'^2 and so on at the outer dead centre, by hand."""
    l1, l2, rate = 0.15, 0.30, 150.0
    rates = [rate, -rate * l1 / l2 - rate, 0.0]
    found = [float(x) for x in make_slider_crank()([arb(x) for x in (0.0, 0.0, l1 + l2, *rates)])]
    np.testing.assert_allclose(found[3:5], 0, atol=1e-9)
    assert found[5] == pytest.approx(-l1 * rate**2 - l2 * (rate * l1 / l2) ** 2, rel=1e-12)


@pytest.mark.parametrize("name", ["slider_crank", "heavy_top"])
def test_we_end_where_the_certificate_says(name: str) -> None:
    """At the finest setting of order 8 but one, to 11 digits."""
    way = next(iter(list_community(make_problem(name))))
    assert way.runs[-2]().error < 1e-11


def test_loops_have_the_ends_of_their_own_references() -> None:
    """The older references of A02 to A04; the governor's certificate, of 1 s, compares with its own."""
    certificates = read_certificates()
    for name, make in PROBLEMS.items():
        if name == "flyball":
            continue
        end = np.array([float(x) for x in certificates[name]["end"]])
        np.testing.assert_allclose(make().end, end, rtol=1e-15, atol=1e-15)


def test_mujoco_gets_joints_at_one_point_in_one_body() -> None:
    tree = make_problem("heavy_top").tree
    assert find_massless(tree) == []
    text = write_xml(tree)
    assert (text.count("<body "), text.count("<joint ")) == (1, 3)


def test_the_page_says_who_is_quickest_and_what_to_mend() -> None:
    """Ours to 9 digits, then a peer alone; at 3 and 6 the shorter time wins."""
    points = (
        Point("mbsgen", "DOP853", 1e-10, 2e-4, 2e-4, 0, 3),
        Point("mbsgen", "RK45", 1e-4, 2e-5, 2e-5, 0, 3),
        Point("Pinocchio", "DOP853", 1e-13, 4e-4, 4e-4, 0, 3),
        Point("MuJoCo", "RK4", 1e-4, 1e-5, 1e-5, 0, 3),
    )
    page = write_page([Diagram("pendulum", "", points, (0.1, 0.2))], "a machine", 3)
    own = "mbsgen, 2 times faster than Pinocchio"
    assert f"| {TITLES['pendulum']} | **MuJoCo**, 2 times faster | {own} | {own} | **Pinocchio** alone |" in page
    assert "3 digits: MuJoCo takes 10 us (RK4); 20 us by RK45." in page
    assert "12 digits: Pinocchio takes 400 us (DOP853); we do not reach them." in page


def test_each_file_is_a_problem() -> None:
    assert {path.stem for path in MODELS.glob("*.yaml")} == set(TITLES) - set(PROBLEMS)
