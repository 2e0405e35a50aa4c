"""Sensors and frames against Pinocchio's forward kinematics."""

from __future__ import annotations

import numpy as np
import pytest

from mbsgen.formulations.results import poses
from mbsgen.tape.interpreter import evaluate
from tests.random_trees import Pinocchio, floats, random_tree


@pytest.mark.parametrize("seed", range(4))
def test_poses_equal_pinocchio(seed: int):
    import pinocchio as pin

    tree = random_tree(seed, 7, tidy=seed == 0)
    peer = Pinocchio(tree)
    q = np.random.default_rng(seed).uniform(-3, 3, 7)
    pin.forwardKinematics(peer.model, peer.data, peer._theirs(q))
    places = [peer.data.oMi[k + 1] for k in peer.order]
    tip = tree.sensors[0]
    places.append(places[tip.body - 1] * pin.SE3(floats(tree, tip.orientation), floats(tree, tip.position)))
    found = evaluate(poses.build_frames(tree), {"q": list(q)})
    p = np.array(found["p"], float).reshape(8, 3)
    R = np.array(found["R"], float).reshape(8, 3, 3).transpose(0, 2, 1)
    for k, place in enumerate(places):
        assert np.abs(p[k] - place.translation).max() < 1e-13
        assert np.abs(R[k] - place.rotation).max() < 1e-13
    sensed = evaluate(poses.build_sensors(tree), {"q": list(q)})["position"]
    assert np.abs(np.array(sensed, float) - places[-1].translation).max() < 1e-13
