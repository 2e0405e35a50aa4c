"""Muscles and springs along paths in OpenSim's files, in the forms of versions 3 and 4, with numbers of our own."""

from __future__ import annotations

from tests.mbsgen.importing.osim_files import LEG, LINE, SPLINE, Link, write_model

Place = tuple[str, str]  # a body, and a location


def _frame(body: str, version: int) -> str:
    if version < 40000:
        return f"<body>{body}</body>"
    path = "/ground" if body == "ground" else f"/bodyset/{body}"
    return f"<socket_parent_frame>{path}</socket_parent_frame>"


def fixed(name: str, body: str, location: str, version: int = 40000) -> str:
    return f'<PathPoint name="{name}">{_frame(body, version)}<location>{location}</location></PathPoint>'


def conditional(name: str, body: str, location: str, coordinate: str, bounds: str, version: int = 40000) -> str:
    tag = "coordinate" if version < 40000 else "socket_coordinate"
    path = coordinate if version < 40000 else f"/jointset/to_{body}/{coordinate}"
    return (
        f'<ConditionalPathPoint name="{name}">{_frame(body, version)}<location>{location}</location>'
        f"<{tag}>{path}</{tag}><range>{bounds}</range></ConditionalPathPoint>"
    )


def moving(name: str, body: str, coordinate: str, functions: tuple[str, str, str], version: int = 40000) -> str:
    socket = "" if version < 40000 else "socket_"
    path = coordinate if version < 40000 else f"/jointset/to_{body}/{coordinate}"
    places = "".join(
        f"<{x}_location>{f}</{x}_location><{socket}{x}_coordinate>{path}</{socket}{x}_coordinate>"
        for x, f in zip("xyz", functions, strict=True)
    )
    return f'<MovingPathPoint name="{name}">{_frame(body, version)}{places}</MovingPathPoint>'


def line(kind: str, name: str, points: str, more: str = "", wraps: str = "") -> str:
    return (
        f'<{kind} name="{name}"><GeometryPath><PathPointSet><objects>{points}</objects></PathPointSet>'
        f"<PathWrapSet><objects>{wraps}</objects></PathWrapSet></GeometryPath>{more}</{kind}>"
    )


def numbers(**given: object) -> str:
    return "".join(f"<{key}>{str(x).lower() if isinstance(x, bool) else x}</{key}>" for key, x in given.items())


def write_forces(version: int = 40000) -> str:
    """Write muscles of all kinds and a spring."""
    z = "<Constant><value>0.02</value></Constant>"
    via = fixed("a", "ground", "0.1 0.2 0.05", version), fixed("b", "femur", "0.05 -0.1 0.02", version)
    knee = conditional("c", "tibia", "0.04 -0.02 0.01", "knee", "-0.3 0.4", version)
    end = moving("d", "tibia", "knee", (SPLINE, LINE.replace("1 0<", "0.1 0.02<"), z), version)
    foot = fixed("e", "foot", "0.03 -0.1 0.02", version)
    own = numbers(max_isometric_force=900, optimal_fiber_length=0.2, tendon_slack_length=0.15)
    degroote = numbers(
        pennation_angle_at_optimal=0.2, fiber_damping=0.01, active_force_width_scale=1.5, max_contraction_velocity=12,
        passive_fiber_strain_at_one_norm_force=0.7, tendon_strain_at_one_norm_force=0.05,
        ignore_tendon_compliance=True, ignore_passive_fiber_force=True,
    )  # fmt: skip
    millard = numbers(fiber_damping=0.05, default_fiber_length=0.1) + (
        "<FiberForceLengthCurve><strain_at_one_norm_force>0.65</strain_at_one_norm_force></FiberForceLengthCurve>"
        "<TendonForceLengthCurve><strain_at_one_norm_force>0.04</strain_at_one_norm_force></TendonForceLengthCurve>"
    )
    thelen = numbers(FmaxMuscleStrain=0.5, FmaxTendonStrain=0.033)
    springs = numbers(resting_length=0.3, stiffness=250, dissipation=0.1)
    return "\n".join(
        (
            line("DeGrooteFregly2016Muscle", "long", "".join((*via, knee, foot)), own + degroote),
            line("Millard2012EquilibriumMuscle", "two-joints", via[1] + knee + end, own + millard),
            line("Thelen2003Muscle", "short.1", via[0] + end, own + thelen),
            line("RigidTendonMuscle", "rigid", via[1] + knee + foot, own),
            line("PathSpring", "strap", via[0] + foot, springs),
        )
    )


CASES = {
    "leg": write_model(LEG, forces=write_forces()),
    "leg_3": write_model(LEG, version=30000, forces=write_forces(30000)),
}


