"""Contacts in OpenSim's files, in the forms of versions 3 and 4, with numbers of our own."""

from __future__ import annotations

from tests.mbsgen.importing.osim_files import Link, write_model
from tests.mbsgen.importing.osim_muscle_files import numbers

QUARTER = 1.5707963267948966  # rad
TIBIA = Link("tibia", "PlanarJoint", "ground", ("tilt", "px", "py"))
FOOT, BALL = Link("foot", "PinJoint", "tibia", ("ankle",)), Link("ball", "UniversalJoint", "ground", ("a", "b"))
ROUGH = {"static_friction": 0.9, "dynamic_friction": 0.6, "viscous_friction": 0.3}


def shape(kind: str, name: str, body: str, location: str, version: int = 40000, **more: object) -> str:
    """Write a sphere, or a half space."""
    path = "/ground" if body == "ground" else f"/bodyset/{body}"
    frame = f"<body_name>{body}</body_name>" if version < 40000 else f"<socket_frame>{path}</socket_frame>"
    return f'<{kind} name="{name}">{frame}<location>{location}</location>{numbers(**more)}</{kind}>'


def write_shapes(version: int = 40000) -> str:
    """Write spheres so large that they press in most poses, and half spaces on the ground and on a body."""
    floor = f"0.2 0.1 {-QUARTER}"
    return "".join(
        (
            shape("ContactHalfSpace", "floor", "ground", "0.1 -0.9 0", version, orientation=floor),
            shape("ContactHalfSpace", "plate", "tibia", "0.02 0 0.1", version, orientation="0.2 1.1 -0.5"),
            shape("ContactSphere", "heel", "foot", "0.1 0 0.02", version, radius=0.8, orientation="0.1 0.2 0.3"),
            shape("ContactSphere", "toe", "foot", "-0.1 0 0.02", version, radius=0.7),
            shape("ContactSphere", "other", "ball", "-0.1 0.1 0.02", version, radius=0.9),
        )
    )


def smooth(name: str, sphere: str, plane: str, **given: object) -> str:
    sockets = {"socket_sphere": sphere, "socket_half_space": plane}
    paths = "".join(f"<{key}>/contactgeometryset/{x}</{key}>" for key, x in sockets.items())
    return f'<SmoothSphereHalfSpaceForce name="{name}">{paths}{numbers(**given)}</SmoothSphereHalfSpaceForce>'


def blunt(name: str, materials: dict[str, dict[str, object]], speed: float = 0.3) -> str:
    """Write a HuntCrossleyForce between geometry, each with its material."""
    rows = "".join(
        f"<HuntCrossleyForce::ContactParameters><geometry>{shapes}</geometry>{numbers(**given)}"
        "</HuntCrossleyForce::ContactParameters>"
        for shapes, given in materials.items()
    )
    tag = "HuntCrossleyForce::ContactParametersSet"
    held = f'<{tag} name="contact_parameters"><objects>{rows}</objects></{tag}>'
    return (
        f'<HuntCrossleyForce name="{name}">{held}<transition_velocity>{speed}</transition_velocity></HuntCrossleyForce>'
    )


def write_contacts(forces: str, version: int = 40000) -> str:
    shapes = write_shapes(version)
    held = f'<ContactGeometrySet name="contactgeometryset"><objects>{shapes}</objects></ContactGeometrySet>'
    return write_model((TIBIA, FOOT, BALL), version=version, forces=forces, more=held)


STEEL: dict[str, object] = {"stiffness": 3e3, "dissipation": 0.1, **ROUGH}
RUBBER: dict[str, object] = {"stiffness": 1e3, "dissipation": 0.3, "static_friction": 0.4, "dynamic_friction": 0.4}
CASES: dict[str, str] = {
    "smooth": write_contacts(
        smooth("one", "heel", "floor", stiffness=3e3, dissipation=0.3, transition_velocity=0.5, **ROUGH)
    ),
    "lossless": write_contacts(
        smooth("one", "toe", "floor", stiffness=2e3, constant_contact_force=1e-3, hertz_smoothing=20)
    ),
    "moving": write_contacts(
        smooth("one", "other", "plate", stiffness=1e3, dissipation=0.2, hunt_crossley_smoothing=5, dynamic_friction=0.5)
    ),
    "spheres": write_contacts(blunt("all", {"heel other": STEEL})),
    "shares": write_contacts(blunt("all", {"floor": STEEL, "heel toe": RUBBER})),
    "releasing": write_contacts(blunt("all", {"floor heel toe": {**STEEL, "dissipation": 3.0}})),
    "old": write_contacts(blunt("all", {"plate other": RUBBER}), version=30000),
}
