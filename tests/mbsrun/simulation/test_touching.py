"""Rigid contacts from event to event: closed forms of impacts, slip, stick and lift-off, and Painleve's paradox."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad

from mbsgen.errors import InputError
from mbsgen.expressions import parse
from mbsgen.manifest import Stops
from mbsrun import Mechanism, load
from mbsrun.limits import Allowance, Limits
from mbsrun.models import Extent
from mbsrun.simulation import Kind, Motion, Settings, simulate
from mbsrun.simulation.drive import Piece, control, express, hold, hold_steps
from mbsrun.simulation.integration.events import Course
from mbsrun.simulation.integration.touching import TouchingCourse, find_rest
from mbsrun.simulation.motion import Chunk, HaltError
from tests.mbsrun.simulation.conftest import MODELS, load_texts
from tests.mbsrun.simulation.planar import HALF, NEEDED, PLANAR, POINT, ROD, grip
from tests.mbsrun.simulation.pulses import RATE, find_slip, write_pulses

Array = NDArray[np.float64]
Make = Callable[[str], Mechanism]

G = 9.81
TIGHT = {"rtol": 1e-12, "atol": 1e-12}
WIDTH, HEIGHT = 0.1, 0.3  # halves of the block
BLOCK = PLANAR.format(inertia=(WIDTH**2 + HEIGHT**2) / 3) + "".join(
    POINT.format(name, x, -HEIGHT, 0) for name, x in (("left", -WIDTH), ("right", WIDTH))
)
RADIUS = 0.2
DISC = PLANAR.format(inertia=RADIUS**2 / 2) + POINT.format("rim", 0, 0, RADIUS)


@pytest.fixture(scope="session")
def make(tmp_path_factory: pytest.TempPathFactory) -> Make:
    """Return a function that loads a model from its text, each text once."""
    return load_texts(tmp_path_factory, NEEDED)


def tilt(kernels: Mechanism, slope: float) -> Mechanism:
    """Turn gravity, so that x leads down a slope of an angle."""
    return kernels.with_parameters(gx=G * np.sin(slope), gz=-G * np.cos(slope))


def move(kernels: Mechanism, q: list[float], qd: list[float], duration: float) -> Motion:
    settings = Settings(duration, output_step=duration / 8, **TIGHT)
    motion = simulate(kernels, hold([]), q, qd, settings)
    energy = motion.energy
    assert energy is not None
    assert energy.friction is not None
    assert energy.impacts is not None
    assert min(np.diff(energy.friction).min(initial=0), np.diff(energy.impacts).min(initial=0)) >= -1e-14
    assert kernels("touching", q=motion.q)["clearance"].min() >= -1e-13
    return motion


def times(motion: Motion, kind: Kind) -> list[float]:
    return [event.time for event in motion.events if event.kind is kind]


def test_a_ball_bounces_up_to_its_accumulation_point(make: Make) -> None:
    """It hits at t0 (1 + 2 (e + e^2 + ...)), and rests from t0 (1 + e)/(1 - e) on, while it goes on along x."""
    e, t0 = 0.5, np.sqrt(2 / G)
    motion = move(grip(make(DISC), 0, e), [0, 1 + RADIUS, 0], [0.3, 0, 0.2], 1.5)
    assert times(motion, Kind.IMPACT)[:12] == pytest.approx(
        t0 * (1 + 2 * np.cumsum([0, *e ** np.arange(1, 12)])), abs=1e-12
    )
    assert times(motion, Kind.REST) == pytest.approx([t0 * (1 + e) / (1 - e)], abs=1e-12)
    assert motion.q[-1] == pytest.approx([0.45, RADIUS, 0.3], abs=1e-12)


@pytest.mark.parametrize(("first", "rests"), [(2.0, 2.0), (3.0, 2.0 + 1e-13)])
def test_the_earliest_forecast_that_later_ones_repeat_is_the_time_of_rest(first: float, rests: float) -> None:
    """Of forecasts by rebounds of 1 mm/s, 0.1 mm/s and 1 um/s, whose impacts have times to 1e-15 m over the speed."""
    assert find_rest([(first, 1e-3), (2.0 + 1e-13, 1e-4), (2.0 + 9e-10, 1e-6)]) == rests
    assert find_rest([(first, 1e-6)]) == first


def test_an_event_at_once_is_no_step(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    """A step of no length to an event changes neither the motion nor its times, and loses no impact."""
    look, told = TouchingCourse.look, iter([True])

    def look_at_once(self: TouchingCourse, *given: Any) -> tuple[float, Array] | None:
        return (0.0, given[4]) if given[3] > 0.1 and next(told, False) else look(self, *given)

    kernels, start = grip(make(DISC), 0, 0.5), ([0, 1 + RADIUS, 0], [0.3, 0, 0.2], 0.8)
    plain = move(kernels, *start)
    monkeypatch.setattr(TouchingCourse, "look", look_at_once)
    found = move(kernels, *start)
    assert (np.diff(found.t) > 0).all()
    assert found.q == pytest.approx(plain.q, abs=1e-12)
    assert times(found, Kind.IMPACT) == pytest.approx(times(plain, Kind.IMPACT), abs=1e-12)


def test_a_block_on_a_slope_sticks_or_slips_to_rest(make: Make) -> None:
    """It sticks for 10^4 s where tan(slope) < mu; from a speed v it comes to rest after v/(g (mu cos - sin))."""
    slope, mu, v = 0.3, 0.32, 0.1
    block = tilt(grip(make(BLOCK), mu), slope)
    motion = move(block, [0, HEIGHT, 0], [0, 0, 0], 1e4)
    assert motion.events == ()
    assert np.ptp(motion.q, axis=0).max() < 1e-13
    brake = G * (mu * np.cos(slope) - np.sin(slope))
    motion = move(block, [0, HEIGHT, 0], [v, 0, 0], 2.0)
    assert times(motion, Kind.STICK) == pytest.approx([v / brake] * 2, abs=1e-12)
    assert motion.q[-1] == pytest.approx([v**2 / 2 / brake, HEIGHT, 0], abs=1e-12)
    assert motion.contacts is not None
    assert motion.contacts[1][-1].sum() == pytest.approx(G * np.cos(slope), abs=1e-12)
    slipping = move(tilt(grip(make(BLOCK), 0.2), slope), [0, HEIGHT, 0], [0, 0, 0], 1.0)
    assert slipping.q[-1, 0] == pytest.approx(G * (np.sin(slope) - 0.2 * np.cos(slope)) / 2, abs=1e-12)
    assert slipping.energy is not None
    assert np.abs(slipping.energy.drift).max() < 1e-12


def test_a_block_rocks_as_housner_says(make: Make) -> None:
    """Each impact leaves 1 - 3/2 sin(a)^2 of the angular velocity; a quarter swing takes an elliptic integral."""
    block, start, reach = grip(make(BLOCK), 0.8), 0.1, np.hypot(WIDTH, HEIGHT)
    a, p = np.arctan(WIDTH / HEIGHT), np.sqrt(3 * G / 4 / reach)
    x = WIDTH - (WIDTH * np.cos(start) - HEIGHT * np.sin(start))
    z = WIDTH * np.sin(start) + HEIGHT * np.cos(start)
    motion = move(block, [x, z, start], [0, 0, 0], 0.6)
    hits = [event for event in motion.events if event.kind is Kind.IMPACT]

    def slowness(s: float) -> float:  # of the angle start (1 - s^2), times its derivative by s
        angle = start * (1 - s * s)
        return float(2 * start * s / (p * np.sqrt(2 * (np.cos(a - start) - np.cos(a - angle)))))

    assert hits[0].time == pytest.approx(quad(slowness, 0, 1, epsabs=1e-13)[0], abs=1e-10)
    speeds = [2 * WIDTH * p * np.sqrt(2 * (np.cos(a - start) - np.cos(a)))]
    speeds.append(speeds[0] * (1 - 1.5 * np.sin(a) ** 2))
    assert [-event.before for event in hits[:2]] == pytest.approx(speeds, abs=1e-11)
    assert [event.joint for event in hits[:2]] == ["left", "right"]


def test_a_disc_slips_until_it_rolls(make: Make) -> None:
    """Of a speed v it keeps 2/3, after v/(3 mu g); down a slope it rolls at 2/3 g sin, or slips where 3 mu < tan."""
    mu, v, slope = 0.15, 1.2, 0.2
    disc = grip(make(DISC), mu)
    motion = move(disc, [0, RADIUS, 0], [v, 0, 0], 1.0)
    assert times(motion, Kind.STICK) == pytest.approx([v / (3 * mu * G)], abs=1e-12)
    assert motion.qd[-1] == pytest.approx([2 / 3 * v, 0, 2 / 3 * v / RADIUS], abs=1e-12)
    rolling = move(tilt(disc, slope), [0, RADIUS, 0], [0, 0, 0], 1.0)
    assert rolling.qd[-1, 0] == pytest.approx(2 / 3 * G * np.sin(slope), abs=1e-12)
    slipping = move(tilt(grip(disc, 0.05), slope), [0, RADIUS, 0], [0, 0, 0], 1.0)
    assert slipping.qd[-1, 0] == pytest.approx(G * (np.sin(slope) - 0.05 * np.cos(slope)), abs=1e-12)
    assert slipping.qd[-1, 2] == pytest.approx(2 * 0.05 * G * np.cos(slope) / RADIUS, abs=1e-11)


@pytest.mark.parametrize(
    ("spin", "message"), [(0.0, "no motion obeys the laws"), (5.0, "2 motions obey the laws"), (-1.0, "")]
)
def test_painleves_rod_has_no_motion_or_two(spin: float, message: str, make: Make) -> None:
    """The normal force needs 1 + 3 s (s - mu c) > 0 where the rod leans by an angle; else its weight decides."""
    angle, mu, v = 0.6, 2.0, 1.0
    s, c = np.sin(angle), np.cos(angle)
    assert 1 + 3 * s * (s - mu * c) < 0
    assert 1 + 3 * s * (s + mu * c) > 0
    lean = -angle if message else angle
    q = [HALF * np.sin(lean), HALF * np.cos(lean), lean]
    qd = [v + q[1] * spin, -q[0] * spin, spin]
    motion = move(grip(make(ROD), mu), q, qd, 0.02)
    assert (motion.halt is None) == (not message)
    if motion.halt is not None:
        assert message in motion.halt.finding
        assert "Painleve's paradox" in motion.halt.finding
        assert (HALF * spin**2 * c > G) == message.startswith("2")


def test_balls_in_a_row_pass_the_velocity_on(make: Make) -> None:
    """Newton's cradle: equal balls exchange velocities; of three that touch, two take 2/3 of the first one's each."""
    text = "name: cradle\ngravity: [0, 0, 0]\nbodies:\n"
    for name in "abc":
        text += f"  - {{name: {name}, joint: {{type: prismatic, axis: x, actuated: false}}, mass: 1}}\n"
    text += "contacts:\n"
    for one, other in ("ab", "bc"):
        sides = f"body: {one}, radius: 0.1, sphere: {{body: {other}, radius: 0.1}}"
        text += f"  - {{name: {one}{other}, {sides}, restitution: 1}}\n"
    cradle = make(text)
    motion = move(cradle, [0, 1.0, 2.0], [1, 0, 0], 2.0)
    assert motion.qd[-1] == pytest.approx([0, 0, 1], abs=1e-14)
    assert times(motion, Kind.IMPACT) == pytest.approx([0.8, 1.6], abs=1e-13)
    motion = move(cradle, [0.5, 1.0, 1.2], [1, 0, 0], 1.0)
    assert motion.qd[-1] == pytest.approx([-1 / 3, 2 / 3, 2 / 3], abs=1e-13)


def test_balls_that_meet_within_one_long_step_do_not_pass_through_each_other(make: Make) -> None:
    """Nothing bends their motion, so steps are as long as a tolerance lets them; masses 2, 3, 1.5, and e = 0.6."""
    text, e, v = "name: cradle\ngravity: [0, 0, 0]\nbodies:\n", 0.6, 1.3
    for name, mass in zip("abc", (2, 3, 1.5), strict=True):
        text += f"  - {{name: {name}, joint: {{type: prismatic, axis: x, actuated: false}}, mass: {mass}}}\n"
    text += "contacts:\n"
    for one, other in ("ab", "bc"):
        sides = f"body: {one}, radius: 0.1, sphere: {{body: {other}, radius: 0.1}}"
        text += f"  - {{name: {one}{other}, {sides}, restitution: {e}}}\n"
    motion = move(make(text), [0, 0.5, 1.5], [v, 0, 0], 4.0)
    a, b = v * (2 - 3 * e) / 5, v * 2 * (1 + e) / 5
    assert motion.qd[-1] == pytest.approx([a, b * (3 - 1.5 * e) / 4.5, b * 3 * (1 + e) / 4.5], abs=1e-13)
    assert times(motion, Kind.IMPACT) == pytest.approx([0.3 / v, 0.3 / v + 0.8 / b], abs=1e-13)


@pytest.mark.parametrize("miss", [0.0, 0.17, 0.199, 0.2001])
def test_a_ball_that_flies_past_another_hits_it_or_not(miss: float, make: Make) -> None:
    """At a distance of the lines of flight below both radii, it hits where the centres are 0.2 apart."""
    text = "name: pass\ngravity: [0, 0, 0]\nbodies:\n  - name: a\n    joint:\n"
    for axis in "xy":
        text += f"      - {{name: {axis}, type: prismatic, axis: {axis}, actuated: false}}\n"
    text += "    mass: 2\ncontacts:\n  - {name: c, body: a, radius: 0.1, sphere: {radius: 0.1}, restitution: 1}\n"
    motion = move(make(text), [-3.0, miss], [1.1, 0], 9.0)
    if miss > 0.2:
        assert motion.events == ()
        return
    along = np.sqrt(0.04 - miss**2)
    assert times(motion, Kind.IMPACT) == pytest.approx([(3 - along) / 1.1], abs=1e-12)
    n = np.array([-along, miss]) / 0.2
    assert motion.qd[-1] == pytest.approx(np.array([1.1, 0]) - 2 * 1.1 * n[0] * n, abs=1e-11)


def test_wheels_that_slip_in_a_plane_come_to_roll() -> None:
    """A bicycle whose wheels start to slip sideways: the slip of a wheel turns round ever faster before it ends.

    Steps of one length follow the same motion, with an error in proportion to the step.
    """
    bicycle = load(MODELS / "switching" / "bicycle.yaml", extent=NEEDED)
    q, qd = np.zeros(9), np.zeros(9)
    q[2], qd[0], qd[4], qd[6], qd[8] = 0.3, 5, 0.5, 5 / 0.3, 5 / 0.35
    motion = simulate(bicycle, hold([]), q, qd, Settings(4e-3, output_step=4e-4))
    front, rear = (event for event in motion.events if event.kind is Kind.STICK)
    assert (front.joint, rear.joint) == ("front", "rear")
    others = [
        event.time for event in motion.events if event not in (front, rear)
    ]  # friction turns at the rear, and may
    assert all(abs(time - rear.time) < 1e-8 for time in others)  # lift the front for an instant, as rounding decides
    last = {event.joint: event.kind for event in motion.events}
    assert Kind.LEAVE not in last.values()
    slide = bicycle("touching", q=motion.q[-1:])["slide"][0]
    assert np.abs(slide @ motion.qd[-1]).max() < 1e-14
    assert motion.energy is not None
    assert motion.energy.friction is not None
    assert np.abs(motion.energy.drift).max() < 1e-3 * motion.energy.friction[-1]  # by quadrature over the turns
    stepped = [simulate(bicycle, hold([]), q, qd, Settings(4e-3, "moreau", step=h)) for h in (4e-5, 1e-5)]
    errors = [np.abs(one.qd[-1] - motion.qd[-1]).max() for one in stepped]
    assert errors[1] < 0.4 * errors[0] < 4e-3


def test_a_motion_that_switches_again_and_again_at_once_is_ended() -> None:
    """A course whose mode ends as soon as it begins: after 200 switches within 1e-9 s there is a message."""

    class Restless(Course):
        switches, lost, remedy = "nothing", ArithmeticError, ""

        def settle(self, _time: float, _piece: Piece, q: Array, qd: Array) -> tuple[Array, Array]:
            return q, qd

        def run(self, piece: Piece, q: Array, qd: Array, _allowance: Allowance) -> Iterator[Chunk]:
            yield Chunk(np.array([piece.start, piece.start + 1e-10]), np.array([q, q]), np.array([qd, qd]))

    piece = Piece(0.0, 1.0, lambda t: np.zeros((len(t), 0)), True)
    with pytest.raises(HaltError, match="200 switches of nothing, each within 1e-09 s"):
        list(Restless(Settings(1.0)).follow(piece, np.zeros(1), np.zeros(1), Allowance(Limits())))


LEG = """
name: leg
gravity: [0, 0, -9.81]
bodies:
  - name: shank
    joint:
      - {name: x, type: prismatic, axis: x, actuated: false}
      - {name: z, type: prismatic, axis: z, actuated: false}
      - {name: ankle, type: revolute, axis: y, actuated: false}
    mass: 4
    com: [0, 0, 0.2]
    inertia: [0.2, 0.2, 0.01]
  - name: thigh
    parent: shank
    joint: {name: knee, type: revolute, axis: y, position: [0, 0, 0.4]}
    mass: 1
    com: [0, 0, 0.1]
    inertia: [0.02, 0.02, 0.002]
