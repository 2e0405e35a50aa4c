"""Wrenches between two frames: powers by SciPy's angles, the quarter turn, parameters, files and faults."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import mbsrun
from mbsgen.errors import InputError
from mbsgen.model.changes.releasing import with_runtime_numbers
from mbsgen.model.construction import body, end, make_model, prismatic, revolute, wrench
from mbsgen.model.reader import read_model
from mbsgen.model.writer import write_model
from mbsrun.kernel import KernelError

Array = NDArray[np.float64]
LAW = """\
name: bushing
gravity: [0, 0, 0]
bodies:
  - name: block
    joint:
      - {name: x, type: prismatic, axis: x, actuated: false}
      - {name: y, type: prismatic, axis: y, actuated: false}
      - {name: z, type: prismatic, axis: z, actuated: false}
      - {name: a, type: revolute, axis: x, actuated: false}
      - {name: b, type: revolute, axis: y, actuated: false}
      - {name: c, type: revolute, axis: z, actuated: false}
    mass: 2
    inertia: [0.1, 0.2, 0.3]
wrenches:
  - name: rubber
    body: block
    position: [0.1, -0.2, 0.05]
    orientation: [{axis: y, angle: 0.3}]
    against: {body: base, position: [0.2, 0.1, -0.1], orientation: [{axis: x, angle: -0.4}]}
    about: turns
    force: [-200*shift_x - 3*shift_x_rate, -90*shift_y**3, 4*shift_z_rate*shift_x]
    moment: [-20*turn_x - 2*turn_x_rate, -15*turn_y*turn_z, -12*turn_z - turn_y_rate]
"""
FREE = LAW[: LAW.index("wrenches")]
H = 1e-6  # of differences, whose error is 1e-9


def see(q: Array) -> Array:
    """Return shifts and turns of the block's frame as the base's frame sees it."""
    block = Rotation.from_euler("XYZ", q[3:])
    own, first = block * Rotation.from_euler("y", 0.3), Rotation.from_euler("x", -0.4)
    place = q[:3] + block.apply([0.1, -0.2, 0.05]) - np.array([0.2, 0.1, -0.1])
    return np.concatenate([first.inv().apply(place), (first.inv() * own).as_euler("XYZ")])


def push(seen: Array, rates: Array) -> Array:
    """The law of the file, by numbers."""
    x, y, _, a, b, c = seen
    return np.array(
        [
            -200 * x - 3 * rates[0],
            -90 * y**3,
            4 * rates[2] * x,
            -20 * a - 2 * rates[3],
            -15 * b * c,
            -12 * c - rates[4],
        ]
    )


@pytest.fixture(scope="module")
def kernels(tmp_path_factory: pytest.TempPathFactory) -> mbsrun.Kernels:
    path = tmp_path_factory.mktemp("bushing") / "model.yaml"
    path.write_text(LAW, "utf-8")
    return mbsrun.load(path)


def test_forces_do_the_work_of_their_shifts_and_turns(kernels: mbsrun.Kernels, tmp_path: Path) -> None:
    """Phi(q, qd, 0) without the wrench less Phi with it: the derivatives of shifts and turns times the law."""
    (tmp_path / "free.yaml").write_text(FREE, "utf-8")
    free, rng = mbsrun.load(tmp_path / "free.yaml"), np.random.default_rng(5)
    for _ in range(10):
        q, qd = rng.uniform(-1.2, 1.2, (2, 6))
        rates = (see(q + H * qd) - see(q - H * qd)) / (2 * H)
        slopes = np.array([(see(q + H * e) - see(q - H * e)) / (2 * H) for e in np.eye(6)])
        given = {"q": q, "qd": qd, "qdd": np.zeros(6)}
        felt = np.ravel(free.impl(**given)["Phi"]) - np.ravel(kernels.impl(**given)["Phi"])
        wanted = slopes @ push(see(q), rates)
        assert np.abs(felt - wanted).max() < 1e-7 * np.abs(wanted).max()


def test_a_quarter_turn_in_the_middle_is_a_status(kernels: mbsrun.Kernels) -> None:
    q = np.array([0, 0, 0, -0.4, np.pi / 2 - 0.3, 0.0])  # the other frame is turned by -0.4 about x
    with pytest.raises(KernelError, match=r"wrench rubber, whose middle turn is a quarter"):
        kernels.impl(q=q, qd=np.zeros(6), qdd=np.zeros(6))


def test_it_is_written_and_read_again_and_its_numbers_are_parameters(tmp_path: Path) -> None:
    (tmp_path / "model.yaml").write_text(LAW, "utf-8")
    model = read_model(tmp_path / "model.yaml")
    (tmp_path / "again.yaml").write_text(write_model(model), "utf-8")
    assert read_model(tmp_path / "again.yaml") == model
    names = {x.name for x in with_runtime_numbers(model).parameters}
    assert {"wrenches.rubber.against.position.x", "wrenches.rubber.force.x.1", "wrenches.rubber.position.z"} <= names


def test_it_is_made_in_python() -> None:
    block = body("block", (prismatic("x"), revolute("y")), mass=1, inertia=(0.1, 0.1, 0.1))
    soft = wrench(
        "soft", "block", against=end("base", orientation=[("z", 0.5)]), force=("-10*shift_x", 0, 0), about="turns"
    )
    assert make_model("soft", [block], gravity=(0, 0, 0), wrenches=[soft]).wrenches[0].by_turns


FAULTS = {
    "about": ("    against: {body: base, position: [0.2, 0.1, -0.1], orientation: [{axis: x, angle: -0.4}]}\n", "",
              "it has no meaning without `against`"),
    "body": ("against: {body: base", "against: {body: block", "both ends are on block"),
    "missing": ("against: {body: base", "against: {body: bse", "there is no body bse; did you mean base?"),
    "frame": (
        "    about: turns",
        "    frame: body\n    about: turns",
        "its components are along the axes of `against`",
    ),
    "input": ("moment: [-20*turn_x - 2*turn_x_rate, -15*turn_y*turn_z, -12*turn_z - turn_y_rate]", "moment: input",
              "an input between two frames; give three expressions, which read signals"),
    "name": ("-200*shift_x -", "-200*shift -", "shift"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_have_a_line_and_a_remedy(fault: str, tmp_path: Path) -> None:
    old, new, wanted = FAULTS[fault]
    assert old in LAW
    (tmp_path / "model.yaml").write_text(LAW.replace(old, new), "utf-8")
    with pytest.raises(InputError) as caught:
        read_model(tmp_path / "model.yaml")
    assert wanted in str(caught.value).replace('"', ""), str(caught.value)
    assert "model.yaml:" in str(caught.value)
