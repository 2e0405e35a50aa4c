"""Modes of phases, simulated again from event to event: the same inputs on the model as its file describes it.

The simulation knows nothing of the phases. It starts where the first one starts, and is never put back on the solution.
It has a part for each interval, in which inputs are smooth. Amid each phase, its modes are compared with the ones that
the phase states; every event must be near the end of a phase: within the square root of the accuracy, relative to the
duration, since a joint that comes to rest does so at a time with half the digits.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mbsgen.errors import MbsError
from mbsgen.manifest import Manifest
from mbsrun.kernel import Kernels
from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.plant import Openable, Plant
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.problem.design import equip
from mbsrun.ocp.problem.modes import BACKWARD, FORWARD, FREE, LOWER, STICK, UPPER, is_closed
from mbsrun.ocp.problem.phases import Plants
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solution.phases import Followed, PhasedSolution
from mbsrun.ocp.solution.solution import Solution
from mbsrun.simulation.drive import Drive, follow_polynomials
from mbsrun.simulation.motion import Mode, Motion, Settings
from mbsrun.simulation.simulate import simulate

TOLERANCE = 1e-12  # of steps, relative and absolute
TOUCHES = 1e-9  # m: a gap that counts as closed

_NAMES = {
    Mode.FREE: FREE,
    Mode.FORWARD: FORWARD,
    Mode.BACKWARD: BACKWARD,
    Mode.STICKS: STICK,
    Mode.LOWER: LOWER,
    Mode.UPPER: UPPER,
}


def follow_modes(solution: PhasedSolution, plants: Plants) -> Iterator[Followed]:
    """Simulate phases with modes that links join in their order, each row of them once."""
    for row in _list_rows(solution):
        plant, first = plants.phases[row[0]], solution.phases[row[0]]
        if not isinstance(plant, Openable):
            continue
        equipped = equip(plant, first.problem, first.trajectory.unknowns)
        names = tuple(solution.names[k] for k in row)
        run = _Run(equipped, plant.load_closed(), [solution.phases[k] for k in row], names)
        try:
            error, finding = run.go()
        except (MbsError, ValueError) as fault:
            error, finding = None, str(fault)
        yield Followed(names, error, finding)


def _list_rows(solution: PhasedSolution) -> Iterator[list[int]]:
    """List phases with modes, each row as far as links lead from one to the next in the list."""
    joined = {(link.source, link.target) for link in solution.links}
    row: list[int] = []
    for k, (name, phase) in enumerate(zip(solution.names, solution.phases, strict=True)):
        if row and (not phase.problem.modes or (solution.names[k - 1], name) not in joined):
            yield row
            row = []
        if phase.problem.modes:
            row.append(k)
    if row:
        yield row


@dataclass(frozen=True)
class _Part:
    """An interval of a phase."""

    begin: float  # s, since the start of the first phase
    end: float
    phase: int
    mesh: int  # the point of the phase's mesh at which it ends


class _Run:
    """The simulation of phases in a row."""

    def __init__(self, plant: Plant, kernels: Kernels, phases: Sequence[Solution], names: Sequence[str]) -> None:
        self.manifest, self.kernels = plant.manifest, kernels
        self.phases, self.names = phases, names
        self.motions = [phase.trajectory for phase in phases]
        self.ends = np.cumsum([motion.t[-1] for motion in self.motions])
        self.starts = self.ends - [motion.t[-1] for motion in self.motions]

    def go(self) -> tuple[float | None, str]:
        """Return the largest error, and what differs."""
        q, qd = _place_start(self.phases[0].problem, self.motions[0], self.manifest)
        largest = 0.0
        for part in self.list_parts():
            drive = self.drive(part)
            settings = Settings(part.end - part.begin, rtol=TOLERANCE, atol=TOLERANCE)
            motion = simulate(self.kernels, drive, q, qd, settings)
            if finding := self.compare(part, motion):
                return None, finding
            q, qd = motion.q[-1], motion.qd[-1]
            largest = max(largest, self.measure(part, motion))
        asked = max(phase.problem.asked_accuracy for phase in self.phases)
        if largest > asked:
            return largest, f"its states differ by {largest:.1e}, more than the accuracy asked for, {asked:.1e}"
        return largest, ""

    def list_parts(self) -> Iterator[_Part]:
        """List the intervals of all phases."""
        for k, (start, motion) in enumerate(zip(self.starts, self.motions, strict=True)):
            for i, (a, b) in enumerate(zip(motion.t[:-1], motion.t[1:], strict=True)):
                yield _Part(float(start + a), float(start + b), k, i + 1)

    def drive(self, part: _Part) -> Drive:
        """Return the inputs of a part, from time 0 on."""
        knots, nodes, values = [0.0], [], []
        for start, phase in zip(self.starts, self.phases, strict=True):
            motion = phase.trajectory
            own = self.list_inputs(motion)
            for k, (a, b) in enumerate(zip(motion.t[:-1] + start, motion.t[1:] + start, strict=True)):
                first, last = max(a, part.begin), min(b, part.end)
                if last > first:
                    knots.append(float(last - part.begin))
                    nodes.append(motion.point_t[k] + start - part.begin)
                    values.append(own[k])
        return follow_polynomials(knots, nodes, values)

    def list_inputs(self, motion: Trajectory) -> Array:
        """Return the inputs of the simulated model at the points, (N, d, m)."""
        known = list(self.manifest.inputs)
        every = np.concatenate((motion.spread_inputs()[0], motion.point_w), axis=2)
        return every[:, :, [known.index(name) for name in self.kernels.manifest.inputs]]

    # --- comparison ---

    def compare(self, part: _Part, motion: Motion) -> str:
        """Return where events or modes of a part differ from the ones of the phases."""
        where = self.starts[part.phase]
        if motion.halt is not None:
            return f"it ends at {part.begin + motion.t[-1]:.6g} s, {motion.halt}"
        for event in motion.events:
            time = part.begin + event.time
            k = int(np.searchsorted(self.ends, time).clip(max=len(self.ends) - 1))
            if min(abs(time - self.ends[k]), abs(time - self.starts[k])) > self.find_margin(k):
                own = f"phase {self.names[k]}, " if self.names[k] else ""
                return f"{event.joint} {event.kind.value} at {time:.6g} s, {own}amid it"
        if part.mesh != len(self.motions[part.phase].t) // 2:
            return ""
        for name, found, stated in self.list_modes(part, motion):
            if found != stated:
                own = f" of phase {self.names[part.phase]}" if self.names[part.phase] else ""
                return f"{name} has mode {found} at {part.end - where:.6g} s{own}, which states {stated}"
        return ""

    def list_modes(self, part: _Part, motion: Motion) -> Iterator[tuple[str, str, str]]:
        """List the mode of each joint and contact at the end of a part, and the one that the phase states."""
        stated = dict(self.phases[part.phase].problem.modes)
        coordinates = [c.name for c in self.manifest.coordinates]
        for law in self.manifest.open_joints:
            assert motion.modes is not None, "a model with such joints has modes"
            i = coordinates.index(law.name)
            found = _NAMES[Mode(int(motion.modes[-1, i]))]
            if law.friction is not None and found == STICK and stated[law.name] in (LOWER, UPPER):
                found = stated[law.name]  # friction holds it there, too
            yield law.name, found, stated[law.name]
        for contact in self.manifest.open_contacts:
            is_open = float(motion[f"gap_{contact.name}"][-1]) > TOUCHES
            mode = stated[contact.name]
            if is_open == is_closed(contact, mode):
                yield contact.name, "open" if is_open else "closed", mode

    def measure(self, part: _Part, motion: Motion) -> float:
        """Return the distance from the solution at the end of a part; in an impact there, of coordinates alone."""
        own = self.motions[part.phase]
        error = float(np.abs(motion.q[-1] - own.q[part.mesh]).max(initial=0.0))
        if part.mesh == len(own.t) - 1:  # velocities before an impact, or after it
            return error
        return max(error, float(np.abs(motion.qd[-1] - own.qd[part.mesh]).max(initial=0.0)))

    def find_margin(self, k: int) -> float:
        """Return how near to the end of a phase events may be [s]."""
        return math.sqrt(self.phases[k].problem.asked_accuracy) * float(self.ends[k] - self.starts[k])


def _place_start(problem: Problem, motion: Trajectory, manifest: Manifest) -> tuple[Array, Array]:
    """Return the start, at stops and at rest to the last digit where the modes are closed."""
    q, qd, modes = motion.q[0].copy(), motion.qd[0].copy(), dict(problem.modes)
    for law in manifest.open_joints:
        place = manifest.positions.index(law.name)
        i = [c.name for c in manifest.coordinates].index(law.name)
        if is_closed(law, modes[law.name]):
            qd[i] = 0.0
        if law.stops is not None:
            ends = (law.stops.lower, law.stops.upper)
            lower, upper = (x if x is not None else y for x, y in zip(ends, (-math.inf, math.inf), strict=True))
            q[place] = {LOWER: lower, UPPER: upper}.get(modes[law.name], min(max(q[place], lower), upper))
    return q, qd
