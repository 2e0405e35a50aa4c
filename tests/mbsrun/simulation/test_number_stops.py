"""Stops at limits of numbers of the pose, in motions: closed forms of ropes, gears and billiards, and laws."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsrun import Mechanism, load
from mbsrun.models import Extent
from mbsrun.simulation import Kind, Motion, Settings, simulate
from mbsrun.simulation.drive import hold
from mbsrun.simulation.integration.methods import find_refusals
from mbsrun.simulation.simulate import InsideError

Array = NDArray[np.float64]
Make = Callable[[str], Mechanism]

G = 9.81
PLAIN = ("exp2", "impl", "semi", "semi_res", "energy", "power", "frames")
TIGHT = {"rtol": 1e-12, "atol": 1e-12}
PAIR = """
name: pair
gravity: [0, 0, {}]
bodies:
  - {{name: a, joint: {{type: prismatic, axis: z, actuated: false}}, mass: 2}}
  - {{name: b, joint: {{type: prismatic, axis: z, actuated: false}}, mass: 3}}
stops:
"""
ATWOOD = PAIR.format(-G) + "  - {name: rope, quantity: q_a + q_b, limits: [0, null], restitution: 0.5}\n"
BALL = """
name: ball
gravity: [0, 0, 0]
bodies:
  - name: ball
    joint: [{name: x, type: prismatic, axis: x, actuated: false}, {name: y, type: prismatic, axis: y, actuated: false}]
    mass: 1.5
frames: [{name: c, body: ball, sensor: false}]
"""


@pytest.fixture(scope="module")
def make(tmp_path_factory: pytest.TempPathFactory) -> Make:
    def build(text: str) -> Mechanism:
        file: Path = tmp_path_factory.mktemp("model") / "model.yaml"
        file.write_text(text, encoding="utf-8")
        rigid = ("touching", "distances") if "restitution" in text else ()
        return load(file, extent=Extent((*PLAIN, *rigid), 1))

    return build


def times(motion: Motion, kind: Kind) -> list[float]:
    return [event.time for event in motion.events if event.kind is kind]


def test_a_rope_over_a_pulley_slackens_and_jerks(make: Make) -> None:
    """Slack, both masses fall freely: the rope is tight after v/g, and bounces like a ball in 2 g; then it pulls."""
    e, v = 0.5, 4.0
    motion = simulate(make(ATWOOD), hold([]), [0, 0], [v, 0], Settings(2.0, **TIGHT))
    hits = times(motion, Kind.IMPACT)
    t0 = v / G
    assert hits[:8] == pytest.approx(t0 * np.cumsum([1, *e ** np.arange(1, 8)]), abs=1e-12)
    assert times(motion, Kind.REST) == pytest.approx([t0 / (1 - e)], abs=1e-9)
    assert motion.events[0].after == pytest.approx(e * v, rel=1e-12)
    assert motion["normal_rope_lower"][-1] == pytest.approx(2 * 2 * 3 * G / 5, rel=1e-12)
    assert motion.energy is not None
    assert motion.energy.impacts is not None
    assert np.abs(motion.energy.drift).max() < 1e-11
    assert motion.energy.impacts[-1] == pytest.approx(0.5 * 6 / 5 * v**2, rel=1e-10)
    assert motion.unit("gap_rope_lower") == ""
    assert not any(name.startswith("fx") for name in motion.results)


def test_a_number_bounces_to_rest_on_another_that_holds(make: Make) -> None:
    """Only while a rests does q_b - 2 q_a fall, as a ball in g: without a's stop it would rise."""
    stops = """  - {name: floor, quantity: q_a, limits: [0, null], restitution: 0}
  - {name: lid, quantity: q_b - 2*q_a, limits: [0, null], restitution: 0.5}
"""
    motion = simulate(make(PAIR.format(-G) + stops), hold([]), [0, 1], [0, 0], Settings(2.0, **TIGHT))
    assert motion.halt is None
    t0 = np.sqrt(2 / G)
    hits = [x.time for x in motion.events if x.joint == "lid.lower" and x.kind is Kind.IMPACT]
    assert hits[:5] == pytest.approx(t0 * (1 + 2 * np.cumsum([0, *0.5 ** np.arange(1, 5)])), abs=1e-12)
    (rest,) = (x.time for x in motion.events if x.joint == "lid.lower" and x.kind is Kind.REST)
    assert rest == pytest.approx(3 * t0, abs=1e-8)
    assert motion["normal_floor_lower"][-1] == pytest.approx((2 + 2 * 3) * G, rel=1e-12)


FLYWHEELS = """
name: flywheels
gravity: [0, 0, 0]
bodies:
  - {name: a, joint: {type: revolute, axis: z, actuated: false}, mass: 1, inertia: [0.3, 0.3, 0.3]}
  - {name: b, joint: {type: revolute, axis: z, actuated: false, force: 8*t}, mass: 1, inertia: [0.5, 0.5, 0.5]}
stops:
  - {name: dog, quantity: q_b - q_a, limits: [0, null], restitution: 0, hold: 2}
"""


