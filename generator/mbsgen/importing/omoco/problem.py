"""A study's bounds and goals -> a problem file, and notices of the goals that have no counterpart."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from mbsgen.documents import abbreviate, nearest
from mbsgen.importing.findings import Findings
from mbsgen.importing.markup import Element
from mbsgen.importing.omoco.muscles import write_muscles
from mbsgen.importing.omoco.study import FREE, Range, Study, Variable, find_text, list_within, match_pattern
from mbsgen.importing.omoco.turning import warn_of_bounds, warn_of_goal

_ALL = ("enabled", "weight", "mode", "divide_by_duration", "MocoConstraintInfo", "scale_factors")
_CONSTRAINTS = ("MocoPeriodicityGoal", "MocoInitialForceEquilibriumDGFGoal")  # by default
_PLAIN = re.compile(r"[A-Za-z_][\w.]*")
_WORDS = ("null", "true", "false", "yes", "no", "on", "off", "y", "n")  # of YAML


@dataclass
class _Parts:
    """The lines of a problem."""

    running: list[str] = field(default_factory=list)
    terminal: list[str] = field(default_factory=list)
    track: list[str] = field(default_factory=list)
    references: list[str] = field(default_factory=list)
    pairs: dict[str, str] = field(default_factory=dict)  # coordinates and states at the start by those at the end
    speeds: dict[str, str] = field(default_factory=dict)
    conditions: list[str] = field(default_factory=list)
    constraints: list[str] = field(default_factory=list)


class Goals:
    """Reads the goals of a study."""

    def __init__(self, study: Study, findings: Findings) -> None:
        self._study, self._findings, self.parts = study, findings, _Parts()
        self._controls = [x for x in study.variables.values() if x.kind in ("control", "excitation")]
        self._states = [x for x in study.variables.values() if x.kind not in ("control", "excitation")]

    def read(self) -> _Parts:
        """Read all goals; goals that are not read get a warning each."""
        readers: Mapping[str, tuple[Callable[[Element, float], None], tuple[str, ...]]] = {
            "MocoControlGoal": (self._add_effort, ("control_weights", "control_weights_pattern", "exponent")),
            "MocoSumSquaredStateGoal": (self._add_squares, ("state_weights", "pattern")),
            "MocoFinalTimeGoal": (self._add_time, ()),
            "MocoMarkerFinalGoal": (self._add_place, ("point_name", "reference_location")),
            "MocoStateTrackingGoal": (self._track_states, ("reference", "state_weights", "pattern")),
            "MocoMarkerTrackingGoal": (self._track_markers, ("markers_reference",)),
            "MocoPeriodicityGoal": (self._add_period, ("state_pairs", "control_pairs")),
            "MocoInitialForceEquilibriumDGFGoal": (self._balance_tendons, ()),
        }
        for goal in self._study.goals:
            if find_text(goal, "enabled").lower() == "false":
                self._findings.tell(goal, "it is switched off in the file: left out")
            elif goal.tag not in readers:
                self._findings.warn(goal, "this goal has no counterpart that is written here: left out")
            elif find_text(goal, "mode") == "endpoint_constraint" and goal.tag not in _CONSTRAINTS:
                self._findings.warn(goal, "a goal as a constraint is not read: left out")
            else:
                reader, own = readers[goal.tag]
                self._name_rest(goal, own)
                reader(goal, self._number(goal, "weight", 1.0))
        return self.parts

    def _name_rest(self, goal: Element, own: Sequence[str]) -> None:
        for child in goal.children:
            known = child.tag in (*_ALL, *own) or child.attributes.get("name") in own
            if not known and (child.children or child.text not in ("", "false")):
                self._findings.warn(child, "this setting of a goal is not read: the goal stands without it")
        scaled = goal.first("scale_factors")
        if scaled is not None and scaled.children:
            self._findings.warn(scaled, "scale factors are not read: the goal has its plain weight")

    # --- goals -------------------------------------------------------------------------------------------------------

    def _add_effort(self, goal: Element, weight: float) -> None:
        exponent = self._number(goal, "exponent", 2.0)
        if exponent != int(exponent) or int(exponent) % 2 or not 2 <= exponent <= 16:
            self._findings.warn(goal, f"an exponent of {exponent:g} is not read, only even ones: left out")
            return
        weights = self._weigh(goal, "control_weights", self._controls, pattern="control_weights_pattern")
        for x in self._controls:
            self._run(goal, weight * weights.get(x.path, 1.0), f"({x.text})**{int(exponent)}")

    def _add_squares(self, goal: Element, weight: float) -> None:
        chosen, weights = self._choose(goal), self._weigh(goal, "state_weights", self._states)
        self._warn_of_rates(goal, [x for x in chosen if weights.get(x.path, 1.0)])
        for x in chosen:
            self._run(goal, weight * weights.get(x.path, 1.0), f"({x.text})**2")

    def _add_time(self, goal: Element, weight: float) -> None:
        begin = self._study.grid.start
        own = weight / 1.0
        if _is_true(goal, "divide_by_duration"):
            self._findings.warn(goal, "a time over itself is constant: left out")
            return
        self.parts.terminal.append(f"{{expression: {_quote(f'T + {begin!r}' if begin else 'T')}, weight: {own!r}}}")

    def _add_place(self, goal: Element, weight: float) -> None:
        name = self._find_sensor(goal, find_text(goal, "point_name").rsplit("/", 1)[-1])
        child = goal.first("reference_location")
        place: tuple[float, ...] = (0.0, 0.0, 0.0)
        if child is not None:
            place = self._findings.numbers(child, "reference_location", place, attributes={child.tag: child.text})
        if name is None:
            return
        squares = " + ".join(f"({k}_{name} - {x!r})**2" for k, x in zip("xyz", place, strict=True))
        share = f"({squares})/T" if _is_true(goal, "divide_by_duration") else squares
        self.parts.terminal.append(f"{{expression: {_quote(share)}, weight: {weight!r}}}")

    def _track_states(self, goal: Element, weight: float) -> None:
        table = self._open_table(goal, "reference")
        if table is None:
            return
        file, columns = table
        weights, chosen = self._weigh(goal, "state_weights", self._states), self._choose(goal)
        tracked = [x for x in chosen if x.path in columns]
        if not tracked:
            self._findings.warn(goal, f"{abbreviate(file)} has no column of a state: left out")
            return
        if _is_true(goal, "scale_weights_with_range"):
            self._findings.warn(goal, "weights by ranges are not read: the goal stands without them")
        self._warn_of_rates(goal, [x for x in tracked if weights.get(x.path, 1.0)])
        reference = f"states_{len(self.parts.references) + 1}"
        names = {x.path: f"column_{k}" for k, x in enumerate(tracked, 1)}
        shown = ", ".join(f"{own}: {_quote(path)}" for path, own in names.items())
        self._refer(reference, file, f", columns: {{{shown}}}")
        for x in tracked:
            text = f"({x.text} - ref_{reference}_{names[x.path]})**2"
            self._run(goal, weight * weights.get(x.path, 1.0), text)

    def _track_markers(self, goal: Element, weight: float) -> None:
        held = next((x for x in goal.children if x.tag in ("markers_reference", "MarkersReference")), None)
        inner = None if held is None else (held if held.first("marker_file") else held.first("MarkersReference"))
        file = "" if inner is None else find_text(inner, "marker_file")
        if inner is None or not file:
            self._findings.warn(goal, "it names no file of markers: left out")
            return
        default = self._number(inner, "default_weight", 1.0)
        given = next((x for x in inner.children if x.attributes.get("name") == "marker_weights"), None)
        weights = {
            x.attributes.get("name", ""): self._number(x, "weight", default)
            for x in (() if given is None else list_within(given))
        }
        sensors = [x.name for x in self._study.imported.model.frames if x.is_sensor]
        labels = self._study.imported.labels
        known = {labels.get(name, name): name for name in sensors}
        chosen = [name for name in weights if name in known] or [*known]
        for name in weights:
            if name not in known:
                self._findings.warn(goal, f"there is no marker {abbreviate(name)} in the model: left out")
        if not chosen:
            self._findings.warn(goal, "the model has no markers: left out")
            return
        reference = f"markers_{len(self.parts.references) + 1}"
        self._refer(reference, file, "")
        shown = ", ".join(f"{_quote(known[name])}: {_quote(name)}" for name in chosen)
        own = ", ".join(f"{_quote(known[x])}: {weights[x]!r}" for x in chosen if weights.get(x, default) != 1)
        more = f", weights: {{{own}}}" if own else ""
        self.parts.track.append(f"{{reference: {reference}, markers: {{{shown}}}, weight: {weight!r}{more}}}")

    def _add_period(self, goal: Element, _: float) -> None:
        if self._is_cost(goal):
            return
        for kind, known in (("state_pairs", self._states), ("control_pairs", self._controls)):
            paths = {x.path: x for x in known}
            for pair in list_within(goal.first(kind)):
                first = find_text(pair, "initial_variable")
                last = find_text(pair, "final_variable") or first
                reasons = [why for x in (first, last) if (why := self._study.find_reason(x))]
                if reasons:
                    self._findings.warn(pair, f"{reasons[0]}: the pair is left out")
                    continue
                missing = [x for x in (first, last) if x not in paths]
                for path in missing:
                    meant = nearest(path, list(paths))
                    remedy = f"did you mean {abbreviate(meant)}?" if meant else "give the path of a variable"
                    self._findings.fault(pair, f"there is no variable {abbreviate(path)}", remedy)
                if not missing:
                    self._warn_of_rates(pair, [paths[first], paths[last]])
                    self._pair(paths[first], paths[last], -1 if _is_true(pair, "negate") else 1)

    def _balance_tendons(self, goal: Element, _: float) -> None:
        """Name the equilibrium of elastic tendons at the start, which holds anyway."""
        if not self._is_cost(goal):
            self._findings.tell(goal, "elastic tendons begin in equilibrium without it")

    def _is_cost(self, goal: Element) -> bool:
        """Return whether a goal that is a constraint here is a cost in the file; with a warning."""
        is_cost = find_text(goal, "mode") == "cost"
        if is_cost:
            self._findings.warn(goal, "this goal as a cost is not read: left out")
        return is_cost

    def _pair(self, first: Variable, last: Variable, sign: int) -> None:
        """Make a variable at the end equal to another one at the start, or to its opposite."""
        slope, rest = sign * last.slope / first.slope, (sign * last.offset - first.offset) / first.slope
        text = f"{slope!r}*{_strip(last.name)}" if slope != 1 else _strip(last.name)
        text = text if rest == 0 else f"{text} + {rest!r}"
        if first.kind == "speed":
            self.parts.speeds[first.own] = text
        elif first.kind in ("control", "excitation"):
            shown = f"end_{last.name} - ({1 / slope!r})*start_{first.name}"
            self.parts.conditions.append(f"{{expression: {_quote(shown)}, range: [0, 0]}}")
        else:
            self.parts.pairs[first.own if first.kind == "value" else first.name] = text

    # --- parts -------------------------------------------------------------------------------------------------------

    def _warn_of_rates(self, goal: Element, used: Sequence[Variable]) -> None:
        warn_of_goal(goal, used, self._study, self._findings)

    def _run(self, goal: Element, weight: float, text: str) -> None:
        if weight:
            share = f"{text}/T" if _is_true(goal, "divide_by_duration") else text
            name = _quote(goal.attributes.get("name", "") or goal.tag)
            self.parts.running.append(f"{{expression: {_quote(share)}, weight: {weight!r}}}  # {name}")

    def _choose(self, goal: Element) -> list[Variable]:
        """Return the states that the pattern of a goal matches, if it has one."""
        text = find_text(goal, "pattern")
        if not text:
            return self._states
        found = match_pattern(text, [x.path for x in self._states])
        if found is None:
            self._findings.warn(goal, f"the pattern {abbreviate(text)} is not read: it is taken for all states")
            return self._states
        return [x for x in self._states if x.path in found]

    def _weigh(
        self, goal: Element, name: str, known: Sequence[Variable], pattern: str | None = None
    ) -> dict[str, float]:
        """Return the weights of variables that a goal names; a fault for others."""
        paths, weights = [x.path for x in known], dict[str, float]()
        for key in (pattern, name):
            held = next((x for x in goal.children if key and (x.attributes.get("name") == key or x.tag == key)), None)
            for given in list_within(held):
                path, weight = given.attributes.get("name", ""), self._number(given, "weight", 1.0)
                matched = match_pattern(path, paths) if key == pattern else [path]
                for own in matched or []:
                    if own in paths:
                        weights[own] = weight
                    elif reason := self._study.find_reason(own):
                        self._findings.warn(given, f"{reason}: its weight is left out")
                    else:
                        meant = nearest(own, paths)
                        remedy = f"did you mean {abbreviate(meant)}?" if meant else "give the path of a variable"
                        self._findings.fault(given, f"there is no variable {abbreviate(own)}", remedy)
        return weights

    def _open_table(self, goal: Element, name: str) -> tuple[str, list[str]] | None:
        """Return the file of a table, and its columns; None with a warning."""
        held = next((x for x in goal.children if x.attributes.get("name") == name or x.tag == name), None)
        inner = held.first("TableProcessor") if held is not None and held.first("filepath") is None else held
        file = "" if inner is None else find_text(inner, "filepath")
        if inner is None or not file:
            self._findings.warn(goal, "it names no table: left out")
            return None
        for operator in list_within(inner.first("operators")):
            self._findings.warn(operator, "this change of the table is not made: change the file")
        path = (self._study.folder / file).resolve()
        if not path.is_relative_to(self._study.folder.resolve()) or not path.is_file():
            self._findings.warn(goal, f"there is no {abbreviate(file)} in the folder of the study: left out")
            return None
        return file, _list_columns(path)

    def _refer(self, name: str, file: str, more: str) -> None:
        start = f", start: {self._study.grid.start!r}"  # else a recording begins with the motion
        self.parts.references.append(f"  {name}: {{file: {_quote(file)}{start}{more}}}")

    def _find_sensor(self, goal: Element, name: str) -> str | None:
        labels = self._study.imported.labels
        known = {labels.get(x.name, x.name): x.name for x in self._study.imported.model.frames}
        if name in known:
            return re.sub(r"\W", "_", known[name], flags=re.ASCII)
        meant = nearest(name, list(known))
        remedy = f"did you mean {abbreviate(meant)}?" if meant else "name a marker of the model"
        self._findings.fault(goal, f"there is no marker {abbreviate(name)}", remedy)
        return None

    def _number(self, element: Element, tag: str, default: float) -> float:
        child = element.first(tag)
        if child is None or not child.text:
            return default
        return self._findings.number(child, tag, default, {tag: child.text})


def write_problem(study: Study, model: str, findings: Findings) -> str:
    """Write the problem file of a study over a model file. Raises InputError where goals name what is not there."""
    parts = Goals(study, findings).read()
    warn_of_bounds(study, findings)
    if findings.faults:
        raise findings.refuse()
    if not (parts.running or parts.terminal or parts.track):
        findings.sum_up("no goal is left: any motion within the bounds is a solution")
    lines = [*_write_grid(study, model), *_write_ends(study, parts), *_write_bounds(study)]
    muscles, narrower = write_muscles(study, findings)
    if muscles:
        lines.append(muscles)
        parts.constraints += narrower
    if parts.references:
        lines += ["references:", *parts.references]
    lines.append("cost:" if parts.running or parts.terminal or parts.track else "cost: {inputs: 0}")
    for key, rows in (("running", parts.running), ("terminal", parts.terminal), ("track", parts.track)):
        lines += [f"  {key}:", *(f"    - {row}" for row in rows)] if rows else []
    if parts.constraints:
        lines += ["constraints:", *(f"  - {row}" for row in parts.constraints)]
    lines += _write_link(study, parts)
    grid = study.grid
    most = f", max_iterations: {grid.iterations}" if grid.iterations else ""
    lines.append(f"solver: {{tolerance: {grid.tolerance!r}{most}}}")
    return "".join(f"{line}\n" for line in lines)


def _write_grid(study: Study, model: str) -> Iterator[str]:
    grid = study.grid
    yield f"# {study.name}, a study of OpenSim Moco".encode("unicode_escape").decode("ascii")
    yield f"model: {_quote(model)}"
    low, high = grid.duration
    assert low is not None, "durations are given"
    assert high is not None, "durations are given"
    if low == high:
        yield f"horizon: {low!r}"
    else:
        least = max(low, 1e-3 * high)
        yield f"horizon: {{guess: {(least + high) / 2!r}, range: [{least!r}, {high!r}]}}"
    steps = grid.intervals
    yield f"intervals: {steps if isinstance(steps, int) else [*steps]}"
    yield f"scheme: {grid.scheme}"
    yield f"degree: {grid.degree}"
    yield f"inputs: {grid.inputs}"


def _write_ends(study: Study, parts: _Parts) -> Iterator[str]:
    """Write values at the start and at the end, and collect ranges as constraints."""
    is_periodic = bool(parts.pairs or parts.speeds or parts.conditions)
    rows: dict[str, dict[str, list[str]]] = {"start": {}, "end": {}}
    for x in study.variables.values():
        for end in rows:
            bounds = x.invert(getattr(x.limits, end))
            is_fixed = bounds != FREE and bounds[0] == bounds[1]
            key = {"value": "pose", "speed": "velocity"}.get(x.kind)
            if key is not None and is_fixed and not (is_periodic and end == "start"):
                rows[end].setdefault(key, []).append(f"{_quote(x.own)}: {bounds[0]!r}")
                continue
            if key is not None and end == "start" and not is_periodic:
                rows[end].setdefault(key, []).append(f"{_quote(x.own)}: null")
            if bounds != FREE:
                parts.constraints.append(f"{{expression: {x.name}, range: {_show(bounds)}, at: {end}}}")
    for end, held in rows.items():
        if held or (end == "start" and not is_periodic):
            yield f"{end}:"
            if end == "start" and "pose" not in held:
                yield "  pose: {}"
            for key, entries in held.items():
                yield f"  {key}: {{{', '.join(entries)}}}"


def _write_bounds(study: Study) -> Iterator[str]:
    yield "bounds:"
    for kind, key in (("value", "coordinates"), ("speed", "velocities"), ("control", "inputs")):
        rows = [
            f"{_quote(x.own)}: {_show(x.invert(x.limits.whole))}"
            for x in study.variables.values()
            if x.kind == kind and x.limits.whole != FREE
        ]
        if rows:
            yield f"  {key}: {{{', '.join(rows)}}}"


def _write_link(study: Study, parts: _Parts) -> Iterator[str]:
    if not (parts.pairs or parts.speeds or parts.conditions):
        return
    yield "links:"
    values = {x.own: parts.pairs.get(x.own) for x in study.variables.values() if x.kind == "value"}
    values |= {k: x for k, x in parts.pairs.items() if k not in values}
    values |= {
        x.name: None
        for x in study.variables.values()
        if x.kind in ("activation", "tendon") and x.name not in parts.pairs
    }
    speeds = {x.own: parts.speeds.get(x.own) for x in study.variables.values() if x.kind == "speed"}
    for key, held, head in (("map", values, "  - "), ("velocities", speeds, "    ")):
        shown = ", ".join(f"{_quote(k)}: {'null' if x is None else _quote(x)}" for k, x in held.items())
        yield f"{head}{key}: {{{shown}}}"
    if parts.conditions:
        yield "    conditions:"
        yield from (f"      - {row}" for row in parts.conditions)


def _list_columns(path: Path) -> list[str]:
    """Return the names of the columns of a table of OpenSim."""
    with path.open(encoding="utf-8", errors="replace") as file:
        is_below = False
        for _, line in zip(range(200), file, strict=False):
            if is_below and line.strip():
                return line.strip().split("\t") if "\t" in line else line.split()
            is_below = is_below or line.strip().lower() == "endheader"
    return []


def _is_true(element: Element, tag: str) -> bool:
    return find_text(element, tag).lower() in ("true", "1")


def _strip(name: str) -> str:
    """Return the name that links have for a coordinate, a velocity or a state."""
    return re.sub(r"^qd?_", "", name)


def _show(bounds: Range) -> str:
    low, high = ("null" if x is None or math.isinf(x) else repr(x) for x in bounds)
    return f"[{low}, {high}]"


def _quote(text: str) -> str:
    return text if _PLAIN.fullmatch(text) and text.lower() not in _WORDS else json.dumps(text)
