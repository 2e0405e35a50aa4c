"""Time stepping: closed forms of rigid contacts, conditions of the cone problem, energy, and the way by events."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.errors import InputError
from mbsgen.model.reader import read_model
from mbsgen.model.writer import write_model
from mbsrun import Mechanism, load
from mbsrun.models import Extent
from mbsrun.simulation import Motion, Settings, control, simulate
from mbsrun.simulation.drive import hold
from mbsrun.simulation.memory import load_functions
from mbsrun.simulation.simulate import InsideError
from tests.mbsrun.simulation.drawn_trees import draw_tree

Array = NDArray[np.float64]
Make = Callable[[str], Mechanism]

G = 9.81
NEEDED = ("exp2", "impl", "semi", "semi_res", "energy", "power", "frames")
FREE = """
name: body
gravity: [0, 0, -9.81]
bodies:
  - {{name: body, joint: {{type: free}}, mass: 2, inertia: [0.1, 0.2, 0.3]}}
contacts:
"""
LEG = "  - {{name: {}, body: body, position: [{}, {}, -0.7], restitution: 0, friction: {{coefficient: 0.5}}}}\n"
FEET = (("a", 0.5, 0.4), ("b", -0.5, 0.4), ("c", 0.5, -0.4), ("d", -0.5, -0.4))
TABLE = FREE.format() + "".join(LEG.format(*foot) for foot in FEET)
BALL = FREE.format() + "  - {name: ball, body: body, radius: 0.1, restitution: 0.5, friction: {coefficient: 0.3}}\n"
SLOPE = 0.29  # the tangent of its angle
BLOCK = FREE.format() + (
    "  - {name: box, body: body, size: [0.4, 0.3, 0.2], plane: {normal: [%g, 0, 1]}, restitution: 0, "
    "friction: {coefficient: %g}}\n"
)
AT_REST = [0.0] * 6


@pytest.fixture(scope="session")
def make(tmp_path_factory: pytest.TempPathFactory) -> Make:
    """Return a function that loads a model from its text, each text once."""
    known: dict[str, Mechanism] = {}

    def build(text: str) -> Mechanism:
        if text not in known:
            file = tmp_path_factory.mktemp("model") / "model.yaml"
            file.write_text(text, encoding="utf-8")
            functions = NEEDED + (("touching", "distances") if "contacts:" in text else ())
            functions += ("rates",) if "free" in text else ()
            known[text] = load(file, extent=Extent(functions, 1))
        return known[text]

    return build


def step(kernels: Mechanism, q: object, qd: object, duration: float, h: float, **more: float) -> Motion:
    settings = Settings(duration, "moreau", step=h, **more)  # type: ignore[arg-type]
    motion = simulate(kernels, hold([0.0] * len(kernels.manifest.inputs)), q, qd, settings)  # type: ignore[arg-type]
    assert motion.is_complete
    assert motion.effort.residual <= 1e-8
    return motion


def find_excess(motion: Motion) -> float:
    """Return by how much the energy exceeds the start's, plus work, less losses."""
    energy = motion.energy
    assert energy is not None
    return float(energy.drift.max())


def test_a_table_stands_on_four_legs_and_slides_to_rest(make: Make) -> None:
    """Three legs would do: the forces are not unique, but their sums are; it slides v^2/(2 mu g), to the step."""
    table = make(TABLE)
    still = step(table, [0, 0, 0.7, 0, 0, 0, 1], AT_REST, 1.0, 1e-2)
    forces = np.array([still[f"normal_{leg}"] for leg in "abcd"])
    assert forces.sum(axis=0) == pytest.approx(2 * G, rel=1e-12)
    assert np.abs(forces.T @ [[0.5, 0.4], [-0.5, 0.4], [0.5, -0.4], [-0.5, -0.4]]).max() < 1e-11
    assert forces.min() > 0
    assert np.abs(still.q - still.q[0]).max() < 1e-15
    slides = step(table, [0, 0, 0.7, 0, 0, 0, 1], [1.0, *AT_REST[1:]], 0.5, 1e-3)
    assert slides.q[-1][:3] == pytest.approx([1 / G, 0, 0.7], abs=1e-6)
    assert slides.energy is not None
    assert slides.energy.friction is not None
    assert slides.energy.friction[-1] == pytest.approx(1.0, abs=1e-12)
    assert slides["fx_a"][5] + slides["fx_b"][5] + slides["fx_c"][5] + slides["fx_d"][5] == pytest.approx(-G)
    assert find_excess(slides) < 1e-12


