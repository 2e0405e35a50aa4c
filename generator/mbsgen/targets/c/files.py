"""C sources of a model's kernels: tapes -> a header, one C file per kernel, the ABI header, and the manifest's kernels.

A view holds everything that a template lays out: numbers counted, expressions written, lines broken. A kernel is one C
function with typed arguments, and a second one, in CasADi's contract, that calls it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate

from mbsgen import resources
from mbsgen.manifest import Argument, Flops, Kernel
from mbsgen.procedure.procedure import Computation
from mbsgen.procedure.wires import Wire
from mbsgen.roles import Axis, Role
from mbsgen.tape.types import Input, Output, Sparsity
from mbsgen.targets.c.agreement import compare
from mbsgen.targets.c.stages import Written, write_stages
from mbsgen.targets.c.symbols import OPEN, PRIVATE, find_declared, seal, tag, write_own
from mbsgen.targets.contract import Face, Slot, arguments, faces, name_function, name_symbol
from mbsgen.targets.layout import lay_out
from mbsgen.targets.statements import wrap, write_literal
from mbsgen.targets.unit import Unit

ABI_HEADER = "mbs_abi.h"
# Results that lose digits with the condition of the mass matrix.
_SOLVED = (Role.ACCELERATION, Role.CONDITION, Role.MULTIPLIER, Role.DRIVING_FORCE)
_LARGEST_REFERENCE = 1000  # results of a function; where it has more, the check program holds none of them
_LARGEST_DERIVATIVE = 10_000  # of derivatives likewise
_COPIED = (ABI_HEADER, "mbs_states.h", "mbs_sincos.h", "mbs_check.h")  # from csrc; more where stages need them
# Ends of the names that CasADi's contract adds to a function.
_ENDS = (
    "",
    *(f"_{x}" for x in ["n_in", "n_out", "name_in", "name_out", "sparsity_in", "sparsity_out", "diff_in", "work"]),
)


@dataclass(frozen=True)
class Sources:
    """The written files, and their description in the manifest."""

    files: Mapping[str, str]  # file name -> text; every file of the folder except the manifest and reports
    header: str
    sources: tuple[str, ...]  # the C files of the kernels among them
    kernels: tuple[Kernel, ...]
    own: str  # the prefix of all symbols, with the tag


def write_c(unit: Unit) -> Sources:
    """Write every kernel of `unit` in C, and the files of a library; the same unit gives the same text."""
    found = [face for family in unit.families for face in faces(family, unit.prefix)]
    views = [_view(unit.prefix, face, unit.part) for face in found]
    header = f"{unit.prefix}.h"
    parameters, design = (tuple(write_literal(x) for x in values) for values in (unit.parameters, unit.design))
    common = {
        "prefix": unit.prefix,
        "version": unit.version,
        "model_hash": unit.model_hash,
        "header": header,
        "parameters": parameters,
        "design": design,
        "groups": unit.groups,
        "own": tag(unit.prefix),
        "open": OPEN,
        "private": PRIVATE,
    }
    sources = {view.file: lay_out("c/kernel.c", kernel=view, **common) for view in views}
    if parameters or design:
        sources[f"{unit.prefix}_default_parameters.c"] = lay_out("c/parameters.c", **common)
    if unit.groups:
        sources[f"{unit.prefix}_names.c"] = lay_out("c/names.c", **common)
    copied = dict.fromkeys((*_COPIED, *(name for view in views for name in view.stages.headers)))
    symbols = tuple(_list_symbols(unit, found))
    files = {
        header: lay_out("c/model.h", kernels=views, tolerance=unit.tolerance, loops=unit.has_loops, **common),
        f"{unit.prefix}_symbols.h": lay_out("c/symbols.h", symbols=symbols, **common),
        **{name: _read(name) for name in copied},
        **sources,
        **_write_comparisons(common),
        f"{unit.prefix}_check.c": _write_check(unit, found, common),
        f"{unit.prefix}.pc": lay_out("c/model.pc", **common),
        "CMakeLists.txt": lay_out(
            "c/CMakeLists.txt",
            sources=tuple(sources),
            abi=ABI_HEADER,
            headers=unit.headers,
            widths=unit.widths,
            laned=[view.file for view in views if view.stages.has_lanes],
            **common,
        ),
    }
    files, own = seal(files, unit.prefix)
    return Sources(files, header, tuple(sources), tuple(_describe(unit.prefix, f) for f in found), own)


def _read(name: str) -> str:
    return (resources.folder("csrc") / name).read_text(encoding="utf-8")


def _list_symbols(unit: Unit, found: Sequence[Face]) -> Iterator[tuple[str, str]]:
    """List the names that a program uses, each with the symbol that it stands for."""
    own = tag(unit.prefix)
    for face in found:
        yield face.function, write_own(name_function(own, face.kernel), own)
        symbol = name_symbol(own, face.family, face.tape)
        yield from ((face.symbol + end, write_own(symbol + end, own)) for end in _ENDS)
    others = [f"NAMES_{group.name}" for group in unit.groups]
    others += ["default_parameters"] * bool(unit.parameters) + ["default_design"] * bool(unit.design)
    yield from ((f"{unit.prefix}_{name}", write_own(f"{own}_{name}", own)) for name in others)


def _write_comparisons(common: Mapping[str, object]) -> dict[str, str]:
    """Write the functions that a check calls, with symbols of this folder."""
    text = lay_out("c/private.h", shared=find_declared("mbs", [_read("mbs_check.h")]), macro="MBS_OWN", **common)
    return {PRIVATE: text, "mbs_check.c": f'#include "{PRIVATE}"\n{_read("mbs_check.c")}'}


def _write_check(unit: Unit, found: Sequence[Face], common: Mapping[str, object]) -> str:
    comparisons = compare(unit.families, only_driven=unit.only_driven, has_loops=unit.has_loops)
    solved = {face.kernel for face in found if _is_solved(face.family.value)}
    values = {family.value.name for family in unit.families}
    references = {
        k: v
        for k, v in unit.references.items()
        if 0 < len(v) <= (_LARGEST_REFERENCE if k in values else _LARGEST_DERIVATIVE)
    }
    compared = {kernel for comparison in comparisons for kernel in comparison.kernels} | references.keys()
    known = [
        {"kernel": kernel, "is_solved": kernel in solved, "values": wrap(map(repr, values))}
        for kernel, values in references.items()
    ]
    chosen = [f for f in found if f.kernel in compared]
    return lay_out("c/check.c", faces=chosen, comparisons=comparisons, references=known, **common)


def _is_solved(value: Computation) -> bool:
    """Return whether the results of a function, and its derivatives, come from the solution of equations."""
    reduced = any(Axis.INDEPENDENT in (o.port.rows, o.port.cols) for o in value.outputs)
    return reduced or all(o.port.role in _SOLVED for o in value.outputs)


# -- the manifest's side --------------------------------------------------------------------------------------------


def _describe(prefix: str, face: Face) -> Kernel:
    """Describe a kernel by the arguments of its tape, without the empty arguments that CasADi adds."""
    counts = face.counts
    slots = {slot.name: slot for slot in (*face.inputs, *face.outputs)}
    of = face.tape.function
    return Kernel(
        name=face.kernel,
        base=of.base,
        order=of.order,
        symbol=face.symbol,
        function=face.function,
        sources=(_file(prefix, face),),
        inputs=tuple(_argument(i, slots[i.name].differentiable) for i in face.tape.inputs),
        outputs=tuple(map(_argument, face.tape.outputs)),
        flops=counts.flops,
        equations=counts.equations,
        integer=face.family.integer,
    )


def _file(prefix: str, face: Face) -> str:
    return f"{prefix}_{face.kernel}.c"


def _argument(source: Input | Output | Wire, differentiable: bool = True) -> Argument:
    pattern, port = source.sparsity, source.port
    dense = pattern.is_dense
    return Argument(
        name=port.name,
        role=port.role,
        rows=pattern.rows,
        cols=pattern.cols,
        colind=None if dense else pattern.colind,
        row=None if dense else pattern.row,
        differentiable=differentiable,
        matrix=port.is_matrix,
        unit=port.unit,
        row_axis=port.rows,
        col_axis=port.cols,
        of=port.of.name if port.of else None,
        by=port.by.name if port.by else None,
    )


# -- the template's side --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Parameter:
    """An argument of the typed function."""

    name: str
    declaration: str
    note: str
    macro: str  # the macro for the number of its nonzeros
    nnz: int
    pattern: str  # the macro for their positions; empty for a full vector
    told_by: str  # the function that returns the pattern
    passed: str  # the expression that CasADi's face passes for it


@dataclass(frozen=True)
class _Unwanted:
    """Storage for the nonzeros of a result that the caller does not request."""

    name: str
    place: int


@dataclass(frozen=True)
class _Pattern:
    name: str
    lines: tuple[str, ...]


@dataclass(frozen=True)
class _Table:
    """One side of CasADi's face: the initialisers of its tables, as lines."""

    size: int
    names: tuple[str, ...]
    patterns: tuple[str, ...]
    differentiable: tuple[str, ...]


