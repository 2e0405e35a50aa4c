"""The command line `mbsgen`: a model file in; a folder of C, a report, or a verdict out."""

from __future__ import annotations

import sys
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

from mbsgen import __version__
from mbsgen.errors import MbsError
from mbsgen.pipeline import Options, generate, make
from mbsgen.report import COLUMNS, NOTE, Report, sections, write_json, write_markdown

BAD_INPUT = 2  # exit code: a file or an argument that cannot be accepted; 0 is success

MODEL = click.argument("model", type=click.Path(path_type=Path))


class ModelFirst(click.Group):
    """A group whose default command is `generate`: `mbsgen MODEL -o DIR`. A subcommand wins over a file of its name."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Put the default command before a first argument that is none."""
        first = next((a for a in args if not a.startswith("-")), None)
        if first is not None and first not in self.commands and not {"--help", "--version"} & set(args):
            args = ["generate", *args]
        return super().parse_args(ctx, args)


@click.group(cls=ModelFirst, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="mbsgen")
def cli() -> None:
    r"""Turn the description of a multibody system into C kernels for its dynamics.

    \b
      mbsgen MODEL -o DIR       generate DIR: kernels with their derivatives, header, manifest, report
      mbsgen report MODEL       count what the model costs, and write nothing
      mbsgen check MODEL        tell every fault of the model file, and write nothing

    MODEL is a YAML file; models/ holds examples. A file that has the name of a subcommand is reached as ./NAME.

    Exit codes: 0 done; 2 the model or an argument cannot be accepted (nothing has been written).
    """


@cli.command("generate")
@MODEL
@click.option("-o", "--output", "out", type=click.Path(path_type=Path), required=True, help="The folder to write.")
@click.option("--runtime", is_flag=True, help="Make every number of the model a run-time parameter.")
@click.option("--python", is_flag=True, help="Also write the kernels as a Python module, for any number type.")
def generate_command(model: Path, out: Path, runtime: bool, python: bool) -> None:
    """Generate the folder DIR from MODEL: kernels in C, header, manifest.json, report.md and report.json.

    The flop table is printed. The folder appears as a whole, and replaces one that mbsgen wrote before.
    """
    product = generate(model, out, Options(runtime=runtime, python=python))
    print_report(product.report)
    Console(stderr=True).print(f"wrote {len(product.files)} files to {out}", highlight=False)


@cli.command("report")
@MODEL
@click.option("--json", "form", flag_value="json", help="Print report.json.")
@click.option("--markdown", "form", flag_value="markdown", help="Print report.md.")
def report_command(model: Path, form: str | None) -> None:
    """Count flops and equations of MODEL, for each formulation and each kernel."""
    report = make(model).report
    if form is None:
        print_report(report)
    else:
        click.echo(write_json(report) if form == "json" else write_markdown(report), nl=False)


@cli.command("check")
@MODEL
def check_command(model: Path) -> None:
    """Read MODEL and generate it in memory; tell every fault of it."""
    make(model)
    Console(stderr=True).print(f"{model}: no fault found", highlight=False)


def print_report(report: Report) -> None:
    """Print the flop table on stdout."""
    console = Console()
    for title, costs in sections(report):
        table = Table(title=f"{title}: {report.model}", title_justify="left", caption_justify="left")
        table.add_column("")
        for column in COLUMNS:
            table.add_column(column, justify="right")
        for name, cost in costs.items():
            table.add_row(name, *map(str, cost.row))
        console.print(table)
    console.print(NOTE, highlight=False)


def main() -> None:
    """Run the command line; a user's errors are told without a traceback."""
    try:
        cli()
    except MbsError as error:
        click.echo(f"mbsgen: {error}" if "\n" not in str(error) else str(error), err=True)
        sys.exit(BAD_INPUT)
