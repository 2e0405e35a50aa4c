"""Kernels: nanoseconds of a call against the error, by formulation, precision, flags of the compiler, and size.

Errors are against 50 digits at the same inputs (`reference`), the largest over the states tried:

    of a result x      max |x - x*| / max |x*|;       of several results, the largest
    of the equations   max_i |r_i| / (|M| |qdd| + |c| + |Q|)_i,    the backward error

where r is the error of a residual, or the residual at the computed accelerations: a change of the forces by r makes the
result exact. With closed loops, lam and the equations of loops count likewise. A state in which the kernel returns a
status other than 0 counts as failed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsgen.manifest import Manifest
from mbsgen.roles import Order, name_derivative, name_kernel, name_low, name_precise
from mbsrun import forms
from mbsrun.closure import has_loops
from mbsrun.kernel import find_place
from mbsrun.measuring.candidates import Candidate, add_hidden, compile_kernel, difference, differentiate
from mbsrun.measuring.functions import Variant
from mbsrun.measuring.mechanisms import CLOSING, Subject, draw_states, write_chain
from mbsrun.measuring.points import KernelPoint
from mbsrun.measuring.reference import Moment, Reference
from mbsrun.measuring.store import Store
from mbsrun.measuring.timing import Watch, measure_costs, sum_up
from mbsrun.models import Extent

Array = NDArray[np.float64]
Results = Mapping[str, Array]

RESIDUAL, MASS, ACCELERATIONS = "residual", "mass matrix and bias", "accelerations"
SLOPES_R, SLOPES_A = "Jacobian of the residual", "Jacobian of the accelerations"
REDUCED_R, REDUCED_M, REDUCED_A = "reduced residual", "reduced mass matrix and bias", "reduced accelerations"
SLOPES_RR, SLOPES_RA = "Jacobian of the reduced residual", "Jacobian of the reduced accelerations"
KERNELS = {
    RESIDUAL: forms.RESIDUALS,
    MASS: (forms.SEMI.function,),
    ACCELERATIONS: forms.ACCELERATIONS,
    REDUCED_R: ("impl_red",),
    REDUCED_M: ("semi_red",),
    REDUCED_A: ("exp1_red",),
}
SLOPES = {SLOPES_R: RESIDUAL, SLOPES_A: ACCELERATIONS, SLOPES_RR: REDUCED_R, SLOPES_RA: REDUCED_A}
OF_LOOPS = (REDUCED_R, REDUCED_M, REDUCED_A, SLOPES_RR, SLOPES_RA)  # tasks that mechanisms without loops do not have
VALUES = Extent(forms.FUNCTIONS, 0, optional=CLOSING)
DERIVATIVES = replace(VALUES, derivatives=1, targets=("python",))
DOUBLE_DOUBLE = "double-double"  # the target, and the precision

USUAL, SINGLE, PRECISE = Variant(), Variant("float32"), Variant("double-double")
VARIANTS = (
    *(Variant(level=level) for level in ("-O0", "-O1", "-O2", "-O3")),
    Variant(contract=False),
    Variant(libm=True),
    SINGLE,
    Variant("float32", level="-O1"),
    Variant("float32", contract=False),
    Variant("float32", libm=True),
    PRECISE,
    Variant("double-double", contract=False),
)
TEXTBOOK, EXACT = "textbook's recursion, Python", "50 digits"
REPEATED = 3  # states in which the reference is timed
STATES = 256  # for times: for an arm, they exceed the first cache


@dataclass(frozen=True)
class KernelScope:
    """The amount of measurement."""

    sizes: tuple[int, ...] = (2, 5, 10, 20)  # of chains, beside the model
    variants: tuple[Variant, ...] = VARIANTS
    rounds: int = 40
    judged: int = 16  # states for errors
    derivatives: bool = True  # of the model, not of the chains


QUICK = KernelScope((3,), (Variant(level="-O0"), USUAL, SINGLE, PRECISE), 3, 3)


@dataclass(frozen=True)
class Errors:
    """The errors of the results for one state."""

    error: float
    backward: float | None


def measure_kernels(
    model: Path, folder: Path, scope: KernelScope, report: Callable[[str, int, int], None]
) -> list[KernelPoint]:
    """Measure a model and chains; earlier measurements are read from the folder. `report` receives each step.

    Raises InputError for a model with faults, CompileError.
    """
    own = Subject(model, _extend(DERIVATIVES if scope.derivatives else VALUES, scope))
    report(f"{own.manifest.model}: generating", 0, 1)  # a model with faults is refused before anything is written
    chains = [Subject(write_chain(size, folder / "models"), _extend(VALUES, scope)) for size in scope.sizes]
    jobs = [(own, task) for task in list_tasks(own.manifest, derivatives=scope.derivatives)]
    jobs += [(chain, task) for chain in chains for task in list_tasks(chain.manifest, derivatives=False)]
    store = Store(folder / "kernels.jsonl", KernelPoint)
    points: list[KernelPoint] = []
    for done, (subject, task) in enumerate(jobs):
        report(f"{subject.model.stem}: {task}", done, len(jobs))
        points += measure_task(subject, task, scope, store)
    return points


def _extend(extent: Extent, scope: KernelScope) -> Extent:
    """Add the kernels in double-double, if they are measured."""
    return replace(extent, targets=(*extent.targets, DOUBLE_DOUBLE)) if PRECISE in scope.variants else extent


def list_tasks(manifest: Manifest, *, derivatives: bool) -> list[str]:
    """List the tasks of a mechanism."""
    every = (*KERNELS, *(SLOPES if derivatives else ()))
    return [task for task in every if has_loops(manifest) or task not in OF_LOOPS]


def measure_task(subject: Subject, task: str, scope: KernelScope, store: Store[KernelPoint]) -> list[KernelPoint]:
    """Measure all ways of one task in turn."""
    variants = scope.variants if task in KERNELS else tuple(v for v in (USUAL, SINGLE) if v in scope.variants)
    compilers = [variant.compiler() for variant in variants]
    versions = [(c.command, c.flags, c.macros) for c in compilers]
    facts = (
        "kernels",
        subject.manifest.generator,
        subject.manifest.model_hash,
        task,
        versions,
        scope.rounds,
        scope.judged,
        STATES,
    )
    return store.find_or_measure(facts, lambda: KernelTask(subject, task, scope).measure(variants))


class KernelTask:
    """One task of one mechanism: candidates, states and expected results."""

    def __init__(
        self, subject: Subject, task: str, scope: KernelScope, states: Mapping[str, Array] | None = None
    ) -> None:
        """Take a task; without states (K, size) by input, draw them."""
        self.subject, self.task, self.scope = subject, task, scope
        drawn = draw_states(subject.kernels, max(STATES, scope.judged)) if states is None else states
        self.states = add_hidden(subject, drawn)

    @cached_property
    def moments(self) -> list[Moment]:
        """Return the states for errors, in 50 digits."""
        reference = Reference(self.subject.model)
        return [
            reference.at({name: values[k] for name, values in self.states.items()}) for k in range(self.scope.judged)
        ]

    @cached_property
    def expected(self) -> list[dict[str, Array]]:
        """Compute the expected results in 50 digits, each as the sum of two arrays of doubles."""
        return [_expect(self.task, moment) for moment in self.moments]

    def measure(self, variants: Sequence[Variant]) -> list[KernelPoint]:
        """Evaluate all candidates, then time them in turn."""
        candidates = [x for variant in variants for x in self._list_candidates(variant)]
        drafts = [self._judge(x) for x in candidates]
        timed = [(draft, watch) for draft, watch in drafts if watch is not None]
        costs = measure_costs([watch for _, (watch, _) in timed], self.scope.rounds)
        cost_of = {
            id(draft): replace(cost, shortest=cost.shortest * calls, median=cost.median * calls)
            for (draft, (_, calls)), cost in zip(timed, costs, strict=True)
        }
        points = [replace(draft, ns=cost_of.get(id(draft))) for draft, _ in drafts]
        return [*points, *([self._time_reference()] if self.task in (RESIDUAL, ACCELERATIONS) else [])]

    def judge_states(self, name: str) -> list[tuple[int, float | None]]:
        """Evaluate a kernel in each of the first `judged` states: its status, and its error; None without a number."""
        judged = {key: values[: self.scope.judged] for key, values in self.states.items()}
        statuses, found = compile_kernel(self.subject, name, USUAL).evaluate(judged)
        errors = [self._compare(k, x).error if x else None for k, x in enumerate(found)]
        finite = [None if error is None or not np.isfinite(error) else error for error in errors]
        return list(zip(statuses.tolist(), finite, strict=True))

    def _time_reference(self) -> KernelPoint:
        """Return the reference as a point: its time in Python, and no error."""
        reference, times = Reference(self.subject.model), []
        for k in range(REPEATED):
            moment = reference.at({name: values[k] for name, values in self.states.items()})
            before = time.perf_counter_ns()
            _expect(self.task, moment)
            times.append(time.perf_counter_ns() - before)
        point = replace(self._point(TEXTBOOK, USUAL), precision=EXACT, flags="", states=REPEATED)
        return replace(point, ns=sum_up(np.array(times, dtype=np.float64)), error=0.0, error_median=0.0)

    def _list_candidates(self, variant: Variant) -> Iterator[Candidate | KernelPoint]:
        if self.task in KERNELS:
            known = {kernel.name for kernel in self.subject.manifest.kernels}
            for name in KERNELS[self.task]:
                if variant.precision == DOUBLE_DOUBLE and name_precise(name) not in known:
                    yield self._point(name, variant, "computed in stages: there is no kernel in double-double")
                else:
                    yield compile_kernel(self.subject, name, variant)
            return
        names = KERNELS[SLOPES[self.task]]
        yield from (compile_kernel(self.subject, name_kernel(name, Order.JACOBIAN), variant) for name in names)
        yield from difference(self.subject, names[-1] if self.task == SLOPES_A else names[0], variant)
        if variant.precision == "float64":  # CasADi's C calls sine in double precision
            for name in names:
                found = differentiate(self.subject, name, variant)
                yield self._point(f"{name}, CasADi's AD", variant, found) if isinstance(found, str) else found

    def _point(self, way: str, variant: Variant, finding: str = "") -> KernelPoint:
        manifest = self.subject.manifest
        size, states = len(manifest.coordinates), len(self.states["q"])
        names = (manifest.model, size, self.task, way, variant.precision, variant.label)
        return KernelPoint(*names, None, None, None, None, states, 0, finding)

    def _judge(self, candidate: Candidate | KernelPoint) -> tuple[KernelPoint, tuple[Watch, int] | None]:
        """Return the errors of a candidate, and a watch for the states in which it does not fail."""
        if isinstance(candidate, KernelPoint):
            return candidate, None
        judged = {name: values[: self.scope.judged] for name, values in self.states.items()}
        errors = [self._compare(k, found) for k, found in enumerate(candidate.evaluate(judged)[1]) if found]
        finite = [e for e in errors if np.isfinite(e.error)]
        statuses, _ = candidate.evaluate(self.states)
        point = replace(
            self._point(candidate.way, candidate.variant, self._describe_failures(statuses, len(errors) - len(finite))),
            failed=int(np.count_nonzero(statuses)),
        )
        if finite:
            sizes, backward = [e.error for e in finite], [e.backward for e in finite if e.backward is not None]
            point = replace(
                point,
                error=float(np.max(sizes)),
                error_median=float(np.median(sizes)),
                backward=float(np.max(backward)) if backward else None,
            )
        good = {name: values[statuses == 0] for name, values in self.states.items()}
        return point, candidate.watch(good) if len(good["q"]) else None

    def _describe_failures(self, statuses: NDArray[np.int64], overflown: int) -> str:
        """Describe failures and their joints."""
        parts = []
        if statuses.any():
            found = sorted(set(statuses[statuses > 0].tolist()))
            places = ", ".join(str(find_place(self.subject.manifest, s)).removeprefix("joint ") for s in found)
            parts.append(f"digits lost at {places} in {np.count_nonzero(statuses)} of {len(statuses)} states")
        if overflown:
            parts.append(f"not a number, with status 0, in {overflown} of {self.scope.judged} states")
        return "; ".join(parts)

    def _compare(self, k: int, found: Results) -> Errors:
        moment, expected = self.moments[k], self.expected[k]
        parts = [
            float(np.abs(_subtract(found, expected, name)).max() / np.abs(expected[name]).max())
            for name in _list_first(expected)
            if expected[name].size and np.abs(expected[name]).max() > 0
        ]
        return Errors(max(parts, default=0.0), _measure_backward(self.task, moment, found, expected))


def _expect(task: str, moment: Moment) -> dict[str, Array]:
    """Compute the results of a task in 50 digits, by their names in kernels; of values, two arrays make a sum."""
    reduced = moment.reduced
    if task in (RESIDUAL, REDUCED_R):
        return _split("Phi", [moment.residual() if task == RESIDUAL else reduced.residual()], turned=True)
    if task in (MASS, REDUCED_M):
        M, c = (moment.M, moment.bias) if task == MASS else reduced.terms
        return _split("M", M) | _split("c", [c], turned=True)
    if task in (ACCELERATIONS, REDUCED_A):
        solution = moment.solution if task == ACCELERATIONS else reduced.solution
        parts = [_split(name, [x], turned=True) for name, x in solution.items()]
        return {name: part for found in parts for name, part in found.items()}
    names = [name for name in _INPUTS[task] if moment.state.get(name)]
    if task in (SLOPES_R, SLOPES_RR):
        rows = {name: moment.slopes(name) if task == SLOPES_R else reduced.slopes(name) for name in names}
        return {name_derivative("Phi", name): _round(x).T for name, x in rows.items()}
    solved = {name: moment.differentiate(name) if task == SLOPES_A else reduced.differentiate(name) for name in names}
    return {name_derivative(of, by): _round(x).T for by, results in solved.items() for of, x in results.items()}


_OWN = ("u", "w", "theta")
_INPUTS = {  # that results are differentiated by
    SLOPES_R: ("q", "qd", "qdd", "lam", "tau", *_OWN),
    SLOPES_A: ("q", "qd", "a", *_OWN),
    SLOPES_RR: ("q", "yd", "ydd", "tau", *_OWN),
    SLOPES_RA: ("q", "yd", "a", *_OWN),
}


def _split(name: str, rows: Sequence[Sequence[Any]], *, turned: bool = False) -> dict[str, Array]:
    """Write a matrix as the sum of two, the second one by the name of the second part."""
    high = _round(rows)
    low = _round([[x - type(x)(float(x)) for x in row] for row in rows])
    return {name: high.T, name_low(name): low.T} if turned else {name: high, name_low(name): low}


def _list_first(results: Results) -> list[str]:
    """List results without their second parts."""
    lows = {name_low(name) for name in results}
    return [name for name in results if name not in lows]


def _subtract(found: Results, expected: Results, name: str) -> Array:
    """Subtract an expected result; its second part only where the result has one."""
    difference, low = found[name] - expected[name], name_low(name)
    return difference + (found[low] - expected[low]) if low in found else difference


def _measure_backward(task: str, moment: Moment, found: Results, expected: Results) -> float | None:
    if task == RESIDUAL:
        forces = {name: moment.state[name] for name in ("qdd", "lam", "tau") if moment.state.get(name)}
        return _relate(_subtract(found, expected, "Phi"), moment.scale(forces)[: moment.size])
    if task == ACCELERATIONS and all(np.isfinite(x).all() for x in found.values()):
        solution = {name: _add(moment, found, name) for name in _list_first(expected)}
        return _relate(_round([moment.balance(**solution)]), moment.scale(solution))
    return None


def _add(moment: Moment, found: Results, name: str) -> list[Any]:
    """Return a result in 50 digits."""
    lows = found.get(name_low(name), 0 * found[name])
    pairs = zip(found[name].ravel(), lows.ravel(), strict=True)
    return [moment.context.mpf(float(high)) + moment.context.mpf(float(low)) for high, low in pairs]


def _relate(rest: Array, scale: Array) -> float:
    """Return the largest ratio of two vectors, entry by entry; where the scale is 0, the entry itself."""
    return float((np.abs(rest.ravel()) / np.where(scale > 0, scale, 1.0)).max())


def _round(rows: Sequence[Sequence[object]]) -> Array:
    return np.array(rows, dtype=np.float64)
