"""Model, inputs, start, settings -> Motion: the pieces of the inputs, one after the other, by the method's steps."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbsgen.errors import MbsError
from mbsgen.manifest import RigidPair, RigidPoint
from mbsgen.roles import Order, name_kernel
from mbsrun.closure import Closure
from mbsrun.kernel import ArgumentError, KernelError, Kernels
from mbsrun.limits import Allowance, Limits
from mbsrun.quaternions import measure_lengths
from mbsrun.simulation.closing import check_closed
from mbsrun.simulation.course import Course, check_course, is_constrained, place_driven, stand
from mbsrun.simulation.drive import Drive, DriveError, Piece, cut
from mbsrun.simulation.dynamics import Dynamics, SingularError
from mbsrun.simulation.formulation import Formulation
from mbsrun.simulation.integration import adaptive
from mbsrun.simulation.integration.energy import add_up_friction, add_up_work
from mbsrun.simulation.integration.holding import Forces
from mbsrun.simulation.integration.joints import Joints
from mbsrun.simulation.integration.method import Family
from mbsrun.simulation.integration.methods import METHODS, complete_settings, find_refusals, takes_too_many_steps
from mbsrun.simulation.motion import (
    SINGULAR,
    STORED,
    Chunk,
    ClosureRecord,
    Effort,
    Energy,
    Event,
    Halt,
    HaltError,
    Keeping,
    Motion,
    Push,
    Segment,
    Settings,
    Strikes,
)
from mbsrun.simulation.outputs import Outputs
from mbsrun.simulation.solids import measure_pairs

Array = NDArray[np.float64]

BEYOND = 1e-6  # of a limit or of 1 rad or m: beyond it there is a warning
STIFF = 500.0  # times that a fast motion decays within a simulation; slower ones bring no warning of stiffness


class InsideError(MbsError):
    """A start at which a rigid contact is within the other side, or a number beyond a rigid stop."""

    def __init__(self, point: RigidPoint | RigidPair, depth: float) -> None:
        finding = f"contact {point.name} starts {depth:.4g} m inside the other side; start outside or in touch"
        if point.is_stop:
            finding = f"stop {point.name} starts {depth:.4g} beyond its limit; start within its limits"
        super().__init__(finding)


def simulate(
    kernels: Kernels,
    drive: Drive,
    q: ArrayLike,
    qd: ArrayLike,
    settings: Settings,
    show: Callable[[float], None] = lambda _: None,
    course: Course | None = None,
    watch: Callable[[Dynamics, Piece, Chunk], None] | None = None,
) -> Motion:
    """Integrate the motion from q, qd (n,) at time 0 under the inputs of `drive`; call `show` with the time reached.

    Driven joints move along `course`; without one they stand still. `watch` gets the steps as they are taken. A failure
    on the way is no exception: `halt` of the motion then describes why it ends early. Raises ValueError for arguments
    that do not fit, OpenError for a start with open loops,
    InsideError for one with rigid contacts inside, ArgumentError for kernels that were not generated, and
    DriveError for inputs without a value.
    """
    check_settings(kernels, drive, settings)
    start = check_start(kernels, q, qd)
    is_closed = is_constrained(kernels.manifest)
    settings = complete_settings(settings, is_closed=is_closed)
    course = course or stand(start[0][place_driven(kernels.manifest)])
    if is_closed:
        check_course(kernels.manifest, course, *start)
        check_closed(kernels, *start)
    _check_outside(kernels, start[0])
    dynamics = Dynamics(kernels, settings.formulation, course)
    method = METHODS[settings.method]
    integrate = method.closed if is_closed else method.integrate
    assert integrate is not None, "the method was checked to take loops"
    record = _Record(kernels, settings, *start, course)
    allowance = Allowance(Limits(settings.max_steps, settings.max_seconds))
    halt: Halt | None = None
    edges = {time for latch in settings.latches for pair in latch.times for time in pair}
    pieces = cut(drive.play(kernels, settings.duration, lambda: record.last), edges)
    while halt is None and record.last_time < settings.duration:
        try:
            piece = next(pieces)
            record.open(piece)
            for chunk in _timed(integrate(dynamics, piece, *record.last, settings, allowance), dynamics.effort):
                record.add(chunk)
                if watch is not None:
                    for part in chunk.part():
                        watch(dynamics, piece, part)
                show(float(chunk.t[-1]))
        except HaltError as error:
            halt = error.halt
        except DriveError as error:
            if drive.control is None or not record.inputs:
                raise
            halt = Halt(record.last_time, None, error.finding, error.remedy)
        finally:
            record.close()
    return record.finish(dynamics.effort, halt)


def check_start(kernels: Kernels, q: ArrayLike, qd: ArrayLike) -> tuple[Array, Array]:
    """Return a start, (nq,) and (n,), as arrays. Raises ValueError for one from which no motion begins."""
    manifest = kernels.manifest
    sizes = len(manifest.positions), len(manifest.coordinates)
    start = np.array(q, dtype=np.float64), np.array(qd, dtype=np.float64)
    if any(x.shape != (n,) or not np.isfinite(x).all() for x, n in zip(start, sizes, strict=True)):
        raise ValueError(f"q must be {sizes[0]} finite numbers, qd {sizes[1]}")
    if (measure_lengths(start[0], manifest) == 0).any():
        raise ValueError("a quaternion of q is 0; it turns by 0 as 0, 0, 0, 1")
    for joint, found, stop in Joints.of(manifest).find_beyond(start[0]):
        raise ValueError(f"joint {joint} starts at {found:.9g}, beyond its stop at {stop:.9g}")
    return start


def check_settings(kernels: Kernels, drive: Drive, settings: Settings) -> None:
    """Check that a model can be simulated with some settings. Raises ValueError, and ArgumentError for kernels."""
    manifest = kernels.manifest
    if not isinstance(drive, Drive):
        raise ValueError(f"inputs: found a value of type {type(drive).__name__}; give a Drive, such as hold([0, 1])")
    if settings.method not in METHODS:
        raise ValueError(f"no method {settings.method!r}; there are {', '.join(METHODS)}")
    lengths = {"duration": settings.duration, "step": settings.step, "rtol": settings.rtol, "atol": settings.atol}
    lengths |= {"output_step": settings.duration if settings.output_step is None else settings.output_step}
    for name, value in lengths.items():
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name} = {value} must be a positive number")
    if settings.max_steps < 1 or not settings.max_seconds > 0:
        raise ValueError("max_steps and max_seconds must be positive")
    if takes_too_many_steps(settings):
        raise ValueError(f"step = {settings.step} takes more than max_steps = {settings.max_steps} steps")
    if manifest.quaternions and not METHODS[settings.method].takes_quaternions:
        raise ValueError(f"{settings.method} takes no quaternions; gauss with one stage does")
    for name, finding, remedy in find_refusals(settings, manifest):
        raise ValueError(f"{name}: {finding}; {remedy}")
    _check_kernels(kernels, settings)
    if settings.duration > drive.end:
        raise ValueError(f"the inputs end at {drive.end} s, before the duration of {settings.duration} s")


def check_inputs(kernels: Kernels, piece: Piece, q: Array, qd: Array) -> Array:
    """Return the inputs at the start of a piece, (m,). Raises ValueError where there are fewer or more."""
    inputs, count = piece.at(piece.start, q, qd), len(kernels.manifest.inputs)
    if inputs.shape != (count,):
        raise ValueError(f"the inputs have shape {inputs.shape}, ({count},) expected")
    return inputs


def _check_outside(kernels: Kernels, q: Array) -> None:
    """Refuse a start within another side. Raises InsideError."""
    if kernels.manifest.rigid:
        clearance = kernels("touching", q=q)["clearance"].ravel()
        clearance[[x.is_coupling for x in kernels.manifest.rigid]] = 0.0
        k = int(clearance.argmin())
        if clearance[k] < -BEYOND:
            raise InsideError(kernels.manifest.rigid[k], -float(clearance[k]))
    if kernels.manifest.meetings:
        distances = measure_pairs(kernels, q[None])[0].ravel()
        k = int(distances.argmin())
        if distances[k] < -BEYOND:
            raise InsideError(kernels.manifest.meetings[k], -float(distances[k]))


def _check_kernels(kernels: Kernels, settings: Settings) -> None:
    """Demand the kernels that the formulation, energies, warnings and pictures need."""
    is_closed, is_explicit = is_constrained(kernels.manifest), METHODS[settings.method].stability is not None
    evaluated = complete_settings(settings, is_closed=is_closed).formulation.evaluated
    jacobian = name_kernel(evaluated.function, Order.JACOBIAN)
    needed = {evaluated.function, "energy", "power", "frames"}
    needed |= set() if evaluated.mass in (None, jacobian) else {evaluated.mass}
    linearised = name_kernel(evaluated.function, Order.LINEARISATION)
    if is_closed:
        needed |= {"semi", "semi_res"} if is_explicit else {jacobian, linearised}
        needed |= {"loops", "loop_rates", "loop_jacobian"} if kernels.manifest.loops else set()
        needed |= {"lin_loops", "lin_loop_rates"} if kernels.manifest.loops and not is_explicit else set()
        needed |= set() if kernels.manifest.find("exp2") else {"exp1"}
    else:
        needed |= {"impl", "jac_impl"} if is_explicit else {jacobian}
        switches = bool(kernels.manifest.switching or kernels.manifest.touching)
        needed |= {"semi", "semi_res"} if switches and is_explicit else set()
        needed |= {"reactions"} if kernels.manifest.loaded else set()
        if kernels.manifest.rigid:
            needed |= {"touching", "jac_touching"} if is_explicit else {"touching"}
        needed |= {"meetings"} if kernels.manifest.meetings else set()
        needed |= {linearised} if METHODS[settings.method].needs_residual else set()
    needed |= {"rates", "jac_rates"} if kernels.manifest.configuration else set()
    if missing := kernels.list_missing(needed):
        raise ArgumentError(
            f"{kernels.manifest.model} was generated without {', '.join(missing)}; generate all functions, "
            "with first derivatives"
        )


def _timed(chunks: Iterator[Chunk], effort: Effort) -> Iterator[Chunk]:
    """Pass chunks on, and add up the processor time of making them."""
    while True:
        before = time.process_time()
        try:
            chunk = next(chunks, None)
        finally:
            effort.seconds += time.process_time() - before
        if chunk is None:
            return
        yield chunk


class _Record:
    """Keeps some of the states, and the work done until then."""

    def __init__(self, kernels: Kernels, settings: Settings, q: Array, qd: Array, course: Course) -> None:
        self.kernels, self.settings = kernels, settings
        self.is_closed, self.gaps = is_constrained(kernels.manifest), [0.0, 0.0]
        self.equations = Closure(kernels)
        self.observer = Dynamics(kernels, settings.formulation, course)  # its calls are not the integrator's
        self.outputs = Outputs(settings.output_step or settings.duration / STORED)
        self.t, self.q, self.qd, self.work = [0.0], [q], [qd], [0.0]
        self.inputs: list[Array] = []
        self.last, self.last_time, self.done = (q, qd), 0.0, 0.0
        self.piece: Piece | None = None
        self.work_is_known = True
        self.switches = bool(kernels.manifest.switching or kernels.manifest.touching)
        self.strikes = METHODS[settings.method].strikes
        self.rates: list[Array] = []  # of the states that are kept: accelerations,
        self.pushes: list[Array] = []  # and forces of rigid contacts
        self.ends: list[Array] = []  # both of the last step
        self.joints, self.forces = Joints.of(kernels.manifest), Forces(self.observer)
        self.events: list[Event] = []
        self.modes: list[tuple[int, ...]] = []  # of the states that are kept
        self.friction = self.impacts = 0.0  # the energy that they took so far [J]
        self.losses = [(0.0, 0.0)]

    def open(self, piece: Piece) -> None:
        """Begin a piece; the inputs at its start are its own."""
        self.piece = piece
        self.outputs.open()
        self.inputs[len(self.t) - 1 :] = [check_inputs(self.kernels, piece, *self.last)]

    def add(self, chunk: Chunk) -> None:
        """Take steps: keep the states at the times of outputs."""
        assert self.piece is not None, "a chunk lies in a piece"
        if self.is_closed:
            self.gaps = [max(*x) for x in zip(self.gaps, self._measure_gaps(chunk.q, chunk.qd), strict=True)]
        chunk, chosen = self.outputs.choose(chunk)
        if chunk.segment is not None:
            self._add_losses(chunk, chunk.segment, chosen)
        if chunk.segment is not None and chunk.segment.push is not None:
            self._add_pushes(chunk, chunk.segment.push, chosen)
        if chunk.strikes is not None:
            self._add_strikes(chunk.strikes, chosen)
        work = self.done + np.concatenate(([0.0], np.cumsum(self._add_up(chunk))))
        self._keep(chunk, work, chosen)
        self.last, self.last_time, self.done = (chunk.q[-1], chunk.qd[-1]), float(chunk.t[-1]), float(work[-1])

    def close(self) -> None:
        """End a piece: the last state is kept in any case."""
        if self.t[-1] != self.last_time and self.piece is not None:
            self.inputs += self._ask(np.array([self.last_time]), *(x[None] for x in self.last))
            self.t.append(self.last_time)
            self.q.append(self.last[0])
            self.qd.append(self.last[1])
            self.work.append(self.done)
            self.losses.append((self.friction, self.impacts))
            self.modes += self.modes[-1:]
            self.rates += self.ends[:1]
            self.pushes += self.ends[1:]

    def finish(self, effort: Effort, halt: Halt | None) -> Motion:
        """Make the motion of all states that were kept."""
        t, q, qd, inputs = (np.array(kept) for kept in (self.t, self.q, self.qd, self.inputs))
        energies = self.kernels("energy", q=q, qd=qd)
        losses = np.array(self.losses).T if self.switches else (None, None)
        energy = Energy(energies["kinetic"][:, 0], energies["potential"][:, 0], np.array(self.work), *losses)
        modes = np.array(self.modes).reshape(len(t), -1) if self.switches and self.modes else None
        warnings = [*_find_exceeded_limits(self.kernels, t, q), *self._find_stiffness(effort, t, q, qd, inputs)]
        is_known = self.work_is_known and bool(np.isfinite(energy.drift).all())
        return Motion(
            settings=self.settings,
            t=t,
            q=q,
            qd=qd,
            inputs=inputs,
            energy=energy if is_known else None,
            effort=effort,
            closure=self._find_closure(t, q, qd, inputs, modes) if self.is_closed else None,
            halt=halt,
            events=tuple(self.events),
            modes=modes,
            warnings=(
                *warnings,
                *(_find_drift(energy) if is_known else ()),
                *_find_singularity(self.settings, effort),
            ),
            contacts=self._find_contacts(q),
            qdd=self._find_accelerations(t, q, qd, inputs, modes),
            kernels=self.kernels,
        )

    def _find_accelerations(
        self, t: Array, q: Array, qd: Array, inputs: Array, modes: NDArray[np.int_] | None
    ) -> Array:
        if self.rates:
            return np.array(self.rates)
        if self.strikes and self.switches:
            return np.full(qd.shape, np.nan)
        if modes is None:
            return self.observer.find_accelerations(t, q, qd, inputs)
        return self.forces.find_all(t, q, qd, inputs, modes)[0]

    def _find_contacts(self, q: Array) -> tuple[Array, Array, Array] | None:
        """Return the forces of rigid contacts, without stops, normal parts of all, and the distances of solids."""
        manifest = self.kernels.manifest
        count = len(manifest.rigid) + len(manifest.meetings)
        if not count:
            return None
        forces = np.array(self.pushes).reshape(-1, count, 3) if self.pushes else np.full((len(q), count, 3), np.nan)
        normals, distances = np.zeros((len(q), 0, 3)), np.zeros((len(q), 0))
        if manifest.rigid:
            normals = self.kernels("touching", q=q)["direction"].transpose(0, 2, 1)
        if manifest.meetings:
            distances, more = measure_pairs(self.kernels, q)
            normals = np.concatenate((normals, more), axis=1)
        placed = [True] * count
        placed[: len(manifest.rigid)] = [not x.is_stop for x in manifest.rigid]
        return forces[:, placed].reshape(len(forces), -1), np.einsum("kpi,kpi->kp", normals, forces), distances

    def _add_pushes(self, chunk: Chunk, push: Push, chosen: NDArray[np.intp]) -> None:
        """Note accelerations and forces of rigid contacts between events."""
        rates, forces, _ = push(chunk.t, chunk.q, chunk.qd)
        if not self.rates:  # the start
            self.rates, self.pushes = [rates[0]], [forces[0]]
        self.rates += list(rates[chosen])
        self.pushes += list(forces[chosen])
        self.ends = [rates[-1], forces[-1]]

    def _add_strikes(self, strikes: Strikes, chosen: NDArray[np.intp]) -> None:
        """Add the losses of time stepping; note accelerations and forces, of the step before each state."""
        impacts, friction = np.cumsum(strikes.losses, axis=0).T
        if not self.rates:  # the start
            self.rates, self.pushes = [strikes.rates[0]], [strikes.forces[0]]
        self.losses += [(self.friction + float(friction[k - 1]), self.impacts + float(impacts[k - 1])) for k in chosen]
        self.rates += list(strikes.rates[chosen - 1])
        self.pushes += list(strikes.forces[chosen - 1])
        self.friction += float(friction[-1])
        self.impacts += float(impacts[-1])
        self.ends = [strikes.rates[-1], strikes.forces[-1]]

    def _measure_gaps(self, q: Array, qd: Array) -> tuple[float, float]:
        return self.equations.measure(q), self.equations.measure_rates(q, qd)

    def _find_closure(
        self, t: Array, q: Array, qd: Array, inputs: Array, modes: NDArray[np.int_] | None
    ) -> ClosureRecord:
        """Compute how far loops are open along the motion, and the forces that keep them closed."""
        position, velocity = (
            np.abs(x).max(axis=1, initial=0.0) for x in (self.equations.gaps(q), self.equations.rates(q, qd))
        )
        most = [max(*x) for x in zip(self.gaps, self._measure_gaps(q, qd), strict=True)]
        if modes is None:
            multipliers, driving = self.observer.forces(t, q, qd, inputs)
        else:
            multipliers, driving = self.forces.find_all(t, q, qd, inputs, modes)[1:]
        return ClosureRecord(position, velocity, (most[0], most[1]), multipliers, driving)

    def _add_losses(self, chunk: Chunk, segment: Segment, chosen: NDArray[np.intp]) -> None:
        """Add the losses of impacts before a chunk and of friction in it; note events and modes."""
        self.events += segment.events
        self.done += segment.driven
        self.impacts += segment.loss
        friction = np.cumsum(add_up_friction(self.joints, chunk))
        if len(self.modes) < len(self.t):  # the start
            self.modes.append(segment.modes)
        impacts = self.impacts + np.zeros(len(chunk.t))
        if segment.bounces is not None:
            self.events += segment.bounces.events
            np.add.at(impacts, segment.bounces.rows, segment.bounces.losses)
            impacts = self.impacts + np.cumsum(impacts - self.impacts)
        self.losses += [(self.friction + float(friction[k - 1]), float(impacts[k])) for k in chosen]
        self.modes += [segment.modes] * len(chosen)
        self.friction, self.impacts = self.friction + float(friction[-1]), float(impacts[-1])

    def _keep(self, chunk: Chunk, work: Array, chosen: NDArray[np.intp]) -> None:
        if chosen.size:
            self.inputs += self._ask(chunk.t[chosen], chunk.q[chosen], chunk.qd[chosen])
        self.t += chunk.t[chosen].tolist()
        self.q += list(chunk.q[chosen])
        self.qd += list(chunk.qd[chosen])
        self.work += work[chosen].tolist()

    def _ask(self, t: Array, q: Array, qd: Array) -> list[Array]:
        """Return the inputs at some states; not a number where a feedback has no value, which ends the motion."""
        assert self.piece is not None, "a state lies in a piece"
        if self.piece.law is None:
            return list(self.piece.values(t))
        rows = []
        for state in zip(t, q, qd, strict=True):
            try:
                rows.append(self.piece.at(*state))
            except DriveError:
                rows.append(np.full(len(self.kernels.manifest.inputs), np.nan))
        return rows

    def _add_up(self, chunk: Chunk) -> Array:
        assert self.piece is not None, "a chunk lies in a piece"
        if self.work_is_known:
            try:
                with np.errstate(all="ignore"):  # a motion that diverges has no number for its energy
                    return add_up_work(self.observer, self.piece, chunk)
            except (KernelError, SingularError, DriveError):
                self.work_is_known = False
        return np.zeros(len(chunk.t) - 1)

    def _find_stiffness(self, effort: Effort, t: Array, q: Array, qd: Array, inputs: Array) -> list[str]:
        """Warn where stability, not accuracy, sets the length of explicit steps."""
        method = METHODS[self.settings.method]
        if method.stability is None or not t[-1] or self.is_closed:
            return []
        dynamics = Dynamics(self.kernels, Formulation.IMPL)
        try:
            found = [adaptive.find_stability(dynamics, q[k], qd[k], inputs[k]) for k in (0, len(t) // 2)]
        except (KernelError, SingularError, np.linalg.LinAlgError):
            return []
        decay, joint = max(found)
        is_fixed = method.family is Family.EXPLICIT
        step = self.settings.step if is_fixed else t[-1] / max(effort.steps, 1)
        limit = method.stability if is_fixed else 0.5 * method.stability
        if decay * step < limit or (not is_fixed and decay * t[-1] < STIFF):
            return []
        return [
            f"stiff: motion of joint {joint} decays at {decay:.3g} 1/s, so that explicit steps must stay below "
            f"{method.stability / decay:.2g} s; an implicit method (radau, radau-iia) takes longer ones"
        ]


def _find_singularity(settings: Settings, effort: Effort) -> list[str]:
    """Warn where Baumgarte's terms may have left the branch of a loop's motion."""
    if settings.loops is not Keeping.BAUMGARTE or effort.pivot > SINGULAR:
        return []
    return [
        f"the motion passes a singular pose of the loops (a pivot of their Jacobian shrinks to {effort.pivot:.1e}), "
        "where Baumgarte's terms may choose another branch; compare it with projection"
    ]


def _find_drift(energy: Energy) -> list[str]:
    if energy.is_kept:
        return []
    drift, exchanged = np.abs(energy.drift).max(), energy.exchanged
    return [f"energy drifts by {drift:.2g} J, where {exchanged:.2g} J are exchanged; take a smaller step or tolerance"]


def _find_exceeded_limits(kernels: Kernels, t: Array, q: Array) -> list[str]:
    found = []
    manifest = kernels.manifest
    columns = dict(zip(manifest.positions, q.T, strict=True))
    for coordinate in manifest.coordinates:
        column = columns.get(coordinate.name)
        if column is None or coordinate.stops is not None:  # a joint with a quaternion has no limits
            continue
        for limit, sign in ((coordinate.lower, -1), (coordinate.upper, 1)):
            if limit is None:
                continue
            beyond = np.flatnonzero(sign * (column - limit) > BEYOND * max(1.0, abs(limit)))
            if beyond.size:
                found.append(
                    f"joint {coordinate.name} is beyond its limit {limit:.4g} from t = {t[beyond[0]]:.4g} s on; "
                    "nothing stops it there"
                )
    return found
