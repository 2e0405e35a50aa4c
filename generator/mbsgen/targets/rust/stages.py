"""The functions of a kernel in Rust: one for a tape; of stages, one for each tape, and one that calls them.

A long tape has parts, which are functions too: each `let` opens a scope inside the one before, and the compiler
overflows its stack in thousands of them.

Each returns a tuple of arrays, or the status. For each kind of stage one rule writes the lines; `templates/rust/stages`
holds the functions that they call.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mbsgen.procedure.newton import Newton
from mbsgen.procedure.patterns import General, Pattern, Symmetric, Tree
from mbsgen.procedure.procedure import Computation
from mbsgen.procedure.repeat import Repeat
from mbsgen.procedure.solve import Factor, Solve
from mbsgen.procedure.stages import Stage
from mbsgen.procedure.straight import Straight
from mbsgen.procedure.wires import Wire
from mbsgen.tape.types import FUNCTIONS, Op, Tape
from mbsgen.targets.parts import Line, Part, Store, Words, divide, order_lines
from mbsgen.targets.statements import Body, Check, Statement, Syntax, Turns, wrap, write_body

KEYWORDS = re.compile(
    "abstract|as|async|await|become|box|break|const|continue|crate|do|dyn|else|enum|extern|false|final|fn|for|gen|if|"
    "impl|in|let|loop|macro|match|mod|move|mut|override|priv|pub|ref|return|self|Self|static|struct|super|trait|true|try|"
    "type|typeof|union|unsafe|unsized|use|virtual|where|while|yield"
)
# Keywords, and names of the prelude that a pattern would refer to, cannot name variables.
RUST = Syntax(
    "{}",
    {op: f"math::{op.value[0]}" for op in FUNCTIONS} | {Op.ABS: "math::abs"},
    re.compile(f"{KEYWORDS.pattern}|None|Some|Ok|Err|math|stages|compute|kept"),
    turns=True,
)
_KINDS: Mapping[type[Pattern], str] = {Tree: "tree", Symmetric: "symmetric", General: "general"}
_WIDTH = 112
_LET = "let "
_WORDS = Words(f"{_LET}{{name}}", "kept[{place}]")


@dataclass(frozen=True)
class Function:
    """A function, ready to be laid out."""

    name: str
    arguments: tuple[tuple[str, str], ...]  # name, type
    returned: str
    lines: tuple[str, ...]
    is_part: bool = False


def name_type(size: int) -> str:
    """Name the type of an array."""
    return f"[math::Real; {size}]"


def write_functions(function: Computation) -> tuple[Function, ...]:
    """Write the functions of a kernel; the last one, `compute`, is the kernel."""
    if isinstance(function, Tape):
        return _write_tape(function, "compute")
    parts: list[Function] = []
    lines: list[str] = []
    given = frozenset(wire.name for wire in function.inputs)
    for stage in function.stages:
        parts += [written for tape in stage.tapes for written in _write_tape(tape, f"_{stage.name}")]
        assert type(stage) in RULES, f"no rule writes {type(stage).__name__} in Rust"
        lines += RULES[type(stage)](stage, given)
    outputs = [wire for wire in function.outputs if wire.sparsity.nnz]
    lines.append(f"Ok({_tuple(f'*{w.name}' if w.name in given else w.name for w in outputs)})")
    whole = Function("compute", _list_arguments(function), _name_results(function), _break(lines))
    return (*parts, whole)


def _list_arguments(function: Computation) -> tuple[tuple[str, str], ...]:
    return tuple((i.name, f"&{name_type(i.sparsity.nnz)}") for i in function.inputs if i.sparsity.nnz)


def _name_results(function: Computation) -> str:
    return f"Result<{_tuple(name_type(o.sparsity.nnz) for o in function.outputs if o.sparsity.nnz)}, u32>"


def _tuple(entries: Iterable[str]) -> str:
    return f"({''.join(f'{entry}, ' for entry in entries)})"


def _table(numbers: Iterable[int]) -> str:
    return f"&[{', '.join(map(str, numbers))}]"


def _break(lines: Iterable[str]) -> tuple[str, ...]:
    """Break long lines where they have spaces."""
    found: list[str] = []
    for line in lines:
        indent = line[: len(line) - len(line.lstrip())]
        found += textwrap.wrap(
            line, _WIDTH, subsequent_indent=f"{indent}    ", break_long_words=False, break_on_hyphens=False
        )
    return tuple(found)


# -- tapes ----------------------------------------------------------------------------------------------------------


def _write_tape(tape: Tape, name: str) -> tuple[Function, ...]:
    """Write the function of a tape, after its parts if it is long."""
    body = write_body(tape, RUST)
    inputs = dict(_list_arguments(tape))
    divided = divide(body, tuple(inputs), f"{name.removeprefix('_')}_part", words=_WORDS)
    if len(divided.parts) > 1:
        kept = name_type(len(divided.kept))
        sizes = {o.name: name_type(o.sparsity.nnz) for o in tape.outputs}
        parts = tuple(_write_part(part, inputs, sizes, kept) for part in divided.parts)
        lines = [f"let mut kept = [0.0; {len(divided.kept)}];"] * bool(divided.kept)
        lines += [f"let mut {result.name} = [0.0; {len(result.statements)}];" for result in body.results]
        lines += [_call_part(part) for part in divided.parts]
        lines.append(f"Ok({_tuple(result.name for result in body.results)})")
    else:
        parts, lines = (), _write_whole(body)
    return (*parts, Function(name, tuple(inputs.items()), _name_results(tape), _break(lines)))


def _write_whole(body: Body) -> list[str]:
    lines = [text for line in order_lines(body) for text in _write_line(line)]
    lines.append("Ok((")
    for result in body.results:  # nonzeros in their order, not in the order in which they are known
        expressions = wrap(statement.expression for statement in result.statements)
        lines += ["    [", *(f"        {line}" for line in expressions), "    ],"]
    return [*lines, "))"]


def _write_line(line: Line) -> list[str]:
    match line:
        case Statement():
            return [f"let {line.target} = {line.expression};"]
        case Turns():
            return [
                f"let ({turn.sine or '_'}, {turn.cosine or '_'}) = math::sincos({turn.angle});" for turn in line.turns
            ]
        case Check():
            return [
                f"if !({line.value} > math::threshold({line.tolerance}) * {line.scale}) {{",
                f"    return Err({line.joint});",
                "}",
            ]
        case Store():  # the last expression of the function
            return []


def _write_part(part: Part, inputs: Mapping[str, str], sizes: Mapping[str, str], kept: str) -> Function:
    """Write a part, which stores results and kept values in arrays of its caller."""
    arguments = [(name, inputs[name]) for name in part.inputs]
    arguments += [("kept", f"&mut {kept}")] * part.keeps
    arguments += [(name, f"&mut {sizes[name]}") for name in part.results]
    lines = [text for line in part.lines for text in _write_line_of_part(line)]
    return Function(part.name, tuple(arguments), "Result<(), u32>", _break([*lines, "Ok(())"]), is_part=True)


def _write_line_of_part(line: Line) -> list[str]:
    """Write a line whose targets are declared or kept."""
    match line:
        case Statement() | Store():
            return [f"{line.target} = {line.expression};"]
        case Turns():
            return [
                text for turn in line.turns for text in _write_turn(turn.sine or "_", turn.cosine or "_", turn.angle)
            ]
        case Check():
            return _write_line(line)


def _write_turn(sine: str, cosine: str, angle: str) -> list[str]:
    """Write a sine and a cosine; one is declared by a statement apart where the other is kept."""
    lets = [name for name in (sine, cosine) if name.startswith(_LET)]
    if len(lets) + [sine, cosine].count("_") == 2:
        return [f"let ({sine.removeprefix(_LET)}, {cosine.removeprefix(_LET)}) = math::sincos({angle});"]
    pair = f"({sine.removeprefix(_LET)}, {cosine.removeprefix(_LET)}) = math::sincos({angle});"
    return [*(f"{name};" for name in lets), pair]


def _call_part(part: Part) -> str:
    arguments = [*part.inputs, *(["&mut kept"] * part.keeps), *(f"&mut {name}" for name in part.results)]
    return f"{part.name}({', '.join(arguments)})?;"


# -- stages ---------------------------------------------------------------------------------------------------------


def _refer(name: str, given: frozenset[str]) -> str:
    """Write a reference to an array; the kernel's own arguments are references."""
    return name if name in given else f"&{name}"


