"""The layout of `--help` in both programs: commands by subject, and the options of robots' files after all others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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


class CommandsBySubject(click.Group):
    """A group that lists its commands by subject, each with its first argument and its whole summary."""

    command_class = ModelCommand

    def __init__(self, *arguments: Any, subjects: Mapping[str, Sequence[click.Command]] | None = None, **own: Any):
        super().__init__(*arguments, **own)
        self.subjects = subjects or {}
        for commands in self.subjects.values():
            for command in commands:
                self.add_command(command)

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002  # click's
        """List the names in the order in which the commands were given."""
        return list(self.commands)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands under the titles of their subjects."""
        subjects = self.subjects or {COMMANDS: tuple(self.commands.values())}
        _write_sections(
            formatter, {title: [_describe(each, ctx) for each in commands] for title, commands in subjects.items()}
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
