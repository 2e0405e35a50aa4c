"""`mbsgen equations`: the equations of motion, in several languages."""

from __future__ import annotations

from pathlib import Path

import click

from mbsgen.commands.console import show_progress
from mbsgen.commands.importing import MODEL, importing, read_model
from mbsgen.equations import (
    FORMATS,
    Page,
    SizeError,
    build_numeric,
    build_symbolic,
    derive,
    derive_stepwise,
    show_lines,
    show_motion,
    write_lines,
)
from mbsgen.help import ModelCommand
from mbsgen.importing import Choices
from mbsgen.model.tree import Tree
from mbsgen.output import write_file
from mbsgen.pipeline import read

_SUFFIXES = {".txt": "text", ".py": "python", ".tex": "latex", ".md": "markdown", ".html": "html"}
_READABLE = 600  # terms of whole equations, beyond which lines are shorter


@click.command("equations", cls=ModelCommand)
@MODEL
@click.option(
    "--form",
    type=click.Choice(["auto", "whole", "named", "lines"]),
    default="auto",
    show_default=True,
    help="Whole equations, equations in named intermediate values, or the residual line by line as it is generated; "
    "auto chooses whole ones where they are short, else lines.",
)
@click.option(
    "--format",
    "language",
    type=click.Choice([*FORMATS]),
    help="The language; by default, text, or what the suffix of --output says.",
)
@click.option("--numbers", is_flag=True, help="Put in the numbers of named parameters, instead of their names.")
@click.option(
    "-o",
    "--output",
    "outputs",
    type=click.Path(path_type=Path),
    multiple=True,
    help="A file to write; else stdout. May be given several times.",
)
@importing
def equations_command(
    model: Path, form: str, language: str | None, numbers: bool, outputs: tuple[Path, ...], choices: Choices
) -> None:
    """Print the equations of motion of MODEL.

    They are M(q) qdd + c(q, qd) + G(q) = Q. Products of sines and cosines are written as sums, so the form is unique,
    and no term is 0. Loops add h(q) = 0 and its Jacobian J; frames add their positions. Mechanisms of many joints are
    written line by line, as the recursion that is generated.
    """
    if language is not None and len(outputs) > 1:
        finding = "the suffixes of several files choose their languages; leave it out"
        raise click.BadParameter(finding, param_hint="--format")
    languages = [language or _choose_language(out) for out in outputs]
    source = read(read_model(model, choices))
    with show_progress() as tell:
        tell("the equations")
        tree = build_numeric(source) if numbers else build_symbolic(source)
        page = _choose_page(tree, form)
    if hidden := [x.name for x in tree.joints if x.dry or (x.stops and x.stops.restitution is not None)]:
        click.echo(
            f"note: rigid stops and dry friction of joints {', '.join(hidden)} are not in the equations", err=True
        )
    for out, own in zip(outputs, languages, strict=True):
        write_file(FORMATS[own](page).encode(), out)
    if not outputs:
        click.echo(FORMATS[language or "text"](page), nl=False)


def _choose_language(out: Path) -> str:
    """Return the language of a file's suffix."""
    if out.suffix not in _SUFFIXES:
        raise click.BadParameter(f"{out} ends in none of {', '.join(_SUFFIXES)}; give --format", param_hint="-o")
    return _SUFFIXES[out.suffix]


def _choose_page(tree: Tree, form: str) -> Page:
    """Lay out whole equations, or lines where these are too long."""
    if form == "lines":
        return show_lines(write_lines(tree))
    if form == "named":
        return show_motion(derive_stepwise(tree), "intermediate values")
    try:
        motion = derive(tree) if form == "whole" else derive(tree, _READABLE)
    except SizeError as error:
        if form == "whole":
            raise SizeError(f"{error}; take --form named or --form lines") from None
        return show_lines(write_lines(tree))
    return show_motion(motion) if form == "whole" or motion.terms <= _READABLE else show_lines(write_lines(tree))
