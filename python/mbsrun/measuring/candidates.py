"""Ways to compute one function: generated kernels, their differences, and their equations differentiated by CasADi."""

from __future__ import annotations

import importlib.util
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mbsgen.manifest import Kernel
from mbsgen.roles import name_derivative, name_precise
from mbsrun.library import compile_library
from mbsrun.measuring.functions import Code, Numbers, Variant, find_function
from mbsrun.measuring.mechanisms import Subject
from mbsrun.measuring.timing import Watch

Array = NDArray[np.float64]
States = Mapping[str, Array]  # (K, size) by name
Found = tuple[NDArray[np.int64], list[dict[str, Array]]]  # the status of each state, and its results

VARIABLES = ("q", "qd", "yd", "qdd", "ydd", "lam", "tau", "a", "u", "w", "theta")  # of Jacobians
LARGEST = 20_000  # operations of a CasADi function that is compiled: for more, -O3 takes minutes


@dataclass(frozen=True)
class Differences:
    """An approximation of a derivative by differences."""

    step: float  # of each variable: rad or m, and these per s, per s^2; N m or N
    central: bool

    @property
    def label(self) -> str:
        """Return kind and step as text."""
        return f"{'central' if self.central else 'forward'} differences, {self.step:.0e}"


@dataclass(frozen=True)
class Candidate:
    """One compiled way to compute a function."""

    way: str
    code: Code
    variant: Variant
    differences: Differences | None = None  # of the result of the code; None: the code itself computes the function

    def evaluate(self, states: States) -> Found:
        """Return the results: matrices by name, derivatives as `jac_<result>_<input>`."""
        if self.differences is None:
            return self.code.call(self.code.lay(states))
        statuses, results = self.code.call(self._lay_neighbours(states))
        shape = (len(states["q"]), -1)
        failures = statuses.reshape(shape).max(axis=1)
        width = statuses.size // shape[0]
        found = [
            {} if failures[k] else self._subtract(results[k * width : (k + 1) * width], states) for k in range(shape[0])
        ]
        return failures, found

    def watch(self, states: States) -> tuple[Watch, int]:
        """Return a watch, and the number of calls for one result."""
        if self.differences is None:
            return Watch(self.code, self.code.lay(states)), 1
        inputs = self._lay_neighbours(states)
        return Watch(self.code, inputs), len(inputs[0]) // len(states["q"])

    def _variables(self) -> list[str]:
        return [name for name in VARIABLES if name in self.code.inputs]

    def _lay_neighbours(self, states: States) -> list[Numbers]:
        """Return the inputs for the states that are subtracted.

        Central: two for each variable; forward: the state itself, then one for each variable.
        """
        assert self.differences is not None, "called only where differences are taken"
        central, step = self.differences.central, self.differences.step
        variables = self._variables()
        total = sum(states[name].shape[1] for name in variables)
        shifts = np.repeat(np.eye(total), 2, axis=0) * np.tile([step, -step], total)[:, None] if central else None
        shifts = np.vstack((np.zeros(total), step * np.eye(total))) if shifts is None else shifts
        spread = {name: np.repeat(values, len(shifts), axis=0) for name, values in states.items()}
        start = 0
        for name in variables:
            width = states[name].shape[1]
            spread[name] = spread[name] + np.tile(shifts[:, start : start + width], (len(states["q"]), 1))
            start += width
        return self.code.lay(spread)

    def _subtract(self, results: list[dict[str, Array]], states: States) -> dict[str, Array]:
        assert self.differences is not None, "called only where differences are taken"
        step, found = self.differences.step, {}
        for name in results[0]:
            values = np.array([x[name].ravel() for x in results])
            if self.differences.central:
                columns = (values[::2] - values[1::2]) / (2 * step)
            else:
                columns = (values[1:] - values[0]) / step
            start = 0
            for variable in self._variables():
                width = states[variable].shape[1]
                found[name_derivative(name, variable)] = columns[start : start + width].T
                start += width
        return found


