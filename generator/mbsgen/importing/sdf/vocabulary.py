"""The vocabulary of SDF: the elements and attributes of its schemas, versions 1.0 to 1.12, and Drake's extensions.

Version 1.0 writes most values as attributes; what a later version has as an element is warned of as an attribute.
Source: the descriptions of SDFormat (sdformat.org/spec), and Drake's list of custom elements.
"""

from __future__ import annotations

from collections.abc import Mapping

from mbsgen.importing.vocabulary import Part, Place, Vocabulary, place, warning

GRAVITY_IN_PHYSICS = (1, 5)  # the last version that has the gravity of a world under its physics
AXES_BY_FLAG = (1, 6)  # the last version that has use_parent_model_frame

_DRAKE = "drake:linear_bushing_rpy drake:linear_spring_damper drake:tendon_constraint drake:ball_constraint"
_OLD = "as an attribute is not read since version 1.2: write it as an element"
_BESIDE = "belongs into <axis>; here it is left out"
_VALUE = "#text"
_MEDIUM = "a resistance of the surrounding medium, which is left out"


def _old(*names: str) -> dict[str, str | Part]:
    return {f"@{name}": f"{name} {_OLD}" for name in names}


def _out(*names: str) -> dict[str, str | Part]:
    return {name: f"{name} is not part of the model" for name in names}


_INCLUDE = {"include": ("an included model, which is not read", "write the model's text in its place")}
_SELDOM: dict[str, str | Part] = {
    "origin": "origin is not read since version 1.2: give a <pose>",
    "enable_wind": "enable_wind: the wind is not part of the model",
}

PLACES: dict[str, Place] = {
    "sdf": place(read="@version world model*", idle="light actor", refused=_INCLUDE, warned=_out("plugin")),
    "world": place(
        read="@name gravity=value physics* model* joint* frame*",
        idle="light gui scene audio magnetic_field atmosphere spherical_coordinates",
        refused=_INCLUDE,
        warned=_out("plugin", "actor", "road", "state", "population")
        | {"wind": "wind is not part of the model", "particle_emitter": "particle_emitter is not part of the model"},
    ),
    "physics": place(
        idle="@name @default @type @update_rate max_step_size real_time_factor real_time_update_rate update_rate "
        "max_contacts magnetic_field simbody bullet ode dart",
        warned={
            "gravity": warning("the gravity of a world is no part of its physics since version 1.6, and is left out")
        },
    ),
    "model": place(
        read="@name @canonical_link @placement_frame static=value pose link* joint* model* frame*",
        idle="self_collide allow_auto_disable @xmlns drake:collision_filter_group light",
        refused=_INCLUDE
        | {
            "drake:joint": ("a drake:joint, which is not read", "give a <joint> of SDF"),
        },
        warned=_out("plugin", "gripper", "model_state", *_DRAKE.split()) | _old("static") | _SELDOM,
    ),
    "frame": place(read="@name @attached_to pose"),
    "pose": place(read=f"{_VALUE} @relative_to @rotation_format @degrees @frame"),
    "value": place(read=_VALUE),
    "link": place(
        read="@name pose inertial",
        idle="visual collision sensor light self_collide must_be_base_link audio_sink audio_source particle_emitter "
        "@self_collide frame",
        warned=_out("plugin", "kinematic", "battery", "projector")
        | {
            "gravity": warning("a link without gravity; here gravity acts on all", "true", "1"),
            "@gravity": warning("a link without gravity; here gravity acts on all", "true", "1"),
            "@kinematic": "kinematic is not part of the model",
            "velocity_decay": f"velocity_decay: {_MEDIUM}",
            "damping": f"damping of a link: {_MEDIUM}",
        }
        | _SELDOM,
    ),
    "inertial": place(
        read="@auto pose mass=value inertia",
        idle="density auto_inertia_params @density frame",
        warned=_out("fluid_added_mass") | _old("mass") | {"origin": "origin is not read: give a <pose>"},
    ),
    "inertia": place(
        read="ixx=value ixy=value ixz=value iyy=value iyz=value izz=value",
        warned=_old("ixx", "ixy", "ixz", "iyy", "iyz", "izz"),
    ),
    "joint": place(
        read="@name @type pose parent=end child=end axis axis2=axis screw_thread_pitch=value thread_pitch=value "
        "physics=solver",
        idle="sensor frame drake:controller_gains",
        warned=_out("plugin")
        | {
            "gearbox_ratio": "of a gearbox, which is not part of the model",
            "gearbox_reference_body": "of a gearbox, which is not part of the model",
            "dynamics": f"dynamics {_BESIDE}",
            "limit": f"limit {_BESIDE}",
            "drake:rotor_inertia": "drake:rotor_inertia is left out; give an armature in the model file",
            "drake:gear_ratio": warning("drake:gear_ratio is left out", "1", "1.0"),
            "drake:mimic": "it follows another joint in Drake; here it moves on its own: give <mimic>",
            "origin": "origin is not read since version 1.2: give a <pose>",
        },
    ),
    "end": place(read=_VALUE, warned=_old("link")),
    "axis": place(
        read="xyz=direction dynamics limit use_parent_model_frame=value mimic",
        warned={
            "initial_position": "the joint begins there in the file; here it begins at 0",
            "damping": "damping belongs into <dynamics>; here it is left out",
            "friction": "friction belongs into <dynamics>; here it is left out",
        }
        | _old("xyz"),
    ),
    "direction": place(read=f"{_VALUE} @expressed_in"),
    "dynamics": place(
        read="damping=value friction=value spring_reference=value spring_stiffness=value",
        warned=_old("damping", "friction", "spring_reference", "spring_stiffness"),
    ),
    "limit": place(
        read="lower=value upper=value effort=value velocity=value",
        idle="stiffness dissipation drake:acceleration",
        warned=_old("lower", "upper", "effort", "velocity"),
    ),
    "mimic": place(read="@joint @axis multiplier=value offset=value reference=value"),
    "solver": place(read="simbody ode", idle="provide_feedback"),
    "simbody": place(read="must_be_loop_joint=value"),
    "ode": place(
        idle="provide_feedback cfm_damping implicit_spring_damper fudge_factor cfm erp limit",
        warned={
            "max_force": "a motor of ODE, which is left out",
            "velocity": "of a motor of ODE, which is left out",
            "bounce": "bouncing at the limits is left out",
            "suspension": "the suspension of a joint in ODE is left out; give a spring",
        },
    ),
}


def _make(places: Mapping[str, Place]) -> Vocabulary:
    return Vocabulary({**PLACES, **places})


_FLAG = {"use_parent_model_frame": "use_parent_model_frame is not part of SDF since version 1.7, and is left out"}
_RECENT = _make({"axis": {**PLACES["axis"], **place(warned=_FLAG)}})
_EARLIER = _make({})
_EARLIEST = _make({"physics": {**PLACES["physics"], **place(read="gravity=value")}})


def choose_vocabulary(version: tuple[int, int]) -> Vocabulary:
    """Return the vocabulary of a version."""
    if version > AXES_BY_FLAG:
        return _RECENT
    return _EARLIEST if version <= GRAVITY_IN_PHYSICS else _EARLIER
