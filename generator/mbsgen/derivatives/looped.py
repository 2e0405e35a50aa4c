"""First derivatives of the dynamics of large trees, with loops over tables: code of O(n) instead of O(n^3).

A straight stage places each body beside its parent, and adds up the forces of joints and wrenches, whose derivatives
are its own. The recursions of `procedure.tree_dynamics` do the rest.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

from mbsgen.derivatives.kernels import Derivatives, differentiable
from mbsgen.derivatives.recursion import write_forces
from mbsgen.derivatives.vanishing import find_patterns
from mbsgen.formulations import exp1, ports
from mbsgen.formulations.chain import write_chain
from mbsgen.formulations.parsimony.segments import align, feels_itself, largest_inertias
from mbsgen.formulations.reductions import Reductions
from mbsgen.formulations.states import State, declare_state
from mbsgen.formulations.tables import list_joints, list_moments, list_placements
from mbsgen.model.tree import Tree
from mbsgen.procedure.patterns import LANES
from mbsgen.procedure.procedure import Computation, Procedure, count
from mbsgen.procedure.solve import Block
from mbsgen.procedure.straight import Straight
from mbsgen.procedure.tree_dynamics import Added, TreeDynamics
from mbsgen.procedure.wires import Wire
from mbsgen.roles import Order
from mbsgen.tape import forward
from mbsgen.tape.builder import Builder, Scalar
from mbsgen.tape.ports import Function, Port, adjoint_port, derivative_port, seed_port
from mbsgen.tape.replay import replay, replay_lengths
from mbsgen.tape.types import Sparsity, Tape


class _Looped(Derivatives, ABC):
    """The first derivatives of one form of the equations of motion, in stages. `others` are its straight ones."""

    value: Port  # of the form

    def __init__(self, tape: Tape, tree: Tree, reductions: Reductions, others: Callable[[], Derivatives]) -> None:
        super().__init__(tape, differentiable(tape))
        self._tree, self._reductions, self._others = tree, reductions, others

    @property
    @abstractmethod
    def _blocks(self) -> Mapping[str, Wire]:
        """The blocks of the Jacobian, by input."""

    @cached_property
    def jac(self) -> Procedure:
        """The Jacobian."""
        written = self._write(self.tape.function.to(Order.JACOBIAN), self.value, self._blocks)
        return replace(written, outputs=written.outputs[1:])

    @cached_property
    def lin(self) -> Procedure:
        """The value and its Jacobian."""
        return self._write(self.tape.function.to(Order.LINEARISATION), self.value, self._blocks)

    @cached_property
    def adj1(self) -> Computation:
        """The adjoint, straight."""
        return self._others().adj1

    @property
    def jac_adj1(self) -> Tape:
        """The second derivatives, straight."""
        return self._others().jac_adj1

    def count_ways(self, orders: Iterable[Order]) -> Mapping[str, Mapping[str, int]]:
        """Count the only way."""
        written = {Order.JACOBIAN: self.jac, Order.LINEARISATION: self.lin, Order.ADJOINT: self.adj1}
        return {written[o].name: {"tables": count(written[o]).paper} for o in orders if o in written}

    @cached_property
    def _patterns(self) -> Mapping[str, Sparsity]:
        """The patterns of dPhi/dx, by x."""
        n, inputs = len(self._tree.bodies), self._forces[0].inputs
        blocks = {i.name: derivative_port(ports.RESIDUAL, i.port) for i in inputs if i.port.role.is_differentiated}
        full = {
            x: Wire.to(port, Sparsity.dense(n, self._forces[0].input(x).sparsity.nnz)) for x, port in blocks.items()
        }
        found = find_patterns(self._write(self.tape.function, ports.RESIDUAL, full))
        return {x: found[port.name] for x, port in blocks.items()}

    def _number_columns(self, value: Port) -> tuple[Mapping[str, int], int]:
        """Return the first column of B of each input, and the number of all columns: whole lanes."""
        columns, used = {}, 0
        for i in self._forces[0].inputs:
            if i.port.role.is_differentiated and not (i.port == ports.ACCELERATIONS == value):
                columns[i.name] = used
                used += i.sparsity.nnz
        return columns, -(-used // LANES) * LANES

    def _write(
        self, function: Function, value: Port, results: Mapping[str, Wire], seeds: Port | None = None
    ) -> Procedure:
        """Write the stage that places bodies and adds up forces, and the recursions."""
        tree, builder = self._tree, Builder()
        n, is_given = len(tree.bodies), value == ports.RESIDUAL
        columns, width = self._number_columns(value)
        state = declare_state(tree, builder, accelerations=is_given)
        given = builder.vector(seeds, n) if seeds else []
        chain = write_chain(tree, builder, state)
        segments = align(chain, group=False)
        owned = tuple(map(feels_itself, segments))
        largest = largest_inertias(chain, segments)
        numbers = {
            "placements": list_placements(chain),
            "moments": list_moments(chain, builder),
            "gravity": list(chain.gravity),
            "rates": state.qd,
            "rotors": list(chain.armatures),
            "scales": [builder.zero if own else largest[i] for i, own in enumerate(owned, 1)],
            **({"seeds": given} if seeds else {}),
            **({"accelerations": state.qdd} if is_given else {}),
        }
        added = self._write_forces(builder, state, numbers, columns)
        for name, values in numbers.items():
            builder.output(name, Sparsity.dense(len(values)), values)
        before = Straight(builder.build(f"place_{function.name}"))
        wires = {wire.name: wire for wire in before.gives}
        dynamics = TreeDynamics(
            name=f"dynamics_{function.name}",
            parents=tuple(link.parent for link in chain.links),
            joints=list_joints(chain),
            owned=owned,
            tolerances=(n * exp1.PIVOT_TOLERANCE, exp1.LOCKING_TOLERANCE),
            placements=wires["placements"],
            moments=wires["moments"],
            gravity=wires["gravity"],
            rates=wires["rates"],
            rest=wires["rest"],
            rotors=wires["rotors"],
            scales=wires["scales"],
            added=tuple(Added(wires[name], first) for name, first in added.items()),
            width=width,
            value=Wire.to(value, Sparsity.dense(n)),
            results=tuple(Block(wire, columns[x]) for x, wire in results.items()),
            accelerations=wires.get("accelerations"),
            seeds=wires.get("seeds"),
        )
        return Procedure(function, before.reads, (before, dynamics), dynamics.gives)

    @cached_property
    def _forces(self) -> tuple[Tape, Tape]:
        """Phi of the tree without mass, and its derivatives."""
        forces = write_forces(self._tree, self._reductions)
        return forces, forward.jacobian(forces, differentiable(forces))

    def _write_forces(
        self, builder: Builder, state: State, numbers: dict[str, list[Scalar]], columns: Mapping[str, int]
    ) -> dict[str, int]:
        """Write the forces of joints, wrenches and rotors, and their derivatives; return the columns of these."""
        given: dict[str, Sequence[Scalar]] = {**vars(state), "qdd": state.qdd or [builder.zero] * len(state.qd)}
        added = {}
        for tape in self._forces:
            values = replay(tape, builder, given)
            replay_lengths(tape, builder, values)
            for o in tape.outputs:
                if o.port.by is None:
                    numbers["rest"] = [values[v] for v in o.values]
                elif o.sparsity.nnz and o.port.by.name in columns:
                    builder.output(f"of_forces_{o.name}", o.sparsity, [values[v] for v in o.values])
                    added[f"of_forces_{o.name}"] = columns[o.port.by.name]
        return added


class LoopedResidual(_Looped):
    """The derivatives of the residual."""

    value = ports.RESIDUAL

    @cached_property
    def _blocks(self) -> Mapping[str, Wire]:
        by = {x: derivative_port(ports.RESIDUAL, self.tape.input(x).port) for x in self.wrt}
        return {x: Wire.to(port, self._patterns[x]) for x, port in by.items()}


class LoopedAccelerations(_Looped):
    """The derivatives of the accelerations."""

    value = ports.ACCELERATIONS

    @cached_property
    def adj1(self) -> Procedure:
        """The adjoint."""
        inputs = {x: self.tape.input(x) for x in self.wrt}
        sums = {x: Wire.to(adjoint_port(i.port), Sparsity.dense(i.sparsity.nnz)) for x, i in inputs.items()}
        seeds = seed_port(ports.ACCELERATIONS)
        written = self._write(self.tape.function.to(Order.ADJOINT), self.value, sums, seeds)
        return replace(written, outputs=written.outputs[1:])

    @cached_property
    def _blocks(self) -> Mapping[str, Wire]:
        """The results, by input: columns of dPhi/dx that do not vanish reach all joints of their part of the tree."""
        roots = [0]
        for k, body in enumerate(self._tree.bodies, 1):
            roots.append(roots[body.parent] or k)
        blocks = {}
        for x in self.wrt:
            pattern, reached = self._patterns[x], dict[int, set[int]]()
            for k, c in pattern.entries:
                reached.setdefault(c, set()).add(roots[k + 1])
            entries = [(k - 1, c) for c, parts in reached.items() for k in range(1, len(roots)) if roots[k] in parts]
            port = derivative_port(ports.ACCELERATIONS, self.tape.input(x).port)
            blocks[x] = Wire.to(port, Sparsity.of(pattern.rows, pattern.cols, entries))
        return blocks
