"""Dry friction by the load of joints: closed forms, an independent integration, its law in drawn trees, refusals."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp

from mbsgen.errors import InputError
from mbsrun import Mechanism, load
from mbsrun.models import Extent
from mbsrun.simulation import Kind, Mode, Motion, Settings, differentiate, simulate
from mbsrun.simulation.drive import hold
from mbsrun.simulation.dynamics import Dynamics
from mbsrun.simulation.formulation import Formulation
from mbsrun.simulation.integration.bearings import Bearings, LoadError, _contract, _find_roots
from mbsrun.smoothness import demand_smooth
from tests.mbsrun.simulation.conftest import MODELS, load_texts

Array = NDArray[np.float64]
Make = Callable[[str], Mechanism]

G = 9.81
NEEDED = Extent(("exp2", "impl", "semi", "semi_res", "energy", "power", "frames"), 1)
TIGHT = {"rtol": 1e-12, "atol": 1e-12}
BLOCK = """
name: rail
gravity: [0, 0, 0]
wrenches: [{{name: push, body: block, position: [0, 0, {offset}], force: input}}]
bodies:
  - name: block
    joint: {{type: prismatic, axis: x, actuated: false, friction: {{torque: 0, load: {{{load}}}}}}}
    mass: 3
    inertia: [0.1, 0.1, 0.1]
"""
PENDULUM = """
name: pendulum
gravity: [0, 0, -9.81]
bodies:
  - name: swing
    joint:
      {type: revolute, axis: y, actuated: false,
       friction: {torque: 0, load: {coefficient: 0.4, static: 0.5, radius: 0.06}}}
    mass: 2
    com: [0, 0, -0.5]
    inertia: [0.1, 0.1, 0.01]
"""
PAINLEVE = """
name: painleve
gravity: [0, 0, -9.81]
bodies:
  - name: slide
    joint: {type: prismatic, axis: x, actuated: false, friction: {torque: 0, load: {coefficient: 1.3}}}
    mass: 0.1
  - name: rod
    parent: slide
    joint: {type: revolute, axis: y, actuated: false}
    mass: 1
    com: [0, 0, -1]
    inertia: [0.01, 0.01, 0.01]
