"""`mbsrun simulate`: a model and settings -> a motion, with tables and pictures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

from mbsgen.documents import Data
from mbsgen.errors import Fault, InputError
from mbsgen.expressions import Expression, Number, parse, substitute
from mbsgen.help import ModelCommand
from mbsgen.manifest import Manifest
from mbsrun.commands.columns import more_columns
from mbsrun.commands.console import NOT_SOLVED, NameType, choose_format, list_written, output_folder, say, show_status
from mbsrun.commands.robots import accept_robots
from mbsrun.commands.starts import Wish, simulate_starts
from mbsrun.external import load
from mbsrun.models import INTEGRATED
from mbsrun.ocp.problem.driving import HORIZON
from mbsrun.ocp.solution.solution import Solution, read_solution
from mbsrun.quantities import Added, list_quantities
from mbsrun.recordings import find_column, read_column, read_recording
from mbsrun.results import Numbers
from mbsrun.simulation.closing import close_start
from mbsrun.simulation.drive import follow_polynomials, hold_steps
from mbsrun.simulation.integration.methods import METHODS, Family, Formulation
from mbsrun.simulation.motion import Keeping, Motion
from mbsrun.simulation.record import FILES as MOTION_FILES
from mbsrun.simulation.record import describe_settings, write_motion
from mbsrun.simulation.simulate import simulate
from mbsrun.simulation.statement import Recording, read_statement

PLAIN = (  # options that a settings file has too
    *("duration", "method", "formulation", "step", "output_step", "rtol", "atol", "stages", "rho"),
    *("loops", "alpha", "beta", "input_period", "max_steps", "max_seconds"),
)

INPUT_COLUMNS = ("u[{}]", "input[{}]", "acting[{}]", "w[{}]", "{}")  # names that the column of an input may have

SIMULATE_HELP = """Integrate the motion of MODEL, and write it with its energy, plots and an animation.

MODEL is a model file, a robot's file, or a folder that mbsgen wrote:

\b
  mbsrun simulate models/pendulum.yaml --duration 10 --pose q1=pi/2
  mbsrun simulate models/four_bar.yaml --duration 2 --velocity motor=3 -o four_bar

--pose and --velocity give the state at time 0; other coordinates and velocities are 0, or follow from loops. --input
gives inputs, which are 0 by default. A file (--settings) can hold all of these, and open wrenches; options have
priority:

\b
  duration: 5
  method: rk4
  step: 1e-3
  start: {pose: {q1: pi/2}}
  inputs: {q1: 0.2*sin(3*t) - 2*qd_q1}
  wrenches: {contact: {force: [0, 0, 10*t]}}

\b
Methods
METHODS

\b
Loops are kept closed, with --loops, by
KEEPING

\b
Formulations
  exp2, exp1   accelerations: by articulated bodies, by elimination in the mass matrix
  semi, impl   mass matrix and bias, residual; explicit methods then solve for accelerations

\b
The output folder gets
  simulation.json   settings, number of steps, energies, warnings, the last state
  trajectory.csv    coordinates, velocities, inputs, energies over time, with units, and the columns of --columns
  plots.png         the same as curves
  animation.html    plays the motion in any browser

--starts makes many motions: one for each row of a table with columns q_NAME, qd_NAME or a parameter's name, or N random
ones from the ranges of --vary. The folder gets simulation.json, starts.csv (the numbers of each start, its status and
its last state) and motions.npz (t, q, qd of all motions).

The summary shows the drift of the energy: kinetic and potential energy, minus their initial values and the work of
inputs, springs, dampers and wrenches. Exact integration would give 0.

\b
Exit codes
  0   the end was reached
  1   the end was not reached: a kernel or a step failed, or the limit of steps or seconds
      was reached; the message gives time, joint and reason; the motion up to this time is
      written, and marked as incomplete
  2   the model, a file or an argument cannot be accepted; nothing written
