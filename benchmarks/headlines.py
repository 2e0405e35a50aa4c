"""The pages of single benchmarks in `benchmarks/results` -> sentences of the README, by the numbers in their tables."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

Row = dict[str, str]  # cells by the names of the columns
Tables = dict[str, list[Row]]  # by the last heading before; of two tables under one heading, the first

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


def _part(ratio: float) -> str:
    """Write a ratio to two digits, as the part that ours is of it."""
    return f"1/{float(f'{ratio:.2g}'):g}"


def _find(rows: Sequence[Row], column: str, beginning: str) -> Row:
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
    motion = next(rows for heading, rows in tables.items() if heading.startswith("Andrews"))
    coarse, fine = (read_number(_find(motion, "", level)["mbsgen"]) for level in ("1e-07", "1e-11"))
    return (
        f"On mechanisms with closed loops, accelerations take {_part(ratios[0])} to {_part(ratios[-1])} of the time of "
        f"the quickest peer, with the same sines. Andrews' squeezing mechanism takes {coarse:.2g} ms for 7 digits and "
        f"{fine:.2g} ms for 11 ([figures](loops.md))."
    )


def describe_ocp_loops(text: str) -> str:
    """Describe optimal motions of closed loops."""
    tables = read_tables(text)
    five_bar, delta = tables["five_bar_reach.ocp.yaml"], tables["delta_pick.ocp.yaml"]
    tuned, plain = (
        [_part(read_number(_find(rows, "way", f"CasADi, interpreted, {way}")["ratio"])) for rows in (five_bar, delta)]
        for way in ("tuned", "defaults")
    )
    return (
        f"Optimal motions of a five-bar and a Delta robot take {tuned[0]} and {tuned[1]} of the time of tuned CasADi "
        f"with IPOPT, {plain[0]} and {plain[1]} of its defaults ([figures](ocp_loops.md))."
    )


def describe_kkt(text: str) -> str:
    """Describe the linear solver."""
    problems = _search(r"(\d+) problems, \d+ programs", text)
    algebra = _part(float(_search(r"the time of linear algebra is ([\d.]*\d)", text)))
    whole = _part(float(_search(r"of whole solves ([\d.]*\d)", text)))
    return (
        f"On {problems} problems of optimal control from the literature, the linear solver takes {algebra} of the time "
        f"of MUMPS in linear algebra, and {whole} in whole solves ([figures](kkt.md))."
    )


def describe_methods(text: str) -> str:
    """Describe the method by stages beside IPOPT."""
    whole = _find(next(iter(read_tables(text).values())), "group", "all")
    ours, theirs = whole["solved"].split(", ")
    solved = f"solves {ours} tasks of {whole['tasks']}, IPOPT {theirs}"
    return f"The method by stages {solved}, in {whole['mean ratio']} times its iterations ([figures](methods.md))."


def describe_ends(text: str) -> str:
    """Describe random problems that end on their limits."""
    whole = _find(next(iter(read_tables(text).values())), "kind", "all")
    ours, theirs = whole["solved"].split(", ")
    return (
        f"Of {whole['problems']} random problems that end on their limits it solves {ours}, IPOPT {theirs}, in "
        f"{whole['mean ratio']} times its iterations ([figures](ends.md))."
    )


def describe_classics(text: str) -> str:
    """Describe published problems."""
    problems = _search(r"- (\d+) problems", text)
    digits = _search(r"- (\d+) optima agree with all printed digits", text)
    ratio = _part(float(_search(r"each at its best: ([\d.]*\d)", text)))
    return (
        f"Of {problems} published problems, {digits} end at all printed digits, in {ratio} of the time of plain CasADi "
        "on the same grid in the mean ([figures](classics.md))."
    )


def describe_legged(text: str) -> str:
    """Describe motions in phases."""
    rows = next(iter(read_tables(text).values()))
    most = _part(min(read_number(row["ratio"]) for row in rows))
    bound = read_number(_find(rows, "problem", "bound")["ours, s"])
    return (
        f"Each of {len(rows)} motions of legs and arms in phases takes {most} or less of the processor time of plain "
        f"CasADi with IPOPT; a quadruped's bound takes {bound:.2g} s ([figures](legged.md))."
    )


def describe_mpc(text: str) -> str:
    """Describe predictive control: the first two tables are of solves, and of steps in real time."""
    tables = read_tables(text)
    solves, latencies = (rows for rows, _ in zip(tables.values(), range(2), strict=False))
    latency = latencies[0]
    own = [row for row in solves if row["N"] == latency["N"]]
    fatrop, acados = (_part(read_number(_find(own, "solver", name)["by ours"])) for name in ("fatrop", "acados"))
    return (
        f"With {latency['N']} steps ahead, a Panda's controller prepares a step in {latency['preparation']} µs and "
        f"answers a measured state in {latency['feedback']} µs; a whole solve from the plan before takes {fatrop} of "
        f"the time of fatrop and {acados} of the time of acados ([figures](mpc.md))."
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
        " ".join(_describe(folder / name, describe) for name, describe in paragraph.items()) for paragraph in PARAGRAPHS
    )


def _describe(page: Path, describe: Callable[[str], str]) -> str:
    try:
        return describe(page.read_text(encoding="utf-8"))
    except (PageError, LookupError, StopIteration, ValueError) as error:
        raise PageError(f"{page}: {error}; write the page anew") from error