@dataclass(frozen=True)
class _View:
    """A kernel, ready to be laid out."""

    file: str
    symbol: str
    plain_symbol: str  # with the precision
    own_symbol: str  # with the tag and the precision
    function: str
    plain_function: str
    own_function: str
    integer: str  # the integer type of CasADi's contract
    title: str
    flops: Flops
    equations: int
    parameters: tuple[_Parameter, ...]
    left_out: tuple[str, ...]
    unwanted: tuple[_Unwanted, ...]
    unwanted_size: int
    stages: Written
    zeros: int  # nonzeros of the largest input
    patterns: tuple[_Pattern, ...]
    inputs: _Table
    outputs: _Table


def _view(prefix: str, face: Face, part: int) -> _View:
    counts = face.counts
    outputs = face.procedure.outputs
    unwanted = tuple(accumulate((o.sparsity.nnz for o in outputs), initial=0))
    patterns = _name_patterns(face)
    empty = [a for a in map(_argument, arguments(face.tape)) if not a.nnz]
    own_symbol = write_own(name_symbol(tag(prefix), face.family, face.tape), tag(prefix))
    own_function = write_own(name_function(tag(prefix), face.kernel), tag(prefix))
    return _View(
        file=_file(prefix, face),
        symbol=face.symbol,
        plain_symbol=own_symbol.replace(tag(prefix), prefix),
        own_symbol=own_symbol,
        function=face.function,
        plain_function=own_function.replace(tag(prefix), prefix),
        own_function=own_function,
        integer=face.family.integer,
        title=face.family.describe(face.tape),
        flops=counts.flops,
        equations=counts.equations,
        parameters=_parameters(prefix, face),
        left_out=tuple(f"{a.name}: {a.rows} x {a.cols}, without a nonzero: no argument" for a in empty),
        unwanted=tuple(_Unwanted(o.name, place) for o, place in zip(outputs, unwanted, strict=False) if o.sparsity.nnz),
        unwanted_size=unwanted[-1],
        stages=write_stages(face.procedure, part),
        zeros=max((i.sparsity.nnz for i in face.tape.inputs), default=0),
        patterns=tuple(_Pattern(name, wrap(map(str, _compress(pattern)))) for pattern, name in patterns.items()),
        inputs=_table(face.inputs, patterns),
        outputs=_table(face.outputs, patterns),
    )


