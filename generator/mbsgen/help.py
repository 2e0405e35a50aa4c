"""The layout of `--help` in both programs: commands by subject, and the options of robots' files after all others."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, MutableMapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from keyword import iskeyword
from types import MappingProxyType
from typing import Any

import click

OPTIONS = "Options"
ROBOTS = "Options for robots in URDF, MJCF, SDF and OpenSim"
WHOLE = "mbsgen import --help"  # describes all options for robots
COMMANDS = "Commands"  # the subject of commands without one
_WHOLE = 1000  # characters, more than any summary has


class RobotOption(click.Option):
    """An option that files of other formats alone take."""


class ModelCommand(click.Command):
    """A command on a model, which may be a robot's file.

    `sections` names groups of its options, by parameters; all other options come before them. Options for robots are
    last, by their names alone unless `describes_robots`.
    """

    def __init__(
        self,
        *arguments: Any,
        sections: Mapping[str, Sequence[str]] = MappingProxyType({}),
        describes_robots: bool = False,
        **own: Any,
    ):
        super().__init__(*arguments, **own)
        self.titles = {name: title for title, names in sections.items() for name in names}
        self._describes_robots = describes_robots

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options under the titles of their sections, and the options of robots' files last."""
        rows: dict[str, list[tuple[str, str]]] = {title: [] for title in (OPTIONS, *self.titles.values(), ROBOTS)}
        names: list[str] = []
        for parameter in self.get_params(ctx):
            if not isinstance(parameter, click.Option) or (row := parameter.get_help_record(ctx)) is None:
                continue
            if isinstance(parameter, RobotOption) and not self._describes_robots:
                names += parameter.opts
            else:
                title = ROBOTS if isinstance(parameter, RobotOption) else self.titles.get(parameter.name or "", OPTIONS)
                rows[title].append(row)
        _write_sections(formatter, rows)
        if names:
            with formatter.section(ROBOTS):
                formatter.write_text(f"{', '.join(names)}: see `{WHOLE}`")


@dataclass(frozen=True)
class Entry:
    """A command in the list of `--help`, which loads none of them."""

    name: str
    argument: str  # the first one, as `--help` writes it
    summary: str


class CommandsOnDemand(MutableMapping[str, click.Command]):
    """Commands of a package, loaded when they are used: `fit-motion` is its `fit_motion.fit_motion_command`.

    A module whose name is a word of Python ends in _: `import_.import_command`.
    """

    def __init__(self, package: str, entries: Iterable[Entry]) -> None:
        self._package = package
        self._commands: dict[str, click.Command | None] = dict.fromkeys(entry.name for entry in entries)

    def __getitem__(self, name: str) -> click.Command:
        """Return a command."""
        command = self._commands[name]
        if command is None:
            word = name.replace("-", "_")
            module = import_module(f"{self._package}.{word}{'_' if iskeyword(word) else ''}")
            command = getattr(module, f"{word}_command")
            assert isinstance(command, click.Command), "the module has the command of its name"
            self._commands[name] = command
        return command

    def __setitem__(self, name: str, command: click.Command) -> None:
        """Add a command."""
        self._commands[name] = command

    def __delitem__(self, name: str) -> None:
        """Take a command out."""
        del self._commands[name]

    def __iter__(self) -> Iterator[str]:
        """Return an iterator over the names."""
        return iter(self._commands)

    def __len__(self) -> int:
        """Return how many commands there are."""
        return len(self._commands)


class CommandsBySubject(click.Group):
    """A group that lists its commands by subject, each with its first argument and its whole summary."""

    command_class = ModelCommand

    def __init__(
        self,
        *arguments: Any,
        subjects: Mapping[str, Sequence[Entry]] | None = None,
        others: Mapping[str, str] = MappingProxyType({}),
        **own: Any,
    ):
        super().__init__(*arguments, **own)
        self._subjects = subjects
        self._others = others  # names that other programs have for commands

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a command by its name, or by the one that other programs have for it."""
        return super().get_command(ctx, self._others.get(cmd_name, cmd_name))

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002  # click's
        """List the names in the order in which the commands were given."""
        return list(self.commands)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands under the titles of their subjects."""
        subjects = self._subjects or {COMMANDS: [describe(command, ctx) for command in self.commands.values()]}
        rows = {
            title: [(f"{entry.name} {entry.argument}".strip(), entry.summary) for entry in entries]
            for title, entries in subjects.items()
        }
        _write_sections(formatter, rows)


def describe(command: click.Command, ctx: click.Context) -> Entry:
    """Return the entry of a command that is loaded."""
    own = click.Context(command, info_name=command.name, parent=ctx)
    words = [word for part in command.params if isinstance(part, click.Argument) for word in part.get_usage_pieces(own)]
    return Entry(command.name or "", next(iter(words), ""), command.get_short_help_str(limit=_WHOLE))


def _write_sections(formatter: click.HelpFormatter, sections: Mapping[str, Sequence[tuple[str, str]]]) -> None:
    """Write tables under their titles; their columns stand under one another."""
    width = max((len(first) for rows in sections.values() for first, _ in rows if len(first) <= 30), default=0)
    for title, rows in sections.items():
        if rows:
            with formatter.section(title):
                formatter.write_dl([(first.ljust(width), second) for first, second in rows])