"""


@pytest.fixture(scope="session")
def make(tmp_path_factory: pytest.TempPathFactory) -> Make:
    """Return a function that loads a model from its text, each text once."""
    return load_texts(tmp_path_factory, NEEDED)


def run(
    model: Mechanism, q: ArrayLike, qd: ArrayLike, end: float, w: Sequence[float] = (), **settings: float
) -> Motion:
    given = {**TIGHT, "output_step": end / 20, **settings}
    return simulate(model, hold(w), q, qd, Settings(end, **given))  # type: ignore[arg-type]


@pytest.mark.parametrize("size", [1e-3, 1e6])
def test_a_slider_under_an_oblique_force_locks_itself_at_the_angle_of_friction(make: Make, size: float) -> None:
    """Whatever its size, a force at the angle b to the rail moves the slider if b < atan(1/mu_s)."""
    model, locking = make(BLOCK.format(offset=0, load="coefficient: 0.4, static: 0.5")), np.arctan(1 / 0.5)
    for angle in (locking - 1e-6, locking + 1e-6):
        force = size * np.array([np.cos(angle), 0, -np.sin(angle)])
        motion = run(model, [0.0], [0.0], 1.0, force.tolist())
        way = 0.0 if angle > locking else (force[0] + 0.4 * force[2]) / 3 / 2
        np.testing.assert_allclose(motion.q[-1], way, rtol=1e-12)
        assert motion.modes is not None
        assert motion.modes[-1, 0] == (Mode.STICKS if angle > locking else Mode.FORWARD)


def test_a_guide_wedges_where_the_push_is_far_from_its_axis(make: Make) -> None:
    """A push F at a distance e loads two bearings at a distance L by F e/L each: it wedges if 2 mu e >= L."""
    for offset in (0.499, 0.501):
        model = make(BLOCK.format(offset=offset, load="coefficient: 0.4, static: 0.5, length: 0.5"))
        way = run(model, [0.0], [0.0], 1.0, [7.0, 0, 0]).q[-1]
        np.testing.assert_allclose(way, 0.0 if offset > 0.5 else 7 * (1 - 2 * 0.4 * offset / 0.5) / 3 / 2, rtol=1e-12)


def swing_by_hand(angle: float) -> list[tuple[float, float]]:
    """Return the turning points of PENDULUM from rest, by SciPy, until it sticks: the reaction solves a quadratic."""
    m, length, inertia, mu, static, r = 2.0, 0.5, 0.6, 0.4, 0.5, 0.06

    def accelerate(q: float, w: float, way: float) -> float:
        free, slope = -m * G * length * np.sin(q) / inertia, -way * mu * r / inertia
        radial, c, d = m * (length * w**2 + G * np.cos(q)), m * (length * free + G * np.sin(q)), m * length * slope
        a, b = 1 - d * d, c * d
        return float(free + slope * (b + np.sqrt(b * b + a * (radial**2 + c * c))) / a)

    found, time = list[tuple[float, float]](), 0.0
    while abs(m * G * length * np.sin(angle)) > static * r * m * G:
        way = -float(np.sign(angle))

        def rests(t: float, y: Array, way: float = way, begin: float = time) -> float:
            return float(y[1] * way) if t > begin + 1e-6 else 1.0

        rests.terminal, rests.direction = True, -1  # type: ignore[attr-defined]

        def move(_: float, y: Array, way: float = way) -> list[float]:
            return [y[1], accelerate(y[0], y[1], way)]

        start, span = [angle, 0.0], (time, time + 10)
        path = solve_ivp(move, span, start, "DOP853", events=rests, rtol=1e-13, atol=1e-14)
        time, angle = float(path.t_events[0][0]), float(path.y_events[0][0][0])
        found.append((time, angle))
    return found


def test_a_pendulum_in_a_journal_bearing_swings_as_by_hand_and_does_not_creep(make: Make) -> None:
    """The friction is mu r |F|, with the force F of the pin; at rest |F| = m g, so it sticks if sin q <= mu_s r/l."""
    motion, turns = run(make(PENDULUM), [1.2], [0.0], 1e4, output_step=10.0), swing_by_hand(1.2)
    assert [event.kind for event in motion.events] == [*[Kind.REVERSE] * (len(turns) - 1), Kind.STICK]
    np.testing.assert_allclose([event.time for event in motion.events], [t for t, _ in turns], atol=2e-11)
    np.testing.assert_allclose(motion.q[motion.t > 20], turns[-1][1], atol=4e-12)
    assert np.ptp(motion.q[motion.t > 20]) == 0


def test_a_pendulum_at_rest_holds_up_to_its_static_friction(make: Make) -> None:
    most = np.arcsin(0.5 * 0.06 / 0.5)
    for angle, kinds in ((most * (1 - 1e-9), []), (-most * (1 + 1e-8), [Kind.STICK])):
        motion = run(make(PENDULUM), [angle], [0.0], 2.0)
        assert [event.kind for event in motion.events] == kinds
        assert (motion.q[-1, 0] == angle) == (not kinds)


def draw_tree(seed: int) -> str:
    """Draw a tree of joints with friction by their load, of one bearing or of two, and by constants."""
    rng = np.random.default_rng(seed)
    text = "name: drawn\ngravity: [0.5, 0, -9.81]\nbodies:\n"
    for i in range(3):
        kind = rng.choice(["revolute", "prismatic"])
        options = f"type: {kind}, axis: {rng.normal(size=3).round(4).tolist()}, actuated: false, stiffness: 5"
        options += f", position: {(0.3 * rng.normal(size=3)).round(3).tolist()}"
        mu = rng.uniform(0.02, 0.2)
        numbers = f"coefficient: {mu:.4f}, static: {mu * rng.uniform(1, 1.3):.4f}"
        numbers += ", radius: 0.05" if kind == "revolute" else ""
        numbers += f", length: {rng.uniform(0.3, 1):.3f}" if rng.random() < 0.5 else ""
        stribeck = f", stribeck: {rng.uniform(0.05, 0.3):.3f}" if rng.random() < 0.5 else ""
        options += f", friction: {{torque: {rng.uniform(0, 0.1):.4f}, load: {{{numbers}}}{stribeck}}}"
        parent = f"b{rng.integers(max(0, i - 2), i)}" if i else "base"
        text += f"  - name: b{i}\n    parent: {parent}\n    joint: {{{options}}}\n    mass: {rng.uniform(0.5, 2):.3f}\n"
        text += f"    com: {(0.2 * rng.normal(size=3)).round(3).tolist()}\n    inertia: [0.03, 0.04, 0.05]\n"
    return text


def find_loads(model: Mechanism, motion: Motion) -> Array:
    """Return the sums of the bearings' forces across the axes, (K, n), from the reactions of the motion."""
    manifest = model.manifest
    assert manifest.appearance is not None
    found, turns = model("reactions", q=motion.q, qd=motion.qd, qdd=motion.qdd), model("frames", q=motion.q)["R"]
    loads = []
    for k, (axle, joint) in enumerate(zip(manifest.appearance.axles, manifest.coordinates, strict=True)):
        assert joint.friction is not None
        assert joint.friction.load is not None
        a = turns[:, :, 3 * k : 3 * k + 3] @ axle.axis
        F, T, length = found["force"][:, :, k], found["moment"][:, :, k], joint.friction.load.length
        F = F - (F * a).sum(axis=1)[:, None] * a
        pair = [F] if length is None else [F / 2 + side * np.cross(a, T) / length for side in (1, -1)]
        loads.append(sum(np.linalg.norm(x, axis=1) for x in pair))
    return np.stack(loads, axis=1)


