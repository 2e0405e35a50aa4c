"""What a search has tried: every attempt, and the best motion found for each task, in one SQLite file.

Each attempt is committed as it ends, so that a search that was stopped goes on where it was.
"""

from __future__ import annotations

import io
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from mbsgen.errors import Fault, InputError
from mbsrun.ocp.trajectory import Trajectory

FORMAT = "mbsrun record 1"
SAME = 1e-6  # relative difference of costs within which two optima are one

_TABLES = """
create table about (format text, study text);
create table attempts (
  place_i integer, place_j integer, inputs real, input_rates real, representation text, part text, guess text,
  status text, iterations integer, cpu_seconds real, cpu_seconds_evaluating real, cost real,
  primary key (place_i, place_j, inputs, input_rates, representation, part, guess));
create table best (
  place_i integer, place_j integer, inputs real, input_rates real, representation text, cost real, motion blob,
  primary key (place_i, place_j, inputs, input_rates, representation));
"""


@dataclass(frozen=True)
class Task:
    """One target, with one cost, in one representation."""

    place: tuple[int, int]  # of the target on its grid
    weights: tuple[float, float]  # of the inputs, and of their rates
    representation: str

    @property
    def row(self) -> tuple[int, int, float, float, str]:
        """Give what identifies it in a table."""
        return (*self.place, *self.weights, self.representation)


@dataclass(frozen=True)
class Attempt:
    """A solve of a task."""

    task: Task
    part: str  # of a protocol
    guess: str  # what it started from
    status: str
    iterations: int
    cpu_seconds: float
    cpu_seconds_evaluating: float
    cost: float | None  # None: no solution


class Record:
    """The file, open."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection

    def find(self, task: Task, part: str, guess: str) -> bool:
        """Tell whether something was tried."""
        query = f"select 1 from attempts where {_IS_TASK} and part = ? and guess = ?"
        return self._connection.execute(query, (*task.row, part, guess)).fetchone() is not None

    def add(self, attempt: Attempt, motion: Trajectory | None) -> bool:
        """Keep an attempt, and its motion if it is the best of its task by more than rounding; tell whether it is."""
        task, best = attempt.task, self.best_cost(attempt.task)
        is_better = motion is not None and attempt.cost is not None
        if is_better and best is not None:
            is_better = attempt.cost is not None and attempt.cost < best - SAME * abs(best)
        with self._connection:
            row = (*task.row, attempt.part, attempt.guess, attempt.status, attempt.iterations)
            numbers = (attempt.cpu_seconds, attempt.cpu_seconds_evaluating, attempt.cost)
            self._connection.execute("insert into attempts values (?,?,?,?,?,?,?,?,?,?,?,?)", (*row, *numbers))
            if is_better and motion is not None:
                values = (*task.row, attempt.cost, _pack(motion))
                self._connection.execute("insert or replace into best values (?,?,?,?,?,?,?)", values)
        return is_better

    def best_cost(self, task: Task) -> float | None:
        """Give the lowest cost found for a task."""
        found = self._connection.execute(f"select cost from best where {_IS_TASK}", task.row).fetchone()
        return None if found is None else float(found[0])

    def best_motion(self, task: Task) -> Trajectory | None:
        """Give the motion of lowest cost."""
        found = self._connection.execute(f"select motion from best where {_IS_TASK}", task.row).fetchone()
        return None if found is None else _unpack(found[0])

    def attempts(self) -> Iterator[Attempt]:
        """List what was tried, in order."""
        for row in self._connection.execute("select * from attempts order by rowid"):
            yield Attempt(Task((row[0], row[1]), (row[2], row[3]), row[4]), *row[5:])


_IS_TASK = "place_i = ? and place_j = ? and inputs = ? and input_rates = ? and representation = ?"


@contextmanager
def open_record(path: Path, study: str) -> Iterator[Record]:
    """Open the record of a study, or begin one. Raises InputError for a file that is something else."""
    try:
        connection = sqlite3.connect(path)
    except sqlite3.Error as error:
        raise _refuse(path, f"cannot be opened: {error}", "check the path") from None
    try:
        _check(connection, path, study)
        yield Record(connection)
    except sqlite3.Error as error:
        raise _refuse(path, f"cannot be used as a record: {error}", "give another file") from None
    finally:
        connection.close()


def _check(connection: sqlite3.Connection, path: Path, study: str) -> None:
    """Begin an empty file; demand of others that they are of this study."""
    if not connection.execute("select count(*) from sqlite_master").fetchone()[0]:
        with connection:
            connection.executescript(_TABLES)
            connection.execute("insert into about values (?, ?)", (FORMAT, study))
    about = connection.execute("select format, study from about").fetchone()
    if about is None or about[0] != FORMAT:
        raise _refuse(path, "it is no record of this version", "give another file")
    if about[1] != study:
        raise _refuse(path, "it is the record of another problem, or of another model", "give another file")


def _refuse(path: Path, finding: str, remedy: str) -> InputError:
    return InputError([Fault(str(path), 0, "", finding, remedy)])


def _pack(motion: Trajectory) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **{field.name: getattr(motion, field.name) for field in fields(Trajectory)})
    return file.getvalue()


def _unpack(blob: bytes) -> Trajectory:
    with np.load(io.BytesIO(blob), allow_pickle=False) as arrays:
        return Trajectory(**{field.name: arrays[field.name] for field in fields(Trajectory)})
