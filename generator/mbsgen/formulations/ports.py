"""The arguments of the functions of a tree: names, roles, units and meanings, each stated once.

    M(q) qdd + c(q, qd, w) = Q(q, qd, u),    Phi = M qdd + c - Q

Names follow Docquier, Bruls and Fisette (2019), where they have one.
"""

from __future__ import annotations

from mbsgen.roles import Axis, Role
from mbsgen.tape.ports import Port

COORDINATES = Port("q", Role.COORDINATE, Axis.COORDINATES, unit="rad or m", meaning="joint coordinates")
VELOCITIES = Port("qd", Role.VELOCITY, Axis.VELOCITIES, unit="rad/s or m/s", meaning="joint velocities")
ACCELERATIONS = Port("qdd", Role.ACCELERATION, Axis.VELOCITIES, unit="rad/s2 or m/s2", meaning="joint accelerations")
FORCES = Port("u", Role.FORCE, Axis.FORCES, unit="N m or N", meaning="forces of the actuated joints, in joint order")
WRENCHES = Port(
    "w",
    Role.WRENCH,
    Axis.COMPONENTS,
    unit="N and N m",
    meaning="external forces and moments that the model leaves open, in its order",
)
DESIGN = Port("theta", Role.DESIGN, Axis.DESIGN, meaning="differentiated parameters, in the manifest's order")
PARAMETERS = Port("p", Role.PARAMETER, Axis.PARAMETERS, meaning="run-time parameters, in the manifest's order")
SETUP = Port("h", Role.SETUP, meaning="what setup computes from the run-time parameters")

JOINT_FORCES = Port("Q", Role.RESULT, Axis.VELOCITIES, unit="N m or N", meaning="joint forces")
RESIDUAL = Port(
    "Phi", Role.RESIDUAL, Axis.VELOCITIES, unit="N m or N", meaning="residual Phi(q, qd, qdd) - Q(q, qd, u)"
)
MASS_MATRIX = Port(
    "M", Role.MASS_MATRIX, Axis.VELOCITIES, Axis.VELOCITIES, unit="kg m2, kg m or kg", meaning="mass matrix"
)
BIAS = Port("c", Role.BIAS, Axis.VELOCITIES, unit="N m or N", meaning="bias: the joints' forces at qdd = 0")
RATES = Port("rate", Role.RATE, Axis.COORDINATES, meaning="time derivatives of q")

