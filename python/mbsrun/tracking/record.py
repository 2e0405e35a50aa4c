"""The folder of a track: a row for each sample, a summary, plots, and the page that plays the true motion.

The same trial writes the same files, except for computing times.
"""

from __future__ import annotations

import csv
import io
import json
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mbsgen.manifest import Manifest
from mbsrun.animation import write_animation
from mbsrun.external import Mechanism
from mbsrun.ocp.problem.problem import Problem
from mbsrun.quaternions import find_rates
from mbsrun.tracking.analysis import Margin, Measured, Times, find_margins, measure_track
from mbsrun.tracking.loop import Track
from mbsrun.tracking.pictures import draw_times, draw_track, save

Array = NDArray[np.float64]

FORMAT = "mbsrun track 1"
TABLE, SUMMARY, PLOTS, TIMES, ANIMATION = "track.csv", "summary.json", "plots.png", "times.png", "animation.html"
FILES = (SUMMARY, TABLE, PLOTS, TIMES, ANIMATION)


@dataclass(frozen=True, eq=False)
class Report:
    """A track with its figures."""

    track: Track
    problem: Problem
    measured: tuple[Measured, ...]
    margins: tuple[Margin, ...]
    unmeasured: tuple[str, ...]  # constraints without a margin
    times: Times  # from a state to inputs
    preparing: Times
    statuses: tuple[tuple[str, int], ...]  # the controller's words, the most frequent first
    late: int  # samples whose computation took longer than a period
    violation: float  # of the constraints of a plan, the largest; NaN: no plan was found
    moved: int  # samples whose state was put within the controller's bounds
    rescues: int  # samples that solved, in place of steps in real time

    @property
    def is_met(self) -> bool:
        """Return whether the end was reached, every measure is small enough, and no range was left."""
        kept = all(margin.is_kept for margin in self.margins)
        return kept and self.track.is_complete and all(x.is_met for x in self.measured)


def report_track(track: Track, problem: Problem, plant: Mechanism) -> Report:
    """Compute the figures of a track."""
    samples = track.samples
    margins, left = find_margins(track, problem, plant)
    violations = [sample.decision.violation for sample in samples]
    return Report(
        track=track,
        problem=problem,
        measured=tuple(measure_track(track, plant)),
        margins=tuple(margins),
        unmeasured=tuple(left),
        times=Times.of([sample.decision.seconds for sample in samples]),
        preparing=Times.of([sample.preparing for sample in samples]),
        statuses=tuple(Counter(sample.decision.status for sample in samples).most_common()),
        late=sum(sample.decision.seconds > track.trial.period for sample in samples),
        violation=max((x for x in violations if x == x), default=np.nan),
        moved=sum(sample.is_moved for sample in samples),
        rescues=sum(sample.decision.is_rescue for sample in samples),
    )


def write_track(report: Report, plant: Mechanism, folder: Path) -> None:
    """Write the folder of a track; files of these names are replaced."""
    folder.mkdir(parents=True, exist_ok=True)
    track, manifest = report.track, plant.manifest
    (folder / SUMMARY).write_text(_summarise(report, plant), encoding="utf-8")
    (folder / TABLE).write_text(_tabulate(track, manifest), encoding="utf-8")
    save(draw_track(track, report.problem, report.measured, report.margins, plant), folder / PLOTS)
    save(draw_times(track, report.times), folder / TIMES)
    rates = find_rates(plant, track.q, track.qd)
    title = track.trial.name if track.halt is None else f"{track.trial.name}, incomplete: {track.halt}"
    moves = np.concatenate(([True], np.diff(track.t) > 0))
    t, q, qd = track.t[moves], track.q[moves], rates[moves]
    begun = np.searchsorted([sample.time for sample in track.samples], t, side="right") - 1
    acting = np.array([sample.acting for sample in track.samples])[np.maximum(begun, 0)]
    write_animation(
        folder / ANIMATION, plant, t, q, qd=qd, inputs=acting[:, : len(plant.manifest.actuated)], title=title
    )


def _summarise(report: Report, plant: Mechanism) -> str:
    track, trial, manifest = report.track, report.track.trial, plant.manifest
    usual = {p.name: p.value for p in (*manifest.parameters, *manifest.design)}
    iterations = [sample.decision.iterations for sample in track.samples]
    summary = {
        "format": FORMAT,
        "complete": track.is_complete,
        "met": report.is_met,
        "halt": None if track.halt is None else asdict(track.halt),
        "problem": trial.name,
        "model": manifest.model,
        "parameters": {name: x for name, x in plant.parameters.items() if usual[name] != x},
        "duration": trial.duration,
        "period": trial.period,
        "delay": trial.delay,
        "predict": trial.predicts,
        "fallback": trial.fallback.value,
        "seed": trial.noise.seed,
        "samples": len(track.samples),
        "failures": track.failures,
        "statuses": dict(report.statuses),
        "moved_into_bounds": report.moved,
        "violation": report.violation,
        "rescues": report.rescues,
        "late": report.late,
        "iterations": {"mean": float(np.mean(iterations)), "largest": max(iterations)},
        "seconds": asdict(report.times),
        "seconds_preparing": asdict(report.preparing),
        "first_seconds": track.first.seconds,
        "measures": {
            x.name: {"largest": x.largest, "rms": x.rms, "most": x.most, "met": x.is_met} for x in report.measured
        },
        "margins": {
            x.name: {"least": x.least, "time": x.time, "tolerated": x.tolerated, "kept": x.is_kept}
            for x in report.margins
        },
        "unmeasured": list(report.unmeasured),
        "energy_drift": track.drift,
        "end": {"t": float(track.t[-1]), "q": track.q[-1].tolist(), "qd": track.qd[-1].tolist()}
        | ({"states": track.states[-1].tolist()} if trial.states else {}),
    }
    return json.dumps(_finite(summary), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _finite(data: object) -> object:
    """Return data with null for numbers that are not finite, which JSON does not have."""
    if isinstance(data, dict):
        return {key: _finite(value) for key, value in data.items()}
    if isinstance(data, list):
        return [_finite(value) for value in data]
    return None if isinstance(data, float) and not np.isfinite(data) else data


def _tabulate(track: Track, manifest: Manifest) -> str:
    """Write a line for each sample, with every digit; names are bracketed, so that no cell begins like a formula."""
    velocities = [c.name for c in manifest.coordinates]
    inputs = [velocities[i] for i in manifest.actuated]
    header = ["t"]
    for kind, known in (("q", manifest.positions), ("qd", velocities)):
        header += [f"{kind}[{name}]" for name in known]
    header += [f"measured_q[{name}]" for name in manifest.positions]
    header += [f"measured_qd[{name}]" for name in velocities]
    header += [f"state[{name}]" for name in track.trial.states]
    for kind in ("", "acting_"):
        header += [f"{kind or 'u'}[{name}]".replace("_[", "[") for name in inputs]
        header += [f"{kind}control[{name}]" for name in track.trial.controls]
    header += ["status", "solved", "iterations", "seconds", "preparing", "violation"]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    for x in track.samples:
        measured = (x.measured_q, x.measured_qd, x.states)
        numbers = np.concatenate(([x.time], x.q, x.qd, *measured, x.u, x.acting)).tolist()
        decision = x.decision
        words = [decision.status, int(decision.is_solved), decision.iterations, decision.seconds, x.preparing]
        words.append(decision.violation)
        writer.writerow([*numbers, *words])
    return text.getvalue()
