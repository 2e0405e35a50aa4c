"""Derivatives of the residual by mechanics: Tree -> Tapes of `lin_impl`, which holds `jac_impl`, and `jac_adj1_impl`.

Phi is the sum of the inertial residual, which `parsimony.sensitivities` and `parsimony.curvatures` differentiate, and
of the rest: forces of joints, rotors and external wrenches. The rest is the residual of the same tree without mass and
gravity. It is differentiated as a tape, and added.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from sympy import Integer

from mbsgen.derivatives import kernels
from mbsgen.formulations import impl, ports
from mbsgen.formulations.chain import write_chain
from mbsgen.formulations.closure import count_forces
from mbsgen.formulations.parsimony.curvatures import Curvatures, curvatures
from mbsgen.formulations.parsimony.mass_matrix import Entries
from mbsgen.formulations.parsimony.segments import align
from mbsgen.formulations.parsimony.sensitivities import Sensitivities, sensitivities
from mbsgen.formulations.parsimony.writing import Writing, begin
from mbsgen.formulations.planning import dynamics_alone, find_plans, take_factors
from mbsgen.formulations.reductions import Reductions
from mbsgen.formulations.states import State, declare_state
from mbsgen.model.tree import Tree
from mbsgen.roles import Order
from mbsgen.tape import forward, reverse
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.ports import Port, adjoint_port, derivative_port, seed_port
from mbsgen.tape.replay import replay, replay_lengths
from mbsgen.tape.types import Tape

Block = dict[tuple[int, int], Scalar]  # by (row, column), from 0
NOTHING = (Integer(0),) * 3


def linearisation(tree: Tree, reductions: Reductions) -> Tape:
    """Write `lin_impl`: the outputs Phi and the outputs of `jac_impl`."""
    return _linearise(tree, reductions, lambda found, _: found.Phi)


def expansion(tree: Tree, reductions: Reductions) -> Tape:
    """Write `lin_impl` with Phi from the blocks of its Jacobian, which takes few operations where qdd = 0.

    Phi of the bodies is linear in qdd, and a square in qd: Phi = dPhi/dqdd qdd + dPhi/dqd qd / 2 + Phi at rest.
    """
    return _linearise(tree, reductions, _expand)


def _expand(found: Sensitivities, state: State) -> Mapping[int, Scalar]:
    Phi = dict(found.weight)
    half = [x * x.builder.number(0.5) for x in state.qd]
    for entries, factors in ((found.qdd, state.qdd), (found.qd, half)):
        for (i, j), value in sorted(entries.items(), key=lambda entry: entry[0]):
            Phi[i] = Phi[i] + value * factors[j - 1]
    return Phi


def _linearise(
    tree: Tree, reductions: Reductions, write: Callable[[Sensitivities, State], Mapping[int, Scalar]]
) -> Tape:
    writer = _Writer.declare(tree, reductions)
    found = sensitivities(writer.begin(), writer.state.qd, writer.state.qdd)
    forces, Phi = write_forces(tree, reductions), write(found, writer.state)
    writer.write_blocks({ports.RESIDUAL: {(i - 1, 0): value for i, value in Phi.items()}}, forces)
    writer.write_blocks(_jacobian_blocks(found), forward.jacobian(forces, kernels.differentiable(forces)))
    return writer.finish(Order.LINEARISATION)


def adjoint_jacobian(tree: Tree, reductions: Reductions) -> Tape:
    """Write `jac_adj1_impl`: inputs of `impl` and adj_Phi; outputs jac_adj_<in>_<in> and jac_adj_<in>_adj_Phi."""
    writer = _Writer.declare(tree, reductions)
    multipliers = writer.seed(seed_port(ports.RESIDUAL), len(tree.bodies))
    blocks = _second_blocks(*curvatures(writer.begin(), writer.state.qd, writer.state.qdd, multipliers))
    forces = write_forces(tree, reductions)
    wrt = kernels.differentiable(forces)
    adj1 = reverse.adjoint(forces, wrt)
    writer.write_blocks(blocks, kernels.adjoint_jacobian(forces, adj1, wrt))
    return writer.finish(Order.ADJOINT_JACOBIAN)


def write_forces(tree: Tree, reductions: Reductions) -> Tape:
    """Write the residual of the tree without mass and gravity."""
    bodies = tuple(
        replace(body, mass=Integer(0), com=NOTHING, inertia=(NOTHING, NOTHING, NOTHING), parts=())
        for body in tree.bodies
    )
    return impl.build(replace(tree, gravity=NOTHING, bodies=bodies), replace(reductions, trials=1))


def _jacobian_blocks(found: Sensitivities) -> dict[Port, Block]:
    by = {ports.COORDINATES: found.q, ports.VELOCITIES: found.qd, ports.ACCELERATIONS: found.qdd}
    return {derivative_port(ports.RESIDUAL, port): _from_zero(entries) for port, entries in by.items()}


def _second_blocks(first: Sensitivities, second: Curvatures) -> dict[Port, Block]:
    q, qd, qdd = ports.COORDINATES, ports.VELOCITIES, ports.ACCELERATIONS
    q_qd, q_qdd = _from_zero(second.q_qd), _from_zero(second.q_qdd)
    blocks = {
        (q, q): _mirrored(_from_zero(second.q_q)),
        (q, qd): q_qd,
        (q, qdd): q_qdd,
        (qd, q): transposed(q_qd),
        (qd, qd): _mirrored(_from_zero(second.qd_qd)),
        (qdd, q): transposed(q_qdd),
    }
    for port, entries in ((q, first.q), (qd, first.qd), (qdd, first.qdd)):
        blocks[port, seed_port(ports.RESIDUAL)] = transposed(_from_zero(entries))
    return {derivative_port(adjoint_port(row), col): block for (row, col), block in blocks.items()}


def _from_zero(entries: Entries) -> Block:
    return {(i - 1, j - 1): value for (i, j), value in entries.items()}


def transposed(block: Block) -> Block:
    """Swap rows and columns."""
    return {(c, r): value for (r, c), value in block.items()}


def _mirrored(block: Block) -> Block:
    return block | transposed(block)


@dataclass(frozen=True)
class _Writer:
    """A tree's state in a builder, and the start of its recursions."""

    tree: Tree
    reductions: Reductions
    builder: Builder
    state: State
    given: dict[str, Sequence[Scalar]]  # the nonzeros of all inputs

    @staticmethod
    def declare(tree: Tree, reductions: Reductions) -> _Writer:
        builder = Builder()
        state = declare_state(tree, builder, more=count_forces(tree))
        return _Writer(tree, reductions, builder, state, {**vars(state), **state.more})

    def seed(self, port: Port, size: int) -> list[Scalar]:
        seeds = self.builder.vector(port, size)
        self.given[port.name] = seeds
        return seeds

    def begin(self) -> Writing:
        chain = write_chain(dynamics_alone(self.tree, driven=False), self.builder, self.state)
        segments = align(chain, group=self.reductions.share_frames)
        return begin(chain, segments, find_plans(self.tree, self.reductions).sensitivities, self.reductions)

    def write_blocks(self, blocks: Mapping[Port, Block], forces: Tape) -> None:
        """Declare the outputs of `forces`, each with its inertial block added."""
        values = replay(forces, self.builder, self.given)
        replay_lengths(forces, self.builder, values)
        for output in forces.outputs:
            block = dict(blocks.get(output.port, {}))
            for place, value in zip(output.sparsity.entries, output.values, strict=True):
                block[place] = block[place] + values[value] if place in block else values[value]
            if output.sparsity.is_dense:
                self.builder.output(output.port, output.sparsity, [block[place] for place in output.sparsity.entries])
            else:
                self.builder.output_nonzeros(output.port, output.sparsity.rows, output.sparsity.cols, block)

    def finish(self, order: Order) -> Tape:
        return take_factors(self.builder.build(impl.FUNCTION.to(order)), self.reductions)