def test_a_ball_bounces_to_rest_and_rolls(make: Make) -> None:
    """It loses all energy at its accumulation point; from sliding it comes to roll."""
    ball = make(BALL)
    errors = []
    for h in (2e-3, 2e-4):
        motion = step(ball, [0, 0, 1.1, 0, 0, 0, 1], AT_REST, 2.0, h)
        errors.append(np.abs(motion.q[:, 2] - 0.1 - bounce(motion.t, 1.0, 0.5)).max())
        assert find_excess(motion) < 1e-11
        assert np.abs(motion.qd[-1]).max() < 1e-12
    assert errors[1] < errors[0] / 4
    rolls = step(ball, [0, 0, 0.1, 0, 0, 0, 1], [2.0, *AT_REST[1:]], 3.0, 1e-3)
    assert abs(np.hypot(rolls.qd[-1, 0], rolls.qd[-1, 2])) == pytest.approx(2 * 0.02 / 0.22, rel=1e-5)
    assert rolls["fx_ball"][-1] == pytest.approx(0, abs=1e-9)


def bounce(t: Array, h: float, e: float) -> Array:
    """Return the height of a ball that falls from h, at times t."""
    start, v, z = 0.0, 0.0, h - G * t**2 / 2
    v, start = e * math.sqrt(2 * G * h), math.sqrt(2 * h / G)
    while v > 1e-9:
        later = t >= start
        z[later] = v * (t[later] - start) - G * (t[later] - start) ** 2 / 2
        start, v = start + 2 * v / G, e * v
    return np.where(t >= start, 0.0, z)


def test_a_block_on_an_incline_sticks_for_ten_thousand_seconds_or_slides(make: Make) -> None:
    """Below the angle of friction it does not creep by a picometre; above, it has g (sin - mu cos)."""
    a = math.atan(SLOPE)
    start = [0.1 * math.sin(a), 0, 0.1 * math.cos(a), 0, math.sin(a / 2), 0, math.cos(a / 2)]
    sticks = step(make(BLOCK % (SLOPE, 0.3)), start, AT_REST, 1e4, 0.05)
    assert np.abs(sticks.q[-1] - sticks.q[0]).max() < 1e-12
    slides = step(make(BLOCK % (SLOPE, 0.2)), start, AT_REST, 1.0, 0.01)
    assert np.linalg.norm(slides.qd[-1]) == pytest.approx(G * (math.sin(a) - 0.2 * math.cos(a)), rel=1e-10)


STACK = """
name: stack
gravity: [0, 0, -9.81]
bodies:
  - {name: low, joint: {type: free}, mass: 1, inertia: [0.1, 0.1, 0.1]}
  - {name: high, joint: {type: free}, mass: 20, inertia: [0.1, 0.1, 0.1]}
contacts:
  - {name: ground, body: low, size: [0.4, 0.4, 0.2], restitution: 0, friction: {coefficient: 0.5}}
  - name: top
    body: high
    size: [0.4, 0.4, 0.2]
    plane: {body: low, position: [0, 0, 0.1]}
    restitution: 0
    friction: {coefficient: 0.5}
"""


def test_a_heavy_block_stands_on_a_light_one(make: Make) -> None:
    """The ground bears both weights; a blow that both can hold together moves them together."""
    pose = [0, 0, 0.1, 0, 0, 0, 1, 0, 0, 0.3, 0, 0, 0, 1]
    motion = step(make(STACK), pose, [0.3, *AT_REST[1:], 0.3, *AT_REST[1:]], 0.2, 1e-3)
    normals = [sum(motion[f"normal_{name}_{k}"][-1] for k in range(1, 9)) for name in ("ground", "top")]
    assert normals == pytest.approx([21 * G, 20 * G], rel=1e-9)
    assert motion.q[-1, 0] == pytest.approx(motion.q[-1, 7], abs=1e-12)
    assert motion.q[-1, 0] == pytest.approx(0.3**2 / G, rel=1e-2)


@pytest.mark.parametrize("seed", [1, 4])
def test_random_trees_approach_their_motion_from_event_to_event(seed: int, make: Make) -> None:
    """Stops and dry friction: the error falls with the step, conditions hold, and energy never exceeds its balance."""
    tree, start = make(draw_tree(seed)), np.random.default_rng(seed + 100).normal(size=4)
    by_events = simulate(tree, hold([]), np.zeros(4), start, Settings(1.0, rtol=1e-11, atol=1e-11, output_step=0.01))
    assert len(by_events.events) > 4
    errors = []
    for h in (1e-3, 1e-4):
        motion = step(tree, np.zeros(4), start, 1.0, h, output_step=0.01)
        errors.append(np.abs(motion.q - by_events.q).max())
        assert find_excess(motion) < 1e-10
        assert motion.energy is not None
        assert np.diff(motion.energy.total).max() < 1e-10
    assert errors[1] < 1e-3
    assert errors[1] < errors[0] / 3


