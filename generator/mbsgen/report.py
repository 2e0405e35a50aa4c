"""The report: the cost of each formulation and each generated kernel, as a table, as Markdown and as JSON.

`formulations` counts the dynamics with every number of the model as a run-time parameter and `setup` apart, as in the
paper's Table 4. Masses are lumped by divisions by parameters, as `--runtime --lump` generates them. `kernels` counts
the generated kernels.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import chain
from math import ceil, log10
from types import MappingProxyType

from sympy import Expr

from mbsgen import assembly
from mbsgen.assembly import Findings
from mbsgen.formulations import ports
from mbsgen.formulations.catalogue import FUNCTIONS, is_by_tables, list_rows, write_row
from mbsgen.formulations.reductions import ALL, NONE, Reductions
from mbsgen.manifest import Flops, Kernel
from mbsgen.model.symbols import exact, to_double
from mbsgen.model.tree import Kind, Tree
from mbsgen.request import MEASURED, CodeSize
from mbsgen.roles import Order
from mbsgen.scene_tables import Evidence, describe, describe_cuts
from mbsgen.tape.counts import count
from mbsgen.tape.passes import hoist
from mbsgen.tape.types import Tape
from mbsgen.verification.verify import TOLERANCE, Verification

LUMPED = Reductions(lump_runtime=True)
FEW = 12  # plans tried with a reduction switched off
SWITCHED: Mapping[str, Reductions] = MappingProxyType(
    {
        "all reductions (--runtime --lump)": LUMPED,
        "inertia not regrouped": replace(LUMPED, regroup=False, trials=FEW),
        "frames not shared": replace(LUMPED, share_frames=False, trials=FEW),
        "masses not lumped by parameters (--runtime)": ALL,
        "masses not lumped": replace(LUMPED, lump=False, lump_runtime=False, trials=FEW),
        "relative angles": replace(LUMPED, absolute=False),
        "motions not carried to inertia": replace(LUMPED, meet=False),
        "joints eliminated one by one": replace(LUMPED, together=False),
        "fields not from angular accelerations": replace(LUMPED, spin=False),
        "momentum not passed, no moments by rates": replace(LUMPED, momentum=False),
        "accelerations along axes in the bias": replace(LUMPED, rest=False),
        "point masses not in series": replace(LUMPED, series=False),
        "sums not factored": replace(LUMPED, factor=False),
        "common parts not shared": replace(LUMPED, share=False),
        "sums as they come": replace(LUMPED, order=False),
        "no reduction": replace(NONE, trials=1),
    }
)
# Published counts of a mechanism, whatever its name: flops and equations.
PUBLISHED: Mapping[str, Mapping[str, tuple[int, int]]] = MappingProxyType(
    {  # by `identify`. Docquier, Bruls, Fisette, Table 4: the arm with a pendulum of their Table 2
        "d688b205c36105a7": {"IMPL": (460, 114), "SEMI": (830, 264), "EXP1": (991, 328), "EXP2": (1784, 395)}
    }
)
COLUMNS = ("flops", "arith", "+ -", "*", "/", "neg", "sqrt", "trig", "other", "guard", "eqs")
NOTE = (
    "flops: + - * / sqrt sin cos and unary minus, one each, as the paper counts. arith: + - * / alone. Neither counts "
    "other (exp, tanh and the like) and guard (products and signs in tests of pivots). eqs: assignments of the C that "
    "compute something. A formulation is the equations of motion alone: no inputs and no other forces, except a force "
    "in every joint where it gives accelerations; of M, one triangle. A kernel is counted as it is generated. Numbers "
    "at run time, masses lumped: as --runtime --lump generates them. Their setup divides by lengths and inertias, and "
    "fails where one is 0. --runtime alone divides by none, and takes more flops."
)
BRIEF = "flops: + - * / sqrt sin cos and unary minus, one each. report.md explains tables and columns."
COMPARISON = "Flops of the formulations, compared"
SCENE = "Flops of the functions, with ever more left out"
LEFT_OUT = "Left out below the tolerance"
VERIFICATION = "Compared before it was written"
LOOPS = "Loops"
DIFFERENTIATION = "Flops of the derivatives, by the way of writing them"
WAYS = ("tape", "recursion", "implicit")  # differentiating the tape, the recursion, or by the implicit function theorem


@dataclass(frozen=True)
class Cost:
    """The cost of one evaluation."""

    flops: Flops
    equations: int

    @property
    def row(self) -> tuple[int, ...]:
        """Return the cost in the order of COLUMNS."""
        f = self.flops
        return (f.paper, f.arithmetic, f.add, f.mul, f.div, f.neg, f.sqrt, f.trig, f.other, f.guard, self.equations)


@dataclass(frozen=True)
class Report:
    """The costs of a model."""

    model: str
    formulations: Mapping[str, Cost]
    setups: Mapping[str, Cost]  # of the formulations, once per change of parameters
    folded: Mapping[str, Cost]  # the formulations with every number of the model folded
    kernels: Mapping[str, Cost]
    values: frozenset[str]  # of the kernels, the functions themselves: others are derivatives
    reductions: Mapping[str, Mapping[str, int]]  # flops of each formulation without each reduction; may be empty
    ways: Mapping[str, Mapping[str, int]]  # flops of the derivatives of the formulations, by the way they are written
    verification: Verification
    evidence: Evidence | None  # of the scene; None without one
    published: Mapping[str, tuple[int, int]]  # published flops and equations; may be empty
    loops: Findings | None = None  # None without loops


def make_report(
    written: Tree,
    parametric: Tree,
    kernels: tuple[Kernel, ...],
    ways: Mapping[str, Mapping[str, int]],
    verification: Verification,
    evidence: Evidence | None = None,
    *,
    counted: bool = True,
    compare: bool = False,
    size: CodeSize = MEASURED,
) -> Report:
    """Count the generated kernels, and the formulations among them unless they are not to be `counted`.

    Formulations that tables write are not counted: their straight code would be long.

    `written` is the tree of the model; in `parametric`, every number is a run-time parameter. Counting without each
    reduction takes a while, and is done only if requested.
    """
    made = {kernel.name.upper() for kernel in kernels if counted}
    names = [
        name for name in list_rows() if name in made and not is_by_tables(FUNCTIONS[name.lower()], written, size.matrix)
    ]
    parametric = replace(parametric, closure=written.closure)
    formulations, setups, folded = {}, {}, {}
    for name in names:
        setup, tape = _write(name, parametric, LUMPED)
        formulations[name], setups[name] = _cost(tape), _cost(setup)
        folded[name] = _cost(write_row(name, _fold(written), ALL))
    switched = SWITCHED if compare else {}
    reductions = {
        title: {name: count(_write(name, parametric, choice)[1]).paper for name in names}
        for title, choice in switched.items()
    }
    costs = {k.name: Cost(k.flops, k.equations) for k in kernels}
    values = frozenset(k.name for k in kernels if k.order is Order.VALUE)
    published = PUBLISHED.get(identify(written), {})
    return Report(
        written.name,
        formulations,
        setups,
        folded,
        costs,
        values,
        reductions,
        ways,
        verification,
        evidence,
        published,
        assembly.describe(written),
    )


def identify(tree: Tree) -> str:
    """Return a hash of the numbers that the dynamics depend on, in doubles: names do not enter."""
    values = {p.symbol: exact(p.value) for p in tree.parameters}

    def read(*numbers: Expr) -> list[str]:
        return [to_double(number.xreplace(values)).hex() for number in numbers]

    told: list[object] = []
    for b in tree.bodies:
        numbers = read(*b.position, *chain(*b.orientation), b.mass, *b.com, *chain(*b.inertia))
        for part in b.parts:
            numbers += read(part.mass, *part.com, *chain(*part.inertia))
        if b.joint.armature != 0:
            numbers += read(b.joint.armature)
        told.append((b.parent, b.joint.motion.value, b.joint.axis, str(b.joint.law), numbers))
    if tree.is_constrained:
        told.append((tree.loops, tree.constraints, tree.driven))
    if tree.couplings:
        told.append([(x.follower, x.leader, *read(x.ratio, x.offset)) for x in tree.couplings])
        if more := [(x.follower, leader, *read(ratio)) for x in tree.couplings for leader, ratio in x.more]:
            told.append(more)
    return hashlib.sha256(repr((read(*tree.gravity), told, len(tree.wrenches))).encode()).hexdigest()[:16]


def _fold(tree: Tree) -> Tree:
    """Return the tree with constant parameters."""
    return replace(tree, parameters=tuple(replace(p, kind=Kind.CONSTANT) for p in tree.parameters))


def _write(name: str, tree: Tree, reductions: Reductions) -> tuple[Tape, Tape]:
    """Write a formulation's dynamics alone; split off the operations on parameters alone."""
    setup, (tape,) = hoist([write_row(name, tree, reductions)], ports.PARAMETERS, ports.SETUP)
    return setup, tape


