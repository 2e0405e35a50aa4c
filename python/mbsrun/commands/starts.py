"""`mbsrun simulate --starts`: a table, or random numbers -> a motion for each row, with a table and arrays of all."""

from __future__ import annotations

import csv
import json
import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from mbsgen.errors import Fault, InputError
from mbsgen.expressions import FLOATS, ExpressionError, evaluate, parse
from mbsgen.manifest import Manifest
from mbsrun.closure import OpenError
from mbsrun.commands.console import list_written, say, show_progress
from mbsrun.external import Mechanism
from mbsrun.motions import Motions, simulate_many
from mbsrun.quantities import list_quantities
from mbsrun.quaternions import normalise
from mbsrun.recordings.tables import read_cells
from mbsrun.simulation.closing import Start, close_start
from mbsrun.simulation.course import is_constrained, place_driven
from mbsrun.simulation.motion import Halt
from mbsrun.simulation.record import describe_settings
from mbsrun.simulation.statement import Statement

Array = NDArray[np.float64]

FORMAT = "mbsrun simulations 1"
SUMMARY, TABLE, ARRAYS = "simulation.json", "starts.csv", "motions.npz"
MANY = 1_000_000  # starts
SHOWN = 10  # motions that end early, and are printed


@dataclass(frozen=True)
class Wish:
    """The options of a command."""

    starts: str  # a number, or the path of a table
    vary: tuple[str, ...]  # NAME=LOW:HIGH
    seed: int
    threads: int


def simulate_starts(mechanism: Mechanism, statement: Statement, wish: Wish, out: Path) -> bool:
    """Simulate all starts, write and print what they give; return whether all motions reach their end."""
    names, rows = _read(wish, mechanism)
    q, qd, open_ones = _lay(mechanism, statement, names, rows)
    own = {name: rows[:, k] for k, name in enumerate(names) if name in mechanism.parameters}
    begun = time.process_time()
    with show_progress() as report:

        def show(done: int) -> None:
            report("integrating", done, len(q))

        motions = simulate_many(
            *(mechanism, statement.drive, q, qd, statement.settings),
            parameters=own,
            threads=wish.threads,
            show=show,
            course=statement.course,
        )
    halts = [
        Halt(0.0, None, open_ones[k], "start elsewhere") if k in open_ones else x for k, x in enumerate(motions.halts)
    ]
    motions = replace(motions, halts=tuple(halts))
    _print(motions, time.process_time() - begun)
    out.mkdir(parents=True, exist_ok=True)
    _write_table(motions, names, rows, out / TABLE)
    _write_arrays(motions, names, rows, out / ARRAYS)
    (out / SUMMARY).write_text(_summarise(motions), encoding="utf-8")
    say(f"wrote {list_written(out, (SUMMARY, TABLE, ARRAYS))}")
    return bool(motions.is_complete.all())


# --- starts ---


def _list_known(mechanism: Mechanism) -> dict[str, tuple[str, int]]:
    """List what may differ between starts: coordinates and velocities by their names in expressions; parameters."""
    manifest = mechanism.manifest
    held = {"q": place_driven(manifest), "qd": list(manifest.driven)}
    states = {
        name: (x.kind, x.index)
        for name, x in list_quantities(manifest).items()
        if x.kind in held and x.index not in held[x.kind]
    }
    return dict.fromkeys(mechanism.parameters, ("", 0)) | states


def _read(wish: Wish, mechanism: Mechanism) -> tuple[tuple[str, ...], Array]:
    """Return the names of numbers that differ, and a row of them for each start. Raises InputError, UsageError."""
    known = _list_known(mechanism)
    if not wish.starts.isdecimal():
        if wish.vary:
            raise click.UsageError("--vary draws numbers; with a table of starts, leave it out")
        return _read_table(Path(wish.starts), known)
    count = int(wish.starts)
    if not 1 <= count <= MANY:
        raise click.BadParameter(f"{count} starts; give 1 to {MANY}", param_hint="--starts")
    if not wish.vary:
        raise click.UsageError("--starts N draws numbers: give --vary NAME=LOW:HIGH, or a table of starts")
    ranges = [_read_range(text, known) for text in wish.vary]
    names = tuple(name for name, _, _ in ranges)
    if len(set(names)) < len(names):
        raise click.BadParameter("a name is given twice", param_hint="--vary")
    low, high = (np.array([x[k] for x in ranges]) for k in (1, 2))
    return names, np.random.default_rng(wish.seed).uniform(low, high, (count, len(names)))


def _read_range(text: str, known: dict[str, tuple[str, int]]) -> tuple[str, float, float]:
    """Read NAME=LOW:HIGH. Raises BadParameter."""
    name, _, ends = text.rpartition("=")
    if name.strip() not in known:
        raise click.BadParameter(f"{name.strip() or text!r}: there are {', '.join(known)}", param_hint="--vary")
    try:
        low, high = (evaluate(parse(part), {}, FLOATS) for part in ends.split(":"))
        if not (math.isfinite(low) and math.isfinite(high) and low <= high):
            raise ValueError
    except (ExpressionError, ValueError):
        raise click.BadParameter(f"found {text!r}; give NAME=LOW:HIGH, LOW first", param_hint="--vary") from None
    return name.strip(), low, high


