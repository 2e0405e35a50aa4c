"""A predicted half stride by 18 muscles: an optimum for IPOPT, too; periodic, at its speed, by lengths of OpenSim."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from mbsrun import read_problem
from mbsrun.optimal.phases import PhasedControl, SolvedPhases
from tests.shipped import FOLDER

GAIT = FOLDER / "human" / "muscle_gait.ocp.yaml"
SPEED, MASS = 1.2, 61.9999
SIDES = {"r": "right", "l": "left"}
CONTACTS = ("heel", "toe")
STAY = {"mu_init": 1e-6}  # for IPOPT, which leaves the motion it is given by its own barrier of 0.1
# Lengths of muscles over angles of joints, by powers of the first and then of the last: in OpenSim Moco's
# example2DGaitPrediction (gait10dof18musc.osim), polynomials that were fitted to this model of OpenSim.
LENGTHS = {
    "hamstrings": (
        ("hip", "knee"),
        (
            (0.42049524880528, 0.02875525494048, -0.018300167519638, -0.006995443639179),
            (0.053690588126276, 0.002092858497112, 0.001164874424056),
            (0.016799961996946, 0.000188680107368),
            (-0.009576337870147,),
        ),
    ),
    "bifemsh": (("knee",), ((0.244916441634551, 0.021846865400467, -0.020950072312087, -0.006400711591235),)),
    "glut_max": (
        ("hip",),
        ((0.201384070841096, 0.056529803505131, -0.001007247819865, -0.013044763452684, 0.004357279476748),),
    ),
    "iliopsoas": (("hip",), ((0.254156701045543, -0.038230025226882, -0.005210532284289, 0.002534168005785),)),
    "vasti": (("knee",), ((0.184215306369091, -0.04008448860356, -0.00652454222961, 0.000319777796336),)),
    "soleus": (("ankle",), ((0.280659364908914, 0.042682272678384, -0.007031377756060, -0.006261791606827),)),
    "tib_ant": (("ankle",), ((0.290611643802287, -0.043920949896278, -0.0043498646867, 0.003846471985262),)),
}


@pytest.fixture(autouse=True)
def compiler(requires: Callable[[str], str]) -> None:
    requires("cc")


@pytest.fixture(scope="module")
def problem() -> PhasedControl:
    """The problem on 12 intervals, with excitations that are free at each point: constant ones are too coarse there."""
    stated = read_problem(GAIT)
    assert isinstance(stated, PhasedControl), "the motion is periodic"
    return stated.with_phase("motion", intervals=12, inputs="polynomial")


@pytest.fixture(scope="module")
def solved(problem: PhasedControl) -> SolvedPhases:
    found = problem.solve(check=False)
    assert isinstance(found, SolvedPhases), found
    return found


def test_ipopt_finds_nothing_better(problem: PhasedControl, solved: SolvedPhases) -> None:
    """From the motion found, IPOPT ends at the same cost."""
    again = problem.with_solver("ipopt", objective_scaling=1.0, options=STAY).solve(guess=solved, check=False)
    assert isinstance(again, SolvedPhases), again
    assert again.cost == pytest.approx(solved.cost, rel=1e-6)


def test_half_a_stride_by_muscles_keeps_momentum(solved: SolvedPhases) -> None:
    """The mean force of the ground is the weight, to the rule of points; legs exchange their states and muscles."""
    phase = solved["motion"]
    t, x = phase["t"], phase["q_x"]
    assert (x[-1] - x[0]) / (t[-1] - t[0]) == pytest.approx(SPEED, rel=1e-7)
    for joint in ("hip", "knee", "ankle"):
        for kind in ("q", "qd"):
            right, left = (phase[f"{kind}_{side}_{joint}"] for side in SIDES.values())
            assert abs(right[-1] - left[0]) + abs(left[-1] - right[0]) < 1e-6
    for name in (*LENGTHS, "rect_fem", "gastroc"):
        right, left = (phase[f"{name}_{side}"] for side in SIDES)
        assert abs(right[-1] - left[0]) + abs(left[-1] - right[0]) < 1e-6
        assert min(right.min(), left.min()) > 0.0099
    weight = sum(phase[f"fz_{side}_{name}"] for side in SIDES.values() for name in CONTACTS)
    assert float(np.trapezoid(weight, t)) / (t[-1] - t[0]) == pytest.approx(MASS * 9.81, rel=0.1)


def test_half_a_stride_with_elastic_tendons_is_an_optimum_for_ipopt() -> None:
    """Legs exchange the forces of their tendons, too; on 12 intervals."""
    stated = read_problem(GAIT.with_name("tendon_gait.ocp.yaml"))
    assert isinstance(stated, PhasedControl), "the motion is periodic"
    problem = stated.with_phase("motion", intervals=12)
    found = problem.solve(check=False)
    assert isinstance(found, SolvedPhases), found
    for name in LENGTHS:
        right, left = (found["motion"][f"{name}_{side}_tendon"] for side in SIDES)
        assert abs(right[-1] - left[0]) + abs(left[-1] - right[0]) < 1e-6
    again = problem.with_solver("ipopt", objective_scaling=1.0, options=STAY).solve(guess=found, check=False)
    assert isinstance(again, SolvedPhases), again
    assert again.cost == pytest.approx(found.cost, rel=1e-6)


@pytest.mark.parametrize("name", LENGTHS)
def test_lengths_of_muscles_are_opensims(name: str, solved: SolvedPhases) -> None:
    """To the 3 mm that polynomials of low order leave; knees of OpenSim flex by negative angles."""
    joints, coefficients = LENGTHS[name]
    for side, word in SIDES.items():
        angles = [(-1 if joint == "knee" else 1) * solved["motion"][f"q_{word}_{joint}"] for joint in joints]
        first, last = (angles[0], angles[-1]) if len(angles) > 1 else (np.zeros_like(angles[0]), angles[0])
        powers = [np.polynomial.polynomial.polyval(last, np.array(row)) for row in coefficients]
        wanted = sum(first**i * power for i, power in enumerate(powers))
        assert solved["motion"][f"length_{name}_{side}"] == pytest.approx(wanted, abs=3e-3)
