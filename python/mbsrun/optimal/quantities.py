"""The quantities of a problem as CasADi symbols, and expressions of them as functions that a program calls.

A symbol is known by its name alone: `q_NAME`, `qd_NAME`, `qdd_NAME`, `u_NAME`, `x_SENSOR`, `vx_SENSOR`, `t`, `T`, the
problem's own states, controls and constants. Positions and velocities of sensors are computed by kernels, with their
exact derivatives; results of other functions of the model are expressions in the symbols, which CasADi differentiates.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any

import casadi as ca

from mbsgen.documents import abbreviate, nearest
from mbsgen.manifest import Argument, Manifest
from mbsgen.roles import Role
from mbsrun.kernel import Kernels
from mbsrun.models import Extent, find_folder, is_model
from mbsrun.ocp.evaluation.backends import symbolic
from mbsrun.ocp.problem.problem import Symbolic
from mbsrun.ocp.statement.checks import ProblemError
from mbsrun.quantities import Quantity
from mbsrun.results import UnknownNameError

LONGEST = 60  # characters of the text of an expression
_SYMBOLS = (ca.SX, ca.MX)


class Quantities(Mapping[str, Any]):
    """Symbols by name, as items or as attributes: `s["q_elbow"]` is `s.q_elbow`.

    `s.q`, `s.qd`, `s.qdd` and `s.u` are vectors of all coordinates, velocities, accelerations and inputs, unless the
    problem has these names.
    """

    def __init__(
        self,
        manifest: Manifest,
        known: Mapping[str, Quantity],
        numbers: tuple[str, ...],
        model: Path | None,
        parameters: Mapping[str, float],
        kind: type[Any],
    ) -> None:
        """Make symbols of quantities and of `numbers`; `parameters` are values that replace the model's."""
        self._manifest, self._known, self._model, self._kind = manifest, known, model, kind
        self._parameters = parameters
        self._symbols = {name: kind.sym(name) for name in (*known, *numbers)}

    def __getitem__(self, name: str) -> Any:
        """Return a symbol, (1, 1). Raises UnknownNameError."""
        if name not in self._symbols:
            meant = nearest(name, list(self._symbols))
            remedy = f"did you mean {meant}?" if meant else f"there are {', '.join(self._symbols)}"
            raise UnknownNameError(f"the problem has no quantity {abbreviate(name)}; {remedy}")
        return self._symbols[name]

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        if name in ("q", "qd", "qdd", "u") and name not in self._symbols:
            return self._gather(name)
        try:
            return self[name]
        except UnknownNameError as error:
            raise AttributeError(str(error)) from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._symbols)

    def __len__(self) -> int:
        return len(self._symbols)

    def __repr__(self) -> str:
        return f"Quantities({', '.join(self)})"

    def position(self, sensor: str) -> Any:
        """Return the position of a sensor in the base frame, (3, 1). Raises UnknownNameError."""
        return ca.vertcat(*(self[f"{axis}_{sensor}"] for axis in "xyz"))

    def velocity(self, sensor: str) -> Any:
        """Return the velocity of a sensor in the base frame, (3, 1). Raises UnknownNameError."""
        return ca.vertcat(*(self[f"v{axis}_{sensor}"] for axis in "xyz"))

    def function(self, name: str) -> Mapping[str, Any]:
        """Return the results of a function of the model, by name, as expressions in the symbols.

        `energy` gives kinetic, potential, momentum, ...; `semi` gives M and c. Parameters have the values of the
        problem or of the model; unknowns are symbols. Raises InputError for an unknown function, ProblemError where the
        model is no file.
        """
        if self._model is None:
            finding = "the kernels are given, without the file of their model"
            raise ProblemError(self._manifest.model, [("model", finding, "make the problem of the model's file")])
        if name not in self._found:
            self._found[name] = self._trace(self._model, name)
        return self._found[name]

    @cached_property
    def _found(self) -> dict[str, Mapping[str, Any]]:
        return {}

    def _gather(self, kind: str) -> Any:
        """Return the symbols of a kind as a vector."""
        found = sorted((x.index, name) for name, x in self._known.items() if x.kind == kind)
        return ca.vertcat(*(self._symbols[name] for _, name in found))

    def _trace(self, model: Path, name: str) -> Mapping[str, Any]:
        """Evaluate the generated equations of a function in the symbols."""
        folder = find_folder(model, Extent((name,), 0, targets=("python",))) if is_model(model) else model
        kernels = Kernels(folder)
        described, equations = kernels.describe(name), load_equations(folder, kernels.manifest.prefix)
        given = [self._give(argument, kernels) for argument in described.inputs]
        results = getattr(equations, name)(*given, functions=ca)
        return MappingProxyType({a.name: _shape(a, results[a.name], self._kind) for a in described.outputs})

    def _give(self, argument: Argument, kernels: Kernels) -> list[Any]:
        """Return the entries of an input: symbols of a motion, numbers of parameters."""
        kinds = {Role.COORDINATE: "q", Role.VELOCITY: "qd", Role.ACCELERATION: "qdd", Role.FORCE: "u"}
        if argument.role in kinds:
            return list(ca.vertsplit(self._gather(kinds[argument.role])))
        if argument.role is Role.SETUP:
            assert kernels.manifest.setup is not None, "hoisted values come from a kernel"
            values = [self._parameters.get(x.name, x.value) for x in kernels.manifest.parameters]
            (found,) = kernels(kernels.manifest.setup.name, p=values).values()
            return [float(x) for x in found]
        if argument.role is Role.DESIGN:
            design = kernels.manifest.design
            return [self._symbols.get(x.name, self._parameters.get(x.name, x.value)) for x in design]
        finding = f"it takes {argument.name}, which has no symbol"
        raise ProblemError(self._manifest.model, [("function", finding, "take a function of q, qd, qdd and u")])


