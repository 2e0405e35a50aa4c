"""The command `mbsrun advise`: measure the options for a model, and print the fastest that are accurate enough."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import click
from rich import box
from rich.table import Table
from rich.text import Text

from mbsgen.help import ModelCommand
from mbsrun.commands.console import keep_grid, open_console, output_folder, show_progress
from mbsrun.commands.robots import accept_robots
from mbsrun.external import load
from mbsrun.measuring import motions, solves
from mbsrun.measuring.advice import Advice, Option
from mbsrun.measuring.points import Cost
from mbsrun.measuring.surveys import survey_control, survey_optimisation, survey_simulation

ADVISE_HELP = """Find the fastest way to compute with MODEL, with errors of at most --accuracy.

\b
  mbsrun advise models/pendulum.yaml --accuracy 1e-5 --quick
  mbsrun advise models/arm_pendulum.yaml --task control

The command measures MODEL itself on this machine. It prints the measurements with the advice, and lists the things that
it did not measure. The output folder keeps the measurements, so the next question about MODEL takes less time.

\b
Tasks
  simulate   formulation, method, step or tolerance; on the motion of --settings, else one from a random pose
  optimise   representation, collocation, degree, intervals; on --problem, else a small reach from rest to rest
  control    kernels and their precision, for torques, accelerations and derivatives of both

\b
Exit codes
  0   for every task, some measured choice is accurate enough
  1   for some task, no measured choice is accurate enough
  2   the model, a file or an argument cannot be accepted
"""

NOTHING_GOOD = 1  # exit code


@click.command("advise", cls=ModelCommand, help=ADVISE_HELP)
@click.argument("model", type=click.Path(path_type=Path))
@click.option(
    "--accuracy", type=click.FloatRange(0, min_open=True), default=1e-6, help="The largest error; by default 1e-6."
)
@click.option(
    "--task",
    type=click.Choice(["simulate", "optimise", "control"]),
    default="simulate",
    help="See above; by default simulate.",
)
@output_folder("advice", "a model NAME")
@click.option(
    "--settings",
    "settings",
    type=click.Path(path_type=Path),
    help="With --task simulate: a file with the motion to measure.",
)
@click.option("--problem", type=click.Path(path_type=Path), help="With --task optimise: the problem to measure.")
@click.option("--quick", is_flag=True, help="Measure little, as a preview.")
@accept_robots
@click.pass_context
def advise_command(
    context: click.Context,
    /,
    model: Path,
    accuracy: float,
    task: str,
    out: Path | None,
    settings: Path | None,
    problem: Path | None,
    quick: bool,
) -> None:
    """Measure, choose, and print the advice."""
    for name, value, own in (("--settings", settings, "simulate"), ("--problem", problem, "optimise")):
        if value is not None and task != own:
            raise click.UsageError(f"{name} is for --task {own}")
    out = out or Path(f"{model.stem}.advice")
    with show_progress() as report:
        if task == "simulate":
            course = motions.read_course(model, settings, None)
            extent = motions.QUICK if quick else motions.MotionScope()
            advice = survey_simulation(course, out, accuracy, extent, report)
        elif task == "optimise":
            mechanism = load(model)
            case = None if problem is None else solves.read_case(mechanism, problem)
            told = "a reach from rest to rest in 1 s, stated for any model" if problem is None else str(problem)
            case = solves.state_reach(mechanism) if case is None else replace(case, problem=keep_grid(case.problem))
            scope = solves.QUICK if quick else solves.SolveScope()
            advice = survey_optimisation(case, told, out, accuracy, scope, report)
        else:
            advice = survey_control(model, out, accuracy, quick, report)
    _print_advice(advice)
    context.exit(0 if advice.is_complete else NOTHING_GOOD)


def _print_advice(advice: Advice) -> None:
    console = open_console()
    console.print(f"{advice.model}: {advice.task}, with errors of {advice.accuracy:g} at most", markup=False)
    console.print(f"error: {advice.meaning}", markup=False)
    for need in advice.needs:
        best = advice.choose(need)
        console.print(
            f"\n{need}: " + ("no measured option is so accurate" if best is None else _describe(best)), markup=False
        )
        table = Table(box=box.SIMPLE)
        options = advice.shortlist(need)
        for name in _list_columns(options):
            table.add_column(name)
        for column in ("time", "spread", "error"):
            table.add_column(column, justify="right")
        table.add_column("")
        for option in options:
            verdict = option.finding or ("" if option.meets(advice.accuracy) else "not accurate enough")
            time, spread = (_format_time(option), _format_spread(option.cost)) if option.cost else ("-", "-")
            error = "-" if option.error is None else f"{option.error:.1e}"
            marked = "taken" if option is best else verdict
            choices = dict(option.choices)
            cells = (*(choices.get(name, "") for name in _list_columns(options)), time, spread, error, marked)
            table.add_row(*map(Text, cells))
        console.print(table)
    console.print("not measured:", markup=False)
    for text in advice.unmeasured:
        console.print(f"- {text}", markup=False)


def _list_columns(options: Sequence[Option]) -> list[str]:
    return list(dict.fromkeys(name for option in options for name, _ in option.choices))


def _describe(option: Option) -> str:
    chosen = ", ".join(f"{name} {value}" for name, value in option.choices)
    return f"{chosen}; {_format_time(option)}, error {option.error:.1e}"


def _format_time(option: Option) -> str:
    """Write the shortest time, with its unit."""
    return f"{option.price:.3g} {option.unit}"


def _format_spread(cost: Cost) -> str:
    return "timed once" if cost.rounds == 1 else f"{cost.spread:.0%}"
