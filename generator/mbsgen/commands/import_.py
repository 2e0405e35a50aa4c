"""`mbsgen import`: a model file of a file in another format."""

from __future__ import annotations

from pathlib import Path

import click

from mbsgen.commands.importing import MODEL, importing, tell
from mbsgen.errors import Fault, InputError
from mbsgen.help import ModelCommand
from mbsgen.importing import Choices, import_model, list_formats, write_imported
from mbsgen.importing.findings import Findings
from mbsgen.importing.formats import STUDY
from mbsgen.output import write_file

_OWN = (".yaml", ".yml")  # suffixes of model files
_PROBLEM = ".ocp.yaml"


@click.command(
    "import",
    cls=ModelCommand,
    describes_robots=True,
    help=f"""Make a model file of MODEL, a file of {list_formats()}.

    Changes and omissions are printed on stderr, and written as comments into the model file. A study of OpenSim Moco
    (.omoco) makes two files: -o PROBLEM.ocp.yaml, and PROBLEM.yaml, its model.
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
    if model.suffix.lower() == STUDY:
        _import_study(model, out, choices)
        return
    imported = import_model(model, choices)
    tell(imported.notices)
    text = write_imported(imported)
    if out is None:
        click.echo(text, nl=False)
        return
    write_file(text.encode(), out)
    click.echo(f"wrote {out}", err=True)


def _import_study(path: Path, out: Path | None, choices: Choices) -> None:
    """Write the problem file of a study, and its model file beside it."""
    from mbsgen.importing.omoco.problem import write_problem
    from mbsgen.importing.omoco.study import read_study

    if out is None or not out.name.endswith(_PROBLEM) or out.name == _PROBLEM:  # else the model's file has no name
        raise click.UsageError(f"a study makes two files: give -o {path.stem}{_PROBLEM}")
    model, findings = out.with_name(f"{out.name.removesuffix(_PROBLEM)}.yaml"), Findings(str(path))
    study = read_study(path, choices, findings)
    text = write_problem(study, model.name, findings)
    tell((*study.imported.notices, *findings.notices))
    if study.folder.resolve() != out.parent.resolve() and "references:" in text:
        click.echo(f"copy the tables of {study.folder} beside {out}", err=True)
    for file, content in ((model, write_imported(study.imported)), (out, text)):
        write_file(content.encode(), file)
        click.echo(f"wrote {file}", err=True)