def _cost(tape: Tape) -> Cost:
    counts = count(tape)
    return Cost(counts.flops, counts.equations)


@dataclass(frozen=True)
class Section:
    """A table of the report: rows in groups; a kernel and its derivatives are a group."""

    title: str
    groups: tuple[Mapping[str, Cost], ...]


def sections(report: Report) -> tuple[Section, ...]:
    """List the tables of a report; a kernel and its derivatives are a group."""
    groups: list[dict[str, Cost]] = []
    for name, cost in report.kernels.items():
        if not groups or name in report.values:
            groups.append({})
        groups[-1][name] = cost
    counted = (
        Section("Formulations, numbers at run time, masses lumped", (report.formulations,)),
        Section("Formulations, constants folded", (report.folded,)),
        Section("Setup of the first, once per change of parameters", (report.setups,)),
    )
    return (*(counted if report.formulations else ()), Section("Kernels as generated", tuple(groups)))


def comparisons(report: Report) -> dict[str, Mapping[str, int]]:
    """Return the flops of the formulations for comparison: published, and without each reduction, where known."""
    rows: dict[str, Mapping[str, int]] = dict(report.reductions)
    if report.published and report.formulations:
        rows |= {"published": {name: flops for name, (flops, _) in report.published.items()}}
        rows |= {"published, equations": {name: equations for name, (_, equations) in report.published.items()}}
    return rows


