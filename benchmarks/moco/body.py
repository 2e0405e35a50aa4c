"""A body with 31 freedoms and 80 muscles, as a file of OpenSim.

Masses are Rajagopal's (A. Rajagopal and others, IEEE Transactions on Biomedical Engineering 63, 2016), and so are the
centres of joints. Knees, ankles, subtalar joints and forearms are pins. Wrists and toes do not move. The right leg's
muscles are in leg_muscles.csv; the left one mirrors them. Quadriceps end at points that move with the knee, by the
polynomials of models/human/muscle_walker.yaml. Each coordinate has a motor, too.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

TABLE = Path(__file__).with_name("leg_muscles.csv")
MIRROR = (1.0, 1.0, -1.0)

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Segment:
    """A body and the joint that carries it: in the parent's frame, about axes one after the other."""

    name: str
    parent: str
    place: Triple
    coordinates: tuple[tuple[str, Triple], ...]
    mass: float
    com: Triple
    inertia: Triple  # about the axes through the centre of mass
    slides: tuple[str, ...] = ()


PELVIS = Segment(
    "pelvis",
    "ground",
    (0, 0, 0),
    (("pelvis_tilt", (0, 0, 1)), ("pelvis_list", (1, 0, 0)), ("pelvis_rotation", (0, 1, 0))),
    11.777,
    (-0.0707, 0, 0),
    (0.1028, 0.0871, 0.0579),
    ("pelvis_tx", "pelvis_ty", "pelvis_tz"),
)
TORSO = Segment(
    "torso",
    "pelvis",
    (-0.1007, 0.0815, 0),
    (("lumbar_extension", (0, 0, 1)), ("lumbar_bending", (1, 0, 0)), ("lumbar_rotation", (0, 1, 0))),
    26.8266,
    (-0.03, 0.32, 0),
    (1.4745, 0.7555, 1.4314),
)
RIGHT = (
    Segment(
        "femur",
        "pelvis",
        (-0.0707, -0.0661, 0.0835),
        (("hip_flexion", (0, 0, 1)), ("hip_adduction", (1, 0, 0)), ("hip_rotation", (0, 1, 0))),
        9.3014,
        (0, -0.17, 0),
        (0.1339, 0.0351, 0.1412),
    ),
    Segment(
        "tibia",
        "femur",
        (0, -0.396, 0),
        (("knee_angle", (0, 0, 1)),),
        3.7075,
        (0, -0.1867, 0),
        (0.0504, 0.0051, 0.0511),
    ),
    Segment("talus", "tibia", (0, -0.43, 0), (("ankle_angle", (0, 0, 1)),), 0.1, (0, 0, 0), (0.001, 0.001, 0.001)),
    Segment(
        "calcn",
        "talus",
        (-0.0488, -0.042, 0.0079),
        (("subtalar_angle", (0.7872, 0.6047, -0.1209)),),
        1.4666,
        (0.11, 0.027, 0),
        (0.0016, 0.0065, 0.0067),
    ),
    Segment(
        "humerus",
        "torso",
        (0.0032, 0.3715, 0.17),
        (("arm_flex", (0, 0, 1)), ("arm_add", (1, 0, 0)), ("arm_rot", (0, 1, 0))),
        2.0325,
        (0, -0.1645, 0),
        (0.0119, 0.0041, 0.0134),
    ),
    Segment(
        "ulna",
        "humerus",
        (0.0131, -0.2863, -0.0096),
        (("elbow_flex", (0.226, 0.0223, 0.9739)),),
        0.6075,
        (0, -0.1205, 0),
        (0.003, 0.0006, 0.0032),
    ),
    Segment(
        "radius",
        "ulna",
        (-0.0067, -0.013, 0.0261),
        (("pro_sup", (0.0564, 0.9984, 0.002)),),
        1.065,
        (0, -0.18, 0),
        (0.0085, 0.001, 0.0088),
    ),
)

