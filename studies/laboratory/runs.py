"""Run the trials of the laboratory, keep their findings, and write tables.

An exception in a trial is a finding of this run, and is not kept: the next run tries again.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import asdict, fields, replace
from functools import cache
from pathlib import Path

import mbsrun
from mbsrun.library import find_compiler
from mbsrun.measuring.sections import Cell, Table, write_table
from mbsrun.measuring.store import Store
from mbsrun.models import fingerprint_generator
from studies.laboratory.case import Case, Finding, Loss, Report, Trial, Verdict, Workspace, demand, judge

KEPT = ("findings.jsonl", "losses.jsonl")
MODELS = "models"


def open_workspace(folder: Path) -> Workspace:
    """Prepare the folder of a run. Raises CompileError without a compiler."""
    return Workspace(folder / MODELS, Store(folder / KEPT[1], Loss), _fingerprint())


def run_cases(cases: Sequence[Case], folder: Path, report: Report, *, quick: bool = False) -> list[Finding]:
    """Run cases; earlier findings of the same program are read from the folder. `quick` leaves long trials out."""
    workspace = open_workspace(folder)
    store = Store(folder / KEPT[0], Finding)
    jobs = [(case, trial) for case in cases for trial in case.trials if not (quick and trial.is_long)]
    findings: list[Finding] = []
    for done, (case, trial) in enumerate(jobs):
        report(f"{case.id} {case.title}: {trial.name}", done, len(jobs))
        findings += _run_trial(case, trial, workspace, store)
    return findings


def _run_trial(case: Case, trial: Trial, workspace: Workspace, store: Store[Finding]) -> list[Finding]:
    def measure() -> list[Finding]:
        found = trial.measure(workspace)
        assert found, "it found nothing"
        return [replace(x, case=case.id, trial=trial.name) for x in found]

    try:
        return store.find_or_measure((workspace.program, case.id, trial.name), measure)
    except Exception as error:  # any error: the other trials go on
        broken = demand("the trial itself", "end", False, f"{type(error).__name__}: {error}")
        return [replace(broken, case=case.id, trial=trial.name)]


def write_findings(cases: Sequence[Case], findings: Sequence[Finding], folder: Path) -> list[Path]:
    """Write verdicts and findings as CSV, and as JSON with title, columns, rows and note; verdicts as Markdown too."""
    titles = {case.id: case.title for case in cases}
    verdicts: list[tuple[Cell, ...]] = [
        (
            x.case,
            titles[x.case],
            x.way,
            x.quantity,
            x.value,
            x.bound,
            x.trial,
            x.met,
            x.total,
            name_verdict(x),
            x.remark,
        )
        for x in judge(findings)
    ]
    columns = ("case", "title", "way", "quantity", "value", "bound", "trial", "met", "of", "verdict", "remark")
    note = "; ".join(f"{case.id}: {case.criterion}" for case in cases)
    title = "Where methods fail: verdicts by formulation, method or representation"
    rows = tuple(sorted(verdicts, key=lambda row: str(row[0])))
    paths = write_table(Table(title, columns, rows, note), folder, "verdicts")
    names = [field.name for field in fields(Finding)]
    order = ("case", "trial", *(name for name in names if name not in ("case", "trial")))
    listed = tuple(tuple(asdict(finding)[name] for name in order) for finding in findings)
    note = "The value must not exceed its bound. Without a bound, the value is information, or no number decides."
    paths.append(folder / "verdicts.md")
    paths[-1].write_text(_write_markdown(cases, findings), encoding="utf-8")
    return paths + write_table(Table("All findings of the laboratory", order, listed, note), folder, "findings")


def _write_markdown(cases: Sequence[Case], findings: Sequence[Finding]) -> str:
    """Write each case with its criterion, and a row for each way."""
    lines, verdicts = ["# Verdicts", ""], judge(findings)
    for case in cases:
        lines += [f"## {case.id}: {case.title}", "", f"{case.setup} *Demanded:* {case.criterion}", ""]
        if case.exemption:
            lines += [f"*Does not apply:* {case.exemption}", ""]
        own = [x for x in verdicts if x.case == case.id]
        if own:
            lines += ["| way | closest to its bound | value | bound | in | met | |", "|---|---|---|---|---|---|---|"]
        for x in own:
            number, bound = ("" if v is None else f"{v:.2g}" for v in (x.value, x.bound))
            cells = (x.way, x.quantity, number, bound, x.trial, f"{x.met} of {x.total}", name_verdict(x))
            lines.append("| " + " | ".join(cells) + " |")
        lines += [""] if own else []
    return "\n".join(lines)


def name_verdict(verdict: Verdict) -> str:
    """Return the verdict in words; a way that is known to fail has to fail."""
    if verdict.is_contrast:
        return "fails, as known" if verdict.is_met else "does not fail"
    return "met" if verdict.is_met else "not met"


@cache
def _fingerprint() -> str:
    """Return a hash of everything that findings depend on: both packages, the laboratory, and the compiler."""
    digest = hashlib.sha256(fingerprint_generator())
    for module in (mbsrun.__file__, __file__):
        for file in sorted(Path(module).parent.rglob("*.py")):
            digest.update(hashlib.sha256(file.read_bytes()).digest())
    compiler = find_compiler(os.environ)
    digest.update(repr((compiler.command, compiler.flags, compiler.macros)).encode())
    return digest.hexdigest()