def _read_table(path: Path, known: dict[str, tuple[str, int]]) -> tuple[tuple[str, ...], Array]:
    """Read a table with names on top, and a number in each cell. Raises InputError with all faults."""
    _, lines = read_cells(path)
    if not 2 <= len(lines) <= MANY + 1:
        remedy = f"give names on top, and 1 to {MANY} starts below"
        raise InputError([Fault(str(path), 0, "", f"found {max(0, len(lines) - 1)} starts", remedy)])
    top, cells = lines[0]
    names = tuple(cell.strip() for cell in cells)
    faults = [
        Fault(str(path), top, "", f"{name or 'an empty cell'} names nothing", f"there are {', '.join(known)}")
        for name in names
        if name not in known
    ]
    if len(set(names)) < len(names):
        faults.append(Fault(str(path), top, "", "a name is given twice", "give each name one column"))
    rows = np.zeros((len(lines) - 1, len(names)))
    for k, (number, line) in enumerate(lines[1:]):
        try:
            values = [evaluate(parse(cell), {}, FLOATS) for cell in line]
            if len(values) != len(names) or not all(map(math.isfinite, values)):
                raise ValueError
            rows[k] = values
        except (ExpressionError, ValueError):
            finding = f"found {', '.join(line)!s:.60}"
            faults.append(Fault(str(path), number, "", finding, f"give {len(names)} numbers, one for each name"))
    if faults:
        raise InputError(faults[:SHOWN])
    return names, rows


def _lay(
    mechanism: Mechanism, statement: Statement, names: Sequence[str], rows: Array
) -> tuple[Array, Array, dict[int, str]]:
    """Return starts (N, nq), (N, n), closed, and the findings on starts that stay open."""
    manifest, known, start = mechanism.manifest, _list_known(mechanism), statement.start
    q, qd = (np.tile(x, (len(rows), 1)) for x in (start.q, start.qd))
    given: dict[str, set[int]] = {"q": set(), "qd": set()}
    for k, name in enumerate(names):
        kind, index = known[name]
        if kind:
            (q if kind == "q" else qd)[:, index] = rows[:, k]
            given[kind].add(index)
    q = normalise(q, manifest)
    findings: dict[int, str] = {}
    if not is_constrained(manifest):
        return q, qd, findings
    placed, moving = start.placed | given["q"], start.moving | given["qd"]
    for k, row in enumerate(rows):
        own = {name: float(x) for name, x in zip(names, row, strict=True) if name in mechanism.parameters}
        kernels = mechanism.with_parameters(**own) if own else mechanism
        try:
            q[k], qd[k], _ = close_start(kernels, Start(start.base, q[k], qd[k], placed, moving), statement.course)
        except OpenError as error:
            q[k], findings[k] = np.nan, str(error)
    return q, qd, findings


# --- results ---


def _list_columns(manifest: Manifest) -> list[str]:
    units = {c.name: c.unit for c in manifest.coordinates}
    return [
        *(f"q[{x}] [{units.get(x, '-')}]" for x in manifest.positions),
        *(f"qd[{name}] [{unit}/s]" for name, unit in units.items()),
    ]


def _write_table(motions: Motions, names: Sequence[str], rows: Array, path: Path) -> None:
    """Write a line for each start: its numbers, how its motion ended, the last state, energies."""
    times, q, qd = motions.ends
    header = ["start", *names, "status", "t [s]", *_list_columns(motions.kernels.manifest)]
    header += ["energy at the start [J]", "energy at the end [J]"]
    numbers = np.hstack((times[:, None], q, qd, motions.measure_energy())).tolist()
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        for k, (row, halt) in enumerate(zip(rows.tolist(), motions.halts, strict=True)):
            writer.writerow([k, *row, "complete" if halt is None else str(halt), *numbers[k]])


def _write_arrays(motions: Motions, names: Sequence[str], rows: Array, path: Path) -> None:
    manifest = motions.kernels.manifest
    np.savez(
        path,
        t=motions.t,
        q=motions.q,
        qd=motions.qd,
        given=rows,
        complete=motions.is_complete,
        names=np.array(names, dtype=np.str_),
        positions=np.array(manifest.positions, dtype=np.str_),
        velocities=np.array([c.name for c in manifest.coordinates], dtype=np.str_),
    )


def _summarise(motions: Motions) -> str:
    manifest = motions.kernels.manifest
    summary = {
        "format": FORMAT,
        "complete": int(motions.is_complete.sum()),
        "starts": len(motions),
        "halts": {k: asdict(halt) for k, halt in enumerate(motions.halts) if halt is not None},
        "model": manifest.model,
        "model_hash": manifest.model_hash,
        "parameters": dict(motions.kernels.parameters),
        "settings": describe_settings(motions.settings),
        "coordinates": [c.name for c in manifest.coordinates],
    }
    return json.dumps(summary, indent=1, ensure_ascii=False) + "\n"


def _print(motions: Motions, seconds: float) -> None:
    settings = describe_settings(motions.settings)
    energy = motions.measure_energy()
    change = energy[:, 1] - energy[:, 0]
    known = change[np.isfinite(change)]
    rows = {
        "model": f"{motions.kernels.manifest.model}, {len(motions.kernels.manifest.coordinates)} coordinates",
        "method": f"{settings['method']}, {settings['formulation']}",
        "reached": f"{motions.settings.duration:.6g} s by {motions.is_complete.sum()} of {len(motions)} motions",
        "kept": f"{motions.t.size} states of each",
        "energy": f"changes by {known.min():.4g} to {known.max():.4g} J" if known.size else "unknown",
        "time": f"{seconds:.3g} s of processor, {1e6 * seconds / len(motions):.3g} us a motion",
    }
    for name, text in rows.items():
        click.echo(f"{name:<14}{text}")
    early = [k for k, halt in enumerate(motions.halts) if halt is not None]
    for k in early[:SHOWN]:
        say(f"start {k}: {motions.halts[k]}")
    if len(early) > SHOWN:
        say(f"{len(early) - SHOWN} more motions end early; their statuses are in {TABLE}")
