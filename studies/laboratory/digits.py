"""Measure the digits that kernels lose, against exact accelerations.

Exact accelerations are found by refinement: x += M^-1 r in double precision, scaled to a diagonal of ones, with the
residual r in 50 digits by `measuring.reference`, until x stands still to 25 digits. Where that is too ill conditioned
to converge, elimination in 50 digits finds them. So x depends on the residual alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbsrun.forms import FORMS
from mbsrun.measuring.candidates import Found, compile_kernel
from mbsrun.measuring.functions import Precision, Variant
from mbsrun.measuring.mechanisms import Subject
from mbsrun.measuring.reference import Moment, Reference
from mbsrun.models import Extent
from studies.laboratory.case import Finding, Loss, Workspace, check, tell
from studies.laboratory.mechanisms import State, States, write

Array = NDArray[np.float64]

U = {"float64": 2.0**-53, "float32": 2.0**-24}  # the loss of one rounding
EXPLICIT = {form.name: form.function for form in FORMS if form.is_direct}
RESIDUAL = {form.name: form.differentiated for form in FORMS if not form.is_direct}
KERNELS = {**RESIDUAL, **EXPLICIT}
TOLD_BY = {"EXP1": "elimination", "EXP2": "articulated"}
ALWAYS = 1e-13  # the loss of forces and accelerations, which `condition` does not include
ABOVE = 16.0  # the allowed ratio of an error and its estimate: docs/accuracy.md
SMALL, LARGE = 10, 50  # joints: from which on less is optimised in compiling
ELIMINATED = 60  # joints: up to which 50 digits are eliminated where refinement fails
_ENOUGH = 1e-25  # the relative size of a correction after which none is needed
_CORRECTIONS = 60


@dataclass(frozen=True)
class Exact:
    """The exact results in one state."""

    moment: Moment
    M: Array  # rounded
    qdd: list[Any]  # accelerations, in 50 digits; not numbers where M is singular

    @cached_property
    def rounded(self) -> Array:
        """Return the accelerations, rounded to doubles."""
        return np.array([float(x) for x in self.qdd])

    def scale(self, qdd: Sequence[Any]) -> Array:
        """Compute |M| |qdd| + |c| + |Q|, the sum of the absolute values of all terms."""
        parts = zip(self.moment.bias, self.moment.forces, strict=True)
        rest = np.array([float(abs(c) + abs(Q)) for c, Q in parts])
        return np.asarray(np.abs(self.M) @ np.abs(np.array([float(x) for x in qdd])) + rest)

    def leave(self, qdd: Array) -> float:
        """Return the residual of the equations of motion, relative to the sum of the absolute values of their terms."""
        found = [self.moment.context.mpf(float(x)) for x in qdd]
        left = np.array([float(x) for x in self.moment.residual(qdd=found)])
        return float(np.abs(left).max() / self.scale(found).max())


class Specimen:
    """A mechanism with some of its kernels."""

    def __init__(self, model: Path, functions: Sequence[str], without: tuple[str, ...] = ()) -> None:
        """Take a model file, and generate nothing yet. `without` lists reductions to switch off."""
        self.subject = Subject(model, Extent(tuple(dict.fromkeys((*functions, "impl"))), 0, without=without))

    @property
    def size(self) -> int:
        """Count the joints."""
        return len(self.subject.manifest.coordinates)

    def joint(self, status: int) -> str:
        """Name the joint of a status; empty for 0."""
        return self.subject.manifest.coordinates[status - 1].name if status > 0 else ""

    def evaluate(self, kernel: str, states: States, precision: Precision = "float64") -> Found:
        """Call a kernel on states; return statuses, and results as matrices: none where it fails."""
        variant = Variant(precision) if self.size <= SMALL else Variant(precision, "-O1")
        variant = variant if self.size <= LARGE else Variant(precision, "-O0")
        return compile_kernel(self.subject, kernel, variant).evaluate(states)

    def find_exact(self, states: States) -> list[Exact]:
        """Compute the exact results in each state."""
        return [self._find_exact({name: x[k] for name, x in states.items()}) for k in range(len(states["q"]))]

    def balance(self, states: States) -> dict[str, Array]:
        """Choose forces that give about the requested accelerations."""
        still = {**states, "u": 0 * states["u"]}
        return {**states, "u": np.array([found["Phi"][:, 0] for found in self.evaluate("impl", still)[1]])}

    @cached_property
    def reference(self) -> Reference:
        """Return the equations of motion in 50 digits."""
        return Reference(self.subject.model)

    def _find_exact(self, state: State) -> Exact:
        moment = self.reference.at(state)
        M = self._compute_mass(state) if self.size > SMALL else np.array(moment.M, dtype=np.float64)
        qdd = _refine(moment, M)
        if qdd is None and self.size > ELIMINATED:
            raise ArithmeticError("the accelerations are too ill conditioned for refinement")
        return Exact(moment, M, qdd or _eliminate(moment))

    def _compute_mass(self, state: State) -> Array:
        n = self.size
        units = np.vstack((np.zeros((1, n)), np.eye(n)))
        states = {name: np.zeros((n + 1, len(x))) for name, x in state.items()}
        states |= {"q": np.tile(state["q"], (n + 1, 1)), "qdd": units}
        columns = np.array([found["Phi"][:, 0] for found in self.evaluate("impl", states)[1]])
        return np.asarray((columns[1:] - columns[0]).T)


def specimen(workspace: Workspace, text: str, *functions: str, without: tuple[str, ...] = ()) -> Specimen:
    """Write a model file, and return its specimen."""
    return Specimen(write(workspace.folder, text), functions, without)


def relate(found: Array, exact: Array) -> float:
    """Compare by the largest entry."""
    return float(np.abs(found - exact).max() / np.abs(exact).max())


def measure_losses(
    workspace: Workspace,
    mechanism: str,
    number: float,
    chosen: Specimen,
    states: States,
    precision: Precision = "float64",
) -> list[Loss]:
    """Compute accelerations by EXP1 and EXP2 in all states; earlier results are read from the store."""
    facts = (
        workspace.program,
        mechanism,
        number,
        chosen.subject.model.read_bytes(),
        chosen.subject.extent,
        precision,
    )
    key = (*facts, [(name, x.tobytes()) for name, x in sorted(states.items())])
    return workspace.losses.find_or_measure(
        key, lambda: _measure_losses(mechanism, number, chosen, dict(states), precision)
    )


def check_estimate(loss: Loss) -> Finding:
    """Compare an error with the estimate of `condition`."""
    if loss.estimate is None:
        return tell(loss.way, "error where no digit is promised", read(loss.error))
    remark = f"{loss.estimate:.0e} is the estimate, at {loss.number:.0e}"
    return check(loss.way, "error beyond the estimate", read(loss.error), ABOVE * loss.estimate + ALWAYS, remark)


def read(number: float | None) -> float:
    """Return a number, or NaN for None: it meets no bound."""
    return float("nan") if number is None else number


def _measure_losses(
    mechanism: str, number: float, chosen: Specimen, states: States, precision: Precision
) -> list[Loss]:
    losses = []
    exact = chosen.find_exact(states)
    warned = chosen.evaluate("condition", states)[1]
    for way, kernel in EXPLICIT.items():
        statuses, found = chosen.evaluate(kernel, states, precision)
        for k, (status, results, truth) in enumerate(zip(statuses, found, exact, strict=True)):
            qdd = results["qdd"][:, 0] if results else None
            is_finite = qdd is not None and bool(np.isfinite(qdd).all())
            warning = U[precision] * float(warned[k][TOLD_BY[way]].max())
            losses.append(
                Loss(
                    mechanism=mechanism,
                    joints=chosen.size,
                    number=number,
                    state=k,
                    way=way if precision == "float64" else f"{way}, {precision}",
                    condition=float(np.linalg.cond(truth.M)),
                    scaled=scale_condition(truth),
                    estimate=warning if np.isfinite(warning) else None,
                    error=relate(qdd, truth.rounded) if qdd is not None and is_finite else None,
                    backward=truth.leave(qdd) if qdd is not None and is_finite else None,
                    failed=chosen.joint(int(status)) or ("" if is_finite else "nothing: not a number"),
                )
            )
    return losses


def scale_condition(exact: Exact) -> float:
    """Compute the condition of D^-1/2 M D^-1/2, D the diagonal of M; of a very ill-conditioned one in 50 digits."""
    root = np.sqrt(np.diag(exact.M))
    with np.errstate(all="ignore"):
        estimate = float(np.linalg.cond(exact.M / np.outer(root, root)))
    if estimate < 1e12 or not np.isfinite(estimate):
        return estimate
    context, M, n = exact.moment.context, exact.moment.M, len(exact.M)
    scaled = context.matrix(n, n)
    for i in range(n):
        for j in range(n):
            scaled[i, j] = M[i][j] / context.sqrt(M[i][i] * M[j][j])
    try:
        pair = (scaled, scaled**-1)
    except ZeroDivisionError:
        return float("inf")
    first, second = (np.linalg.norm(np.array(A.tolist(), dtype=np.float64), 2) for A in pair)
    return float(first * second)


def _eliminate(moment: Moment) -> list[Any]:
    """Solve for the accelerations in 50 digits; where M is singular none is right, and all are not a number."""
    try:
        return moment.qdd
    except ZeroDivisionError:
        return [moment.context.nan] * moment.size


def _refine(moment: Moment, M: Array) -> list[Any] | None:
    """Solve for the accelerations; None where corrections do not become small."""
    context = moment.context
    with np.errstate(all="ignore"):
        root = np.sqrt(np.diag(M))
        scaled = M / np.outer(root, root)
    if not np.isfinite(scaled).all():
        return None
    x, last = [context.mpf(0)] * len(M), np.inf
    for _ in range(_CORRECTIONS):
        rest = np.array([float(r) for r in moment.residual(qdd=x)])
        try:
            step = np.linalg.solve(scaled, -rest / root) / root
        except np.linalg.LinAlgError:
            return None
        x = [a + context.mpf(float(b)) for a, b in zip(x, step, strict=True)]
        size = float(np.abs(step * root).max() / max(abs(float(a) * r) for a, r in zip(x, root, strict=True)))
        if size <= _ENOUGH:
            return x
        if not size < last / 2:
            return None
        last = size
    return None
