"""A joint that friction or a stop holds does not move at all, from the moment at which it is caught."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from mbsgen.expressions import parse
from mbsrun import Mechanism
from mbsrun.models import Extent
from mbsrun.simulation import Kind, Settings, simulate
from mbsrun.simulation.drive import express
from tests.mbsrun.simulation.conftest import load_texts

NEEDED = ("exp2", "impl", "semi", "semi_res", "energy", "power", "frames")
BLOCKS = """
name: blocks
gravity: [0, 0, 0]
bodies:
  - {name: rubbed, joint: {type: prismatic, axis: x, friction: {torque: 2}}, mass: 0.7}
  - {name: stopped, joint: {type: prismatic, axis: y, limits: [null, 0.3], stops: {restitution: 0}}, mass: 1.3}
"""


@pytest.fixture(scope="module")
def blocks(tmp_path_factory: pytest.TempPathFactory) -> Mechanism:
    make: Callable[[str], Mechanism] = load_texts(tmp_path_factory, Extent(NEEDED, 1))
    return make(BLOCKS)


@pytest.mark.parametrize("method", ["dop853", "rk4"])
@pytest.mark.parametrize("speed", [0.31, 0.77, 1.13])
def test_held_joints_stand_still_to_the_last_bit(method: str, speed: float, blocks: Mechanism) -> None:
    """The forces vary, so that events are roots that no step hits; later, they stay below what holds."""
    drive = express([parse("sin(3*t)"), parse("1 + 0.5*cos(2*t)")], ["f", "g"], {})
    motion = simulate(blocks, drive, [0.0, 0.0], [speed, 0.1], Settings(2.0, method, step=0.01))
    for joint, kind in ((0, Kind.STICK), (1, Kind.REST)):
        (event,) = [x for x in motion.events if x.kind is kind and x.joint == blocks.manifest.coordinates[joint].name]
        after = motion.t >= event.time
        assert after.any()
        assert (motion.qd[after, joint] == 0).all()
        assert (motion.q[after, joint] == motion.q[-1, joint]).all()
    assert motion.q[-1, 1] == 0.3
    assert np.abs(motion.qd[motion.t < 0.05]).min() > 0