# places along x and y on the tibia over the knee's angle, from the highest power on; the knee flexes by negative angles
KNEECAP = {
    "rectus": ((0.01068, 0.04408, 0.06375, 0.0536, 0.05951), (-0.00399, -0.01354, -0.01666, -0.0106, 0.02049)),
    "vasti": ((0.01169, 0.04813, 0.06962, 0.0573, 0.05335), (-0.00244, -0.00707, -0.0066, -0.00351, 0.02461)),
}


def mirror(segment: Segment, side: str) -> Segment:
    """Return a segment of the right side on a side: it turns about mirrored axes, so that signs are the right one's."""
    sign = 1.0 if side == "r" else -1.0
    parent = segment.parent if segment.parent in ("pelvis", "torso") else f"{segment.parent}_{side}"
    axes = tuple(
        (f"{name}_{side}", axis if sign > 0 else (-axis[0], -axis[1], axis[2])) for name, axis in segment.coordinates
    )
    place, com = ((v[0], v[1], sign * v[2]) for v in (segment.place, segment.com))
    return Segment(f"{segment.name}_{side}", parent, place, axes, segment.mass, com, segment.inertia)


SEGMENTS = (PELVIS, TORSO, *(mirror(segment, side) for side in "rl" for segment in RIGHT))
FREEDOMS = tuple(name for x in SEGMENTS for name in (*(axis[0] for axis in x.coordinates), *x.slides))


@dataclass(frozen=True)
class Muscle:
    """A muscle, whose points are given by XML of their kinds."""

    name: str
    strength: float
    fibre: float
    tendon: float
    pennation: float  # deg
    points: tuple[str, ...]


def read_muscles() -> list[Muscle]:
    """Read the table for both legs."""
    rows = [row for row in csv.reader(TABLE.read_text("utf-8").splitlines()) if not row[0].startswith("#")]
    found = []
    for side in "rl":
        for name, strength, fibre, tendon, pennation, *rest in rows:
            own = f"{name}_{side}"
            points = tuple(_write_points(own, rest, side))
            found.append(Muscle(own, float(strength), float(fibre), float(tendon), float(pennation), points))
    return found


def _write_points(name: str, rest: list[str], side: str) -> Iterator[str]:
    sign = 1.0 if side == "r" else -1.0
    while rest:
        if rest[0] == "kneecap":
            kind, z = rest[1], float(rest[2])
            yield _move(f"{name}_end", side, *KNEECAP[kind], sign * z)
            rest = rest[3:]
            continue
        body, (x, y, z), rest = rest[0], map(float, rest[1:4]), rest[4:]
        where = body if body == "pelvis" else f"{body}_{side}"
        yield (
            f'<PathPoint name="{name}_p{len(rest)}"><socket_parent_frame>/bodyset/{where}</socket_parent_frame>'
            f"<location>{x} {y} {sign * z}</location></PathPoint>"
        )


def _move(name: str, side: str, x: tuple[float, ...], y: tuple[float, ...], z: float) -> str:
    def bend(coefficients: tuple[float, ...]) -> str:
        numbers = " ".join(map(str, coefficients))
        return f"<PolynomialFunction><coefficients>{numbers}</coefficients></PolynomialFunction>"

    places = {"x": bend(x), "y": bend(y), "z": f"<Constant><value>{z}</value></Constant>"}
    joint = f"/jointset/to_tibia_{side}/knee_angle_{side}"
    parts = "".join(
        f"<{k}_location>{function}</{k}_location><socket_{k}_coordinate>{joint}</socket_{k}_coordinate>"
        for k, function in places.items()
    )
    frame = f"<socket_parent_frame>/bodyset/tibia_{side}</socket_parent_frame>"
    return f'<MovingPathPoint name="{name}">{frame}{parts}</MovingPathPoint>'


