"""Closed loops, and how long their controllers take: `python -m benchmarks.track`.

The trials of models/track are run by the commands that a user types, each with the default method, with IPOPT, and with
the controller in C, which solves every sample or makes one step. Times are medians of the processor and, beside them,
99.9th percentiles, in ms. A trial fails if a measure exceeds its limit or the end is not reached.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from click.testing import CliRunner
from rich.console import Console

from benchmarks.compilation import describe_machine
from benchmarks.pages import tabulate
from mbsrun.cli import cli

TRIALS = Path(__file__).parents[1] / "models" / "track"
WAYS: Mapping[str, tuple[str, ...]] = {
    "mbs": (),
    "IPOPT": ("--solver", "ipopt"),
    "C, solved": ("--controller",),
    "C, one step": ("--steps", "1", "--controller"),
    "C, rescued": ("--steps", "1", "--rescue", "5", "--controller"),
}

Summary = Mapping[str, Any]


def run(*arguments: str) -> int:
    """Run a command; return its exit code."""
    return CliRunner().invoke(cli, list(arguments)).exit_code


def follow(name: str, way: str, folder: Path) -> Summary | None:
    """Run a trial in one way, and return its summary; None where it has none."""
    options = WAYS[way]
    problem, settings = str(TRIALS / f"{name}.ocp.yaml"), str(TRIALS / f"{name}.track.yaml")
    controller, out = folder / f"{name}.controller", folder / f"{name}.{way.replace(' ', '_').replace(',', '')}"
    if "--controller" in options:
        if not controller.exists() and run("controller", problem, "-o", str(controller)) != 0:
            return None
        options = (*options, str(controller))
    run("track", problem, "--settings", settings, *options, "-o", str(out))
    summary = out / "summary.json"
    return json.loads(summary.read_text("utf-8")) if summary.exists() else None


def write_page(found: Mapping[tuple[str, str], Summary | None]) -> str:
    """Write the table as a page."""
    about = (__doc__ or "").split("\n\n")[1].strip().replace("\n", " ")
    lines = [
        "# Closed loops",
        "",
        f"`python -m benchmarks.track` wrote this page: {describe_machine()}.",
        "",
        about,
        "",
    ]
    titles = ["trial", "controller", "samples", "failures", "a sample", "99.9 %", "preparation", "99.9 %", "iterations"]
    lines += tabulate(
        [*titles, "measures"], ([name, way, *_list_cells(summary)] for (name, way), summary in found.items()), words=2
    )
    return "\n".join(lines) + "\n"


def _list_cells(summary: Summary | None) -> list[str]:
    if summary is None:
        return ["no plan", *[""] * 7]
    times = [_milliseconds(summary["seconds"], key) for key in ("median", "tail")]
    times += [_milliseconds(summary["seconds_preparing"], key) for key in ("median", "tail")]
    counts = [str(summary["samples"]), str(summary["failures"])]
    return [*counts, *times, f"{summary['iterations']['mean']:.1f}", _judge(summary)]


def _judge(summary: Summary) -> str:
    if halt := summary["halt"]:
        return f"lost: its simulation halts at {halt['time']:.2g} s"
    verdicts = (f"{name} {part['largest']:.2g} of {part['most']:.2g}" for name, part in summary["measures"].items())
    return ("" if summary["met"] else "fails: ") + "; ".join(verdicts)


def _milliseconds(times: Mapping[str, float], key: str) -> str:
    return f"{1e3 * times[key]:.3g}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run, print and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.track", description=__doc__)
    names = sorted(path.name.removesuffix(".track.yaml") for path in TRIALS.glob("*.track.yaml"))
    parser.add_argument("--trials", nargs="+", choices=names, default=names, help="all")
    parser.add_argument("--ways", nargs="+", choices=list(WAYS), default=list(WAYS), help="all")
    parser.add_argument(
        "--out", type=Path, default=Path("build/bench-track"), help="the folder: track.md, and all results"
    )
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    console, found = Console(), dict[tuple[str, str], Summary | None]()
    for name in given.trials:
        for way in given.ways:
            found[name, way] = follow(name, way, given.out)
            console.print(f"{name}, {way}: {' '.join(_list_cells(found[name, way])[:4])}")
    page = given.out / "track.md"
    page.write_text(write_page(found), encoding="utf-8")
    console.print(f"wrote {page}")


if __name__ == "__main__":
    main()
