"""Explicit Runge-Kutta methods, of a fixed step h or by a tolerance, for y = (q, qd) and y' = f(t, y):

    k_i = f(t + c_i h, y + h sum_j A_ij k_j),    y(t + h) = y + h sum_i b_i k_i

The steps are taken in C: see csrc/mbs_explicit.h for the equations, and for the ways to keep loops closed. States
within a step are the ends of shorter ones from its start, so that they have the method's order, and are closed too. By
a tolerance, the embedded error estimate err of a step keeps |err_i| <= atol + rtol |y_i| in the root mean square.

Hairer, Norsett, Wanner, "Solving ordinary differential equations I", chapter II, above all sections 4 and 5.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen.manifest import Argument
from mbsrun.closure import GAP
from mbsrun.kernel import find_place
from mbsrun.limits import Allowance, LimitError
from mbsrun.simulation.course import Course, is_constrained, place_driven
from mbsrun.simulation.drive import DriveError, Piece
from mbsrun.simulation.dynamics import Dynamics, Equations, find_mass_matrix
from mbsrun.simulation.formulation import Formulation
from mbsrun.simulation.integration.steps import count_steps, describe_singularity, find_longest, place_steps
from mbsrun.simulation.integration.tableaus import DOP853, EULER, RK4, RK45, Pair, Tableau
from mbsrun.simulation.memory import Memory, load_functions
from mbsrun.simulation.motion import Chunk, Guard, Halt, HaltError, Keeping, Settings

__all__ = ["DOP853", "EULER", "KEEPS", "RK4", "RK45", "Pair", "Tableau", "integrate", "march"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

STEPS = 1024  # taken in C at a time
FREE_STEPS = 128  # the same by a tolerance: each may take many attempts
BOUNCING_STEPS = 1024  # the same, where impacts are passed on the way
RUNAWAY, STOPPED, SHORT, OPEN, BRANCHED, DEPENDENT, EVENT = -1, -2, -3, -4, -5, -6, -7  # the C functions' statuses
LOADED = -9
KEEPING = {  # the C functions' numbers
    Keeping.PROJECTION: 1,
    Keeping.MASS_PROJECTION: 2,
    Keeping.PARTITIONING: 0,
    Keeping.BAUMGARTE: 3,
}

MOST_GUARDS = 4  # of a joint

_RESULT, _TABLEAU, _MODE, _LOAD = "result ", "tableau ", "mode ", "load "  # begin names of arrays that are no inputs
_WHOLE = ("held", "kind", "joint", "place", "fired", "row", "guard")

_CDEF = """
typedef int (*mbs_kernel)(const double **arg, double **res, long long *iw, double *w, int mem);
typedef struct { mbs_kernel f; const double **arg; double **res; } mbs_call;
typedef struct { const double *nonzeros; long long entries; const long long *place; } mbs_entries;
typedef struct {
    long long bearings, joints, axes;
    const long long *owner, *frame;
    const double *by_force, *by_moment, *coefficient, *fall, *hold;
    mbs_entries force, moment, turn;
    mbs_call reactions, poses;
} mbs_loads;
typedef struct {
    const long long *held;
    const double *sign, *torque, *fall, *slowness;
    long long guards;
    const long long *kind, *joint, *place;
    const double *side, *level;
    long long *fired;
    long long most;
    double slow, still, touch;
    const double *restitution;
    long long bounces;
    long long *row, *guard;
    double *impulse;
    const mbs_loads *loads;
} mbs_modes;
typedef struct {
    long long n, nq, m, e, d;
    double *q, *qd, *v, *course, *rest;
    const double *qdd, *r, *h, *hd, *gamma, *qt;
    mbs_entries M, J;
    mbs_call direct, residual, mass, closure, rates, jacobian, change;
    const long long *driven, *place, *loop;
    mbs_modes *modes;
} mbs_explicit;
typedef struct {
    long long stages, estimates, order;
    const double *A, *b, *c, *E;
    double rtol, atol, alpha, beta, longest;
    int keeping;
    int (*guide)(double t);
    int (*inputs)(double t);
} mbs_manner;
typedef struct {
    long long evaluations, rejected, switches, steps;
    double pivot, gap;
    int status, loop;
} mbs_outcome;
long long mbs_explicit_reals(const mbs_explicit *plant, long long stages);
long long mbs_explicit_integers(const mbs_explicit *plant);
void mbs_explicit_run(const mbs_explicit *plant, const mbs_manner *manner, double end, double *h, long long steps,
                      const double *inputs, const double *courses, double *times, double *states, double *reals,
                      long long *integers, mbs_outcome *outcome);
