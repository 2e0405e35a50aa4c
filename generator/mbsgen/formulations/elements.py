"""Forces between bodies by themselves: Tree -> Tapes of `lengths`, `tensions` and `contact_forces`.

`mbsgen.model.elements` states their laws as definitions of the tree; these functions give what the definitions of one
force name: with d from the first end to the second, and F on the first one,

    length = |d|,    tension = F.d / |d|

The derivatives of a length by the coordinates are, with the other sign, the moment arms of the tension.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from sympy import Expr

from mbsgen.algebra.vectors import Vector
from mbsgen.formulations import ports
from mbsgen.formulations.chain import Chain, write_chain
from mbsgen.formulations.states import declare_state
from mbsgen.model.tree import Tree
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.types import Tape

LEAST = 1e-300  # m2, beside the square of a length that may be 0: its root has a derivative


def build_lengths(tree: Tree) -> Tape:
    """Write `lengths`: inputs q [, p]; output length, shape (springs and cables,) [m]."""
    builder = Builder()
    state = declare_state(tree, builder, rates=False, accelerations=False, forces=False, wrenches=False)
    chain = write_chain(tree, builder, replace(state, qd=[builder.zero] * len(tree.bodies)))
    chain.guard_lengths(set(tree.elements))
    builder.output_dense(ports.LENGTH, [[_measure(chain, name)] for name in tree.elements])
    return builder.build("lengths")


def build_tensions(tree: Tree) -> Tape:
    """Write `tensions`: inputs q, qd [, w] [, p]; output tension, shape (springs and cables,) [N]."""
    chain = _write_chain(tree)
    chain.guard_lengths(set(tree.elements))
    pulls = [_read_vector(chain, name, "F").dot(_read_vector(chain, name, "d")) for name in tree.elements]
    tensions = [[pull / _measure(chain, name)] for name, pull in zip(tree.elements, pulls, strict=True)]
    chain.builder.output_dense(ports.TENSION, tensions)
    return chain.builder.build("tensions")


def build_contacts(tree: Tree) -> Tape:
    """Write `contact_forces`: inputs q, qd [, w] [, p]; outputs normal (points,) and contact_force (3, points) [N]."""
    chain = _write_chain(tree)
    chain.guard_lengths({x.name for x in tree.distances})
    own = [_define(chain, x.name) for x in tree.distances]
    forces = [_read_vector(chain, x.name, "F") for x in tree.distances]
    chain.builder.output_dense(ports.NORMAL_FORCE, [[chain.force(known["N"])] for known in own])
    chain.builder.output_dense(ports.CONTACT_FORCE, [[F[r] for F in forces] for r in range(3)])
    return chain.builder.build("contact_forces")


def _write_chain(tree: Tree) -> Chain:
    builder = Builder()
    return write_chain(tree, builder, declare_state(tree, builder, accelerations=False, forces=False))


def _measure(chain: Chain, name: str) -> Scalar:
    """Return a length: as it is defined, or of a spring that may have none."""
    known = _define(chain, name)
    if "length" in known:
        return chain.force(known["length"])
    d = _read_vector(chain, name, "d")
    return chain.builder.sqrt(d.dot(d) + chain.builder.number(LEAST))


def _read_vector(chain: Chain, name: str, key: str) -> Vector[Scalar]:
    known = _define(chain, name)
    return Vector.of(chain.force(known[f"{key}.{axis}"]) for axis in "xyz")


def _define(chain: Chain, name: str) -> Mapping[str, Expr]:
    """Return the symbols of a force by their keys."""
    return {x.key: x.symbol for x in chain.tree.definitions if x.owner == name}
