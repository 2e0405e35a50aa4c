"""The vocabulary of OpenSim's models: the elements that its versions 2.3 to 4 write where they describe motion.

Source: OpenSim's documentation of its classes and their properties.
"""

from __future__ import annotations

from mbsgen.importing.osim.contacts import BLUNT, HALF_SPACE, PARAMETERS, SETS, SMOOTH, SPHERE
from mbsgen.importing.osim.forces import ACTUATORS, FORMULA, LIMIT, SPRING
from mbsgen.importing.osim.functions import FUNCTIONS
from mbsgen.importing.osim.joints import JOINTS
from mbsgen.importing.osim.muscles import PAIRS, PATHS, POINTS, SHAPES, SURFACES
from mbsgen.importing.osim.pushes import CURVES, FORMULAS, NUMBERS, PUSHES
from mbsgen.importing.osim.pushes import SETS as TIMED
from mbsgen.importing.vocabulary import Part, Place, Vocabulary, place

_SHOWN = "VisibleObject FrameGeometry frame_geometry attached_geometry Appearance display"
_VECTORS = "location=value orientation=value"
_BOTH = " ".join(f"{name}_body_{k}=value" for name in ("location", "orientation") for k in (1, 2))
_FUNCTIONS = " ".join(f"{name}=function" for name in FUNCTIONS)
_MUSCLES = (
    "Thelen2003Muscle_Deprecated Schutte1993Muscle_Deprecated Delp1990Muscle_Deprecated Millard2012AccelerationMuscle "
    "McKibbenActuator"
)
_CONTACTS = "ElasticFoundationForce MeyerFregly2016Force"
_MATERIAL = " ".join(
    f"{x}=value" for x in ["stiffness", "dissipation", "static_friction", "dynamic_friction", "viscous_friction"]
)
_SPRINGS = "TwoFrameLinker CoordinateLinearStop"
_ACTUATORS = "ClutchedPathSpring SpatialForce ExternalForce StationPlaneContactForce"
_ENDS = " ".join(f"socket_frame{k}=value socket_body_{k}=value body_{k}=value" for k in (1, 2))


def _out(names: str, text: str) -> dict[str, str | Part]:
    return dict.fromkeys(names.split(), text)


