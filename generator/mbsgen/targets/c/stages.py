"""The stages of a kernel in C: for each kind one rule, which fills the kind's template.

The wires between stages are local arrays. A stage writes a result where the caller wants it, unless a later stage reads
it or can still fail: then it is a local array as well, and copied at the end. So a kernel that fails writes no result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from itertools import count as count_from
from typing import Any

from mbsgen.procedure.double_double import DoubleDouble
from mbsgen.procedure.newton import Newton
from mbsgen.procedure.patterns import LANES, General, Pattern, Symmetric, Tree
from mbsgen.procedure.procedure import Procedure
from mbsgen.procedure.repeat import Repeat
from mbsgen.procedure.solve import Block, Factor, Solve
from mbsgen.procedure.stages import Stage
from mbsgen.procedure.straight import Straight
from mbsgen.procedure.tree_dynamics import TreeDynamics, TreeMatrix
from mbsgen.procedure.wires import Wire
from mbsgen.roles import name_low
from mbsgen.tape.ordering import arrange
from mbsgen.tape.ports import Port
from mbsgen.tape.types import Sparsity, Tape
from mbsgen.targets.c import double_double as c_double_double
from mbsgen.targets.c.groups import Groups, group_columns
from mbsgen.targets.layout import lay_out
from mbsgen.targets.parts import LENGTH, Line, Part, divide
from mbsgen.targets.statements import Body, C, Check, Turns, wrap, write_body, write_literal

WIRES, COLUMNS, ANGLES, NEWTON = "mbs_wires.h", "mbs_columns.h", "mbs_sincos.h", "mbs_newton.h"
DYNAMICS, SPATIAL, MATRIX = "mbs_dynamics.h", "mbs_spatial.h", "mbs_matrix.h"
_HEADERS: Mapping[type[Pattern], str] = {Tree: "mbs_tree.h", Symmetric: "mbs_symmetric.h", General: "mbs_general.h"}
_FACTORS = "Where the factors of M have their entries, and the results their nonzeros in M^-1 B."
_PLACES = "Where nonzeros stand in full arrays, and what is gathered."

ONE, SEVERAL = "#ifndef MBS_STATES", "#ifdef MBS_STATES"  # around tables that kernels for one state, or several, need

LONGEST = 108  # characters of a line of C


@dataclass(frozen=True)
class CFunction:
    """A function that computes a part of a kernel: its parameters, how it is called, its lines."""

    name: str
    parameters: tuple[str, ...]
    arguments: tuple[str, ...]
    lines: tuple[str, ...]


@dataclass(frozen=True)
class Functions:
    """A tape as functions, to be called in turn."""

    values: str  # the type of the struct of kept values
    keeper: str  # the variable that holds them
    kept: tuple[str, ...]  # the values that outlive their part, as lines of declarations
    parts: tuple[CFunction, ...]
    number: str = "mbs_real"  # the type of a value


@dataclass(frozen=True)
class Written:
    """The stages of a kernel: what stands before its function and within it, line by line."""

    headers: tuple[str, ...]
    before: tuple[str, ...]  # tables and functions
    has_status: bool  # whether a local variable is needed for it
    has_lanes: bool  # whether it can compute several states at once
    values: str  # the type of the kept values of the body; empty where there are none
    locals: tuple[str, ...]
    unused: tuple[str, ...]  # inputs that nothing reads
    lines: tuple[str, ...]


def write_stages(procedure: Procedure, part: int = LENGTH) -> Written:
    """Write the stages of a procedure; long functions in parts of `part` lines at least."""
    writer = Writer(procedure, part)
    for stage in procedure.stages:
        assert type(stage) in RULES, f"no rule writes {type(stage).__name__} in C"
        writer.declare(stage)
        RULES[type(stage)](writer, stage)
    return writer.finish()


class Writer:
    """A kernel while its stages are written, one after the other."""

    def __init__(self, procedure: Procedure, part: int) -> None:
        self.procedure, self.part = procedure, part
        self.headers: dict[str, None] = {}
        self.tables: dict[str, tuple[str, ...]] = {}
        self.functions: list[str] = []
        self.locals: list[str] = []
        self.lines: list[str] = []
        self.values = ""
        self.has_status = False
        self.has_lanes = True
        self.read: set[str] = set()
        self._trees: dict[Tree, str] = {}
        self._outputs = {wire.name for wire in procedure.outputs}
        self._laid_out = {wire.name for wire in _find_laid_out(procedure)}
        self._forms: dict[str, set[str]] = {}  # of tables
        self._groups = {s.right.name: group_columns(s) for s in procedure.stages if isinstance(s, Solve) and is_wide(s)}
        self._held = _find_held(procedure)

    def name(self, wire: Wire) -> str:
        """Name the array of a wire."""
        return f"mbs_{wire.name}" if wire.name in self._held else wire.name

    def is_laid_out(self, wire: Wire) -> bool:
        """Return whether the array of a wire holds zeros, too."""
        return wire.name in self._laid_out

    def write_targets(self, name: str, pattern: Sparsity) -> list[str]:
        """Write the nonzeros of a wire where the array has them."""
        if name in self._laid_out and name in self._groups:
            place = self._groups[name].place
            return [f"{name}[MBS_EITHER({r + c * pattern.rows}, {place(c, r)})]" for r, c in pattern.entries]
        if name in self._laid_out:
            return [f"{name}[{r + c * pattern.rows}]" for r, c in pattern.entries]
        return [f"{name}[{k}]" for k in range(pattern.nnz)]

    def declare(self, stage: Stage) -> None:
        """Declare the arrays of the results of a stage."""
        own = [w for w in stage.gives if w.name not in self._outputs or w.name in self._held]
        plain = [f"{self.name(w)}[{_size(w)}]" for w in own if not (w.is_whole or self.is_laid_out(w))]
        if plain:
            self.locals.append(f"mbs_real {', '.join(plain)};")
        self.locals += [f"int {self.name(w)}[{_size(w)} * MBS_ABREAST];" for w in own if w.is_whole]
        for w in own:
            if self.is_laid_out(w):
                groups = self.find_groups(w)
                count = f"MBS_EITHER({w.numel}, {groups.numbers})" if groups else str(w.numel)
                self.locals.append(f"{'MBS_ALIGNED ' if groups else ''}mbs_real {w.name}[{count}] = {{0}};")

    def find_groups(self, wire: Wire) -> Groups | None:
        """Find the groups of the columns of right-hand sides, where several are solved for at once."""
        return self._groups.get(wire.name)

    def tabulate(self, name: str, numbers: Iterable[object], form: str = "") -> str:
        """Write a table of whole numbers, and return its name: stages whose wires have one name may need several.

        Kernels of a `form` alone, ONE or SEVERAL, have it where others do not need it.
        """
        table = wrap(map(str, numbers)) or ("0",)  # C has no empty arrays
        names = chain([name], (f"{name}_{k}" for k in count_from(2)))
        found = next(x for x in names if self.tables.setdefault(x, table) == table)
        self._forms.setdefault(found, set()).add(form)
        return found

    def tree(self, pattern: Tree, form: str = "") -> tuple[str, str]:
        """Write the tables of a tree, once."""
        suffix = self._trees.setdefault(pattern, str(len(self._trees) + 1) if self._trees else "")
        starts = self.tabulate(f"mbs_starts{suffix}", pattern.starts, form)
        return starts, self.tabulate(f"mbs_ancestors{suffix}", (i for row in pattern.ancestors for i in row), form)

    def below(self, pattern: Tree, form: str = "") -> tuple[str, str]:
        """Write the tables of the columns of a tree's factor."""
        suffix = self._trees[pattern]
        places = (i for row in pattern.below for pair in row for i in pair)
        starts = self.tabulate(f"mbs_below_starts{suffix}", pattern.below_starts, form)
        return starts, self.tabulate(f"mbs_below{suffix}", places, form)

    def call(self, function: str, arguments: Iterable[str]) -> None:
        """Call a function that may fail."""
        self.has_status = True
        self.lines += [f"if ((mbs_status = {function}({', '.join(arguments)})) != 0)", "    return mbs_status;"]

    def write_tape(self, tape: Tape, name: str) -> Functions:
        """Write a tape as functions; their arguments have the names of the tape's own."""
        body = write_body(arrange(tape), replace(C, nonzeros=self.write_targets))
        return self.divide(tape, body, name, f"{name}_values", f"{name}_kept")

    def divide(self, tape: Tape, body: Body, name: str, values: str, keeper: str) -> Functions:
        """Divide a body in functions of bounded length."""
        if any(isinstance(s, Turns) for s in body.statements):
            self.headers[ANGLES] = None
        divided = divide(body, [i.name for i in tape.inputs], name, self.part)
        parts = tuple(_write_function(part, values) for part in divided.parts)
        return Functions(values, keeper, wrap(divided.kept), parts)

    def finish(self) -> Written:
        """Copy the results that were held back, and gather what is written."""
        given = {wire.name: wire for stage in self.procedure.stages for wire in stage.gives}
        for wire in self.procedure.outputs:
            if wire.sparsity.nnz and (wire.name in self._held or wire.name not in given):
                self.headers[WIRES] = None
                self.lines.append(f"mbs_copy({wire.sparsity.nnz}, {self.name(wire)}, {wire.name});")
        comment = _FACTORS if self._trees else _PLACES
        tables = [f"/* {comment} */"] if self.tables else []
        for form in ("", ONE, SEVERAL):
            tables += self._write_tables(form)
        unused = [w.name for w in self.procedure.inputs if w.sparsity.nnz and w.name not in self.read]
        return Written(
            tuple(sorted(self.headers, key=lambda name: name != ANGLES)),
            (*(["", *tables] if tables else []), *self.functions),
            self.has_status,
            self.has_lanes,
            self.values,
            tuple(self.locals),
            tuple(unused),
            tuple(self.lines),
        )

    def _write_tables(self, form: str) -> list[str]:
        """Write the tables that both forms of the kernel need, or only one."""
        lines = []
        for name, numbers in self.tables.items():
            forms = self._forms[name]
            if form == (next(iter(forms)) if len(forms) == 1 else ""):
                lines += [f"static const int {name}[] = {{", *(f"    {line}" for line in numbers), "};"]
        return [form, *lines, "#endif"] if form and lines else lines


