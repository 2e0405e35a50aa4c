"""Solids that touch each other, by steps: distances, stacks at rest, slopes, impacts, energy, shapes and refusals."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mbsgen.errors import InputError
from mbsgen.manifest import RigidPair, Solid
from mbsgen.model.reader import read_model
from mbsgen.model.writer import write_model
from mbsrun import Mechanism, load
from mbsrun.animation import Motion as Shown
from mbsrun.animation import Part, make_film
from mbsrun.animation.film import Kind, Layer
from mbsrun.models import Extent
from mbsrun.simulation import Motion, Settings, simulate
from mbsrun.simulation.drive import hold
from mbsrun.simulation.memory import load_functions
from mbsrun.simulation.simulate import InsideError
from mbsrun.simulation.solids import CDEF, Pairs
from tests.mbsrun.simulation.corners import draw_points, make_box

Array = NDArray[np.float64]
Make = Callable[[str], Mechanism]

G = 9.81
NEEDED = ("impl", "energy", "power", "frames", "meetings", "rates")
BODY = "  - {{name: {}, joint: {{type: free}}, mass: {}, inertia: [{}, {}, {}]}}\n"
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
LAW = "restitution: {}, friction: {{coefficient: {}}}}}\n"


@pytest.fixture(scope="module")
def make(tmp_path_factory: pytest.TempPathFactory) -> Make:
    """Return a function that loads a model from its contacts, for free bodies a, b, ... of masses 1, 2, ..."""

    def build(contacts: str, bodies: str = "ab") -> Mechanism:
        text = "name: solids\ngravity: [0, 0, -9.81]\nbodies:\n"
        text += "".join(BODY.format(x, k, 0.01 * k, 0.012 * k, 0.014 * k) for k, x in enumerate(bodies, 1))
        file = tmp_path_factory.mktemp("model") / "model.yaml"
        file.write_text(f"{text}contacts:\n{contacts}", encoding="utf-8")
        return load(file, extent=Extent(NEEDED, 1, optional=("touching", "distances")))

    return build  # type: ignore[return-value]


def step(kernels: Mechanism, q: object, qd: object, duration: float, h: float, **more: object) -> Motion:
    motion = simulate(kernels, hold([]), q, qd, Settings(duration, "moreau", step=h, **more))  # type: ignore[arg-type]
    assert motion.is_complete, motion.halt
    assert motion.effort.residual <= 1e-8
    assert motion.energy is not None
    assert motion.energy.drift.max() < 1e-10  # energy never exceeds its balance
    return motion


# --- distances --------------------------------------------------------------------------------------------------------


def draw_solid(rng: np.random.Generator, kind: str) -> Solid:
    match kind:
        case "box":
            return Solid(points=make_box(rng.uniform(0.3, 1, 3)), radius=0.0)
        case "capsule":
            return Solid(points=((0, 0, -0.3), (0, 0, 0.3)), radius=0.15)
        case "ball":
            return Solid(points=((0, 0, 0),), radius=0.2)
    return Solid(points=draw_points(rng, 12, 0.5), radius=0.1 if kind == "round" else 0.0)


def measure(first: Solid, other: Solid, places: Array, turns: Array) -> float:
    pair = RigidPair(name="pair", first=first, other=other, restitution=0, coefficient=0)
    distances, normals = Pairs([pair], *load_functions(CDEF, "mbs_solids.c")).measure(
        places.T[None], np.hstack(list(turns))[None]
    )
    assert np.linalg.norm(normals[0, 0]) == pytest.approx(1, abs=1e-12)
    return float(distances[0, 0])


@pytest.mark.parametrize(
    "kinds", ["box box", "hull hull", "box hull", "capsule capsule", "capsule box", "round box", "ball hull"]
)
def test_distances_and_depths_are_those_of_coal(kinds: str) -> None:
    """Of solids at random places, apart and one in the other; below 0, the least way that parts them."""
    coal = pytest.importorskip("coal")
    rng = np.random.default_rng(len(kinds))

    def shape(solid: Solid) -> object:
        if len(solid.points) <= 2:
            long = solid.points[-1][2] - solid.points[0][2]
            return coal.Capsule(solid.radius, long) if long else coal.Sphere(solid.radius)
        corners = coal.StdVec_Vec3s()
        for point in solid.points:
            corners.append(np.array(point))
        hull = coal.ConvexBase.convexHull(corners, True, "Qt")
        hull.setSweptSphereRadius(solid.radius)
        return hull

    request, inside = coal.DistanceRequest(), 0
    request.gjk_tolerance = request.epa_tolerance = 1e-12
    request.gjk_max_iterations = request.epa_max_iterations = 1000
    for _ in range(60):
        first, other = (draw_solid(rng, kind) for kind in kinds.split())
        turns, places = Rotation.random(2, random_state=rng).as_matrix(), 0.35 * rng.normal(size=(2, 3))
        poses = [coal.Transform3s(R, p) for R, p in zip(turns, places, strict=True)]
        expected = coal.distance(shape(first), poses[0], shape(other), poses[1], request, coal.DistanceResult())
        assert measure(first, other, places, turns) == pytest.approx(expected, abs=1e-10)
        inside += expected < 0
    assert 3 < inside < 57


def test_faces_edges_and_corners_that_touch_have_the_distance_0() -> None:
    """Coincident faces, parallel and crossing edges, corner on corner, and both at one place."""
    cube, I = Solid(points=make_box(np.ones(3)), radius=0.0), np.eye(3)
    for place in ([0, 0, 1], [0.3, -0.2, 1], [0, 1, 1], [1, 1, 1], [1, 0.5, 1]):
        assert abs(measure(cube, cube, np.array([place, [0, 0, 0]], dtype=float), np.array([I, I]))) < 1e-15
    assert measure(cube, cube, np.zeros((2, 3)), np.array([I, I])) == pytest.approx(-1)
    tilted = Rotation.from_euler("x", 45, degrees=True).as_matrix()
    crossed = Rotation.from_euler("y", 45, degrees=True).as_matrix()
    places = np.array([[0.1, 0.2, np.sqrt(2) - 0.01], [0, 0, 0]])
    assert measure(cube, cube, places, np.array([tilted, crossed])) == pytest.approx(-0.01, abs=1e-15)


# --- motions ----------------------------------------------------------------------------------------------------------

ON_BOX = "  - {{name: {}, body: {}, size: [0.2, 0.2, 0.2], box: {{{}size: {}}}, " + LAW
STACK = ON_BOX.format("under", "a", "", "[0.4, 0.3, 0.2]", 0, 0.5) + ON_BOX.format(
    "pair", "b", "body: a, ", "[0.2, 0.2, 0.2]", 0, 0.5
)


def test_a_stack_of_boxes_stays_for_a_thousand_seconds(make: Make) -> None:
    """Aligned, and turned on each other: it carries its weight, and creeps by rounding alone."""
    stack = make(STACK)
    for yaw in (0.0, 0.4):
        turn = (0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2))
        motion = step(stack, [0, 0, 0.2, *UPRIGHT, 0.01, 0.02, 0.4, *turn], np.zeros(12), 1e3, 0.1, output_step=10)
        assert np.abs(motion.q - motion.q[0]).max() < 1e-12
        assert motion["gap_pair"].min() > -1e-12
        assert motion["normal_pair"][-1] == pytest.approx(2 * G, rel=1e-10)
        assert motion["normal_under"][-1] == motion["fz_under"][-1] == pytest.approx(3 * G, rel=1e-10)


@pytest.mark.parametrize("mu", [0.5, 0.2])
def test_a_box_sticks_or_slides_on_a_tilted_box(make: Make, mu: float) -> None:
    """By g (sin - mu cos), with all four corners."""
    slope = np.arctan(0.3)
    across, down = np.array([np.sin(slope), 0, np.cos(slope)]), np.array([np.cos(slope), 0, -np.sin(slope)])
    tilt = "orientation: [{axis: y, angle: atan(0.3)}], "
    box = make(ON_BOX.format("pair", "a", tilt, "[4, 2, 1]", 0, mu), "a")  # type: ignore[call-arg]
    start = 0.6 * across - down
    motion = step(box, [*start, 0, np.sin(slope / 2), 0, np.cos(slope / 2)], np.zeros(6), 0.5, 1e-3)
    way = max(0.0, G * (np.sin(slope) - mu * np.cos(slope))) * 0.5**2 / 2
    assert motion.q[-1, :3] - start == pytest.approx(way * down, abs=1e-13)
    assert np.abs(motion.q[:, 3:] - motion.q[0, 3:]).max() < 1e-14


def test_two_edges_cross_in_an_impact(make: Make) -> None:
    """One impulse at the point where they cross, by Newton's law: P (1/m + (r x n) I^-1 (r x n)) = (1 + e) v."""
    tilt = "orientation: [{axis: x, angle: 45 deg}], "
    contacts = ON_BOX.format("pair", "a", tilt, "[1, 1, 1]", 0.5, 0).replace(
        "size: [0.2", "orientation: [{axis: y, angle: 45 deg}], size: [0.2", 1
    )
    box, h = make(contacts, "a"), 1e-5  # type: ignore[call-arg]
    q = [0.05, -0.04, 0.6 * np.sqrt(2) + 1e-9, *UPRIGHT]
    motion = step(box, q, [0, 0, -1, 0, 0, 0], h, h)
    r, inertia = np.array([0, 0.04, -0.1 * np.sqrt(2)]), np.array([0.01, 0.012, 0.014])
    lever = np.cross(r, [0, 0, 1])
    P = (1.5 + G * h) / (1 + lever @ (lever / inertia))
    assert motion["normal_pair"][-1] * h == pytest.approx(P, rel=1e-6)
    assert motion.qd[-1] == pytest.approx([0, 0, P - 1 - G * h, *(lever * P / inertia)], abs=2e-5)


