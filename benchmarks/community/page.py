"""Diagrams of motions, and the certificates of their ends -> a page: who is quickest at 3, 6, 9, 12 digits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from benchmarks.candidates import OURS
from benchmarks.community.problems import TITLES, read_certificates
from benchmarks.loops.motions import Diagram, Point
from benchmarks.pages import tabulate

DIGITS = (3, 6, 9, 12)
AUTHORS = ("Pinocchio", "Simbody", "Exudyn", "MuJoCo")
_TEXT = """\
Processor time of the quickest setting whose error at the end is at most 10^-3, 10^-6, 10^-9 and 10^-12. The error is
the largest of |x - x*| / (1 + |x*|) over coordinates and velocities; of Exudyn's bodies in space, over places and
velocities of centres of mass. Each program tries its methods from coarse to fine, {repeats} times; its shortest time
counts. Clocks run while motions are integrated; models are read before. `python -m benchmarks.community` repeats this.

- mbsgen: DOP853 and RK45 in C, on EXP1 and EXP2, with each way to keep loops closed; Radau IIA for the stiff governor.
- Pinocchio has no integrator, and gets DOP853 in C++, without projection: articulated bodies for trees,
  `constraintDynamics` for loops.
- Simbody: Runge-Kutta-Merson, Runge-Kutta-Feldberg, and CPodes for the governor, with its own projection.
- Exudyn: absolute coordinates, with generalised alpha or the trapezoidal rule; for trees minimal ones and DOPRI5.
- MuJoCo: Runge-Kutta 4 and its implicit method; its loops are soft.

All programs have the same coordinates. In the governor, the peers have springs where our model has struts of 1 mg. The
wheelset of the Test Set for IVP Solvers is left out: model files have no words for its profiles of wheel and rail and
their creep forces. Whipple's bicycle has a certificate alone: no peer here rolls without slip. Our time stepping comes
near it by order 1, to 4e-3 with 1 ms and 1e-3 with 0.25 ms.
"""


def write_page(diagrams: Sequence[Diagram], machine: str, repeats: int) -> str:
    """Write the page."""
    loads = [x for diagram in diagrams for x in diagram.load]
    lines = ["# The community's motions", "", f"{machine}. Load of the machine meanwhile: {min(loads):.1f} to "]
    lines[-1] += f"{max(loads):.1f}."
    lines += ["", *_TEXT.format(repeats=repeats).splitlines(), "", "## Who is quickest", ""]
    titles = ["motion", *(f"{n} digits" for n in DIGITS)]
    lines += tabulate(titles, ([TITLES[x.problem], *map(_judge, _list_levels(x))] for x in diagrams), 5)
    lost = list(_list_lost(diagrams))
    lines += ["", "## What to mend next", "", *(lost or ["No peer is quicker at any of these digits."])]
    for diagram in diagrams:
        lines += ["", f"## {TITLES[diagram.problem]}: time", ""]
        titles = ["digits", OURS, *AUTHORS]
        lines += tabulate(titles, ([str(n), *_write_row(diagram, n)] for n in DIGITS), len(titles))
    lines += ["", "## Certificates of the ends", "", *_describe_certificates(), ""]
    lines += tabulate(["motion", "first method", "second method", "difference"], _list_certificates(), 4)
    return "\n".join(lines) + "\n"


def _list_levels(diagram: Diagram) -> Iterator[tuple[Point | None, Point | None]]:
    """List our quickest point and the peers', for each number of digits."""
    for n in DIGITS:
        peers = [x for author in AUTHORS if (x := diagram.find_best(author, 10.0**-n)) is not None]
        yield diagram.find_best(OURS, 10.0**-n), min(peers, key=lambda x: x.seconds, default=None)


def _judge(pair: tuple[Point | None, Point | None]) -> str:
    own, peer = pair
    if own is None:
        return "none" if peer is None else f"**{peer.author}** alone"
    if peer is None:
        return f"{OURS} alone"
    if own.seconds <= peer.seconds:
        return f"{OURS}, {_write(peer.seconds / own.seconds)} times faster than {peer.author}"
    return f"**{peer.author}**, {_write(own.seconds / peer.seconds)} times faster"


def _list_lost(diagrams: Sequence[Diagram]) -> Iterator[str]:
    for diagram in diagrams:
        for n, (own, peer) in zip(DIGITS, _list_levels(diagram), strict=True):
            if peer is not None and (own is None or own.seconds > peer.seconds):
                ours = "we do not reach them" if own is None else f"{_time(own)} by {own.method}"
                theirs = f"{peer.author} takes {_time(peer)} ({peer.method})"
                yield f"- {TITLES[diagram.problem]}, {n} digits: {theirs}; {ours}."
            elif own is None:
                yield f"- {TITLES[diagram.problem]}, {n} digits: nobody reaches them in doubles."


def _write_row(diagram: Diagram, digits: int) -> Iterator[str]:
    for author in (OURS, *AUTHORS):
        point = diagram.find_best(author, 10.0**-digits)
        yield "–" if point is None else f"{_time(point)} ({point.method})"


def _write(ratio: float) -> str:
    return f"{ratio:.0f}" if ratio >= 10 else f"{ratio:.2g}"


def _time(point: Point) -> str:
    microseconds = 1e6 * point.seconds
    return f"{microseconds:.3g} us" if microseconds < 1000 else f"{microseconds / 1000:.3g} ms"


def _describe_certificates() -> list[str]:
    return [
        "Each end was computed twice in 50 digits, on equations that no part of the engine writes;",
        "`tests/reference/motions.json` keeps 25 digits; `python -m tests.motion_references NAME` makes them again.",
        "The governor's is of 1 s; its end at 10 s is the second method's.",
    ]


def _list_certificates() -> Iterator[list[str]]:
    for name, content in read_certificates().items():
        yield [name.replace("_", " "), *content["methods"], content["difference"]]