def _render(kind: str, **view: object) -> list[str]:
    """Fill a template."""
    return lay_out(f"c/stages/{kind}", **view).splitlines()


def _size(wire: Wire) -> int:
    return max(1, wire.sparsity.nnz)  # C has no empty arrays


def _find_laid_out(procedure: Procedure) -> list[Wire]:
    """Find the right-hand sides that a straight stage can write where the solution will stand."""
    outputs = {wire.name for wire in procedure.outputs}
    written = {wire.name for s in procedure.stages if isinstance(s, Straight) for wire in s.gives}
    readers = [wire.name for s in procedure.stages for wire in s.reads]
    found = [s.right for s in procedure.stages if isinstance(s, Solve)]
    return [w for w in found if w.name in written - outputs and readers.count(w.name) == 1]


def _find_held(procedure: Procedure) -> set[str]:
    """Find the results that a later stage reads or can prevent; what an iteration or a map gives may still change."""
    held = set()
    outputs = {wire.name for wire in procedure.outputs}
    for k, stage in enumerate(procedure.stages):
        later = procedure.stages[k + 1 :]
        is_early = any(s.can_fail for s in later) or (stage.can_fail and not isinstance(stage, Straight | DoubleDouble))
        read = {wire.name for s in later for wire in s.reads}
        held |= {wire.name for wire in stage.gives if wire.name in outputs and (is_early or wire.name in read)}
    return held


