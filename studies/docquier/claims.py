"""The claims of Docquier, Brüls and Fisette about their study, each with its judge."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from studies.docquier.judges import (
    ALIKE,
    EXPLICIT,
    HALF,
    IMPLICIT,
    MANY,
    SIMILAR,
    Finding,
    compare_flops,
    compare_groups,
    compare_iterations,
    compare_motions,
    compare_ode,
    effort,
    judge_centre,
    judge_convergence,
    judge_crossing,
    judge_dae_iterations,
    judge_explicit_cpu_alike,
    judge_explicit_lower,
    judge_implicit_trapped,
    judge_iteration_outliers,
    judge_more_without_smoothing,
    judge_nonzeros,
    judge_order_n_dae,
    judge_order_n_iterations,
    judge_order_n_prefers_dae,
    judge_same_end,
    judge_shooting,
    judge_sides,
    judge_sizes,
    judge_smooth_minima,
    late_turns,
    speed,
    variation,
)
from studies.docquier.results import Results


@dataclass(frozen=True)
class Claim:
    """A sentence of the paper."""

    key: str  # the name in tables and tests
    place: str  # section, figure or table
    words: str
    meaning: str  # the computed numbers, and the condition for a confirmation
    judge: Callable[[Results], Finding | None]  # None: not measured
    scatters: bool = False  # it compares iterations, which scatter


CLAIMS: tuple[Claim, ...] = (
    Claim(
        "refinement",
        "4.3.1, Fig. 7",
        "The mean number of iterations does not vary significantly between two refinements after a certain size.",
        f"from the second finest grid to the grid of the run, every mean changes by {ALIKE:.0%} at most",
        judge_convergence,
        scatters=True,
    ),
    Claim(
        "smoother",
        "4.3.2, Fig. 8",
        "The second cost definition leads to a smoother actuation.",
        "the total variation of the torques is less",
        compare_motions(variation, "N m", lambda rough, smooth: smooth < rough),
    ),
    Claim(
        "effort",
        "4.3.2, Fig. 8",
        "The smoother actuation is more important.",
        "the integral of the squared torques is larger",
        compare_motions(effort, "N² m² s", lambda rough, smooth: smooth > rough),
    ),
    Claim(
        "oscillations",
        "4.3.2, Fig. 8",
        "There are less oscillations at the end of the trajectory.",
        "the torques turn less often in the last quarter of the time",
        compare_motions(late_turns, "turns", lambda rough, smooth: smooth < rough),
    ),
    Claim(
        "speeds",
        "4.3.2, Fig. 8",
        "Joint velocities have lower values than for the non-smoothed actuation.",
        "the largest joint velocity at a mesh point is lower",
        compare_motions(speed, "rad/s", lambda rough, smooth: smooth < rough),
    ),
    Claim(
        "same-end",
        "4.3.2, Fig. 8",
        "For the 2 cost definitions, the same final angular positions and the same final actuation are obtained.",
        "angles agree to 1e-4 rad, torques of the last interval to 1e-2 N m",
        judge_same_end,
    ),
    Claim(
        "one-outlier",
        "4.3.2, Fig. 9.b",
        "With smoothed actuation, only one formulation presents an outlier, which corresponds to a higher local "
        "minimum.",
        "one representation has tasks in a higher minimum than the lowest from the interpolation",
        judge_smooth_minima,
    ),
    Claim(
        "fewer-minima",
        "4.3.2, Fig. 9",
        "The actuation smoothing seems to reduce the problem of higher local minima.",
        "all representations together are in fewer higher minima with smoothing",
        judge_more_without_smoothing,
    ),
    Claim(
        "implicit-trapped",
        "4.3.2, Fig. 9.a; 4.3.3; 5",
        "Without smoothing, the implicit and semi-explicit formulations are more frequently trapped in higher local "
        "minima than the explicit ones.",
        "IMPL and SEMI are in more higher minima, on average, than the explicit forms",
        judge_implicit_trapped,
    ),
    Claim(
        "sides-and-centre",
        "4.3.2, Fig. 9.a",
        "Outliers correspond to points at the far left or the far right, and to the central point.",
        "most higher minima are at azimuths in the outer tenth, or at 0",
        judge_sides,
    ),
    Claim(
        "explicit-lower",
        "4.3.2, Fig. 9.a",
        "Lower minima are reached by the explicit formulations for the same tasks.",
        "of the tasks in which IMPL or SEMI is in a higher minimum, an explicit form reached the lowest of most",
        judge_explicit_lower,
    ),
    Claim(
        "no-lateral-movement",
        "4.3.2",
        "All the formulations seem to struggle with the problem without lateral movement.",
        "without smoothing, every form's median of iterations at azimuth 0 is above the median over all tasks",
        judge_centre,
        scatters=True,
    ),
    Claim(
        "iteration-outliers",
        "4.3.2, Fig. 10.a",
        "Without smoothing, the number of iterations has a high number of outliers corresponding to the high local "
        "minima.",
        f"more than {MANY:.0%} of the solves are outliers, and most outliers are in a higher minimum",
        judge_iteration_outliers,
        scatters=True,
    ),
    Claim(
        "dae-iterations",
        "4.3.2, Fig. 10.a",
        "Without smoothing, the DAE explicit formulations need a larger average number of iterations than the four "
        "others.",
        "both means are above the means of all others",
        judge_dae_iterations,
        scatters=True,
    ),
    Claim(
        "implicit-iterations",
        "4.3.2, Fig. 10.b",
        "With smoothing, the implicit and semi-explicit formulations generally perform better (iterations).",
        "both medians are below the medians of the explicit forms",
        compare_groups("smooth", "iterations", IMPLICIT, EXPLICIT),
        scatters=True,
    ),
    Claim(
        "implicit-cpu-rough",
        "4.3.2, Fig. 10.a; 4.3.3; 5",
        "Without smoothing, the implicit and the semi-explicit formulations lead to better CPU times than the explicit "
        "ones.",
        "both medians are below the medians of the explicit forms",
        compare_groups("rough", "cpu", IMPLICIT, EXPLICIT, " of CPU s"),
        scatters=True,
    ),
    Claim(
        "implicit-cpu-smooth",
        "4.3.2, Fig. 10.b; 4.3.3; 5",
        "With smoothing, the implicit and the semi-explicit formulations lead to better CPU times than the explicit "
        "ones.",
        "both medians are below the medians of the explicit forms",
        compare_groups("smooth", "cpu", IMPLICIT, EXPLICIT, " of CPU s"),
        scatters=True,
    ),
    Claim(
        "implicit-cpu-per-iteration-rough",
        "4.3.2, Fig. 11.a",
        "This tendency is also observed for the CPU time per iteration: without smoothing.",
        "both medians are below the medians of the explicit forms",
        compare_groups("rough", "cpu per iteration", IMPLICIT, EXPLICIT, " of CPU ms"),
    ),
    Claim(
        "implicit-cpu-per-iteration-smooth",
        "4.3.2, Fig. 11.b",
        "This tendency is also observed for the CPU time per iteration: with smoothing.",
        "both medians are below the medians of the explicit forms",
        compare_groups("smooth", "cpu per iteration", IMPLICIT, EXPLICIT, " of CPU ms"),
    ),
    Claim(
        "ode-iterations",
        "4.3.2, Fig. 10.a",
        "The ODE representation gives better results in terms of iterations for the first set of tasks.",
        f"without smoothing, both explicit forms take at least {ALIKE:.0%} fewer iterations as ODE",
        compare_ode("rough", True),
        scatters=True,
    ),
    Claim(
        "ode-iterations-unclear",
        "4.3.2, Fig. 10.b",
        "This difference is not so clear for the second set of tasks.",
        f"with smoothing, not both explicit forms take at least {ALIKE:.0%} fewer iterations as ODE",
        compare_ode("smooth", False),
        scatters=True,
    ),
    Claim(
        "explicit-cpu-alike",
        "4.3.2, Fig. 10",
        "The two explicit forms exhibit similar performances in terms of CPU time as ODE and as DAE systems.",
        f"medians within {SIMILAR:.0%}",
        judge_explicit_cpu_alike,
        scatters=True,
    ),
    Claim(
        "order-n-dae-per-iteration",
        "4.3.2, Fig. 11",
        "The Order-N implementation yields a lower CPU time per iteration when formulated as a DAE system.",
        "EXP2-A's median is below EXP2-O's, in each set",
        judge_order_n_dae,
    ),
    Claim(
        "order-n-iterations",
        "4.3.2, Fig. 10",
        "Its poor performances in terms of total CPU time are explained by its high number of iterations.",
        "EXP2-A takes more iterations than EXP2-O, and no less time, in each set",
        judge_order_n_iterations,
        scatters=True,
    ),
    Claim(
        "dae-larger",
        "4.3.3, Table 3",
        "The DAE form leads to a larger problem as both the number of equations and variables is higher.",
        "compared for all forms",
        judge_sizes,
    ),
    Claim(
        "nonzeros",
        "4.3.3, Table 3",
        "The implicit and semi-explicit formulations lead to the exact same number of non-zero terms in the Jacobian "
        "and the Hessian.",
        "counted",
        judge_nonzeros,
    ),
    Claim(
        "flops-half",
        "4.3.3, Table 4",
        "Φ takes about half of the operations of the M and c terms.",
        f"flops of IMPL by flops of SEMI, from {HALF[0]:g} to {HALF[1]:g}",
        compare_flops("IMPL", "SEMI", lambda ratio: HALF[0] <= ratio <= HALF[1]),
    ),
    Claim(
        "flops-exp1",
        "4.3.3, Table 4",
        "The modified NER with Cholesky decomposition takes a number of flops comparable with the semi-explicit form.",
        f"flops of EXP1 by flops of SEMI, up to {1 + SIMILAR:g}",
        compare_flops("EXP1", "SEMI", lambda ratio: ratio <= 1 + SIMILAR),
    ),
    Claim(
        "flops-exp2",
        "4.3.3, Table 4",
        "The Order-N method takes more than 4 times the number of operations of the implicit form.",
        "flops of EXP2 by flops of IMPL, above 4",
        compare_flops("EXP2", "IMPL", lambda ratio: ratio > 4),
    ),
    Claim(
        "crossing",
        "4.3.3",
        "The linear behaviour of the Order-N method becomes only interesting for a greater number of joints (around "
        "15).",
        "from 10 to 20 joints of a chain on, EXP2 takes fewer flops than EXP1",
        judge_crossing,
    ),
    Claim(
        "same-iterations",
        "4.3.3, Fig. 10.b",
        "With smoothing, IMPL and SEMI take an almost exact same number of iterations in the 231 tasks.",
        f"the same in {1 - ALIKE:.0%} of the tasks",
        compare_iterations("smooth", True),
        scatters=True,
    ),
    Claim(
        "similar-iterations",
        "4.3.3, Fig. 10.a",
        "Without smoothing, a similar but non-identical number of iterations is observed for the two formulations.",
        f"not the same in all tasks, medians within {SIMILAR:.0%}",
        compare_iterations("rough", False),
        scatters=True,
    ),
    Claim(
        "order-n-prefers-dae",
        "5",
        "The Order-N explicit form works better with a DAE representation, while a pure ODE seems more appropriate for "
        "the NER explicit form.",
        "medians of CPU time, in each set: EXP2-A below EXP2-O, and EXP1-O below EXP1-A",
        judge_order_n_prefers_dae,
        scatters=True,
    ),
    Claim(
        "shooting",
        "4.3.3; 5",
        "Multiple shooting led to lower performances in terms of robustness: lower success rate for the extreme points "
        "and slower convergence.",
        "at the extreme targets and in the middle, with smoothing, every kind of shooting solves fewer tasks, and is "
        "slower, for an explicit form",
        judge_shooting,
    ),
)
