"""A problem of phases as one nonlinear program: the direct sum of the phases' programs, and the rows of links.

`addition` writes the sum, `linking` and `impacts` the links behind it. The program's bounds are the phases' own, the
bounds of shared unknowns, the ranges of conditions, and zeros for all other rows of links.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.ground.program import Chain, Matrix, Program
from mbsrun.ocp.ground.trajectory import Trajectory
from mbsrun.ocp.problem.phases import Link, PhasedProblem, Plants
from mbsrun.ocp.solution.phases import Guess
from mbsrun.ocp.transcription.addition import Further, Offsets, Summand, add, add_parameters, place_summands
from mbsrun.ocp.transcription.chain import Joined, Joint, order_stages
from mbsrun.ocp.transcription.delays import Half, Placed, find_shifts, write_jumps, write_repeats
from mbsrun.ocp.transcription.impacts import ImpactRows, write_impact
from mbsrun.ocp.transcription.linking import Defined, Rows, write_conditions, write_costs, write_transfer
from mbsrun.ocp.transcription.scales import ROUNDED, USUAL, find_scales, find_terms, round_scale
from mbsrun.ocp.transcription.sides import Side, name_blows, name_impulses, read_side
from mbsrun.ocp.transcription.standing import find_standing
from mbsrun.ocp.transcription.transcription import Transcription, transcribe


@dataclass(frozen=True)
class LinkRows:
    """Where the conditions of a link lie, and its impact."""

    link: Link
    conditions: Indices
    impact: ImpactRows | None
    costs: Indices  # among the weights
    extent: tuple[int, int]  # the first row, and the one after the last
    variables: tuple[int, int]  # likewise
    repeats: Indices  # further rows, which let inputs act again


@dataclass(frozen=True)
class PhasedTranscription:
    """A program, and how problems become its numbers and its variables trajectories.

    Bounds, `pack` and `split_rows` are of the variables and rows that a solver sees; all else is numbered in the whole.
    """

    phases: tuple[Transcription, ...]
    offsets: tuple[Offsets, ...]  # of each phase, and last of the links
    links: tuple[LinkRows, ...]
    closed: tuple[Indices, ...]  # rows of each phase that would close loops, or hold contacts, as its link does
    unknowns: Indices  # variables
    constants: tuple[str, ...]  # that links read
    defined: tuple[Defined, ...]  # variables of links that a first guess finds from others
    texts: tuple[tuple[Indices, str], ...]  # rows of links, and their descriptions
    bounds: tuple[Array, Array]  # of the variables of links
    row_bounds: tuple[Array, Array]  # of the rows of links
    unstaged: Indices  # rows of links that keep the program from falling into stages
    program: Program

    def see(self, variables: Indices) -> Indices:
        """Number variables as a solver sees them."""
        return np.searchsorted(self.program.kept, variables)

    def see_rows(self, rows: Indices) -> Indices:
        """Number rows as a solver sees them."""
        return np.searchsorted(self.program.kept_rows, rows)

    def list_unknowns(self, problem: PhasedProblem) -> dict[str, Indices]:
        """Return the variables of each unknown: the shared one, and its copies in phases."""
        found = {x.name: {int(i)} for x, i in zip(problem.every_unknown, self.unknowns, strict=True)}
        for own, phase, offset in zip(self.phases, problem.phases, self.offsets, strict=False):
            for unknown, variable in zip(phase.problem.unknowns, own.layout.unknowns, strict=True):
                found[unknown.name].add(int(variable) + offset.variables)
        return {name: np.array(sorted(variables), dtype=np.int64) for name, variables in found.items()}

    def parameters(self, problem: PhasedProblem) -> Array:
        """Return the parameters of the program."""
        parts = [own.parameters(phase.problem) for own, phase in zip(self.phases, problem.phases, strict=True)]
        weights = [term.weight for link in problem.links for term in link.cost]
        constants = dict(problem.constants)
        return add_parameters(self.offsets, parts, [constants[name] for name in self.constants], weights)

    def variable_bounds(self, problem: PhasedProblem) -> tuple[Array, Array]:
        """Bound all variables."""
        own = [part.variable_bounds(phase.problem) for part, phase in zip(self.phases, problem.phases, strict=True)]
        lower, upper = (np.concatenate(parts) for parts in zip(*own, self.bounds, strict=True))
        shared = np.array([unknown.bounds for unknown in problem.every_unknown]).reshape(-1, 2).T
        lower[self.see(self.unknowns)], upper[self.see(self.unknowns)] = shared
        return lower, upper

    def constraint_bounds(self, problem: PhasedProblem) -> tuple[Array, Array]:
        """Bound all rows."""
        own = [part.constraint_bounds(phase.problem) for part, phase in zip(self.phases, problem.phases, strict=True)]
        for k, (closed, part) in enumerate(zip(self.closed, self.phases, strict=True)):
            if closed.size:
                lower, upper = (bound.copy() for bound in own[k])
                rows = np.searchsorted(part.program.kept_rows, closed)
                lower[rows], upper[rows] = -np.inf, np.inf
                own[k] = lower, upper
        last = [bound.copy() for bound in self.row_bounds]
        for link_rows, link in zip(self.links, problem.links, strict=True):
            ranges = np.array([condition.range for condition in link.conditions]).reshape(-1, 2).T
            for bound, given in zip(last, ranges, strict=True):
                bound[link_rows.conditions - self.offsets[-1].rows] = given
        lower, upper = (np.concatenate(parts) for parts in zip(*own, last, strict=True))
        return lower, upper

    def pack(self, problem: PhasedProblem, guess: Guess) -> Array:
        """Put trajectories into the variables; the ones of links are 0, except for unknowns."""
        parts = [own.pack(motion) for own, motion in zip(self.phases, guess.trajectories, strict=True)]
        x = np.concatenate([*parts, np.zeros(self.program.variables - self.offsets[-1].variables)])
        given = dict(guess.unknowns)
        values = {unknown.name: given.get(unknown.name, unknown.guess) for unknown in problem.every_unknown}
        x[self.see(self.unknowns)] = list(values.values())
        for own, phase, offset in zip(self.phases, problem.phases, self.offsets, strict=False):
            copies = self.see(own.layout.unknowns + offset.variables)
            x[copies] = [values[unknown.name] for unknown in phase.problem.unknowns]
        return x

    def find_scales(self, x: Array, bounds: tuple[Array, Array]) -> Array:
        """Return the scales of the variables that a solver sees; 1 for the ones of links."""
        scales, at = np.ones(self.program.kept.size), 0
        for part in self.phases:
            own = slice(at, at + part.program.kept.size)
            scales[own] = find_scales(part, x[own], (bounds[0][own], bounds[1][own]))
            at = own.stop
        return scales

    def size_inputs(self, scales: Array, x: Array, J: Matrix, bounds: tuple[Array, Array]) -> Array:
        """Return scales in which open inputs without a guess balance the other terms of the rows that read them.

        Derivatives J of the rows are given.
        """
        parts = [own.layout.list_inputs() + at.variables for own, at in zip(self.phases, self.offsets, strict=False)]
        inputs = self.see(np.intersect1d(np.concatenate(parts), self.program.kept))
        is_open = ~np.isfinite(np.subtract(*bounds)[inputs])
        inputs = inputs[is_open & (scales[inputs] == 1) & (np.abs(x[inputs]) <= ROUNDED)]
        if not inputs.size:
            return scales
        is_input = np.isin(np.arange(scales.size), inputs)
        terms, read = find_terms(J, np.where(is_input, 0.0, scales)), np.repeat(is_input, np.diff(J.indptr))
        own = np.abs(J.data[read])
        sizes = terms[J.indices[read]][own > 0] / own[own > 0]
        found = scales.copy()
        found[inputs] = round_scale(float(sizes.max(initial=0.0)), np.array([np.inf]), USUAL)
        return found

    def split(self, x: Array) -> list[Array]:
        """Return the variables of each phase, of all variables."""
        return [x[a.variables : b.variables] for a, b in zip(self.offsets, self.offsets[1:], strict=False)]

    def split_rows(self, g: Array) -> list[Array]:
        """Return the rows of each phase, and last the ones of links."""
        ends = self.see_rows(np.array([offset.rows for offset in self.offsets])).tolist()
        return [g[a:b] for a, b in zip(ends, [*ends[1:], g.size], strict=True)]

    def unpack(self, x: Array) -> list[Trajectory]:
        """Read the trajectories of all phases off all variables."""
        return [own.unpack(part) for own, part in zip(self.phases, self.split(x), strict=True)]


def transcribe_phases(problem: PhasedProblem, plants: Plants) -> PhasedTranscription:
    """Write the program of a problem of phases. Raises ValueError where parts of a phase do not go together."""
    phases = tuple(transcribe(phase.problem, plant) for phase, plant in zip(problem.phases, plants.phases, strict=True))
    if len(phases) == 1 and not problem.links and not problem.unknowns:
        return _keep(phases[0])
    numbers = [plants.number(plant) for plant in plants.phases]
    terms = sum(len(link.cost) for link in problem.links)
    offsets = place_summands([phase.program for phase in phases], terms)
    unknowns = [unknown.name for unknown in problem.every_unknown]
    rows = Rows(offsets[-1], unknowns, [name for name, _ in problem.constants], plants.every)
    for phase, part, offset in zip(problem.phases, phases, offsets, strict=False):
        for unknown, variable in zip(phase.problem.unknowns, part.layout.unknowns, strict=True):
            row = rows.add_rows(1, f"phase {phase.name}: {unknown.name}")
            rows.A.put(row, [rows.unknowns[unknown.name]], 1.0)
            rows.A.put(row, [int(variable) + offset.variables], -1.0)

    def side(k: int, *, is_end: bool) -> Side:
        own, first = problem.phases[k].problem, offsets[k].variables
        return read_side(phases[k], plants.phases[k].manifest, numbers[k], first, own, is_end=is_end)

    def place(k: int) -> Placed:
        phase = problem.phases[k]
        return Placed(Half(phase.name, phase.problem, plants.phases[k].manifest), phases[k], offsets[k].variables)

    links = []
    closed = [np.zeros(0, dtype=np.int64) for _ in phases]
    for i, link in enumerate(problem.links):
        source, target = problem.find(link.source), problem.find(link.target)
        before, after = side(source, is_end=True), side(target, is_end=False)
        text, state, impact = f"link {link.source} to {link.target}", before.state, None
        sides = place(source), place(target)
        shifts = find_shifts(*(part.half for part in sides))
        repeats = write_repeats(rows, text, shifts, *sides)
        first, first_variable = rows.rows, rows.variables
        if link.impact is not None:
            plant = plants.find_impact(i, source)
            impact = write_impact(rows, text, link.impact, state, plant, plants.number(plant))
            state = impact.after
        apart = tuple((x.name, None) for x in shifts if x.kind == "state" and x.name not in dict(link.map))
        write_transfer(rows, text, state, after.state, (*link.map, *apart), link.velocities)
        write_jumps(rows, text, shifts, *sides)
        same, dependent = numbers[source] == numbers[target], len(plants.phases[target].manifest.dependent)
        closed[target] = np.concatenate(
            (
                _find_given_loops(link, same, phases[target], dependent),
                _find_given_contacts(problem, plants, i, phases[target]),
            )
        )
        impulses: dict[str, int] = {}
        if link.impact is not None and impact is not None:
            named = name_impulses(link.impact.contacts)
            impulses = {name: int(impact.impulses[contact][k]) for name, contact, k in named}
            impulses |= {name: int(impact.blows[k]) for name, k in name_blows(link.impact.blows)}
        conditions = write_conditions(rows, text, link.conditions, before, after, impulses)
        costs = write_costs(rows, link.cost, before, after, impulses)
        extents = (first, rows.rows), (first_variable, rows.variables)
        links.append(LinkRows(link, conditions, impact, costs, *extents, repeats))
    further = Further(
        rows.variables - rows.first_variable,
        len(problem.constants),
        rows.matrix(),
        tuple(rows.blocks),
        terms,
        tuple(rows.costs),
    )
    summands = [Summand(phase.program, number) for phase, number in zip(phases, numbers, strict=True)]
    joints = [
        Joint(
            problem.find(x.link.source),
            problem.find(x.link.target),
            np.arange(*x.variables),
            np.arange(*x.extent),
            x.costs,
        )
        for x in links
    ]
    joined = Joined(further.A, further.blocks, further.costs, rows.first_row)
    chain = order_stages([phase.program for phase in phases], offsets, joints, joined)
    return PhasedTranscription(
        phases=phases,
        offsets=offsets,
        links=tuple(links),
        closed=tuple(closed),
        unknowns=np.array(list(rows.unknowns.values()), dtype=np.int64),
        constants=tuple(name for name, _ in problem.constants),
        defined=tuple(rows.defined),
        texts=tuple(rows.texts),
        bounds=_collect(rows.variable_bounds, rows.first_variable, rows.variables),
        row_bounds=_collect(rows.row_bounds, rows.first_row, rows.rows),
        unstaged=np.zeros(0, dtype=np.int64) if isinstance(chain, Chain) else chain,
        program=add(summands, further, chain if isinstance(chain, Chain) else None),
    )


def _keep(own: Transcription) -> PhasedTranscription:
    """Return the program of one phase without links as it is."""
    nothing = np.zeros(0, dtype=np.int64)
    return PhasedTranscription(
        phases=(own,),
        offsets=place_summands([own.program]),
        links=(),
        closed=(nothing,),
        unknowns=own.layout.unknowns,
        constants=(),
        defined=(),
        texts=(),
        bounds=(np.zeros(0), np.zeros(0)),
        row_bounds=(np.zeros(0), np.zeros(0)),
        unstaged=nothing,
        program=own.program,
    )


def _find_given_loops(link: Link, same: bool, target: Transcription, dependent: int) -> Indices:
    """Return the rows that would close loops at a start whose state a link gives, so that they are closed already."""
    if not same or link.map or link.velocities:
        return np.zeros(0, dtype=np.int64)
    closing = target.rows.start_closure
    return closing if link.impact is None else closing[:dependent]


def _find_given_contacts(problem: PhasedProblem, plants: Plants, link: int, target: Transcription) -> Indices:
    """Return the rows that would hold contacts at a start, of contacts that stand by the link already."""
    rows = target.rows.extras.contacts_at_start
    return rows[find_standing(problem, plants, link)] if rows.size else rows


def _collect(bounds: Sequence[tuple[Indices, float, float]], first: int, last: int) -> tuple[Array, Array]:
    """Return lower and upper bounds."""
    lower, upper = np.zeros(last - first), np.zeros(last - first)
    for found, least, most in bounds:
        lower[found - first], upper[found - first] = least, most
    return lower, upper