def _call(tape: Tape, function: str, named: Mapping[str, str]) -> str:
    """Write a call, and the assignment of its results to the names of the outputs."""
    arguments = ", ".join(named[i.name] for i in tape.inputs if i.sparsity.nnz)
    results = _tuple(f"mut {o.name}" for o in tape.outputs if o.sparsity.nnz)
    return f"let {results} = {function}({arguments})?;"


def _write_straight(stage: Straight, given: frozenset[str]) -> list[str]:
    named = {i.name: _refer(i.name, given) for i in stage.tape.inputs}
    return [_call(stage.tape, f"_{stage.name}", named)]


def _factorise(stage: Factor, factors: Sequence[str], matrix: str, indent: str = "") -> list[str]:
    """Write the lines that lay a matrix out and factorise it."""
    pattern, n, full = stage.pattern, stage.pattern.size, f"{stage.name}_full"
    places = _table(r * n + c for r, c in stage.matrix.sparsity.entries)
    spread = f"spread_symmetric({n}, " if pattern.is_symmetric else "spread("
    threshold = f"math::threshold({stage.tolerance!r})"
    lines = [
        f"let mut {full} = [0.0; {n * n}];",
        f"stages::{spread}{places}, {matrix}, &mut {full});",
        f"let mut {stage.name}_scales = [0.0; {n}];",
    ]
    first, second = factors
    if isinstance(pattern, Tree):
        lines += [f"let mut {first} = [0.0; {pattern.starts[-1]}];", f"let mut {second} = [0.0; {n}];"]
        tables, results = f", {_list_tables(pattern)}", f"&mut {first}, &mut {second}"
    else:
        lines.append(f"let mut {second} = [0_i32; {n}];")
        tables, results = "", f"&mut {second}"
    call = (
        f"stages::factorise_{_KINDS[type(pattern)]}({n}{tables}, {threshold}, &mut {full}, &mut {stage.name}_scales, "
    )
    lines += [f"if !{call}{results}) {{", f"    return Err({stage.status});", "}"]
    if not isinstance(pattern, Tree):
        lines.append(f"let {first} = {full};")
    return [f"{indent}{line}" for line in lines]