def surface(kind: str, name: str, place: str, turn: str = "0 0 0", quadrant: str = "all", length: float = 1.0) -> str:
    numbers = f"<length>{length}</length>" if kind == "WrapCylinder" else ""
    return (
        f'<{kind} name="{name}"><active>true</active><translation>{place}</translation><xyz_body_rotation>{turn}'
        f"</xyz_body_rotation><quadrant>{quadrant}</quadrant><radius>0.1</radius>{numbers}</{kind}>"
    )


def around(name: str, span: str = "-1 -1", method: str = "hybrid") -> str:
    return (
        f'<PathWrap name="w"><wrap_object>{name}</wrap_object><method>{method}</method><range>{span}</range></PathWrap>'
    )


def write_wrapped() -> str:
    """Write a plane leg with springs around cylinders across the plane and spheres, where OpenSim's path is exact."""
    plane = {"outer": ("0 -0.4 0", "0 0 0"), "inner": ("0 0 0", "0 0 0")}
    links = (Link("thigh", coordinates=("hip",), **plane), Link("shank", "PinJoint", "thigh", ("knee",), **plane))
    shapes = {
        "thigh": surface("WrapCylinder", "knee", "0 -0.42 0", quadrant="x")
        + surface("WrapCylinder", "back", "0.02 -0.37 0", "0 0 0.3", "-x")
        + surface("WrapSphere", "ball", "0.01 -0.4 0.03", "0.3 0.2 0.1")
        + surface("WrapSphere", "cap", "0.02 -0.41 0.02", "0.1 0.2 0.4", "x"),
        "shank": surface("WrapCylinder", "any", "0.01 -0.05 0"),
    }
    begin, end = fixed("a", "thigh", "0.03 -0.15 0.02"), fixed("b", "shank", "0.02 -0.25 0.02")
    far = fixed("c", "ground", "0.12 -0.2 0.02")
    rows = (
        ("front", begin + end, around("knee")),
        ("behind", begin + end, around("back")),
        ("near", begin + end, around("any")),
        ("ball", begin + end, around("ball")),
        ("cap", begin + end, around("cap")),
        ("three", far + begin + end, around("knee")),
        ("range", far + begin + end, around("any", "2 3")),
        ("two", far + begin + end, around("cap", "1 2") + around("ball", "2 -1")),
    )
    springs = numbers(resting_length=0.3, stiffness=250, dissipation=0.1)
    text = write_model(links, forces="".join(line("PathSpring", *row[:2], springs, row[2]) for row in rows))
    for body, inner in shapes.items():
        head = f'<Body name="{body}">'
        text = text.replace(
            head, f'{head}<WrapObjectSet name="wrapobjectset"><objects>{inner}</objects></WrapObjectSet>'
        )
    return text


CASES["wrapped"] = write_wrapped()


def shape(kind: str, name: str, place: str, turn: str, quadrant: str = "all", **sizes: str) -> str:
    return (
        f'<{kind} name="{name}"><active>true</active><translation>{place}</translation><xyz_body_rotation>{turn}'
        f"</xyz_body_rotation><quadrant>{quadrant}</quadrant>{numbers(**sizes)}</{kind}>"
    )


def write_shaped() -> str:
    """Write a spatial leg with springs around ellipsoids by all methods, and through tori."""
    spatial = {"outer": ("0 -0.4 0", "0.3 0.1 0"), "inner": ("0 0 0", "0 0.2 0")}
    links = (Link("thigh", coordinates=("hip",), **spatial), Link("shank", "PinJoint", "thigh", ("knee",), **spatial))
    eggs = {"egg": "all", "behind": "-x"}
    rings = {"ring": "all", "half": "x"}
    shapes = "".join(
        shape("WrapEllipsoid", name, "0.01 -0.4 0.02", "0.3 0.2 0.1", side, dimensions="0.1 0.07 0.12")
        for name, side in eggs.items()
    ) + "".join(
        shape("WrapTorus", name, "0.02 -0.38 0.03", "1.5 0.1 0.2", side, inner_radius="0.02", outer_radius="0.06")
        for name, side in rings.items()
    )
    begin, end = fixed("a", "thigh", "0.03 -0.12 0.02"), fixed("b", "shank", "0.02 -0.28 0.02")
    far = fixed("c", "ground", "0.12 -0.2 0.02")
    rows = (
        *((f"{name}_{method}", begin + end, around(name, method=method)) for name in eggs for method in METHODS),
        *((name, begin + end, around(name)) for name in rings),
        ("three", far + begin + end, around("egg")),
    )
    springs = numbers(resting_length=0.3, stiffness=250, dissipation=0.1)
    text = write_model(links, forces="".join(line("PathSpring", *row[:2], springs, row[2]) for row in rows))
    head = '<Body name="thigh">'
    return text.replace(head, f'{head}<WrapObjectSet name="wrapobjectset"><objects>{shapes}</objects></WrapObjectSet>')


METHODS = ("hybrid", "midpoint", "axial")
CASES["shaped"] = write_shaped()
