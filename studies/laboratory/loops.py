"""Closed loops: drift off them, equations that depend on each other, and poses where loops lose their rank (F16, F24).

Bricard's mechanism has five equations of rank 4 in every pose. N four-bars of equal rods have 2 N equations; N of them
vanish where all rods are on one line. All uprights lean by the same angle a, so that

    ((N + 1) / 3 + N) a'' = ((N + 1) / 2 + N) g sin a
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import cos, hypot, inf, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from mbsrun.closure import Closure
from mbsrun.external import Mechanism
from mbsrun.kernel import KernelError, Kernels
from mbsrun.models import Extent, find_folder
from mbsrun.simulation import Keeping, Motion, Settings, simulate
from mbsrun.simulation.drive import hold
from studies.laboratory.case import Finding, Workspace, check, demand, find_worst, show_failure
from studies.laboratory.integration import STAYS, swing, swing_freely
from studies.laboratory.mechanisms import BRICARD, PENDULUM_ROD, describe_bricard, describe_four_bars, write

Array = NDArray[np.float64]

MOVING = ("exp2", "semi", "semi_res", "energy", "power", "frames", "loops", "loop_rates", "loop_jacobian")
SINGULAR = ("exp1", "exp2", "exp1_red", "close", "close_rates", "loop_jacobian", "loops")
CORRECTED = (Keeping.PROJECTION, Keeping.MASS_PROJECTION, Keeping.PARTITIONING)
EXPLICIT = (*CORRECTED, Keeping.BAUMGARTE)
TIGHT: Mapping[str, Any] = {"method": "dop853", "rtol": 1e-10, "atol": 1e-10}
DURATION = 10.0  # s
CLOSED = 1e-12  # m
RANK = 1e-10  # of singular values, relative to the first
HOME = (
    1.902113032590307,
    1.902113032590307,
    1.1755705045849463,
    1.1755705045849463,
    0.0,
)  # 2 sin(72 deg), 2 sin(36 deg)
TURNS = np.linspace(0, 2.6, 14)  # rad: of the last joint
END = (0.328458112, 0.944518538)  # m: the end of the first upright of two four-bars after 10 s
AT_END = 1e-5  # m
SPEED = 3.0  # rad/s, where rods are level
THREE_DIGITS = 1e-3  # kernels fail where about three digits remain
EARLY = 1e-6  # rad: a status further away is not needed
DISTANCES = (1e-1, 1e-2, 1e-3, 1e-5, 1e-7, 1e-9, 1e-12, 0.0)  # rad from the level pose
ROUNDINGS = 8  # states at each distance


def measure_rod(workspace: Workspace, step: float) -> list[Finding]:
    """F16: the pendulum on a rod by the methods of simulations, beside the program of the laboratory in x and y."""
    plant = _load(workspace, PENDULUM_ROD, MOVING)
    free = swing_freely(0.0, step)
    findings = []
    for gain in (0.0, Settings(DURATION).alpha, 0.5 / step, 1 / step):
        way, remark = f"rk4, baumgarte, h alpha = {gain * step:g}", f"h = {step:g} s, alpha = {gain:g} 1/s"
        drift, miss = _swing(plant, step, Keeping.BAUMGARTE, gain)
        findings.append(check(way, "drift off the rod [m]", drift, STAYS, remark))
        off = abs(drift / swing_freely(gain, step).drift - 1)
        findings.append(check(way, "drift, off the drift of the program in x and y", off, 0.01, remark))
        if gain == Settings(DURATION).alpha:
            findings.append(check(way, "error of the place [m]", miss, 2 * free.miss, f"{remark}, the default"))
    findings.append(_check_refusal(plant, step))
    for keeping in CORRECTED:
        drift, miss = _swing(plant, step, keeping)
        way, remark = f"rk4, {keeping.value}", f"h = {step:g} s"
        findings.append(check(way, "drift off the rod [m]", drift, CLOSED, remark))
        findings.append(check(way, "error of the place [m]", miss, 2 * free.miss, remark))
    return findings


def _swing(plant: Kernels, step: float, keeping: Keeping, gain: float = 0.0) -> tuple[float, float]:
    """Return the largest distance off the rod, and the error of the place at the end [m]."""
    settings = Settings(DURATION, "rk4", step=step, loops=keeping, alpha=gain, beta=gain)
    motion = simulate(plant, hold(np.zeros(0)), [1.0, 0.0], [0.0, 0.0], settings)
    if not motion.is_complete:
        return inf, inf
    angle = float(swing(DURATION))
    drift = float(np.abs(np.hypot(*motion.q.T) - 1).max())
    return drift, hypot(motion.q[-1, 0] - sin(angle), motion.q[-1, 1] + cos(angle))


def _check_refusal(plant: Kernels, step: float) -> Finding:
    gain = 1.01 / step
    way, quantity = "rk4, baumgarte", "refusal of h alpha = 1.01"
    try:
        _swing(plant, step, Keeping.BAUMGARTE, gain)
    except ValueError as error:
        return demand(way, quantity, "gain" in str(error), str(error))
    return demand(way, quantity, False, f"a gain of {gain:g} 1/s is taken")


def measure_ranks(workspace: Workspace) -> list[Finding]:
    """F24: the rank of Bricard's equations, by screws without the generator, is the number of kept ones."""
    plant = _load(workspace, describe_bricard(), ("loops", "loop_jacobian"))
    (loop,) = plant.manifest.loops
    home = np.linalg.svd(list_screws(np.zeros(5)), compute_uv=False)
    kept = len(loop.equations)
    poses = [_turn(plant, angle) for angle in TURNS]
    ranks = {_find_rank(list_screws(q)) for q in poses}
    way, remark = "assembly of loops", f"kept: {', '.join(loop.equations)}; redundant: {', '.join(loop.redundant)}"
    J = [plant("loop_jacobian", q=q, qd=np.zeros(5))["J"] for q in poses]
    together = {_find_rank(np.vstack((list_screws(q), own))) for q, own in zip(poses, J, strict=True)}
    off = float(np.abs(home - HOME).max())
    return [
        check(
            "singular values by screws", "in the cube, off the known ones", off, 1e-12, f"{home[-1]:.1e} is the last"
        ),
        demand(
            way, "kept equations are the rank", {kept} == ranks, f"{kept} kept, rank {sorted(ranks)} in {len(J)} poses"
        ),
        demand(way, "one equation is reported as redundant", len(loop.redundant) == 1, remark),
        demand(way, "kept equations are independent", {_find_rank(x) for x in J} == {kept}, remark),
        demand(way, "kept equations imply all five", together == {kept}, f"rank {sorted(together)} together"),
    ]