def _parameters(prefix: str, face: Face) -> tuple[_Parameter, ...]:
    inputs = {slot.name: k for k, slot in enumerate(face.inputs)}
    outputs = {slot.name: k for k, slot in enumerate(face.outputs)}

    def describe(argument: Input | Output | Wire, way: str, k: int, qualifier: str, passed: str) -> _Parameter:
        name, told_by = argument.name, f"{face.symbol}_sparsity_{way}({k})"
        return _Parameter(
            name,
            f"{qualifier}mbs_real *MBS_RESTRICT {name}",
            _note(way, argument, told_by),
            f"{prefix}_{face.kernel}_NNZ_{name}",
            argument.sparsity.nnz,
            ""
            if argument.sparsity.is_dense and (argument.sparsity.cols == 1 or face.family.integer == "int")
            else f"{prefix}_{face.kernel}_PATTERN_{name}",
            told_by,
            passed,
        )

    return tuple(
        describe(i, "in", inputs[i.name], "const ", f"arg[{inputs[i.name]}] ? arg[{inputs[i.name]}] : zeros")
        for i in face.tape.inputs
        if i.sparsity.nnz
    ) + tuple(
        describe(o, "out", outputs[o.name], "", f"res[{outputs[o.name]}]") for o in face.tape.outputs if o.sparsity.nnz
    )


def _note(way: str, argument: Input | Output | Wire, told_by: str) -> str:
    pattern = argument.sparsity
    nonzeros = "" if pattern.is_dense else f", {pattern.nnz} nonzeros, placed by {told_by}"
    meaning = argument.port.note
    return f"{argument.name} ({way}, {pattern.rows} x {pattern.cols}{nonzeros})" + (f": {meaning}" if meaning else "")


def _name_patterns(face: Face) -> dict[Sparsity, str]:
    different = dict.fromkeys(slot.sparsity for slot in (*face.inputs, *face.outputs))
    return {pattern: f"pattern{k}" for k, pattern in enumerate(different)}


def _compress(pattern: Sparsity) -> tuple[int, ...]:
    """Write a pattern in CasADi's format."""
    if pattern.is_dense:
        return (pattern.rows, pattern.cols, 1)
    return (pattern.rows, pattern.cols, *pattern.colind, *pattern.row)


def _table(slots: Iterable[Slot], patterns: Mapping[Sparsity, str]) -> _Table:
    slots = tuple(slots)
    return _Table(
        len(slots),
        wrap(f'"{slot.name}"' for slot in slots),
        wrap(patterns[slot.sparsity] for slot in slots),
        wrap(str(int(slot.differentiable)) for slot in slots),
    )
