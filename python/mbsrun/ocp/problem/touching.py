"""Contacts whose times are not given: complementarity of force and distance, and of friction and slip, relaxed.

    g = p_n - height >= 0,    f_n >= 0,    g f_n <= e                         a force only where the distance is 0
    mu f_n >= |f_t|
    v_t (mu f_n + f_t) <= e,    -v_t (mu f_n - f_t) <= e                      friction is against the slip

and with two axes across, with an unknown number s that is the speed of the slip,

    (mu f_n)^2 - |f_t|^2 >= 0,    s >= 0,    s ((mu f_n)^2 - |f_t|^2) <= e
    |mu f_n v_t + s f_t| <= e                                                 on each axis: friction is against the slip

at all collocation points (Posa, Cantu, Tedrake, "A direct method for trajectory optimization of rigid bodies through
contact", Int. J. Robotics Research 33, 2014; products of the third line replace their variables of slip: each factor in
brackets is not negative). A point that slides to the positive side has f_t = -mu f_n: friction takes out as much power
as it can. The solver solves for large e first, and starts each solve from the one before. A point that lands keeps no
velocity along its normal. The unknown s avoids the norm of the slip, which has no derivative where a point sticks.
"""

from __future__ import annotations

import re
from collections.abc import Container, Iterator, Sequence
from dataclasses import replace

import numpy as np

from mbsgen.manifest import Manifest
from mbsrun.ocp.problem.contacts import AXES, write_friction
from mbsrun.ocp.problem.problem import Constraint, Contact, Problem, WrenchComponent
from mbsrun.quantities import find_component, list_quantities, name_components

SLIP = 0.1  # m/s: the guess of the speed of a slip


def list_across(contact: Contact) -> list[int]:
    """List the axes across the normal."""
    return [axis for axis in contact.axes if axis != contact.normal]


def name_slip(contact: Contact, taken: Container[str]) -> str | None:
    """Name the speed of a contact's slip, by no name that is taken; None where no unknown number is needed."""
    if len(list_across(contact)) < 2:
        return None
    name = "slip_" + re.sub(r"\W", "_", contact.sensor, flags=re.ASCII)
    while name in taken:
        name += "_"
    return name


def list_constraints(
    contact: Contact, height: float, last: float, manifest: Manifest, slip: str | None = None
) -> Iterator[Constraint]:
    """List the constraints of a contact; the products have the range up to e, and are relaxed.

    `slip` is the name of the speed of its slip, where there are two axes across.
    """
    assert contact.normal is not None, "contacts are checked before"
    n, across = contact.normal, list_across(contact)
    positions, velocities = (_name_sensor(contact, manifest, kind) for kind in ("position", "v"))
    forces = {axis: _name_force(contact, manifest, axis) for axis in contact.axes}
    gap = f"({positions[n]} - {height!r})" if height else positions[n]
    yield Constraint(gap, (0.0, np.inf))
    yield _relax(f"{gap}*{forces[n]}", last)
    limit = f"{contact.friction!r}*{forces[n]}"
    if len(across) == 1:
        for text in write_friction(contact, manifest):
            yield Constraint(text, (0.0, np.inf))
        v, f = velocities[across[0]], forces[across[0]]
        yield _relax(f"{v}*({limit} + {f})", last)
        yield _relax(f"-{v}*({limit} - {f})", last)
    elif across:
        assert slip is not None, "there are two axes across"
        cone = f"({limit})**2 - {forces[across[0]]}**2 - {forces[across[1]]}**2"
        yield Constraint(cone, (0.0, np.inf))
        yield _relax(f"{slip}*({cone})", last)
        for axis in across:
            text = f"{limit}*{velocities[axis]} + {slip}*{forces[axis]}"
            yield _relax(text, last)
            yield _relax(f"-({text})", last)


def _relax(text: str, last: float) -> Constraint:
    return Constraint(text, (-np.inf, last), is_relaxed=True)


def _name_sensor(contact: Contact, manifest: Manifest, kind: str) -> list[str]:
    """Return the names of the three components of a sensor's position or velocity."""
    first = 3 * [frame.name for frame in manifest.frames if frame.sensor].index(contact.sensor)
    known = {x.index: name for name, x in list_quantities(manifest).items() if x.kind == kind}
    return [known[first + axis] for axis in range(3)]


def _name_force(contact: Contact, manifest: Manifest, axis: int) -> str:
    index = find_component(manifest, contact.wrench, axis)
    assert index is not None, "contacts are checked before"
    return str(name_components(manifest)[index])


def list_components(contact: Contact, given: tuple[WrenchComponent, ...]) -> Iterator[WrenchComponent]:
    """List the components of a contact's force that a problem leaves out: unknowns along its axes, and zeros."""
    known = {part.component for part in given if part.wrench == contact.wrench}
    for axis in range(3):
        if axis not in known:
            least = 0.0 if axis == contact.normal else -np.inf
            expression = None if axis in contact.axes else "0"
            yield WrenchComponent(contact.wrench, axis, expression, (least, np.inf))


def find_faults(contact: Contact, manifest: Manifest) -> Iterator[tuple[str, str, str]]:
    """Find the part of a contact that is wrong: key, finding, remedy."""
    sensors = [frame.name for frame in manifest.frames if frame.sensor]
    wrenches = {wrench.name: wrench for wrench in manifest.wrenches}
    wrench = wrenches.get(contact.wrench)
    if contact.sensor not in sensors:
        yield "sensor", f"the model has no sensor {contact.sensor}", f"there are {', '.join(sensors) or 'none'}"
    if wrench is None or not wrench.force:
        finding = f"the model has no open wrench {contact.wrench} with a force"
        yield "wrench", finding, "give the model one at the sensor's point, with force: input"
    elif not wrench.in_base:
        finding = f"the force of {contact.wrench} is along axes of its body"
        yield "wrench", finding, "let the model give it along axes of the base (frame: base)"
    if contact.normal is None or contact.normal not in contact.axes:
        yield "normal", "complementarity needs a normal among the axes", f"give one of {'xyz'}, and axes that hold it"
    across = [AXES[axis] for axis in list_across(contact)]
    if across and contact.friction is None:
        finding = f"forces along {', '.join(across)} without friction would not know when to act"
        yield "friction", finding, f"give a coefficient, or axes: {AXES[contact.normal or 0]}"


def set_relaxation(problem: Problem, amount: float) -> Problem:
    """Return the same problem with another e."""
    constraints = tuple(
        replace(part, range=(part.range[0], amount)) if part.is_relaxed else part for part in problem.constraints
    )
    return replace(problem, constraints=constraints)


def list_relaxed(problems: Sequence[Problem]) -> Iterator[list[Problem]]:
    """List problems that are solved together with their relaxations, step by step; the last ones are at their last e.

    Where one has fewer steps, it begins later.
    """
    every = [list_steps(problem) for problem in problems]
    count = max(map(len, every), default=0)
    for k in range(count):
        yield [
            set_relaxation(problem, steps[max(0, k - count + len(steps))]) if steps else problem
            for problem, steps in zip(problems, every, strict=True)
        ]


def list_steps(problem: Problem) -> tuple[float, ...]:
    """List the values of e, from the first to the last; none without contacts of this kind."""
    relaxation = problem.relaxation
    if relaxation is None or not any(part.is_relaxed for part in problem.constraints):
        return ()
    steps, amount = [], relaxation.first
    while amount > relaxation.last * (1 + 1e-9):
        steps.append(amount)
        amount *= relaxation.factor
    return (*steps, relaxation.last)
