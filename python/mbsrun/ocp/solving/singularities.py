"""Expressions of a problem that have no finite value or derivative along a motion, and kinks that it meets.

Every expression is computed with its first and second derivatives (`jets`) at all points of a motion, part by part:

    the first part whose operands are finite and whose value or derivative is not is the one to name, as sqrt at 0
    abs(x), max(x, y), min(x, y) have a kink where x, or x - y, is 0 or changes its sign from one point to the next

Solvers use the derivatives by the variables of a program; by the time and by constants they need none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mbsgen.expressions import Algebra, Call, Expression, Operation, Power, evaluate, list_operands, names, parse, write
from mbsrun.jets import Jet, make_jets, vary
from mbsrun.ocp.evaluation.values import Values
from mbsrun.ocp.ground.functions import Array
from mbsrun.ocp.ground.plant import Plant
from mbsrun.ocp.ground.status import INFEASIBLE, OVERDETERMINED
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.guessing.state_guess import list_parts
from mbsrun.ocp.problem.phases import Link, PhasedProblem, Plants
from mbsrun.ocp.problem.problem import Problem
from mbsrun.ocp.solution.solution import Run
from mbsrun.ocp.transcription.sides import END, START
from mbsrun.quantities import Quantity, list_quantities

KINKS = ("abs", "max", "min")
NEAR = 1e-6  # of the largest argument of a kink: it is met
SMOOTH = "split it or smooth it"  # a kink


@dataclass(frozen=True)
class Stated:
    """An expression of a problem, and where it stands."""

    place: str  # a part of a problem, as of findings
    title: str  # in words
    text: str
    is_terminal: bool = False  # of the end alone
    is_initial: bool = False  # of the start alone


@dataclass(frozen=True)
class Singularity:
    """A part of an expression without a finite value or derivative, or with a kink, and when."""

    stated: Stated
    part: str
    finding: str  # "has no finite derivative"
    remedy: str
    time: float

    def describe(self, motion: str) -> str:
        """Return the finding; `motion` is the one along which it was found."""
        whole = f"{self.stated.title} {self.stated.text}"
        where = f"in the {whole}" if self.part != self.stated.text else f"the {self.stated.title.rstrip(':')}"
        return f"{self.part} {self.finding} at t = {self.time:.4g} s of {motion} ({where})"


@dataclass(frozen=True)
class Cause:
    """An expression that kept a search from its end: finding, remedy, and the part of the problem."""

    finding: str
    remedy: str
    place: str


def find_cause(problem: Problem, plant: Plant, run: Run, guess: Trajectory, end: Trajectory | None) -> Cause | None:
    """Find an expression by which a search failed: singular at its guess or at its end, or with a kink there."""
    if run.status in (*INFEASIBLE, OVERDETERMINED):
        return None
    motions = [(guess, "the guess"), *([(end, "the motion where the search ended")] if end is not None else [])]
    for motion, name in motions:
        if (found := find_singularity(problem, plant, motion)) is not None:
            return Cause(found.describe(name), found.remedy, found.stated.place)
    motion, name = motions[-1]
    if (found := find_kink(problem, plant, motion)) is not None:
        return Cause(found.describe(name), found.remedy, found.stated.place)
    return None


def list_stated(problem: Problem) -> list[Stated]:
    """List the expressions of a problem that a program differentiates."""
    return list(_list(problem))


def _list(problem: Problem) -> Iterator[Stated]:
    for i, constraint in enumerate(problem.constraints):
        at = constraint.at
        yield Stated(f"constraints[{i}]", "constraint", constraint.expression, at == "end", at == "start")
    for key, terms in (("running", problem.cost.running), ("terminal", problem.cost.terminal)):
        for i, term in enumerate(terms):
            yield Stated(f"cost.{key}[{i}]", f"{key} cost", term.expression, key == "terminal")
    for state in problem.states:
        yield Stated(f"states.{state.name}.rate", f"rate of {state.name}:", state.rate)
    for i, part in enumerate(problem.integrals):
        yield Stated(f"integrals[{i}]", "integral of", part.expression)
    for i, force in enumerate(problem.forces):
        yield Stated(f"forces[{i}]", "force", force.expression)
    for i, component in enumerate(problem.wrenches):
        if component.expression is not None:
            yield Stated(f"wrenches[{i}]", "component of a wrench", component.expression)


class _Points:
    """The points of a motion, with the names that expressions read."""

    def __init__(self, problem: Problem, plant: Plant, motion: Trajectory) -> None:
        self._problem, self._plant = problem, plant
        points, first = list_parts(motion, plant), slice(None, None, motion.point_t.shape[1])
        mesh = {kind: values[first] for kind, values in points.items()}  # inputs of the interval that begins there
        mesh |= {"t": motion.t[:-1, None], "q": motion.q[:-1], "qd": motion.qd[:-1], "states": motion.states[:-1]}
        end = {kind: values[-1:] for kind, values in points.items()}
        end |= {"t": motion.t[-1:, None], "q": motion.q[-1:], "qd": motion.qd[-1:], "states": motion.states[-1:]}
        order = np.argsort(np.concatenate((mesh["t"], points["t"]))[:, 0], kind="stable")
        path = {kind: np.concatenate((mesh[kind], points[kind]))[order] for kind in points}
        self._parts = {kind: np.concatenate((values, end[kind])) for kind, values in path.items()}
        self.times = self._parts["t"][:, 0]

    @property
    def known(self) -> Mapping[str, Quantity]:
        """Return the quantities that expressions may read."""
        return list_quantities(self._plant.manifest, self._problem.added)

    def read_end(self, named: Sequence[str], *, is_last: bool) -> Array:
        """Return the quantities (1, names) at the end, or at the start."""
        return Values(named, self._problem, self._plant)(self._parts)[[-1 if is_last else 0]]

    def read(self, stated: Stated) -> tuple[Mapping[str, Jet], Array]:
        """Return the jets of the names that an expression reads, and the times of its places."""
        text = stated.text
        every = sorted(names(parse(text)) | {"T"})
        values = Values(every, self._problem, self._plant)(self._parts)
        chosen = slice(-1, None) if stated.is_terminal else slice(0, 1) if stated.is_initial else slice(-1)
        fixed = {"t", "T", *(name for name, _ in self._problem.constants)}
        if not self._problem.is_timed:
            fixed.discard("T")
        varied = [name for name in every if name not in fixed and not name.startswith("ref_")]
        n = max(len(varied), 1)
        jets = {}
        for name, column in zip(every, values.T, strict=True):
            column = column[chosen]
            none = Jet(column, np.zeros((1, n)), np.zeros((1, n, n)))
            jets[name] = vary(column, varied.index(name), n) if name in varied else none
        return jets, self.times[chosen]


def find_singularity(problem: Problem, plant: Plant, motion: Trajectory) -> Singularity | None:
    """Find the first expression that has no finite value or derivative at a point of a motion."""
    points = _Points(problem, plant, motion)
    for stated in list_stated(problem):
        if found := _find_singular_part(stated, *points.read(stated)):
            return found
    return None


def _find_singular_part(stated: Stated, jets: Mapping[str, Jet], times: Array) -> Singularity | None:
    """Find the first part of an expression without a finite value or derivative."""
    algebra = _keep_constants(make_jets(max(len(next(iter(jets.values())).H[0]), 1)))
    for part in _list_parts(parse(stated.text)):
        with np.errstate(all="ignore"):
            jet = evaluate(part, jets, algebra)
        wrong, kind = _find_wrong(jet, times.size)
        if wrong is not None:
            return Singularity(stated, write(part), f"has no finite {kind}", _advise(part), float(times[wrong]))
    return None


def _keep_constants(algebra: Algebra[Jet]) -> Algebra[Jet]:
    """Make an algebra whose functions of constants are constants, where their derivatives are infinite too."""

    def keep(apply: Callable[..., Jet]) -> Callable[..., Jet]:
        def apply_to(*operands: Any) -> Jet:
            jet = apply(*operands)
            slopes = [operand.g for operand in operands if isinstance(operand, Jet)]
            is_constant = not any(g.any() for g in slopes)
            return Jet(jet.f, np.zeros_like(jet.g), np.zeros_like(jet.H)) if is_constant else jet

        return apply_to

    operations = {sign: keep(apply) for sign, apply in algebra.operations.items()}
    functions = {name: keep(apply) for name, apply in algebra.functions.items()}
    return replace(algebra, operations=operations, power=keep(algebra.power), functions=functions)


def find_in_links(problem: PhasedProblem, plants: Plants, motions: Sequence[Trajectory], title: str) -> Cause | None:
    """Find the first expression of a link that has no finite value or derivative at the ends of motions."""
    numbers = {name: np.full(1, value) for name, value in problem.constants}
    numbers |= {unknown.name: np.full(1, unknown.guess) for unknown in problem.every_unknown}
    for i, link in enumerate(problem.links):
        ends = [problem.find(link.source), problem.find(link.target)]
        sides = [_Points(problem.phases[k].problem, plants.phases[k], motions[k]) for k in ends]
        for stated in _list_of_link(i, link):
            every = sorted(names(parse(stated.text)))
            known = numbers | _read_sides(stated, every, *sides)
            if not every or not known.keys() >= set(every):  # a number alone, or impulses
                continue
            jets = {name: vary(known[name], k, len(every)) for k, name in enumerate(every)}
            if found := _find_singular_part(stated, jets, sides[0].times[-1:]):
                return Cause(found.describe(f"{title}, phase {link.source}"), found.remedy, stated.place)
    return None


def _list_of_link(i: int, link: Link) -> Iterator[Stated]:
    """List the expressions of a link."""
    own = f"link {link.source} to {link.target}"
    for key, given in (("map", link.map), ("velocities", link.velocities)):
        yield from (Stated(f"links[{i}].{key}.{name}", f"{name} by {own}:", text) for name, text in given if text)
    for k, condition in enumerate(link.conditions):
        yield Stated(f"links[{i}].conditions[{k}]", f"condition of {own}:", condition.expression)
    for k, term in enumerate(link.cost):
        yield Stated(f"links[{i}].cost[{k}]", f"cost of {own}:", term.expression)


def _read_sides(stated: Stated, every: Sequence[str], before: _Points, after: _Points) -> dict[str, Array]:
    """Return the numbers of both sides of a link that an expression of it reads, by the names in it."""
    found: dict[str, Array] = {}
    for prefix, side in ((END, before), (START, after)):
        known = {prefix + name: name for name in side.known}
        if prefix == END and ".map." in stated.place:
            known = {name.removeprefix("q_"): name for name, x in side.known.items() if x.kind in ("q", "states")}
        elif prefix == END and ".velocities." in stated.place:
            known = {name.removeprefix("qd_"): name for name, x in side.known.items() if x.kind == "qd"}
        read = {name: known[name] for name in every if name in known}
        values = side.read_end([*read.values()], is_last=prefix == END)
        found |= dict(zip(read, values.T, strict=True))
    return found


def find_kink(problem: Problem, plant: Plant, motion: Trajectory) -> Singularity | None:
    """Find the first expression whose kink a motion meets."""
    points = _Points(problem, plant, motion)
    for stated in list_stated(problem):
        kinks = [part for part in _list_parts(parse(stated.text)) if isinstance(part, Call) and part.function in KINKS]
        if not kinks:
            continue
        jets, times = points.read(stated)
        algebra = make_jets(max(len(next(iter(jets.values())).H[0]), 1))
        for part in kinks:
            inner = part.arguments[0] if part.function == "abs" else Operation("-", *part.arguments)
            with np.errstate(all="ignore"):
                values = np.broadcast_to(evaluate(inner, jets, algebra).f, times.shape)
            met = _find_zero(values)
            if met is not None:
                where = "0" if part.function == "abs" else "equal arguments"
                remedy = f"{part.function} has no derivative at {where}: {SMOOTH}"
                return Singularity(stated, write(part), "meets its kink", remedy, float(times[met]))
    return None


def _list_parts(expression: Expression) -> Iterator[Expression]:
    """List the parts of an expression, operands first."""
    for operand in list_operands(expression):
        yield from _list_parts(operand)
    yield expression


def _find_wrong(jet: Jet, places: int) -> tuple[int | None, str]:
    """Return the first place where a jet is not finite, and what is not."""
    for kind, values in (("value", jet.f), ("derivative", jet.g), ("second derivative", jet.H)):
        finite = np.isfinite(values)
        if finite.all():
            continue
        whole = np.broadcast_to(finite.reshape(len(finite) if finite.ndim else 1, -1).all(axis=1), places)
        return int(np.flatnonzero(~whole)[0]), kind
    return None, ""


def _find_zero(values: Array) -> int | None:
    """Return the first place at which numbers are 0, or change their sign; None where they do neither."""
    values = np.nan_to_num(values)
    is_zero = np.abs(values) <= NEAR * np.abs(values).max(initial=0.0)
    changes = (
        np.flatnonzero(is_zero[:-1] | (values[:-1] * values[1:] < 0)) if values.size > 1 else np.flatnonzero(is_zero)
    )
    return int(changes[0]) if changes.size else None


def _advise(part: Expression) -> str:
    """Return what to do about a part without a finite value or derivative."""
    match part:
        case Operation("/", _, divisor):
            return f"guess a motion on which {write(divisor)} is not 0, or write it without the division"
        case Power(base, exponent) if exponent < 0:
            return f"guess a motion on which {write(base)} is not 0"
        case Call("sqrt", (inner,)):
            return (
                f"sqrt has no derivative at 0: guess a motion on which {write(inner)} is positive, or write the square"
            )
        case Call("log", (inner,)):
            return f"guess a motion on which {write(inner)} is positive"
        case Call("asin" | "acos", (inner,)):
            return f"guess a motion on which {write(inner)} is between -1 and 1"
        case Call("atan2", _):
            return "atan2 has no derivative where both arguments are 0: guess another motion"
    return "guess another motion, or write it otherwise"
