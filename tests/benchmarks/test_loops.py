"""The benchmark of closed loops: models close, references hold their digits, and the table comes of kept points."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpmath import mp, mpf

from benchmarks.loops import rows_of_bars
from benchmarks.loops.kernels import Row, Timed
from benchmarks.loops.mechanism import Law, find_obstacle, list_kinds, release, write_loops, write_xml
from benchmarks.loops.models import find_model, write_four_bars
from benchmarks.loops.motions import Diagram, Point, Run, Way, measure_problem
from benchmarks.loops.placement import find_angle, place_bodies
from benchmarks.loops.problems import make_andrews, measure_error
from benchmarks.loops.table import Results, make_tables, write_json, write_markdown
from mbsgen.model.tree import ONE, ZERO, Constraint
from mbsgen.pipeline import read_tree
from mbsrun.limits import LimitError
from mbsrun.measuring.store import Store
from tests import loop_references
from tests.loop_references import FOLDER, Andrews, Bricard, Flyball, find_beta, find_phi, find_tilt, swing_twice

# Of the Test Set for IVP Solvers, at 0.03 s; they hold 8 to 9 digits.
PUBLISHED = (
    0.1581077119629904e2,
    -0.1575637105984298e2,
    0.4082224013073101e-1,
    -0.5347301163226948,
    0.5244099658805304,
    0.5347301163226948,
    0.1048080741042263e1,
)


def refer(name: str) -> Any:
    return json.loads((FOLDER / f"{name}.json").read_text("utf-8"))["motion"]


def test_andrews_moves_as_published_and_as_a_coarser_quadrature() -> None:
    """Eight digits of the published reference; 15 with half the digits and nodes."""
    found = [float(x) for x in refer("loops_andrews")["0.03"]["angles"]]
    np.testing.assert_allclose(found, PUBLISHED, rtol=2e-8)
    with mp.workdps(20):
        beta = find_beta(Andrews(), mpf("0.01"), nodes=16)
        expected = refer("loops_andrews")["0.01"]
        model = Andrews()
        for name, values in (("angles", model.angles(beta)), ("rates", model.speeds(beta))):
            assert max(abs(x / mpf(y) - 1) for x, y in zip(values, expected[name], strict=True)) < mpf("1e-13")


def test_a_way_ends_at_a_limit_and_goes_on_after_a_failure() -> None:
    """On a slow machine a run may use up its time; what was measured before it stays."""

    def fail() -> Run:
        raise ArithmeticError

    def exceed() -> Run:
        raise LimitError("60 s are used up", "loosen the tolerance")

    def work() -> Run:
        return Run(1e-3, 1e-6, 5)

    ways = [Way("ours", "dear", (work, fail, work, exceed, work)), Way("ours", "cheap", (work,))]
    found = measure_problem(make_andrews(), ways, 1, lambda _: None)
    assert [x.method for x in found.points] == ["dear", "dear", "cheap"]


def test_bricards_loop_is_closed_and_its_energy_kept() -> None:
    """At all times of the file: the last axis, the end of the last rod, and m phid^2/2 + V, to 20 digits."""
    motion, model = refer("loops_bricard"), Bricard()
    tree = read_tree(find_model("bricard"))
    with mp.workdps(30):
        _, start = model.energies(mpf(0))
        for state in motion.values():
            phi, rate = mpf(state["angles"][0]), mpf(state["rates"][0])
            inertia, potential = model.energies(phi)
            assert abs(inertia * rate**2 / 2 + potential - start) < mpf("1e-22")
            q = [float(x) for x in model.angles(phi)]
            last = place_bodies(tree, q, [0.0] * 5)[5]
            np.testing.assert_allclose(last.origin + last.axes[:, 1], [0, 0, 1], atol=1e-14)
            np.testing.assert_allclose(last.axes[:, 0], [1, 0, 0], atol=1e-14)
        coarse = find_phi(model, mpf(1), panels=4, nodes=20)
        assert abs(coarse[0] - mpf(motion["1"]["angles"][0])) < mpf("1e-13")


@pytest.mark.parametrize("bars", ["2", "40"])
def test_four_bars_move_by_jacobis_functions(bars: str) -> None:
    """The place of B0 in the file of closed forms, and by a coarser quadrature."""
    closed = json.loads((FOLDER / "iftomm_A02_n_four_bar.json").read_text("utf-8"))["B0_x_y_vx_vy"][bars]
    own = refer("loops_four_bars")[bars]
    for time in ("1", "5", "10", "20"):
        found = [*own[time]["place"], *own[time]["velocity"]]
        np.testing.assert_allclose([float(x) for x in found], [float(x) for x in closed[time]], atol=2e-15)
    with mp.workdps(20):
        tilt, _ = find_tilt(int(bars), mpf(5), nodes=16, panels=8)
        assert abs(tilt - mpf(own["5"]["angle"][0])) < mpf("1e-12")


def test_the_governor_and_the_double_pendulum_agree_with_coarser_steps() -> None:
    """Radau IIA of order 9 instead of 15, and order 16 in half as many steps instead of 24."""
    model = Flyball()
    start = np.array([np.longdouble(x) for x in model.START])
    found = loop_references.integrate_stiff(model, start, [(0.01, 30), (0.99, 50)], stages=5)[-1]
    expected = np.array([np.longdouble(x) for x in refer("loops_flyball")["1"]["state"]])
    assert np.abs(found - expected).max() < 3e-11
    with mp.workdps(20):
        y = loop_references.extrapolate(swing_twice, [mp.pi / 2, mp.pi / 2, mpf(0), mpf(0)], mpf(1), 10, columns=8)
        expected = [mpf(x) for x in refer("loops_double_pendulum")["1"]["state"]]
        assert max(abs(a - b) for a, b in zip(y, expected, strict=True)) < mpf("1e-10")


def test_the_file_of_two_four_bars_is_the_written_one() -> None:
    assert find_model("four_bars").read_text("utf-8") == write_four_bars(2)


def test_andrews_starts_at_the_published_angles_and_is_written_for_the_peers() -> None:
    """Its hinges are points that bodies share, for the others of their equations follow in a plane."""
    problem = make_andrews()
    model = Andrews()
    angles = dict(zip(model.ANGLES, model.angles(model.start), strict=True))
    expected = [float(angles[body.joint.name]) for body in problem.tree.bodies]
    np.testing.assert_allclose(problem.q, expected, atol=1e-15)
    assert list_kinds(problem.tree) == ("point", "point", "point")
    lines = write_loops(problem.tree, [Law(0, f=0.033)]).splitlines()
    assert lines[8] == "3"
    assert [line.split()[0] for line in lines[9:12]] == ["point"] * 3
    assert lines[12:14] == ["1", "0 0.033 0.0 0.0 0.0 0.0 1.0"]
    assert write_xml(problem.tree, problem.springs).count("<connect ") == 3
    turned = place_bodies(problem.tree, problem.q.tolist(), [1.0] + [0.0] * 6)
    assert find_angle(turned[0].axes, turned[1].axes, 2) == pytest.approx(problem.q[0], abs=1e-15)
    assert turned[2].omega[2] == pytest.approx(1.0, abs=1e-15)
    np.testing.assert_allclose(turned[2].velocity[:2], [-turned[2].com[1], turned[2].com[0]], atol=1e-15)


def test_a_rod_has_its_length_in_the_file_and_no_place_in_mujoco() -> None:
    tree = release(read_tree(find_model("pendulum_rod")))
    assert (find_obstacle(tree), list_kinds(tree)) == (None, ("rod",))
    line = next(x for x in write_loops(tree).splitlines() if x.startswith("rod "))
    values = {x.symbol: x.value for x in tree.parameters}
    assert float(line.split()[-1]) == float(tree.loops[0].value.subs(values)) > 0
    assert len(line.split()) == 1 + 2 * 13 + 1
    heavy = replace(tree, bodies=tuple(replace(body, mass=ONE) for body in tree.bodies))
    with pytest.raises(ValueError, match="MuJoCo's loops keep points together, not distances"):
        write_xml(heavy)


def test_equations_are_refused_for_the_peers() -> None:
    tree = replace(make_andrews().tree, constraints=(Constraint("gear", ZERO),))
    assert find_obstacle(tree) == "equations of coordinates, driven joints: no peer has them all"
    with pytest.raises(ValueError, match="no peer has them all"):
        write_loops(tree)


def test_an_error_counts_small_and_large_numbers_alike() -> None:
    assert measure_error(np.array([100.0, 0.1]), np.array([101.0, 0.1])) == pytest.approx(1 / 102)
    assert measure_error(np.array([np.nan]), np.array([0.0])) == float("inf")


def test_the_table_comes_of_kept_points(tmp_path: Path) -> None:
    """A peer that disagrees is quickest where no other is there; a soft one never; ratios are of kept times."""
    ours = (Timed("mbsgen", "exp2", 436, 100.0, 110.0, None), Timed("mbsgen", "exp2, libm", 436, 160.0, 170.0, None))
    wrong = Timed("Pinocchio, proximal", "Pinocchio, proximal", None, 4000.0, 5000.0, 7.0)
    right = Timed("Simbody", "Simbody", None, 9000.0, 9900.0, 1e-15)
    soft = Timed("MuJoCo", "MuJoCo", None, 3000.0, 3100.0, 3e-4)
    rows = [
        Row("andrews", 7, 6, "exp", ours, (wrong, right, soft), (), (0.5, 1.0)),
        Row("andrews", 7, 6, "jac_exp", ours, (wrong, soft), ("Simbody: none",), (0.5, 1.0)),
    ]
    points = (Point("mbsgen", "DOP853", 1e-8, 1e-3, 2e-3, 190, 3), Point("Exudyn", "alpha", 1e-6, 0.5, 0.6, 8000, 3))
    diagram = Diagram("andrews", "Andrews, 0.05 s", points, (0.2, 3.0))
    store = Store(tmp_path / "kernels.jsonl", Row)
    store.find_or_measure(("key",), lambda: rows)
    kept = Store(tmp_path / "kernels.jsonl", Row).find_or_measure(("key",), lambda: [])
    results = Results("a machine", "-O3", 20, 3, (), ()).add_rows(kept).add_diagrams([diagram])
    page = write_markdown(results)
    kernels = "436 | 100 · 110 | 160 · 170"
    assert f"exp2 {kernels} | Simbody | 9000 · 9900 | 90.0 · 90.0 | 56.2 · 58.2 |" in page
    assert f"exp2 {kernels} | Pinocchio, proximal, disagrees | 4000 · 5000 | 40.0 · 45.5 | 25.0 · 29.4 |" in page
    assert "| 1e-05 | 1.00 · 2.00 (DOP853) | – | – | 500 · 600 (alpha) | – | 500 · 300 |" in page
    assert "| 1e-09 | – | – | – | – | – | – |" in page
    assert "Load of the machine meanwhile: 0.2 to 3.0." in page
    assert json.loads(write_json(results))["rows"][1]["failures"] == ["Simbody: none"]
    assert [table.row_count for table in make_tables(results)] == [2, 2, 5]


def test_a_row_of_four_bars_passes_its_singular_poses(tmp_path: Path) -> None:
    """In 3 s all rods are level three times, by the equation of one pendulum."""
    out = tmp_path / "page.md"
    rows_of_bars.main(["--bars", "2", "--span", "3", "--out", str(out)])
    angles = [rows_of_bars.find_angle(2, span) for span in np.linspace(0.1, 3, 30)]
    assert (np.diff(np.sign(np.cos(angles))) != 0).sum() == 3
    rows = [line.strip("| ").split(" | ") for line in out.read_text("utf-8").splitlines() if line.startswith("| 2 |")]
    assert [row[2] for row in rows] == ["complete"] * len(rows_of_bars.SETTINGS)
    assert all(float(row[3]) < 1e-3 and float(row[4]) < 1e-13 for row in rows)