def test_two_flywheels_engage_and_part_under_a_load(make: Make) -> None:
    """The impact keeps the angular momentum; the latch bears 0.3/0.8 of the torque 8 t, which is 2 at t = 2/3."""
    wheels = make(FLYWHEELS)
    motion = simulate(wheels, hold([]), [0, 1], [4, 1], Settings(1.0, **TIGHT))
    engaged = min(x.real for x in np.roots([8 / 3, 0, -3, 1]) if x.real > 0)  # of the difference 1 - 3 t + 8 t^3/3
    names = [(x.joint, x.kind) for x in motion.events]
    assert names == [("dog.lower", kind) for kind in (Kind.IMPACT, Kind.REST, Kind.LEAVE)]
    assert [x.time for x in motion.events] == pytest.approx([engaged, engaged, 2 / 3], abs=1e-12)
    common = (1.7 + 4 * (2 / 3) ** 2) / 0.8
    assert motion.qd[-1] == pytest.approx([common, common + 8 * (1 - 4 / 9)], rel=1e-12)
    slip = 4 - (1 + 8 * engaged**2)
    assert motion.energy is not None
    assert motion.energy.impacts is not None
    assert motion.energy.impacts[-1] == pytest.approx(0.5 * 0.15 / 0.8 * slip**2, rel=1e-12)
    assert np.abs(motion.energy.drift).max() < 1e-11
    together = (motion.t > engaged + 1e-3) & (motion.t < 2 / 3)
    assert motion["normal_dog_lower"][together] == pytest.approx(-3 * motion.t[together], rel=1e-12)
    assert np.abs(motion["gap_dog_lower"][together]).max() < 1e-14


def test_a_latch_that_bears_too_little_does_not_engage(make: Make) -> None:
    """At the impact the torque already pulls with 0.3/0.8 8 t > 0.5; the wheels part at once, at one speed."""
    wheels = make(FLYWHEELS.replace("hold: 2", "hold: 0.5"))
    motion = simulate(wheels, hold([]), [0, 1], [4, 1], Settings(0.5, **TIGHT))
    assert [x.kind for x in motion.events] == [Kind.IMPACT]
    assert motion["normal_dog_lower"].max() == motion["normal_dog_lower"].min() == 0
    assert motion["gap_dog_lower"][-1] > 0


def test_time_stepping_refuses_latches(make: Make) -> None:
    refusals = [*find_refusals(Settings(1.0, "moreau"), make(FLYWHEELS).manifest)]
    assert [(key, "takes no stops that hold" in finding) for key, finding, _ in refusals] == [("method", True)]


def test_billiards_in_an_ellipse_keep_the_product_of_angular_momenta_about_the_foci(make: Make) -> None:
    """Joachimsthal: of x^2/4 + y^2 = 1 with foci at +-sqrt(3), every reflection keeps it, and the speed."""
    text = BALL + "stops:\n  - {name: wall, quantity: x_c**2/4 + y_c**2, limits: [null, 1], restitution: 1}\n"
    table = make(text)
    motion = simulate(table, hold([]), [0.3, 0.1], [1.0, 0.6], Settings(25.0, output_step=0.1, **TIGHT))
    assert len(motion.events) > 10
    (x, y), (vx, vy), c = motion.q.T, motion.qd.T, np.sqrt(3)
    product = ((x - c) * vy - y * vx) * ((x + c) * vy - y * vx)
    assert product == pytest.approx(np.full_like(product, product[0]), abs=1e-12)
    assert vx**2 + vy**2 == pytest.approx(np.full_like(vx, 1.36), abs=1e-12)
    assert table("touching", q=motion.q)["clearance"].min() > -1e-13


def test_a_tight_rope_unwinds_from_a_cylinder(make: Make) -> None:
    """The load moves on an involute at its constant speed v: the free part L obeys L L' = R v."""
    R, v, L = 0.2, 0.7, 0.5
    rope = f"""forces:
  - name: rope
    from: {{body: base, position: [-1, {-R}, 0]}}
    to: {{body: ball}}
    wraps: [{{type: cylinder, radius: {R}, body: base, side: -y}}]
stops:
  - {{name: tight, quantity: length_rope, limits: [null, LIMIT], restitution: 0}}
"""
    turned = 1.0  # the angle of the cylinder that the rope covers
    at, along = np.array([np.sin(turned), -np.cos(turned)]), np.array([np.cos(turned), np.sin(turned)])
    limit = 1 + R * turned + L
    motion = simulate(
        make(BALL + rope.replace("LIMIT", f"{limit!r}")),
        hold([]),
        R * at + L * along,
        v * at,
        Settings(0.8, **TIGHT),
    )
    free = np.sqrt(L**2 + 2 * R * v * motion.t)
    angle = turned - (free - L) / R
    expected = R * np.array([np.sin(angle), -np.cos(angle)]) + free * np.array([np.cos(angle), np.sin(angle)])
    assert pytest.approx(expected, abs=1e-10) == motion.q.T
    assert np.linalg.norm(motion.qd, axis=1) == pytest.approx(np.full(len(motion.t), v), abs=1e-11)
    assert motion["normal_tight_upper"][1:] == pytest.approx((1.5 * v**2 / free)[1:], rel=1e-8)