# -- straight stages ------------------------------------------------------------------------------------------------


def _write_straight(writer: Writer, stage: Straight) -> None:
    """Write the only straight stage in the kernel's own function, others as functions of theirs."""
    stages = writer.procedure.stages
    is_alone = stages[0] is stage and not any(isinstance(s, Straight) for s in stages[1:])
    if is_alone:
        _write_body(writer, stage)
        return
    written = writer.write_tape(stage.tape, f"mbs_{stage.name}")
    writer.functions += _render("functions", tape=written)
    if written.kept:
        writer.locals.append(f"{written.values} {written.keeper};")
    named = {wire.name: writer.name(wire) for wire in (*stage.reads, *stage.gives)}
    named["&mbs_kept"] = f"&{written.keeper}"
    for part in written.parts:
        writer.read.update(part.arguments)
        writer.call(part.name, [named[x] for x in part.arguments])


def _write_body(writer: Writer, stage: Straight) -> None:
    tape = _rename(stage.tape, writer)
    body = write_body(arrange(tape), replace(C, nonzeros=writer.write_targets))
    written = writer.divide(tape, body, "mbs_part", "mbs_values", "mbs_kept")
    read = {i.name for i in tape.inputs} - set(body.unused)
    writer.read |= read
    if len(written.parts) == 1:
        writer.lines += written.parts[0].lines
        return
    writer.functions += _render("functions", tape=written)
    writer.values = written.values if written.kept else ""
    for part in written.parts:
        writer.call(part.name, part.arguments)


