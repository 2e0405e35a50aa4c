"""Contacts: points of a mechanism that stand on the ground for the whole horizon, held by unknown forces.

    v_i(q_kj, qd_kj) = 0              at collocation points j = 2 .. d, along the axes that are held
    p_i(q_kd) - p_i(q_k0) = 0         over every interval, in place of the velocity at its first point
    f_n >= 0                          along the normal: the ground does not pull
    mu f_n >= |f_t|                   friction, one axis across: two rows
    mu f_n + e - sqrt(f_x^2 + f_y^2 + e^2) >= 0        two axes across

The forces are the multipliers of the velocities, of index 2, so the collocation is Radau's, which includes the mesh
points (Hairer, Wanner, "Solving ordinary differential equations II", VII.4). With v = 0 at all points, a point p would
creep over an interval by the error of Radau's quadrature of its velocity, O(h^(2d)). With p held at both ends, its
velocity at the first point is that error, divided by h and the weight of that point; so the order remains, and a place
does not drift. With d = 1 there is one velocity, which is held. The last row is the friction cone with its apex
rounded. It is convex, and its gradient does not vanish where the force does, as the gradient of mu^2 f_n^2 - |f_t|^2
would; the force across is at most e = 1 mN beyond the cone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbsgen.manifest import Manifest
from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.schemes import Family
from mbsrun.ocp.problem.problem import Contact, Form, Problem
from mbsrun.quantities import find_component, name_components
from mbsrun.quaternions import find_rates, list_quaternions

ROUNDED = 1e-3  # N: of the cone's apex
SAME = 1e-9  # relative difference of a force's power, by two kernels
AXES = "xyz"

Line = tuple[str, str, str]  # as in `checks`


def list_held(contacts: Sequence[Contact], manifest: Manifest) -> tuple[int, ...]:
    """Return the entries of w that contacts determine, contact by contact."""
    found = (find_component(manifest, contact.wrench, axis) for contact in contacts for axis in contact.axes)
    return tuple(i for i in found if i is not None)


@dataclass(frozen=True)
class Held:
    """The velocities that contacts keep at 0, and the components of w that keep them there."""

    entries: list[int]  # of the velocities of all sensors
    components: list[int]
    drags: tuple[tuple[int, int, float], ...] = ()  # of sliding ones: place in `components`, another component, ratio

    def clear(self, w: Array) -> Array:
        """Return w (B, nw) without the forces of contacts."""
        w = w.copy()
        w[:, [*self.components, *(across for _, across, _ in self.drags)]] = 0.0
        return w

    def push(self, by_force: Array) -> Array:
        """Return the derivatives of equations by the components that hold, of the ones by w, (B, n, nw)."""
        found = by_force[:, :, self.components]
        for k, across, ratio in self.drags:
            found[:, :, k] += ratio * by_force[:, :, across]
        return found

    def put(self, w: Array, forces: Array) -> None:
        """Put the forces (B, k) that hold contacts into w (B, nw), with the friction of sliding ones."""
        w[:, self.components] = forces
        for k, across, ratio in self.drags:
            w[:, across] = ratio * forces[:, k]

    def differentiate(self, plant: Plant, q: Array, qd: Array) -> tuple[Array, Array]:
        """Return J_c (B, k, n) and dJ_c/dt qd (B, k) of the velocities J_c qd at states q (B, nq), qd (B, n)."""
        slopes = plant("jac_motion", q=q, qd=qd)
        by_q, by_qd = (slopes[f"jac_v_{name}"][:, self.entries] for name in ("q", "qd"))
        return by_qd, np.einsum("bkn,bn->bk", by_q, find_rates(plant, q, qd))


def find_held(problem: Problem, manifest: Manifest) -> Held | None:
    """Find the velocities that a problem's contacts keep at 0; None without contacts."""
    if not problem.contacts:
        return None
    entries = [entry for contact in problem.contacts for entry in list_entries(contact, manifest)]
    components, drags = list(list_held(problem.contacts, manifest)), []
    for contact in problem.contacts:
        if contact.drag is not None and contact.normal is not None:
            normal, across = (find_component(manifest, contact.wrench, k) for k in (contact.normal, contact.drag[0]))
            assert normal is not None, "components are checked before"
            assert across is not None, "and so are the ones across"
            drags.append((components.index(normal), across, contact.drag[1]))
    return Held(entries, components, tuple(drags))


def list_entries(contact: Contact, manifest: Manifest) -> tuple[int, ...]:
    """Return the entries of a contact's velocities among the velocities of all sensors."""
    first = 3 * [frame.name for frame in manifest.frames if frame.sensor].index(contact.sensor)
    return tuple(first + axis for axis in contact.axes)


def write_friction(contact: Contact, manifest: Manifest) -> tuple[str, ...]:
    """Return expressions that friction keeps from being negative."""
    if contact.friction is None or contact.normal is None:
        return ()
    names = name_components(manifest)
    forces = {}
    for axis in contact.axes:
        i = find_component(manifest, contact.wrench, axis)
        assert i is not None, "components are checked before"
        forces[axis] = names[i]
    normal = forces.pop(contact.normal)
    across = list(forces.values())
    if len(across) == 1:
        return tuple(f"{contact.friction!r}*{normal} {sign} {across[0]}" for sign in "-+")
    if not across:
        return ()
    squares = " + ".join(f"{name}**2" for name in across)
    return (f"{contact.friction!r}*{normal} + {ROUNDED!r} - sqrt({squares} + {ROUNDED**2!r})",)