def list_screws(q: Array) -> Array:
    """Return the Jacobian of Bricard's last hinge: velocity of its point, and turns across its axis; shape (5, 5)."""
    place, turn = np.zeros(3), np.eye(3)
    axes, places = [], []
    for (axis, offset, _), angle in zip(BRICARD, q, strict=True):
        place = place + turn @ np.array(offset)
        axes.append(turn[:, "xyz".index(axis)])
        places.append(place)
        turn = turn @ _rotate("xyz".index(axis), angle)
    end = place + turn @ np.array(BRICARD[-1][2])
    return np.array([[*np.cross(a, end - p), a[1], a[2]] for a, p in zip(axes, places, strict=True)]).T


def _rotate(axis: int, angle: float) -> Array:
    j, k = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[j, j] = R[k, k] = cos(angle)
    R[j, k], R[k, j] = -sin(angle), sin(angle)
    return R


def _turn(plant: Kernels, angle: float) -> Array:
    """Return the closed pose of Bricard's mechanism with its last joint at an angle."""
    return Closure(plant).move(np.zeros(5), [4], np.array([angle]))


def _find_rank(J: Array) -> int:
    found = np.linalg.svd(J, compute_uv=False)
    return int((found > RANK * found[0]).sum())


def measure_bricard(workspace: Workspace) -> list[Finding]:
    """F24: Bricard's mechanism keeps its energy; LU of its equations without regard to the rank goes on."""
    plant = _load(workspace, describe_bricard(), MOVING)
    findings, q = [], np.zeros(5)
    for keeping in EXPLICIT:
        motion = _run(plant, q, np.zeros(5), keeping)
        way, remark = f"dop853, {keeping.value}", f"{DURATION:g} s, tolerance {TIGHT['rtol']:g}"
        findings.append(check(way, "energy error [J]", _find_drift(motion), 1e-9, remark))
        findings.append(check(way, "open loops [m]", _find_gap(motion), 1e-9, remark))
    return [*findings, _eliminate_blindly(plant)]


def _eliminate_blindly(plant: Kernels) -> Finding:
    """Solve M qdd - J' lam = -c with all five equations by LU, which should find a zero pivot in every pose."""
    conditions = []
    for angle in TURNS:
        q = _turn(plant, angle)
        found = plant("semi", q=q, qd=np.zeros(5))
        J, right = list_screws(q), np.concatenate((-found["c"].ravel(), np.zeros(5)))
        A = np.block([[found["M"], -J.T], [J, np.zeros((5, 5))]])
        try:
            np.linalg.solve(A, right)
        except np.linalg.LinAlgError:
            continue
        conditions.append(float(np.linalg.cond(A)))
    remark = f"of {len(TURNS)}; conditions from {min(conditions, default=inf):.0e} on"
    return show_failure("LU of all five equations", "poses in which it returns numbers", len(conditions), 0, remark)