def _rename(tape: Tape, writer: Writer) -> Tape:
    """Name the arrays that outputs are written to."""
    return replace(
        tape,
        outputs=tuple(replace(o, port=Port(writer.name(Wire.of(o)), o.port.role)) for o in tape.outputs),
    )


def _write_double_double(writer: Writer, stage: DoubleDouble) -> None:
    """Write the only stage of a kernel in double-double arithmetic, in the kernel's own function."""
    assert writer.procedure.stages == (stage,), "a kernel in double-double has one stage"
    writer.headers[c_double_double.HEADER] = None
    writer.has_lanes = False
    divided, unused = c_double_double.divide_tape(stage.tape, "mbs_part", writer.part)
    writer.read |= {part for i in stage.tape.inputs if i.name not in unused for part in (i.name, name_low(i.name))}
    parts = tuple(_write_precise(part) for part in divided.parts)
    if len(parts) == 1:
        writer.lines += parts[0].lines
        return
    written = Functions("mbs_values", "mbs_kept", wrap(divided.kept), parts, c_double_double.NUMBER)
    writer.functions += _render("functions", tape=written)
    writer.values = written.values if written.kept else ""
    for part in written.parts:
        writer.call(part.name, part.arguments)


def _write_precise(part: Part) -> CFunction:
    """Write a part in double-double arithmetic: each result has two parts."""
    results = tuple(x for name in part.results for x in (name, name_low(name)))
    text = tuple(x for line in c_double_double.write_lines(part.lines) for x in break_line(line))
    return replace(_write_function(replace(part, results=results, lines=()), "mbs_values"), lines=text)


def _write_function(part: Part, values: str) -> CFunction:
    return CFunction(
        part.name,
        tuple(f"const mbs_real *MBS_RESTRICT {name}" for name in part.inputs)
        + tuple(f"mbs_real *MBS_RESTRICT {name}" for name in part.results)
        + (f"{values} *MBS_RESTRICT mbs_kept",) * part.keeps,
        (*part.inputs, *part.results, *("&mbs_kept",) * part.keeps),
        _write_lines(part.lines),
    )


def _write_lines(lines: Sequence[Line]) -> tuple[str, ...]:
    text: list[str] = []
    suffixes = map(str, count_from(1))
    for line in lines:
        match line:
            case Turns():
                text += _write_turns(line, next(suffixes))
            case Check():
                text.append(f"if (!MBS_EXCEEDS({line.value}, MBS_THRESHOLD({line.tolerance}) * {line.scale}))")
                text.append(f"    return {line.joint};")
            case _:
                text += break_line(f"{line.target} = {line.expression};")
    return tuple(text)


def break_line(line: str) -> list[str]:
    """Break a long line where it has spaces, as `textwrap` does, which takes far longer."""
    lines, indent = [], ""
    while len(indent) + len(line) > LONGEST:
        place = line.rfind(" ", 0, LONGEST - len(indent) + 1)
        place = place if place > 0 else line.find(" ")
        if place < 0:  # a word that is longer
            break
        lines.append(indent + line[:place])
        line, indent = line[place + 1 :], "    "
    return [*lines, indent + line]


