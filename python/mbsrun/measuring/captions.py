"""Captions of charts: a report includes the folder of a chart, and shows its files as a section."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from mbsrun.environment import describe_environment
from mbsrun.measuring.sections import Caption, Outline, write_outline

MARKS = (
    "A dot is a setting, at its shortest time. A line joins the best settings of a method, with the method's name at "
    "its end; slower methods are grey. Lower and further left is better: the broad band is the front. The table lists "
    "failed settings, with the reason."
)
TIMES = (
    "Times are the shortest and the median of the rounds; the spread is the distance between their quartiles, relative "
    "to the median."
)

OUTLINES: Mapping[str, Outline] = {
    outline.name: outline
    for outline in (
        Outline(
            "fronts",
            0,
            "Speed against accuracy: all choices",
            "All choices for the model: formulation, precision, method, grid, and the parts that may be left out.",
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
            "Each formulation in single, double and double-double precision, compiled with several flags, for the "
            "model and for chains of equal bodies. Derivatives are compared with finite differences, and with CasADi's "
            "derivatives of the same equations. The reference is the textbook's recursion in 50 digits, at the same "
            "inputs. Times are of a loop in C over states in memory, in many rounds, in which all take turns.",
            (
                Caption(
                    "kernels.png",
                    "Kernels: time of a call against the error of results",
                    "A panel for each mechanism and task. Vertical axis: the largest error over the states, relative "
                    f"to the largest entry of the result. {MARKS}",
                ),
                Caption(
                    "kernels_backward.png",
                    "Kernels: time of a call against the backward error",
                    "Vertical axis: the change of the forces for which the result would be exact, joint by joint, "
                    "relative to |M| |qdd| + |c| + |Q|. An ill-conditioned mass matrix does not enlarge it.",
                ),
                Caption(
                    "derivatives.png",
                    "Derivatives: time of a Jacobian against its error",
                    "Generated derivatives, finite differences with several steps, and CasADi's derivatives of the "
                    "same equations. The time of differences is the time of their calls, without subtractions.",
                ),
                Caption("kernels.json", "Kernels and derivatives", TIMES),
            ),
        ),
        Outline(
            "simulation",
            2,
            "Speed against accuracy: simulation",
            "A motion of the model, by each method of simulation with each formulation that it accepts, at several "
            "steps or tolerances. The reference is another method, Gauss collocation with six stages. Its accuracy is "
            "its difference from DOP853 at a tolerance of 1e-13.",
            (
                Caption(
                    "simulation.png",
                    "Simulation: processor time against the error, and against the drift of energy",
                    "Left: the largest error at the end; shaded: errors below the accuracy of the reference. Right: "
                    f"the largest drift of energy, relative to the exchanged energy. {MARKS}",
                ),
                Caption("simulation.json", "Simulations", f"Errors are in rad, m, rad/s and m/s. {TIMES}"),
            ),
        ),
        Outline(
            "optimisation",
            3,
            "Speed against accuracy: optimal control",
            "The problem in all representations, with several numbers of intervals, with Radau and Legendre points of "
            "several degrees; the highest degree of Radau points also with other tolerances of the solver. Inputs are "
            "constant over an interval, so each number of intervals is a control grid with its own optimum. The "
            "reference is the optimum with Legendre points of degree 9; its accuracy is its difference from the "
            "optimum with Radau points of degree 9.",
            (
                Caption(
                    "optimisation.png",
                    "Optimal control: time of a solve against the error of the cost, and against the defect",
                    "A row for each control grid. Left: the error of the cost on the same control grid; shaded: errors "
                    "below the accuracy of the reference. Right: the largest defect of an interval, by re-simulation. "
                    f"{MARKS}",
                ),
                Caption(
                    "control_grid.png",
                    "Optimal control: error of the control grid, and error of collocation",
                    "Errors of the cost against the number of intervals; the limit of fine grids is extrapolated from "
                    "the two finest.",
                ),
                Caption("optimisation.json", "Solves", f"Defects are in rad, m, rad/s and m/s. {TIMES}"),
                Caption("control_grid.json", "Control grids", "The reference of each, with its accuracy."),
            ),
        ),
        Outline(
            "fidelity",
            4,
            "Speed against accuracy: reduced models",
            "Kernels of reduced models, compared with the kernels of the whole model at random states: the saved time, "
            "and the error of the entries that both have.",
            (
                Caption(
                    "fidelity.png",
                    "Fidelity: time of a call against the error of a reduction",
                    "A row for each kernel. Left: states that agree with the reduction; right: any state. Reductions "
                    "that make a call at least 1.1 times faster have names. The dashed line is the time of the whole "
                    "model. "
                    f"{MARKS}",
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
    text = f"{outline.text} Measured with {mechanism}: {environment}."
    return write_outline(replace(outline, text=text), folder)
