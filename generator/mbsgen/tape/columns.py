"""A function whose last stage is a loop: many columns that one factorisation solves for, all in the same way.

Straight-line code of more than some 4000 operations does not fit into the first instruction cache of a processor, and
waits for instructions from then on. The columns of a Jacobian of accelerations are solved for by the same operations,
one as the other, and make most of a large tree's code: as a loop, they are a few lines, and several are computed at
once. It computes more, since it knows of no zeros in the columns.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mbsgen.tape.counts import Counts, count
from mbsgen.tape.types import Op, Sparsity, Tape

LANES = 16  # the width is a multiple of it: columns that the C computes together, MBS_LANES
LOWER, INVERSES, COLUMNS = "lower", "inverses", "columns"  # what the tape hands to the loop


@dataclass(frozen=True)
class Columns:
    """Blocks -M^-1 B, with M = LT D L, where L has a unit diagonal.

    Of the outputs of `tape`, the three above are for the loop: the entries of L below the diagonal, row by row, as
    `ancestors` places them; 1/D; and B by rows, of which the nonzeros are given. The others are results.
    """

    tape: Tape
    ancestors: tuple[tuple[int, ...], ...]  # of each row of L, the columns of its entries
    width: int  # of B, padded
    blocks: Mapping[str, int]  # result -> the column of B that its first one is

    @property
    def size(self) -> int:
        """Count the rows."""
        return len(self.ancestors)

    @property
    def starts(self) -> tuple[int, ...]:
        """Number the first entry of each row of L, and the end."""
        starts = [0]
        for row in self.ancestors:
            starts.append(starts[-1] + len(row))
        return tuple(starts)

    def places(self, result: str, pattern: Sparsity) -> tuple[int, ...]:
        """Tell where in B, by rows, the nonzeros of a result are."""
        return tuple(r * self.width + self.blocks[result] + c for r, c in pattern.entries)

    def solve(self, found: Mapping[str, Sequence[Any]]) -> list[list[Any]]:
        """Do what the loop does, in any number type: of what the tape gives, make the blocks, by rows."""
        entries = iter(found.get(LOWER, ()))
        lower = [[(i, next(entries)) for i in row] for row in self.ancestors]
        right: list[list[Any]] = [[0] * self.width for _ in range(self.size)]
        for (place, _), value in zip(self.tape.output(COLUMNS).sparsity.entries, found[COLUMNS], strict=True):
            right[place // self.width][place % self.width] = -value
        for k in reversed(range(self.size)):
            for i, entry in lower[k]:
                right[i] = [x - entry * y if y else x for x, y in zip(right[i], right[k], strict=True)]
        for k, (row, inverse) in enumerate(zip(right, found[INVERSES], strict=True)):
            right[k] = [inverse * x for x in row]
            for i, entry in lower[k]:
                right[k] = [x - entry * y if y else x for x, y in zip(right[k], right[i], strict=True)]
        return right

    def counts(self, nonzeros: int) -> Counts:
        """Count what is computed, with the columns that pad B; the results have so many nonzeros."""
        before = count(self.tape)
        entries = 2 * self.starts[-1] * self.width
        loop = {Op.MUL: entries + self.size * self.width, Op.SUB: entries, Op.NEG: nonzeros}
        return Counts(dict(Counter(before.operations) + Counter(loop)), before.equations, before.guards)


def pad(width: int) -> int:
    """Round up to a multiple of LANES."""
    return -(-width // LANES) * LANES