def _write_turns(turns: Turns, suffix: str) -> list[str]:
    angles, sines, cosines = (f"mbs_{kind}{suffix}" for kind in ("angles", "sines", "cosines"))
    count = len(turns.turns)
    text = [f"const mbs_real {angles}[MBS_PADDED({count})] = {{"]
    text += [f"    {line}" for line in wrap(turn.angle for turn in turns.turns)]
    text += ["};", f"mbs_real {sines}[MBS_PADDED({count})], {cosines}[MBS_PADDED({count})];"]
    text.append(f"mbs_sincos({count}, {angles}, {sines}, {cosines});")
    for k, turn in enumerate(turns.turns):
        text += [f"{name} = {of}[{k}];" for name, of in ((turn.sine, sines), (turn.cosine, cosines)) if name]
    return text


# -- linear systems -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _System:
    """How a pattern's functions in C are called."""

    kind: str
    tables: tuple[str, ...]
    factors: tuple[str, ...]
    full: str  # where the full matrix is laid out
    locals: tuple[str, ...] = field(default=())


def _describe(writer: Writer, pattern: Pattern, factors: Sequence[str], name: str, form: str = "") -> _System:
    kind, n = type(pattern).__name__.lower(), pattern.size
    scales = f"mbs_real {name}_scales[{n}];"
    if isinstance(pattern, Tree):
        full = f"{name}_full"
        return _System(kind, writer.tree(pattern, form), tuple(factors), full, (f"mbs_real {full}[{n * n}];", scales))
    return _System(kind, (), tuple(factors), factors[0], (scales,))


def _write_factorise(writer: Writer, stage: Factor, factors: Sequence[str], matrix: str) -> tuple[list[str], list[str]]:
    """Return the declarations and the lines that lay a matrix out and factorise it."""
    pattern, n = stage.pattern, stage.pattern.size
    writer.headers |= {WIRES: None, _HEADERS[type(pattern)]: None}
    system = _describe(writer, pattern, factors, stage.name)
    threshold = f"MBS_THRESHOLD({write_literal(stage.tolerance)})"
    results = system.factors if isinstance(pattern, Tree) else system.factors[1:]
    places = writer.tabulate(f"mbs_places_{stage.matrix.name}", (r * n + c for r, c in stage.matrix.sparsity.entries))
    lines = _render(
        "factor",
        pattern=system.kind,
        symmetric=pattern.is_symmetric,
        count=stage.matrix.sparsity.nnz,
        places=places,
        matrix=matrix,
        size=n,
        full=system.full,
        arguments=(n, *system.tables, threshold, system.full, f"{stage.name}_scales", *results),
        status=stage.status,
    )
    return [*system.locals], lines


def _write_factor(writer: Writer, stage: Factor) -> None:
    declared, lines = _write_factorise(writer, stage, [writer.name(w) for w in stage.gives], writer.name(stage.matrix))
    writer.read.add(stage.matrix.name)
    writer.locals += declared
    writer.lines += lines


def is_wide(stage: Solve) -> bool:
    """Return whether several columns are computed at once."""
    return isinstance(stage.pattern, Tree) and stage.width % LANES == 0 and stage.negated


def _call_solve(writer: Writer, stage: Solve, factors: Sequence[str], rows: str) -> tuple[str, tuple[object, ...]]:
    """Return the function that solves, and its arguments."""
    wide, turned = is_wide(stage), stage.transposed and not stage.pattern.is_symmetric
    form = ONE if wide else ""
    system = _describe(writer, stage.pattern, factors, stage.name, form)
    writer.headers |= {COLUMNS if wide else _HEADERS[type(stage.pattern)]: None}
    function = "columns" if wide else "transposed" if turned else system.kind
    below = writer.below(stage.pattern, form) if wide and isinstance(stage.pattern, Tree) else ()
    return f"mbs_solve_{function}", (stage.pattern.size, *system.tables, *below, *system.factors, stage.width, rows)