MULTIPLIERS = Port(
    "lam",
    Role.MULTIPLIER,
    Axis.CONSTRAINTS,
    unit="N, N m or the constraint's own",
    meaning="multipliers: the force on each equation of h, in the direction in which h grows",
)
CLOSURE = Port(  # not called h, as the result of setup is
    "gap",
    Role.CLOSURE,
    Axis.CONSTRAINTS,
    unit="m, or 1 of angles",
    meaning="h(q): what is left open of loops and constraints",
)
CLOSURE_RATE = Port("hd", Role.CLOSURE_RATE, Axis.CONSTRAINTS, meaning="time derivative of h: J qd")
CLOSURE_ACCELERATION = Port(
    "hdd", Role.CLOSURE_ACCELERATION, Axis.CONSTRAINTS, meaning="second time derivative of h: J qdd + Jd qd"
)
CLOSURE_JACOBIAN = Port(
    "J", Role.CLOSURE_JACOBIAN, Axis.CONSTRAINTS, Axis.VELOCITIES, meaning="Jacobian of h: hd = J qd"
)
CLOSURE_BIAS = Port(
    "gamma", Role.CLOSURE_ACCELERATION, Axis.CONSTRAINTS, meaning="second time derivative of h at qdd = 0: Jd qd"
)
DRIVE = Port("a", Role.DRIVE, Axis.DRIVEN, unit="rad/s2 or m/s2", meaning="accelerations of the driven joints")
DRIVING_FORCES = Port(
    "tau",
    Role.DRIVING_FORCE,
    Axis.DRIVEN,
    unit="N m or N",
    meaning="forces that keep the driven joints to their accelerations",
)
INDEPENDENT_VELOCITIES = Port("yd", Role.VELOCITY, Axis.INDEPENDENT, meaning="independent joint velocities")
INDEPENDENT_ACCELERATIONS = Port("ydd", Role.ACCELERATION, Axis.INDEPENDENT, meaning="independent joint accelerations")
REDUCED_RESIDUAL = Port(
    "Phi",
    Role.RESIDUAL,
    Axis.INDEPENDENT,
    unit="N m or N",
    meaning="residual, projected to the independent coordinates",
)
REDUCED_MASS_MATRIX = Port(
    "M", Role.MASS_MATRIX, Axis.INDEPENDENT, Axis.INDEPENDENT, meaning="mass matrix of the independent coordinates"
)
REDUCED_BIAS = Port("c", Role.BIAS, Axis.INDEPENDENT, meaning="bias of the independent coordinates")
CLOSED = Port("closed", Role.RESULT, Axis.COORDINATES, unit="rad or m", meaning="coordinates with all loops closed")
CLOSED_VELOCITIES = Port(
    "qd", Role.RESULT, Axis.VELOCITIES, unit="rad/s or m/s", meaning="velocities that keep loops closed"
)
PROJECTED_VELOCITIES = Port(
    "closed_qd", Role.RESULT, Axis.VELOCITIES, unit="rad/s or m/s", meaning="nearest velocities that keep loops closed"
)
CLOSED_ACCELERATIONS = Port(
    "qdd", Role.RESULT, Axis.VELOCITIES, unit="rad/s2 or m/s2", meaning="accelerations that keep loops closed"
)

POSITION = Port(
    "position",
    Role.RESULT,
    cols=Axis.SENSORS,
    unit="m",
    meaning="places of the sensors in the base frame, a column each",
)
DISTANCE = Port(
    "distance",
    Role.RESULT,
    Axis.CONTACTS,
    unit="m",
    meaning="distances of the points of contact from the other sides; below 0 inside",
)
CLEARANCE = Port(
    "clearance",
    Role.RESULT,
    Axis.RIGID,
    unit="m",
    meaning="distances of the points of rigid contacts from the other sides; below 0 inside",
)
CONTACT_NORMAL = Port(
    "direction",
    Role.RESULT,
    cols=Axis.RIGID,
    meaning="normals of rigid contacts out of the other sides, in the base frame, a column each",
)
CONTACT_JACOBIAN = Port(
    "slide",
    Role.RESULT,
    Axis.RIGID,
    Axis.VELOCITIES,
    meaning="three rows for each point of rigid contact: slide qd is its velocity relative to the other side",
)
SOLID_PLACES = Port(
    "place",
    Role.RESULT,
    cols=Axis.MEETINGS,
    unit="m",
    meaning="origins of the frames of both solids of each pair in the base frame, a column each",
)
SOLID_AXES = Port(
    "axes",
    Role.RESULT,
    cols=Axis.MEETINGS,
    meaning="axes of these frames as columns, in the base frame",
)
SOLID_TWISTS = Port(
    "twist",
    Role.RESULT,
    Axis.MEETINGS,
    Axis.VELOCITIES,
    meaning="six rows for each pair: twist qd is the velocity at the base's origin, and the angular velocity, of the "
    "first solid relative to the other one",
)
VELOCITY = Port(
    "v",
    Role.RESULT,
    cols=Axis.SENSORS,
    unit="m/s",
    meaning="velocities of the sensors in the base frame, a column each",
)
ANGULAR_VELOCITY = Port(
    "omega",
    Role.RESULT,
    cols=Axis.SENSORS,
    unit="rad/s",
    meaning="angular velocities of the sensors in the base frame, a column each",
)
ACCELERATION = Port(
    "acceleration",
    Role.RESULT,
    cols=Axis.SENSORS,
    unit="m/s2",
    meaning="accelerations of the sensors in the base frame, a column each",
)
ANGULAR_ACCELERATION = Port(
    "alpha",
    Role.RESULT,
    cols=Axis.SENSORS,
    unit="rad/s2",
    meaning="angular accelerations of the sensors in the base frame, a column each",
)
ATTITUDE = Port(
    "attitude",
    Role.RESULT,
    cols=Axis.SENSORS,
    meaning="axes of the sensors as columns, in the base frame, three for each",
)
SENSOR_JACOBIAN = Port(
    "J",
    Role.RESULT,
    Axis.SENSORS,
    Axis.VELOCITIES,
    meaning="six rows for each sensor: J qd is its velocity, then its angular velocity, in the base frame",
)
ORIGINS = Port(
    "p", Role.RESULT, cols=Axis.FRAMES, unit="m", meaning="origins of the frames in the base frame, a column each"
)
ROTATIONS = Port("R", Role.RESULT, cols=Axis.FRAMES, meaning="axes of the frames as columns, in the base frame")

