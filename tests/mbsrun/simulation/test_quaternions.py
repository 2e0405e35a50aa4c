"""Motions of joints with quaternions: the same as by other coordinates, by all methods that take them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mbsgen.errors import InputError
from mbsgen.model.construction import body, floating, frame, free, make_model, revolute
from mbsgen.model.model import Joint, Model
from mbsgen.model.writer import write_model
from mbsrun import Mechanism
from mbsrun.measuring.mechanisms import draw_states
from mbsrun.measuring.reference import Reference
from mbsrun.models import Extent, find_folder
from mbsrun.simulation import Formulation, Settings, simulate
from mbsrun.simulation.drive import hold
from mbsrun.simulation.statement import read_statement

SIMULATED = ("impl", "semi", "semi_res", "exp2", "energy", "power", "frames", "sensors")
SPEEDS = [0.3, -0.2, 1.0, 1.5, 2.5, -0.7, 0.4]  # of the trunk along and about x, y, z, and of the wing


def bird(trunk: tuple[Joint, ...]) -> Model:
    """A trunk with one wing on a spring, in free fall."""
    wing = revolute("x", position=(0.2, 0.1, 0), stiffness=4.0, rest=0.3, actuated=False)
    return make_model(
        "bird",
        [
            body("trunk", trunk, mass=2.0, com=(0.05, 0.0, 0.1), inertia=(0.2, 0.3, 0.45)),
            body("wing", wing, parent="trunk", mass=0.4, com=(0, 0.3, 0), inertia=(0.05, 0.01, 0.05)),
        ],
        gravity=(0, 0, -9.81),
        frames=[frame("tip", "wing", position=(0, 0.6, 0))],
    )


def write(model: Model, folder: Path) -> Path:
    file = folder / "bird.yaml"
    file.write_text(write_model(model), encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def loose(tmp_path_factory: pytest.TempPathFactory) -> Mechanism:
    extent = Extent((*SIMULATED, "exp1", "rates"), 1)
    return Mechanism(find_folder(write(bird(free()), tmp_path_factory.mktemp("loose")), extent))


@pytest.fixture(scope="module")
def turned(tmp_path_factory: pytest.TempPathFactory) -> Mechanism:
    return Mechanism(find_folder(write(bird(floating()), tmp_path_factory.mktemp("turned")), Extent(SIMULATED, 1)))


def start(kernels: Mechanism) -> tuple[list[float], list[float]]:
    """At the neutral pose, turns about z, y, x are those about the body's axes."""
    if kernels.manifest.configuration:
        return [0, 0, 0, 0, 0, 0, 1, 0], SPEEDS
    x, y, z, a, b, c, wing = SPEEDS
    return [0.0] * 7, [x, y, z, c, b, a, wing]


@pytest.mark.parametrize(
    ("method", "formulation", "error"),
    [
        ("dop853", "exp2", 1e-9),
        ("rk4", "exp1", 1e-9),
        ("rk4", "impl", 1e-9),
        ("radau", "exp2", 1e-8),
    ],
)
def test_the_motion_is_that_of_turns_in_a_row(
    loose: Mechanism, turned: Mechanism, method: str, formulation: str, error: float
) -> None:
    """The wing's tip moves as with slides along x, y, z and turns about z, y, x; energy is kept, and the length 1."""
    drive = hold(np.zeros(0))
    exact = simulate(turned, drive, *start(turned), Settings(0.5, rtol=1e-12, atol=1e-12))
    motion = simulate(loose, drive, *start(loose), Settings(0.5, method, Formulation(formulation), step=5e-4))
    assert motion.is_complete
    tips = [k("sensors", q=m.q[-1])["position"][:, 0] for k, m in ((loose, motion), (turned, exact))]
    np.testing.assert_allclose(tips[0], tips[1], atol=error)
    assert motion.energy is not None
    assert np.abs(motion.energy.drift).max() < 100 * error
    np.testing.assert_allclose(np.linalg.norm(motion.q[:, 3:7], axis=1), 1, atol=error)


