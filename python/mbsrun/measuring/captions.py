"""Captions of charts: a report includes the folder of a chart, and shows its files as a section."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from mbsrun.environment import describe_environment
from mbsrun.measuring.sections import Caption, Outline, write_outline

MARKS = (
    "A dot is a setting, at the shortest of its times. A line joins the best settings of a method, and its name is at "
    "the end; slower methods are grey. Lower and further left is better: the broad band is the front. Settings "
    "that failed are in the table, with the reason."
)
TIMES = (
    "Times: the shortest and the median of the rounds; the spread is the distance of their quartiles, by the median."
)

OUTLINES: Mapping[str, Outline] = {
    outline.name: outline
    for outline in (
        Outline(
            "fronts",
            0,
            "Speed against accuracy: all choices",
            "All that can be chosen for the model: formulation, precision, method, grid, and what may be left out.",
            (
                Caption(
                    "fronts.png",
                    "Speed against accuracy",
                    "A panel for each need, with its finding. A ring marks the setting that `mbsrun advise` chooses "
                    f"for errors up to the dashed line. {MARKS}",
                ),
                Caption("fronts.json", "Settings", "Times are the shortest of the rounds."),
            ),
        ),
        Outline(
            "kernels",
            1,
            "Speed against accuracy: kernels",
            "Each formulation, in single, double and double-double precision, compiled with several flags, for the "
            "model and for chains of equal bodies; derivatives beside finite differences, and beside CasADi's of "
            "the same equations. The reference is the textbook's recursion in 50 digits, at the same inputs. A loop "
            "in C over states in memory is timed, in many rounds of all in turn.",
            (
                Caption(
                    "kernels.png",
                    "Kernels: time of a call against the error of results",
                    "A panel for each mechanism and task. Up: the largest error over the states, by the largest entry "
                    f"of a result. {MARKS}",
                ),
                Caption(
                    "kernels_backward.png",
                    "Kernels: time of a call against the backward error",
                    "Up: the change of the forces that makes the result exact, joint by joint, by "
                    "|M| |qdd| + |c| + |Q|. An ill-conditioned mass matrix does not enlarge it.",
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
            "steps or tolerances. The reference is another method, Gauss collocation with six stages. Its difference "
            "from DOP853 at a tolerance of 1e-13 is its accuracy.",
            (
                Caption(
                    "simulation.png",
                    "Simulation: processor time against the error, and against the drift of energy",
                    "Left: the largest error at the end; shaded: where the reference is no better. Right: the largest "
                    f"drift of energy, by the energy that is exchanged. {MARKS}",
                ),
                Caption("simulation.json", "Simulations", f"Errors in rad and m, and these per s. {TIMES}"),
            ),
        ),
        Outline(
            "optimisation",
            3,
            "Speed against accuracy: optimal control",
            "The problem with several numbers of intervals, degrees, Radau and Legendre points, in all "
            "representations; the highest degree of Radau points also with other tolerances of the solver. "
            "Inputs are constant over an interval, so each number of intervals is a control grid "
            "with its own optimum. The reference is the optimum with Legendre points of degree 9; its difference from "
            "Radau points of degree 9 is its accuracy.",
            (
                Caption(
                    "optimisation.png",
                    "Optimal control: time of a solve against the error of the cost, and against the defect",
                    "A row for each control grid. Left: the error of the cost on the same control grid; shaded: where "
                    "the reference is no better. Right: the largest defect of an interval by re-simulation. "
                    f"{MARKS}",
                ),
                Caption(
                    "control_grid.png",
                    "Optimal control: error of the control grid, and error of collocation",
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
            "Speed against accuracy: reduced models",
            "Kernels of the model with something left out, beside the kernels of the whole model, at random states: "
            "saved time, and the error of the remaining entries.",
            (
                Caption(
                    "fidelity.png",
                    "Fidelity: time of a call against the error of leaving something out",
                    "A row for each kernel. Left: states that agree with the reduction; right: any state. Reductions "
                    f"that save a tenth of the time have names; dashed: the time of the whole model. {MARKS}",
                ),
                Caption("fidelity.json", "Reductions", f"ns whole: time of the whole model. {TIMES}"),
            ),
        ),
    )
}


def write_captions(chart: str, mechanism: str, folder: Path) -> Path:
    """Write the captions of a chart with its model and its environment; return the path."""
    outline = OUTLINES[chart]
    environment = ", ".join(f"{name} {value}" for name, value in describe_environment().items())
    text = f"{outline.text} Measured of {mechanism}: {environment}."
    return write_outline(replace(outline, text=text), folder)