LENGTH = Port(
    "length", Role.RESULT, Axis.ELEMENTS, unit="m", meaning="distances between the ends of springs and cables"
)
STRETCH = Port("stretch", Role.RESULT, Axis.ELEMENTS, unit="m/s", meaning="rates of the lengths of springs and cables")
TENSION = Port(
    "tension", Role.RESULT, Axis.ELEMENTS, unit="N", meaning="tensions of springs and cables, which pull their ends"
)
NORMAL_FORCE = Port(
    "normal", Role.RESULT, Axis.CONTACTS, unit="N", meaning="forces of contacts along their normals, off the other side"
)
CONTACT_FORCE = Port(
    "contact_force",
    Role.RESULT,
    cols=Axis.CONTACTS,
    unit="N",
    meaning="forces of contacts on the body that touches, in the base frame, a column each",
)
REACTION_FORCE = Port(
    "force",
    Role.RESULT,
    cols=Axis.BODIES,
    unit="N",
    meaning="forces by which joints act on their bodies, in the base frame, a column each",
)
REACTION_MOMENT = Port(
    "moment",
    Role.RESULT,
    cols=Axis.BODIES,
    unit="N m",
    meaning="moments by which joints act on their bodies, about the bodies' origins, in the base frame, a column each",
)

REGRESSOR = Port(
    "Y",
    Role.RESULT,
    Axis.VELOCITIES,
    Axis.MOMENTS,
    meaning="derivatives of the residual by the moments m, S, J of each body about its origin, ten columns each",
)

ELIMINATION = Port(
    "elimination",
    Role.CONDITION,
    Axis.VELOCITIES,
    meaning="by joint, what rounding is multiplied by in exp1: M_ii times the same entry of M^-1",
)
ARTICULATED = Port(
    "articulated",
    Role.CONDITION,
    Axis.VELOCITIES,
    meaning="by joint, what rounding is multiplied by in exp2: |inertia| times |what it gives way|",
)
KINETIC = Port("kinetic", Role.RESULT, unit="J", meaning="kinetic energy")
POTENTIAL = Port(
    "potential",
    Role.RESULT,
    unit="J",
    meaning="potential energy of gravity, 0 with all mass at the base's origin",
)
POWER = Port("power", Role.RESULT, unit="W", meaning="power of all forces but gravity")
MOMENTUM = Port("momentum", Role.RESULT, unit="kg m/s", meaning="momentum in the base frame")
ANGULAR_MOMENTUM = Port(
    "angular_momentum",
    Role.RESULT,
    unit="kg m2/s",
    meaning="moment of momentum about the base's origin, in the base frame",
)
CENTRE_OF_MASS = Port("com", Role.RESULT, unit="m", meaning="centre of mass in the base frame")
