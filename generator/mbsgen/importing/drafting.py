"""The common part of all readers: bodies with clean names, combined to a Model, and checked as a whole.

A `Draft` takes bodies as in a file: a pose, joints about or along any axes, a solid. Held joints become part of poses.
Its `closing` takes loops, equations of coordinates, and joints that follow others. Names that a model cannot have are
changed, with a notice.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mbsgen.documents import Data, Place, abbreviate, nearest, take
from mbsgen.errors import Fault
from mbsgen.expressions import FLOATS, Call, Expression, Name, Number, Operation, evaluate, is_free_name, names, spell
from mbsgen.importing.choices import Choices, Imported, MasslessError
from mbsgen.importing.closing import Closing, Closure, Equation, Rule, Spot, Term
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.poses import ORIGIN, Array, Pose, Writer, write_axis, write_triple
from mbsgen.importing.rotations import turn
from mbsgen.importing.solids import NOTHING, Solid, add, find_miss, show_moments, write_inertia
from mbsgen.model.checks.checks import find_faults
from mbsgen.model.checks.naming import MAX_LENGTH
from mbsgen.model.following import list_joints
from mbsgen.model.joints import find_joint_type
from mbsgen.model.model import (
    BASE,
    FREE,
    UNITS,
    ZERO,
    Body,
    Constraint,
    Contact,
    DryFriction,
    Fixed,
    Follow,
    ForceElement,
    Frame,
    Friction,
    Joint,
    Law,
    Loop,
    LoopEnd,
    Model,
    PathPoint,
    Placement,
    Stop,
    Stops,
    Visual,
    Wrap,
    Wrench,
)
from mbsgen.model.muscles import Muscle
from mbsgen.model.quantities import find_moving, list_poses, name_lengths
from mbsgen.model.topology import find_carriers
from mbsgen.model.tree import Motion

GRAVITY = (0.0, 0.0, -9.81)
MJCF = "mujoco"  # the root of its files
TOLERANCE = 1e-9  # of the largest moment: rounding of a file's digits in an inertia that is just possible
SLIGHT = 1e-9  # m2: a body whose inertia is less than this times its mass is a point
AGREED = 1e-6  # rad or m: the digits with which joints are held
GROSS = 0.5  # of the largest moment of bodies fixed together: beyond this, results mean little
_LENGTH = "length of "  # and the name of a line: its key beside the names of joints


@dataclass(frozen=True, eq=False)
class Move:
    """One degree of freedom of a file."""

    motion: Motion
    axis: Array  # in the frame that moves
    source: Element
    name: str | None = None
    pose: Pose = ORIGIN  # of the frame that moves at q = 0, in the frame before it
    actuated: bool = True
    lower: float | None = None
    upper: float | None = None
    law: Law = FREE
    armature: float = 0.0  # a rotor's contribution to M [kg m2 or kg]
    velocity: float | None = None  # the largest, either way [rad/s or m/s]; 0 and None: unbounded
    effort: float | None = None  # the same of the input [N m or N]
    follows: Rule | None = None
    floats: bool = False  # one of the joints of a quaternion
    start: float = 0.0  # the coordinate in the pose of the file [rad or m]
    drag: float = 0.0  # of the first of three turns: the damping of the ball that they make [N m s/rad]

    def at(self, q: float) -> Pose:
        """Return the pose of the moving frame, in the frame before it."""
        if self.motion is Motion.REVOLUTE:
            return self.pose @ Pose(turn(self.axis, q), np.zeros(3))
        return self.pose @ Pose(np.eye(3), self.axis / np.linalg.norm(self.axis) * q, ())


def list_moves(type: str, source: Element, pose: Pose = ORIGIN, *, actuated: bool = True, **fields: Data) -> list[Move]:
    """List the elementary joints of a joint type of model files, given its fields as a file has them."""
    joints = take({"type": type, **fields}, find_joint_type(type)).make("")
    assert isinstance(joints, tuple), "the type is one of joints in a row"
    return [
        Move(
            joint.motion,
            np.array([evaluate(component, {}, FLOATS) for component in joint.axis]),
            source,
            pose=ORIGIN if k else pose,
            actuated=actuated,
            floats=joint.floats,
        )
        for k, joint in enumerate(joints)
    ]


def move_freely(source: Element, *, quaternion: bool = False) -> list[Move]:
    """List the six joints of a free body: along x, y, z of its parent, then a ball; without a motor."""
    return list_moves("free" if quaternion else "floating", source, actuated=False)


def list_screw(turned: Move, pitch: float, choices: Choices) -> list[Move]:
    """List the turn of a screw, and the slide that follows it by `pitch` [m/rad]; a held turn holds both."""
    held = dict(choices.locked).get(turned.name or "")
    if held is not None:
        along = turned.axis / np.linalg.norm(turned.axis) * pitch * held
        return [replace(turned, pose=Pose(np.eye(3), along, ()))]
    slid = Move(
        Motion.PRISMATIC, turned.axis, turned.source, name=f"{turned.name}.slide", actuated=False,
        follows=(turned.name or "", pitch, 0.0),
    )  # fmt: skip
    return [turned, slid]


def make_law(
    stiffness: float = 0.0,
    rest: float = 0.0,
    damping: float = 0.0,
    friction: float = 0.0,
    speed: float = 0.01,
    force: Expression = ZERO,
) -> Law:
    """Make the force law of a joint; a spring without stiffness has no rest."""
    dry = Friction(Number(friction), Number(speed)) if friction else None
    return Law(Number(stiffness), Number(rest if stiffness else 0.0), Number(damping), dry, force)


def describe_friction(friction: float, choices: Choices, *, follows: bool = False) -> str:
    """Describe how the dry friction of a joint is taken, for a notice."""
    if choices.dry_friction and not follows:
        return f"dry friction of {friction:g}, which simulations alone apply"
    return f"dry friction of {friction:g}, smoothed: tanh(qd/{choices.friction_speed:g})"


def damp(moves: Sequence[Move], damping: float) -> list[Move]:
    """Damp each joint of a row; three turns about z, y, x by a moment against the angular velocity of the ball.

    With the angles a, b, c the angular velocity has the square a'² + b'² + c'² - 2 a' c' sin(b), so that the forces
    in the first and the last turn depend on each other's velocities.
    """
    turns = [k for k, move in enumerate(moves) if move.motion is Motion.REVOLUTE]
    ball = turns[0] if len(turns) == 3 and damping else None
    return [
        replace(move, law=replace(move.law, damping=Number(damping)), drag=damping if k == ball else 0.0)
        for k, move in enumerate(moves)
    ]


@dataclass(frozen=True)
class Reach:
    """A sum of coordinates, by the joints of the file, and of lengths of lines over divisors."""

    terms: tuple[tuple[str, float], ...]
    lines: tuple[tuple[float, tuple[Spot, ...]], ...] = ()


@dataclass
class Draft:
    """A model under construction, and the source of each part."""

    findings: Findings
    choices: Choices
    writer: Writer = field(init=False)
    closing: Closing = field(default_factory=Closing)
    bodies: list[Body] = field(default_factory=list)
    frames: list[Frame] = field(default_factory=list)
    _solids: dict[str, Solid] = field(default_factory=dict)  # by the name of the body
    _sources: dict[str, Element] = field(default_factory=dict)  # of bodies
    _fixed: dict[str, Pose] = field(default_factory=dict)  # of bodies without joints, on their parents
    _moves: dict[tuple[str, int], Element] = field(default_factory=dict)  # of joints: body, place in its sequence
    _starts: dict[tuple[str, int], float] = field(default_factory=dict)  # of joints: body, place in its sequence
    _drags: dict[tuple[str, int], float] = field(default_factory=dict)  # of balls: body, place of the first turn
    _called: dict[str, str] = field(default_factory=dict)  # file name of a joint -> its name in the model
    _names: dict[str, set[str]] = field(default_factory=dict)
    _forces: list[tuple[ForceElement, Element]] = field(default_factory=list)
    _pushes: list[tuple[Wrench, Element]] = field(default_factory=list)  # that the file gives
    _reaches: list[tuple[Stop, Reach, tuple[str, ...], Element]] = field(default_factory=list)
    _contacts: list[Contact] = field(default_factory=list)
    _signals: list[str] = field(default_factory=list)
    _labels: dict[str, str] = field(default_factory=dict)  # name in the model -> in the file, of sensors and forces
    _equations: list[Equation] = field(default_factory=list)  # of the model
    _locked: set[str] = field(default_factory=set)
    _sensors: set[str] = field(default_factory=set)
    _wrenches: list[Wrench] = field(default_factory=list)  # that a use gives
    _joints: list[str] = field(default_factory=list)  # of the file
    _visible: list[str] = field(default_factory=list)  # possible sensors

    def __post_init__(self) -> None:
        self.writer = Writer(self.choices.quarter_turns)

    def add_body(self, name: str, parent: str, pose: Pose, moves: Sequence[Move], solid: Solid, source: Element) -> str:
        """Add a body on a body of the draft, and return its name in the model.

        `pose` is the pose of the first joint's frame, or of a fixed body's, in the frame of the parent; the frame of
        the solid is the last one.
        """
        pending = pose
        kept: list[tuple[Move, Pose]] = []
        for move in moves:
            held = self._find_held(move)
            if held is None:
                kept.append((move, pending @ move.pose))
                pending = ORIGIN
            else:
                pending = pending @ move.at(held)
        is_shifted = not pending.is_straight or pending.position.any()
        own = self._choose_name("body", name, source)
        if (
            kept and is_shifted
        ):  # a held joint came last: the moving frame is a separate body, and the body is fixed on it
            carrier = self._choose_name("body", f"{own}.carrier", source)
            self._append(carrier, parent, self._make_joint(carrier, kept), NOTHING, source)
            self._append_fixed(own, carrier, pending, solid, source)
        elif kept:
            self._append(own, parent, self._make_joint(own, kept), solid, source)
        else:
            self._append_fixed(own, parent, pending, solid, source)
        return own

    def show(self, body: str, visuals: Sequence[Visual]) -> None:
        """Draw a body of the draft by shapes."""
        i = next(i for i, each in reversed([*enumerate(self.bodies)]) if each.name == body)
        self.bodies[i] = replace(self.bodies[i], visuals=tuple(visuals))

    def add_frame(self, name: str, body: str, pose: Pose, source: Element) -> None:
        """Add a sensor on a body of the draft, if the choices name it."""
        self._visible.append(name)
        if name in (*self.choices.sensors, *self.choices.opened) and name not in self._sensors:
            self._sensors.add(name)
            own = self._choose_name("frame", name, source)
            self._labels[own] = name
            frame = Frame(own, body, self.writer.placement(pose))
            self.frames.append(frame)
            if name in self.choices.opened:
                self._wrenches.append(Wrench(own, body, frame.placement.position, force=None, moment=None))

    def add_force(
        self,
        name: str,
        path: Sequence[PathPoint],
        force: Expression,
        muscle: Muscle | None,
        wraps: Sequence[Wrap],
        signals: Sequence[str],
        source: Element,
    ) -> None:
        """Add a force along a line, and the signals that it reads."""
        own = self._choose_name("force", name, source)
        self._labels[own] = name
        first, *via, last = path
        element = ForceElement(own, first, last, force=force, via=tuple(via), muscle=muscle, wraps=tuple(wraps))
        self._forces.append((element, source))
        self._signals += signals

    def add_wrench(self, wrench: Wrench, signals: Sequence[str], source: Element) -> None:
        """Add a wrench, and the signals that it reads."""
        own = self._choose_name("frame", wrench.name, source)
        self._labels[own] = wrench.name
        self._pushes.append((replace(wrench, name=own), source))
        self._signals += signals

    def add_contact(self, contact: Contact, source: Element) -> None:
        """Add a contact with a plane, under a name that no other has."""
        self._contacts.append(replace(contact, name=self._choose_name("contact", contact.name, source)))

    def add_stops(self, name: str, reach: Reach, limits: tuple[float, float], source: Element) -> None:
        """Add stops at the limits of a number, with the restitution of the choices."""
        assert self.choices.stops is not None, "the choices ask for stops"
        lines = []
        for k, (_, points) in enumerate(reach.lines, 1):
            own = self._choose_name("force", f"{name}.line" if len(reach.lines) == 1 else f"{name}.line{k}", source)
            first, *via, last = (PathPoint(x.body, Placement(write_triple(x.pose.position))) for x in points)
            self._forces.append((ForceElement(own, first, last, via=tuple(via)), source))
            lines.append(own)
        own = self._choose_name("force", name, source)
        lower, upper = map(Number, limits)
        stop = Stop(own, ZERO, lower, upper, Stops(Number(self.choices.stops)))
        self._reaches.append((stop, reach, tuple(lines), source))

    def _write_stops(self, model: Model) -> Model:
        """Write the numbers that stops limit, in the names of the model; leave out numbers that do not change."""
        called = {x.source: name for name, x in list_poses(model).items()}
        called = {file: called[own] for file, own in self._called.items() if own in called}
        called |= {_LENGTH + own: name for name, own in name_lengths([x.name for x in model.forces]).items()}
        held, carriers, kept = dict(self.choices.locked), find_carriers(model), []
        for stop, reach, lines, source in self._reaches:
            terms = [Term(name, factor) for name, factor in reach.terms if factor]
            terms += [Term(_LENGTH + own, 1 / x) for own, (x, _) in zip(lines, reach.lines, strict=True)]
            known = tuple(x for x in terms if x.joint in held or x.joint in called)
            left = Equation(stop.name, known, 0.0, source).hold(held)
            quantity = left.write(called) if left.terms else ZERO
            if find_moving(quantity, model, carriers):
                kept.append(replace(stop, quantity=quantity))
            else:
                self.findings.tell(source, "what its range limits does not change: left out")
        return replace(model, stops=tuple(kept))

    def find_joint(self, name: str) -> str:
        """Return the name in the model of a joint of the file."""
        return self._called.get(name, name)

    def warn_of_limits(self) -> None:
        """Warn of the joints that the file stops at the ends of their ranges: without stops, no simulation does."""
        joints = [joint for body in self.bodies for joint in _list_joints(body.joint)]
        ends = [(joint.lower, joint.upper) for joint in joints if joint.stops is None]
        bounded = sum(lower is not None or upper is not None for lower, upper in ends)
        if bounded:
            text = "1 joint" if bounded == 1 else f"{bounded} joints"
            self.findings.sum_up(f"the ranges of {text} bound problems alone: a simulation passes them", alters=True)

    def finish(self, name: str, gravity: Sequence[float], root: Element) -> Imported:
        """Complete the model and check it.

        Raises InputError with all faults of the file, MasslessError for joints that are then to be held.
        """
        self._check_choices()
        allowed = self._check_solids()
        if self.findings.faults:
            raise self.findings.refuse()
        model = Model(
            name=self._choose_name("model", self.choices.name or name, root),
            gravity=write_triple(self.choices.gravity or gravity),
            bodies=tuple(self.bodies),
            frames=tuple(self.frames),
            wrenches=(*(wrench for wrench, _ in self._pushes), *self._wrenches),
            forces=tuple(element for element, _ in self._forces),
            signals=tuple(dict.fromkeys(self._signals)),
            allow_unphysical=not allowed,
        )
        model = self._write_stops(self._damp_balls(self._close(self._drop_idle(model))))
        if self.choices.contacts is not None and root.tag != MJCF:
            self.findings.sum_up("no contacts are made: only a file of MJCF has planes that geoms touch", alters=True)
        carriers = find_carriers(model)
        touching = [x for x in self._contacts if carriers.get(x.body) != carriers.get(x.other.body, BASE)]
        model = replace(model, contacts=tuple(touching))
        self._check_model(model, root)
        self._tell_fixed(model)
        self._tell_angles()
        ordered = sorted(self.findings.notices, key=lambda n: (not n.alters, n.line == 0, n.file, n.line, n.path))
        return Imported(model, tuple(dict.fromkeys(ordered)), tuple(dict.fromkeys(self._visible)), self._labels)

    def _drop_idle(self, model: Model) -> Model:
        """Leave out forces between points that do not move relative to each other."""
        carriers, kept = find_carriers(model), []
        for element, source in self._forces:
            if len({carriers.get(body, body) for body in element.bodies}) > 1:
                kept.append((element, source))
            else:
                self.findings.tell(source, "its points do not move relative to each other: left out")
        self._forces = kept
        read = frozenset[str]().union(*(x.reads for x, _ in kept))
        pushes = []
        for wrench, source in self._pushes:
            other = BASE if wrench.against is None else wrench.against.body
            if carriers.get(wrench.body) != carriers.get(other):
                pushes.append((wrench, source))
                read = read.union(*map(names, (*(wrench.force or ()), *(wrench.moment or ()))))
            else:
                self.findings.tell(source, "it acts on nothing that moves: left out")
        self._pushes = pushes
        signals = tuple(name for name in model.signals if name in read)
        wrenches = (*(wrench for wrench, _ in pushes), *self._wrenches)
        return replace(model, forces=tuple(element for element, _ in kept), wrenches=wrenches, signals=signals)

    # --- parts -------------------------------------------------------------------------------------------------------

    def _append(
        self, name: str, parent: str, joint: Joint | Fixed | tuple[Joint, ...], solid: Solid, source: Element
    ) -> None:
        body = Body(name, joint, parent, Number(solid.mass), write_triple(solid.com), write_inertia(solid.inertia))
        self.bodies.append(body)
        self._solids[name] = solid
        self._sources[name] = source

    def _append_fixed(self, name: str, parent: str, pose: Pose, solid: Solid, source: Element) -> None:
        self._append(name, parent, Fixed(self.writer.placement(pose)), solid, source)
        self._fixed[name] = pose

    def _find_held(self, move: Move) -> float | None:
        if move.name is None:
            return None
        self._joints.append(move.name)
        for name, value in self.choices.locked:
            if name == move.name:
                self._locked.add(name)
                self.findings.tell(move.source, f"held at {value:g}")
                return value
        return None

    def _make_joint(self, body: str, kept: Sequence[tuple[Move, Pose]]) -> Joint | tuple[Joint, ...]:
        joints = []
        for i, (move, pose) in enumerate(kept):
            name = None if move.name is None else self._choose_name("joint", move.name, move.source)
            lower, upper = (None if limit is None else Number(limit) for limit in (move.lower, move.upper))
            speed, force = (Number(bound) if bound else None for bound in (move.velocity, move.effort))
            if move.name is not None:
                self._called.setdefault(move.name, name or body)
                if move.follows is not None:
                    self.closing.rules[move.name] = move.follows
            joints.append(
                Joint(
                    move.motion, write_axis(move.axis), None if name == body and len(kept) == 1 else name,
                    self.writer.placement(pose), move.actuated, lower, upper, move.law,
                    speed, force, Number(move.armature), floats=move.floats,
                )
            )  # fmt: skip
            if move.follows is None:
                joints[-1] = self._let_switch(joints[-1])
            self._moves[body, i] = move.source
            self._starts[body, i] = move.start
            if move.drag:
                self._drags[body, i] = move.drag
        return joints[0] if len(joints) == 1 else tuple(joints)

    def _let_switch(self, joint: Joint) -> Joint:
        """Return a joint with dry friction and stops, by the choices."""
        smooth = joint.law.friction
        if self.choices.dry_friction and smooth is not None:
            joint = replace(joint, law=replace(joint.law, friction=None), dry=DryFriction(smooth.torque))
        if self.choices.stops is not None and (joint.lower, joint.upper) != (None, None) and not joint.floats:
            joint = replace(joint, stops=Stops(Number(self.choices.stops)))
        return joint

    def _choose_name(self, kind: str, wanted: str, source: Element) -> str:
        """Return a valid name that differs from all others of its kind; a change makes a notice."""
        taken = self._names.setdefault(kind, {_fold(BASE)} if kind == "body" else set())
        clean = "".join("_" if _is_unfit(c) else c for c in wanted).strip().lstrip(".~") or kind
        clean = clean[: MAX_LENGTH - 8].strip()
        name, number = clean, 1
        while _fold(name) in taken:
            number += 1
            name = f"{clean}_link" if number == 2 and _fold(clean) == BASE else f"{clean}_{number}"
        taken.add(_fold(name))
        if wanted and name != wanted:
            self.findings.tell(source, f"{kind} {abbreviate(wanted)} is called {abbreviate(name)} in the model")
        return name

    # --- loops and followers -----------------------------------------------------------------------------------------

    def _close(self, model: Model) -> Model:
        """Add loops, equations and followers."""
        files = {own: file for file, own in self._called.items()}
        equations = self._equations = [*self._hold_equations()]
        for equation in equations:
            for term in equation.terms:
                self._make_writable(term.joint, equation.source)
        model = replace(
            model,
            bodies=tuple(self._lead(body, files) for body in model.bodies),
            loops=tuple(map(self._write_loop, self.closing.closures)),
            constraints=tuple(
                Constraint(self._choose_name("loop", x.name, x.source), x.write(self._called)) for x in equations
            ),
        )
        if not (model.loops or model.constraints):
            return model
        return replace(model, independent=self._list_independent(model), assembly=tuple(self._list_starts(model)))

    def _write_loop(self, closure: Closure) -> Loop:
        one, other = (LoopEnd(spot.body, self.writer.placement(spot.pose)) for spot in (closure.first, closure.second))
        axis = UNITS["z"] if closure.axis is None else write_axis(closure.axis)
        axis2 = UNITS["x"] if closure.axis2 is None else write_axis(closure.axis2)
        name = self._choose_name("loop", closure.name, closure.source)
        return Loop(name, closure.cut, one, other, axis, axis2, pitch=Number(closure.pitch))

    def _hold_equations(self) -> Iterator[Equation]:
        """Yield the equations that are left where some joints are held; a fault where held joints contradict one."""
        for equation in self.closing.equations:
            left = equation.hold(dict(self.choices.locked))
            if left.terms:
                yield left
            elif abs(left.constant) > AGREED:
                remedy = "hold one of its joints only, or at other coordinates"
                self.findings.fault(equation.source, f"the joints are held, and {left.constant:g} is left", remedy)
            else:
                self.findings.tell(equation.source, "the joints are held, and meet it")

    def _make_writable(self, joint: str, source: Element) -> None:
        """Rename a joint that an equation cannot name."""
        name = self._called[joint]
        if is_free_name(name):
            return
        clean = re.sub(r"[^A-Za-z0-9_]", "_", name)
        clean = clean if is_free_name(clean) else f"q_{clean}"
        self._called[joint] = self._choose_name("joint", clean, source)
        text = f"joint {abbreviate(name)} is called {abbreviate(self._called[joint])} in the model"
        self.findings.tell(source, f"{text}, as equations need it")

    def _list_independent(self, model: Model) -> tuple[str, ...]:
        """List the independent coordinates where the file says which ones depend on others."""
        steps = [step for step in list_joints(model) if step.joint.follows is None]
        dependent = {self._called[file] for file in self.closing.dependent if file in self._called}
        if not dependent.intersection(step.name for step in steps):
            return ()
        if any(step.joint.floats for step in steps):
            self.findings.sum_up("the independent coordinates are chosen anew, since some are of quaternions")
            return ()
        return tuple(step.name for step in steps if step.name not in dependent)

    def _list_starts(self, model: Model) -> Iterator[tuple[str, Number]]:
        """Yield the coordinates in the pose of the file that are not 0."""
        for step in list_joints(model):
            _, i, _, *rest = step.place
            start = self._starts[model.bodies[int(i)].name, int(rest[0]) if rest else 0]
            if start and step.joint.follows is None and not step.joint.floats:
                yield step.name, Number(start)

    def _lead(self, body: Body, files: Mapping[str, str]) -> Body:
        """Name the joints of a body as equations need them, and let joints follow others."""

        def lead(joint: Joint) -> Joint:
            file = files.get(body.name if joint.name is None else joint.name)
            if file is None:
                return joint
            joint = (
                joint
                if joint.name is None and self._called[file] == body.name
                else replace(joint, name=self._called[file])
            )
            if file not in self.closing.rules:
                return joint
            leader, ratio, offset = self.closing.rules[file]
            follows = Follow(self._called[leader], Number(ratio), Number(offset))
            return replace(joint, follows=follows, actuated=False, max_force=None)

        match body.joint:
            case Fixed():
                return body
            case Joint():
                return replace(body, joint=lead(body.joint))
        return replace(body, joint=tuple(map(lead, body.joint)))

    def _damp_balls(self, model: Model) -> Model:
        """Add the forces by which the first and the last turn of a damped ball depend on each other's velocities."""
        steps = list_joints(model)
        spelled = dict(zip((step.place for step in steps), spell([step.name for step in steps]), strict=True))
        bodies = []
        for i, body in enumerate(model.bodies):
            for (_, k), drag in ((key, x) for key, x in self._drags.items() if key[0] == body.name):
                first, second, third = (spelled["bodies", i, "joint", k + n] for n in range(3))
                assert isinstance(body.joint, tuple), "a ball is three turns"
                if first is None or second is None or third is None:
                    self.findings.warn(
                        self._sources[body.name], "its damping is left out: expressions cannot name its coordinates"
                    )
                    continue
                joints = [*body.joint]
                for n, other in ((k, third), (k + 2, first)):
                    pull = Operation("*", Number(drag), Call("sin", (Name(f"q_{second}"),)))
                    force = Operation("*", pull, Name(f"qd_{other}"))
                    joints[n] = replace(joints[n], law=replace(joints[n].law, force=force))
                body = replace(body, joint=tuple(joints))
            bodies.append(body)
        return replace(model, bodies=tuple(bodies))

    # --- checks ------------------------------------------------------------------------------------------------------

    def _check_choices(self) -> None:
        chosen = (
            ("joint to be held", [name for name, _ in self.choices.locked], self._locked, self._joints),
            (
                "link, body or site to be a sensor",
                [*self.choices.sensors, *self.choices.opened],
                self._sensors,
                self._visible,
            ),
        )
        for what, wanted, met, there in chosen:
            for name in wanted:
                if name not in met:
                    meant = nearest(name, there)
                    remedy = f"did you mean {abbreviate(meant)}?" if meant else f"there are {_list(there)}"
                    finding = f"there is no {what} that is called {abbreviate(name)}"
                    self.findings.faults.append(Fault(self.findings.file, 0, "", finding, remedy))

    def _check_solids(self) -> bool:
        """Return whether all inertias are possible; slight violations make notices, large ones faults."""
        possible = True
        for name, solid in self._solids.items():
            source = self._sources[name]
            miss = find_miss(solid)
            if solid.mass < 0:
                self.findings.fault(source, f"a mass of {solid.mass:g} kg", "give 0 or more")
            elif solid.mass == 0 and solid.inertia.any():
                self.findings.warn(source, f"it has an inertia of {show_moments(solid)} without a mass; it is kept")
                possible = False
            elif miss > TOLERANCE:
                text = f"no body has the principal moments of inertia {show_moments(solid)}"
                self.findings.warn(source, f"{text}: they miss by {miss:.2g} of the largest; they are kept")
                possible = False
        if not self.choices.allow_unphysical:
            self._check_groups()
        return possible

    def _check_groups(self) -> None:
        """Check bodies that are fixed to each other as one: a violation by a light body may not matter."""
        for name, members in self._group().items():
            whole = add(solid.seen_from(pose) for member, pose in members for solid in (self._solids[member],))
            if name != BASE and np.abs(whole.inertia).max() > SLIGHT * whole.mass > 0 and find_miss(whole) > GROSS:
                worst = max((member for member, _ in members), key=lambda member: find_miss(self._solids[member]))
                with_others = f", with the {len(members) - 1} that are fixed to it" if len(members) > 1 else ""
                text = f"no body has the principal moments of inertia {show_moments(whole)}{with_others}"
                remedy = "none may be negative, nor more than the sum of the others; mend them, or --allow-unphysical"
                self.findings.fault(self._sources[worst], text, remedy)

    def _group(self) -> dict[str, list[tuple[str, Pose]]]:
        """List the bodies that are fixed to each moving body, or to the base, with their poses on it."""
        carriers: dict[str, tuple[str, Pose]] = {BASE: (BASE, ORIGIN)}
        groups: dict[str, list[tuple[str, Pose]]] = {}
        for body in self.bodies:  # parents come first
            carrier, pose = body.name, ORIGIN
            if body.name in self._fixed:
                carrier, outer = carriers[body.parent]
                pose = outer @ self._fixed[body.name]
            carriers[body.name] = carrier, pose
            groups.setdefault(carrier, []).append((body.name, pose))
        return groups

    def _check_model(self, model: Model, root: Element) -> None:
        """Report faults of the model at the elements that cause them."""
        faults = [*find_faults(model)]
        massless = [self._name_in_file(model, x.place) for x in faults if "moves nothing:" in x.finding]
        if self.choices.lock_massless and (named := [name for name in massless if name is not None]):
            raise MasslessError([name for name in named if name not in self.closing.rules] or named)
        for found in faults:
            remedy, finding = found.remedy, self._name_twin(found.finding)
            if found.finding == "nothing moves":
                remedy = "give it a joint that is not fixed, or free its root link (--base floating)"
            if "moves nothing" in found.finding:
                every = "; --lock-massless: all such joints" if "moves nothing:" in found.finding else ""
                remedy += f", or hold it where it is (--lock JOINT=VALUE{every})"
            self.findings.fault(self._locate(model, found.place) or root, finding, remedy)
        if self.findings.faults:
            raise self.findings.refuse()

    def _name_twin(self, finding: str) -> str:
        """Replace the place of a loop in the model by its line in the file."""
        return re.sub(r"\bloops\[(\d+)\]", lambda x: f"line {self.closing.closures[int(x[1])].source.line}", finding)

    def _name_in_file(self, model: Model, place: Place) -> str | None:
        """Return the file's name of the joint at a place; None where the file gives none."""
        match place:
            case ("bodies", int(i), "joint", *rest):
                body = model.bodies[i]
                joint = (
                    body.joint[rest[0]] if isinstance(body.joint, tuple) and isinstance(rest[0], int) else body.joint
                )
                assert isinstance(joint, Joint), "only joints move"
                own = joint.name or body.name
                return next((file for file, name in self._called.items() if name == own), None)
        return None

    def _locate(self, model: Model, place: Place) -> Element | None:
        match place:
            case ("bodies", int(i), "joint", *rest):
                name, k = model.bodies[i].name, rest[0] if rest and isinstance(rest[0], int) else 0
                return self._moves.get((name, k), self._sources[name])
            case ("bodies", int(i), *_):
                return self._sources[model.bodies[i].name]
            case ("loops", int(i), *_):
                return self.closing.closures[i].source
            case ("forces", int(i), *_):
                return self._forces[i][1]
            case ("wrenches", int(i), *_) if i < len(self._pushes):
                return self._pushes[i][1]
            case ("constraints", int(i), *_):
                return self._equations[i].source
        return None

    def _tell_fixed(self, model: Model) -> None:
        carriers = find_carriers(model)
        for body in model.bodies:
            mass, carrier = self._solids[body.name].mass, carriers[body.name]
            if body.name in self._fixed and mass:
                where = "stands on the base, where nothing feels it" if carrier == BASE else f"moves with {carrier}"
                self.findings.tell(self._sources[body.name], f"fixed: its mass of {mass:g} kg {where}")

    def _tell_angles(self) -> None:
        if doubtful := self.writer.doubtful:
            self.findings.sum_up(
                f"{len(doubtful)} angles are near a quarter turn, but off by up to {max(doubtful):.2g} rad; they are "
                f"kept. Taken as quarter turns (--quarter-turns {max(doubtful) * 1.01:.1g}), they make shorter code"
            )


def _list_joints(carrier: Joint | Fixed | tuple[Joint, ...]) -> tuple[Joint, ...]:
    if isinstance(carrier, Fixed):
        return ()
    return (carrier,) if isinstance(carrier, Joint) else carrier


def _is_unfit(character: str) -> bool:
    category = unicodedata.category(character)
    return character in "/\\" or category[0] == "C" or category in ("Zl", "Zp")


def _fold(name: str) -> str:
    return unicodedata.normalize("NFKC", unicodedata.normalize("NFKC", name).casefold())


def _list(names: Sequence[str]) -> str:
    shown = ", ".join(map(abbreviate, names[:8]))
    return f"{shown}, ..." if len(names) > 8 else shown or "none"
