"""The muscles of a model along a given motion: signals, tensions by activation, and slopes of lengths.

A muscle with a rigid tendon pulls with T0 + a T1 at the activation a. The tension of an elastic tendon is a signal,
and T1 is its tension where the signal is 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbsgen.expressions import Name, parse
from mbsgen.manifest import Manifest
from mbsrun.kernel import ArgumentError, Kernels

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Muscles:
    """The muscles of a model."""

    names: tuple[str, ...]
    signals: tuple[str, ...]  # their activations, then forces of elastic tendons
    elastic: tuple[str, ...]  # muscles with elastic tendons
    places: tuple[int, ...]  # among the force elements


@dataclass(frozen=True, eq=False)
class Pull:
    """The tensions of muscles along a motion, T0 + a T1, and the slopes of their lengths."""

    passive: Array  # (K, m)
    active: Array  # (K, m): more of it at full activation
    slopes: Array  # (K, m, n), by velocities


def list_muscles(manifest: Manifest) -> Muscles:
    """List the muscles. Raises ArgumentError where there are none, or one does not read signals that are its own."""
    elements = () if manifest.appearance is None else manifest.appearance.elements
    found = [(k, x.name, x.muscle) for k, x in enumerate(elements) if x.muscle is not None]
    if not found:
        raise ArgumentError(f"{manifest.model} has no muscles; give it some, with type: muscle under forces")
    given = {name: (fibres.activation, fibres.tendon_state) for _, name, fibres in found}
    signals = [text for pair in zip(*given.values(), strict=True) for text in pair if text]
    for name, texts in given.items():
        if not all(isinstance(parse(text), Name) for text in texts if text):
            raise ArgumentError(f"the activation of {name} is no signal; let it be the name of one")
    if len(set(signals)) < len(signals):
        raise ArgumentError("two muscles have one activation; give each its own signal")
    elastic = tuple(name for name, (_, force) in given.items() if force)
    return Muscles(tuple(given), tuple(signals), elastic, tuple(k for k, *_ in found))


def measure_pull(kernels: Kernels, muscles: Muscles, q: Array, qd: Array, w: Array) -> Pull:
    """Compute the tensions of muscles, and the slopes of their lengths, along a motion (K, ...)."""
    manifest, places = kernels.manifest, list(muscles.places)
    labels = manifest.inputs[len(manifest.actuated) :]
    w = w.copy()
    tensions = []
    for level in (0.0, 1.0):
        w[:, [labels.index(name) for name in muscles.signals]] = level
        tensions.append(kernels("tensions", q=q, qd=qd, w=w)["tension"].reshape(len(w), -1)[:, places])
    slopes = [
        kernels("stretches", q=q, qd=np.tile(row, (len(w), 1)))["stretch"].reshape(len(w), -1)[:, places]
        for row in np.eye(qd.shape[1])
    ]
    return Pull(tensions[0], tensions[1] - tensions[0], np.stack(slopes, axis=2))
