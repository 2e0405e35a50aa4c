"""Write a tree as text for the programs in `cpp/`: the same mechanism for all candidates."""

from __future__ import annotations

from collections.abc import Iterable

from sympy import Expr

from mbsgen.model.tree import NO_FORCE, Body, Motion, Tree


def write_mechanism(tree: Tree) -> str:
    """Write a mechanism as `cpp/mechanism.hpp` reads it. Raises ValueError for parts that peers lack."""
    forced = [body.joint.name for body in tree.bodies if body.joint.law != NO_FORCE or body.joint.armature != 0]
    if forced or tree.wrenches or tree.quaternions:
        raise ValueError(
            f"{tree.name}: {', '.join(forced) or 'wrenches, quaternions'}: only what turns and slides about and along "
            "axes is compared, without rotors, and without forces but the actuators'"
        )
    if not _is_depth_first([body.parent for body in tree.bodies]):
        raise ValueError(f"{tree.name}: Pinocchio wants every branch's bodies together; write them in that order")
    values = {parameter.symbol: parameter.value for parameter in tree.parameters}

    def numbers(expressions: Iterable[Expr]) -> list[str]:
        return [repr(float(expression.subs(values))) for expression in expressions]

    def line(body: Body) -> str:
        inertia = [body.inertia[r][c] for r, c in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))]
        axes = [entry for row in body.orientation for entry in row]
        kind = "R" if body.joint.motion is Motion.REVOLUTE else "P"
        joint = [str(body.parent), kind + "XYZ"[body.joint.axis], str(int(body.joint.actuated))]
        return " ".join(joint + numbers([*body.position, *axes, body.mass, *body.com, *inertia]))

    first = " ".join([str(len(tree.bodies)), *numbers(tree.gravity)])
    return "\n".join([first, *map(line, tree.bodies)]) + "\n"


def _is_depth_first(parents: Iterable[int]) -> bool:
    """Return whether each body 1, 2, … has the body before it, or one of its ancestors, for parent."""
    path = [0]
    for number, parent in enumerate(parents, 1):
        while path and path[-1] != parent:
            path.pop()
        if not path:
            return False
        path.append(number)
    return True
