"""The layout of `--help` in both programs: commands by subject, and the options of robots' files after all others."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, MutableMapping, Sequence
from importlib import import_module
from typing import Any

import click

ROBOTS = "Options for robots in URDF, MJCF and SDF"
COMMANDS = "Commands"  # the subject of commands without one
_WHOLE = 1000  # characters, more than any summary has


class RobotOption(click.Option):
    """An option that files of URDF, MJCF and SDF alone take."""


class ModelCommand(click.Command):
    """A command on a model, which may be a robot's file."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options of robots' files under their own title."""
        rows: dict[str, list[tuple[str, str]]] = {"Options": [], ROBOTS: []}
        for parameter in self.get_params(ctx):
            if isinstance(parameter, click.Option) and (row := parameter.get_help_record(ctx)) is not None:
                rows[ROBOTS if isinstance(parameter, RobotOption) else "Options"].append(row)
        _write_sections(formatter, rows)


class CommandsOnDemand(MutableMapping[str, click.Command]):
    """Commands of a package, loaded when they are used: `fit-motion` is its `fit_motion.fit_motion_command`."""

    def __init__(self, package: str, names: Iterable[str]) -> None:
        self._package = package
        self._commands: dict[str, click.Command | None] = dict.fromkeys(names)

    def __getitem__(self, name: str) -> click.Command:
        """Return a command."""
        command = self._commands[name]
        if command is None:
            module = name.replace("-", "_")
            command = getattr(import_module(f"{self._package}.{module}"), f"{module}_command")
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

    def __init__(self, *arguments: Any, subjects: Mapping[str, Sequence[str]] | None = None, **own: Any):
        super().__init__(*arguments, **own)
        self._subjects = subjects

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002  # click's
        """List the names in the order in which the commands were given."""
        return list(self.commands)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands under the titles of their subjects."""
        subjects = self._subjects or {COMMANDS: tuple(self.commands)}
        _write_sections(
            formatter,
            {title: [_describe(self.commands[name], ctx) for name in names] for title, names in subjects.items()},
        )


def _describe(command: click.Command, ctx: click.Context) -> tuple[str, str]:
    """Return a command with its first argument, and its summary."""
    own = click.Context(command, info_name=command.name, parent=ctx)
    words = [word for part in command.params if isinstance(part, click.Argument) for word in part.get_usage_pieces(own)]
    return " ".join([command.name or "", *words[:1]]), command.get_short_help_str(limit=_WHOLE)


def _write_sections(formatter: click.HelpFormatter, sections: Mapping[str, Sequence[tuple[str, str]]]) -> None:
    """Write tables under their titles; their columns stand under one another."""
    width = max((len(first) for rows in sections.values() for first, _ in rows if len(first) <= 30), default=0)
    for title, rows in sections.items():
        if rows:
            with formatter.section(title):
                formatter.write_dl([(first.ljust(width), second) for first, second in rows])