def _write_solve(writer: Writer, stage: Solve) -> None:
    numbers, right = stage.pattern.size * stage.width, stage.right
    groups = group_columns(stage) if is_wide(stage) else None
    writer.read.update(wire.name for wire in stage.reads)
    rows, places = writer.name(right), ""
    count = f"MBS_EITHER({numbers}, {groups.numbers})" if groups else str(numbers)
    if not writer.is_laid_out(right):
        writer.headers[WIRES] = None
        rows, places = f"{stage.name}_rows", _tabulate_places(writer, stage, groups)
        writer.locals.append(f"{'MBS_ALIGNED ' if groups else ''}mbs_real {rows}[{count}];")
    factors = [writer.name(w) for w in stage.factors]
    function, arguments = _call_solve(writer, stage, factors, rows)
    writer.headers |= {} if groups else {WIRES: None}
    writer.lines += _render(
        "solve",
        function=function,
        arguments=arguments,
        places=places,
        count=right.sparsity.nnz,
        right=writer.name(right),
        rows=rows,
        numbers=count,
        width=stage.width,
        wide=groups is not None,
        sign=-1 if stage.negated else 1,
        blocks=[_take(writer, stage, block) for block in stage.blocks if block.result.sparsity.nnz],
        groups=_call_groups(writer, stage, groups, factors, rows) if groups else (),
        results=[writer.name(wire) for wire in groups.results] if groups else (),
    )


def _tabulate_places(writer: Writer, stage: Solve, groups: Groups | None) -> str:
    """Write where the right-hand sides stand, by the number of states."""
    name, right = f"mbs_places_{stage.right.name}", stage.right
    if groups is None:
        return writer.tabulate(name, right.places)
    one = writer.tabulate(name, right.places, ONE)
    several = writer.tabulate(f"{name}_in_groups", (groups.place(r, c) for c, r in right.sparsity.entries), SEVERAL)
    return f"MBS_EITHER({one}, {several})"


def _call_groups(writer: Writer, stage: Solve, groups: Groups, factors: Sequence[str], rows: str) -> tuple[object, ...]:
    """Return the arguments of the function that solves for several states."""
    steps, of_groups = groups.write()
    tables = (
        writer.tabulate(f"mbs_steps_{stage.right.name}", steps, SEVERAL),
        writer.tabulate(f"mbs_groups_{stage.right.name}", of_groups, SEVERAL),
    )
    return (stage.pattern.size, len(groups.groups), *tables, *factors, rows, "mbs_results")


def _take(writer: Writer, stage: Solve, block: Block) -> dict[str, object]:
    """Describe how a result is taken from the rows of X."""
    pattern, n = block.result.sparsity, stage.pattern.size
    wide = is_wide(stage)
    is_block = wide and pattern.is_dense and pattern.rows == n
    places = (r * stage.width + c - block.first for r, c in block.entries(n))
    return {
        "result": writer.name(block.result),
        "first": block.first,
        "height": pattern.rows,
        "columns": pattern.cols,
        "count": pattern.nnz,
        "places": "" if is_block else writer.tabulate(f"mbs_places_{block.result.name}", places, ONE if wide else ""),
    }


# -- trees by tables ------------------------------------------------------------------------------------------------


