"""Given motions of driven joints in a problem: expressions of t and T, with exact derivatives by t; and their forces.

In a program, coordinates q, velocities qd and accelerations a of driven joints are variables at every point, with the
equations

    q = f(t),    qd = f'(t),    a = f''(t),    t = s T,

so their derivatives by a free horizon T, and by unknowns that f reads, are exact. The forces tau of driven joints are
variables too; the equations of motion give them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen.documents import Finding, abbreviate, nearest
from mbsgen.expressions import Expression, ExpressionError, Program, names, parse
from mbsgen.manifest import Manifest
from mbsrun.closure import RANK, find_closure
from mbsrun.differentiation import differentiate_by
from mbsrun.ocp.ground import schemes
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.problem.problem import Drive, Form, Problem, Range
from mbsrun.quaternions import list_entries
from mbsrun.simulation.drive import ARRAYS, TIME

Array = NDArray[np.float64]

HORIZON = "T"
SAME = 1e-9  # relative, and absolute below 1: numbers of a motion that count as equal
OTHER = 1.37  # times the guess of a number that the solver chooses: another one


@cache
def derive(text: str) -> tuple[Expression, Expression, Expression]:
    """Return the expressions of coordinate, velocity and acceleration. Raises ExpressionError for a kink."""
    place = parse(text)
    velocity = differentiate_by(place, TIME)
    return place, velocity, differentiate_by(velocity, TIME)


def varies(text: str, problem: Problem) -> bool:
    """Return whether a motion depends on numbers that the solver chooses: a free horizon, unknowns."""
    chosen = {unknown.name for unknown in problem.unknowns}
    if not problem.is_timed:
        chosen |= {TIME, HORIZON}
    return bool(names(parse(text)) & chosen)


class Guide:
    """The motions of all driven joints, by number."""

    def __init__(
        self,
        drives: Sequence[Drive],
        manifest: Manifest,
        constants: Mapping[str, float] | None = None,
        unknowns: Mapping[str, float] | None = None,
    ) -> None:
        """Differentiate the motions; `unknowns` are their guesses, in order. Raises ExpressionError for a kink."""
        texts = {drive.joint: drive.expression for drive in drives}
        self.joints, self.places = list(manifest.driven), list_entries(manifest, manifest.driven)
        self.texts = [texts[i] for i in self.joints]
        self._program = Program([part for text in self.texts for part in derive(text)], ARRAYS)
        self._constants = {name: np.array([value]) for name, value in (constants or {}).items()}
        self._unknowns, self._guesses = list(unknowns or {}), np.array([*(unknowns or {}).values()])

    @staticmethod
    def of(problem: Problem, manifest: Manifest) -> Guide:
        """Return the motions of a problem."""
        unknowns = {unknown.name: unknown.guess for unknown in problem.unknowns}
        return Guide(problem.driven, manifest, dict(problem.constants), unknowns)

    def read(self, t: Array, horizon: float, unknowns: Array | None = None) -> tuple[Array, Array, Array]:
        """Return coordinates, velocities and accelerations (..., d) at times (...); without unknowns, by their guesses.

        Where an expression has no value, the number is not finite.
        """
        values = self._guesses if unknowns is None or not unknowns.size else unknowns
        known = self._constants | dict(zip(self._unknowns, values[:, None], strict=True))
        known |= {TIME: t.ravel(), HORIZON: np.array([horizon])}
        with np.errstate(all="ignore"):
            found = [np.broadcast_to(part, t.size).reshape(t.shape) for part in self._program.evaluate(known)]
        q, qd, qdd = (np.stack(found[order::3], axis=-1) for order in range(3))
        return q, qd, qdd

    def put(self, t: Array, horizon: float, unknowns: Array, *parts: Array) -> list[Array]:
        """Return q (..., nq), qd and perhaps qdd (..., n) with the entries of driven joints at times (...)."""
        found = [part.copy() for part in parts]
        places = (self.places, self.joints, self.joints)
        for part, entries, given in zip(found, places, self.read(t, horizon, unknowns), strict=False):
            part[..., entries] = given
        return found


def find_wrong_motions(drives: Sequence[Drive], known: Sequence[str], manifest: Manifest) -> Iterator[Finding]:
    """Find driven joints without a motion, motions of other joints, and expressions that are no motions.

    `known` are the names of constants and unknowns.
    """
    joints = [drive.joint for drive in drives]
    for i in manifest.driven:
        if i not in joints:
            name = manifest.coordinates[i].name
            yield Finding(
                ("driven",),
                f"the model drives {name}, and the problem gives no motion of it",
                f"give it under driven, as {name}: 0.1*t",
            )
    for i, drive in enumerate(drives):
        if drive.joint not in manifest.driven or drive.joint in joints[:i]:
            finding = "the joint has a motion already" if drive.joint in joints[:i] else "the model does not drive it"
            yield Finding(("driven", i), finding, "leave it out")
            continue
        try:
            read = names(parse(drive.expression))
            derive(drive.expression)
        except ExpressionError as error:
            yield Finding(("driven", i), error.finding, error.remedy)
            continue
        for name in sorted(read - {TIME, HORIZON, *known}):
            every = [TIME, HORIZON, *known]
            meant = nearest(name, every)
            remedy = f"did you mean {abbreviate(meant)}?" if meant else f"a motion reads {', '.join(every)}"
            yield Finding(("driven", i), f"unknown name {abbreviate(name)}", remedy)


def find_conflicts(problem: Problem, manifest: Manifest) -> Iterator[Finding]:
    """Find what a problem with driven joints asks for that their motions do not give; the motions are right."""
    if not manifest.driven:
        return
    coordinates = [c.name for c in manifest.coordinates]
    if problem.form is not Form.STANDARD:
        named = ", ".join(coordinates[i] for i in manifest.driven)
        finding = f"the {problem.form.value} form takes no driven joints, and the model drives {named}"
        yield Finding(("form",), finding, "take standard")
    places = list_entries(manifest, manifest.driven)
    for key, given, entries, labels in (
        ("pose", problem.end.coordinates, places, manifest.positions),
        ("velocity", problem.end.velocities, manifest.driven, coordinates),
        ("acceleration", problem.end.accelerations, manifest.driven, coordinates),
    ):
        for i, _ in given:
            if i in entries:
                yield Finding(("end", key, labels[i]), "its motion is given under driven", "leave it out")
    guide = Guide.of(problem, manifest)
    t = list_times(problem, schemes.build(problem.family, problem.degree).points)
    motion = guide.read(t, problem.horizon)
    for k, (i, place) in enumerate(zip(manifest.driven, places, strict=True)):
        text, entry = guide.texts[k], (coordinates[i],)
        q, qd = (part[:, k] for part in motion[:2])
        wrong = np.flatnonzero(~np.isfinite([part[:, k] for part in motion]).all(axis=0))
        if wrong.size:
            finding = f"the motion has no finite value or derivative at t = {t[wrong[0]]:.6g} s"
            yield Finding(("driven", *entry), finding, "mend its expression")
        elif not varies(text, problem):
            yield from _find_excess(t, q, problem.bounds.q[place], Finding(("driven", *entry), "the motion", ""))
            yield from _find_excess(t, qd, problem.bounds.qd[i], Finding(("driven", *entry), "the velocity", ""))
        elif manifest.dependent and _varies_at_start(guide, k, problem):
            finding = "the loops would start in a pose or at a velocity that the solver chooses"
            remedy = "let the motion start without t/T and unknowns, or give the horizon"
            yield Finding(("driven", *entry), finding, remedy)


def _find_excess(t: Array, values: Array, limits: Range, found: Finding) -> Iterator[Finding]:
    """Find where a known motion leaves the bounds of its joint; `found` names the motion as its finding."""
    lower, upper = limits
    excess = np.maximum(lower - values, values - upper)
    k = int(excess.argmax())
    if excess[k] > SAME * (1 + abs(values[k])):
        finding = f"{found.finding} is {values[k]:.6g} at t = {t[k]:.6g} s, out of [{lower:g}, {upper:g}]"
        yield replace(found, finding=finding, remedy="move it within the bounds, or widen these")


def _varies_at_start(guide: Guide, k: int, problem: Problem) -> bool:
    """Return whether motion k begins in another place, or at another velocity, where the solver chooses others."""
    values = np.array([unknown.guess for unknown in problem.unknowns])
    stretch = 1.0 if problem.is_timed else OTHER
    pairs = ((problem.horizon, values), (stretch * problem.horizon, OTHER * values + 1.0))
    one, other = (np.array(guide.read(np.zeros(1), *pair)[:2])[:, 0, k] for pair in pairs)
    return not np.allclose(one, other, rtol=SAME, atol=SAME)


def follow(motion: Trajectory, problem: Problem, manifest: Manifest) -> Trajectory:
    """Return a motion in which driven joints move as the problem says; its other parts stay as they are."""
    if not manifest.driven:
        return motion
    guide, T = Guide.of(problem, manifest), float(motion.t[-1])
    q, qd = guide.put(motion.t, T, motion.unknowns, motion.q, motion.qd)
    parts = (motion.point_q, motion.point_qd, motion.point_qdd)
    point_q, point_qd, point_qdd = guide.put(motion.point_t, T, motion.unknowns, *parts)
    return replace(motion, q=q, qd=qd, point_q=point_q, point_qd=point_qd, point_qdd=point_qdd)


def find_forces(plant: Plant, q: Array, qd: Array, qdd: Array, u: Array, w: Array) -> tuple[Array, Array]:
    """Find the multipliers (B, m) of loops and the forces (B, d) of driven joints by least squares, in B states.

    J^T lam + D tau = Phi, the residual without both, with the unit columns D of driven joints.
    """
    manifest, closure = plant.manifest, find_closure(plant)
    state = give_nothing(manifest, {"q": q, "qd": qd, "qdd": qdd, "u": u})
    if w.size:
        state["w"] = w
    Phi = plant("impl", **state)["Phi"]
    if closure is None:
        return np.zeros((len(q), 0)), np.asarray(Phi[:, list(manifest.driven)])
    J, count = closure.jacobian(q), len(closure.dependent)
    rows = np.concatenate((J, choose_rows(manifest, len(q))), axis=1).swapaxes(1, 2)
    found = (np.linalg.pinv(rows, rcond=RANK) @ Phi[..., None])[..., 0]
    return found[:, :count], found[:, count:]


def find_point_forces(plant: Plant, motion: Trajectory) -> tuple[Array, Array]:
    """Find the same at the points of a motion, (N, d, ...)."""
    N, d = motion.point_t.shape
    parts = (motion.point_q, motion.point_qd, motion.point_qdd, motion.spread_inputs()[0], motion.point_w)
    found = find_forces(plant, *(np.ascontiguousarray(part.reshape(N * d, part.shape[2])) for part in parts))
    multipliers, driving = (np.nan_to_num(part).reshape(N, d, -1) for part in found)
    return multipliers, driving


def choose_rows(manifest: Manifest, count: int) -> Array:
    """Return the rows of the identity that choose driven joints, (count, d, n)."""
    unit = np.eye(len(manifest.coordinates))[list(manifest.driven)]
    return np.tile(unit, (count, 1, 1))


def give_nothing(manifest: Manifest, state: dict[str, Any]) -> dict[str, Any]:
    """Return the inputs of the residual at a state (B, ...), without forces of loops and of driven joints."""
    count, found = len(state["q"]), dict(state)
    if manifest.dependent:
        found["lam"] = np.zeros((count, len(manifest.dependent)))
    if manifest.driven:
        found["tau"] = np.zeros((count, len(manifest.driven)))
    return found


def list_times(problem: Problem, points: Array) -> Array:
    """List the times of mesh and collocation points, (K,), at the guess of a free horizon."""
    t, point_t = problem.grid.times(problem.horizon, points)
    return np.unique(np.concatenate((t, point_t.ravel())))