@pytest.mark.parametrize("seed", range(3))
def test_friction_in_a_drawn_tree_is_the_law_of_the_reactions_that_it_causes(make: Make, seed: int) -> None:
    """Sliding joints have -sign(qd) T(qd, N), resting ones at most T_s(N) and qdd = 0; energy never grows."""
    model, rng = make(draw_tree(seed)), np.random.default_rng(seed)
    motion = run(model, rng.normal(size=3), rng.normal(size=3), 0.6, rtol=1e-10, atol=1e-10, output_step=0.01)
    assert motion.halt is None
    assert motion.modes is not None
    assert motion.energy is not None
    loads = find_loads(model, motion)
    forces = model("impl", q=motion.q, qd=motion.qd, qdd=motion.qdd)["Phi"]
    for i, joint in enumerate(motion.modes.T):
        friction = model.manifest.coordinates[i].friction
        assert friction is not None
        assert friction.load is not None
        N, speed = friction.load.arm * loads[:, i], motion.qd[:, i]
        low, most = friction.torque + friction.load.coefficient * N, friction.static + friction.load.static * N
        sliding, sticks = np.abs(joint) == 1, joint == Mode.STICKS
        fall = 0.0 if friction.stribeck is None else np.exp(-((speed / friction.stribeck) ** 2))
        law = -joint * (low + (most - low) * fall)
        scale = np.abs(forces).max() + N.max()
        np.testing.assert_allclose(forces[sliding, i], law[sliding], atol=1e-12 * scale)
        assert (np.abs(forces[sticks, i]) <= most[sticks] + 1e-9 * scale).all()
        assert not motion.qdd[sticks, i].any()
        assert not speed[sticks].any()
        assert (joint * speed >= 0)[sliding].all()
    assert motion.energy.friction is not None
    assert (np.diff(motion.energy.friction) >= 0).all()
    assert np.abs(motion.energy.drift).max() <= 1e-7 * motion.energy.exchanged


def test_paradoxes_end_in_words(make: Make) -> None:
    """One way the load has two solutions, the other way none: D = mu m^2 l^2 sin q cos q/det M is beyond -1 or 1."""
    model = make(PAINLEVE)
    for angle, speed, told in (
        (0.785, 1.0, "2 motions obey the friction by the load of joints slide: Painleve's paradox"),
        (0.785, -1.0, "no motion obeys the friction by the load of joints slide: Painleve's paradox"),
    ):
        halt = run(model, [0.0, angle], [speed, 0.0], 1.0).halt
        assert halt is not None
        assert (halt.time, told in halt.finding) == (0.0, True), halt


def test_a_motion_that_meets_a_paradox_keeps_the_steps_before_it(make: Make) -> None:
    motion = run(make(PAINLEVE), [0.0, 1.3], [3.0, 0.0], 1.0)
    assert motion.halt is not None
    assert "by the load of joints slide is not known to rounding" in motion.halt.finding
    assert motion.halt.time > 0.01
    assert motion.t[-1] == motion.halt.time
    m, s, c = 1.0, np.sin(motion.q[-1, 1]), np.cos(motion.q[-1, 1])
    det = 1.1 * 1.01 - c**2
    np.testing.assert_allclose(abs(1.3 * m**2 * s * c / det), 1.0, rtol=1e-6)  # where the load starts to be ambiguous


def test_a_paradox_on_the_way_names_all_joints_that_slide(make: Make) -> None:
    friction = "friction: {torque: 0, load: {coefficient: 0.1, radius: 0.05}}"
    model = make(PAINLEVE.replace("axis: y, actuated: false", f"axis: y, actuated: false, {friction}"))
    halt = run(model, [0.0, 1.3], [3.0, 0.1], 1.0).halt
    assert halt is not None
    assert halt.time > 0.1
    assert "by the load of joints slide, rod is not known" in halt.finding