def _write_dynamics(writer: Writer, stage: TreeDynamics) -> None:
    writer.headers |= {DYNAMICS: None, COLUMNS: None, SPATIAL: None}
    n, width = stage.size, stage.width
    parents, joints = writer.tabulate("mbs_parents", stage.parents), writer.tabulate("mbs_joints", stage.joints)
    writer.read.update(wire.name for wire in stage.reads)
    writer.locals += [
        f"mbs_body mbs_bodies[{n + 1}];",
        f"mbs_lanes mbs_work[{12 * (n + 1)}];",
        f"MBS_ALIGNED mbs_real mbs_right[{n * width}];",
    ]
    bodies = ", ".join(map(writer.name, (stage.placements, stage.moments, stage.gravity, stage.rates)))
    writer.lines.append(f"mbs_write_bodies({n}, {parents}, {joints}, {bodies}, mbs_bodies);")
    rest, value = writer.name(stage.rest), writer.name(stage.value)
    if stage.accelerations:
        motion = f"{writer.name(stage.accelerations)}, {rest}, mbs_work, mbs_bodies, {value}"
        writer.lines.append(f"mbs_find_residual({n}, {parents}, {motion});")
    else:
        writer.locals.append(f"mbs_free_inertia mbs_free[{n + 1}];")
        writer.locals.append(f"mbs_lanes mbs_column[{n}];")
        own = writer.tabulate("mbs_owned", ("1" if own else "0" for own in stage.owned))
        thresholds = [f"MBS_THRESHOLD({write_literal(x)})" for x in stage.tolerances]
        wires = map(writer.name, (stage.rest, stage.rotors, stage.scales))
        work = ("mbs_free", "mbs_work", "mbs_column", "mbs_bodies")
        writer.call("mbs_find_accelerations", (str(n), parents, own, *thresholds, *wires, *work, value))
    blocks = 3 if stage.accelerations else 2
    writer.lines.append(f"mbs_write_slopes({n}, {parents}, {blocks}, {width}, mbs_bodies, mbs_right);")
    for added in stage.added:
        places = writer.tabulate(f"mbs_places_{added.wire.name}", added.places(width))
        count, numbers = added.wire.sparsity.nnz, writer.name(added.wire)
        writer.lines.append(f"mbs_add_places({count}, {places}, {numbers}, mbs_right);")
    if stage.seeds:
        seeds = writer.name(stage.seeds)
        writer.lines.append(f"mbs_solve_column({n}, {parents}, mbs_bodies, {seeds}, mbs_work, mbs_column);")
    elif not stage.accelerations:
        writer.lines.append(f"mbs_solve_bodies({n}, {parents}, mbs_bodies, {width}, mbs_work, mbs_right);")
    writer.lines += (_give(writer, stage, block) for block in stage.results if block.result.sparsity.nnz)


def _give(writer: Writer, stage: TreeDynamics, block: Block) -> str:
    """Write a result: sums over the rows of B, columns of X, or nonzeros."""
    n, width, pattern, result = stage.size, stage.width, block.result.sparsity, writer.name(block.result)
    if stage.seeds:
        return f"mbs_weigh_columns({n}, {width}, {pattern.nnz}, mbs_right + {block.first}, mbs_column, {result});"
    columns = [c for c in range(pattern.cols) if pattern.colind[c] < pattern.colind[c + 1]]
    if pattern.nnz == n * len(columns):
        table = writer.tabulate(f"mbs_columns_{block.result.name}", (block.first + c for c in columns))
        return f"mbs_give_columns({n}, {len(columns)}, {table}, {width}, mbs_right, {result});"
    places = writer.tabulate(f"mbs_places_{block.result.name}", (r * width + c for r, c in block.entries(n)))
    return f"mbs_give_entries({pattern.nnz}, {places}, mbs_right, {result});"


def _write_matrix(writer: Writer, stage: TreeMatrix) -> None:
    writer.headers |= {MATRIX: None, SPATIAL: None}
    n = len(stage.parents)
    parents, joints = writer.tabulate("mbs_parents", stage.parents), writer.tabulate("mbs_joints", stage.joints)
    writer.read.update(wire.name for wire in stage.reads)
    writer.locals.append(f"mbs_composite mbs_bodies[{n + 1}];")
    given = ", ".join(map(writer.name, stage.reads))
    writer.lines.append(
        f"mbs_write_matrix({n}, {parents}, {joints}, {given}, mbs_bodies, {writer.name(stage.matrix)});"
    )


# -- iterations and maps --------------------------------------------------------------------------------------------