typedef struct { const double *first; long long step, numbers; double *to; } mbs_parameters;
typedef struct {
    double begin, end;
    long long sets;
    const mbs_parameters *set;
    long long outputs;
    const double *times;
    double near;
    long long chunk, most;
} mbs_series;
void mbs_explicit_series(const mbs_explicit *plant, const mbs_manner *manner, const mbs_series *series, long long first,
                         long long last, double *kept, double *lengths, double *times, double *states, double *reals,
                         long long *integers, int *status);
void mbs_explicit_read(const mbs_explicit *plant, const mbs_manner *manner, long long count, const double *times,
                       const double *lengths, const double *inputs, const double *courses, const double *starts,
                       double *ends, double *reals, long long *integers, mbs_outcome *outcome);
"""


KEEPS = tuple(KEEPING)


def integrate(
    pair: Pair,
    dynamics: Dynamics,
    piece: Piece,
    q: Array,
    qd: Array,
    settings: Settings,
    allowance: Allowance,
) -> Iterator[Chunk]:
    """Go through a piece of the inputs; yield the steps.

    Raises HaltError where a kernel fails, a loop cannot be kept closed, or the allowance is used up.
    """
    time, steps = piece.start, march(pair, dynamics, piece, np.concatenate((q, qd)), settings, allowance)
    try:
        for chunk in steps:
            time = float(chunk.t[-1])
            yield chunk
    except LimitError as error:
        raise HaltError(Halt(time, None, error.finding, error.remedy)) from None


def march(
    pair: Pair, equations: Equations, piece: Piece, state: Array, settings: Settings, allowance: Allowance
) -> Iterator[Chunk]:
    """Go through a piece likewise; raise LimitError where the allowance is used up."""
    if "plant" not in equations.kept:
        equations.kept["plant"] = Plant(equations, pair, settings)
    plant: Plant = equations.kept["plant"]
    plant.open(piece)
    count = 0 if plant.manner.estimates else count_steps(piece, settings.step)
    time, first = piece.start, 0
    while time < piece.end:
        done, halt, times, states = plant.advance(piece, state, time, first, count, allowance)
        if done:
            allowance.note(done - 1)
            time, state, first = float(times[done]), states[done], first + done
            q, qd = np.split(states[: done + 1], [plant.dynamics.places], axis=1)
            dense = plant.make_dense(piece, times[:done], states[:done]) if plant.is_dense else None
            yield Chunk(times[: done + 1], q, qd, dense)
        if halt is not None:
            raise halt


@dataclass(frozen=True, eq=False)
class Brakes:
    """Joints that are held, and the friction -sign (torque + fall exp(-(slowness qd)^2)) of sliding ones: (n,) each."""

    held: list[int]
    sign: Array
    torque: Array
    fall: Array
    slowness: Array


@dataclass(frozen=True, eq=False)
class Loads:
    """Friction of joints by the forces of R bearings: csrc/mbs_loads.h."""

    owner: list[int]  # (R,): the joint of each bearing,
    frame: list[int]  # and its frame
    by_force: Array  # (R, 3, 3): the load of a bearing by the joint's force in that frame,
    by_moment: Array  # and by its moment
    coefficient: Array  # (n,): of sliding joints,
    fall: Array  # what the one at rest exceeds it by, with a Stribeck speed,
    hold: Array  # and the one of joints that are held


class _Feed:
    """The inputs and the motion of driven joints, as C functions ask for them."""

    def __init__(self, course: Course, arrays: Mapping[str, Array]) -> None:
        self.course, self.arrays = course, arrays
        self.piece: Piece | None = None
        self.error: BaseException | None = None  # raised in a function that C called

    def open(self, piece: Piece) -> None:
        """Take the inputs of a piece, and write those at its start."""
        self.piece = piece
        if piece.is_constant:
            self.lay_inputs(piece.start)
        self.lay_course(piece.start)

    def lay_course(self, time: float) -> None:
        """Write coordinates, velocities and accelerations of driven joints."""
        numbers = np.concatenate(self.course.at(time))
        self.arrays["course"][: len(numbers)] = numbers

    def lay_inputs(self, time: float) -> None:
        """Write the inputs, which may follow the state that is laid out."""
        assert self.piece is not None, "inputs belong to a piece"
        q, qd, v = (self.arrays[name] for name in ("q", "qd", "v"))
        v[:-1] = self.piece.at(time, q.copy(), qd.copy())

    def serve(self, ffi: Any, lay: Callable[[float], None]) -> Any:
        """Make a function for C, which keeps an exception until C has returned."""

        def call(time: float) -> int:
            try:
                lay(time)
            except BaseException as error:
                self.error = error
                return 1
            return 0

        return ffi.callback("int(double)", call)


class Plant:
    """A model as the C functions take it, with the memory that they use."""

    def __init__(
        self,
        dynamics: Equations,
        pair: Pair,
        settings: Settings,
        *,
        switches: bool = False,
        loads: Loads | None = None,
    ) -> None:
        """Lay a model out; with `switches` joints may be held and braked, also by loads, and guards watched."""
        self.dynamics, self.manifest = dynamics, dynamics.kernels.manifest
        self.ffi, self.lib = load_functions(_CDEF, "mbs_explicit.c", "mbs_least.c")
        self.plant, self.manner = self.ffi.new("mbs_explicit *"), self.ffi.new("mbs_manner *")
        self.length = self.ffi.new("double *")  # of the next step
        self.is_tree = not is_constrained(self.manifest)
        self.switches = switches
        self.is_event = self.is_lost = False  # how the last run ended: by a guard, or without known loads
        self.is_dense = bool(pair.E) or not self.is_tree or self.switches  # states within steps are asked for
        self.memory = self._lay_plant()
        self.feed = _Feed(dynamics.course, self.memory.arrays)
        self._lay_manner(pair, settings)
        if switches:
            self._lay_modes()
        if loads is not None:
            self._lay_loads(loads)
        reals, integers = (
            self.lib.mbs_explicit_reals(self.plant, len(pair.tableau.b)),
            self.lib.mbs_explicit_integers(self.plant),
        )
        self.room = self.memory.add("reals", reals + 1), self.memory.integers([0] * integers)
        if switches:
            self.modes.guards = 0

    def _lay_plant(self) -> Memory:
        dynamics, manifest, p = self.dynamics, self.manifest, self.plant
        n, e, d = dynamics.size, len(manifest.owners), len(manifest.driven)
        arrays = {
            "q": np.zeros(dynamics.places),
            "qd": np.zeros(n),
            "qdd": np.zeros(n),
            "lam": np.zeros(e + 1),
            "v": np.zeros(dynamics.forces_count + dynamics.kernels.manifest.open_entries + 1),
            "course": np.zeros(3 * d + 1),
            "tau": np.zeros(d + 1),  # 0: residuals of driven joints are their forces, and are not read
        }
        arrays["a"] = arrays["course"][2 * d :]
        memory = Memory(self.ffi, dynamics.kernels, arrays)
        p.n, p.nq, p.m, p.e, p.d = n, dynamics.places, len(arrays["v"]) - 1, e, d
        p.q, p.qd, p.v, p.course, p.rest = (memory.pointer(name) for name in ("q", "qd", "v", "course", "qdd"))
        sizes = {"qdd": n, "r": n, "h": e, "hd": e, "gamma": e, "qt": dynamics.places}
        for name, size in sizes.items():
            setattr(p, name, memory.add(_RESULT + name, size + 1))
        p.driven, p.place = memory.integers(manifest.driven), memory.integers(place_driven(manifest))
        p.loop = memory.integers([k + 1 for k in manifest.owners])
        self._lay_dynamics(memory)
        if e:
            self._lay_call(memory, p.closure, "loops", {GAP: "h"})
            self._lay_call(memory, p.rates, "loop_rates", {"hd": "hd"})
            self._lay_call(memory, p.jacobian, "loop_jacobian", {"J": "J", "gamma": "gamma"}, p.J)
        if manifest.configuration:
            self._lay_call(memory, p.change, "rates", {"rate": "qt"})
        return memory

    def _lay_dynamics(self, memory: Memory) -> None:
        """Lay accelerations, if the formulation gives them, and what solves for them elsewhere."""
        p, evaluated = self.plant, self.dynamics.formulation.evaluated
        if evaluated.is_direct:
            if not self.switches:
                self._lay_call(memory, p.direct, evaluated.function, {"qdd": "qdd"})
            if self.is_tree and not self.switches:
                return
            evaluated = Formulation.SEMI.evaluated
        assert evaluated.mass is not None, "a residual comes with a mass matrix"
        self._lay_call(memory, p.residual, evaluated.function, {"Phi": "r"})
        M = find_mass_matrix(memory.describe(evaluated.mass))
        self._lay_call(memory, p.mass, evaluated.mass, {M.name: "M"}, p.M)

    def _lay_call(self, memory: Memory, call: Any, name: str, results: dict[str, str], matrix: Any = None) -> None:
        """Lay a kernel; with a matrix, its first result is that one."""
        entry = memory.bind(name)
        if matrix is not None:
            argument = next(x for x in entry.kernel.outputs if x.name == next(iter(results)))
            matrix.nonzeros = memory.add(_RESULT + results[argument.name], argument.nnz + 1)
            matrix.entries, matrix.place = argument.nnz, memory.place(entry, argument)
        call.f, call.arg, call.res = memory.lay(entry, {key: _RESULT + x for key, x in results.items()})

    def _lay_modes(self) -> None:
        """Lay the arrays of modes; a joint has four guards at most: two stops, and one or two of its friction."""
        n, memory, modes = self.dynamics.size, self.memory, self.ffi.new("mbs_modes *")
        for name in ("sign", "torque", "fall", "slowness"):
            setattr(modes, name, memory.add(_MODE + name, n))
        for name in ("side", "level"):
            setattr(modes, name, memory.add(_MODE + name, MOST_GUARDS * n))
        sizes = {"held": n, "row": BOUNCING_STEPS, "guard": BOUNCING_STEPS}
        self.whole = {name: self.ffi.new("long long[]", sizes.get(name, MOST_GUARDS * n)) for name in _WHOLE}
        for name, numbers in self.whole.items():
            setattr(modes, name, numbers)
        modes.restitution = memory.add(_MODE + "restitution", n)
        modes.impulse = memory.add(_MODE + "impulse", BOUNCING_STEPS)
        modes.guards = MOST_GUARDS * n
        self.modes = self.plant.modes = memory.keep(modes)

    def _lay_loads(self, given: Loads) -> None:
        """Lay bearings, and the kernels that give their forces."""
        memory, loads = self.memory, self.ffi.new("mbs_loads *")
        loads.bearings, loads.owner, loads.frame = len(given.owner), *map(memory.integers, (given.owner, given.frame))
        for name in ("by_force", "by_moment", "coefficient", "fall", "hold"):
            numbers = np.ravel(getattr(given, name))
            setattr(loads, name, memory.add(_LOAD + name, numbers.size))
            memory.arrays[_LOAD + name][:] = numbers
        reactions = self._lay_results(loads.reactions, "reactions", {"force": loads.force, "moment": loads.moment})
        loads.joints = reactions["force"].cols
        loads.axes = self._lay_results(loads.poses, "frames", {"R": loads.turn})["R"].cols
        self.modes.loads = memory.keep(loads)

    def _lay_results(self, call: Any, name: str, matrices: Mapping[str, Any]) -> dict[str, Argument]:
        """Lay a kernel that writes matrices; return their descriptions."""
        memory, entry = self.memory, self.memory.bind(name)
        found = {x.name: x for x in entry.kernel.outputs if x.name in matrices}
        for key, argument in found.items():
            matrices[key].nonzeros = memory.add(_RESULT + key, argument.nnz + 1)
            matrices[key].entries, matrices[key].place = argument.nnz, memory.place(entry, argument)
        call.f, call.arg, call.res = memory.lay(entry, {key: _RESULT + key for key in found})
        return found

    def switch(self, brakes: Brakes, guards: Sequence[Guard]) -> None:
        """Hold and brake joints, and watch guards."""
        arrays = self.memory.arrays
        self.whole["held"][0 : self.dynamics.size] = brakes.held
        for name in ("sign", "torque", "fall", "slowness"):
            arrays[_MODE + name][:] = getattr(brakes, name)
        for k, guard in enumerate(guards):
            for name in ("side", "level"):
                arrays[_MODE + name][k] = getattr(guard, name)
            for name in ("kind", "joint", "place"):
                self.whole[name][k] = getattr(guard, name)
        self.modes.guards, self.modes.most = len(guards), 0

    def bounce(self, restitution: Array, slow: float, still: float, touch: float) -> None:
        """Pass impacts that need no decision, with restitutions (n,), until the next `switch`."""
        self.memory.arrays[_MODE + "restitution"][:] = restitution
        modes = self.modes
        modes.most, modes.slow, modes.still, modes.touch = BOUNCING_STEPS, slow, still, touch

    @property
    def bounced(self) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
        """Return the impacts of the last run: the rows of the states after them, the guards, and the impulses."""
        count = self.modes.bounces
        rows, guards = (np.array(list(self.whole[name][0:count]), dtype=np.intp) for name in ("row", "guard"))
        return rows, guards, self.memory.arrays[_MODE + "impulse"][:count].copy()

    @property
    def fired(self) -> list[int]:
        """List the guards that are below 0 at an event."""
        return [k for k in range(self.modes.guards) if self.whole["fired"][k]]

    def _lay_manner(self, pair: Pair, settings: Settings) -> None:
        memory, tableau, m = self.memory, pair.tableau, self.manner
        self.duration = settings.duration
        self.nodes = np.append(tableau.c, 1.0)
        m.stages, m.estimates, m.order = len(tableau.b), len(pair.E), pair.order
        for name, values in (("A", tableau.A), ("b", tableau.b), ("c", tableau.c), ("E", pair.E)):
            numbers = np.ravel(np.array(values, dtype=np.float64))
            setattr(m, name, memory.add(_TABLEAU + name, numbers.size + 1))
            memory.arrays[_TABLEAU + name][:-1] = numbers
        m.rtol, m.atol, m.alpha, m.beta = settings.rtol, settings.atol, settings.alpha, settings.beta
        m.keeping = KEEPING[settings.loops or Keeping.PROJECTION]  # without loops it does not matter
        if self.manifest.driven and not self.dynamics.course.is_constant:
            m.guide = memory.keep(self.feed.serve(self.ffi, self.feed.lay_course))
        self.inputs = memory.keep(self.feed.serve(self.ffi, self.feed.lay_inputs))

    def begin(self, dynamics: Equations) -> None:
        """Begin another motion of the model, with its own parameters; forget the one before."""
        self.dynamics, self.feed.course = dynamics, dynamics.course
        self.memory.fill(dynamics.kernels)
        self.length[0] = 0.0
        self.memory.arrays["reals"][:] = 0.0
        integers = self.ffi.buffer(self.room[1])
        integers[:] = bytes(len(integers))

    def open(self, piece: Piece) -> None:
        """Take the inputs of a piece."""
        self.feed.open(piece)
        self.manner.inputs = self.ffi.NULL if piece.is_constant else self.inputs
        self.manner.longest = find_longest(self.duration, piece, self.dynamics.course)

    def run(
        self, piece: Piece, state: Array, times: Array, steps: int, length: float | None
    ) -> tuple[int, BaseException | None, Array]:
        """Take steps; return how many, why they end early, and the states by rows."""
        states = np.empty((steps + 1, len(state)))
        states[0] = state
        outcome, effort = self.ffi.new("mbs_outcome *"), self.dynamics.effort
        given: tuple[Array | None, Array | None] = (None, None)
        if length is not None:
            self.length[0] = length
            given = self._sample(piece, times[:-1], np.full(steps, length))
        path = self._point(times), self._point(states)
        self.lib.mbs_explicit_run(
            *(self.plant, self.manner, piece.end, self.length, steps),
            *map(self._point_if, given),
            *(*path, *self.room, outcome),
        )
        effort.steps += outcome.steps - (self.modes.bounces if self.switches else 0)
        effort.rejected = (effort.rejected or 0) + outcome.rejected
        effort.evaluations += outcome.evaluations
        effort.switches += outcome.switches
        effort.pivot = min(effort.pivot, outcome.pivot)
        effort.gap = max(effort.gap, outcome.gap)
        self.is_event, self.is_lost = outcome.status == EVENT, outcome.status == LOADED
        return outcome.steps, self._explain(outcome, float(times[outcome.steps])), states

    def advance(
        self, piece: Piece, state: Array, time: float, first: int, count: int, allowance: Allowance
    ) -> tuple[int, BaseException | None, Array, Array]:
        """Take some steps from a time: by a tolerance, or of the piece's `count` equal ones from number `first` on.

        Returns how many, why they end early, and times and states by rows. Raises LimitError.
        """
        most = BOUNCING_STEPS if self.switches and self.modes.most else FREE_STEPS
        steps = min(max(1, allowance.steps), min(STEPS, count - first) if count else most)
        allowance.spend()
        times = place_steps(piece, first + np.arange(steps + 1), count) if count else np.full(steps + 1, time)
        length = (piece.end - piece.start) / count if count else None
        done, halt, states = self.run(piece, state, times, steps, length)
        return done, halt, times, states

    def run_series(
        self,
        piece: Piece,
        times: Array,
        near: float,
        given: Mapping[str, Mapping[str, Array]],
        kept: Array,
        lengths: Array,
        status: NDArray[np.int32],
        part: range,
        most: int,
    ) -> None:
        """Go through a piece with constant inputs by a tolerance, motion by motion, in C alone.

        Writes the states at `times`, the last of which is the piece's end, behind the starts: `kept` (N, 1 + times,
        nq + n). `given` are the inputs that parameters make, by kernel and by name: rows of all motions, or one row.
        `lengths` (N,) are the first steps to try, or 0, and then the next ones. A status other than 0 is an
        incomplete motion.
        """
        self.open(piece)
        series, end = self.ffi.new("mbs_series *"), min(FREE_STEPS, most) + 1
        pairs = [
            (rows, self.memory.filled[kernel][name]) for kernel, own in given.items() for name, rows in own.items()
        ]
        sets = self.ffi.new("mbs_parameters[]", len(pairs) + 1)
        for item, (rows, to) in zip(sets, pairs, strict=False):
            item.first, item.to = self._point(rows), self._point(to)
            item.step, item.numbers = (rows.shape[1] if len(rows) > 1 else 0), rows.shape[1]
        series.begin, series.end, series.near = piece.start, piece.end, near
        series.sets, series.set, series.outputs, series.times = len(pairs), sets, len(times), self._point(times)
        series.chunk, series.most = FREE_STEPS, most
        room = np.empty(end), np.empty((end, kept.shape[2]))
        told = self.ffi.cast("int *", status.ctypes.data)
        arrays = [self._point(x) for x in (kept, lengths, *room)]
        self.lib.mbs_explicit_series(self.plant, self.manner, series, part.start, part.stop, *arrays, *self.room, told)

    def make_dense(self, piece: Piece, times: Array, states: Array) -> Callable[..., tuple[Array, Array]]:
        """Return the motion within steps that begin at `times` (k,) and `states` (k, nq + n)."""

        def dense(t: Array, step: NDArray[np.intp]) -> tuple[Array, Array]:
            lengths = t - times[step]
            rows = self._sample(piece, times[step], lengths)
            q, qd = np.split(
                self.read(piece, times[step], lengths, states[step], *rows), [self.dynamics.places], axis=1
            )
            return q, qd

        return dense

    def read(
        self, piece: Piece, begins: Array, lengths: Array, starts: Array, inputs: Array | None, courses: Array | None
    ) -> Array:
        """Return the ends (k, nq + n) of steps from some times and states; raise why one fails.

        `inputs` and `courses` are given at the stages and the end of each step; None: they are the piece's.
        """
        self.open(piece)
        ends, outcome = np.empty_like(starts), self.ffi.new("mbs_outcome *")
        arrays = [None if x is None else np.ascontiguousarray(x) for x in (begins, lengths, inputs, courses, starts)]
        given = [*map(self._point_if, (*arrays, ends))]
        self.lib.mbs_explicit_read(self.plant, self.manner, len(begins), *given, *self.room, outcome)
        last = min(outcome.steps, len(begins) - 1)
        failure = self._explain(outcome, float(begins[last] + lengths[last]))
        if failure is not None:
            raise failure
        return ends

    def read_pieces(
        self, pieces: Sequence[Piece], which: Indices, begins: Array, lengths: Array, starts: Array
    ) -> Array:
        """Return the ends of steps likewise, each in one of the pieces, whose inputs are given over time."""
        times = begins[:, None] + lengths[:, None] * self.nodes
        inputs = np.empty((*times.shape, self.plant.m))
        for k in np.unique(which).tolist():
            chosen = which == k
            inputs[chosen] = pieces[k].values(times[chosen].ravel()).reshape(*times[chosen].shape, self.plant.m)
        courses = np.hstack(self.dynamics.course.states(times.ravel())) if self.manner.guide else None
        return self.read(pieces[0], begins, lengths, starts, inputs, courses)

    def _sample(self, piece: Piece, begins: Array, lengths: Array) -> tuple[Array | None, Array | None]:
        """Return inputs and courses at the stages and the end of each step, where they vary over time alone."""
        times = (begins[:, None] + lengths[:, None] * self.nodes).ravel()
        inputs = None if piece.is_constant or piece.law is not None else np.ascontiguousarray(piece.values(times))
        is_guided = bool(self.manner.guide)
        return inputs, np.hstack(self.dynamics.course.states(times)) if is_guided else None

    def _explain(self, outcome: Any, time: float) -> BaseException | None:
        """Return why steps end early, if they do."""
        error, self.feed.error = self.feed.error, None
        piece = self.feed.piece
        if outcome.status == STOPPED and isinstance(error, DriveError) and piece and piece.law is not None:
            return HaltError(Halt(time, None, error.finding, error.remedy))
        if outcome.status == STOPPED:
            return error
        if outcome.status in (0, EVENT):
            return None
        return HaltError(describe_status(self.dynamics, outcome.status, outcome.loop, time, self.memory.arrays["qd"]))

    def _point(self, array: Array) -> Any:
        return self.ffi.cast("double *", array.ctypes.data)

    def _point_if(self, array: Array | None) -> Any:
        return self.ffi.NULL if array is None else self._point(array)


_FINDINGS = {
    OPEN: ("it cannot be closed here", "take a smaller step, or look for a singular pose"),
    BRANCHED: ("to close it would change the velocities by a tenth in one step", "take a smaller step or tolerance"),
    DEPENDENT: ("its equations contradict each other or others here: a singular pose", "start elsewhere"),
}
_UNKNOWN = "whether a motion obeys the friction by the load of joints is not known to rounding"


def describe_status(dynamics: Equations, status: int, loop: int, time: float, qd: Array) -> Halt:
    """Describe a status of the C functions, returned in the step after `time`; qd: the last velocities."""
    manifest = dynamics.kernels.manifest
    names = [c.name for c in manifest.coordinates]
    fastest = names[int(np.nan_to_num(np.abs(qd), nan=np.inf).argmax())]
    if status == RUNAWAY:
        remedy = "take a smaller step" if manifest.loops else "take a smaller step or an implicit method"
        return Halt(time, fastest, "the motion diverges: its numbers overflow", remedy)
    if status == SHORT:
        finding = "the step has become too short to advance the time"
        return Halt(time, fastest, finding, "loosen the tolerance, or look for a singularity there")
    if status > 0:
        return describe_singularity(find_place(manifest, status), time)
    if status == LOADED:
        return Halt(time, None, _UNKNOWN, "lessen the coefficient of friction, or give a torque in place of load")
    finding, remedy = _FINDINGS[status]
    return Halt(time, None, finding, remedy, loop=manifest.loops[loop - 1].name)
