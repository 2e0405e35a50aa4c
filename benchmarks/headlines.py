"""The pages of single benchmarks in `benchmarks/results` -> sentences about them, by the numbers in their tables."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TypeVar

Row = dict[str, str]  # cells by the names of the columns
Tables = dict[str, list[Row]]  # by the last heading before; of two tables under one heading, the first

T = TypeVar("T")

NONE = "–"


class PageError(ValueError):
    """A page lacks what a sentence needs."""


def read_tables(text: str) -> Tables:
    """Read the first table under each heading of a page in Markdown."""
    tables: Tables = {}
    heading, lines = "", text.splitlines()
    for k, line in enumerate(lines):
        if line.startswith("#"):
            heading = line.lstrip("# ")
        elif line.startswith("|") and not lines[k - 1].startswith("|") and heading not in tables:
            tables[heading] = list(_read_rows(lines[k:]))
    return tables


def _read_rows(lines: Sequence[str]) -> Iterator[Row]:
    columns = _split(lines[0])
    for line in lines[2:]:
        if not line.startswith("|"):
            return
        yield dict(zip(columns, _split(line), strict=True))


def _split(line: str) -> list[str]:
    return [cell.strip().strip("*") for cell in line.strip().strip("|").split("|")]


def read_number(cell: str) -> float:
    """Read the first number of a cell; of several, such as least and median, the first counts."""
    found = re.search(r"\d+(\.\d*)?", cell)
    if found is None:
        raise PageError(f"no number in {cell!r}")
    return float(found.group())


def write_times(ratio: float) -> str:
    """Write how many times faster something is, to two digits."""
    return f"{float(f'{ratio:.2g}'):g}"


def compare_iterations(ratio: float) -> str:
    """Write who takes more iterations, from the ratio of our iterations to IPOPT's."""
    if ratio <= 0:
        raise PageError(f"{ratio} is no ratio of iterations")
    if ratio > 1:
        return f"it takes {write_times(ratio)} times as many iterations as IPOPT"
    return f"IPOPT takes {write_times(1 / ratio)} times as many iterations"


def find_row(rows: Sequence[Row], column: str, beginning: str) -> Row:
    """Return the row whose cell begins with a text."""
    for row in rows:
        if row[column].startswith(beginning):
            return row
    raise PageError(f"no row has {beginning!r} in the column {column!r}")


def _search(pattern: str, text: str) -> str:
    found = re.search(pattern, text)
    if found is None:
        raise PageError(f"no {pattern!r}")
    return found.group(1)


def describe_loops(text: str) -> str:
    """Describe kernels of closed loops, and one motion."""
    tables = read_tables(text)
    rows = [r for r in tables["Kernels"] if r["function"] == "accelerations" and r["by ours, libm"] != NONE]
    ratios = sorted(read_number(row["by ours, libm"]) for row in rows)
    least, most = write_times(ratios[0]), write_times(ratios[-1])
    motion = next(rows for heading, rows in tables.items() if heading.startswith("Andrews"))
    coarse, fine = (read_number(find_row(motion, "", level)["mbsgen"]) for level in ("1e-07", "1e-11"))
    return (
        f"On mechanisms with closed loops, accelerations are {least} to {most} times faster than the quickest peer's, "
        f"with the same sines. Andrews' squeezing mechanism takes {coarse:.2g} ms for 7 digits and {fine:.2g} ms for "
        "11 ([figures](loops.md))."
    )


def describe_ocp_loops(text: str) -> str:
    """Describe optimal motions of closed loops."""
    tables = read_tables(text)
    five_bar, delta = tables["five_bar_reach.ocp.yaml"], tables["delta_pick.ocp.yaml"]
    tuned, plain = (
        [
            write_times(read_number(find_row(rows, "way", f"CasADi, interpreted, {way}")["ratio"]))
            for rows in (five_bar, delta)
        ]
        for way in ("tuned", "defaults")
    )
    return (
        f"Optimal motions of a five-bar and a Delta robot are found {tuned[0]} and {tuned[1]} times faster than by "
        f"tuned CasADi with IPOPT, {plain[0]} and {plain[1]} times faster than by its defaults "
        "([figures](ocp_loops.md))."
    )