def ways_taken(report: Report) -> dict[str, tuple[str, ...]]:
    """Return the flops of derivatives in each of WAYS; empty where one is not written."""
    return {name: tuple(str(found.get(way, "")) for way in WAYS) for name, found in report.ways.items()}


def tables_of_scene(report: Report) -> list[tuple[str, tuple[str, ...], list[tuple[str, ...]]]]:
    """Return tables of the savings of a scene: a title, the header, rows; none without a scene."""
    if report.evidence is None:
        return []
    names = tuple(next(iter(report.evidence.flops.values())))
    tables = [(SCENE, ("", *names), describe(report.evidence, names))]
    if report.evidence.approximation is not None and report.evidence.approximation.taken:
        tables.append((LEFT_OUT, ("", "value", "alone errs by", "saves flops"), describe_cuts(report.evidence)))
    return tables


def note_of_scene(report: Report) -> str:
    """Return a sentence on the errors of an approximation; empty without one."""
    if report.evidence is None or report.evidence.approximation is None:
        return ""
    found = report.evidence.approximation
    left_out = "" if found.taken else "Nothing that would save flops could be left out. "
    slopes = (
        f" Errors of Jacobians are measured at {found.slope_states} of these states, relative to the largest entry of "
        "a row of the derivative by one input; the tolerance does not limit them."
    )
    return (
        f"{left_out}Errors by the tolerance are the largest of {found.states} states within the joints' limits, which "
        "were not used to choose what is left out, relative to the largest value that an entry has there. A mass, a "
        "moment or an inertia of a body includes the parts beyond it that their joints do not feel."
        f"{slopes if found.slopes else ''}"
    )


def note_of_verification(report: Report) -> str:
    """Return a sentence on the comparisons before anything was written, and their largest deviations."""
    checked = report.verification
    values = [x for name, x in checked.deviations.items() if name in report.values]
    others = [x for name, x in checked.deviations.items() if name not in report.values]
    found = f"values by at most {_bound(max(values, default=0.0)):.0e}"
    found += f", derivatives by {_bound(max(others)):.0e}" if others else ""
    left = f" Not compared: {', '.join(f'`{name}`' for name in checked.unchecked)}." if checked.unchecked else ""
    return (
        f"In 50 digits, at {checked.states} random states, functions were compared with the textbook's recursion and "
        "with the geometry of all bodies, and derivatives with differences along a random direction. "
        f"Of their size, they differ: {found}; more than {float(TOLERANCE):.0e} is refused.{left}"
    )


def notes_of_loops(report: Report) -> list[str]:
    """Return sentences on the degrees of freedom, the redundant equations and the assemblies; none without loops."""
    found = report.loops
    if found is None:
        return []
    equations = f"{found.kept} independent equation{'' if found.kept == 1 else 's'}"
    count = f"{found.freedoms} degree{'' if found.freedoms == 1 else 's'}"
    notes = [f"{found.coordinates} coordinates and {equations} leave {count} of freedom."]
    if found.redundant:
        within = f" within {found.distance:.1e} (rad, or of the loop's size)" if found.distance else ""
        notes.append(f"These equations follow from the others{within}: {', '.join(f'`{x}`' for x in found.redundant)}.")
    by = "as the model says" if found.is_chosen else "since they determine the others best; joints with inputs first"
    names = ", ".join(f"`{x}`" for x in found.independent)
    notes.append(
        f"Independent are {names}, {by}. The least singular value of the dependent columns of J is "
        f"{found.regularity:.2g} of the largest one of J."
    )
    for k, pose in enumerate(found.assemblies):
        told = ", ".join(f"{x:.6g}" for x in pose)
        notes.append(f"{'Closed at' if k == 0 else 'With the same independent coordinates, also at'} q = ({told}).")
    return notes