"""


def list_methods() -> str:
    """List the methods by family, as help shows them."""
    lines = []
    for family in Family:
        names = ", ".join(name for name, method in METHODS.items() if method.family is family)
        lines += [f"  {family.value}", f"      {names}"]
    return "\n".join(lines)


def list_keeping() -> str:
    """List the ways to keep loops closed, with their methods, as help shows them."""
    lines = []
    for keeping in Keeping:
        names = ", ".join(name for name, method in METHODS.items() if keeping in method.keeps)
        lines.append(f"  {keeping.value:<16}{names}")
    return "\n".join(lines)


SECTIONS = {
    "The motion": (
        *("duration", "pose", "velocity", "inputs", "driven", "input_period", "parameters"),
        *("solution", "table"),
    ),
    "The method": (
        *("method", "formulation", "step", "rtol", "atol", "stages", "rho", "loops", "alpha", "beta"),
        *("max_steps", "max_seconds"),
    ),
    "Many motions": ("starts", "vary", "seed", "threads"),
    "Results": ("output_step", "columns", "format"),
}


@click.command(
    "simulate",
    cls=ModelCommand,
    sections=SECTIONS,
    help=SIMULATE_HELP.replace("METHODS", list_methods()).replace("KEEPING", list_keeping()),
)
@click.argument("model", type=click.Path(path_type=Path))
@output_folder("simulation", "a model NAME")
@click.option("--settings", "file", type=click.Path(path_type=Path), help="A file with settings; see above.")
@click.option("--duration", metavar="T", help="The length of the motion [s].")
@click.option("--method", type=NameType(METHODS), help="How to integrate; by default dop853.")
@click.option(
    "--formulation",
    type=click.Choice([f.value for f in Formulation]),
    help="The form of the equations of motion; by default exp2.",
)
@click.option("--step", metavar="H", help="The longest step of a method with fixed steps [s]; by default 1e-3.")
@click.option("--rtol", metavar="R", help="The relative tolerance of an adaptive method; by default 1e-9.")
@click.option("--atol", metavar="A", help="The absolute tolerance, in rad, m, rad/s and m/s; by default 1e-9.")
@click.option("--stages", type=int, metavar="S", help="The stages of radau-iia and gauss, 1 to 9; by default 2.")
@click.option(
    "--rho",
    metavar="R",
    help="The part of the highest frequencies that a step of generalized-alpha keeps, 0 to 1; by default 0.8.",
)
@click.option(
    "--loops",
    type=click.Choice([keeping.value for keeping in Keeping]),
    help="How loops are kept closed; by default the first way above that has the method.",
)
@click.option("--alpha", metavar="A", help="Baumgarte's gain of the rate at which loops open [1/s]; by default 5.")
@click.option("--beta", metavar="B", help="Baumgarte's gain of the gap [1/s]; by default 5.")
@click.option("--output-step", metavar="H", help="The time between stored states [s]; by default T/1000.")
@click.option("--max-steps", type=int, metavar="N", help="The largest number of steps; by default 10 million.")
@click.option("--max-seconds", metavar="S", help="The largest processor time; by default 60 s.")
@click.option(
    "--pose", multiple=True, metavar="NAME=NUMBER", help="The initial value of a coordinate [rad, m]: --pose q1=pi/2"
)
@click.option(
    "--velocity", multiple=True, metavar="NAME=NUMBER", help="The initial velocity of a coordinate [rad/s, m/s]."
)
@click.option(
    "--input",
    "inputs",
    multiple=True,
    metavar="NAME=EXPRESSION",
    help="The input of an actuated joint [N m, N], by the time t and the state: --input 'q1=0.2*sin(3*t) - 2*qd_q1'",
)
@click.option(
    "--driven",
    multiple=True,
    metavar="NAME=EXPRESSION",
    help="The motion of a driven joint over the time t: --driven 'q1=0.2*sin(3*t)'; by default it stands still.",
)
@click.option("--input-period", metavar="H", help="Compute inputs every H seconds, and hold them in between.")
@click.option("--parameter", "parameters", multiple=True, metavar="NAME=NUMBER", help="A run-time parameter.")
@click.option(
    "--solution",
    type=click.Path(path_type=Path),
    help="A solution.json of `mbsrun solve`: its inputs, and its start, parameters and motions of driven joints unless "
    "others are given.",
)
@click.option(
    "--inputs",
    "table",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="A table of inputs from time 0 on, linear between its rows: CSV, MOT or STO, with columns NAME, u[NAME] or "
    "input[NAME]; other inputs are 0.",
)
@click.option(
    "--starts", metavar="TABLE|N", help="Make many motions, from the starts of a table, or from N random ones."
)
@click.option("--vary", multiple=True, metavar="NAME=LOW:HIGH", help="Draw a number of each random start from a range.")
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, metavar="S", help="The seed of random starts; by default 0."
)
@click.option(
    "--threads",
    type=click.IntRange(min=1),
    default=1,
    metavar="K",
    help="With --starts: the number of threads; by default 1.",
)
@more_columns
@choose_format
@accept_robots
@click.pass_context
def simulate_command(
    context: click.Context,
    /,
    model: Path,
    out: Path | None,
    file: Path | None,
    solution: Path | None,
    table: Path | None,
    columns: tuple[str, ...],
    starts: str | None,
    vary: tuple[str, ...],
    seed: int,
    threads: int,
    **given: Any,
) -> None:
    """Read, integrate, write, print."""
    _check_starts(context, starts, columns)
    mechanism = load(model, extent=INTEGRATED)
    if solution is not None and table is not None:
        raise click.UsageError("--solution and --inputs both give the inputs; leave one out")
    recording = None if solution is None else _read_recording(solution, mechanism.manifest)
    if table is not None:
        recording = _read_table(table, mechanism.manifest)
    statement = read_statement(file, _collect_options(given), mechanism.manifest, recording)
    mechanism = mechanism.with_parameters(**statement.parameters)
    out = out or Path(f"{model.stem}.simulation")
    if starts is not None:
        if not simulate_starts(mechanism, statement, Wish(starts, vary, seed, threads), out):
            context.exit(NOT_SOLVED)
        return
    q, qd, note = close_start(mechanism, statement.start, statement.course)
    if note:
        say(f"note: {note}")
    Numbers(mechanism, list_quantities(mechanism.manifest, Added()), {}).select(columns)
    with show_status("integrating") as status:

        def show(time: float) -> None:
            status.update(f"integrating: t = {time:.4g} of {statement.settings.duration:.4g} s")

        motion = simulate(mechanism, statement.drive, q, qd, statement.settings, show, statement.course)
        status.update("writing")
        write_motion(motion, mechanism, out, columns)
    _print_motion(motion, mechanism.manifest)
    say(f"wrote {list_written(out, MOTION_FILES)}")
    for warning in motion.warnings:
        say(f"warning: {warning}")
    if motion.halt is not None:
        say(f"{motion.halt}; what was written is incomplete")
        context.exit(NOT_SOLVED)


def _check_starts(context: click.Context, starts: str | None, columns: tuple[str, ...]) -> None:
    """Refuse options that have no effect without many starts, or with them."""
    if starts is not None and columns:
        raise click.UsageError("--columns belongs to the table of one motion; leave it out, or --starts")
    for name in ("vary", "seed", "threads"):
        is_given = context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE
        if starts is None and is_given:
            raise click.UsageError(f"--{name} belongs to many motions; give --starts, or leave it out")


def _collect_options(given: Mapping[str, Any]) -> dict[str, Data]:
    """Nest options as a settings file does; NAME=VALUE is split at its last =, since names may hold one."""
    options: dict[str, Data] = {name: given[name] for name in PLAIN if given[name] is not None}
    start: dict[str, Data] = {key: pairs for key in ("pose", "velocity") if (pairs := _split(key, given[key]))}
    lists = {"start": start, "inputs": _split("input", given["inputs"])}
    lists["driven"] = _split("driven", given["driven"])
    lists["parameters"] = _split("parameter", given["parameters"])
    return {**options, **{key: pairs for key, pairs in lists.items() if pairs}}


def _split(option: str, pairs: Sequence[str]) -> dict[str, Data]:
    values: dict[str, Data] = {}
    for pair in pairs:
        name, sign, value = pair.rpartition("=")
        if not sign or not name.strip() or name.strip() in values:
            finding = f"{name.strip()} is given twice" if sign and name.strip() else f"found {pair!r}"
            raise click.BadParameter(f"{finding}; give NAME=VALUE, each name once", param_hint=f"--{option}")
        values[name.strip()] = value
    return values


def _read_recording(path: Path, manifest: Manifest) -> Recording:
    """Take start, inputs, motions of driven joints and parameters of a solution; it must be one of this model."""
    found = read_solution(path)
    names, inputs = manifest.positions, tuple(manifest.coordinates[i].name for i in manifest.actuated)
    trajectory = found.trajectory
    given = trajectory.point_w.shape[-1]
    if (found.coordinates, found.inputs) != (names, inputs):
        own = f"coordinates {_list(found.coordinates)} and inputs {_list(found.inputs)}"
        remedy = f"give one of a model with coordinates {_list(names)} and inputs {_list(inputs)}"
        raise InputError([Fault(str(path), 0, "", f"it is of model {found.model}, with {own}", remedy)])
    if given != manifest.open_entries:
        finding = f"it has {given} components of open wrenches and signals, and the model {manifest.open_entries}"
        raise InputError([Fault(str(path), 0, "", finding, "solve the problem with this version of the model")])
    if found.mechanism not in ("", manifest.mechanism):
        say(f"warning: {path} was made with another version of the model")
    if trajectory.point_u.size or given:
        values = np.concatenate([trajectory.spread_inputs()[0], trajectory.point_w], axis=-1)
        drive = follow_polynomials(trajectory.t, trajectory.point_t, values)
    else:
        drive = hold_steps(trajectory.t, trajectory.u)
    known = {p.name for p in (*manifest.parameters, *manifest.design)}
    parameters = {name: value for name, value in found.parameters.items() if name in known}
    return Recording(drive, trajectory.q[0], trajectory.qd[0], parameters, _read_driven(found, manifest))


def _read_driven(found: Solution, manifest: Manifest) -> dict[str, Expression]:
    """Return the motions of driven joints over the time alone, with the numbers that were found."""
    unknowns = zip((x.name for x in found.problem.unknowns), found.trajectory.unknowns.tolist(), strict=True)
    values = dict(found.problem.constants) | dict(unknowns) | {HORIZON: float(found.trajectory.t[-1])}
    numbers: dict[str, Expression] = {name: Number(value) for name, value in values.items()}
    return {
        manifest.coordinates[drive.joint].name: substitute(parse(drive.expression), numbers)
        for drive in found.problem.driven
    }


def _list(names: Sequence[str]) -> str:
    return ", ".join(names) or "none"


def _read_table(path: Path, manifest: Manifest) -> Recording:
    """Read inputs over time, linear between rows. Raises InputError for a table without them, or with gaps."""
    found = read_recording(path)
    units = [manifest.coordinates[i].force_unit for i in manifest.actuated]
    units += [""] * (len(manifest.inputs) - len(units))
    times, values, used = found.times, np.zeros((len(found.times), len(manifest.inputs))), set()
    for k, (label, unit) in enumerate(zip(manifest.inputs, units, strict=True)):
        column = find_column(found, tuple(name.format(label) for name in INPUT_COLUMNS))
        if column is not None:
            values[:, k] = read_column(found, column, unit)
            used.add(column)
    faults = []
    if not used:
        columns = ", ".join(manifest.inputs) or "none: no joint is actuated"
        faults.append(Fault(str(path), 1, "", "no column is an input's", f"name columns as the inputs are: {columns}"))
    if times[0] != 0:
        faults.append(Fault(str(path), 2, "", f"the first time is {times[0]:g} s", "let the table begin at 0"))
    if not np.isfinite(values).all():
        first = times[np.flatnonzero(~np.isfinite(values).all(axis=1))[0]]
        faults.append(Fault(str(path), 0, "", f"an input is missing at {first:g} s", "give a number in each row"))
    if len(times) < 2:
        faults.append(Fault(str(path), 0, "", "it has one row", "give the inputs at two times or more"))
    if faults:
        raise InputError(faults)
    if left := [name for name in found.names if _is_of_no_input(name, manifest)]:
        say(f"warning: {path}: {', '.join(left)}: of no input of the model, which has {_list(manifest.inputs)}")
    ends = np.arange(len(times) - 1)[:, None] + [0, 1]
    return Recording(follow_polynomials(times, times[ends], values[ends]))


def _is_of_no_input(column: str, manifest: Manifest) -> bool:
    """Return whether a column names an input that the model does not have."""
    marks = [name.removesuffix("{}]") for name in INPUT_COLUMNS if name.endswith("[{}]")]
    label = next((column.removeprefix(mark).removesuffix("]") for mark in marks if column.startswith(mark)), None)
    return label is not None and label not in manifest.inputs


def _print_motion(motion: Motion, manifest: Manifest) -> None:
    settings, effort, energy = describe_settings(motion.settings), motion.effort, motion.energy
    numbers = ", ".join(f"{key} {value}" for key, value in settings.items() if key not in ("method", "formulation"))
    rows = {
        "model": f"{manifest.model}, {len(manifest.coordinates)} coordinates",
        "method": f"{settings['method']} ({METHODS[motion.settings.method].title}), {settings['formulation']}",
        "settings": numbers,
        "reached": f"{motion.t[-1]:.6g} s" + ("" if motion.halt is None else f" of {motion.settings.duration:.6g} s"),
        "steps": f"{effort.steps}, "
        + ("rejected: not counted" if effort.rejected is None else f"{effort.rejected} rejected"),
        "evaluations": f"{effort.evaluations}, {effort.jacobians} of Jacobians, {effort.iterations} Newton iterations",
        "time": f"{effort.seconds:.3g} s of processor",
    }
    if energy is None:
        rows["energy"] = "unknown: it overflows, or a kernel fails on the way"
    else:
        total, drift = energy.total, np.abs(energy.drift).max()
        rows["energy"] = f"{total[0]:.8g} J at the start, {total[-1]:.8g} J at the end, {energy.work[-1]:.4g} J of work"
        rows["energy drift"] = f"{drift:.1e} J at most"
    if energy is not None and energy.friction is not None and energy.impacts is not None:
        rows["losses"] = f"{energy.friction[-1]:.4g} J by dry friction, {energy.impacts[-1]:.4g} J by impacts"
    if motion.modes is not None:
        counts = Counter(event.kind.value for event in motion.events)
        rows["events"] = ", ".join(f"{kind} {count}" for kind, count in counts.items()) or "none"
    if motion.closure is not None:
        position, velocity = motion.closure.most
        rows["loops open"] = f"{position:.1e} at most, at a rate of {velocity:.1e}"
        if settings.get("loops") == Keeping.PARTITIONING.value:
            rows["switches"] = f"{effort.switches} of dependent coordinates"
    for name, text in rows.items():
        click.echo(f"{name:<14}{text}")
