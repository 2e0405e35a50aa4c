"""`mbsrun sweep --over` and `--cases`: a problem file and values of its keys -> an outcome for each, in a record."""

from __future__ import annotations

import csv
import itertools
import math
import multiprocessing
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich import box
from rich.table import Table

from mbsgen.errors import Fault, InputError
from mbsgen.expressions import FLOATS, ExpressionError, evaluate, parse
from mbsrun.commands.console import print_table, say, show_progress
from mbsrun.ocp.cases.cases import Case, CaseSolver, read, solve_cases
from mbsrun.ocp.cases.dispatch import solve_elsewhere
from mbsrun.ocp.cases.layers import Start, find_starts, keep_paths
from mbsrun.ocp.cases.neighbours import Origin, follow, solve_beside, solve_neighbours
from mbsrun.ocp.cases.told import Told, name_case, read_told, tell, write_told
from mbsrun.ocp.searching.cluster import open_client
from mbsrun.ocp.searching.multistart import end_at_interrupt
from mbsrun.ocp.solution.record import open_record
from mbsrun.optimal.control import read_problem
from mbsrun.optimal.many import Family, Values, list_places
from mbsrun.recordings.tables import read_cells

MANY_CASES = 100_000
SHOWN = 30  # cases that are printed one by one
Value = float | int | str
COLUMNS = ("status", "cost", "iterations", "cpu_seconds", "defect", "remark")


@dataclass(frozen=True)
class Wish:
    """The cases and the limits of a command."""

    over: tuple[tuple[str, str], ...]  # keys and their values, as text; cases are all combinations
    cases: Path | None  # a table with a column for each key and a row for each case
    threads: int
    workers: int  # processes; 0: this one
    minutes: float
    folder: Path | None  # for the solutions
    scheduler: str | None = None  # the address of a Dask cluster, in place of threads and workers
    neighbours: bool = False  # cases start from each other's solutions


def sweep_cases(file: Path, record: Path, wish: Wish) -> bool:
    """Solve all cases that the record does not know, write tables and pictures; return whether each has a solution."""
    family = read_problem(file).family
    values = read_table(wish.cases) if wish.cases is not None else list_grid(wish.over)
    found = _solve(file, family, values, record, wish)
    _write_table(values, found, record.with_name(f"{record.name}.csv"))
    written = [f"{record}", f"{record}.csv"]
    if picture := _draw(values, found, family.name):
        picture(record.with_name(f"{record.name}.png"))
        written.append(f"{record}.png")
    if wish.folder is not None:
        written.append(f"{_write_solutions(found, wish.folder)} files in {wish.folder}")
    _print(values, found)
    say(f"wrote {', '.join(written)}")
    missing = len(values) - len(found)
    if missing:
        say(f"{missing} cases are not solved yet; repeat the command to continue")
    return not missing and all(told.is_good for told in found.values())


# --- cases ---


def list_grid(over: Sequence[tuple[str, str]]) -> tuple[Values, ...]:
    """List all combinations of values, the last key fastest. Raises BadParameter."""
    keys = [key for key, _ in over]
    if twice := next((key for key in keys if keys.count(key) > 1), None):
        raise click.BadParameter(f"{twice} is given twice; give all its values at once", param_hint="--over")
    columns = [read_values(key, text) for key, text in over]
    count = math.prod(map(len, columns))
    if count > MANY_CASES:
        raise click.BadParameter(f"{count} cases; give at most {MANY_CASES}", param_hint="--over")
    return tuple(dict(zip(keys, row, strict=True)) for row in itertools.product(*columns))


def read_values(key: str, text: str) -> list[Value]:
    """Read FROM:TO:COUNT, or values with commas between them: expressions, or names. Raises BadParameter."""
    parts = text.split(":")
    if len(parts) == 1:
        return [_read_value(part) for part in text.split(",")]
    try:
        ends = [evaluate(parse(part), {}, FLOATS) for part in parts[:2]]
        count = int(parts[2]) if len(parts) == 3 else 0
        if not 1 <= count <= MANY_CASES or not all(map(math.isfinite, ends)):
            raise ValueError
    except (ExpressionError, ValueError):
        told = f"{key}: found {text!r}; give FROM:TO:COUNT, or values with commas between them"
        raise click.BadParameter(told, param_hint="--over") from None
    return [_spell_whole(x) for x in np.linspace(ends[0], ends[1], count).tolist()]


