"""A Rust crate of a model's kernels: without C, without other crates, and without the standard library if need be.

The folder `rust` is a package for cargo. `src/kernels` has a file for each kernel; `lib.rs` has a `Model` whose methods
take and return arrays of fixed sizes; `tests` compares with results that were computed in 50 digits.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from mbsgen.manifest import Flops
from mbsgen.procedure.procedure import Computation, count
from mbsgen.procedure.wires import Wire
from mbsgen.roles import Role
from mbsgen.tape.types import Input, Output
from mbsgen.targets.contract import Family
from mbsgen.targets.entries import Group
from mbsgen.targets.layout import lay_out
from mbsgen.targets.rust.stages import KEYWORDS, Function, write_functions
from mbsgen.targets.statements import wrap
from mbsgen.targets.unit import Unit

FOLDER = "rust"
_HELD = {Role.SETUP: "&self.hidden", Role.DESIGN: "&self.design"}  # inputs that the model holds
_SOLVED = (
    Role.ACCELERATION,
    Role.CONDITION,
    Role.MULTIPLIER,
    Role.DRIVING_FORCE,
)  # lose digits with the condition
_MOST = 1000  # numbers of a function that the tests hold


@dataclass(frozen=True)
class _Result:
    """A result of a kernel."""

    name: str
    type: str
    value: str  # of the method, from the kernel's array
    note: str


@dataclass(frozen=True)
class _Argument:
    """An input of a method."""

    name: str
    size: int
    note: str


@dataclass(frozen=True)
class _Kernel:
    """A kernel, ready to be laid out."""

    name: str
    method: str
    title: str
    flops: Flops
    functions: tuple[Function, ...]
    arguments: tuple[_Argument, ...]
    results: tuple[_Result, ...]
    passed: tuple[str, ...]
    patterns: tuple[tuple[str, int, tuple[str, ...]], ...]  # of matrices among the results: name, nonzeros, lines

    @property
    def returned(self) -> str:
        """Return the type of the result, or of all of them."""
        return self.results[0].type if len(self.results) == 1 else f"{self.method}_results"


@dataclass(frozen=True)
class _Setup:
    """The kernel that prepares run-time parameters."""

    method: str
    size: int


@dataclass(frozen=True)
class _Reference:
    """The results of a kernel at the first state of the check, one after the other."""

    kernel: _Kernel
    is_solved: bool
    values: tuple[str, ...]


@dataclass(frozen=True)
class _Names:
    """The entries of one vector."""

    name: str
    meaning: str
    entries: tuple[tuple[str, str], ...]  # identifier, string


def write_rust(unit: Unit) -> Mapping[str, str]:
    """Write the crate of a model; return its files, path -> text."""
    found = [(family, tape) for family in unit.families if family.integer != "int" for tape in family.functions]
    views = {tape.name: _view(family, tape) for family, tape in found}
    setup = next((t for _, t in found if any(o.port.role is Role.SETUP for o in t.outputs)), None)
    kernels = tuple(view for name, view in views.items() if view.results and (setup is None or name != setup.name))
    common: dict[str, object] = {
        "prefix": unit.prefix,
        "version": unit.version,
        "model_hash": unit.model_hash,
        "parameters": tuple(map(repr, unit.parameters)),
        "design": tuple(map(repr, unit.design)),
        "setup": None if setup is None else _Setup(views[setup.name].method, setup.outputs[0].sparsity.nnz),
        "kernels": kernels,
        "has_loops": unit.has_loops,
    }
    files = {
        "Cargo.toml": lay_out("rust/Cargo.toml", **common),
        "src/lib.rs": lay_out("rust/lib.rs", groups=tuple(map(_name, unit.groups)), **common),
        "src/math.rs": lay_out("rust/math.rs"),
        "src/stages.rs": lay_out("rust/stages.rs"),
        "src/kernels.rs": lay_out("rust/kernels.rs", methods=[view.method for view in views.values()]),
        "tests/references.rs": lay_out("rust/references.rs", references=tuple(_list_references(unit, views)), **common),
    }
    for view in views.values():
        files[f"src/kernels/{view.method}.rs"] = lay_out("rust/kernel.rs", kernel=view, **common)
    return {f"{FOLDER}/{name}": text for name, text in files.items()}


def name_item(name: str) -> str:
    """Return a Rust identifier for an identifier of C that ends in no underscore; different ones stay different."""
    if KEYWORDS.fullmatch(name):
        return f"{name}_"
    return f"_{name}" if name[0].isdigit() else name


def write_string(text: str) -> str:
    """Write a Rust string of any text: printable ASCII unchanged, other characters escaped."""
    kept = (c if " " <= c <= "~" and c not in '"\\' else f"\\u{{{ord(c):x}}}" for c in text)
    return f'"{"".join(kept)}"'


def _name(group: Group) -> _Names:
    entries = tuple((name_item(entry.identifier), write_string(entry.name)) for entry in group.entries)
    return _Names(name_item(group.name), group.meaning, entries)


def _view(family: Family, tape: Computation) -> _Kernel:
    inputs = [i for i in tape.inputs if i.sparsity.nnz]
    outputs = [o for o in tape.outputs if o.sparsity.nnz]
    matrices = [o for o in outputs if not _is_column(o)]
    return _Kernel(
        name=tape.name,
        method=name_item(tape.name),
        title=_escape(family.describe(tape)),
        flops=count(tape).flops,
        functions=write_functions(tape),
        arguments=tuple(_Argument(i.name, i.sparsity.nnz, _note(i)) for i in inputs if i.port.role not in _HELD),
        results=tuple(_describe(o) for o in outputs),
        passed=tuple(_HELD.get(i.port.role, i.name) for i in inputs),
        patterns=tuple((o.name, o.sparsity.nnz, wrap(f"({r}, {c})" for r, c in o.sparsity.entries)) for o in matrices),
    )


def _is_column(output: Output | Wire) -> bool:
    return output.sparsity.cols == 1 and output.sparsity.is_dense


def _describe(output: Output | Wire) -> _Result:
    pattern = output.sparsity
    if _is_column(output):
        return _Result(output.name, f"[Real; {pattern.nnz}]", output.name, _note(output))
    value = f"Matrix {{ nonzeros: {output.name}, pattern: &PATTERN_{output.name} }}"
    return _Result(output.name, f"Matrix<{pattern.rows}, {pattern.cols}, {pattern.nnz}>", value, _note(output))


def _note(argument: Input | Output | Wire) -> str:
    pattern, meaning = argument.sparsity, argument.port.note
    nonzeros = "" if pattern.is_dense else f", {pattern.nnz} nonzeros, column by column"
    return _escape(f"{pattern.rows} x {pattern.cols}{nonzeros}" + (f": {meaning}" if meaning else ""))


def _escape(text: str) -> str:
    """Escape the characters that mean more than themselves in a comment for rustdoc."""
    return re.sub(r"([<>\[\]*_`\\])", r"\\\1", text.replace("\n", " "))


def _list_references(unit: Unit, views: Mapping[str, _Kernel]) -> Iterable[_Reference]:
    functions: dict[str, tuple[Computation, Computation]] = {
        tape.name: (family.value, tape) for family in unit.families for tape in family.functions
    }
    for name, values in unit.references.items():
        if name in views and 0 < len(values) <= _MOST and views[name].results:
            solved = any(o.port.role in _SOLVED for o in functions[name][0].outputs)
            yield _Reference(views[name], solved, _wrap(values))


def _wrap(values: Sequence[float]) -> tuple[str, ...]:
    return wrap(map(repr, values))
