"""What the charts show, for a report that takes their folder in: which files make a section, and how to read them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from mbsrun.environment import describe_environment
from mbsrun.measuring.sections import Caption, Outline, write_outline

MARKS = (
    "A point stands at the shortest of its times, and a line leads to their median. The grey line is the front: no "
    "point is both faster and more accurate than one on it; its points have labels. A cross is a failure, at the edge "
    "where it has no time or no error; the table gives the reason."
)
TIMES = "Times: the shortest and the median of the rounds, and what lies between their quarters, by the median."

OUTLINES: Mapping[str, Outline] = {
    outline.name: outline
    for outline in (
        Outline(
            "kernels",
            1,
            "Speed against accuracy: kernels",
            "Each formulation, in double and single precision, compiled with several flags, for the model and for "
            "chains of equal bodies; derivatives beside finite differences, and beside CasADi's of the same "
            "equations. Errors are against 50 digits, of the textbook's recursion, at the same inputs; times are of "
            "a loop in C over states that lie in memory, in many rounds of all in turn.",
            (
                Caption(
                    "kernels.png",
                    "Kernels: time of a call against the error of results",
                    "A row for each mechanism, a column for each task. Across: ns of a call; up: the largest error "
                    f"over the states, by the largest entry of a result. {MARKS}",
                ),
                Caption(
                    "kernels_backward.png",
                    "Kernels: time of a call against the backward error",
                    "Up: by how much the forces would have to be others for the result to be exact, joint by joint, by "
                    "|M| |qdd| + |c| + |Q|: what an ill-conditioned mass matrix does not enlarge.",
                ),
                Caption(
                    "derivatives.png",
                    "Derivatives: time of a Jacobian against its error",
                    "Generated, by differences of several steps, and by CasADi from the same equations. Differences "
                    "are charged with the calls that they take, not with their subtractions.",
                ),
                Caption("kernels.json", "Kernels and derivatives", TIMES),
            ),
        ),
        Outline(
            "simulation",
            2,
            "Speed against accuracy: simulation",
            "A motion of the model, by each method of simulation on each formulation that it can take, with several "
            "steps or tolerances. The reference is Gauss collocation with six stages, which is none of them, and as "
            "accurate as it agrees with DOP853 at a tolerance of 1e-13.",
            (
                Caption(
                    "simulation.png",
                    "Simulation: processor time against the error, and against the drift of energy",
                    "Left: the largest error at the end; grey: where the reference is no better. Right: the largest "
                    f"drift of energy, by the energy that is exchanged. Labels: step or tolerance. {MARKS}",
                ),
                Caption("simulation.json", "Simulations", f"Errors in rad and m, and these per s. {TIMES}"),
            ),
        ),
        Outline(
            "optimisation",
            3,
            "Speed against accuracy: optimal control",
            "The problem with several numbers of intervals, degrees, Radau and Legendre points, in all "
            "representations. Inputs are constant over an interval, so each number of intervals is a control grid "
            "with an optimum of its own, by which collocation is judged: that of Legendre points of degree 9, as "
            "accurate as it agrees with Radau points of degree 9.",
            (
                Caption(
                    "optimisation.png",
                    "Optimal control: time of a solve against the error of the cost, and against the defect",
                    "A column for each control grid. Above: the error of the cost on the same control grid; dashed: "
                    "what this grid itself costs; grey: where the reference is no better. Below: the largest defect "
                    f"of an interval by re-simulation. {MARKS}",
                ),
                Caption(
                    "control_grid.png",
                    "Optimal control: what the control grid costs, and what collocation adds",
                    "Errors of the cost against the number of intervals; the limit of fine grids is extrapolated from "
                    "the two finest.",
                ),
                Caption("optimisation.json", "Solves", f"The defect in rad and m, and these per s. {TIMES}"),
                Caption("control_grid.json", "Control grids", "The reference of each, with its accuracy."),
            ),
        ),
        Outline(
            "fidelity",
            4,
            "Speed against accuracy: what is left out",
            "Kernels of the model with something left out, beside those of the whole, at random states: what that "
            "saves, and the error that it makes, by the entries that are left.",
            (
                Caption(
                    "fidelity.png",
                    "Fidelity: time of a call against the error of leaving something out",
                    "A row for each kernel. Left: with locked joints where they are locked, and still what is taken to "
                    "be still; right: anywhere. Labels: what is left out, and which part of the flops that saves; "
                    f"dashed: the time of the whole. {MARKS}",
                ),
                Caption("fidelity.json", "Reductions", f"ns whole: of the model as it is. {TIMES}"),
            ),
        ),
    )
}


def write_captions(chart: str, mechanism: str, folder: Path) -> Path:
    """Write what the files of a chart show, of which model, and where they were measured; give the path."""
    outline = OUTLINES[chart]
    told = ", ".join(f"{name} {value}" for name, value in describe_environment().items())
    text = f"{outline.text} Measured of {mechanism}: {told}."
    return write_outline(replace(outline, text=text), folder)