contacts:
  - {name: foot, body: shank, position: [0.02, 0, -0.07], restitution: 0.2, friction: {coefficient: 0.6}}
"""


def test_jumps_of_inputs_are_no_events_of_a_foot_that_stands(make: Make) -> None:
    """The joints move, and the foot's velocity is the rounding of their sum: its mode changes nowhere."""
    leg, torques = make(LEG), np.random.default_rng(5).uniform(-1, 1, (6, 1))
    drive, q = hold_steps(np.linspace(0, 0.12, 7), torques), np.array([0.03, 0.0, 0.1, 0.3])
    q[1] = -leg("touching", q=q)["clearance"].ravel()[0]
    settings = Settings(0.12, "rk4", step=0.01)
    motion = simulate(leg, drive, q, np.zeros(4), settings)
    assert motion.halt is None
    assert motion.events == ()
    assert np.abs(motion.qd[-1]).max() > 0.1
    assert motion.energy is not None
    assert motion.energy.impacts is not None
    assert motion.energy.impacts[-1] == 0
    assert np.abs(motion["gap_foot"]).max() < 1e-15
    assert np.abs(motion.energy.drift).max() < 1e-7


def test_forces_that_vary_while_a_block_stands_are_seen(make: Make) -> None:
    """Rates are 0 while the force rises above friction: seven times in 2 s, each time by the same way."""
    limit = 0.2 * 2 * G
    drive = express([parse(write_pulses(limit))], ["x"], {})
    motion = simulate(make(SLEDGE), drive, [0, 0], [0, 0], Settings(2.0, output_step=0.5))
    begin, end, way = find_slip(limit, 2.0)
    every = np.arange(7) * np.pi / RATE
    assert times(motion, Kind.SLIP) == pytest.approx(every + begin, abs=1e-9)
    assert times(motion, Kind.STICK) == pytest.approx(every + end, abs=1e-8)
    assert motion.q[-1] == pytest.approx([7 * way, 0], rel=1e-6, abs=1e-12)


