"""The record of searches: every attempt, and the best motions of each task, in one SQLite file.

An attempt is one transaction, on the disk before the next begins: a process that is killed loses its present attempt
alone. One file holds any number of studies. The file keeps one motion for a task, a protocol, a round and a number of
whole turns, if it is better than all motions of earlier rounds. So the starts of a round depend neither on the order of
attempts nor on interruptions. The file also keeps texts that follow from motions, such as certificates, by a hash of
all that they depend on.
"""

from __future__ import annotations

import io
import sqlite3
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from mbsgen.errors import Fault, InputError
from mbsrun.ocp.ground.trajectory import Trajectory

FORMAT = "mbsrun record 4"
BEFORE = "mbsrun record 3"  # without turns: it is converted to the present format when it is opened
SAME = 1e-6  # relative difference of costs within which two optima are one

Key = tuple[object, ...]  # of an attempt: task, protocol, part, guess

_TABLES = """
create table about (format text);
create table studies (id integer primary key, identity text unique, told text);
create table circumstances (id integer primary key, told text unique);
create table attempts (
  study integer, place_i integer, place_j integer, inputs real, input_rates real, representation text,
  protocol text, part text, guess text, round integer, status text, iterations integer, cpu_seconds real,
  cpu_seconds_evaluating real, cost real, defect real, variables integer, constraints integer,
  jacobian_nonzeros integer, hessian_nonzeros integer, turns text, circumstances integer,
  primary key (study, place_i, place_j, inputs, input_rates, representation, protocol, part, guess));
create table best (
  study integer, place_i integer, place_j integer, inputs real, input_rates real, representation text,
  protocol text, round integer, turns text, cost real, motion blob,
  primary key (study, place_i, place_j, inputs, input_rates, representation, protocol, round, turns));
"""
_ATTEMPTS_BEFORE = """study, place_i, place_j, inputs, input_rates, representation, protocol, part, guess, round,
  status, iterations, cpu_seconds, cpu_seconds_evaluating, cost, defect, variables, constraints, jacobian_nonzeros,
  hessian_nonzeros"""
_BEST_BEFORE = "study, place_i, place_j, inputs, input_rates, representation, protocol, round"


@dataclass(frozen=True)
class Task:
    """One target, with one cost, in one representation."""

    place: tuple[int, int]  # of the target on its grid
    weights: tuple[float, float]  # of the inputs, and of their rates
    representation: str

    @property
    def row(self) -> tuple[int, int, float, float, str]:
        """Return the columns that identify it in a table."""
        return (*self.place, *self.weights, self.representation)


@dataclass(frozen=True)
class Attempt:
    """A solve of a task."""

    task: Task
    protocol: str
    part: str  # of the protocol
    guess: str  # the name of its start
    round: int  # of the protocol, from 0
    status: str
    iterations: int
    cpu_seconds: float
    cpu_seconds_evaluating: float
    cost: float | None  # None: no solution
    defect: float | None = None  # the largest error of an interval, where the attempt was re-simulated
    variables: int | None = None  # of the program, where there is a solution
    constraints: int | None = None
    jacobian_nonzeros: int | None = None
    hessian_nonzeros: int | None = None  # of the triangle
    turns: str = ""  # whole turns of joints without limits from start to end, as `starts.count_turns` names them

    @property
    def key(self) -> Key:
        """Return the key of the attempt, which does not depend on its outcome."""
        return (*self.task.row, self.protocol, self.part, self.guess)


@dataclass(frozen=True)
class Best:
    """The lowest cost of a task, and the round that found it."""

    cost: float
    round: int
    turns: str = ""


