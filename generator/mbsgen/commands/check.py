"""`mbsgen check`: every fault of a model."""

from __future__ import annotations

from pathlib import Path

import click

from mbsgen.commands.importing import MODEL, importing, read_model
from mbsgen.help import ModelCommand
from mbsgen.importing import Choices
from mbsgen.pipeline import read_tree


@click.command("check", cls=ModelCommand)
@MODEL
@importing
def check_command(model: Path, choices: Choices) -> None:
    """Print every fault of MODEL, and write nothing."""
    read_tree(read_model(model, choices))
    click.echo(f"{model}: no fault found", err=True)