def test_a_bar_lies_across_a_bar(make: Make) -> None:
    """The four corners of the square that their faces share carry the upper one; no corner of either touches."""
    bars = "  - {name: pair, body: a, size: [1, 0.1, 0.1], box: {size: [0.1, 1, 0.1]}, " + LAW.format(0, 0.5)
    motion = step(make(bars, "a"), [0.04, 0.3, 0.1, *UPRIGHT], np.zeros(6), 1.0, 1e-2)  # type: ignore[call-arg]
    assert np.abs(motion.q - motion.q[0]).max() < 1e-14
    tips = step(make(bars, "a"), [0.06, 0.3, 0.1, *UPRIGHT], np.zeros(6), 0.05, 1e-4)  # type: ignore[call-arg]
    lever = 0.01
    angular = G * lever / (0.012 + lever**2 + 0.05**2)  # about the edge, at first
    assert tips.qd[100, 4] == pytest.approx(angular * tips.t[100], rel=2e-3)


CAPSULE = "  - {name: pair, body: a, radius: 0.05, points: [[-0.2, 0, 0], [0.2, 0, 0]], "


def test_a_capsule_balances_across_a_capsule_and_lies_on_a_box(make: Make) -> None:
    lies = CAPSULE + "capsule: {radius: 0.1, length: 1, orientation: [{axis: x, angle: 90 deg}]}, " + LAW.format(0, 0.5)
    motion = step(make(lies, "a"), [0, 0, 0.15, *UPRIGHT], np.zeros(6), 0.5, 1e-3)  # type: ignore[call-arg]
    assert np.abs(motion.q - motion.q[0]).max() < 1e-13
    lies = CAPSULE + "box: {size: [0.3, 1, 0.2]}, " + LAW.format(0, 0.5)
    motion = step(make(lies, "a"), [0.1, 0, 0.15, *UPRIGHT], np.zeros(6), 10, 1e-2)  # type: ignore[call-arg]
    assert np.abs(motion.q - motion.q[0]).max() < 1e-12
    assert motion["normal_pair"][-1] == pytest.approx(G, rel=1e-10)
    tips = step(make(lies, "a"), [0.16, 0, 0.15, *UPRIGHT], np.zeros(6), 0.05, 1e-4)  # type: ignore[call-arg]
    assert tips.qd[100, 4] == pytest.approx(G * 0.01 / (0.012 + 0.01**2 + 0.05**2) * tips.t[100], rel=3e-2)