def _write_newton(writer: Writer, stage: Newton) -> None:
    writer.headers[NEWTON] = None
    tape, n = stage.residual, stage.pattern.size
    residual, jacobian = (o.name for o in tape.outputs)
    written = writer.write_tape(tape, f"mbs_{stage.name}_residual")
    inner = Factor("mbs", stage.jacobian, stage.pattern, stage.status, stage.tolerance)
    factors = [wire.name for wire in inner.gives]
    declared, factorise = _write_factorise(writer, inner, factors, jacobian)
    arrays = [
        f"int {w.name}[{_size(w)} * MBS_ABREAST];" if w.is_whole else f"mbs_real {w.name}[{_size(w)}];"
        for w in inner.gives
    ]
    right = Wire(residual, Sparsity.dense(1, n))
    solve, arguments = _call_solve(writer, Solve("mbs", stage.pattern, inner.gives, right, ()), factors, residual)
    wires = [w for w in stage.wires if w.sparsity.nnz]
    writer.functions += _render("functions", tape=written)
    writer.functions += _render(
        "newton",
        name=f"mbs_{stage.name}",
        parameters=(
            *(f"const mbs_real *MBS_RESTRICT {w.name}" for w in wires),
            "const mbs_real *mbs_start",
            f"mbs_real *MBS_RESTRICT {stage.unknown}",
        ),
        residual=residual,
        jacobian=jacobian,
        unknown=stage.unknown,
        size=n,
        count=_size(stage.jacobian),
        locals=(*arrays, *declared, *_keep(written)),
        iterations=stage.iterations,
        calls=_render("calls", tape=written),
        factorise=factorise,
        solve=solve,
        arguments=arguments,
        status=stage.status,
    )
    writer.read.update(wire.name for wire in stage.reads)
    writer.call(f"mbs_{stage.name}", map(writer.name, (*wires, stage.start, stage.solution)))


def _write_repeat(writer: Writer, stage: Repeat) -> None:
    written = writer.write_tape(stage.tape, f"mbs_{stage.name}_once")
    sources = list(dict.fromkeys(gather.source for gather in stage.gathers))
    shared = [w for w in stage.shared if w.sparsity.nnz]
    gives = [w for w in stage.gives if w.sparsity.nnz]
    gathers = [
        {
            "name": gather.input,
            "source": f"mbs_from_{gather.source.name}",
            "count": len(gather.places[0]),
            "places": writer.tabulate(
                f"mbs_gather_{stage.name}_{gather.input}", (k for row in gather.places for k in row)
            ),
        }
        for gather in stage.gathers
    ]
    called = replace(written, parts=tuple(_advance(part, stage) for part in written.parts))
    writer.functions += _render("functions", tape=written)
    writer.functions += _render(
        "repeat",
        name=f"mbs_{stage.name}",
        times=stage.times,
        parameters=(
            *(f"const mbs_real *mbs_from_{w.name}" for w in sources),
            *(f"const mbs_real *{w.name}" for w in shared),
            *(f"mbs_real *MBS_RESTRICT {w.name}" for w in gives),
        ),
        locals=(
            *(
                f"mbs_real {g['name']}[{max(1, len(gather.places[0]))}];"
                for g, gather in zip(gathers, stage.gathers, strict=True)
            ),
            *_keep(written),
        ),
        gathers=gathers,
        calls=_render("calls", tape=called),
    )
    writer.read.update(wire.name for wire in stage.reads)
    writer.call(f"mbs_{stage.name}", map(writer.name, (*sources, *shared, *gives)))


def _advance(part: CFunction, stage: Repeat) -> CFunction:
    """Make a part write its own column."""
    sizes = {o.name: o.sparsity.nnz for o in stage.tape.outputs}
    return replace(part, arguments=tuple(f"{x} + mbs_i * {sizes[x]}" if x in sizes else x for x in part.arguments))


def _keep(written: Functions) -> tuple[str, ...]:
    return (f"{written.values} mbs_kept;",) if written.kept else ()


RULES: Mapping[type[Stage], Callable[[Writer, Any], None]] = {
    Straight: _write_straight,
    DoubleDouble: _write_double_double,
    Factor: _write_factor,
    Solve: _write_solve,
    Newton: _write_newton,
    Repeat: _write_repeat,
    TreeDynamics: _write_dynamics,
    TreeMatrix: _write_matrix,
}