def test_a_block_that_never_moved_fast_comes_to_rest(make: Make) -> None:
    """Pushed by mu m g + s - t from rest, it slips until 2 s, where it sticks: the way is s^3/3."""
    block, surplus = make(SLEDGE), 2.5e-4
    push = 0.2 * 2 * G + surplus
    motion = simulate(block, express([parse(f"{push!r} - t")], ["u"], {}), [0, 0], [0, 0], Settings(0.1, **TIGHT))
    (event,) = motion.events
    assert event.kind is Kind.STICK
    assert event.time == pytest.approx(2 * surplus, abs=1e-12)
    assert motion.q[-1] == pytest.approx([surplus**3 / 3, 0], abs=1e-15)


SLEDGE = """
name: sledge
gravity: [0, 0, -9.81]
bodies:
  - name: block
    joint:
      - {name: x, type: prismatic, axis: x}
      - {name: z, type: prismatic, axis: z, actuated: false}
    mass: 2
contacts:
  - {name: foot, body: block, restitution: 0, friction: {coefficient: 0.2}}
"""


ROPE = """
name: rope
gravity: [0, 0, -9.81]
bodies:
  - name: load
    joint:
      - {{name: x, type: prismatic, axis: x, actuated: false}}
      - {{name: z, type: prismatic, axis: z, actuated: false}}
    mass: 2
contacts:
  - {{name: rope, body: load, sphere: {{radius: 1, inside: true}}, {law}}}
"""