PLACES: dict[str, Place] = {
    "OpenSimDocument": place(read="@Version Model"),
    "Model": place(
        read="@name gravity=value length_units=value force_units=value Ground=ground BodySet=bodies JointSet=joints "
        "ConstraintSet=constraints ForceSet=forces MarkerSet=markers ControllerSet=controllers ComponentSet=components "
        "ContactGeometrySet=geometry components=loose",
        idle="credits publications defaults assembly_accuracy ProbeSet ModelVisualPreferences "
        "OutputReporterSet AnalysisSet groups WrapObjectSet SimbodyEngine",
    ),
    "value": place(read="#text"),
    "ground": place(read="@name components=parts WrapObjectSet=surfaces", idle=_SHOWN),
    "bodies": place(read="@name objects=bodies_in", idle="groups"),
    "bodies_in": place(read="Body*=body"),
    "body": place(
        read="@name mass=value mass_center=value inertia=value inertia_xx=value inertia_yy=value inertia_zz=value "
        "inertia_xy=value inertia_xz=value inertia_yz=value Joint=joints_in components=parts WrapObjectSet=surfaces",
        idle=_SHOWN,
    ),
    "joints": place(read="@name objects=joints_in", idle="groups"),
    "joints_in": place(read=" ".join(f"{name}*=joint" for name in JOINTS)),
    "joint": place(
        read="@name socket_parent_frame=value socket_child_frame=value parent_body=value location_in_parent=value "
        f"orientation_in_parent=value {_VECTORS} CoordinateSet=coordinates coordinates=coordinates_in frames=parts "
        "reverse=value SpatialTransform=transform",
        idle="components",
    ),
    "parts": place(
        read="PhysicalOffsetFrame*=offset", idle="Station Marker ContactSphere ContactHalfSpace ContactMesh"
    ),
    "offset": place(
        read="@name socket_parent=value translation=value orientation=value components=parts WrapObjectSet=surfaces",
        idle=_SHOWN,
    ),
    "surfaces": place(read="@name objects=surfaces_in", idle="groups"),
    "surfaces_in": place(
        read=" ".join(f"{name}*=surface" for name in SURFACES),
        idle="WrapSphereObst WrapCylinderObst WrapDoubleCylinderObst",  # paths warn of them
    ),
    "surface": place(
        read="@name active=value xyz_body_rotation=value translation=value quadrant=value radius=value length=value "
        "dimensions=value inner_radius=value outer_radius=value",
        idle="VisibleObject Appearance color display_preference",
    ),
    "coordinates": place(read="@name objects=coordinates_in", idle="groups"),
    "coordinates_in": place(read="Coordinate*=coordinate"),
    "coordinate": place(
        read="@name default_value=value range=value locked=value prescribed=value",
        idle="motion_type default_speed_value clamped prescribed_function is_free_to_satisfy_constraints",
    ),
    "transform": place(read="@name TransformAxis*=axis"),
    "axis": place(read=f"@name coordinates=value axis=value function=functions {_FUNCTIONS}"),
    "functions": place(read=f"@name {_FUNCTIONS}"),
    "function": place(
        read="@name coefficients=value value=value x=value y=value scale=value amplitude=value omega=value phase=value "
        f"offset=value half_order=value error_variance=value function=functions {_FUNCTIONS}",
        idle="weights",
    ),
    "constraints": place(read="@name objects=constraints_in", idle="groups"),
    "constraints_in": place(
        read="CoordinateCouplerConstraint*=coupler WeldConstraint*=closure PointConstraint*=closure",
        warned=_out(
            "ConstantDistanceConstraint PointOnLineConstraint RollingOnSurfaceConstraint",
            "this constraint is not part of the model; its bodies move without it",
        ),
    ),
    "coupler": place(
        read="@name isEnforced=value isDisabled=value coupled_coordinates_function=functions scale_factor=value "
        "independent_coordinate_names=value dependent_coordinate_name=value"
    ),
    "closure": place(
        read="@name isEnforced=value isDisabled=value socket_frame1=value socket_frame2=value socket_body_1=value "
        f"socket_body_2=value body_1=value body_2=value frames=parts {_BOTH}"
    ),
    "forces": place(read="@name objects=forces_in", idle="groups"),
    "forces_in": place(
        read=" ".join(f"{name}*=actuator" for name in ACTUATORS)
        + f" {SPRING}*=spring {LIMIT}*=limit {FORMULA}*=formula {SMOOTH}*=smooth {BLUNT}*=blunt "
        + " ".join(f"{name}*=pair" for name in PAIRS)
        + " "
        + " ".join(f"{name}*=push" for name in PUSHES)
        + " "
        + " ".join(f"{name}*=line" for name in PATHS),
        warned=_out(_MUSCLES, "muscles are not part of the model: its force is left out")
        | _out(_CONTACTS, "this contact is not part of the model; describe it under contacts")
        | _out(_SPRINGS, "this force is not part of the model; describe it under forces or wrenches")
        | _out(_ACTUATORS, "this force is not part of the model; describe it under wrenches"),
    ),
    "actuator": place(
        read="@name appliesForce=value isDisabled=value coordinate=value optimal_force=value min_control=value "
        "max_control=value",
        idle="activation_time_constant default_activation",
    ),
    "spring": place(
        read="@name appliesForce=value isDisabled=value coordinate=value stiffness=value rest_length=value "
        "viscosity=value"
    ),
    "formula": place(read="@name appliesForce=value isDisabled=value coordinate=value expression=value"),
    "pair": place(
        read="@name appliesForce=value isDisabled=value socket_body1=value socket_body2=value body1=value body2=value "
        "point1=value point2=value stiffness=value rest_length=value expression=value bodyA=value bodyB=value "
        "pointA=value pointB=value points_are_global=value optimal_force=value",
        idle="min_control max_control",
    ),
    "push": place(
        read=f"@name appliesForce=value isDisabled=value {_ENDS} frames=parts {_BOTH} "
        + " ".join(f"{x}=value" for x in (*NUMBERS, *FORMULAS))
        + " "
        + " ".join(f"{x}=curved" for x in CURVES)
        + " bodyA=value bodyB=value torque_is_global=value axis=value optimal_force=value body=value point=value "
        "point_is_global=value direction=value force_is_global=value socket_body=value spatial_force_is_global=value "
        "socket_frame=value pointIsGlobal=value forceIsGlobal=value FunctionSet*=timed "
        + " ".join(f"{x}=timed" for x in TIMED),
        idle="min_control max_control moment_visual_scale force_visual_scale visual_aspect_ratio",
    ),
    "curved": place(read=_FUNCTIONS + " function=functions"),
    "timed": place(read="@name objects=functions_in", idle="groups"),
    "functions_in": place(read=" ".join(f"{name}*=function" for name in FUNCTIONS)),
    "limit": place(
        read="@name appliesForce=value isDisabled=value coordinate=value upper_stiffness=value upper_limit=value "
        "lower_stiffness=value lower_limit=value damping=value transition=value",
        idle="compute_dissipation_energy",
    ),
    "smooth": place(
        read=f"@name appliesForce=value isDisabled=value socket_sphere=value socket_half_space=value {_MATERIAL} "
        "transition_velocity=value constant_contact_force=value hertz_smoothing=value hunt_crossley_smoothing=value",
        idle="force_visualization_radius force_visualization_scale_factor",
    ),
    "blunt": place(
        read=f"@name appliesForce=value isDisabled=value {SETS}=materials contact_parameters=materials "
        "transition_velocity=value"
    ),
    "materials": place(read="@name objects=materials_in", idle="groups"),
    "materials_in": place(read=f"{PARAMETERS}*=material ContactParameters*=material"),
    "material": place(read=f"@name geometry=value {_MATERIAL}"),
    "geometry": place(read="@name objects=geometry_in", idle="groups"),
    "geometry_in": place(
        read=f"{SPHERE}*=shape {HALF_SPACE}*=shape",
        idle="ContactMesh",  # contacts warn of it
    ),
    "shape": place(
        read="@name socket_frame=value body_name=value location=value orientation=value radius=value",
        idle="Appearance display_preference color",
    ),
    "line": place(
        read="@name appliesForce=value isDisabled=value GeometryPath=path path=paths max_isometric_force=value "
        "optimal_fiber_length=value tendon_slack_length=value pennation_angle_at_optimal=value fiber_damping=value "
        "max_contraction_velocity=value ignore_tendon_compliance=value ignore_passive_fiber_force=value "
        "active_force_width_scale=value passive_fiber_strain_at_one_norm_force=value FmaxTendonStrain=value "
        "tendon_strain_at_one_norm_force=value FmaxMuscleStrain=value FiberForceLengthCurve=curve "
        "TendonForceLengthCurve=curve ActiveForceLengthCurve=curve ForceVelocityCurve=curve resting_length=value "
        "stiffness=value dissipation=value KshapeActive=value KshapePassive=value Af=value Flen=value "
        "fv_linear_extrap_threshold=value pcsa_force=value force_length_curve=functions linear_stiffness=value "
        f"transition_strain=value damping_coefficient=value slack_length=value optimal_force=value {_FUNCTIONS}",
        idle="min_control max_control default_activation default_fiber_length "
        "default_normalized_tendon_force activation_time_constant deactivation_time_constant "
        "ignore_activation_dynamics tendon_compliance_dynamics_mode activation_dynamics_smoothing minimum_activation "
        "maximum_pennation_angle "
        "active_force_length_curve passive_force_length_curve force_velocity_curve",
    ),
    "curve": place(
        read="@name strain_at_one_norm_force=value "
        + " ".join(sorted({f"{tag}=value" for shape in SHAPES.values() for outer, tag in shape.values() if outer})),
    ),
    "paths": place(read="GeometryPath=path"),
    "path": place(
        read="@name PathPointSet=pathpoints PathWrapSet=wraps", idle="VisibleObject Appearance display default_color"
    ),
    "pathpoints": place(read="@name objects=points_in", idle="groups"),
    "points_in": place(read=" ".join(f"{name}*=point" for name in POINTS)),
    "point": place(
        read="@name location=value socket_parent_frame=value body=value range=value coordinate=value "
        "socket_coordinate=value "
        + " ".join(f"{x}_location=functions {x}_coordinate=value socket_{x}_coordinate=value" for x in "xyz"),
        idle="VisibleObject Appearance",
    ),
    "wraps": place(read="@name objects=wraps_in", idle="groups"),
    "wraps_in": place(read="PathWrap*=wrap"),
    "wrap": place(read="@name wrap_object=value method=value range=value"),
    "markers": place(read="@name objects=markers_in", idle="groups"),
    "markers_in": place(read="Marker*=marker"),
    "marker": place(read="@name socket_parent_frame=value body=value location=value", idle="fixed"),
    "controllers": place(read="@name objects=controllers_in", idle="groups"),
    "controllers_in": place(
        warned=_out(
            "ControlSetController PrescribedController ToyReflexController CMC ProsthesisController MuscleController",
            "controllers are not part of the model",
        )
    ),
    "components": place(read="@name objects=loose", idle="groups"),
}
_LOOSE = ("bodies", "joints", "constraints", "forces", "geometry", "markers", "controllers")
PLACES["loose"] = dict(PLACES["parts"]) | {tag: part for x in _LOOSE for tag, part in PLACES[f"{x}_in"].items()}

VOCABULARY = Vocabulary(PLACES)
