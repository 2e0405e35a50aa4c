"""The reference of commands, from their own help."""

from __future__ import annotations

from pathlib import Path

import click

import mbsgen.cli
import mbsrun.cli

GROUPS: dict[str, click.Command] = {"mbsgen": mbsgen.cli.cli, "mbsrun": mbsrun.cli.cli}
WIDTH = 88  # characters, as many as a page is wide
PAGES = [f"commands/{name}.md" for name in GROUPS]


def write(target: Path) -> None:
    """Write a page for each of the two programs."""
    (target / "commands").mkdir(parents=True, exist_ok=True)
    for name, group in GROUPS.items():
        lines = [f"# The command {name}", "", *_describe(group, name, None)]
        (target / "commands" / f"{name}.md").write_text("\n".join(lines), encoding="utf-8")


def _describe(command: click.Command, name: str, parent: click.Context | None) -> list[str]:
    """Return the help of a command, and of its own commands."""
    settings = {**command.context_settings, "max_content_width": WIDTH, "terminal_width": WIDTH}
    context = click.Context(command, info_name=name, parent=parent, **settings)
    lines = ["``` { .text .help }", command.get_help(context), "```", ""]
    if isinstance(command, click.Group):
        for own in command.list_commands(context):
            found = command.get_command(context, own)
            if found is not None and not found.hidden:
                lines += [f"## {context.command_path} {own}", "", *_describe(found, own, context)]
    return lines
