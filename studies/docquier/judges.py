"""Judge the claims of Docquier, Brüls and Fisette: each judge computes its numbers from the results of a run.

The words of the paper are often without a number; the bounds below define them. `judgement` repeats the judges for
several thresholds, and for draws from the scatter of iterations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.searching.study import Place, Weights
from studies.docquier.published import EFFORTS
from studies.docquier.results import Results, find_outliers, is_dae_of_explicit

Array = NDArray[np.float64]

ALIKE = 0.10  # "the same", "does not vary significantly": relative to the larger
SIMILAR = 0.25  # "similar", "comparable"
HALF = (0.4, 0.6)  # "about half"
MANY = 0.05  # "a high number": of all tasks
IMPLICIT, EXPLICIT = ("IMPL", "SEMI"), ("EXP1-O", "EXP1-A", "EXP2-O", "EXP2-A")
ODE, DAE = ("EXP1-O", "EXP2-O"), ("EXP1-A", "EXP2-A")
ALL = IMPLICIT + EXPLICIT
COLLOCATION = "collocation"  # among transcriptions
CONFIRMED, REFUTED = "confirmed", "not confirmed"


@dataclass(frozen=True)
class Finding:
    """The verdict of one judge on one set of results."""

    verdict: str
    numbers: str


# --- shared numbers ---------------------------------------------------------------------------------


def _find(is_so: bool, numbers: str) -> Finding:
    return Finding(CONFIRMED if is_so else REFUTED, numbers)


def _medians(results: Results, weights: Weights, figure: str, names: tuple[str, ...]) -> dict[str, float]:
    return {name: float(np.median(results.values(weights, name, figure))) for name in names}


def _list_values(values: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:.4g}" for name, value in values.items())


def _are_within(a: float, b: float, share: float) -> bool:
    return abs(a - b) <= share * max(abs(a), abs(b))


def _name(results: Results, weights: Weights) -> str:
    return "with smoothing" if weights == results.smooth else "without smoothing"


def _count_higher(results: Results, weights: Weights) -> dict[str, float]:
    return {name: float(len(results.higher(weights, name))) for name in ALL}


# --- section 4.3.1 -------------------------------------------------------------------------------------------------


def list_grids(results: Results, weights: Weights) -> list[tuple[Place, ...]]:
    """List finer and finer grids of solved tasks: every 8th azimuth and height of the run, every 4th, …"""
    targets = results.study.targets
    rows, columns = (sorted({place[k] for place in targets.places}) for k in (0, 1))
    grids: list[tuple[Place, ...]] = []
    for step in (8, 4, 2, 1):
        grid = tuple((i, j) for i in rows[::step] for j in columns[::step])
        if results.compared[weights].issuperset(grid) and (not grids or len(grid) > len(grids[-1])):
            grids.append(grid)
    return grids


def mean_iterations(results: Results, weights: Weights, name: str, grid: tuple[Place, ...]) -> float:
    """Average the iterations of the tasks of a grid that were solved."""
    taken = set(grid)
    found = [a.iterations for a in results.pick(weights, name) if a.task.place in taken and a.cost is not None]
    return float(np.mean(found)) if found else float("nan")


def judge_convergence(results: Results) -> Finding | None:
    changes, text = [], []
    for weights in (results.rough, results.smooth):
        grids = list_grids(results, weights) if results.is_measured(weights, *ALL) and weights is not None else []
        if weights is None or len(grids) < 3:
            continue
        means = [[mean_iterations(results, weights, name, grid) for name in ALL] for grid in grids[-2:]]
        changes.append(max(abs(a - b) / max(a, b) for a, b in zip(*means, strict=True)))
        sizes = f"from {len(grids[-2])} to {len(grids[-1])} tasks"
        text.append(f"{_name(results, weights)}: {sizes} the means change by {changes[-1]:.1%} at most")
    return _find(max(changes) <= ALIKE, "; ".join(text)) if changes else None


# --- Fig. 8 --------------------------------------------------------------------------------------------------------


def _two_motions(results: Results) -> tuple[Trajectory, Trajectory] | None:
    motions = dict(results.motions)
    rough, smooth = (None if w is None else motions.get(w) for w in (results.rough, results.smooth))
    return None if rough is None or smooth is None else (rough, smooth)


def compare_motions(
    measure: Callable[[Trajectory], float], unit: str, wanted: Callable[[float, float], bool]
) -> Callable[[Results], Finding | None]:
    def judge(results: Results) -> Finding | None:
        pair = _two_motions(results)
        if pair is None:
            return None
        rough, smooth = map(measure, pair)
        return _find(wanted(rough, smooth), f"without smoothing {rough:.4g} {unit}, with {smooth:.4g} {unit}")

    return judge


def effort(motion: Trajectory) -> float:
    """Integrate |u|^2."""
    return float((np.diff(motion.t)[:, None] * motion.u**2).sum())


def variation(motion: Trajectory) -> float:
    """Compute the total variation of the inputs."""
    return float(np.abs(np.diff(motion.u, axis=0)).sum())


def late_turns(motion: Trajectory) -> float:
    """Count the turns of the inputs in the last quarter of the time, from a thousandth of the range on."""
    late = motion.u[3 * len(motion.u) // 4 :]
    turns = 0
    for column, whole in zip(late.T, motion.u.T, strict=True):
        steps = np.diff(column)
        steps = steps[np.abs(steps) > 1e-3 * np.ptp(whole)]
        turns += int((np.diff(np.sign(steps)) != 0).sum())
    return float(turns)


def speed(motion: Trajectory) -> float:
    return float(np.abs(motion.qd).max())


def judge_same_end(results: Results) -> Finding | None:
    pair = _two_motions(results)
    if pair is None:
        return None
    poses, inputs = (float(np.abs(a - b).max()) for a, b in ((pair[0].q[-1], pair[1].q[-1]), _last_inputs(*pair)))
    return _find(poses < 1e-4 and inputs < 1e-2, f"they differ by {poses:.1e} rad and {inputs:.1e} N m")


def _last_inputs(a: Trajectory, b: Trajectory) -> tuple[Array, Array]:
    return a.u[-1], b.u[-1]


# --- Fig. 9: minima ------------------------------------------------------------------------------------------------


def judge_smooth_minima(results: Results) -> Finding | None:
    if not results.is_measured(results.smooth, *ALL) or results.smooth is None:
        return None
    counts = _count_higher(results, results.smooth)
    return _find(sum(count > 0 for count in counts.values()) == 1, f"tasks in a higher minimum: {_list_values(counts)}")


def judge_more_without_smoothing(results: Results) -> Finding | None:
    if not (results.is_measured(results.rough, *ALL) and results.is_measured(results.smooth, *ALL)):
        return None
    assert results.rough is not None
    assert results.smooth is not None
    both = results.compared[results.rough] & results.compared[results.smooth]
    without, with_ = (
        sum(len(both.intersection(results.higher(w, name))) for name in ALL) for w in (results.rough, results.smooth)
    )
    text = f"tasks in a higher minimum: {without} without smoothing, {with_} with, of {len(both) * len(ALL)} each"
    return _find(without > with_, text)


def judge_implicit_trapped(results: Results) -> Finding | None:
    if not results.is_measured(results.rough, *ALL) or results.rough is None:
        return None
    counts = _count_higher(results, results.rough)
    implicit, explicit = (float(np.mean([counts[n] for n in names])) for names in (IMPLICIT, EXPLICIT))
    return _find(implicit > explicit, f"tasks in a higher minimum: {_list_values(counts)}")


def judge_sides(results: Results) -> Finding | None:
    """Locate the higher minima without smoothing: in the outer tenth of azimuths, at 0, or between."""
    if not results.is_measured(results.rough, *ALL) or results.rough is None:
        return None
    azimuths = results.study.targets.azimuths
    widest, found = max(map(abs, azimuths)), [p for name in ALL for p in results.higher(results.rough, name)]
    if not found:
        return None
    at = [abs(azimuths[i]) / widest for i, _ in found]
    sides, centre = sum(a >= 0.9 for a in at), sum(a <= 0.05 for a in at)
    text = f"of {len(found)}, {sides} are at the far sides, {centre} in the centre, {len(at) - sides - centre} between"
    return _find(sides + centre > 0.5 * len(found), text)


def judge_explicit_lower(results: Results) -> Finding | None:
    """Count the tasks in which IMPL or SEMI is in a higher minimum, and an explicit form in the lowest."""
    if not results.is_measured(results.rough, *ALL) or results.rough is None:
        return None
    trapped = {p for name in IMPLICIT for p in results.higher(results.rough, name)}
    if not trapped:
        return None
    reached = 0
    for place in trapped:
        reached += any(
            a.task.place == place and a.cost is not None and place not in results.higher(results.rough, name)
            for name in EXPLICIT
            for a in results.pick(results.rough, name)
        )
    text = f"in {reached} of {len(trapped)} such tasks an explicit form reached the lowest minimum"
    return _find(reached > 0.5 * len(trapped), text)


def judge_centre(results: Results) -> Finding | None:
    """Compare the iterations without lateral movement with the iterations of all tasks."""
    weights, azimuths = results.rough, results.study.targets.azimuths
    if not results.is_measured(weights, *ALL) or weights is None:
        return None
    centre = {p for p in results.study.targets.places if abs(azimuths[p[0]]) < 1e-9}
    harder, text = 0, []
    for name in ALL:
        own = results.pick(weights, name)
        at = [a.iterations for a in own if a.task.place in centre]
        if not at:
            return None
        usual = float(np.median([a.iterations for a in own]))
        harder += float(np.median(at)) > usual
        text.append(f"{name} {np.median(at):.0f} against {usual:.0f}")
    return _find(harder == len(ALL), f"median iterations in the centre, and of all: {', '.join(text)}")


# --- Fig. 10 and 11: effort ----------------------------------------------------------------------------------------


def judge_iteration_outliers(results: Results) -> Finding | None:
    """Count outliers of iterations, and the outliers in higher minima."""
    weights = results.rough
    if not results.is_measured(weights, *ALL) or weights is None:
        return None
    outliers = trapped = total = 0
    for name in ALL:
        values, higher = results.values(weights, name, "iterations"), set(results.higher(weights, name))
        beyond = set(find_outliers(values).tolist())
        own = [a for a in results.pick(weights, name) if a.cost is not None]
        total += len(own)
        outliers += sum(a.iterations in beyond for a in own)
        trapped += sum(a.iterations in beyond and a.task.place in higher for a in own)
    text = f"{outliers} of {total} solves are outliers, {trapped} of them in a higher minimum"
    return _find(outliers > MANY * total and trapped > 0.5 * outliers, text)


def judge_dae_iterations(results: Results) -> Finding | None:
    weights = results.rough
    if not results.is_measured(weights, *ALL) or weights is None:
        return None
    means = {name: float(results.values(weights, name, "iterations").mean()) for name in ALL}
    dae = [value for name, value in means.items() if is_dae_of_explicit(name)]
    rest = [value for name, value in means.items() if not is_dae_of_explicit(name)]
    return _find(min(dae) > max(rest), f"means: {_list_values(means)}")


def compare_groups(
    which: str, figure: str, better: tuple[str, ...], worse: tuple[str, ...], unit: str = ""
) -> Callable[[Results], Finding | None]:
    """Confirm that all medians of one group are below all medians of the other."""

    def judge(results: Results) -> Finding | None:
        weights = results.rough if which == "rough" else results.smooth
        if not results.is_measured(weights, *better, *worse) or weights is None:
            return None
        medians = _medians(results, weights, figure, better + worse)
        is_so = max(medians[n] for n in better) < min(medians[n] for n in worse)
        return _find(is_so, f"medians{unit}: {_list_values(medians)}")

    return judge


def compare_ode(which: str, is_clear: bool) -> Callable[[Results], Finding | None]:
    """Compare ODE and DAE of both explicit forms in iterations: clear if both are fewer by a tenth."""

    def judge(results: Results) -> Finding | None:
        weights = results.rough if which == "rough" else results.smooth
        if not results.is_measured(weights, *EXPLICIT) or weights is None:
            return None
        medians = _medians(results, weights, "iterations", EXPLICIT)
        fewer = [medians[o] < (1 - ALIKE) * medians[a] for o, a in zip(ODE, DAE, strict=True)]
        return _find(all(fewer) is is_clear, f"median iterations: {_list_values(medians)}")

    return judge


def judge_explicit_cpu_alike(results: Results) -> Finding | None:
    sets = [w for w in (results.rough, results.smooth) if results.is_measured(w, *EXPLICIT) and w is not None]
    if not sets:
        return None
    medians = [_medians(results, weights, "cpu", EXPLICIT) for weights in sets]
    is_so = all(_are_within(m[o], m[a], SIMILAR) for m in medians for o, a in zip(ODE, DAE, strict=True))
    return _find(is_so, "median CPU s: " + "; ".join(map(_list_values, medians)))


def judge_order_n_dae(results: Results) -> Finding | None:
    sets = [w for w in (results.rough, results.smooth) if results.is_measured(w, "EXP2-O", "EXP2-A") and w is not None]
    if not sets:
        return None
    medians = [_medians(results, weights, "cpu per iteration", ("EXP2-O", "EXP2-A")) for weights in sets]
    text = "median CPU ms per iteration: " + "; ".join(map(_list_values, medians))
    return _find(all(m["EXP2-A"] < m["EXP2-O"] for m in medians), text)


def judge_order_n_iterations(results: Results) -> Finding | None:
    """Confirm that EXP2-A takes more iterations than EXP2-O, and no less CPU time in spite of the cheaper ones."""
    sets = [w for w in (results.rough, results.smooth) if results.is_measured(w, "EXP2-O", "EXP2-A") and w is not None]
    if not sets:
        return None
    names = ("EXP2-O", "EXP2-A")
    found = [(_medians(results, w, "iterations", names), _medians(results, w, "cpu", names)) for w in sets]
    is_so = all(i["EXP2-A"] > i["EXP2-O"] and c["EXP2-A"] >= c["EXP2-O"] for i, c in found)
    return _find(is_so, "; ".join(f"median iterations {_list_values(i)}, CPU s {_list_values(c)}" for i, c in found))


# --- section 4.3.3 -------------------------------------------------------------------------------------------------


def judge_sizes(results: Results) -> Finding | None:
    sizes = {name: results.size(name) for name in ALL}
    if any(size is None for size in sizes.values()):
        return None
    known = {name: size for name, size in sizes.items() if size is not None}
    text = ", ".join(f"{name} {size[0]}/{size[1]}" for name, size in known.items())
    is_so = all(known[large][k] > known[small][k] for large in IMPLICIT + DAE for small in ODE for k in (0, 1))
    return _find(is_so, f"variables/constraints: {text}")


def judge_nonzeros(results: Results) -> Finding | None:
    impl, semi = results.size("IMPL"), results.size("SEMI")
    if impl is None or semi is None:
        return None
    text = f"Jacobian {impl[2]} and {semi[2]}, Hessian {impl[3]} and {semi[3]}"
    return _find(impl[2:] == semi[2:], text)


def compare_flops(a: str, b: str, wanted: Callable[[float], bool]) -> Callable[[Results], Finding | None]:
    """Judge the ratio of the flops of two formulations."""

    def judge(results: Results) -> Finding | None:
        efforts = dict(results.efforts)
        if a not in efforts or b not in efforts:
            return None
        ratio = efforts[a].flops / efforts[b].flops
        printed = EFFORTS[a][0] / EFFORTS[b][0]
        text = f"{efforts[a].flops} by {efforts[b].flops} flops: {ratio:.2f}; by the paper's Table 4: {printed:.2f}"
        return _find(wanted(ratio), text)

    return judge


def judge_crossing(results: Results) -> Finding | None:
    """Return the length of a chain from which the order-N form takes fewer flops than elimination."""
    growth = {g.formulation: dict(g.flops) for g in results.growth}
    sizes = sorted(set(growth.get("EXP1", {})) & set(growth.get("EXP2", {})))
    if not sizes:
        return None
    cheaper = [n for n in sizes if all(growth["EXP2"][m] < growth["EXP1"][m] for m in sizes if m >= n)]
    if not cheaper:
        return _find(False, f"up to {sizes[-1]} joints EXP1 takes fewer flops")
    text = f"from {cheaper[0]} joints on, among chains of {', '.join(map(str, sizes))}"
    return _find(10 <= cheaper[0] <= 20, text)


def compare_iterations(which: str, is_same: bool) -> Callable[[Results], Finding | None]:
    """Count the tasks in which IMPL and SEMI take the same number of iterations."""

    def judge(results: Results) -> Finding | None:
        weights = results.rough if which == "rough" else results.smooth
        if not results.is_measured(weights, *IMPLICIT) or weights is None:
            return None
        impl, semi = ({a.task.place: a.iterations for a in results.pick(weights, name)} for name in IMPLICIT)
        both = sorted(set(impl) & set(semi))
        same = sum(impl[p] == semi[p] for p in both)
        medians = _medians(results, weights, "iterations", IMPLICIT)
        text = f"in {same} of {len(both)} tasks; medians: {_list_values(medians)}"
        if is_same:
            return _find(same >= (1 - ALIKE) * len(both), text)
        return _find(same < len(both) and _are_within(medians["IMPL"], medians["SEMI"], SIMILAR), text)

    return judge


def judge_order_n_prefers_dae(results: Results) -> Finding | None:
    sets = [w for w in (results.rough, results.smooth) if results.is_measured(w, *EXPLICIT) and w is not None]
    if not sets:
        return None
    medians = [_medians(results, weights, "cpu", EXPLICIT) for weights in sets]
    is_so = all(m["EXP2-A"] < m["EXP2-O"] and m["EXP1-O"] < m["EXP1-A"] for m in medians)
    return _find(is_so, "median CPU s: " + "; ".join(map(_list_values, medians)))


def judge_shooting(results: Results) -> Finding | None:
    """Compare multiple shooting with collocation on the explicit form at the extreme targets."""
    rates, cpu = dict[str, float](), dict[str, float]()
    for name, attempts in results.shooting:
        own = [a for a in attempts if a.task.representation in ODE]
        if own:
            rates[name] = sum(a.cost is not None for a in own) / len(own)
            cpu[name] = float(np.median([a.cpu_seconds for a in own]))
    base = COLLOCATION
    others = [name for name in rates if name != base]
    if base not in rates or not others:
        return None
    is_so = all(rates[name] < rates[base] and cpu[name] > cpu[base] for name in others)
    text = "; ".join(f"{name}: {rates[name]:.0%} solved, median CPU {cpu[name]:.3g} s" for name in (base, *others))
    return _find(is_so, text)