def compile_kernel(subject: Subject, name: str, variant: Variant) -> Candidate:
    """Compile a generated kernel, or the one in double-double arithmetic that computes the same."""
    manifest, is_precise = subject.manifest, variant.precision == "double-double"
    kernel = manifest.kernel(name_precise(name) if is_precise else name)
    library = compile_library(subject.folder, manifest.prefix, kernel.sources, variant.compiler())
    symbol = kernel.single_symbol if variant.precision == "float32" else kernel.symbol
    return Candidate(name, Code(find_function(library, symbol), variant.precision), variant)


def difference(subject: Subject, name: str, variant: Variant) -> Iterator[Candidate]:
    """Yield differences of a generated kernel with several steps, of which one is near the best."""
    code = compile_kernel(subject, name, variant).code
    steps = {
        "float64": ((1e-6, 1e-8, 1e-10), (1e-4, 1e-5, 1e-7)),
        "float32": ((1e-2, 1e-3, 1e-4), (1e-1, 1e-2, 1e-3)),
    }[variant.precision]
    for central, lengths in zip((False, True), steps, strict=True):
        for step in lengths:
            taken = Differences(step, central)
            yield Candidate(f"{name}, {taken.label}", code, variant, taken)


def differentiate(subject: Subject, name: str, variant: Variant) -> Candidate | str:
    """Differentiate the equations of a kernel by CasADi, and compile the C; or return the reason against it."""
    kernel = subject.manifest.kernel(name)
    function = trace(load_equations(subject), kernel)
    inputs = function.sx_in()
    names = [x for x in VARIABLES if x in function.name_in()]
    chosen = [inputs[function.name_in().index(x)] for x in names]
    results = dict(zip(function.name_out(), function.call(inputs), strict=True))
    blocks = [ca.jacobian(result, x) for result in results.values() for x in chosen]
    labels = [name_derivative(out, x) for out in results for x in names]
    symbol = f"casadi_{kernel.symbol}"
    jacobian = ca.Function(symbol, inputs, blocks, function.name_in(), labels, {"cse": True})
    if jacobian.n_instructions() > LARGEST:
        return f"not compiled: {jacobian.n_instructions()} operations"
    with tempfile.TemporaryDirectory() as place:
        generator = ca.CodeGenerator(f"{symbol}.c")
        generator.add(jacobian)
        generator.generate(f"{place}/")
        library = compile_library(Path(place), subject.manifest.prefix, [f"{symbol}.c"], variant.compiler())
    return Candidate(f"{name}, CasADi's AD", Code(find_function(library, symbol), variant.precision), variant)


def add_hidden(subject: Subject, states: States) -> dict[str, Array]:
    """Add the hoisted values of run-time parameters, if kernels need them."""
    setup = subject.manifest.setup
    if setup is None:  # there are no parameters, or kernels do not depend on them
        return dict(states)
    found = subject.kernels(setup.name, p=states["p"][0])
    return {**states, **{name: np.tile(value, (len(states["q"]), 1)) for name, value in found.items()}}


def load_equations(subject: Subject) -> ModuleType:
    """Import the Python module that mbsgen wrote into the cache."""
    name = subject.manifest.prefix
    specification = importlib.util.spec_from_file_location(name, subject.folder / f"{name}.py")
    assert specification is not None, "a name with .py can be imported"
    assert specification.loader is not None, "a name with .py can be imported"
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def trace(equations: ModuleType, kernel: Kernel) -> ca.Function:
    """Write a kernel with dense results in CasADi's symbols."""
    inputs = [ca.SX.sym(a.name, a.rows) for a in kernel.inputs]
    results = getattr(equations, kernel.name)(*(x.elements() for x in inputs), functions=ca)
    outputs = [ca.vertcat(*results[a.name]) for a in kernel.outputs]
    return ca.Function(kernel.name, inputs, outputs, [a.name for a in kernel.inputs], [a.name for a in kernel.outputs])
