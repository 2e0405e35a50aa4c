"""Fusion: the same procedure in fewer stages, without what no result needs.

Straight stages move as far forward as their wires allow, and neighbours are joined, so that what they share is computed
once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby

from mbsgen.procedure.procedure import Procedure
from mbsgen.procedure.sheet import Sheet
from mbsgen.procedure.stages import Stage
from mbsgen.procedure.straight import Straight
from mbsgen.tape.builder import Scalar
from mbsgen.tape.replay import replay, replay_guards


def fuse(procedure: Procedure) -> Procedure:
    """Drop dead stages and results, and join straight stages."""
    return drop_dead(_join_neighbours(_advance(drop_dead(procedure))))


def drop_dead(procedure: Procedure) -> Procedure:
    """Remove the stages, and their wires, that no result needs. Guards of the other stages stay."""
    needed = {wire.name for wire in procedure.outputs}
    kept: list[Stage] = []
    for stage in reversed(procedure.stages):
        given = frozenset(wire.name for wire in stage.gives) & needed
        if given:
            left = stage.keep(given)
            kept.append(left)
            needed |= {wire.name for wire in left.reads}
    return replace(procedure, stages=tuple(reversed(kept)))


def _advance(procedure: Procedure) -> Procedure:
    """Order the stages: all straight ones whose wires are known, then all others, and so on."""
    known = {wire.name for wire in procedure.inputs}
    rest, order = list(procedure.stages), list[Stage]()
    while rest:
        ready = [stage for stage in rest if known.issuperset(wire.name for wire in stage.reads)]
        straight = [stage for stage in ready if isinstance(stage, Straight)]
        taken = straight or ready
        order += taken
        known |= {wire.name for stage in taken for wire in stage.gives}
        rest = [stage for stage in rest if stage not in taken]
    return replace(procedure, stages=tuple(order))


def _join_neighbours(procedure: Procedure) -> Procedure:
    stages: list[Stage] = []
    for _, run in groupby(procedure.stages, lambda stage: isinstance(stage, Straight)):
        group = list(run)
        straight = [stage for stage in group if isinstance(stage, Straight)]
        stages += [_join(straight, procedure)] if len(straight) > 1 else group
    return replace(procedure, stages=tuple(stages))


def _join(stages: Sequence[Straight], procedure: Procedure) -> Straight:
    sheet = Sheet()
    known: dict[str, Sequence[Scalar]] = {}
    own = {stage.name for stage in stages}
    read = {wire.name for s in procedure.stages if s.name not in own for wire in s.reads}
    needed = read | {wire.name for wire in procedure.outputs}
    for stage in stages:
        given = {wire.name: known[wire.name] if wire.name in known else sheet.take(wire) for wire in stage.reads}
        values = replay(stage.tape, sheet.builder, given)
        replay_guards(stage.tape, sheet.builder, values)
        for wire, output in zip(stage.gives, stage.tape.outputs, strict=True):
            known[wire.name] = [values[v] for v in output.values]
            if wire.name in needed:
                sheet.give(wire, known[wire.name])
    tape = sheet.finish(stages[0].name)
    return Straight(replace(tape, guards=tuple(dict.fromkeys(tape.guards))))  # one may come from several stages
