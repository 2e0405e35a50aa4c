"""The inertia that regrouping may move in EXP2: at most as much as digits allow."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sympy import Integer

from mbsgen.formulations.parsimony.plan import Choice, Mass, Plan
from mbsgen.formulations.parsimony.proportions import Proportions
from mbsgen.formulations.parsimony.regrouping import restrain
from mbsgen.formulations.parsimony.segments import Moments
from mbsgen.formulations.planning import PlanTrials, find_plans
from mbsgen.formulations.reductions import Reductions
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.reader import read_model
from tests.mbsgen.failures.mechanisms import draw_state, elbow, error_of, spatial_chain, straight_chain

REDUCED = Reductions(trials=1)
MODELS = Path(__file__).parents[3] / "models"


def masses(tree) -> list[Mass]:
    return [choice.mass for choice in find_plans(tree, REDUCED).articulated.choices]


def growths(tree) -> dict[int, float]:
    """Measure what all mass that may move to the base does on its way."""
    bench, found = PlanTrials(tree, REDUCED), {}
    proportions = Proportions(bench.segments)

    def note(number: int, moved: Moments) -> bool:
        found[number] = proportions.growth(number, moved)
        return True

    restrain(bench.chain.builder, bench.segments, Plan((Choice(),) * len(bench.segments)), note)
    return found


def test_mass_at_the_end_of_a_rod():
    """Across, the free end of a thin rod of mass m resists like m / 4; so k rods moved there count 4 k times."""
    assert growths(straight_chain(4)) == pytest.approx({4: 4.0, 3: 8.0, 2: 12.0}, rel=1e-2)


def test_mass_on_a_body_without_inertia():
    """The articulated inertia of a point mass is along its link; moved to the elbow, it would count across too."""
    assert growths(elbow())[2] == float("inf")
    assert masses(elbow()) == [Mass.PASSED, Mass.KEPT]


def test_long_chains_keep_theirs():
    """The tip passes its mass on; from where it would be too much, all bodies nearer to the base keep theirs."""
    first, *rest = masses(straight_chain(20))
    assert first is Mass.PASSED  # on the base, which feels nothing
    kept = rest.count(Mass.KEPT)
    assert 10 <= kept <= 18
    assert rest == [Mass.KEPT] * kept + [Mass.PASSED] * (len(rest) - kept)


@pytest.mark.parametrize("model", ["arm_pendulum", "double_pendulum", "planar_arm", "six_axis", "quadruped"])
def test_ordinary_machines_regroup_all(model: str):
    assert Mass.KEPT not in masses(build_tree(read_model(MODELS / f"{model}.yaml")))


def test_heavy_tips_cost_no_more_digits_than_they_must():
    """In the median of states at most three times what is lost with nothing regrouped; at one state chance decides."""
    tree = spatial_chain(10, [1] * 9 + [Integer(10**8)])
    states = [draw_state(10, seed) for seed in range(9)]
    found = [error_of("exp2", tree, state) for state in states]
    plain = [error_of("exp2", tree, state, Reductions(trials=1, regroup=False)) for state in states]
    assert np.median(found) <= 3 * np.median(plain)