def test_a_method_of_momenta_refuses_quaternions(loose: Mechanism) -> None:
    """Velocities that are no rates of coordinates have no momenta conjugate to those."""
    with pytest.raises(ValueError, match="symplectic-euler takes no quaternions"):
        simulate(loose, hold(np.zeros(0)), *start(loose), Settings(0.5, "symplectic-euler"))
    with pytest.raises(InputError, match="method: symplectic-euler takes no quaternions; give gauss"):
        read_statement(None, {"duration": 1, "method": "symplectic-euler"}, loose.manifest)


@pytest.mark.parametrize(
    ("method", "stages", "formulation", "order", "error"),
    [
        ("generalized-alpha", 1, "exp2", 2, 4e-3),
        ("variational", 1, "impl", 2, 1e-2),
        ("radau-iia", 2, "impl", 3, 2e-4),
        ("gauss", 2, "exp2", 4, 7e-7),
        ("gauss", 3, "impl", 6, 6e-11),
    ],
)
def test_implicit_steps_have_their_order(
    loose: Mechanism, method: str, stages: int, formulation: str, order: int, error: float
) -> None:
    """Half the step leaves 2^-order of the error; by an adaptive method the same motion. Gauss keeps the length."""

    def move(settings: Settings) -> tuple[np.ndarray, np.ndarray]:
        motion = simulate(loose, drive, *start(loose), settings)
        assert motion.is_complete
        tip = loose("sensors", q=motion.q[-1])["position"][:, 0]
        return np.concatenate((tip, motion.qd[-1])), np.linalg.norm(motion.q[:, 3:7], axis=1)

    drive = hold(np.zeros(0))
    exact, _ = move(Settings(0.5, rtol=1e-13, atol=1e-13))
    settings = Settings(0.5, method, Formulation(formulation), step=0.025, stages=stages)
    (coarse, _), (fine, lengths) = move(settings), move(replace(settings, step=0.0125))
    errors = [np.abs(x - exact).max() for x in (coarse, fine)]
    assert errors[1] < error
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.1)
    np.testing.assert_allclose(lengths, 1, atol=1e-6 if method == "radau-iia" else 1e-14)


def test_a_start_is_given_by_name(loose: Mechanism) -> None:
    """The neutral quaternion, unless another is given, of any length but 0."""
    manifest = loose.manifest
    assert manifest.positions == ("trunk.x", "trunk.y", "trunk.z", *(f"trunk.q{x}" for x in "xyzw"), "wing")
    given = {"start": {"pose": {"trunk.qx": 3, "trunk.qw": 4}, "velocity": {"trunk.ry": 2}}, "duration": 1}
    statement = read_statement(None, given, manifest)
    np.testing.assert_allclose(statement.start.q, [0, 0, 0, 0.6, 0, 0, 0.8, 0])
    assert statement.start.qd.tolist() == [0, 0, 0, 0, 2, 0, 0]
    assert read_statement(None, {"duration": 1}, manifest).start.q.tolist() == [0, 0, 0, 0, 0, 0, 1, 0]
    for wrong, text in (
        ({"start": {"pose": {"trunk.qw": 0}}}, "the quaternion of trunk is 0; give"),
        ({"start": {"pose": {"trunk.rx": 1}}}, "trunk.rx"),
    ):
        with pytest.raises(InputError, match=text):
            read_statement(None, {"duration": 1, **wrong}, manifest)


def test_what_takes_no_quaternions_says_so(loose: Mechanism) -> None:
    _, qd = start(loose)
    with pytest.raises(ValueError, match="a quaternion of q is 0"):
        simulate(loose, hold(np.zeros(0)), [0.0] * 8, qd, Settings(0.1))


def test_random_states_are_the_reference_s(loose: Mechanism, tmp_path: Path) -> None:
    """Drawn quaternions have length 1; there the kernels' derivatives by their entries are the ones in 50 digits."""
    states = draw_states(loose, 2)
    np.testing.assert_allclose(np.linalg.norm(states["q"][:, 3:7], axis=1), 1, atol=1e-15)
    moment = Reference(write(bird(free()), tmp_path)).at({name: values[1] for name, values in states.items()})
    given = {name: states[name][1] for name in ("q", "qd", "qdd", "u") if states[name].size}
    found = loose("jac_impl", **given)["jac_Phi_q"]
    np.testing.assert_allclose(found, np.array(moment.slopes("q"), dtype=float).T, atol=1e-12)
