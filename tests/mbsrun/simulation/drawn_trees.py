"""Random trees of joints with rigid stops and dry friction, as texts of model files."""

from __future__ import annotations

import numpy as np


def draw_tree(seed: int, size: int = 4) -> str:
    """Draw a tree of joints with stops and dry friction."""
    rng = np.random.default_rng(seed)
    text = "name: drawn\ngravity: [0.5, 0, -9.81]\nbodies:\n"
    for i in range(size):
        axis = rng.normal(size=3)
        kind = rng.choice(["revolute", "prismatic"])
        options = f"type: {kind}, axis: {axis.round(4).tolist()}, actuated: false"
        options += f", position: {(0.3 * rng.normal(size=3)).round(3).tolist()}"
        if rng.random() < 0.7:
            options += f", limits: [{-rng.uniform(0.2, 0.6):.4f}, {rng.uniform(0.2, 0.6):.4f}]"
            options += f", stops: {{restitution: {rng.choice([0, 0.3, 0.7, 1])}}}"
        if rng.random() < 0.6:
            torque = rng.uniform(0.1, 2)
            stribeck = f", stribeck: {rng.uniform(0.05, 0.3):.3f}" if rng.random() < 0.5 else ""
            options += f", friction: {{torque: {torque:.4f}, static: {torque * rng.uniform(1, 1.5):.4f}{stribeck}}}"
        parent = f"b{rng.integers(max(0, i - 2), i)}" if i else "base"
        text += f"  - name: b{i}\n    parent: {parent}\n    joint: {{{options}}}\n    mass: {rng.uniform(0.5, 2):.3f}\n"
        text += f"    com: {(0.2 * rng.normal(size=3)).round(3).tolist()}\n    inertia: [0.03, 0.04, 0.05]\n"
    return text
