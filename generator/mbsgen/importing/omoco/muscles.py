"""Excitations, activations and states of tendons of a study -> `muscles` of a problem, and constraints along the path.

The section `muscles` has the activation dynamics of most muscles, and the other ones under `own`. It has one range: the
smallest one that holds the ranges of all excitations and activations; a muscle with a narrower range gets a
constraint. Without bounds in the study, an activation has the range of its excitation, as in Moco.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator

from mbsgen.expressions import write
from mbsgen.importing.findings import Findings
from mbsgen.importing.omoco.study import FREE, Lag, Range, Study, Variable

_USUAL = (0.0, 1.0)  # of excitations without bounds
_SHARED = (
    "its muscles of De Groote have different time constants, as here; in one process of OpenSim 4.6 all have the ones "
    "of the first muscle that is computed"
)
_TENDON = (0.0, 5.0)  # of the states of tendons, in every problem with `muscles`


def write_muscles(study: Study, findings: Findings) -> tuple[str, list[str]]:
    """Return the section of muscles, and a constraint of each variable whose range is narrower; "" without muscles."""
    found = [x for x in study.variables.values() if x.kind in ("excitation", "activation", "tendon")]
    excitations = {x.own: x for x in found if x.kind == "excitation"}
    if not excitations:
        return "", []
    ranges = [(x, _find_range(x, excitations)) for x in found]
    driven = [bounds for x, bounds in ranges if x.kind != "tendon"]
    lows, highs = [low for low, _ in driven if low is not None], [high for _, high in driven if high is not None]
    widest = min(lows, default=_USUAL[0]), max(highs, default=_USUAL[1])
    rows = list[str]()
    for x, bounds in ranges:
        outer = _TENDON if x.kind == "tendon" else widest
        _name_narrower(x, bounds, outer, findings)
        rows += _narrow(x, bounds, outer)
    smooth = {x for x in study.lags.values() if x is not None and not x.sharp}
    if len(smooth) > 1:
        findings.sum_up(_SHARED)
    counts = Counter(study.lags.values())
    most = max(counts, key=counts.__getitem__)
    names = {write(x.muscle.activation): x.name for x in study.imported.model.forces if x.muscle is not None}
    own = [f"{json.dumps(names[x])}: {{{_write_lag(lag)}}}" for x, lag in study.lags.items() if lag != most]
    parts = [f"excitation: [{widest[0]!r}, {widest[1]!r}]", _write_lag(most), "effort: 0"]
    parts += [f"own: {{{', '.join(own)}}}"] if own else []
    return f"muscles: {{{', '.join(x for x in parts if x)}}}", rows


def _write_lag(lag: Lag | None) -> str:
    if lag is None:
        return ""
    return f"rise: {lag.rise!r}, fall: {lag.fall!r}{', sharp: true' if lag.sharp else ''}"


def _find_range(variable: Variable, excitations: dict[str, Variable]) -> Range:
    """Return the range of a variable, of an activation by its excitation if it has none."""
    whole = variable.limits.whole
    if variable.kind == "activation" and whole == FREE and variable.own in excitations:
        return excitations[variable.own].limits.whole
    return whole


def _name_narrower(variable: Variable, bounds: Range, outer: tuple[float, float], findings: Findings) -> None:
    """Warn where the problem's range is narrower than the study's."""
    low, high = bounds
    is_open = variable.limits.whole != FREE or variable.kind == "excitation"
    is_narrower = (low is None or low < outer[0]) or (high is None or high > outer[1])
    if is_open and is_narrower and variable.origin is not None:
        what = "state of its tendon" if variable.kind == "tendon" else variable.kind
        findings.warn(variable.origin, f"the {what} stays between {outer[0]:g} and {outer[1]:g} in the problem")


def _narrow(variable: Variable, bounds: Range, outer: tuple[float, float]) -> Iterator[str]:
    low, high = bounds
    own = low if low is not None and low > outer[0] else None, high if high is not None and high < outer[1] else None
    if own != FREE:
        low_text, high_text = ("null" if x is None else repr(x) for x in own)
        yield f"{{expression: {variable.name}, range: [{low_text}, {high_text}]}}"
