"""Time stepping of Moreau and Jean: rigid contacts with dry friction, rigid stops and dry friction of joints.

Steps have one length, whatever happens in them. `csrc/mbs_stepping.h` states the equations. `csrc/mbs_cone.c` solves
for the impulses of a step, to a tolerance that is met, or the motion ends with a message.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen.roles import Order, name_derivative, name_kernel
from mbsrun.kernel import find_place
from mbsrun.limits import Allowance, LimitError
from mbsrun.simulation.drive import DriveError, Piece
from mbsrun.simulation.dynamics import Dynamics
from mbsrun.simulation.integration.groups import find_group
from mbsrun.simulation.integration.joints import Joints
from mbsrun.simulation.integration.steps import count_steps, describe_singularity, place_steps
from mbsrun.simulation.memory import Memory, load_functions
from mbsrun.simulation.motion import Chunk, Halt, HaltError, Settings, Stages, Strikes
from mbsrun.simulation.solids import CDEF, Pairs

Array = NDArray[np.float64]

STEPS = 4096  # taken in C at a time
TOLERANCE = 1e-8  # of the cone problem: see csrc/mbs_cone.h

_CDEF = (
    CDEF
    + """
typedef int (*mbs_kernel)(const double **arg, double **res, long long *iw, double *w, int mem);
typedef struct { mbs_kernel f; const double **arg; double **res; } mbs_call;
typedef struct { const double *nonzeros; long long entries; const long long *place; } mbs_entries;
typedef struct { long long first, spin, is_free; } mbs_attitude;
typedef struct {
    long long nq, attitudes, scalars;
    const mbs_attitude *attitude;
    const long long *place, *rate;
} mbs_group;
typedef struct {
    const mbs_solid *first, *other;
    long long spots;
    double restitution, coefficient;
} mbs_meeting;
typedef struct { long long place, rate; double side, level, restitution; } mbs_stop;
typedef struct { long long rate; double torque, fall, slowness, still; } mbs_brake;
typedef struct {
    long long n, m, points, pairs, stops, brakes;
    double *q, *qd, *qdd, *v;
    const double *Phi, *clearance, *direction, *kinetic, *potential, *power;
    const double *places, *axes;
    mbs_entries K, C, M, N, J, twist;
    mbs_call linearised, residual, touching, meetings, change, energy, work;
    mbs_group group;
    const double *restitution, *coefficient;
    const mbs_meeting *pair;
    const mbs_stop *stop;
    const mbs_brake *brake;
} mbs_stepping;
typedef struct {
    double allowed, residual;
    long long iterations, jacobians, sweeps, newton;
    int kernel;
} mbs_stepping_record;
long long mbs_stepping_reals(const mbs_stepping *plant);
long long mbs_stepping_integers(const mbs_stepping *plant);
long long mbs_stepping_width(const mbs_stepping *plant);
long long mbs_stepping_run(const mbs_stepping *plant, double tolerance, double h, long long steps, const double *inputs,
                           long long v_step, const double *start, double *results, double *impulses,
                           mbs_stepping_record *record, int *status, double *reals, long long *integers);
