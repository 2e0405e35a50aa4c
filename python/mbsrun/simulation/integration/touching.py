"""Motions with rigid contacts, from event to event: points touch, slip, stick and leave; methods keep their order.

Between events the points keep their mode (`contacts`), and the explicit method takes steps in its equations. After
each, coordinates and velocities are put back on the equations of closed points. An event is where a distance, a normal
force, a slip, or the reserve of friction falls below 0. Steps from the start of the step in which it lies find it to
rounding. Impacts obey Newton's hypothesis, with friction. A rebound that rises by less than REBOUND is the last one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from mbsrun.simulation.drive import Piece
from mbsrun.simulation.dynamics import Dynamics
from mbsrun.simulation.integration.contacts import Contacts, Loads, Mode, ParadoxError, Search, State, Touch
from mbsrun.simulation.integration.events import MANY, MOST
from mbsrun.simulation.integration.stepwise import Stepwise
from mbsrun.simulation.integration.tableaus import Pair
from mbsrun.simulation.motion import Chunk, Event, Halt, HaltError, Impacts, Kind, Segment, Settings

Array = NDArray[np.float64]

TOUCH = 1e-11  # m: a point that is as near touches
STILL = 1e-11  # of the fastest velocity of a point, by its terms: a slower one is at rest
CREEP = 1e-9  # the same of the velocity itself, where the slip has just turned round: in a plane it seldom vanishes
REBOUND = 1e-13  # m: a rebound that rises less is the last one; coordinates are rounded to 1e-16
SLOW = 1e-3  # m/s: only a slower rebound may be the last one
ROUNDED = 1e-15  # m: the rounding of distances, so that times of impacts at a speed v have errors of ROUNDED/v
SLACK = 1e-13  # of the forces: by how much they may exceed what friction holds


class Bound(Enum):
    """A number that is not negative while a mode lasts."""

    GAP = "the distance of an open point"
    PRESS = "the normal force of a closed one"
    PUSH = "what a coupling bears beyond its force, the other way"
    SLIP = "the velocity of a slipping one, along the way in which it began"
    HOLD = "the reserve of friction of one that sticks"


@dataclass(frozen=True)
class Guard:
    """A bound of a point."""

    point: int
    bound: Bound


@dataclass(frozen=True, eq=False)
class Strike:
    """A phase of an impact: M (after - before) = impulses; velocities along normals are -e times the ones before."""

    q: Array
    before: Array
    mode: Mode
    loads: Loads  # `qdd` are the velocities after it
    restitution: Array  # (P,)
    leaving: Array | None = (
        None  # (P,): by point: the ratio of its impulse to the one of the phase before, if it leaves
    )


@dataclass(frozen=True, eq=False)
class Passage:
    """The mode of some steps, and what led to it at their start."""

    mode: Mode
    guards: tuple[Guard, ...] = ()  # that fell to 0
    strikes: tuple[Strike, ...] = ()


class TouchingCourse(Stepwise[Mode, Guard]):
    """A motion of points that touch, stick, slip and leave."""

    switches = "contacts"
    lost, remedy = ParadoxError, "lessen the friction, or give contacts a stiffness"

    def __init__(self, dynamics: Dynamics, pair: Pair, settings: Settings) -> None:
        super().__init__(dynamics, pair, settings)
        self.contacts = Contacts(self.dynamics)
        self.released: set[int] = set()
        self.torn: set[int] = set()  # points that latches no longer hold
        self.turned: set[int] = set()  # points whose slip has just turned round
        self.latches = {k: x for k, name in enumerate(self.contacts.stops) for x in settings.latches if x.name == name}
        self.idle: set[int] = set()  # latches and couplings whose time it is not
        self.coupled: set[int] = set()  # couplings that hold,
        self.worn: set[int] = set()  # and worn ones, until their times end: their force was exceeded
        self.landings: dict[int, list[tuple[float, float]]] = {}  # of points: when they rest, by each slow rebound
        self.fastest = 0.0  # velocity of a point, so far,
        self.reach = 0.0  # and the same by its terms
        self.passed: tuple[Event, ...] = ()
        self.loss = 0.0
        self.strikes: tuple[Strike, ...] = ()  # impacts since the last chunk

    # --- at one state ---

    def settle(self, time: float, piece: Piece, q: Array, qd: Array) -> tuple[Array, Array]:
        """Pass the impacts at a state, and find the mode then; return the state."""
        contacts, events = self.contacts, list[Event]()
        self.couple(time, q)
        q = self.place(q, self.list_near(contacts.touch(q[None], qd[None])).tolist())
        M = self.dynamics.mass_matrix(q, qd, piece.at(time, q, qd))
        for number in range(MOST):
            touch = contacts.touch(q[None], qd[None])
            self.fastest = max(self.fastest, float(np.abs(touch.velocity).max()))
            self.reach = max(self.reach, float(touch.reach.max()))
            near = self.list_near(touch)
            qd = self.still(touch, M, qd, near)
            touch = contacts.touch(q[None], qd[None])
            speed = np.where(np.abs(touch.speed[0]) <= STILL * self.reach, 0.0, touch.speed[0])
            if not ((speed[near] < 0) | ((speed[near] > 0) & np.isin(near, list(self.coupled)))).any():
                break
            qd, found = self.hit(time, piece, q, qd, M, touch, near, speed, bounces=number < MANY)
            events += found
        else:
            raise HaltError(Halt(time, None, f"{MOST} impacts at one time", "change a restitution a little"))
        mode = self.decide(time, piece, q, qd, self.list_closing(near, speed))
        if self.mode is not None:
            told = {event.joint for event in events if event.kind is Kind.REST}
            events += [x for x in self.compare(time, touch, mode) if not (x.kind is Kind.REST and x.joint in told)]
        self.mode, self.passed = mode, (*self.passed, *events)
        self.released, self.turned, self.torn = set(), set(), set()
        return q, qd

    def couple(self, time: float, q: Array) -> None:
        """See which latches hold at a time; let couplings hold their numbers where they are."""
        couplings = set(np.flatnonzero(self.contacts.couples).tolist())
        self.idle = {k for k, latch in self.latches.items() if not latch.holds(time)} | couplings - self.latches.keys()
        self.coupled -= self.idle
        self.worn -= self.idle
        for k in couplings - self.idle - self.coupled - self.worn:
            self.coupled.add(k)
            self.contacts.places[k] = self.contacts.measure(q)[k]

    def list_near(self, touch: Touch) -> NDArray[np.intp]:
        """List the points that touch, in one state."""
        idle = self.contacts.couples & ~np.isin(np.arange(len(self.contacts.names)), list(self.coupled))
        return np.flatnonzero((touch.gap[0] <= TOUCH) & ~idle)

    def list_closing(self, near: NDArray[np.intp], speed: Array) -> list[int]:
        """List the points that do not move away; couplings keep theirs either way."""
        return [int(k) for k in near if speed[k] <= 0 or k in self.coupled]

    def place(self, q: Array, closed: list[int]) -> Array:
        """Put points that touch at the distance 0, by a small change of coordinates (..., nq)."""
        placed = q.reshape(-1, q.shape[-1])
        for _ in range(3 if closed else 0):
            gap, normal, slide = self.contacts.locate(placed)
            rows = np.einsum("kpi,kpin->kpn", normal[:, closed], slide[:, closed])
            change = -_find_least(rows, gap[:, closed])
            placed = placed + self.dynamics.rates(placed, change)
            if np.abs(change).max() < 1e-15:
                break
        return placed.reshape(q.shape)

    def still(self, touch: Touch, M: Array, qd: Array, near: NDArray[np.intp]) -> Array:
        """Take rounding out of the velocities of points that are at rest."""
        rows = []
        for k in near:
            n, S, v = touch.normal[0, k], touch.slide[0, k], touch.velocity[0, k]
            if abs(n @ v) > STILL * self.reach:
                continue
            sticks = self.contacts.coefficient[k] > 0 and self.is_still(k, v - (n @ v) * n)
            rows += list(S) if sticks else [n @ S]
        return qd - _lift(np.array(rows), M, np.array(rows) @ qd) if rows else qd

    def hit(
        self,
        time: float,
        piece: Piece,
        q: Array,
        qd: Array,
        M: Array,
        touch: Touch,
        near: NDArray[np.intp],
        speed: Array,
        *,
        bounces: bool,
    ) -> tuple[Array, list[Event]]:
        """Pass one impact; a rebound that is too low to be seen is none."""
        restitution = self.contacts.restitution * bounces
        points = self.list_closing(near, speed)
        after, loads, strikes = self.strike(q, qd, M, touch, points, restitution, speed)
        last = dict[int, float]()
        rebound = np.einsum("pi,pin,n->p", touch.normal[0], touch.slide[0], after)
        rebounding = [k for k in points if restitution[k] > 0 > speed[k] and 0 < rebound[k] < SLOW]
        self.landings = {k: x for k, x in self.landings.items() if k in rebounding or k not in points}
        if rebounding:
            inertia = self.contacts.find_free(q[None], after[None], piece.at(time, q, after)[None])
            found = self.contacts.touch(q[None], after[None])
            rest = [k for k in points if rebound[k] <= STILL * self.reach]  # they hold while others rebound
            slipping, held = self.find_slipping(found, rest), self.find_held(rest)
            qdd = Search(self.contacts, found, inertia, rest, slipping, held=held).find()[1].qdd[0]
            fall = np.einsum("pi,pin,n->p", found.normal[0], found.slide[0], qdd) + found.pull[0]
            for k in rebounding:
                if fall[k] >= 0 or self.contacts.restitution[k] == 1:
                    continue
                rests = time - float(2 * rebound[k] / fall[k] / (1 - self.contacts.restitution[k]))
                self.landings.setdefault(k, []).append((rests, float(rebound[k])))
                if rebound[k] ** 2 <= -2 * fall[k] * REBOUND:
                    last[k] = find_rest(self.landings.pop(k))
            if last:
                restitution[list(last)] = 0.0
                after, loads, strikes = self.strike(q, qd, M, touch, points, restitution, speed)
        self.strikes = (*self.strikes, *strikes)
        self.loss += 0.5 * float((qd - after) @ M @ (qd + after))
        ends = np.einsum("pi,pin,n->p", touch.normal[0], touch.slide[0], after)
        names = self.contacts.names
        return after, [
            Event(last.get(k, time), names[k], Kind.REST if k in last else Kind.IMPACT, float(speed[k]), float(ends[k]))
            for k in points
            if speed[k] < 0 or loads.normal[0, k] > 1e-12 * loads.normal.max() or (k in self.coupled and speed[k] > 0)
        ]

    def strike(
        self, q: Array, qd: Array, M: Array, touch: Touch, points: list[int], restitution: Array, speed: Array
    ) -> tuple[Array, Loads, tuple[Strike, ...]]:
        """Return the velocities after an impact, its impulses, and its phases."""
        slipping = self.find_slipping(touch, points)
        held, none = self.find_held(points), np.zeros((1, len(speed)))

        def solve(before: Array, goal: Array, given: Array | None = None) -> tuple[Mode, Loads]:
            inertia = M[None], before[None]
            return Search(self.contacts, touch, inertia, points, slipping, goal=goal, held=held, given=given).find()

        if self.settings.impacts is Impacts.NEWTON:
            mode, loads = solve(qd, (-restitution * speed)[None])
            return loads.qdd[0], loads, (Strike(q, qd, mode, loads, restitution),)
        mode, pressed = solve(qd, none)
        leaving, found = solve(pressed.qdd[0], none, restitution * np.maximum(pressed.normal[0], 0))
        phases = (
            Strike(q, qd, mode, pressed, none[0]),
            Strike(q, pressed.qdd[0], leaving, found, none[0], leaving=restitution),
        )
        return found.qdd[0], replace(found, normal=pressed.normal + found.normal), phases

    def decide(self, time: float, piece: Piece, q: Array, qd: Array, points: list[int]) -> Mode:
        """Find the mode in which the motion goes on."""
        touch = self.contacts.touch(q[None], qd[None])
        inertia = self.contacts.find_free(q[None], qd[None], piece.at(time, q, qd)[None])
        slipping = self.find_slipping(touch, points)
        while True:
            held = self.find_held(points)
            mode, loads = Search(self.contacts, touch, inertia, points, slipping, self.released, held=held).find()
            force = np.where(self.contacts.couples, -np.abs(loads.normal[0]), loads.normal[0])
            torn = {k for k in held if force[k] < -self.contacts.hold[k]}
            if not torn:
                break
            self.tear(torn)
            points = [k for k in points if k not in self.worn]
        rows = self.list_rows(touch.normal, touch.slide, mode)[0]
        is_locked = len(rows) > 0 and np.linalg.matrix_rank(rows, tol=1e-9) == self.dynamics.size
        return replace(mode, is_locked=is_locked)

    def tear(self, points: set[int]) -> None:
        """Note the latches and couplings that hold no longer."""
        self.torn |= points
        self.worn |= points & self.coupled
        self.coupled -= points

    def find_held(self, points: list[int]) -> set[int]:
        """List the points that latches and couplings hold."""
        return {k for k in points if self.contacts.hold[k] > 0} - self.torn - self.idle

    def find_slipping(self, touch: Touch, points: list[int]) -> list[int]:
        """List the points that slip."""
        return [k for k in points if not self.is_still(k, touch.slip[0, k])]

    def is_still(self, point: int, slip: Array) -> bool:
        """Return whether a slip (3,) counts as none."""
        return bool(np.linalg.norm(slip) <= max(STILL * self.reach, CREEP * self.fastest * (point in self.turned)))

    def compare(self, time: float, touch: Touch, mode: Mode) -> Iterator[Event]:
        """List the changes of modes, impacts aside."""
        assert self.mode is not None, "there was a mode"
        for k, (old, new) in enumerate(zip(self.mode.states, mode.states, strict=True)):
            kind = _name_change(old, new)
            if kind is None and old == new == State.SLIP and self.mode.ways[k] @ mode.ways[k] < -0.5:
                kind = Kind.REVERSE
            if kind is not None:
                speed = float(touch.speed[0, k])
                yield Event(time, self.contacts.names[k], kind, speed, speed)

    # --- from state to state ---

    def rate(self, piece: Piece, mode: Mode, t: Array, x: Array) -> tuple[Array, Touch, Loads]:
        """Return the rates of states (K, nq + n), with the points and their loads."""
        q, qd = np.split(x, [self.dynamics.places], axis=1)
        touch = self.contacts.touch(q, qd)
        loads = self.contacts.load(touch, *self.contacts.find_free(q, qd, piece.follow(t, q, qd)), mode)
        return np.hstack((self.dynamics.rates(q, qd), loads.qdd)), touch, loads

    def move(self, piece: Piece, mode: Mode, t: Array, x: Array) -> Array:
        """Return the rates of states; no contact is asked for where none acts."""
        if mode.closed:
            return self.rate(piece, mode, t, x)[0]
        q, qd = np.split(x, [self.dynamics.places], axis=1)
        return np.hstack((self.dynamics.rates(q, qd), self.contacts.find_free(q, qd, piece.follow(t, q, qd))[1]))

    def finish(self, mode: Mode, x: Array) -> Array:
        """Put states back on the equations of closed points."""
        closed = mode.closed
        if not closed:
            return x
        q, qd = np.split(x, [self.dynamics.places], axis=1)
        q = self.place(q, closed)
        J = self.list_rows(*self.contacts.locate(q)[1:], mode)
        return np.hstack((q, qd - _find_least(J, (J @ qd[..., None])[..., 0])))

    def list_rows(self, normal: Array, slide: Array, mode: Mode) -> Array:
        """List the derivatives by qd of the velocities that a mode keeps at 0, (K, rows, n)."""
        rows = [np.zeros((len(slide), 0, self.dynamics.size))]
        for k in mode.closed:
            sticks = mode.states[k] == State.STICK and self.contacts.coefficient[k] > 0
            rows.append(slide[:, k] if sticks else normal[:, k, None] @ slide[:, k])
        return np.concatenate(rows, axis=1)

    # --- events ---

    def list_guards(self, mode: Mode) -> list[Guard]:
        """List what must not fall below 0 while a mode lasts."""
        guards = []
        for k, state in enumerate(mode.states):
            if state == State.OPEN:
                guards += [] if self.contacts.couples[k] else [Guard(k, Bound.GAP)]
                continue
            guards.append(Guard(k, Bound.PRESS))
            guards += [Guard(k, Bound.PUSH)] if self.contacts.couples[k] else []
            if self.contacts.coefficient[k] > 0:
                guards.append(Guard(k, Bound.HOLD if state == State.STICK else Bound.SLIP))
        return guards

    def measure(self, piece: Piece, mode: Mode, guards: list[Guard], t: Array, x: Array) -> Array:
        """Return the guards at states, (K, guards)."""
        _, touch, loads = self.rate(piece, mode, t, x)
        self.reach = max(self.reach, float(touch.reach.max()))
        slack = SLACK * np.abs(loads.normal).max(axis=1)
        columns = []
        for guard in guards:
            k = guard.point
            match guard.bound:
                case Bound.GAP:
                    columns.append(touch.gap[:, k])
                case Bound.SLIP:
                    columns.append(touch.slip[:, k] @ mode.ways[k])
                case Bound.PRESS:
                    columns.append(loads.normal[:, k] + self.contacts.hold[k] * (k not in self.idle) + slack)
                case Bound.PUSH:
                    columns.append(self.contacts.hold[k] - loads.normal[:, k] + slack)
                case Bound.HOLD:
                    most = self.contacts.coefficient[k] * loads.normal[:, k] + slack
                    columns.append(most - np.linalg.norm(loads.friction[:, k], axis=1))
        return np.stack(columns, axis=1)

    def descend(self, guards: list[Guard], x: Array) -> Array:
        """Return the rates of distances at states (K, nq + n), shape (K, guards); 0 of other guards."""
        rates = super().descend(guards, x)
        gaps = [(j, guard.point) for j, guard in enumerate(guards) if guard.bound is Bound.GAP]
        if gaps:
            q, qd = np.split(x, [self.dynamics.places], axis=1)
            _, normal, slide = self.contacts.locate(q)
            speed = np.einsum("kpi,kpin,kn->kp", normal, slide, qd)
            speed[np.abs(speed) <= STILL * self.reach] = 0.0
            for j, point in gaps:
                rates[:, j] = speed[:, point]
        return rates

    def release(self, *_: object) -> None:
        """Note the points that are no longer held, or that turn round."""
        self.released = {x.point for x in self.fired}
        self.torn = set[int]()
        self.tear({x.point for x in self.fired if x.bound in (Bound.PRESS, Bound.PUSH)})
        self.turned = {x.point for x in self.fired if x.bound is Bound.SLIP}

    def gather(self, piece: Piece, mode: Mode, times: list[float], states: list[Array]) -> Chunk:
        """Bundle steps with the motion and the forces within them."""
        t, x = np.array(times), np.array(states)
        q, qd = np.split(x, [self.dynamics.places], axis=1)

        def push(at: Array, places: Array, speeds: Array) -> tuple[Array, Array, Array]:
            _, touch, loads = self.rate(piece, mode, at, np.hstack((places, speeds)))
            force = loads.normal[..., None] * touch.normal + loads.friction
            lost = -(loads.friction * touch.slip).sum(axis=(1, 2))
            return loads.qdd, force.reshape(len(at), -1), lost

        passage = Passage(mode, self.guards, self.strikes)
        segment = Segment((0,) * self.dynamics.size, self.passed, self.loss, push=push, passage=passage)
        if len(t) > 1:
            self.passed, self.loss, self.guards, self.strikes = (), 0.0, (), ()
        return Chunk(t, q, qd, self.interpolate(piece, mode, t, x), segment=segment)


def find_rest(landings: list[tuple[float, float]]) -> float:
    """Return the time of rest, by forecasts of a geometric series at each rebound, with their speeds.

    Times of slow impacts are rounded most. So the earliest forecast counts that later ones repeat, to their rounding.
    """
    k = len(landings) - 1
    while k and abs(landings[k - 1][0] - landings[k][0]) <= ROUNDED / landings[k][1]:
        k -= 1
    return landings[k][0]


def _lift(J: Array, M: Array, right: Array) -> Array:
    """Return the change of velocities, least in M, with J change = right."""
    response = np.linalg.solve(M, J.T)
    return np.asarray(response @ (np.linalg.pinv(J @ response, rcond=1e-10) @ right))


def _find_least(J: Array, right: Array) -> Array:
    """Return the least changes (K, n) with J change = right, J (K, m, n)."""
    return np.asarray((np.linalg.pinv(J, rcond=1e-10) @ right[..., None])[..., 0])


def _name_change(old: State, new: State) -> Kind | None:
    if old == new:
        return None
    if new == State.OPEN:
        return Kind.LEAVE
    if old == State.OPEN:
        return Kind.REST
    return Kind.STICK if new == State.STICK else Kind.SLIP