@pytest.mark.parametrize("restitution", [0.0, 0.3])
def test_a_rope_slackens_on_the_way_up_and_tightens_after_a_parabola(restitution: float, make: Make) -> None:
    """Thrown at v^2 = 3.5 g L from below, a load leaves the circle at 120 degrees, with v^2 = g L/2.

    It is there after an elliptic integral, and a parabola meets the circle again after 4 v sin(120 deg)/g.
    """
    rope, start = make(ROPE.format(law=f"restitution: {restitution}")), ([0, -1], [np.sqrt(3.5 * G), 0])
    leaves = quad(lambda a: 1 / np.sqrt(3.5 * G - 2 * G * (1 - np.cos(a))), 0, 2 * np.pi / 3, epsabs=1e-14)[0]
    speed, flight = np.sqrt(G / 2), 4 * np.sqrt(G / 2) * np.sin(2 * np.pi / 3) / G
    settings = Settings(leaves + flight + 1e-3, output_step=0.02, **TIGHT)
    motion = simulate(rope, hold([]), *start, settings)
    leave, hit = motion.events[:2]
    assert (leave.kind, hit.kind) == (Kind.LEAVE, Kind.IMPACT)
    assert leave.time == pytest.approx(leaves, abs=1e-11)
    assert hit.time == pytest.approx(leaves + flight, abs=1e-11)
    t = np.clip(motion.t - leaves, 0, flight)
    fall = np.array([np.sqrt(3) / 2, 0.5]) + np.outer(t, speed * np.array([-0.5, np.sqrt(3) / 2]))
    fall[:, 1] -= G * t**2 / 2
    is_free = (motion.t > leaves) & (motion.t < hit.time)
    assert motion.q[is_free] == pytest.approx(fall[is_free], abs=1e-11)
    out = fall[-1] / np.linalg.norm(fall[-1])
    velocity = speed * np.array([-0.5, np.sqrt(3) / 2]) - [0, G * flight]
    assert hit.before == pytest.approx(-velocity @ out, abs=1e-10)
    assert hit.after == pytest.approx(restitution * (velocity @ out), abs=1e-10)
    assert motion.energy is not None
    assert motion.energy.impacts is not None
    assert motion.energy.impacts[-1] == pytest.approx((1 - restitution**2) * (velocity @ out) ** 2, abs=1e-9)
    assert np.linalg.norm(motion.q, axis=1).max() < 1 + 1e-12
    assert np.abs(motion.energy.drift).max() < 1e-9


