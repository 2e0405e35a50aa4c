"""Modes: what each rigid stop, dry friction and rigid contact of a model does throughout a phase, as parts of it.

The model's switching forces are inputs here (`open_forces`): a signal for each joint, an open wrench for each point.

    free        f = 0                                             a joint without dry friction, within its limits
    forward     f = -F(qd),  qd >= 0;    backward: mirrored       F = T + (S - T) exp(-(qd/v)^2)
    stick       qd = 0,      -S <= f <= S
    lower       q = lower,   f >= -S;    upper: mirrored          at a rigid stop, S = 0 without friction
    open        g >= 0,      F = 0                                a point, g its distance from the plane
    stick       v = 0,       F_n >= 0,  mu F_n >= |F_t|
    forward     v_n = 0,     F_n >= 0,  F_t = -mu F_n,  v_t >= 0  along one axis across; backward: mirrored
    slide       v_n = 0,     F_n >= 0                             without friction

Where a link leads to a mode that closes a stop or a contact, the phase before ends there: at q = limit or g = 0, and
for friction that sticks at qd = 0. With a restitution of 0 an impact follows, M (qd+ - qd-) = L, in which all that are
closed after it have impulses; with a larger one, what arrives must be at rest. `hits` of a link are impacts that
rebound.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

from mbsgen.documents import Finding, abbreviate, nearest
from mbsgen.manifest import Friction, Manifest, OpenContact, OpenJoint, Stops
from mbsrun.ocp.problem.phases import Blow, Impact
from mbsrun.ocp.problem.problem import Constraint, Contact, Problem, Range, WrenchComponent
from mbsrun.quantities import SIGNAL, find_component, list_quantities, name_components

FREE, FORWARD, BACKWARD, LOWER, UPPER = "free", "forward", "backward", "lower", "upper"
OPEN, STICK, SLIDE = "open", "stick", "slide"
LEAST, MOST = -math.inf, math.inf
SAME = 1e-9  # rad or m: a start that counts as being at a stop, or on a plane

Modes = Mapping[str, str]  # of joints and contacts, by name
Axes = Mapping[str, tuple[int, ...]]  # along which each point of contact can move


def list_modes(law: OpenJoint | OpenContact) -> tuple[str, ...]:
    """List the modes that a joint or a contact can have."""
    if isinstance(law, OpenContact):
        return (OPEN, STICK, FORWARD, BACKWARD) if law.coefficient else (OPEN, SLIDE)
    ways: tuple[str, ...] = (FORWARD, BACKWARD) if law.friction is not None else ()
    if law.friction is not None and law.friction.one_way:
        ways = (FORWARD,) if law.friction.one_way > 0 else (BACKWARD,)
    own = (*ways, STICK) if ways else (FREE,)
    return (*own, *(side for side in (LOWER, UPPER) if _find_limit(law, side) is not None))


def list_laws(manifest: Manifest) -> dict[str, OpenJoint | OpenContact]:
    """Return everything that has a mode, by name."""
    found: dict[str, OpenJoint | OpenContact] = {law.name: law for law in manifest.open_joints}
    return found | {law.name: law for law in manifest.open_contacts}


def complete(modes: Modes, manifest: Manifest) -> dict[str, str]:
    """Return the mode of everything that has one: joints without friction are free, contacts open, unless said."""
    usual = {name: list_modes(law)[0] for name, law in list_laws(manifest).items()}
    return usual | dict(modes)


def find_faults(modes: Modes, manifest: Manifest, axes: Axes) -> Iterator[Finding]:
    """Find modes for parts without any, wrong modes, and dry friction without a mode; places are below `modes`."""
    laws = list_laws(manifest)
    joints = {law.name for law in manifest.open_joints}
    for name, mode in modes.items():
        if name not in laws:
            yield Finding((name,), *_explain_unknown(name, [*laws], manifest))
            continue
        if name in joints and any(law.name == name for law in manifest.open_contacts):
            yield Finding((name,), "a joint and a contact have this name", "rename one of them in the model")
        known = list_modes(laws[name])
        if mode not in known:
            yield Finding((name,), _explain_mode(laws[name], mode), f"give {' or '.join(known)}")
        elif fault := _find_wrong_way(laws[name], mode, axes):
            yield Finding((name,), *fault)
    for law in manifest.open_joints:
        if law.friction is not None and law.friction.load is not None:
            finding = f"friction by the load of joint {law.name} has no modes"
            yield Finding((), finding, "give a torque in place of load in the model")
        elif law.friction is not None and law.name not in modes:
            finding = f"{law.name} has dry friction, and no mode"
            yield Finding((), finding, f"give {law.name}: {' or '.join(list_modes(law))}")
        if _name(manifest, "qd", law) is None:
            yield Finding(
                (), f"{law.name} shares its name in expressions with another joint", "rename the joint in the model"
            )
    for point in manifest.rigid:
        finding = f"rigid {'stop' if point.is_stop else 'contact'} {point.name} has no modes here"
        remedy = "modes are for points on planes of the base with normal x, y or z; leave it out of the model"
        yield Finding((), finding, remedy)
    for pair in manifest.meetings:
        finding = f"rigid contact {pair.name} of two solids has no modes"
        yield Finding((), finding, "modes are for points on planes; leave it out of the model")


def _find_wrong_way(law: OpenJoint | OpenContact, mode: str, axes: Axes) -> tuple[str, str] | None:
    """Return finding and remedy of a point that slides, but not along one axis; None where all is right."""
    if isinstance(law, OpenJoint) or mode not in (FORWARD, BACKWARD):
        return None
    across = ["xyz"[k] for k in axes[law.name] if k != law.axis]
    if len(across) == 1:
        return None
    finding = f"{law.name} can slide along {' and '.join(across) or 'no axis'}, and {mode} is along one axis"
    return finding, f"give {STICK} or {OPEN}"


def _explain_unknown(name: str, known: list[str], manifest: Manifest) -> tuple[str, str]:
    """Return finding and remedy of a name without modes."""
    if name in [c.name for c in manifest.coordinates]:
        finding = f"joint {abbreviate(name)} has neither rigid stops nor dry friction, so it has no modes"
        return finding, "leave it out, or give the model stops or friction of it"
    finding = f"the model has no joint or contact {abbreviate(name)} with modes"
    meant = nearest(name, known)
    listed = f"there are {', '.join(known)}" if known else "it has no rigid stops, dry friction or rigid contacts"
    return finding, f"did you mean {abbreviate(meant)}?" if meant else listed


def _explain_mode(law: OpenJoint | OpenContact, mode: str) -> str:
    """Return what is wrong about a mode."""
    if isinstance(law, OpenContact):
        if mode == STICK:
            return f"contact {law.name} has no friction to stick by"
        if mode == SLIDE:
            return f"contact {law.name} has friction, which slide is without"
        if mode in (FORWARD, BACKWARD):
            return f"contact {law.name} has no friction, so its slip has no way"
        return f"contact {law.name} has no mode {abbreviate(mode)}"
    if mode in (LOWER, UPPER):
        return f"joint {law.name} has no rigid stop at its {mode} limit"
    if mode in (FORWARD, BACKWARD, STICK):
        own = "is a clutch, which moves one way" if law.friction is not None else "has no dry friction"
        return f"joint {law.name} {own}, so it has no mode {mode}"
    if mode == FREE:
        return f"joint {law.name} has dry friction, so it is never free"
    return f"joint {law.name} has no mode {abbreviate(mode)}"


# --- a phase ---


def add_modes(problem: Problem, manifest: Manifest, axes: Axes) -> Problem:
    """Return a problem with the forces, bounds and constraints of its modes, which are complete and right."""
    modes = dict(problem.modes)
    for joint in manifest.open_joints:
        problem = _add_joint(problem, manifest, joint, modes[joint.name])
    for contact in manifest.open_contacts:
        problem = _add_contact(problem, manifest, contact, modes[contact.name], axes[contact.name])
    return problem


def _add_joint(problem: Problem, manifest: Manifest, law: OpenJoint, mode: str) -> Problem:
    i, speed = _find_index(manifest, law), _name(manifest, "qd", law)
    assert speed is not None, "names are checked before"
    force = WrenchComponent(law.signal, SIGNAL, "0")
    constraints: tuple[Constraint, ...] = ()
    bounds = problem.bounds
    if mode in (FORWARD, BACKWARD):
        assert law.friction is not None, "modes are checked before"
        sign = 1 if mode == FORWARD else -1
        force = replace(force, expression=_write_friction(law.friction, speed, sign))
        kept = (0.0, MOST) if sign > 0 else (LEAST, 0.0)
        bounds = replace(bounds, qd=_put(bounds.qd, i, _intersect(bounds.qd[i], kept)))
    elif mode != FREE:
        force = replace(force, expression=None, bounds=_limit_holding(law, mode))
        constraints = (Constraint(speed, (0.0, 0.0), name=f"{law.name} at rest"),)
    if mode in (LOWER, UPPER):  # the limit itself, where a bound would leave no room
        bounds = replace(bounds, q=_put(bounds.q, manifest.positions.index(law.name), (LEAST, MOST)))
    return replace(
        problem,
        bounds=bounds,
        wrenches=(*problem.wrenches, force),
        constraints=(*problem.constraints, *constraints),
    )


def _write_friction(friction: Friction, speed: str, sign: int) -> str:
    """Write the force of a joint that slides to one side."""
    text = repr(friction.torque)
    if friction.stribeck is not None and friction.static != friction.torque:
        excess = friction.static - friction.torque
        text = f"({text} + {excess!r}*exp(-({speed}/{friction.stribeck!r})**2))"
    return f"-{text}" if sign > 0 else text


def _limit_holding(law: OpenJoint, mode: str) -> Range:
    """Return the range of the force on a joint that is held."""
    most = 0.0 if law.friction is None else law.friction.static
    way = 0 if law.friction is None else law.friction.one_way
    return LEAST if mode == UPPER or way < 0 else -most, MOST if mode == LOWER or way > 0 else most


def _add_contact(problem: Problem, manifest: Manifest, law: OpenContact, mode: str, axes: tuple[int, ...]) -> Problem:
    if mode == OPEN:
        gap = Constraint(_write_gap(law), (0.0, MOST), name=f"the gap of {law.name}")
        none = tuple(WrenchComponent(law.point, k, "0") for k in range(3))
        return replace(problem, wrenches=(*problem.wrenches, *none), constraints=(*problem.constraints, gap))
    contact = make_contact(law, mode, axes)
    problem = replace(problem, contacts=(*problem.contacts, contact))
    if contact.drag is None:
        return problem
    k, factor = contact.drag
    entry = find_component(manifest, law.point, law.axis)
    assert entry is not None, "contacts are opened with their wrenches"
    force = WrenchComponent(law.point, k, f"{factor!r}*{name_components(manifest)[entry]}")
    slip = Constraint(
        f"v{'xyz'[k]}_{law.point}", (0.0, MOST) if mode == FORWARD else (LEAST, 0.0), name=f"the slip of {law.name}"
    )
    return replace(problem, wrenches=(*problem.wrenches, force), constraints=(*problem.constraints, slip))


def make_contact(law: OpenContact, mode: str, axes: tuple[int, ...]) -> Contact:
    """Return a contact that is closed."""
    held = tuple(k for k in axes if k == law.axis or mode == STICK)
    drag = None
    if mode in (FORWARD, BACKWARD):
        (across,) = (k for k in axes if k != law.axis)
        drag = across, -law.coefficient if mode == FORWARD else law.coefficient
    return Contact(law.point, law.point, held, law.axis, law.coefficient if mode == STICK else None, drag)


def _write_gap(law: OpenContact) -> str:
    """Write the distance of a point from its plane."""
    place = f"{'xyz'[law.axis]}_{law.point}"
    return f"{place} - {law.height!r}" if law.height else place


# --- starts and links ---


def find_wrong_start(problem: Problem, manifest: Manifest) -> Iterator[Finding]:
    """Find joints that a start which no link gives puts elsewhere than at their stops, or moves the other way.

    Places are below `start`.
    """
    for law in manifest.open_joints:
        mode, k = dict(problem.modes)[law.name], _find_index(manifest, law)
        way, speed = {FORWARD: 1, BACKWARD: -1}.get(mode, 0), problem.start_qd[k]
        if way * speed < 0 and len(problem.start_q) + k not in problem.free_start:
            remedy = f"start at {'least' if way > 0 else 'most'} at 0, or free it by null"
            yield Finding(("velocity", law.name), f"{law.name} starts at {speed:g}, and moves {mode} here", remedy)
        limit, i = _find_limit(law, mode), manifest.positions.index(law.name)
        if limit is not None and i not in problem.free_start and abs(problem.start_q[i] - limit) > SAME:
            finding = f"{law.name} starts at {problem.start_q[i]:g}, and is at its stop at {limit:g} in this phase"
            yield Finding(("pose", law.name), finding, f"start at {limit:g}, or free it by null")


def begin(problem: Problem, manifest: Manifest) -> Problem:
    """Return a problem whose start, which no link gives, is at its stops and on its planes where it is free."""
    modes, n = dict(problem.modes), len(problem.start_q)
    added: list[Constraint] = []
    for law in manifest.open_joints:
        mode, i = modes[law.name], _find_index(manifest, law)
        limit, place = _find_limit(law, mode), manifest.positions.index(law.name)
        if limit is not None and place in problem.free_start:
            added.append(Constraint(_demand(manifest, "q", law), (limit, limit), "start"))
        if is_closed(law, mode) and n + i in problem.free_start:
            added.append(Constraint(_demand(manifest, "qd", law), (0.0, 0.0), "start"))
    for contact in manifest.open_contacts:
        if is_closed(contact, modes[contact.name]):
            added.append(Constraint(_write_gap(contact), (0.0, 0.0), "start", name=f"the gap of {contact.name}"))
    return replace(problem, constraints=(*problem.constraints, *(added if problem.free_start else ())))


def arrive(problem: Problem, after: Modes, hits: Modes, manifest: Manifest, *, jumps: bool) -> Problem:
    """Return a problem that ends where the modes of the phase after it, and hits between both, can begin.

    Unless the velocity jumps in between, a joint that sticks comes to rest because the phase after it begins at rest.
    """
    before = dict(problem.modes)
    places, speeds = dict(problem.end.coordinates), dict(problem.end.velocities)
    gaps: list[Constraint] = []
    for law in manifest.open_joints:
        i, mode, hit = _find_index(manifest, law), after[law.name], hits.get(law.name, "")
        limit = _find_limit(law, hit or mode)
        if limit is not None and before[law.name] != (hit or mode):
            places[manifest.positions.index(law.name)] = limit
        sticks = is_closed(law, mode) and not is_closed(law, before[law.name])
        if sticks and jumps and not _strikes(law, mode):
            speeds[i] = 0.0
    for contact in manifest.open_contacts:
        closes = is_closed(contact, after[contact.name]) or contact.name in hits
        if closes and not is_closed(contact, before[contact.name]):
            gaps.append(Constraint(_write_gap(contact), (0.0, 0.0), "end", name=f"the gap of {contact.name}"))
    end = replace(problem.end, coordinates=tuple(places.items()), velocities=tuple(speeds.items()))
    return replace(problem, end=end, constraints=(*problem.constraints, *gaps))


def strike(before: Modes, after: Modes, hits: Modes, manifest: Manifest, axes: Axes) -> Impact | None:
    """Return the impact between two phases; None where nothing arrives."""
    struck, kept = dict(hits), dict[str, str]()
    for name, law in list_laws(manifest).items():
        was, now = is_closed(law, before[name]), is_closed(law, after[name])
        if now and not was and _strikes(law, after[name]):
            struck[name] = after[name]
        elif now and was and (isinstance(law, OpenContact) or before[name] == after[name]):
            kept[name] = after[name]
    if not struck:
        return None
    during = kept | struck
    blows = tuple(
        Blow(
            _find_index(manifest, law), law.name, law.signal, mode == LOWER, _rebound(law) if law.name in hits else 0.0
        )
        for law in manifest.open_joints
        if (mode := during.get(law.name)) in (LOWER, UPPER)
    )
    points = [law for law in manifest.open_contacts if law.name in during]
    contacts = tuple(make_contact(law, during[law.name], axes[law.name]) for law in points)
    return Impact(contacts, max((_rebound(x) for x in points if x.name in hits), default=0.0), blows=blows)


def find_wrong_hits(before: Modes, after: Modes, hits: Modes, manifest: Manifest) -> Iterator[Finding]:
    """Find hits for parts without any, wrong sides, and hits for parts that a phase holds; places are below `hits`."""
    laws = list_laws(manifest)
    for name, mode in hits.items():
        law = laws.get(name)
        if law is None:
            yield Finding((name,), *_explain_unknown(name, [*laws], manifest))
            continue
        known = [x for x in list_modes(law) if x in (LOWER, UPPER) or (x != OPEN and isinstance(law, OpenContact))]
        if mode not in known:
            finding = f"{name} has no impact {abbreviate(mode)}"
            yield Finding((name,), finding, f"give {' or '.join(known)}" if known else "leave it out")
        elif is_closed(law, after[name]) or is_closed(law, before[name]):
            finding = f"{name} is held by the phase {'after' if is_closed(law, after[name]) else 'before'} its impact"
            remedy = "leave it out: with restitution 0, an impact needs no hit; or free it there"
            yield Finding((name,), finding, remedy)
    bounces = {law.restitution for law in manifest.open_contacts if law.name in hits}
    if len(bounces) > 1:
        yield Finding((), "contacts of different restitutions hit at once", "put their hits in separate links")


def is_closed(law: OpenJoint | OpenContact, mode: str) -> bool:
    """Return whether a mode keeps a joint at rest, or a point on its plane."""
    return mode != OPEN if isinstance(law, OpenContact) else mode in (STICK, LOWER, UPPER)


def _strikes(law: OpenJoint | OpenContact, mode: str) -> bool:
    """Return whether what comes to a mode may come with a speed, which its stop or plane takes."""
    return not _rebound(law) and (isinstance(law, OpenContact) or mode in (LOWER, UPPER))


def _rebound(law: OpenJoint | OpenContact) -> float:
    """Return the restitution."""
    if isinstance(law, OpenContact):
        return law.restitution
    return 0.0 if law.stops is None else law.stops.restitution or 0.0


def _find_limit(law: OpenJoint, mode: str) -> float | None:
    """Return the limit of a joint at which a mode keeps it, if it has a stop there."""
    stops: Stops | None = law.stops
    if stops is None or mode not in (LOWER, UPPER):
        return None
    return stops.lower if mode == LOWER else stops.upper


def _find_index(manifest: Manifest, law: OpenJoint) -> int:
    return [c.name for c in manifest.coordinates].index(law.name)


def _name(manifest: Manifest, kind: str, law: OpenJoint) -> str | None:
    """Return the name of a joint's coordinate or velocity in expressions."""
    i = manifest.positions.index(law.name) if kind == "q" else _find_index(manifest, law)
    return next((name for name, x in list_quantities(manifest).items() if (x.kind, x.index) == (kind, i)), None)


def _demand(manifest: Manifest, kind: str, law: OpenJoint) -> str:
    found = _name(manifest, kind, law)
    assert found is not None, "names are checked before"
    return found


def _put(ranges: tuple[Range, ...], i: int, limits: Range) -> tuple[Range, ...]:
    return tuple(limits if k == i else own for k, own in enumerate(ranges))


def _intersect(one: Range, other: Range) -> Range:
    return max(one[0], other[0]), min(one[1], other[1])