def _read_value(text: str) -> Value:
    """Read a number, an expression of numbers, or a name."""
    try:
        return _spell_whole(evaluate(parse(text.strip()), {}, FLOATS))
    except ExpressionError:
        return text.strip()


def _spell_whole(x: float) -> Value:
    """Return a whole number as one: keys that count take no others."""
    return int(x) if x.is_integer() and abs(x) < 2**53 else x


def read_table(path: Path) -> tuple[Values, ...]:
    """Read a table with keys on top; an empty cell leaves the problem's own value. Raises InputError."""
    _, rows = read_cells(path)
    if len(rows) < 2 or len(rows) - 1 > MANY_CASES:
        remedy = f"give keys on top, and 1 to {MANY_CASES} cases below"
        raise InputError([Fault(str(path), 0, "", f"found {max(0, len(rows) - 1)} cases", remedy)])
    top, labels = rows[0]
    keys = [key.strip() for key in labels]
    faults = [
        Fault(str(path), number, "", f"found {len(row)} cells", f"give {len(keys)}, one for each key")
        for number, row in rows[1:]
        if len(row) != len(keys)
    ]
    if faults or len(set(keys)) < len(keys):
        raise InputError(faults or [Fault(str(path), top, "", "a key is given twice", "give each key one column")])
    return tuple(
        {key: _read_value(cell) for key, cell in zip(keys, row, strict=True) if cell.strip()} for _, row in rows[1:]
    )


# --- solving ---


def _solve(file: Path, family: Family, values: Sequence[Values], path: Path, wish: Wish) -> dict[int, Told]:
    """Solve the cases that the record does not know, until the time is over or an interrupt comes."""
    cases = family.list_cases(values, check=True)
    names = [name_case(case, family.plants) for case in cases]
    keys, found = [f"{name}, from neighbours" if wish.neighbours else name for name in names], dict[int, Told]()
    begun, ends = time.monotonic(), list[bool]()
    with open_record(path, keys[0]) as record, show_progress() as show, end_at_interrupt(lambda: ends.append(True)):
        for k, key in enumerate(keys):
            if (text := record.recall(key)) is not None:
                found[k] = read_told(text)
        left = [k for k in range(len(cases)) if k not in found]
        show("solving", len(found), len(cases))
        with closing(_outcomes(file, family, values, cases, left, wish)) as outcomes:
            for number, told in outcomes:
                found[number] = told
                record.keep(keys[number], write_told(told))
                show(f"solving; {sum(x.cost is not None for x in found.values())} solved", len(found), len(cases))
                if ends or time.monotonic() - begun > 60 * wish.minutes:
                    break
    return dict(sorted(found.items()))


Outcomes = Iterator[tuple[int, Told]]


def _outcomes(
    file: Path, family: Family, values: Sequence[Values], cases: Sequence[Case], left: Sequence[int], wish: Wish
) -> Any:
    """Yield the number and the outcome of each case that is left, as it ends."""
    if not left:
        return
    if wish.neighbours:
        yield from _outcomes_beside(file, family, values, cases, left, wish)
    elif wish.scheduler is not None:
        with open_client(0, wish.scheduler) as client:
            for k, told in solve_elsewhere(client, family.plants, [cases[k] for k in left]):
                yield left[k], told
    elif wish.workers == 0:
        for k, outcome in solve_cases([cases[k] for k in left], family.plants, wish.threads):
            yield left[k], tell(outcome)
    else:
        with _open_pool(file, wish.workers) as pool:
            under_way = {pool.submit(_solve_there, values[k]): k for k in left}
            for future in as_completed(under_way):
                yield under_way[future], future.result()


def _outcomes_beside(
    file: Path, family: Family, values: Sequence[Values], cases: Sequence[Case], left: Sequence[int], wish: Wish
) -> Outcomes:
    """Solve in layers of all cases. The ones that the record knows are solved again where others start from them."""
    starts = keep_paths(find_starts(list_places(values, cases)), left)
    asked = set(left)
    if wish.workers == 0:
        for k, outcome in solve_neighbours(cases, starts, family.plants, wish.threads):
            if k in asked:
                yield k, tell(read(outcome))
        return
    with _open_pool(file, wish.workers) as pool:
        for k, told in follow(
            starts, lambda start, origin: pool.submit(_solve_beside, values[start.case], start, origin)
        ):
            if k in asked:
                yield k, told