def test_a_rope_stepped_in_time_follows_the_way_from_event_to_event(make: Make) -> None:
    """The error of the end falls with the step, and the rope is never too long by more than a step's way."""
    rope, start = make(ROPE.format(law="restitution: 0.3")), ([0, -1], [np.sqrt(3.5 * G), 0])
    best = simulate(rope, hold([]), *start, Settings(1.5, **TIGHT)).q[-1]
    runs = [simulate(rope, hold([]), *start, Settings(1.5, "moreau", step=h)) for h in (2e-3, 2.5e-4)]
    errors = [np.abs(run.q[-1] - best).max() for run in runs]
    assert errors[1] < 0.4 * errors[0]
    assert errors[1] < 1e-2
    assert np.linalg.norm(runs[1].q, axis=1).max() < 1 + 2.5e-4 * 6


def test_a_rope_that_gives_way_pulls_in_proportion_to_its_stretch(tmp_path: Path) -> None:
    """A compliant side: no force within the sphere, and k (|d| - L) towards its centre beyond."""
    file = tmp_path / "model.yaml"
    file.write_text(ROPE.format(law="stiffness: 1e4, exponent: 1"), encoding="utf-8")
    rope = load(file, extent=Extent(("exp2",), 0))
    q = np.array([[0.3, -0.4], [0.606, -0.808]])
    qdd = rope("exp2", q=q, qd=np.zeros((2, 2)))["qdd"]
    assert qdd == pytest.approx(np.array([[0, -G], [-0.6 * 1e4 * 0.01 / 2, 0.8 * 1e4 * 0.01 / 2 - G]]), abs=1e-9)


def test_a_hollow_sphere_that_is_too_small_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "model.yaml"
    file.write_text(ROPE.format(law="restitution: 0, radius: 1.5"), encoding="utf-8")
    with pytest.raises(InputError, match=r"sphere.radius: found 1, where the contact's own radius is 1.5; give more"):
        load(file)


def test_contacts_beside_stops_are_refused(make: Make) -> None:
    disc = copy.copy(make(DISC))
    stops = Stops(lower=0.0, upper=None, restitution=0.5)
    first = disc.manifest.coordinates[0].model_copy(update={"stops": stops})
    disc.manifest = disc.manifest.model_copy(update={"coordinates": (first, *disc.manifest.coordinates[1:])})
    with pytest.raises(ValueError, match="dop853 takes no rigid contacts beside stops or friction"):
        simulate(disc, hold([]), [0, 1, 0], [0, 0, 0], Settings(1.0))


def test_a_feedback_without_numbers_ends_a_motion(make: Make) -> None:
    law = control(lambda t, *_: [] if t < 0.01 else [np.nan])
    motion = simulate(make(DISC), law, [0, 1, 0], [0, 0, 0], Settings(0.1))
    assert motion.halt is not None
    assert "the control returned" in motion.halt.finding