PENDULUM = """
name: pendulum
gravity: [0, 0, -9.81]
bodies:
  - name: upper
    joint: {type: revolute, axis: y, actuated: false}
    mass: 1
    com: [0, 0, -0.5]
    inertia: [0.1, 0.1, 0.01]
  - name: lower
    parent: upper
    joint: {type: revolute, axis: y, position: [0, 0, -1], actuated: false}
    mass: 1
    com: [0, 0, -0.5]
    inertia: [0.1, 0.1, 0.01]
contacts:
  - name: tip
    body: lower
    position: [0, 0, -1]
    plane: {position: [0, 0, -1.8]}
    restitution: %g
    friction: {coefficient: 0.8}
"""


def test_without_contacts_it_is_the_midpoint_rule(make: Make) -> None:
    """Order 2 in a double pendulum that touches nothing, against DOP853."""
    free = make(PENDULUM.replace("-1.8", "-5") % 0.5)
    bare = make(PENDULUM.split("contacts")[0])
    best = simulate(bare, hold([]), [1.0, 0.5], [0, 0], Settings(1.0, rtol=1e-12, atol=1e-12)).q[-1]
    errors = [np.abs(step(free, [1.0, 0.5], [0, 0], 1.0, h).q[-1] - best).max() for h in (1e-2, 5e-3)]
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)


def test_an_impact_with_friction_creates_no_energy(make: Make) -> None:
    """Kane's paradox: Newton's law with e = 0.9 and friction would make this double pendulum faster."""
    motion = step(make(PENDULUM % 0.9), [0.5, 0.3], [-1.0, -6.0], 0.5, 1e-4)
    energy = motion.energy
    assert energy is not None
    assert energy.impacts is not None
    assert energy.friction is not None
    assert energy.impacts[-1] > 1
    assert find_excess(motion) < 1e-10
    assert np.diff(energy.total).max() < 1e-6
    assert motion["gap_tip"].min() > -2e-3


_CONE = """
typedef struct { long long rows, blocks; const long long *kind, *first; const double *grip, *W, *free; } mbs_cone;
typedef struct { double residual; long long sweeps, steps; } mbs_cone_effort;
long long mbs_cone_reals(long long rows);
long long mbs_cone_integers(long long rows);
int mbs_cone_solve(const mbs_cone *problem, double tolerance, double *P, mbs_cone_effort *effort, double *reals,
                   long long *integers);
"""


def solve_cone(W: Array, free: Array, kinds: list[int], grip: Array) -> tuple[int, Array, float]:
    """Solve a cone problem of touches (0), pushes (1) and brakes (2) from rest."""
    ffi, lib = load_functions(_CONE, "mbs_cone.c", "mbs_dense.c")
    sizes = [3 if kind == 0 else 1 for kind in kinds]
    arrays = [np.array(x, dtype=np.int64) for x in (kinds, np.cumsum([0, *sizes[:-1]]))]
    numbers = [np.ascontiguousarray(x) for x in (grip, W, free)]
    cone = ffi.new("mbs_cone *", {"rows": len(free), "blocks": len(kinds)})
    cone.kind, cone.first = (ffi.cast("long long *", x.ctypes.data) for x in arrays)
    cone.grip, cone.W, cone.free = (ffi.cast("double *", x.ctypes.data) for x in numbers)
    P, effort = np.zeros(len(free)), ffi.new("mbs_cone_effort *")
    room = np.empty(lib.mbs_cone_reals(len(free))), np.empty(lib.mbs_cone_integers(len(free)), dtype=np.int64)
    pointers = ffi.cast("double *", room[0].ctypes.data), ffi.cast("long long *", room[1].ctypes.data)
    status = lib.mbs_cone_solve(cone, 1e-8, ffi.cast("double *", P.ctypes.data), effort, *pointers)
    return status, P, effort.residual