def describe_kkt(text: str) -> str:
    """Describe the linear solver."""
    problems = _search(r"(\d+) problems, \d+ programs", text)
    algebra = write_times(float(_search(r"the time of linear algebra is ([\d.]*\d)", text)))
    whole = write_times(float(_search(r"of whole solves ([\d.]*\d)", text)))
    return (
        f"On {problems} problems of optimal control from the literature, the linear solver is {algebra} times faster "
        f"than MUMPS, and whole solves are {whole} times faster with it ([figures](kkt.md))."
    )


def describe_methods(text: str) -> str:
    """Describe the method by stages beside IPOPT."""
    whole = find_row(next(iter(read_tables(text).values())), "group", "all")
    ours, theirs = whole["solved"].split(", ")
    more = compare_iterations(read_number(whole["mean ratio"]))
    return (
        f"The method by stages solves {ours} of {whole['tasks']} tasks, IPOPT {theirs}; {more} ([figures](methods.md))."
    )


def describe_ends(text: str) -> str:
    """Describe random problems that end on their limits."""
    whole = find_row(next(iter(read_tables(text).values())), "kind", "all")
    ours, theirs = whole["solved"].split(", ")
    more = compare_iterations(read_number(whole["mean ratio"]))
    return (
        f"Of {whole['problems']} random problems that end on their limits it solves {ours}, IPOPT {theirs}; {more} "
        "([figures](ends.md))."
    )


def describe_classics(text: str) -> str:
    """Describe published problems."""
    problems = _search(r"- (\d+) problems", text)
    digits = _search(r"- (\d+) optima agree with all printed digits", text)
    ratio = write_times(float(_search(r"each at its best: ([\d.]*\d)", text)))
    return (
        f"The optima of {digits} of {problems} published problems agree with all printed digits. In the mean they are "
        f"found {ratio} times faster than by plain CasADi on the same grid ([figures](classics.md))."
    )


def describe_legged(text: str) -> str:
    """Describe motions in phases."""
    rows = next(iter(read_tables(text).values()))
    least = write_times(min(read_number(row["ratio"]) for row in rows))
    bound = read_number(find_row(rows, "problem", "bound")["ours, s"])
    return (
        f"Each of {len(rows)} motions of legs and arms in phases is found at least {least} times faster than by plain "
        f"CasADi with IPOPT, in processor time; a quadruped's bound takes {bound:.2g} s ([figures](legged.md))."
    )


def describe_mpc(text: str) -> str:
    """Describe predictive control: the first two tables are of solves, and of steps in real time."""
    tables = read_tables(text)
    solves, latencies = (rows for rows, _ in zip(tables.values(), range(2), strict=False))
    latency = latencies[0]
    own = [row for row in solves if row["N"] == latency["N"]]
    fatrop, acados = (
        write_times(read_number(find_row(own, "solver", name)["by ours"])) for name in ("fatrop", "acados")
    )
    ours, theirs = (
        read_number(find_row(own, "solver", name)["cold: iterations, ms"].split(",")[1]) for name in ("mbs", "acados")
    )
    ratio, word = (ours / theirs, "faster") if theirs < ours else (theirs / ours, "slower")
    return (
        f"With {latency['N']} steps ahead, a Panda's controller prepares a step in {latency['preparation']} µs and "
        f"answers a measured state in {latency['feedback']} µs; a whole solve from the plan before is {fatrop} times "
        f"faster than fatrop's and {acados} times faster than acados'. A first solve, without a plan, is "
        f"{write_times(ratio)} times {word} with acados ([figures](mpc.md))."
    )


PARAGRAPHS: tuple[Mapping[str, Callable[[str], str]], ...] = (
    MappingProxyType({"loops.md": describe_loops, "ocp_loops.md": describe_ocp_loops}),
    MappingProxyType(
        {
            "kkt.md": describe_kkt,
            "methods.md": describe_methods,
            "ends.md": describe_ends,
            "classics.md": describe_classics,
        }
    ),
    MappingProxyType({"legged.md": describe_legged, "mpc.md": describe_mpc}),
)


def write_headlines(folder: Path) -> str:
    """Write the sentences of all pages, as paragraphs. Raises PageError with the name of the page."""
    return "\n\n".join(
        " ".join(read_page(folder / name, describe) for name, describe in paragraph.items()) for paragraph in PARAGRAPHS
    )


def read_page(page: Path, describe: Callable[[str], T]) -> T:
    try:
        return describe(page.read_text(encoding="utf-8"))
    except (PageError, LookupError, StopIteration, ValueError) as error:
        raise PageError(f"{page}: {error}; write the page anew") from error