SHAPES = {
    "box": ("size: [0.3, 0.25, 0.2]", "box: {{body: {}, size: [0.3, 0.25, 0.2]}}"),
    "capsule": (
        "radius: 0.08, points: [[0, 0, -0.12], [0, 0, 0.12]]",
        "capsule: {{body: {}, radius: 0.08, length: 0.24}}",
    ),
}


def list_shape(rng: np.random.Generator, kind: str) -> tuple[str, str]:
    if kind in SHAPES:
        return SHAPES[kind]
    points = f"points: {[list(x) for x in draw_points(rng, 9, 0.17)]}"
    points += ", radius: 0.03" if kind == "round" else ""
    return points, f"hull: {{{{body: {{}}, {points}}}}}"


@pytest.mark.parametrize("kinds", ["box box box", "hull hull box", "round capsule hull"])
def test_a_heap_comes_to_rest_without_energy_from_nowhere(make: Make, kinds: str) -> None:
    """Bodies that fall on each other: the conditions hold in each step, and depths shrink with the step."""
    rng = np.random.default_rng(4)
    shapes = [list_shape(rng, kind) for kind in kinds.split()]
    law, contacts = LAW.format(0.3, 0.4), ""
    for k, (name, (own, _)) in enumerate(zip("abc", shapes, strict=True)):
        contacts += f"  - {{name: ground_{name}, body: {name}, {own}, {law}"
        for other, (_, side) in zip("abc"[:k], shapes[:k], strict=True):
            contacts += f"  - {{name: {name}{other}, body: {name}, {own}, {side.format(other)}, {law}"
    heap = make(contacts, "abc")  # type: ignore[call-arg]
    turns = Rotation.random(3, random_state=rng).as_quat()
    q = np.concatenate([[0.02 * k, 0.01, 0.35 + 0.45 * k, *turn] for k, turn in enumerate(turns)])
    deepest = []
    for h in (1e-3, 2.5e-4):
        motion = step(heap, q, np.zeros(18), 1.2, h)
        deepest.append(min(motion[f"gap_{pair}"].min() for pair in ("ba", "ca", "cb")))
        assert np.isfinite(motion.q).all()
    assert -4e-3 < deepest[0] <= 0
    assert deepest[1] > max(deepest[0], -1.5e-3)