def measure_passages(workspace: Workspace, bars: int = 2) -> list[Finding]:
    """F24: through the level poses of N four-bars: the right place after 10 s, or a halt that names a loop.

    Baumgarte's method must warn where it takes another branch there.
    """
    plant, exact = _load(workspace, describe_four_bars(bars), MOVING), _lean_exactly(bars)
    findings = []
    if bars == 2:
        off = hypot(-sin(exact) - END[0], cos(exact) - END[1])
        findings.append(check("one equation for all uprights", "error of the place [m]", off, 1e-8, "the known end"))
    for keeping in EXPLICIT:
        motion = _run(plant, _lean(bars, 0.0), _lean(bars, -1.0), keeping)
        way = f"dop853, {keeping.value}, past level poses"
        if motion.halt is not None:
            findings.append(demand(way, "status at the level pose", motion.halt.loop is not None, str(motion.halt)))
            continue
        angle = float(motion.q[-1, 0])
        miss = hypot(sin(angle) - sin(exact), cos(angle) - cos(exact))
        remark = "; ".join((f"energy error {_find_drift(motion):.1e} J", *motion.warnings))
        if keeping is Keeping.BAUMGARTE and miss > AT_END:
            is_warned = any("singular pose" in warning for warning in motion.warnings)
            remark = f"error of the place {miss:.1e} m; {remark}"
            findings.append(demand(way, "warning of the level pose, where the place is wrong", is_warned, remark))
            continue
        findings.append(check(way, "error of the place [m]", miss, AT_END, remark))
    return findings


@dataclass(frozen=True)
class Approach:
    """Results of a kernel at a distance from the level pose: errors of its numbers, loops of its statuses."""

    kernel: str
    distance: float
    errors: tuple[float, ...]
    failed: tuple[str | None, ...]


def measure_level(workspace: Workspace, bars: int = 2) -> list[Finding]:
    """F24: towards the level pose: three digits of the accelerations, or the status of a loop.

    The angles are off by up to one rounding each, so that numbers right by symmetry alone are found out.
    """
    plant = _load(workspace, describe_four_bars(bars), SINGULAR)
    findings = []
    for distance in DISTANCES:
        for found in _approach(plant, bars, distance):
            way, remark = found.kernel.upper(), f"{distance:.0e} rad from the level pose"
            names = {loop.name for loop in plant.manifest.loops}
            if found.failed:
                are_loops = set(found.failed) <= names and distance < EARLY
                findings.append(
                    demand(way, "status names a loop, and not too early", are_loops, f"{remark}: {found.failed[0]}")
                )
            if found.errors:
                findings.append(check(way, "error without a status", find_worst(found.errors), THREE_DIGITS, remark))
    return findings


def _approach(plant: Kernels, bars: int, distance: float) -> Iterator[Approach]:
    angle = np.pi / 2 - distance
    truth = _accelerate(bars, sin(angle))
    rng = np.random.default_rng(0)
    states = [_lean(bars, angle) + 2.0**-52 * rng.integers(-1, 2, 2 * bars + 1) for _ in range(ROUNDINGS)]
    for kernel in ("exp1", "exp2", "exp1_red"):
        is_reduced = kernel == "exp1_red"
        errors, failed = [], []
        for q in states:
            rates = {"yd": [-SPEED]} if is_reduced else {"qd": _lean(bars, -SPEED)}
            try:
                found = plant(kernel, q=q, **rates)
            except KernelError as error:
                failed.append(error.loop)
                continue
            wanted = np.array([truth]) if is_reduced else _lean(bars, truth)
            errors.append(float(np.abs(found["ydd" if is_reduced else "qdd"] - wanted).max() / abs(truth)))
        yield Approach(kernel, distance, tuple(errors), tuple(failed))


def _lean(bars: int, angle: float) -> Array:
    """Return the coordinates for one angle of all uprights: a0, b1, a1, b2, a2, ..."""
    return np.array([angle if k % 2 == 0 else -angle for k in range(2 * bars + 1)])


def _accelerate(bars: int, sine: float) -> float:
    return 9.81 * sine * ((bars + 1) / 2 + bars) / ((bars + 1) / 3 + bars)


def _lean_exactly(bars: int) -> float:
    """Return the uprights' angle after 10 s, from rates of -1 rad/s upright."""
    found = solve_ivp(
        lambda _, y: (y[1], _accelerate(bars, sin(y[0]))), (0, DURATION), (0.0, -1.0), "DOP853", rtol=1e-13, atol=1e-13
    )
    return float(found.y[0, -1])


def _load(workspace: Workspace, text: str, functions: tuple[str, ...]) -> Mechanism:
    return Mechanism(find_folder(write(workspace.folder, text), Extent(functions, 0)))


def _run(plant: Kernels, q: Array, qd: Array, keeping: Keeping) -> Motion:
    return simulate(plant, hold(np.zeros(0)), q, qd, Settings(DURATION, loops=keeping, max_seconds=inf, **TIGHT))


def _find_drift(motion: Motion) -> float:
    return float(np.abs(motion.energy.drift).max()) if motion.is_complete and motion.energy is not None else inf


def _find_gap(motion: Motion) -> float:
    assert motion.closure is not None, "the mechanism has loops"
    return motion.closure.most[0]
