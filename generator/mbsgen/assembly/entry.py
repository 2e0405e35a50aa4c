"""The functions of this package, at no cost for a tree without loops: the modules that close loops load NumPy."""

from __future__ import annotations

from mbsgen.assembly.results import Findings
from mbsgen.model.tree import Tree


def assemble(tree: Tree) -> Tree:
    """Return a tree with its closure; a tree without loops as it is. Raises AssemblyError.

    Where no equation restricts the joints, the loops and constraints are left out.
    """
    if not tree.is_constrained:
        return tree
    from mbsgen.assembly.loops import assemble_loops

    return assemble_loops(tree)


def describe(tree: Tree) -> Findings | None:
    """Describe the loops of an assembled tree; None without any."""
    if tree.closure is None or not (tree.loops or tree.constraints):
        return None
    from mbsgen.assembly.findings import describe_loops

    return describe_loops(tree, tree.closure)


def list_redundant(tree: Tree) -> tuple[str, ...]:
    """Name the equations of an assembled tree that follow from others."""
    from mbsgen.assembly.findings import list_redundant

    return list_redundant(tree)


def list_held(tree: Tree) -> tuple[str, ...]:
    """Name the joints that the loops of an assembled tree keep at rest, wherever the others move."""
    if tree.closure is None:
        return ()
    from mbsgen.assembly.findings import find_held

    return find_held(tree, tree.closure)