def load_equations(folder: Path, name: str) -> ModuleType:
    """Import the Python module of a generated folder."""
    specification = importlib.util.spec_from_file_location(name, folder / f"{name}.py")
    assert specification is not None, "a name with .py can be imported"
    assert specification.loader is not None, "a name with .py can be imported"
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def make_functions(name: str, expression: Any, problem: str) -> list[Symbolic]:
    """Write an expression of symbols as functions, one for each entry. Raises ProblemError for anything else."""
    if not isinstance(expression, _SYMBOLS):
        finding = f"found a value of type {type(expression).__name__}"
        raise ProblemError(problem, [(name, finding, "give an expression of symbols of quantities()")])
    entries = [ca.densify(expression)[i] for i in range(expression.numel())]
    numbered = [name] if len(entries) == 1 else [f"{name}_{i + 1}" for i in range(len(entries))]
    return [_make_function(own, entry, problem) for own, entry in zip(numbered, entries, strict=True)]


def _make_function(name: str, expression: Any, problem: str) -> Symbolic:
    symbols = ca.symvar(expression)
    if not symbols or any(x.numel() != 1 for x in symbols):
        finding = "the expression reads vectors" if symbols else "the expression reads no quantity"
        raise ProblemError(problem, [(name, finding, "write it with symbols of quantities()")])
    function = ca.Function("expression", symbols, [expression])
    with suppress(RuntimeError):  # where it calls a function that is no formula
        function = function.expand()
    try:
        code = function.serialize()
        symbolic.differentiate(code)
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1]
        finding = f"CasADi cannot store or differentiate the expression: {reason}"
        raise ProblemError(problem, [(name, finding, "write it without callbacks")]) from None
    text = " ".join(str(expression).split())
    shown = text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
    return Symbolic(name, tuple(x.name() for x in symbols), shown, code)


def _shape(argument: Argument, nonzeros: list[Any], kind: type[Any]) -> Any:
    """Return a result as a matrix."""
    values = ca.vertcat(*(kind(x) for x in nonzeros))
    if argument.row is None or argument.colind is None:
        return ca.reshape(values, argument.rows, argument.cols)
    return kind(ca.Sparsity(argument.rows, argument.cols, list(argument.colind), list(argument.row)), values)
