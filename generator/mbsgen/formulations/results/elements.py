"""Forces between bodies by themselves: Tree -> Tapes of `lengths`, `stretches`, `tensions` and `contact_forces`.

`mbsgen.model.elements` states their laws as definitions of the tree; these functions give what the definitions of one
force name: with d from the first end to the second, and F on the first one,

    length = |d|,    rate = d.d' / |d|,    tension = F.d / |d|

Elements through further points define their length, rate and tension themselves.

The derivatives of a length by the coordinates are, with the other sign, the moment arms of the tension.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from sympy import Expr

from mbsgen.algebra.vectors import Vector
from mbsgen.formulations import ports
from mbsgen.formulations.chain import Chain, write_chain
from mbsgen.formulations.points import Points
from mbsgen.formulations.states import declare_state
from mbsgen.model.elements import list_end_symbols
from mbsgen.model.tree import Reading, Tree
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


def build_rates(tree: Tree) -> Tape:
    """Write `stretches`: inputs q, qd [, p]; output stretch, the rates of the lengths [m/s]."""
    builder = Builder()
    chain = write_chain(tree, builder, declare_state(tree, builder, accelerations=False, forces=False, wrenches=False))
    chain.guard_lengths(set(tree.elements))
    builder.output_dense(ports.STRETCH, [[_measure_rate(chain, name)] for name in tree.elements])
    return builder.build("stretches")


def build_tensions(tree: Tree) -> Tape:
    """Write `tensions`: inputs q, qd [, w] [, p]; output tension, shape (springs and cables,) [N]."""
    chain = _write_chain(tree)
    chain.guard_lengths(set(tree.elements))
    chain.builder.output_dense(ports.TENSION, [[_pull(chain, name)] for name in tree.elements])
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


def _measure_rate(chain: Chain, name: str) -> Scalar:
    """Return the rate of a length: as it is defined, or of a spring that may have none."""
    known = _define(chain, name)
    if "rate" in known:
        return chain.force(known["rate"])
    points = Points(chain.links, chain.state.qd, chain.still)
    a, b = (
        points.read(Reading.VELOCITY, x.body, chain.vector(x.point))
        for x in chain.tree.probes
        if x.symbols[0] in list_end_symbols(name)
    )
    return _read_vector(chain, name, "d").dot(b - a) / _measure(chain, name)


def _pull(chain: Chain, name: str) -> Scalar:
    known = _define(chain, name)
    if "tension" in known:
        return chain.force(known["tension"])
    return _read_vector(chain, name, "F").dot(_read_vector(chain, name, "d")) / _measure(chain, name)


def _read_vector(chain: Chain, name: str, key: str) -> Vector[Scalar]:
    known = _define(chain, name)
    return Vector.of(chain.force(known[f"{key}.{axis}"]) for axis in "xyz")


def _define(chain: Chain, name: str) -> Mapping[str, Expr]:
    """Return the symbols of a force by their keys."""
    return {x.key: x.symbol for x in chain.tree.definitions if x.owner == name}