def _bound(deviation: float) -> float:
    """Round up to a power of ten."""
    return float(f"1e{ceil(log10(deviation))}") if deviation else 0.0


def write_json(report: Report) -> str:
    """Write `report.json`, a stable form for comparisons between versions."""
    data: dict[str, object] = {
        "model": report.model,
        "formulations": {name: _entry(cost) for name, cost in report.formulations.items()},
        "setups": {name: _entry(cost) for name, cost in report.setups.items()},
        "folded": {name: _entry(cost) for name, cost in report.folded.items()},
        "kernels": {name: _entry(cost) for name, cost in report.kernels.items()},
        "ways": {name: dict(ways) for name, ways in report.ways.items()},
    }
    checked = report.verification
    data["verification"] = {
        "states": checked.states,
        "tolerance": float(TOLERANCE),
        "deviations": {name: _bound(x) for name, x in checked.deviations.items()},
        "unchecked": list(checked.unchecked),
    }
    if report.loops is not None:
        data["loops"] = {
            "freedoms": report.loops.freedoms,
            "redundant": list(report.loops.redundant),
            **({"distance": report.loops.distance} if report.loops.distance else {}),
            "independent": list(report.loops.independent),
            "regularity": report.loops.regularity,
            "assemblies": [list(pose) for pose in report.loops.assemblies],
        }
    if report.evidence is not None:
        data["scene"] = {"flops": dict(report.evidence.flops), "deviations": dict(report.evidence.deviations)}
        if (approximation := report.evidence.approximation) is not None:
            data["approximation"] = {
                "tolerance": approximation.tolerance,
                "states": approximation.states,
                "errors": dict(approximation.errors),
                "errors_of_jacobians": dict(approximation.slopes),
                "left_out": {
                    taken.cut.name: {"value": taken.cut.value, "error": taken.error, "flops": taken.flops}
                    for taken in approximation.taken
                },
            }
    if report.reductions:
        data["reductions"] = dict(report.reductions)
    return json.dumps(data, indent=2, ensure_ascii=False) + "\n"


def _entry(cost: Cost) -> dict[str, object]:
    return {"flops": cost.flops.model_dump(), "equations": cost.equations}


def write_markdown(report: Report) -> str:
    """Write `report.md`."""
    lines = [f"# What {_plain(report.model)} costs", "", NOTE]
    for section in sections(report):
        lines += ["", f"## {section.title}", "", _line(("", *COLUMNS)), _line(["---", *["---:"] * len(COLUMNS)])]
        lines += [_line((f"`{name}`", *map(str, cost.row))) for costs in section.groups for name, cost in costs.items()]
    if notes := notes_of_loops(report):
        lines += ["", f"## {LOOPS}", "", *(f"- {note}" for note in notes)]
    names = tuple(report.formulations)
    if rows := comparisons(report):
        lines += ["", f"## {COMPARISON}", "", _line(("", *names)), _line(["---", *["---:"] * len(names)])]
        lines += [_line((title, *(str(row[name]) for name in names))) for title, row in rows.items()]
    for title, header, table in tables_of_scene(report):
        lines += ["", f"## {title}", "", _line(header), _line(["---", *["---:"] * (len(header) - 1)])]
        lines += map(_line, table if title == SCENE else [tuple(map(_plain, row)) for row in table])
    lines += ["", note] if (note := note_of_scene(report)) else []
    lines += ["", f"## {VERIFICATION}", "", note_of_verification(report)]
    if report.ways:
        lines += ["", f"## {DIFFERENTIATION}", "", _line(("", *WAYS)), _line(["---", *["---:"] * len(WAYS)])]
        lines += [_line((f"`{name}`", *row)) for name, row in ways_taken(report).items()]
    return "\n".join(lines) + "\n"


def _line(cells: tuple[str, ...] | list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _plain(name: str) -> str:
    """Escape characters of a user's name that have a meaning in Markdown."""
    return "".join(c if c.isalnum() or c in " -." else f"\\{c}" for c in name)
