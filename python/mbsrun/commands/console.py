"""Options, messages and tables that the commands share."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeVar

import click
from click.shell_completion import CompletionItem

from mbsgen.expressions import FLOATS, ExpressionError, evaluate, parse
from mbsgen.style import FORMATS, in_format, picture_format
from mbsrun.ocp.problem.problem import Problem, find_conflicts

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

NOT_SOLVED = 1  # exit codes; 0 is a solution as accurate as the problem asks for
UNCUT = 200  # characters in a line where nobody sees a terminal's width

F = TypeVar("F", bound=Callable[..., object])
Report = Callable[[str, int, int], None]  # takes the current step, the number of finished steps and of all


class NumberType(click.ParamType[float]):
    """A number, or an expression such as pi/2."""

    name = "number"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Read one number of an argument."""
        try:
            return value if isinstance(value, float) else evaluate(parse(str(value)), {}, FLOATS)
        except ExpressionError as error:
            self.fail(str(error), param, ctx)


class NameType(click.ParamType[str]):
    """A key of a registry, looked up when the option is read."""

    name = "name"

    def __init__(self, known: Mapping[str, object]) -> None:
        self.known = known

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str | None:  # noqa: ARG002  # click's
        """List the names."""
        return f"[{'|'.join(self.known)}]"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Admit the names."""
        if value not in self.known:
            self.fail(f"{value!r} is not one of {', '.join(self.known)}.", param, ctx)
        return str(value)

    def shell_complete(
        self,
        ctx: click.Context,  # noqa: ARG002  # click's
        param: click.Parameter,  # noqa: ARG002
        incomplete: str,
    ) -> list[CompletionItem]:
        """Complete a name."""
        return [CompletionItem(name) for name in self.known if name.startswith(incomplete)]


def output_folder(kind: str, of: str = "a problem file NAME.ocp.yaml") -> Callable[[F], F]:
    """Return the option for the folder that a command writes to; `of` is the file whose name it takes by default."""
    told = f"The folder to write to; by default NAME.{kind} here, for {of}."
    return click.option("-o", "--output", "out", type=click.Path(file_okay=False, path_type=Path), help=told)


def choose_format(command: Callable[..., None]) -> Callable[..., None]:
    """Add the option for the format of the plots that a command draws."""

    @functools.wraps(command)
    def call(*args: object, format: str, **own: object) -> None:
        with picture_format(format):
            command(*args, **own)

    told = "The format of plots; by default png. PDF and SVG are for print."
    return click.option("--format", type=click.Choice(FORMATS), default=FORMATS[0], help=told)(call)


def list_written(folder: Path, names: Iterable[str]) -> str:
    """Return the paths of written files as text; plots are in their format."""
    return ", ".join(str(in_format(folder / name)) for name in names)


def read_numbers(pairs: Sequence[str], known: Collection[str], option: str) -> dict[str, float]:
    """Read the values NAME=NUMBER of an option, once each."""
    found: dict[str, float] = {}
    for pair in pairs:
        name, sign, text = pair.partition("=")
        if not sign or name.strip() not in known or name.strip() in found:
            told = f"found {pair!r}; give NAME=NUMBER once for some of {', '.join(known)}"
            raise click.BadParameter(told, param_hint=option)
        try:
            found[name.strip()] = evaluate(parse(text), {}, FLOATS)
        except ExpressionError as error:
            raise click.BadParameter(f"{name}: {error}", param_hint=option) from None
    return found


def find_sensor(problem: Problem, argument: str) -> str:
    """Name the one sensor that has a target."""
    sensors = [name for name, _ in problem.end.sensors]
    if len(sensors) != 1:
        raise click.BadParameter(
            f"the problem has targets for {', '.join(sensors) or 'no sensor'}; it must have one for one sensor",
            param_hint=argument,
        )
    return sensors[0]


def check_conflicts(problem: Problem) -> None:
    """Refuse what does not go together."""
    if conflicts := find_conflicts(problem):
        raise click.UsageError("; ".join(f"{c.place[0]}: {c.finding}; {c.remedy}" for c in conflicts))


def keep_grid(problem: Problem) -> Problem:
    """Return a problem without its refinement, and say so if it asks for one."""
    if problem.refine is not None:
        say("note: only `mbsrun solve` refines grids; this command keeps the grid of the file")
    return replace(problem, refine=None)


def say(message: str) -> None:
    """Print a message to stderr."""
    click.echo(message, err=True)


def print_table(table: Table) -> None:
    """Print a table to stdout, as wide as the terminal."""
    open_console().print(table)


def open_console() -> Console:
    """Return stdout as wide as the terminal; lines are long where there is none."""
    from rich.console import Console  # here and below: it takes a while to load, and most commands do without

    return Console(highlight=False, width=None if sys.stdout.isatty() else UNCUT)


@functools.cache
def open_messages() -> Console:
    """Return stderr."""
    from rich.console import Console

    return Console(stderr=True)


class Status(Protocol):
    """A line that shows what is being done."""

    def update(self, text: str, /) -> None:
        """Show another text."""


class _NoStatus:
    """A line where nobody sees it."""

    def update(self, text: str, /) -> None:
        """Show nothing."""


@contextmanager
def show_status(text: str) -> Iterator[Status]:
    """Show what is being done on stderr, if that is a terminal."""
    if sys.stderr.isatty():
        with open_messages().status(text) as status:
            yield status
    else:
        yield _NoStatus()


@contextmanager
def show_progress() -> Iterator[Report]:
    """Show the current step and the remaining time on stderr."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("beginning", total=None)
        yield lambda text, done, total: progress.update(task, description=text, completed=done, total=total)
