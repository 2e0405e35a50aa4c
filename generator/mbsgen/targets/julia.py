"""A Julia module on top of a model's C library: one file, whose functions call the kernels by `ccall`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mbsgen.procedure.wires import Wire
from mbsgen.roles import Role
from mbsgen.tape.types import Input, Output
from mbsgen.targets.contract import Face, faces
from mbsgen.targets.entries import Group
from mbsgen.targets.layout import lay_out
from mbsgen.targets.unit import Unit

_HELD = {Role.SETUP: "model.hidden", Role.DESIGN: "model.design"}  # inputs that the model holds


@dataclass(frozen=True)
class _Result:
    """A result of a function."""

    name: str
    size: int  # of its nonzeros
    value: str  # from the vector of nonzeros
    colptr: tuple[int, ...]  # of a matrix with a pattern, from 1
    rowval: tuple[int, ...]


@dataclass(frozen=True)
class _Kernel:
    """A kernel, ready to be laid out."""

    name: str
    title: str
    notes: tuple[str, ...]
    function: str
    inputs: tuple[str, ...]
    arguments: tuple[str, ...]  # that are passed: inputs, then results
    results: tuple[_Result, ...]


@dataclass(frozen=True)
class _Setup:
    """The function that prepares run-time parameters."""

    name: str
    function: str
    size: int


@dataclass(frozen=True)
class _Names:
    """The names of the entries of one vector, as strings."""

    name: str
    meaning: str
    entries: tuple[str, ...]


def write_julia(unit: Unit) -> Mapping[str, str]:
    """Write the module of a model; return its file, path -> text."""
    found = [
        face
        for family in unit.families
        for face in faces(family, unit.own or unit.prefix)
        if face.family.integer != "int"
    ]
    setup = next((face for face in found if any(o.port.role is Role.SETUP for o in face.tape.outputs)), None)
    text = lay_out(
        "julia/model.jl",
        prefix=unit.prefix,
        variable=f"{unit.prefix.upper()}_LIBRARY",
        version=unit.version,
        model_hash=unit.model_hash,
        parameters=tuple(map(repr, unit.parameters)),
        design=tuple(map(repr, unit.design)),
        setup=None if setup is None else _Setup(setup.kernel, setup.function, setup.tape.outputs[0].sparsity.nnz),
        groups=tuple(map(_name, unit.groups)),
        kernels=[view for face in found if face is not setup and (view := _view(face)).results],
    )
    return {f"{unit.prefix}.jl": text}


def write_string(text: str) -> str:
    """Write a Julia string of any text: printable ASCII unchanged, other characters escaped."""
    kept = (c if " " <= c <= "~" and c not in '"\\$' else f"\\U{ord(c):08x}" for c in text)
    return f'"{"".join(kept)}"'


def _name(group: Group) -> _Names:
    return _Names(group.name, group.meaning, tuple(write_string(entry.name) for entry in group.entries))


def _view(face: Face) -> _Kernel:
    inputs = [i for i in face.tape.inputs if i.sparsity.nnz]
    outputs = [o for o in face.tape.outputs if o.sparsity.nnz]
    own = tuple(i for i in inputs if i.port.role not in _HELD)
    return _Kernel(
        name=face.kernel,
        title=face.family.describe(face.tape),
        notes=tuple(map(_note, (*own, *outputs))),
        function=face.function,
        inputs=tuple(i.name for i in own),
        arguments=(*map(_pass, inputs), *(o.name for o in outputs)),
        results=tuple(_describe(face.kernel, o) for o in outputs),
    )


def _note(argument: Input | Output | Wire) -> str:
    pattern, meaning = argument.sparsity, argument.port.note
    return f"{argument.name} ({pattern.rows} x {pattern.cols})" + (f": {meaning}" if meaning else "")


def _pass(argument: Input | Wire) -> str:
    size, name = argument.sparsity.nnz, argument.name
    held = _HELD.get(argument.port.role)
    return f'as_input({held or name}, {size}, "{name}")'


def _describe(kernel: str, output: Output | Wire) -> _Result:
    pattern, name = output.sparsity, output.name
    if pattern.is_dense:
        value = name if pattern.cols == 1 else f"reshape({name}, {pattern.rows}, {pattern.cols})"
        return _Result(name, pattern.nnz, value, (), ())
    places = f"copy(colptr_{kernel}_{name}), copy(rowval_{kernel}_{name})"
    return _Result(
        name,
        pattern.nnz,
        f"SparseMatrixCSC({pattern.rows}, {pattern.cols}, {places}, {name})",
        tuple(1 + k for k in pattern.colind),
        tuple(1 + k for k in pattern.row),
    )
