"""The numbers of a manifest for pictures, at the present parameters of kernels: manifest, parameters -> manifest.

A manifest holds points, masses, shapes and laws of forces at the model's numbers, and formulas of the ones that depend
on parameters.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel

from mbsgen.expressions import FLOATS, ExpressionError, evaluate, names, parse, spell
from mbsgen.manifest import Appearance, Formula, Manifest, Mass
from mbsrun.ocp.ground.plant import Plant

Entry = TypeVar("Entry", bound=BaseModel)


def name_parameters(plant: Plant) -> dict[str, float]:
    """Return the parameters by their words in expressions; a path has _ for its dots."""
    present = plant.parameters
    return {new or old: present[old] for old, new in zip(present, spell([*present]), strict=True)}


def complete_appearance(plant: Plant) -> Appearance | None:
    """Return the appearance with the numbers of the present parameters, without bodies that have no mass."""
    found = plant.manifest.appearance
    if found is None or not found.formulas:
        return found
    found = _complete(found, found.formulas, plant)
    return found.model_copy(update={"masses": tuple(x for x in found.masses if _is_solid(x))})


def complete_manifest(plant: Plant) -> Manifest:
    """Return the manifest with the points of frames and loops, and the appearance, of the present parameters."""
    found = plant.manifest
    if found.formulas:
        found = _complete(found, found.formulas, plant)
    return found.model_copy(update={"appearance": complete_appearance(plant)})


def _complete(entry: Entry, formulas: Iterable[Formula], plant: Plant) -> Entry:
    """Put the values of formulas in their places; other names than parameters of these kernels cannot change."""
    values = name_parameters(plant)
    for formula in formulas:
        expression = parse(formula.text)
        if names(expression) <= values.keys():
            try:
                entry = _replace(entry, formula.place, evaluate(expression, values, FLOATS))
            except ExpressionError:
                entry = _replace(entry, formula.place, np.nan)  # it has no value there, and its force no arrow
    return entry


def _replace(entry: Any, place: Sequence[str | int], value: float) -> Any:
    """Return an entry of a manifest, or a tuple in it, with another number at a place."""
    if not place:
        return value
    key, *rest = place
    if isinstance(entry, BaseModel):
        return entry.model_copy(update={str(key): _replace(getattr(entry, str(key)), rest, value)})
    return tuple(_replace(x, rest, value) if k == key else x for k, x in enumerate(entry))


def _is_solid(mass: Mass) -> bool:
    return mass.mass > 0 and bool(np.isfinite((mass.mass, *mass.com, *mass.inertia)).all())