@pytest.mark.parametrize("side", ["lower", "upper"])
def test_a_compliant_stop_of_a_sum_rebounds_after_half_a_period(side: str, make: Make) -> None:
    """The number q_a - 2 q_b has the inertia 1/(1/m_a + 4/m_b); without dissipation the rebound is as fast."""
    sign = -1 if side == "lower" else 1
    limits = "[-0.1, null]" if side == "lower" else "[null, 0.1]"
    stop = f"  - {{name: gear, quantity: q_a - 2*q_b, limits: {limits}, stiffness: 500, dissipation: 0}}\n"
    pair, m, v = make(PAIR.format(0) + stop), 1 / (1 / 2 + 4 / 3), 1.5
    duration = 0.1 / v + np.pi * np.sqrt(m / 500) + 0.2
    motion = simulate(pair, hold([]), [0, 0], [sign * v, 0], Settings(duration, output_step=1e-3, **TIGHT))
    number, rate = motion.q @ [1, -2], motion.qd @ [1, -2]
    assert rate[-1] == pytest.approx(-sign * v, abs=1e-6)  # its force has a kink
    assert sign * number[-1] == pytest.approx(0.1 - 0.2 * v, abs=1e-6)
    assert (sign * number).max() == pytest.approx(0.1 + v * np.sqrt(m / 500), rel=1e-4)
    assert motion.qd @ [2, 3 / 2] == pytest.approx(np.full(len(motion.t), sign * 2 * v), abs=1e-10)  # across the gear


def test_time_stepping_approaches_the_motion_from_event_to_event(make: Make) -> None:
    atwood = make(ATWOOD)
    best = simulate(atwood, hold([]), [0, 0], [4.0, 0], Settings(2.0, **TIGHT))
    errors = []
    for h in (2e-3, 2e-4):
        motion = simulate(atwood, hold([]), [0, 0], [4.0, 0], Settings(2.0, "moreau", step=h))
        errors.append(np.abs(motion.q[-1] - best.q[-1]).max())
    assert errors[1] < 1e-3
    assert errors[1] < errors[0] / 3


def draw(seed: int) -> tuple[str, Array]:
    """Draw a chain of three turns with stops at random quadratic numbers of its pose, and velocities."""
    rng = np.random.default_rng(seed)
    lines = ["name: chain", "gravity: [0, 0, -9.81]", "bodies:"]
    for k in range(3):
        axis = rng.normal(size=3).round(2).tolist()
        parent = f"parent: b{k - 1}, " if k else ""
        lines.append(
            f"  - {{name: b{k}, {parent}joint: {{name: j{k}, type: revolute, axis: {axis}, position: "
            f"[{0.4 if k else 0}, 0, 0], actuated: false}}, mass: 1, com: [0.2, 0, 0.1], inertia: [0.02, 0.03, 0.04]}}"
        )
    lines += ["frames: [{name: tip, body: b2, position: [0.4, 0, 0], sensor: false}]", "stops:"]
    a, b, c = rng.normal(size=3).round(2).tolist()
    lines += [
        f"  - {{name: one, quantity: {a}*q_j0 + {b}*q_j1*q_j2, limits: [-0.3, 0.4], restitution: {rng.random():.2f}}}",
        f"  - {{name: two, quantity: (x_tip - 0.2)**2 + y_tip**2 + {c}*z_tip, limits: [null, 2], restitution: 0.5}}",
        "  - {name: three, quantity: z_tip, limits: [-0.5, 0.3], restitution: 0}",
    ]
    return "\n".join(lines) + "\n", rng.normal(size=3)


@pytest.mark.parametrize("seed", range(4))
def test_random_chains_obey_their_stops_and_lose_energy(seed: int, make: Make) -> None:
    """No number passes a limit, impacts take energy out alone, and methods of order 4 and 8 find the same events."""
    text, qd = draw(seed)
    chain = make(text)
    motion, other = (
        simulate(chain, hold([]), np.zeros(3), qd, Settings(0.5, method, rtol=1e-9, atol=1e-9, output_step=0.01))
        for method in ("dop853", "rk45")
    )
    assert motion.halt is None
    assert len(motion.events) > 1
    assert chain("touching", q=motion.q)["clearance"].min() > -1e-12
    assert motion.energy is not None
    assert motion.energy.impacts is not None
    assert np.diff(motion.energy.impacts).min() > -1e-13
    assert np.abs(motion.energy.drift).max() < 1e-6
    assert [(x.joint, x.kind) for x in motion.events] == [(x.joint, x.kind) for x in other.events]
    assert [x.time for x in motion.events] == pytest.approx([x.time for x in other.events], abs=1e-5)


def test_a_start_beyond_a_stop_is_refused(make: Make) -> None:
    with pytest.raises(InsideError, match=r"stop rope\.lower starts 0\.1 beyond its limit"):
        simulate(make(ATWOOD), hold([]), [-0.1, 0], [0, 0], Settings(1.0))
