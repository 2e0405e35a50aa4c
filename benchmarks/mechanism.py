"""Tree -> the text that feeds the programs in `cpp/`: the same mechanism for all that are compared."""

from __future__ import annotations

from collections.abc import Iterable

from sympy import Expr

from mbsgen.model.tree import NO_FORCE, Body, Motion, Tree


def write_mechanism(tree: Tree) -> str:
    """Write a mechanism as `cpp/mechanism.hpp` reads it. Raises ValueError for what the peers have no part for."""
    faults = [
        body.joint.name
        for i, body in enumerate(tree.bodies)
        if body.parent != i or body.joint.motion is not Motion.REVOLUTE or body.joint.law != NO_FORCE
    ]
    if faults or tree.wrenches:
        raise ValueError(
            f"{tree.name}: {', '.join(faults) or 'external forces'}: only chains of revolute joints are compared, "
            "without forces but the actuators'"
        )
    values = {parameter.symbol: parameter.value for parameter in tree.parameters}

    def numbers(expressions: Iterable[Expr]) -> list[str]:
        return [repr(float(expression.subs(values))) for expression in expressions]

    def line(body: Body) -> str:
        inertia = [body.inertia[r][c] for r, c in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))]
        axes = [entry for row in body.orientation for entry in row]
        joint = [str(body.parent), "R" + "XYZ"[body.joint.axis], str(int(body.joint.actuated))]
        return " ".join(joint + numbers([*body.position, *axes, body.mass, *body.com, *inertia]))

    first = " ".join([str(len(tree.bodies)), *numbers(tree.gravity)])
    return "\n".join([first, *map(line, tree.bodies)]) + "\n"