def find_faults(problem: Problem, manifest: Manifest) -> Iterator[Line]:
    """Find contacts that the model or the rest of the problem does not go together with."""
    sensors = [frame.name for frame in manifest.frames if frame.sensor]
    wrenches = {wrench.name: wrench for wrench in manifest.wrenches}
    given = {(part.wrench, part.component) for part in problem.wrenches if part.expression is not None}
    for k, contact in enumerate(problem.contacts):
        place, wrench = f"contacts[{k}]", wrenches.get(contact.wrench)
        if contact.sensor not in sensors:
            yield (f"{place}.sensor", f"the model has no sensor {contact.sensor}", f"there are {_list(sensors)}")
        if wrench is None or not wrench.force:
            finding = f"the model has no open wrench {contact.wrench} with a force"
            yield (f"{place}.wrench", finding, "give the model one at the sensor's point, with force: input")
        elif not wrench.in_base:
            finding = f"the force of {contact.wrench} is along axes of its body"
            yield (f"{place}.wrench", finding, "let the model give it along axes of the base (frame: base)")
        if not contact.axes or any(axis not in (0, 1, 2) for axis in contact.axes):
            yield (f"{place}.axes", f"found {contact.axes}", "give some of the axes x, y, z")
        elif len(set(contact.axes)) < len(contact.axes):
            yield (f"{place}.axes", f"found {contact.axes}", "give each axis once")
        if contact.normal is not None and contact.normal not in contact.axes:
            yield (f"{place}.normal", "the point is not held along its normal", "hold it there, or give normal: null")
        if contact.friction is not None and not 0 <= contact.friction < np.inf:
            yield (f"{place}.friction", f"found {contact.friction:g}", "give a number that is not negative")
        if contact.friction is not None and contact.normal is None:
            yield (f"{place}.friction", "friction without a normal", "give normal, too, or leave friction out")
        for axis in contact.axes:
            if (contact.wrench, axis) in given:
                finding = f"the force along {AXES[axis]} is given by an expression, and holds the point"
                yield (f"{place}.wrench", finding, "leave the expression out, or the axis")
    if len({contact.wrench for contact in problem.contacts}) < len(problem.contacts):
        yield ("contacts", "two contacts have the same wrench", "give each its own")
    if problem.contacts and problem.family is Family.LEGENDRE:
        finding = f"the points of {problem.family.value} are no mesh points, where a contact would slip"
        yield ("contacts", finding, "take scheme: radau")
    if problem.contacts and problem.form is not Form.STANDARD:
        yield ("contacts", f"the {problem.form.value} form takes no contacts", "take form: standard")


def find_stray_forces(problem: Problem, plant: Plant) -> Iterator[Line]:
    """Find contacts whose force acts at another point than their sensor's, by its power; and starts that slip."""
    manifest = plant.manifest
    n = len(manifest.coordinates)
    q = np.array(problem.start_q) + np.linspace(0.1, 0.7, len(problem.start_q))  # any pose
    for quaternion in list_quaternions(manifest):
        q[quaternion.entries] /= np.linalg.norm(q[quaternion.entries])
    every = (*problem.contacts, *problem.touching)
    if not every or not np.isfinite(q).all():
        return
    none = {"qd": np.zeros(n), "qdd": np.zeros(n), "u": np.zeros(len(manifest.actuated))}
    state: dict[str, Any] = {"q": q, **none, "w": np.zeros(len(name_components(manifest)))}
    if manifest.dependent:
        state["lam"] = np.zeros(len(manifest.dependent))
    by_force = -plant("jac_impl", **state)["jac_Phi_w"]
    velocities = [find_velocities(plant, q, qd) for qd in np.eye(n)]
    start = find_velocities(plant, np.array(problem.start_q), np.array(problem.start_qd))
    free = set(problem.free_start)
    for k, contact in enumerate(every):
        held, entries = list_held([contact], manifest), list_entries(contact, manifest)
        moved = np.array([v[list(entries)] for v in velocities])  # (n, axes)
        difference = np.abs(by_force[:, list(held)] - moved).max(initial=0.0)
        if difference > SAME * max(1.0, float(np.abs(moved).max(initial=0.0))):
            finding = f"the force of {contact.wrench} does not act at {contact.sensor}"
            yield (f"contacts[{k}]", finding, "let the model place both at the same point of one body")
        slip = np.abs(start[list(entries)]).max(initial=0.0)
        if not free and slip > SAME and k < len(problem.contacts):
            finding = f"{contact.sensor} moves at the start, at {slip:.3g} m/s"
            yield (f"contacts[{k}]", finding, "give a start at which it stands, or free velocities")


def find_velocities(plant: Plant, q: Array, qd: Array) -> Array:
    """Return the velocities of all sensors, one after the other."""
    return np.asarray(plant("motion", q=q, qd=qd)["v"].T.ravel())


def measure_slip(problem: Problem, plant: Plant, q: Array) -> float | None:
    """Return how far contacts move along the axes that are held, in states q (K, nq); None without contacts."""
    if not problem.contacts:
        return None
    entries = [i for contact in problem.contacts for i in list_entries(contact, plant.manifest)]
    places = locate(plant, q, entries)
    return float(np.abs(places - places[0]).max(initial=0.0))


def locate(plant: Plant, q: Array, entries: Sequence[int]) -> Array:
    """Return entries of the positions of all sensors, in poses q (..., nq)."""
    places = plant("sensors", q=q)["position"].swapaxes(-1, -2)
    return np.asarray(places.reshape(*q.shape[:-1], -1)[..., list(entries)])


def _list(names: Sequence[str]) -> str:
    return ", ".join(names) or "none"