def _list_tables(pattern: Tree) -> str:
    return f"{_table(pattern.starts)}, {_table(i for row in pattern.ancestors for i in row)}"


def _write_factor(stage: Factor, given: frozenset[str]) -> list[str]:
    return _factorise(stage, [wire.name for wire in stage.gives], _refer(stage.matrix.name, given))


def _solve(stage: Solve, factors: Sequence[str], rows: str) -> str:
    pattern = stage.pattern
    tables = f"{_list_tables(pattern)}, " if isinstance(pattern, Tree) else ""
    kind = "transposed" if stage.transposed and not pattern.is_symmetric else _KINDS[type(pattern)]
    return f"stages::solve_{kind}({pattern.size}, {tables}&{factors[0]}, &{factors[1]}, {stage.width}, &mut {rows});"


def _write_solve(stage: Solve, given: frozenset[str]) -> list[str]:
    n, rows, right = stage.pattern.size, f"{stage.name}_rows", stage.right
    lines = [f"let mut {rows} = [0.0; {n * stage.width}];"]
    if right.sparsity.nnz:
        lines.append(f"stages::spread({_table(right.places)}, {_refer(right.name, given)}, &mut {rows});")
    lines.append(_solve(stage, [wire.name for wire in stage.factors], rows))
    sign = "-1.0" if stage.negated else "1.0"
    for block in stage.blocks:
        result = block.result
        if result.sparsity.nnz:
            places = _table(r * stage.width + c for r, c in block.entries(n))
            lines.append(f"let mut {result.name} = [0.0; {result.sparsity.nnz}];")
            lines.append(f"stages::take({places}, {sign}, &{rows}, &mut {result.name});")
    return lines