"""
)

_KERNEL, _SINGULAR, _CONE, _DIVERGED = 1, 2, 3, 4
_FAILURES = {
    _SINGULAR: (
        "a step has no solution here: the mass matrix is singular, or a force grows too fast for the step",
        "take a shorter step, or keep away from this configuration",
    ),
    _CONE: (
        f"the impulses of contacts, stops and friction are not found to {TOLERANCE:g}; they may not exist",
        "take a shorter step, or less friction",
    ),
    _DIVERGED: ("Newton's method does not converge in a step", "take a shorter step"),
}
_INFINITE = "the motion has no finite values any more", "take a shorter step"


class Stepper:
    """A model as the C functions take it, with the memory that they use, and its motion so far."""

    def __init__(self, dynamics: Dynamics) -> None:
        self.dynamics = dynamics
        sources = "mbs_stepping.c", "mbs_cone.c", "mbs_dense.c", "mbs_solids.c"
        self.ffi, self.lib = load_functions(_CDEF, *sources)
        self.plant = self.ffi.new("mbs_stepping *")
        self._lay()
        self._lay_group()
        self.slots = self._lay_pairs()
        self._lay_joints(Joints.of(dynamics.kernels.manifest))
        self.reals = np.empty(self.lib.mbs_stepping_reals(self.plant) + 1)
        self.integers = np.empty(self.lib.mbs_stepping_integers(self.plant) + 1, dtype=np.int64)
        p = self.plant
        self.impulses = np.zeros(3 * (p.points + sum(self.slots)) + p.stops + p.brakes + 1)
        self.record = self.ffi.new("mbs_stepping_record *", {"allowed": np.nan})

    def _lay(self) -> None:
        p, dynamics, manifest = self.plant, self.dynamics, self.dynamics.kernels.manifest
        n, nq = dynamics.size, dynamics.places
        p.n, p.m, p.points = n, len(manifest.inputs), len(manifest.rigid)
        sizes = {"q": nq, "qd": n, "qdd": n, "v": p.m}
        memory = self.memory = Memory(self.ffi, dynamics.kernels, {x: np.zeros(k + 1) for x, k in sizes.items()})
        p.q, p.qd, p.qdd, p.v = (memory.pointer(name) for name in sizes)
        function = dynamics.formulation.evaluated.function
        derivatives = {name_derivative("Phi", by): x for by, x in (("q", p.K), ("qd", p.C), ("qdd", p.M))}
        p.Phi = self._call(p.linearised, name_kernel(function, Order.LINEARISATION), {"Phi": None, **derivatives})[
            "Phi"
        ]
        self._call(p.residual, function, {"Phi": None})
        found = self._call(p.energy, "energy", {"kinetic": None, "potential": None})
        p.kinetic, p.potential = found["kinetic"], found["potential"]
        p.power = self._call(p.work, "power", {"power": None})["power"]
        if manifest.configuration:
            self._call(p.change, "jac_rates", {"jac_rate_qd": p.N})
        if manifest.rigid:
            found = self._call(p.touching, "touching", {"clearance": None, "direction": None, "slide": p.J})
            p.clearance, p.direction = found["clearance"], found["direction"]
        if manifest.meetings:
            found = self._call(p.meetings, "meetings", {"place": None, "axes": None, "twist": p.twist})
            p.places, p.axes = found["place"], found["axes"]
        p.restitution = self._keep("restitution", [x.restitution for x in manifest.rigid])
        p.coefficient = self._keep("coefficient", [x.coefficient for x in manifest.rigid])

    def _call(self, call: Any, name: str, results: dict[str, Any]) -> dict[str, Any]:
        """Lay a kernel; return where its results are written. Matrices are described as entries; one may have none."""
        memory, laid, found = self.memory, {}, {}
        entry = memory.bind(name)
        for argument in entry.kernel.outputs:
            if argument.name in results and argument.nnz:
                laid[argument.name] = place = f"result {argument.name}"
                if place not in memory.arrays:
                    memory.add(place, argument.nnz + 1)
                found[argument.name] = memory.pointer(place)
                if (entries := results[argument.name]) is not None:
                    entries.nonzeros = found[argument.name]
                    entries.entries, entries.place = argument.nnz, memory.place(entry, argument)
        call.f, call.arg, call.res = memory.lay(entry, laid)
        return {name: found.get(name, memory.add(f"nothing {name}", 1)) for name in results}

    def _keep(self, name: str, values: list[float]) -> Any:
        pointer = self.memory.add(name, len(values) + 1)
        self.memory.arrays[name][: len(values)] = values
        return pointer

    def _lay_group(self) -> None:
        group, memory, own = find_group(self.dynamics.kernels), self.memory, self.plant.group
        rows = [(x.quaternion.first, x.quaternion.spin, int(x.is_free)) for x in group.attitudes]
        own.nq, own.attitudes = self.dynamics.places, len(rows)
        own.attitude = memory.keep(self.ffi.new("mbs_attitude[]", [*rows, (0, 0, 0)]))
        places, rates = group.scalars
        own.scalars, own.place, own.rate = len(places), memory.integers(places), memory.integers(rates)

    def _lay_pairs(self) -> list[int]:
        """Lay the pairs of solids; return the number of points that each may have."""
        meetings = self.dynamics.kernels.manifest.meetings
        pairs = Pairs(meetings, self.ffi, self.lib)
        self.memory.keep(pairs)
        rows = [
            (pairs.solids + 2 * k, pairs.solids + 2 * k + 1, slots, pair.restitution, pair.coefficient)
            for k, (pair, slots) in enumerate(zip(meetings, pairs.slots, strict=True))
        ]
        self.plant.pairs, self.plant.pair = len(rows), self.memory.keep(self.ffi.new("mbs_meeting[]", rows))
        return pairs.slots

    def _lay_joints(self, joints: Joints) -> None:
        p, memory = self.plant, self.memory
        stops = [
            (place, i, side, float(level), float(joints.restitution[i]))
            for i, place in enumerate(joints.place)
            for side, level in ((1.0, joints.lower[i]), (-1.0, joints.upper[i]))
            if np.isfinite(level)
        ]
        ways = {int(i): float(joints.one_way[i]) for i in np.flatnonzero(joints.one_way)}
        stops += [(0, i, way, way * np.inf, 0.0) for i, way in ways.items()]  # clutches: always touched
        slowness = np.divide(1.0, joints.stribeck, out=np.zeros_like(joints.stribeck), where=joints.stribeck > 0)
        fall = np.where(joints.stribeck > 0, joints.static - joints.torque, 0.0)
        brakes = [
            (int(i), *(float(x[i]) for x in (joints.torque, fall, slowness, joints.static)))
            for i in np.flatnonzero(joints.is_dry)
        ]
        p.stops, p.stop = len(stops), memory.keep(self.ffi.new("mbs_stop[]", [*stops, (0, 0, 0, 0, 0)]))
        p.brakes, p.brake = len(brakes), memory.keep(self.ffi.new("mbs_brake[]", [*brakes, (0, 0, 0, 0, 0)]))

    def run(self, h: float, inputs: Array, start: Array, steps: int) -> tuple[int, Array]:
        """Take steps of length h from a state (nq + n,), with inputs (steps, m), or one row for all.

        Return the status of the C function, and a row of results for each step that was taken.
        """
        results = np.empty((steps, self.lib.mbs_stepping_width(self.plant)))
        inputs, status = np.ascontiguousarray(inputs), self.ffi.new("int *")
        state = np.ascontiguousarray(start)
        done = self.lib.mbs_stepping_run(
            self.plant,
            TOLERANCE,
            h,
            steps,
            self._point(inputs),
            inputs.shape[1] if len(inputs) > 1 else 0,
            *map(self._point, (state, results, self.impulses)),
            self.record,
            status,
            self._point(self.reals),
            self.ffi.cast("long long *", self.integers.ctypes.data),
        )
        effort, record = self.dynamics.effort, self.record
        effort.steps += done
        effort.iterations, effort.jacobians = record.iterations, record.jacobians
        effort.evaluations = record.iterations
        effort.sweeps, effort.cone_steps, effort.residual = record.sweeps, record.newton, record.residual
        return status[0], results[:done]

    def _point(self, array: Array) -> Any:
        return self.ffi.cast("double *", array.ctypes.data)

    def bundle(self, times: Array, start: Array, results: Array) -> Chunk:
        """Make a chunk of steps; the power of forces is taken in the middle of each."""
        n, nq, h = self.dynamics.size, self.dynamics.places, np.diff(times)[:, None]
        ends, middles, losses, pushes = np.split(results, [nq + n, 2 * (nq + n), 2 * (nq + n) + 2], axis=1)
        q, qd = np.split(np.vstack((start, ends)), [nq], axis=1)
        at = (times[:-1] + times[1:])[:, None] / 2
        pushes = self._sum_up(pushes)
        stages = Stages(at, middles[:, None, :nq], middles[:, None, nq:], np.ones(1))
        return Chunk(times, q, qd, stages=stages, strikes=Strikes(losses, np.diff(qd, axis=0) / h, pushes / h))

    def _sum_up(self, pushes: Array) -> Array:
        """Return the vectors of points, and the sums of the vectors of pairs."""
        ends = self.plant.points + np.cumsum([0, *self.slots])
        vectors = pushes.reshape(len(pushes), -1, 3)
        sums = [vectors[:, a:b].sum(axis=1) for a, b in pairwise(ends)]
        return np.hstack((pushes[:, : 3 * self.plant.points], *sums))

    def describe(self, status: int, time: float) -> Halt:
        """Describe why a run ended."""
        if status == _KERNEL:
            return describe_singularity(find_place(self.dynamics.kernels.manifest, self.record.kernel), time)
        finding, remedy = _FAILURES.get(status, _INFINITE)
        return Halt(time, None, finding, remedy)


def integrate(
    dynamics: Dynamics, piece: Piece, q: Array, qd: Array, settings: Settings, allowance: Allowance
) -> Iterator[Chunk]:
    """Go through a piece by steps of equal length, at most `settings.step`; yield the steps.

    A feedback is evaluated at the start of each step. Raises HaltError where a step fails, or the allowance is used up.
    """
    if "moreau" not in dynamics.kept:
        dynamics.kept["moreau"] = Stepper(dynamics)
    stepper: Stepper = dynamics.kept["moreau"]
    count, taken, row = count_steps(piece, settings.step), 0, np.concatenate((q, qd))
    h = (piece.end - piece.start) / count
    while taken < count:
        steps = 1 if piece.law is not None else min(STEPS, count - taken, max(1, allowance.steps))
        times = place_steps(piece, taken + np.arange(steps + 1), count)
        try:
            allowance.spend(steps)
            inputs = _ask(dynamics, piece, times, row)
        except (LimitError, DriveError) as error:
            raise HaltError(Halt(float(times[0]), None, error.finding, error.remedy)) from None
        status, results = stepper.run(h, inputs, row, steps)
        taken += len(results)
        if len(results):
            yield stepper.bundle(times[: len(results) + 1], row, results)
            row = results[-1, : len(row)]
        if status:
            raise HaltError(stepper.describe(status, float(times[len(results)])))


def _ask(dynamics: Dynamics, piece: Piece, times: Array, state: Array) -> Array:
    """Return the inputs of steps, a row for each, or one for all."""
    if piece.law is not None:
        return piece.at(float(times[0]), *np.split(state, [dynamics.places]))[None]
    middles = (times[:-1] + times[1:]) / 2
    return np.ascontiguousarray(piece.values(middles[:1] if piece.is_constant else middles))
