"""Pairs of free bodies in contact: their forces at given places, and drawn mechanisms with such contacts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mbsgen.errors import InputError
from mbsgen.formulations import catalogue
from mbsgen.formulations.reductions import ALL
from mbsgen.model.changes.reduction import build_tree
from mbsgen.model.construction import body, free, make_model
from mbsgen.model.model import Contact, Model
from mbsgen.model.reader import read_model
from mbsgen.model.tree import Kind, Tree
from mbsgen.tape.interpreter import evaluate
from tests.fuzz import mechanisms

Array = NDArray[np.float64]
Data = dict[str, Any]


def read(text: str, folder: Path) -> Model:
    """Read a model file of this text."""
    file = folder / "model.yaml"
    file.write_text(text, encoding="utf-8")
    return read_model(file)


def check_fault(whole: str, old: str, new: str, path: str, finding: str, folder: Path) -> None:
    """Check that a change of a model file is one fault with its line, path, finding and remedy."""
    text = whole.replace(old, new, 1)
    assert text != whole
    with pytest.raises(InputError) as raised:
        read(text, folder)
    (fault,) = raised.value.faults
    assert (fault.path, finding in fault.finding, bool(fault.remedy)) == (path, True, True), str(fault)
    assert fault.line > 1


def make_pair(touch: Contact) -> Tree:
    """Two free bodies without weight: `a`, then `b`."""
    bodies = [body(name, free(), mass=2, inertia=(0.1, 0.1, 0.1)) for name in ("a", "b")]
    return build_tree(make_model("pair", bodies, gravity=(0, 0, 0), contacts=[touch]))


def call(tree: Tree, name: str, **given: Any) -> Mapping[str, Any]:
    tape = catalogue.FUNCTIONS[name].build(tree, ALL)
    runtime = [x.value for x in tree.parameters if x.kind is Kind.RUNTIME]
    known = {"p": runtime, "qdd": [0.0] * len(tree.joints), "u": [0.0] * sum(x.actuated for x in tree.joints), **given}
    return evaluate(tape, {i.name: [*map(float, known[i.name])] for i in tape.inputs})  # type: ignore[arg-type]


def press(tree: Tree, places: Array, velocities: Array) -> Array:
    """Return force and moment on `a`, and on `b`, in the axes of the base: bodies at places, without rotation."""
    q = np.concatenate([(*p, 0, 0, 0, 1) for p in places])
    still, moving = (np.array(call(tree, "impl", q=q, qd=qd)["Phi"]) for qd in (0 * velocities, velocities))
    m, I = 2.0, 0.1
    v, om = velocities.reshape(2, 2, 3)[:, 0], velocities.reshape(2, 2, 3)[:, 1]
    inertial = np.concatenate([(*(m * np.cross(w, x)), *np.cross(w, I * w)) for x, w in zip(v, om, strict=True)])
    assert still.shape == moving.shape
    return np.asarray((inertial - moving).reshape(2, 2, 3))


REST = np.zeros(12)


def find_drawn(folder: Path, accept: Callable[[Data], bool], side: str = "sphere") -> int:
    """Return the first seed of a mechanism that is accepted, with at most 3 bodies and such a contact with a side."""
    for seed in range(1000, 3000):
        drawn = mechanisms.draw(seed)
        found = any(side in touch and accept(touch) for touch in drawn.model.get("contacts", ()))
        if not found or len(drawn.model["bodies"]) > 3 or drawn.scene:
            continue
        try:
            build_tree(mechanisms.read(drawn, folder))
        except InputError:
            continue
        return seed
    raise AssertionError("no such mechanism is drawn")