@pytest.mark.parametrize("seed", range(40))
def test_impulses_obey_the_laws_of_contact_and_friction(seed: int) -> None:
    """Complementarity, the cone, and friction against the slip, one by one; half of the matrices are singular."""
    rng = np.random.default_rng(seed)
    kinds = [0] * rng.integers(1, 7) + [1] * rng.integers(0, 3) + [2] * rng.integers(0, 3)
    rows = sum(3 if kind == 0 else 1 for kind in kinds)
    J = rng.normal(size=(rows, rows + 3 if seed % 2 else max(2, rows // 2)))
    free = J @ rng.normal(size=J.shape[1])  # as velocities of bodies are
    grip, first = rng.uniform(0, 0.5, len(kinds)), 0
    status, P, residual = solve_cone(J @ J.T, free, kinds, grip)
    assert (status, residual <= 1e-8) == (0, True)
    w = J @ (J.T @ P) + free
    size, fast = max(1.0, np.abs(P).max()), np.abs(free).max()
    for kind, mu in zip(kinds, grip, strict=True):
        if kind == 2:
            assert abs(P[first]) <= mu + 1e-9 * size
            assert abs(P[first]) > mu - 1e-7 * size or abs(w[first]) < 1e-6 * fast
            assert P[first] * w[first] < 1e-7 * size * fast
            first += 1
            continue
        assert P[first] >= 0
        assert w[first] > -1e-6 * fast
        assert abs(P[first] * w[first]) < 1e-6 * size * fast
        if kind == 0:
            t, v = P[first + 1 : first + 3], w[first + 1 : first + 3]
            assert np.linalg.norm(t) <= mu * P[first] + 1e-9 * size
            assert t @ v == pytest.approx(-mu * P[first] * np.linalg.norm(v), abs=1e-6 * size * fast)
        first += 3 if kind == 0 else 1


def test_feedback_is_asked_once_a_step(make: Make) -> None:
    """A damped spring by control brings a cart with dry friction to rest, where friction holds it."""
    text = "name: cart\ngravity: [0, 0, -9.81]\nbodies:\n  - {name: cart, joint: {type: prismatic, axis: x, "
    cart = make(text + "friction: {torque: 0.1}}, mass: 1}\n")
    law = control(lambda _, q, qd: [-40 * q[0] - 9 * qd[0]], 0.01)
    motion = simulate(cart, law, [1.0], [0.0], Settings(4.0, "moreau", step=1e-2))
    assert motion.qd[-1] == 0
    assert abs(40 * motion.q[-1, 0]) <= 0.1
    assert motion.is_complete


def test_a_clutch_lets_a_joint_move_one_way(make: Make) -> None:
    """Pulled back it stands still; pulled on it has F/m."""
    text = "name: cart\ngravity: [0, 0, -9.81]\nbodies:\n  - {name: cart, joint: {type: prismatic, axis: x, "
    cart = make(text + "friction: {torque: 0, one_way: -1}}, mass: 2}\n")
    for force, speed in ((3.0, 0.0), (-3.0, -1.5)):
        motion = simulate(cart, hold([force]), [0.0], [0.0], Settings(1.0, "moreau", step=1e-2))
        assert motion.qd[-1] == pytest.approx(speed, abs=1e-13)
    caught = simulate(cart, hold([0.0]), [0.0], [1.0], Settings(0.1, "moreau", step=1e-2))  # it does not throw back
    assert np.abs(caught.qd[1:]).max() < 1e-13


def test_what_does_not_fit_is_refused(make: Make, tmp_path: Path) -> None:
    """Other methods, starts inside the ground, and numbers of contacts."""
    ball = make(BALL)
    with pytest.raises(ValueError, match="radau takes no rigid contacts, which the model has: ball; give moreau"):
        simulate(ball, hold([]), [0, 0, 1, 0, 0, 0, 1], AT_REST, Settings(1.0, "radau"))
    with pytest.raises(InsideError, match=r"contact ball starts 0.05 m inside the other side"):
        simulate(ball, hold([]), [0, 0, 0.05, 0, 0, 0, 1], AT_REST, Settings(1.0, "moreau"))
    wrong = {
        "restitution: 1.5": "found 1.5; give 0, where nothing rebounds, to 1",
        "restitution: 0.5, stiffness: 3": "the stiffness of a rigid contact; leave it out",
        "restitution: 0.5, friction: {coefficient: -1}": "found -1; give 0 or more",
        "restitution: 0.5, friction: {coefficient: 1, speed: 0.1}": "smoothed friction of a rigid contact",
        "stiffness: 100, friction: {coefficient: 1}": "dry friction of a compliant contact; give a speed",
        "radius: 0.1": "stiffness: missing; give it, or restitution",
    }
    for law, message in wrong.items():
        file = tmp_path / "wrong.yaml"
        file.write_text(FREE.format() + f"  - {{name: ball, body: body, {law}}}\n", encoding="utf-8")
        with pytest.raises(InputError, match=message):
            read_model(file)


def test_files_keep_rigid_contacts(tmp_path: Path) -> None:
    file, copy = tmp_path / "ball.yaml", tmp_path / "copy.yaml"
    file.write_text(BALL, encoding="utf-8")
    copy.write_text(write_model(read_model(file)), encoding="utf-8")
    assert read_model(copy) == read_model(file)