def test_all_roots_of_one_load_are_found() -> None:
    """N = |c + D N|: of numbers, c/(1 - D) and -c/(1 + D) if they are not negative."""
    along = np.array([[0.0, 1.0, 0.0]])
    for c, D, roots in ((-3.0, 1.5, [6.0, 1.2]), (3.0, 1.5, []), (3.0, -2.0, [1.0, 3.0]), (0.0, 1.5, [0.0])):
        np.testing.assert_allclose(sorted(_find_roots(c * along, D * along)), sorted(roots), rtol=1e-12)
    with pytest.raises(LoadError, match="not known"):
        _find_roots(along, -along)


@pytest.mark.parametrize("radius", [0.3, 0.99, 1 - 1e-7])
def test_contracting_loads_are_found_to_rounding(radius: float) -> None:
    """Of c = (1 - S) N with all forces along one axis the loads are N."""
    rng = np.random.default_rng(1)
    S = rng.uniform(0, 1, (4, 3, 3))
    S *= radius / np.abs(np.linalg.eigvals(S)).max(axis=1)[:, None, None]
    N, axis = rng.uniform(1, 2, (4, 3)), np.array([0.6, 0.0, 0.8])
    c, D = (N - (S @ N[..., None])[..., 0])[..., None] * axis, S[:, :, None] * axis[:, None]
    known = (c @ axis >= 0).all(axis=1)  # else the sizes of forces are others
    found = _contract(np.eye(3), S, c, D)
    forces = np.linalg.norm(c + (D @ found[:, None, :, None])[..., 0], axis=2)
    np.testing.assert_allclose(found, forces, rtol=1e-13 / (1 - radius) * 10)
    np.testing.assert_allclose(found[known], N[known], rtol=1e-13 / (1 - radius) * 10)


def test_several_loads_that_depend_on_each_other_too_much_are_not_guessed(make: Make) -> None:
    friction = "friction: {torque: 0, load: {coefficient: 0.1, radius: 0.05}}"
    model = make(PAINLEVE.replace("axis: y, actuated: false", f"axis: y, actuated: false, {friction}"))
    halt = run(model, [0.0, 0.785], [1.0, 0.1], 1.0).halt
    assert halt is not None
    assert "is not known" in halt.finding


def test_two_bearings_share_the_force_and_carry_the_moment(make: Make) -> None:
    model = make(BLOCK.format(offset=0.2, load="coefficient: 0.4, length: 0.5"))
    bearings = Bearings.of(Dynamics(model, Formulation.SEMI))
    state = bearings.place(np.zeros((1, 1)), np.zeros((1, 1)), np.array([[10.0, 3.0, -4.0]]))
    # the reaction is opposite: force (0, -3, 4); moment of the push about the origin (-0.6, 2, 0), of which y loads
    np.testing.assert_allclose(np.linalg.norm(state.r[0].sum(axis=0)), 5.0, rtol=1e-14)
    expected = sorted(np.hypot(1.5, 2 + side * 2 / 0.5) for side in (1, -1))
    np.testing.assert_allclose(sorted(np.linalg.norm(state.r[0], axis=1)), expected, rtol=1e-14)


def test_uses_that_do_not_have_it_refuse_it(make: Make) -> None:
    model = make(PENDULUM)
    with pytest.raises(ValueError, match="moreau takes no friction by the load of joints: swing"):
        run(model, [0.1], [0.0], 1.0, method="moreau")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="radau takes no rigid stops or dry friction"):
        run(model, [0.1], [0.0], 1.0, method="radau")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="friction by the load of joints swing is not differentiated"):
        differentiate(model, hold([]), [0.1], [0.0], Settings(1.0))
    with pytest.raises(InputError, match="give a torque in place of load"):
        demand_smooth(model.manifest, "a linearisation", stops=False)


def test_methods_agree_and_keep_their_order(make: Make) -> None:
    model, exact = make(PENDULUM), run(make(PENDULUM), [1.2], [0.0], 2.0).q[-1]
    ends = [run(model, [1.2], [0.0], 2.0, method="rk4", step=h).q[-1] for h in (0.02, 0.01)]  # type: ignore[arg-type]
    errors = [float(np.abs(end - exact).max()) for end in ends]
    assert 3.5 < np.log2(errors[0] / errors[1]) < 4.7, errors


def test_the_bell_comes_to_rest() -> None:
    motion = run(load(MODELS / "switching" / "bell.yaml", extent=NEEDED), [0.1], [0.0], 20.0, rtol=1e-9, atol=1e-9)
    assert motion.events[-1].kind is Kind.STICK
    assert abs(motion.q[-1, 0]) <= np.arcsin(0.16 * 0.04 / 0.5)