# --- files, pictures and refusals -------------------------------------------------------------------------------------

HULL = (
    "  - {name: pair, body: b, radius: 0.01, points: [[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]], "
    "hull: {body: a, position: [0, 0, 0.1], radius: 0.02, points: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]}, "
    + LAW.format(0, 0.5)
)


def write(folder: Path, contacts: str) -> Path:
    file = folder / "model.yaml"
    text = "name: solids\ngravity: [0, 0, -9.81]\nbodies:\n"
    file.write_text(text + BODY.format("a", 1, 1, 1, 1) + BODY.format("b", 1, 1, 1, 1) + "contacts:\n" + contacts)
    return file


def test_hulls_are_written_and_read(tmp_path: Path) -> None:
    model = read_model(write(tmp_path, HULL))
    (tmp_path / "again.yaml").write_text(write_model(model))
    assert read_model(tmp_path / "again.yaml") == model


def test_a_box_within_a_hollow_sphere_touches_by_each_corner(tmp_path: Path) -> None:
    text = "  - {name: bowl, body: a, size: [0.2, 0.2, 0.2], sphere: {radius: 1, inside: true}, restitution: 0}\n"
    bowl = load(write(tmp_path, text), extent=Extent(("touching",), derivatives=0))
    q = np.array([0.1, -0.2, 0.3, *UPRIGHT, *np.zeros(6), 1])
    corners = np.array(make_box(np.full(3, 0.2))) + q[:3]
    assert bowl("touching", q=q)["clearance"].ravel() == pytest.approx(1 - np.linalg.norm(corners, axis=1))


def test_both_hulls_are_drawn(tmp_path: Path) -> None:
    pair = load(write(tmp_path, HULL), extent=Extent(("frames",), derivatives=0))
    q = np.array([[0, 0, 0, *UPRIGHT, 0, 0, 3, *UPRIGHT]] * 2)
    film = make_film([Shown((Part(pair, np.array([0.0, 1.0]), q),))])
    balls = [x for x in film.actors[0].solids if x.layer is Layer.CONTACTS and x.kind is Kind.ELLIPSOID]
    assert len(balls) == 8
    assert (1.0, 0.0, 0.1) in [x.at for x in balls]


FAULTS = {
    "compliant": ("restitution: 0, friction: {coefficient: 0.5}", "stiffness: 1e4", "compliant hull and a hull"),
    "flat": ("[0, 0, 1]]", "[1, 1, 0]]", "all points lie in a plane"),
    "two sharp points": ("radius: 0.02, points: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]",
                         "points: [[0, 0, 0], [1, 0, 0]]", "two points without a radius"),
    "one point": ("[[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]", "[[0, 0, 0]]", "1 points, where 2 to 100"),
    "a radius below 0": ("radius: 0.02", "radius: -1", "found -1"),
    "a plane too": ("hull: {body", "plane: {}, hull: {body", "a plane and a hull"),
}  # fmt: skip


@pytest.mark.parametrize(("old", "new", "finding"), FAULTS.values(), ids=FAULTS.keys())
def test_faults_are_found(old: str, new: str, finding: str, tmp_path: Path) -> None:
    assert old in HULL
    with pytest.raises(InputError, match=finding):
        read_model(write(tmp_path, HULL.replace(old, new, 1)))


def test_other_methods_and_starts_inside_are_refused(make: Make) -> None:
    stack = make(STACK)
    q, qd = [0, 0, 0.2, *UPRIGHT, 0, 0, 0.4, *UPRIGHT], np.zeros(12)
    with pytest.raises(ValueError, match="contacts of two solids, which the model has: under; give moreau"):
        simulate(stack, hold([]), q, qd, Settings(1.0, "dop853"))
    q[9] = 0.39
    with pytest.raises(InsideError, match=r"contact pair starts 0\.01 m inside"):
        simulate(stack, hold([]), q, qd, Settings(1.0, "moreau", step=1e-3))
