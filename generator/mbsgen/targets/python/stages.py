"""The stages of a kernel in Python: for each kind one rule, which writes its lines.

Straight stages are separate functions. Systems are solved, and iterations done, by the functions of
`procedure.elimination`, which the module contains unchanged.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mbsgen.procedure import elimination
from mbsgen.procedure.newton import Newton
from mbsgen.procedure.patterns import General, Pattern, Symmetric, Tree
from mbsgen.procedure.procedure import Procedure
from mbsgen.procedure.repeat import Repeat
from mbsgen.procedure.solve import Factor, Solve
from mbsgen.procedure.stages import Stage
from mbsgen.procedure.straight import Straight
from mbsgen.procedure.wires import Wire
from mbsgen.tape.types import Tape

_KINDS: Mapping[type[Pattern], str] = {Tree: "tree", Symmetric: "symmetric", General: "general"}
_LINE = 116


@dataclass(frozen=True)
class Part:
    """A tape as a separate function."""

    name: str
    tape: Tape


@dataclass(frozen=True)
class Written:
    """The stages of a kernel: functions before its own, and the lines of that."""

    parts: tuple[Part, ...]
    lines: tuple[str, ...]


def write_stages(procedure: Procedure) -> Written:
    """Write the stages of a procedure. The names of a kernel's functions begin with the kernel's."""
    parts: list[Part] = []
    lines: list[str] = []
    for stage in procedure.stages:
        name = f"_{procedure.name}__{stage.name}"
        parts += [Part(name, tape) for tape in stage.tapes]
        assert type(stage) in RULES, f"no rule writes {type(stage).__name__} in Python"
        lines += RULES[type(stage)](stage, name)
    results = [wire.name for wire in procedure.outputs if wire.sparsity.nnz]
    lines += ["return {", *(f'    "{name}": list({name}),' for name in results), "}"]
    return Written(tuple(parts), tuple(line for long in lines for line in _break(long)))


def list_functions() -> str:
    """Return the source of the functions that stages call, under separate names."""
    functions = [f for _, f in inspect.getmembers(elimination, inspect.isfunction)]
    own = [f for f in functions if f.__module__ == elimination.__name__]
    own.sort(key=lambda f: f.__code__.co_firstlineno)
    text = "\n\n".join(inspect.getsource(f) for f in own)
    names = "|".join(f.__name__ for f in own if not f.__name__.startswith("_"))
    return re.sub(rf"\b({names})\(", r"_\1(", text).rstrip()


def _break(line: str) -> list[str]:
    """Break a long line after commas."""
    indent = " " * (len(line) - len(line.lstrip()))
    lines = []
    while len(line) > _LINE and (place := line.rfind(", ", len(indent) + 4, _LINE)) > 0:
        lines.append(line[: place + 1])
        line = f"{indent}    {line[place + 2 :]}"
    return [*lines, line]


def _write_tuple(entries: Iterable[object]) -> str:
    texts = list(map(str, entries))
    return f"({texts[0]},)" if len(texts) == 1 else f"({', '.join(texts)})"


def _call(name: str, tape: Tape) -> str:
    return f"{name}({', '.join([*(i.name for i in tape.inputs), 'functions'])})"


def _write_straight(stage: Straight, name: str) -> list[str]:
    lines = [f"_found = {_call(name, stage.tape)}"]
    return lines + [f'{wire.name} = _found["{wire.name}"]' for wire in stage.gives if wire.sparsity.nnz]


def _lay_out(wire: Wire, rows: int, cols: int, places: Sequence[tuple[int, int]], *, both: bool = False) -> str:
    values = wire.name if wire.sparsity.nnz else "[]"
    return f"_lay_out({rows}, {cols}, {_write_tuple(places)}, {values}, {both})"


def _factorise(pattern: Pattern, tolerance: float, full: str) -> str:
    """Write the call that gives the factors, by rows, and the row that fails."""
    tree = f"{_write_tuple(pattern.ancestors)}, " if isinstance(pattern, Tree) else ""
    return f"_factorise_{_KINDS[type(pattern)]}({full}, {tree}_threshold({tolerance!r}, functions))"


def _write_factor(stage: Factor, _: str) -> list[str]:
    n, matrix = stage.pattern.size, stage.matrix
    full = _lay_out(matrix, n, n, matrix.sparsity.entries, both=stage.pattern.is_symmetric)
    first, second = (wire.name for wire in stage.gives)
    return [
        f"{stage.name}_full = {full}",
        f"{first}, {second}, _failed = {_factorise(stage.pattern, stage.tolerance, f'{stage.name}_full')}",
        f'_refuse(_failed, {stage.status}, "a pivot of {stage.matrix.name} is lost in rounding")',
        f"{first} = [x for row in {first} for x in row]",
    ]


def _solve(pattern: Pattern, factors: Sequence[str], rows: str, *, transposed: bool = False) -> str:
    """Write the call that puts the solution in the place of the rows."""
    if isinstance(pattern, Tree):
        sizes = _write_tuple(map(len, pattern.ancestors))
        return f"_solve_tree({_write_tuple(pattern.ancestors)}, _nest({factors[0]}, {sizes}), {factors[1]}, {rows})"
    kind = "transposed" if transposed and not pattern.is_symmetric else _KINDS[type(pattern)]
    sizes = _write_tuple([pattern.size] * pattern.size)
    return f"_solve_{kind}(_nest({factors[0]}, {sizes}), {factors[1]}, {rows})"


def _write_solve(stage: Solve, _: str) -> list[str]:
    n, rows = stage.pattern.size, f"{stage.name}_rows"
    places = [(r, c) for c, r in stage.right.sparsity.entries]
    lines = [f"{rows} = {_lay_out(stage.right, n, stage.width, places)}"]
    factors = [wire.name if wire.sparsity.nnz else "[]" for wire in stage.factors]
    lines.append(_solve(stage.pattern, factors, rows, transposed=stage.transposed))
    sign = "-" if stage.negated else ""
    return lines + [
        f"{block.result.name} = [{sign}{rows}[r][c] for r, c in {_write_tuple(block.entries(n))}]"
        for block in stage.blocks
        if block.result.sparsity.nnz
    ]


def _write_newton(stage: Newton, name: str) -> list[str]:
    pattern, jacobian = stage.pattern, stage.jacobian
    n, residual = pattern.size, stage.residual.outputs[0].name
    call = _call(name, stage.residual)
    inner = Wire(f'found["{jacobian.name}"]', jacobian.sparsity)
    solve = _solve(pattern, ("[x for row in first for x in row]", "second"), "rows")
    return [
        f"def {stage.name}_step({stage.unknown}):",
        f"    found = {call}",
        f"    full = {_lay_out(inner, n, n, jacobian.sparsity.entries, both=pattern.is_symmetric)}",
        f"    first, second, failed = {_factorise(pattern, stage.tolerance, 'full')}",
        "    if failed:",
        "        return None",
        f'    rows = [[-x] for x in found["{residual}"]]',
        f"    {solve}",
        "    return [row[0] for row in rows]",
        "_limit = functions.sqrt(_epsilon(functions))",
        f"{stage.solution.name}, _converged = "
        f"_iterate({stage.name}_step, {stage.start.name}, _limit, {stage.iterations})",
        f'_refuse(not _converged, {stage.status}, "the iteration {stage.name} does not converge")',
    ]


def _write_repeat(stage: Repeat, name: str) -> list[str]:
    gathered = {gather.input: gather for gather in stage.gathers}
    lines = [f"{stage.name}_{g.input} = {_write_tuple(g.places)}" for g in stage.gathers]
    arguments = [
        f"[{gathered[i.name].source.name}[k] for k in {stage.name}_{i.name}[i]]" if i.name in gathered else i.name
        for i in stage.tape.inputs
    ]
    lines.append(f"_runs = [{name}({', '.join(arguments)}, functions) for i in range({stage.times})]")
    given = [wire.name for wire in stage.gives if wire.sparsity.nnz]
    return lines + [f'{result} = [x for run in _runs for x in run["{result}"]]' for result in given]


RULES: Mapping[type[Stage], Callable[[Any, str], list[str]]] = {
    Straight: _write_straight,
    Factor: _write_factor,
    Solve: _write_solve,
    Newton: _write_newton,
    Repeat: _write_repeat,
}
