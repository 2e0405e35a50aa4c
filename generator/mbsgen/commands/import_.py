"""`mbsgen import`: a model file of a file in another format."""

from __future__ import annotations

from pathlib import Path

import click

from mbsgen.commands.importing import MODEL, importing, tell
from mbsgen.errors import Fault, InputError
from mbsgen.help import ModelCommand
from mbsgen.importing import Choices, import_model, list_formats, write_imported
from mbsgen.output import write_file

_OWN = (".yaml", ".yml")  # suffixes of model files


@click.command(
    "import",
    cls=ModelCommand,
    describes_robots=True,
    help=f"""Make a model file of MODEL, a file of {list_formats()}.

    Changes and omissions are printed on stderr, and written as comments into the model file.
    """,
)
@MODEL
@click.option("-o", "--output", "out", type=click.Path(path_type=Path), help="The model file to write; else stdout.")
@importing
def import_command(
    model: Path,
    out: Path | None,
    choices: Choices,
) -> None:
    """Make a model file of a file in another format."""
    if model.suffix.lower() in _OWN:
        raise InputError([Fault(str(model), 0, "", "it is a model file already", f"give a file of {list_formats()}")])
    imported = import_model(model, choices)
    tell(imported.notices)
    text = write_imported(imported)
    if out is None:
        click.echo(text, nl=False)
        return
    write_file(text.encode(), out)
    click.echo(f"wrote {out}", err=True)
