"""Bushings, actuators of bodies and prescribed forces in OpenSim's files, with numbers of our own."""

from __future__ import annotations

from tests.mbsgen.importing.osim_files import BALL, SPLINE, Link, write_model
from tests.mbsgen.importing.osim_muscle_files import numbers

LINKS = (
    BALL[0],
    Link("arm", "PinJoint", "ball", ("elbow",)),
    Link("hand", "UniversalJoint", "arm", ("wrist", "bend")),
)
STIFF = {
    "rotational_stiffness": "11 12 13",
    "translational_stiffness": "210 220 230",
    "rotational_damping": "0.4 0.5 0.6",
    "translational_damping": "3 4 5",
}
DAMPING = {key: x for key, x in STIFF.items() if "damping" in key}


def _frame(name: str, body: str, place: str, turn: str) -> str:
    path = "/ground" if body == "ground" else f"/bodyset/{body}"
    return (
        f'<PhysicalOffsetFrame name="{name}"><socket_parent>{path}</socket_parent><translation>{place}</translation>'
        f"<orientation>{turn}</orientation></PhysicalOffsetFrame>"
    )


def bushing(kind: str, name: str, bodies: tuple[str, str], more: str, version: int = 40000) -> str:
    """Write a bushing between frames on two bodies."""
    places, turns = ("0.1 0.2 0.05", "-0.05 0.1 0.2"), ("0.2 -0.1 0.3", "0.1 0.3 -0.2")
    if version < 40000:
        ends = "".join(
            f"<body_{k}>{body}</body_{k}><location_body_{k}>{place}</location_body_{k}>"
            f"<orientation_body_{k}>{turn}</orientation_body_{k}>"
            for k, (body, place, turn) in enumerate(zip(bodies, places, turns, strict=True), 1)
        )
        return f'<{kind} name="{name}">{ends}{more}</{kind}>'
    ends = "".join(f"<socket_frame{k}>end{k}</socket_frame{k}>" for k in (1, 2))
    frames = "".join(_frame(f"end{k}", *given) for k, given in enumerate(zip(bodies, places, turns, strict=True), 1))
    return f'<{kind} name="{name}">{ends}<frames>{frames}</frames>{more}</{kind}>'


def three(name: str, *functions: str) -> str:
    return f'<FunctionSet name="{name}"><objects>{"".join(functions)}</objects></FunctionSet>'


def constant(value: float) -> str:
    return f"<Constant><value>{value}</value></Constant>"


SINE = "<Sine><amplitude>3</amplitude><omega>2</omega><phase>0.4</phase><offset>1</offset></Sine>"
LINE = "<LinearFunction><coefficients>2 5</coefficients></LinearFunction>"
CURVE = SPLINE
FORMULAS = numbers(
    Mx_expression="12*theta_x+3*theta_x^3", My_expression="9*theta_y*exp(delta_z)", Mz_expression="theta_z-theta_x",
    Fx_expression="150*delta_x", Fy_expression="120*delta_y+30*delta_x*delta_y", Fz_expression="90*sin(delta_z)",
)  # fmt: skip
CURVES = (
    f"<m_x_theta_x_function>{CURVE}</m_x_theta_x_function><m_z_theta_z_function>{LINE}</m_z_theta_z_function>"
    f"<f_y_delta_y_function>{CURVE}</f_y_delta_y_function><f_z_delta_z_function>{LINE}</f_z_delta_z_function>"
)
BETWEEN = ("ball", "hand")
CASES: dict[str, str] = {
    "bushing": write_model(LINKS, forces=bushing("BushingForce", "soft", BETWEEN, numbers(**STIFF))),
    "old": write_model(LINKS, version=30000, forces=bushing("BushingForce", "soft", BETWEEN, numbers(**STIFF), 30000)),
    "grounded": write_model(LINKS, forces=bushing("BushingForce", "soft", ("hand", "ground"), numbers(**STIFF))),
    "formulas": write_model(
        LINKS, forces=bushing("ExpressionBasedBushingForce", "soft", BETWEEN, FORMULAS + numbers(**DAMPING))
    ),
    "curves": write_model(
        LINKS, forces=bushing("FunctionBasedBushingForce", "soft", BETWEEN, CURVES + numbers(**DAMPING))
    ),
    "torques": write_model(
        LINKS,
        forces="".join(
            f'<TorqueActuator name="{name}">{numbers(**given)}</TorqueActuator>'
            for name, given in {
                "both": {"bodyA": "ball", "bodyB": "hand", "axis": "1 2 0.5", "optimal_force": 20},
                "own": {"bodyA": "hand", "bodyB": "ball", "axis": "1 -2 1", "torque_is_global": False},
                "one": {
                    "bodyA": "ground",
                    "bodyB": "hand",
                    "axis": "0 0 3",
                    "torque_is_global": False,
                    "optimal_force": 7,
                },
                "floor": {"bodyA": "arm", "bodyB": "ground", "axis": "0 1 1", "optimal_force": 9},
            }.items()
        ),
    ),
    "points": write_model(
        LINKS,
        forces="".join(
            f'<{kind} name="{name}">{numbers(**given)}</{kind}>'
            for kind, name, given in (
                ("PointActuator", "own", {"body": "hand", "point": "0.1 0.2 0", "direction": "1 2 3"}),
                (
                    "PointActuator",
                    "mixed",
                    {"body": "hand", "point": "0.1 0 0.3", "force_is_global": True, "optimal_force": 15},
                ),
                (
                    "PointActuator",
                    "ground",
                    {"body": "arm", "point": "0.1 0 0.3", "point_is_global": True, "force_is_global": True},
                ),
                (
                    "PointToPointActuator",
                    "pair",
                    {"bodyA": "ball", "bodyB": "hand", "pointA": "0.3 0 0", "pointB": "0 0.2 0", "optimal_force": 30},
                ),
                ("BodyActuator", "body", {"socket_body": "/bodyset/hand", "point": "0.1 0.2 0.3"}),
                (
                    "BodyActuator",
                    "turned",
                    {"socket_body": "/bodyset/arm", "point": "0.1 0.2 0.3", "spatial_force_is_global": False},
                ),
            )
        ),
    ),
    "prescribed": write_model(
        LINKS,
        forces="".join(
            f'<PrescribedForce name="{name}"><socket_frame>/bodyset/{body}</socket_frame>{numbers(**flags)}{inner}'
            "</PrescribedForce>"
            for name, body, flags, inner in (
                (
                    "wind",
                    "hand",
                    {},
                    three("forceFunctions", SINE, LINE, constant(2))
                    + three("pointFunctions", constant(0.1), constant(0.2), constant(-0.1)),
                ),
                (
                    "jet",
                    "arm",
                    {"forceIsGlobal": False},
                    three("forceFunctions", LINE, SINE, constant(2))
                    + three("pointFunctions", SINE, constant(0.2), LINE)
                    + three("torqueFunctions", constant(1), SINE, constant(0)),
                ),
                (
                    "fixed",
                    "hand",
                    {"pointIsGlobal": True},
                    three("forceFunctions", SINE, LINE, constant(2))
                    + three("pointFunctions", LINE, SINE, constant(0.3)),
                ),
            )
        ),
    ),
}
