"""Inputs at places of intervals, as parts of a program's variables: constant ones, and ones with values at the points.

    u(t_k + c h_k) = u_k,    or    sum over j of L_j(c) u_kj

with the basis polynomials L_j of the collocation points. At a point itself a value is one variable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbsrun.ocp.ground.functions import Array, Indices
from mbsrun.ocp.ground.program import Column, Combination


@dataclass(frozen=True)
class Group:
    """Some entries of a part of the variables: sums of weights times K values."""

    entries: tuple[int, ...]
    variables: Indices  # (places, K, entries)
    weights: Array  # (kinds, K)


def take_entries(part: Column, entries: Sequence[int]) -> Column:
    """Return some entries of a part of the variables."""
    chosen = list(entries)
    return part[chosen] if isinstance(part, np.ndarray) else replace(part, matrices=part.matrices[:, chosen])


def mix(size: int, groups: Sequence[Group], which: Indices) -> Column:
    """Return a part (size, places) of which groups give the entries; place k is of the kind which[k].

    Where each entry is one variable, the part is a choice of variables.
    """
    groups = [group for group in groups if group.entries]
    kinds, which = np.unique(which, return_inverse=True)
    weights = [group.weights[kinds] for group in groups]
    if all(((w == 1).sum(axis=1) == 1).all() and ((w != 0).sum(axis=1) == 1).all() for w in weights):
        part = np.zeros((size, which.size), dtype=np.int64)
        for group, w in zip(groups, weights, strict=True):
            node = w.argmax(axis=1)[which]
            part[list(group.entries)] = group.variables[np.arange(which.size), node].T
        return part
    matrices = []
    for group, w in zip(groups, weights, strict=True):
        identity = np.zeros((size, len(group.entries)))
        identity[list(group.entries), range(len(group.entries))] = 1.0
        whole = identity[None, :, None, :] * w[:, None, :, None]  # (kinds, size, K, entries)
        matrices.append(whole.reshape(len(kinds), size, -1))
    variables = [group.variables.reshape(which.size, -1) for group in groups]
    return Combination(np.concatenate(matrices, axis=2), which.astype(np.int64), np.concatenate(variables, axis=1))