class Record:
    """One study of an open file."""

    def __init__(self, connection: sqlite3.Connection, study: str, told: str = "") -> None:
        """Open a study of a file: `study` identifies it, `told` describes it for a reader."""
        self._connection, self.identity, self._told = connection, study, told
        found = connection.execute("select id from studies where identity = ?", (study,)).fetchone()
        self._study = _NONE if found is None else int(found[0])

    def of(self, study: str, told: str = "") -> Record:
        """Return another study of the same file."""
        return Record(self._connection, study, told)

    def find(self, key: Key) -> bool:
        """Return whether an attempt was made, by its key."""
        query = f"select 1 from attempts where {_IS_TASK} and protocol = ? and part = ? and guess = ?"
        return self._connection.execute(query, (self._study, *key)).fetchone() is not None

    def add(self, attempt: Attempt, motion: Trajectory | None, circumstances: str = "") -> bool:
        """Keep an attempt, and its motion if that is the best of its task so far; return whether it is.

        It is the best if no earlier round has a cost as low, to rounding, and no other attempt of its round has one as
        low at all. An attempt that was kept before is not kept twice.
        """
        return self._keep(attempt, None if motion is None else _pack(motion), circumstances)

    def restore(self, attempt: Attempt, circumstances: str = "") -> None:
        """Keep an attempt that was made elsewhere, without its motion: `put_motion` adds one that is found again."""
        self._keep(attempt, _ELSEWHERE, circumstances)

    def put_motion(self, attempt: Attempt, motion: Trajectory) -> None:
        """Keep the motion of a restored attempt."""
        update = f"update best set motion = ? where {_IS_TASK} and protocol = ? and round = ? and turns = ?"
        row = (self._study, *attempt.task.row, attempt.protocol, attempt.round, attempt.turns)
        with self._connection:
            self._connection.execute(update, (_pack(motion), *row))

    def _keep(self, attempt: Attempt, motion: bytes | None, circumstances: str) -> bool:
        if self._study == _NONE:
            self._study = self._number("studies", "identity", self.identity)
            with self._connection:
                self._connection.execute("update studies set told = ? where id = ?", (self._told, self._study))
        is_better = motion is not None and attempt.cost is not None and self._is_best(attempt, attempt.cost)
        held = self._number("circumstances", "told", circumstances)
        numbers = tuple(getattr(attempt, name) for name in _NUMBERS)
        row = (self._study, *attempt.key, attempt.round, attempt.status, *numbers, held)
        with self._connection:
            done = self._connection.execute(f"insert or ignore into attempts values ({_marks(row)})", row)
            if is_better and done.rowcount:
                task = (self._study, *attempt.task.row, attempt.protocol, attempt.round)
                values = (*task, attempt.turns, attempt.cost, motion)
                self._connection.execute(f"insert or replace into best values ({_marks(values)})", values)
        return is_better

    def best(self, protocol: str, before: int | None = None) -> Mapping[Task, Best]:
        """Return the best without whole turns of every task that a protocol solved, in rounds before one or in all."""
        query = "select place_i, place_j, inputs, input_rates, representation, cost, round from best"
        query += " where study = ? and protocol = ? and round < ? and turns = '' order by round"
        found = self._connection.execute(query, (self._study, protocol, _LAST if before is None else before))
        return {Task((row[0], row[1]), (row[2], row[3]), row[4]): Best(row[5], row[6]) for row in found}

    def best_turned(self, protocol: str, before: int | None = None) -> Mapping[Task, Best]:
        """Return the best with whole turns of every task, in rounds before one or in all."""
        query = "select place_i, place_j, inputs, input_rates, representation, cost, round, turns from best"
        query += " where study = ? and protocol = ? and round < ? and turns != '' order by cost desc, turns"
        found = self._connection.execute(query, (self._study, protocol, _LAST if before is None else before))
        return {Task((row[0], row[1]), (row[2], row[3]), row[4]): Best(*row[5:]) for row in found}

    def best_motion(self, task: Task, protocol: str, before: int | None = None, turns: str = "") -> Trajectory | None:
        """Return the motion of the best with some whole turns, by default none; None too where it was not restored."""
        found = self._find_best("motion", task, protocol, before, turns)
        return _unpack(found[0]) if found and found[0] else None

    def best_attempt(self, task: Task, protocol: str, before: int | None = None, turns: str = "") -> Attempt | None:
        """Return the attempt that found the best with some whole turns, by default none."""
        found = self._find_best("round, cost", task, protocol, before, turns)
        own = (a for a in self.attempts() if (a.task, a.protocol, a.turns) == (task, protocol, turns))
        return next((a for a in own if (a.round, a.cost) == found), None)

    def _find_best(
        self, columns: str, task: Task, protocol: str, before: int | None, turns: str
    ) -> tuple[Any, ...] | None:
        query = f"select {columns} from best where {_IS_TASK} and protocol = ? and turns = ? and round < ?"
        values = (self._study, *task.row, protocol, turns, _LAST if before is None else before)
        found: tuple[Any, ...] | None = self._connection.execute(
            f"{query} order by round desc limit 1", values
        ).fetchone()
        return found

    def find_or_derive(self, key: str, derive: Callable[[], str]) -> str:
        """Return a text that follows from its key alone; derive and keep a text that is missing."""
        found = self.recall(key)
        if found is None:
            found = derive()
            self.keep(key, found)
        return found

    def recall(self, key: str) -> str | None:
        """Return the text that was kept for a key."""
        with self._connection:
            self._connection.execute("create table if not exists derived (key text primary key, told text)")
        found = self._connection.execute("select told from derived where key = ?", (key,)).fetchone()
        return None if found is None else str(found[0])

    def keep(self, key: str, told: str) -> None:
        """Keep a text that follows from its key, after it was looked for."""
        with self._connection:
            self._connection.execute("insert or replace into derived values (?, ?)", (key, told))

    def attempts(self) -> Iterator[Attempt]:
        """List the attempts, in order."""
        for attempt, _ in self.list_all():
            yield attempt

    def list_all(self) -> Iterator[tuple[Attempt, str]]:
        """List what was tried, in order, with the circumstances of each."""
        query = f"""select place_i, place_j, inputs, input_rates, representation, protocol, part, guess, round, status,
            {", ".join(_NUMBERS)}, told from attempts join circumstances on circumstances.id = circumstances
            where study = ? order by attempts.rowid"""
        for row in self._connection.execute(query, (self._study,)):
            yield Attempt(Task((row[0], row[1]), (row[2], row[3]), row[4]), *row[5:-1]), row[-1]

    def _is_best(self, attempt: Attempt, cost: float) -> bool:
        query = f"select cost from best where {_IS_TASK} and protocol = ? and turns = ? and round "
        values = (self._study, *attempt.task.row, attempt.protocol, attempt.turns, attempt.round)
        before = self._connection.execute(f"{query} < ? order by round desc limit 1", values).fetchone()
        beside = self._connection.execute(f"{query} = ?", values).fetchone()
        if before is not None and cost >= before[0] - SAME * abs(before[0]):
            return False
        return beside is None or cost < float(beside[0])

    def _number(self, table: str, column: str, text: str) -> int:
        """Return the number of a text in a table of texts."""
        with self._connection:
            self._connection.execute(f"insert or ignore into {table} ({column}) values (?)", (text,))
        found = self._connection.execute(f"select id from {table} where {column} = ?", (text,)).fetchone()
        return int(found[0])


