"""CasADi functions of the equations of motion, their derivatives by CasADi, and their costs.

A function f has named inputs; its Jacobian has the results `jac_<out>_<in>`, the Jacobian of its adjoint
`jac_adj_<in>_<in>` and `jac_adj_<in>_adj_<out>`, as the generated kernels have them. All are made by CasADi's
algorithmic differentiation, and pass its elimination of common subexpressions.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path

import casadi as ca

from mbsgen.manifest import Kernel, Manifest

ARITHMETIC = frozenset(
    {ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV, ca.OP_SQ, ca.OP_TWICE, ca.OP_INV, ca.OP_SQRT}
)  # + - * / and the root, one each; the minus sign and sines are not counted
CSE = {"cse": True}


def count_arithmetic(function: ca.Function) -> int:
    """Count the operations + - * / and roots of an SX function."""
    return sum(function.instruction_id(i) in ARITHMETIC for i in range(function.n_instructions()))


def eliminate(function: ca.Function, name: str) -> ca.Function:
    """Return a function without common subexpressions, under another name."""
    inputs = function.sx_in()
    return ca.Function(name, inputs, function.call(inputs), function.name_in(), function.name_out(), CSE)


def jacobian(function: ca.Function, name: str) -> ca.Function:
    """Differentiate the only result of `function` by all inputs."""
    inputs, (out,), (result,) = function.sx_in(), function.name_out(), function.call(function.sx_in())
    names = function.name_in()
    whole = ca.jacobian(result, ca.vertcat(*inputs))
    blocks = ca.horzsplit(whole, _edges(inputs))
    return ca.Function(name, inputs, blocks, names, [f"jac_{out}_{x}" for x in names], CSE)


def adjoint_jacobian(function: ca.Function, name: str) -> ca.Function:
    """Differentiate (d f / d x)^T lambda by x and lambda: a symmetric second derivative, and the Jacobian turned."""
    inputs, (out,), (result,) = function.sx_in(), function.name_out(), function.call(function.sx_in())
    names = function.name_in()
    variables, seed = ca.vertcat(*inputs), ca.SX.sym("seed", result.numel())
    hessian, _ = ca.hessian(ca.dot(seed, result), variables)
    turned = ca.jacobian(result, variables).T
    edges = _edges(inputs)
    rows = [ca.horzsplit(row, edges) for row in ca.vertsplit(hessian, edges)]
    results, labels = [], []
    for row, x, last in zip(rows, names, ca.vertsplit(turned, edges), strict=True):
        results += [*row, last]
        labels += [*(f"jac_adj_{x}_{y}" for y in names), f"jac_adj_{x}_adj_{out}"]
    return ca.Function(name, [*inputs, seed], results, [*names, f"adj_{out}"], labels, CSE)


def read_tape(folder: Path, manifest: Manifest, names: tuple[str, ...]) -> dict[str, ca.Function]:
    """Read kernels from a generated folder's Python target: the equations of the C, as CasADi's expressions."""
    specification = importlib.util.spec_from_file_location(manifest.prefix, folder / f"{manifest.prefix}.py")
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    functions = {}
    for name in names:
        kernel = manifest.kernel(name)
        inputs = [ca.SX.sym(a.name, a.rows) for a in kernel.inputs]
        results = getattr(module, name)(*(x.elements() for x in inputs), functions=ca)
        outputs = [_matrix(kernel, i, results[a.name]) for i, a in enumerate(kernel.outputs)]
        functions[name] = ca.Function(
            name, inputs, outputs, [a.name for a in kernel.inputs], [a.name for a in kernel.outputs]
        )
    return functions


def _edges(parts: list[ca.SX]) -> list[int]:
    edges = [0]
    for part in parts:
        edges.append(edges[-1] + part.numel())
    return edges


def _matrix(kernel: Kernel, i: int, nonzeros: list[ca.SX]) -> ca.SX:
    argument = kernel.outputs[i]
    if argument.row is None or argument.colind is None:
        return ca.reshape(ca.vertcat(*nonzeros), argument.rows, argument.cols)
    return ca.SX(ca.Sparsity(argument.rows, argument.cols, argument.colind, argument.row), ca.vertcat(*nonzeros))