def _write_joint(segment: Segment) -> str:
    parent = "/ground" if segment.parent == "ground" else f"/bodyset/{segment.parent}"
    names = [name for name, _ in segment.coordinates] + list(segment.slides)
    coordinates = "".join(f'<Coordinate name="{name}"/>' for name in names)
    line = "<LinearFunction><coefficients>1 0</coefficients></LinearFunction>"
    still = "<Constant><value>0</value></Constant>"
    spare = [(0, 1, 0), (1, 0, 0), (0, 0, 1)]
    axes = [(name, axis, line) for name, axis in segment.coordinates]
    axes += [("", axis, still) for axis in spare if all(axis != a for _, a, _ in axes)]
    slides = [*segment.slides] or ["", "", ""]
    text = ""
    for k, (name, axis, function) in enumerate(axes[:3], 1):
        text += _write_axis(f"rotation{k}", name, axis, function)
    for k, (name, axis) in enumerate(zip(slides, [(1, 0, 0), (0, 1, 0), (0, 0, 1)], strict=True), 1):
        text += _write_axis(f"translation{k}", name, axis, line if name else still)
    place = " ".join(map(str, segment.place))
    return (
        f'<CustomJoint name="to_{segment.name}"><socket_parent_frame>outer</socket_parent_frame>'
        f"<socket_child_frame>/bodyset/{segment.name}</socket_child_frame><coordinates>{coordinates}</coordinates>"
        f'<frames><PhysicalOffsetFrame name="outer"><socket_parent>{parent}</socket_parent>'
        f"<translation>{place}</translation><orientation>0 0 0</orientation></PhysicalOffsetFrame></frames>"
        f"<SpatialTransform>{text}</SpatialTransform></CustomJoint>"
    )


def _write_axis(kind: str, coordinate: str, axis: tuple[float, ...], function: str) -> str:
    direction = " ".join(map(str, axis))
    return (
        f'<TransformAxis name="{kind}"><coordinates>{coordinate}</coordinates><axis>{direction}</axis>'
        f"{function}</TransformAxis>"
    )


def _write_body(segment: Segment) -> str:
    com, inertia = (" ".join(map(str, x)) for x in (segment.com, (*segment.inertia, 0, 0, 0)))
    numbers = f"<mass>{segment.mass}</mass><mass_center>{com}</mass_center><inertia>{inertia}</inertia>"
    return f'<Body name="{segment.name}">{numbers}</Body>'


def _write_muscle(muscle: Muscle) -> str:
    points = "".join(muscle.points)
    return (
        f'<DeGrooteFregly2016Muscle name="{muscle.name}">'
        f"<GeometryPath><PathPointSet><objects>{points}</objects></PathPointSet></GeometryPath>"
        f"<max_isometric_force>{muscle.strength}</max_isometric_force>"
        f"<optimal_fiber_length>{muscle.fibre}</optimal_fiber_length>"
        f"<tendon_slack_length>{muscle.tendon}</tendon_slack_length>"
        f"<pennation_angle_at_optimal>{muscle.pennation * 0.017453292519943295}</pennation_angle_at_optimal>"
        "<fiber_damping>0.01</fiber_damping><ignore_tendon_compliance>true</ignore_tendon_compliance>"
        "</DeGrooteFregly2016Muscle>"
    )


def _write_motor(coordinate: str) -> str:
    return (
        f'<CoordinateActuator name="motor_{coordinate}"><coordinate>{coordinate}</coordinate>'
        "<optimal_force>1</optimal_force></CoordinateActuator>"
    )


def write_body() -> str:
    """Write the file."""
    forces = [*map(_write_motor, FREEDOMS), *map(_write_muscle, read_muscles())]
    sets = (
        ("BodySet", map(_write_body, SEGMENTS)),
        ("JointSet", map(_write_joint, SEGMENTS)),
        ("ForceSet", forces),
    )
    text = "\n".join(
        f'<{tag} name="{tag.lower()}"><objects>\n' + "\n".join(rows) + f"\n</objects></{tag}>" for tag, rows in sets
    )
    head = '<?xml version="1.0" encoding="UTF-8" ?>\n<OpenSimDocument Version="40000">\n'
    return f'{head}<Model name="body">\n<gravity>0 -9.81 0</gravity>\n{text}\n</Model></OpenSimDocument>\n'