def _write_newton(stage: Newton, given: frozenset[str]) -> list[str]:
    unknown, solution, own = stage.unknown, stage.solution.name, stage.name
    residual, jacobian = (o.name for o in stage.residual.outputs)
    named = {i.name: _refer(i.name, given) for i in stage.residual.inputs} | {unknown: f"&{solution}"}
    inner = Factor(own, stage.jacobian, stage.pattern, stage.status, stage.tolerance)
    factors = [wire.name for wire in inner.gives]
    right = Wire(residual, stage.solution.sparsity)
    solve = Solve(own, stage.pattern, inner.gives, Wire(residual, _turn(right)), ())
    start = f"*{stage.start.name}" if stage.start.name in given else stage.start.name
    return [
        f"let mut {solution} = {start};",
        f"let mut {own}_before = 0.0;",
        f"let mut {own}_is_done = false;",
        f"for {own}_k in 0..{stage.iterations} {{",
        f"    {_call(stage.residual, f'_{own}', named)}",
        *_factorise(inner, factors, f"&{jacobian}", "    "),
        f"    stages::negate(&mut {residual});",
        f"    {_solve(solve, factors, residual)}",
        f"    let ({own}_is_short, {own}_size) = stages::step(&{residual}, &mut {solution});",
        f"    if {own}_is_short && ({own}_k == 0 || 10.0 * {own}_size <= {own}_before) {{",
        f"        {own}_is_done = true;",
        "        break;",
        "    }",
        f"    {own}_before = {own}_size;",
        "}",
        f"if !{own}_is_done {{",
        f"    return Err({stage.status});",
        "}",
    ]


def _turn(wire: Wire) -> Any:
    """Return the pattern of a column as a row."""
    return type(wire.sparsity).dense(1, wire.sparsity.rows)


def _write_repeat(stage: Repeat, given: frozenset[str]) -> list[str]:
    gathered = {gather.input: gather for gather in stage.gathers}
    gives = [o for o in stage.tape.outputs if o.sparsity.nnz]
    results = {o.name: f"{o.name}_all" for o in gives}
    lines = [f"let mut {results[o.name]} = [0.0; {o.sparsity.nnz * stage.times}];" for o in gives]
    lines.append(f"for {stage.name}_i in 0..{stage.times} {{")
    named = {}
    for i in stage.tape.inputs:
        named[i.name] = _refer(i.name, given)
        if i.name in gathered and i.sparsity.nnz:
            gather = gathered[i.name]
            places = _table(k for row in gather.places for k in row)
            source = _refer(gather.source.name, given)
            named[i.name] = f"&{stage.name}_{i.name}"
            lines.append(
                f"    let {stage.name}_{i.name}: {name_type(i.sparsity.nnz)} = "
                f"stages::gather({places}, {stage.name}_i, {source});"
            )
    lines.append(f"    {_call(stage.tape, f'_{stage.name}', named)}".replace("(mut ", "(").replace(", mut ", ", "))
    lines += [f"    stages::put({stage.name}_i, &{o.name}, &mut {results[o.name]});" for o in gives]
    return [*lines, "}", *(f"let {name} = {whole};" for name, whole in results.items())]


RULES: Mapping[type[Stage], Callable[[Any, frozenset[str]], list[str]]] = {
    Straight: _write_straight,
    Factor: _write_factor,
    Solve: _write_solve,
    Newton: _write_newton,
    Repeat: _write_repeat,
}