@contextmanager
def _open_pool(file: Path, workers: int) -> Iterator[ProcessPoolExecutor]:
    """Start processes that solve cases of a problem; cases that have not begun are dropped at the end."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, initializer=_begin, initargs=(file,)) as pool:
        try:
            yield pool
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


_HERE: dict[str, Any] = {}  # of a process that solves cases: the problem, and its solver


def _begin(file: Path) -> None:
    family = read_problem(file).family
    _HERE.update(family=family, solver=CaseSolver(family.plants))


def _solve_there(values: Values) -> Told:
    (case,) = _HERE["family"].list_cases([values], check=True)
    return tell(_HERE["solver"].solve(case))


def _solve_beside(values: Values, start: Start, origin: Origin | None) -> tuple[Told, Origin]:
    (case,) = _HERE["family"].list_cases([values], check=True)
    outcome, own = solve_beside(_HERE["solver"], case, start, origin)
    return tell(outcome), own


# --- results ---


def _list_keys(values: Sequence[Values]) -> list[str]:
    return list(dict.fromkeys(key for case in values for key in case))


def _remark(told: Told) -> str:
    return told.reason or "; ".join(told.short)


def _write_table(values: Sequence[Values], found: Mapping[int, Told], path: Path) -> None:
    """Write a row for each case that ended."""
    keys = _list_keys(values)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["case", *keys, *COLUMNS])
        for k, told in found.items():
            numbers = (told.cost, told.iterations, told.cpu_seconds, told.defect)
            texts = ["" if x is None else repr(x) for x in numbers]
            writer.writerow([k, *(values[k].get(key, "") for key in keys), told.status, *texts, _remark(told)])


def _write_solutions(found: Mapping[int, Told], folder: Path) -> int:
    """Write the file of each solution, by the number of its case; return how many."""
    folder.mkdir(parents=True, exist_ok=True)
    texts = {k: told.solution for k, told in found.items() if told.packed}
    for k, text in texts.items():
        (folder / f"{k:05d}.json").write_text(text, encoding="utf-8")
    return len(texts)


def _print(values: Sequence[Values], found: Mapping[int, Told]) -> None:
    keys, table = _list_keys(values), Table(box=box.SIMPLE)
    for column in ("case", *keys, "cost", "iterations", "CPU s", "defect"):
        table.add_column(column, justify="right")
    table.add_column("status")
    chosen = [*found.items()]
    if len(chosen) > SHOWN:
        chosen = [(k, told) for k, told in chosen if not told.is_good][:SHOWN]
    for k, told in chosen:
        own = [_spell(values[k].get(key)) for key in keys]
        numbers = (_spell(told.cost, 8), str(told.iterations), f"{told.cpu_seconds:.3f}", _spell(told.defect, 2))
        table.add_row(str(k), *own, *numbers, told.status if told.is_good else f"{told.status}: {_remark(told)}")
    if chosen:
        print_table(table)
    costs = [told.cost for told in found.values() if told.cost is not None]
    spread = f", cost {min(costs):.8g} to {max(costs):.8g}" if costs else ""
    short = sum(told.cost is not None and not told.is_good for told in found.values())
    falls = f", {short} of them fall short" if short else ""
    click.echo(f"{len(costs)} of {len(values)} cases solved{falls}{spread}")


def _spell(value: Any, digits: int = 6) -> str:
    return "-" if value is None else f"{value:.{digits}g}" if isinstance(value, float) else str(value)


def _draw(values: Sequence[Values], found: Mapping[int, Told], name: str) -> Callable[[Path], None] | None:
    """Return what draws the cost over one key, or over two; None where keys are no numbers or more than two."""
    from mbsrun.ocp.showing.pictures import plot_cases

    keys = [key for key in _list_keys(values) if len({case.get(key) for case in values}) > 1]
    columns = [[values[k].get(key) for k in found] for key in keys]
    is_drawn = 1 <= len(keys) <= 2 and all(isinstance(x, float | int) for column in columns for x in column)
    if not is_drawn:
        return None
    costs = np.array([math.nan if told.cost is None else told.cost for told in found.values()])
    places = dict(zip(keys, (np.array(column, dtype=np.float64) for column in columns), strict=True))
    return lambda path: plot_cases(name, places, costs, path)
