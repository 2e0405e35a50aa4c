"""A C++ class on top of a model's C: a header whose functions take and return vectors and matrices of known size."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mbsgen import resources
from mbsgen.procedure.wires import Wire
from mbsgen.roles import Role
from mbsgen.tape.types import Input, Output
from mbsgen.targets.contract import Face, faces
from mbsgen.targets.layout import lay_out
from mbsgen.targets.unit import Unit

SHARED = "mbs_model.hpp"  # in csrc
_HELD = {Role.SETUP: "hidden", Role.DESIGN: "design"}  # inputs that the object holds


@dataclass(frozen=True)
class _Result:
    """A result of a function."""

    name: str
    type: str
    place: str  # in the function's local variables
    pattern: str  # the expression for a matrix's pattern; empty for a column


@dataclass(frozen=True)
class _Kernel:
    """A kernel, ready to be laid out."""

    name: str
    title: str
    function: str
    inputs: tuple[Input | Wire, ...]
    results: tuple[_Result, ...]
    arguments: tuple[str, ...]

    @property
    def returned(self) -> str:
        """Return the type of the result, or of all of them."""
        return self.results[0].type if len(self.results) == 1 else f"{self.name}_results"


@dataclass(frozen=True)
class _Setup:
    """The function that prepares run-time parameters."""

    name: str
    function: str
    size: int


def list_headers(prefix: str) -> tuple[str, ...]:
    """List the headers that are installed beside the model's."""
    return (f"{prefix}.hpp", SHARED)


def write_cpp(unit: Unit) -> Mapping[str, str]:
    """Write the header of a model, and the one that it shares with others."""
    found = [face for family in unit.families for face in faces(family, unit.prefix) if face.family.integer != "int"]
    setup = next((face for face in found if any(o.port.role is Role.SETUP for o in face.tape.outputs)), None)
    kernels = [view for face in found if face is not setup and (view := _view(face)).results]
    text = lay_out(
        "cpp/model.hpp",
        prefix=unit.prefix,
        own=unit.own or unit.prefix,
        version=unit.version,
        model_hash=unit.model_hash,
        parameters=len(unit.parameters),
        design=len(unit.design),
        setup=None if setup is None else _Setup(setup.kernel, setup.function, setup.tape.outputs[0].sparsity.nnz),
        kernels=kernels,
    )
    name, shared = list_headers(unit.prefix)
    return {name: text, shared: (resources.folder("csrc") / shared).read_text(encoding="utf-8")}


def _view(face: Face) -> _Kernel:
    inputs = [i for i in face.tape.inputs if i.sparsity.nnz]
    outputs = [o for o in face.tape.outputs if o.sparsity.nnz]
    is_single = len(outputs) == 1
    places = {slot.name: k for k, slot in enumerate(face.outputs)}
    results = tuple(
        _Result(
            o.name,
            _name_type(o),
            "results" if is_single else f"results.{o.name}",
            "" if _is_column(o) else f"{face.symbol}_sparsity_out({places[o.name]})",
        )
        for o in outputs
    )
    arguments = [
        f"{_HELD[i.port.role]}.data()" if i.port.role in _HELD else f'mbs::read<{i.sparsity.nnz}>({i.name}, "{i.name}")'
        for i in inputs
    ]
    arguments += [f"{r.place}{'.nonzeros' if r.pattern else ''}.data()" for r in results]
    return _Kernel(
        name=face.kernel,
        title=face.family.describe(face.tape),
        function=face.function,
        inputs=tuple(i for i in inputs if i.port.role not in _HELD),
        results=results,
        arguments=tuple(arguments),
    )


def _is_column(output: Output | Wire) -> bool:
    return output.sparsity.cols == 1 and output.sparsity.is_dense


def _name_type(output: Output | Wire) -> str:
    pattern = output.sparsity
    if _is_column(output):
        return f"mbs::vector<{pattern.rows}>"
    return f"mbs::matrix<{pattern.rows}, {pattern.cols}, {pattern.nnz}>"