_IS_TASK = "study = ? and place_i = ? and place_j = ? and inputs = ? and input_rates = ? and representation = ?"
_NUMBERS = tuple(field.name for field in fields(Attempt))[6:]
_LAST = 2**31
_ELSEWHERE = b""  # in place of the motion of a restored attempt
_NONE = 0  # the number of a study of which nothing is kept yet


@contextmanager
def open_record(path: Path, study: str, told: str = "") -> Iterator[Record]:
    """Open the record of a study, or begin one. Raises InputError for a file that is no record."""
    try:
        connection = sqlite3.connect(path)
    except sqlite3.Error as error:
        raise _refuse(path, f"cannot be opened: {error}", "check the path") from None
    try:
        _check(connection, path)
        yield Record(connection, study, told)
    except sqlite3.Error as error:
        raise _refuse(path, f"cannot be used as a record: {error}", "give another file") from None
    finally:
        connection.close()


def _check(connection: sqlite3.Connection, path: Path) -> None:
    """Begin an empty file; refuse files of other versions."""
    if not connection.execute("select count(*) from sqlite_master").fetchone()[0]:
        connection.executescript(f"begin; {_TABLES} insert into about values ('{FORMAT}'); commit;")
    about = connection.execute("select format from about").fetchone()
    if about is not None and about[0] == BEFORE:
        _renew(connection)
        about = (FORMAT,)
    if about is None or about[0] != FORMAT:
        raise _refuse(path, "it is no record of this version", "give another file")


def _renew(connection: sqlite3.Connection) -> None:
    """Convert a file of the earlier format, whose searches made no start with whole turns."""
    attempts, best = f"{_ATTEMPTS_BEFORE}, '', circumstances", f"{_BEST_BEFORE}, '', cost, motion"
    renamed = " ".join(f"alter table {name} rename to old_{name};" for name in ("attempts", "best"))
    own = _TABLES[_TABLES.index("create table attempts") :]
    connection.executescript(
        f"begin; {renamed} {own} insert into attempts select {attempts} from old_attempts order by rowid; "
        f"insert into best select {best} from old_best; drop table old_attempts; drop table old_best; "
        f"update about set format = '{FORMAT}'; commit;"
    )


def _refuse(path: Path, finding: str, remedy: str) -> InputError:
    return InputError([Fault(str(path), 0, "", finding, remedy)])


def _marks(row: tuple[object, ...]) -> str:
    return ",".join("?" * len(row))


def _pack(motion: Trajectory) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **{field.name: getattr(motion, field.name) for field in fields(Trajectory)})
    return file.getvalue()


def _unpack(blob: bytes) -> Trajectory:
    with np.load(io.BytesIO(blob), allow_pickle=False) as arrays:
        return Trajectory(**{field.name: arrays[field.name] for field in fields(Trajectory) if field.name in arrays})
