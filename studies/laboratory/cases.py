"""The cases: known failures of methods, the criteria for this program, and the trials that measure them.

u is 2^-53, half the distance from 1 to the next double. Errors of accelerations are relative to the largest, against 50
digits.
"""

from __future__ import annotations

from functools import partial

from mbsrun.ocp.problem.problem import Representation
from studies.laboratory import (
    chains,
    compilation,
    derivatives,
    events,
    expressions,
    inertias,
    integration,
    limits,
    locks,
    loops,
    modelling,
    optimisation,
    orientations,
)
from studies.laboratory.case import Case, Trial

LONG = (100, 200, 500, 1000)  # links of chains that are not written in C
LOOPS = (
    " Above 50 links EXP2 and IMPL are interpreted, without the search for common factors; EXP1 and SEMI, which have "
    "n^2 entries, are computed in loops, of M and c by IMPL."
)

CASES: tuple[Case, ...] = (
    Case(
        "F01",
        "a long straight chain",
        "A planar chain of N equal thin rods, stretched, random velocities and torques; cond M grows as N^4." + LOOPS,
        "EXP2 errs by 1e-12 at most at every N, EXP1 by 10 u cond(M); at exact accelerations a residual is 10 u.",
        (
            *(Trial(f"{n} links", partial(chains.measure_straight, size=n), n > 10) for n in (2, 5, 10, 20, 50)),
            *(Trial(f"{n} links", partial(chains.measure_long, kind="straight", size=n), True) for n in LONG),
        ),
    ),
    Case(
        "F02",
        "a long chain in space",
        "The same rods, axes along z, y, x in turn, angles at random." + LOOPS,
        "EXP2 errs by 100 u sqrt(cond M) at most, EXP1 by 10 u cond(M); residuals as in F01.",
        (
            *(Trial(f"{n} links", partial(chains.measure_spatial, size=n), n > 10) for n in (2, 5, 10, 20, 50)),
            *(Trial(f"{n} links", partial(chains.measure_long, kind="spatial", size=n), True) for n in LONG),
        ),
    ),
    Case(
        "F03",
        "a heavy tip",
        "The chain of F02; the last rod's mass and inertia times 1e4, 1e8, 1e12.",
        "Backward errors of 1e-14 at most; errors of 10 u times the condition of M scaled to a diagonal of ones; "
        "`condition` estimates the lost digits to a factor of 16. EXP1 may fail only where a pivot is below n u 1000 "
        "of its entry of M, and so fewer than three digits are left; EXP2 only where three digits are not sure.",
        tuple(
            Trial(f"{n} links, times {r:.0e}", partial(chains.measure_heavy_tip, size=n, ratio=r), n > 10)
            for n in (10, 50)
            for r in chains.RATIOS
        ),
    ),
    Case(
        "F04",
        "light tips and bases",
        "The chain of F02 with 10 links: ratios of 1e8 and 1e12 that only scale M, whose condition reaches 1e16.",
        "Errors of 1e-11 at most, no status, and no false alarm: `condition` estimates 1e-11 at most.",
        tuple(
            Trial(name, partial(chains.measure_harmless, factors=x, is_alarming=name in chains.ALARMING))
            for name, x in chains.HARMLESS.items()
        ),
    ),
    Case(
        "F05",
        "joints that lock",
        "One body on three axes through a point, or at an elbow, 0.1 to 1e-12 rad from a lock, and at it.",
        "An error of 1e-6 at most, or a status that names the joint, but only where 1e-6 is not sure; never a wrong "
        "number in silence. EXP2 has 1e-11 down to 1e-12 rad from the lock of a Cardan joint or a wrist; at the lock, "
        "less than a rounding of the angle away, a status is due. Residuals are right to 1e-14 everywhere. "
        "`condition` estimates the loss, to a factor of 16.",
        (
            *(Trial(name, partial(locks.measure_lock, lock=name)) for name in ("Cardan", "wrist", "elbow")),
            Trial("a smaller bound", locks.measure_small_bound),
        ),
    ),
    Case(
        "F06",
        "joints that move nothing",
        "A leaf without mass, a slide without mass, a point mass on its joint's axis.",
        "Refused with the model, by the joint's name; where a run-time parameter makes it so, a status names it, and "
        "residuals are finite.",
        tuple(Trial(name, partial(locks.measure_weightless, name=name)) for name in locks.WEIGHTLESS),
    ),
    Case(
        "F07",
        "inertias without a body",
        "Negative masses and moments, moments against the triangle, products too large, not a number, infinite.",
        "Refused with the model; where the file says `allow_unphysical`, taken.",
        (
            *(Trial(x, partial(inertias.measure_strange, name=x)) for x in inertias.STRANGE if "1e" not in x),
            Trial("where the file allows it", inertias.measure_allowed),
            Trial("definite matrices", inertias.measure_definite),
        ),
    ),
    Case(
        "F08",
        "tiny and huge masses",
        "A chain of six links with masses of 1e-150 and 1e150 kg, alone and between others; 1e-310 and 1e200 kg.",
        "Finite, right to 1e-12, and no status from 1e-150 to 1e150 kg; refused beyond.",
        (
            *(Trial(name, partial(inertias.measure_sizes, name=name)) for name in inertias.SIZES),
            *(Trial(x, partial(inertias.measure_strange, name=x)) for x in inertias.STRANGE if "1e" in x),
        ),
    ),
    Case(
        "F09",
        "a distant centre of mass",
        "A body of 1 kg and 1 kg m2 whose centre of mass is 1 to 1e8 m from its origin, in single precision to 1e4 m.",
        "The loss is 4 u (1 + m c2 / I) at most, with all reductions and with none. A status of EXP1 only where that "
        "is more than 1e-6, as at all joints whose body has no inertia (F05); of EXP2 only above 1e-3.",
        tuple(
            Trial(f"{c:g} m away, {kind}", partial(inertias.measure_offset, offset=c, precision=kind))
            for kind, offsets in inertias.OFFSETS_OF.items()
            for c in offsets
        ),
    ),
    Case(
        "F10",
        "a force law that must not be multiplied out",
        "A force by the square of a length, (cos q - cos r)^2 + (sin q - sin r)^2, near where it vanishes.",
        "Errors of at most ten times the errors of the law as written by hand.",
        tuple(Trial(f"{d:g} rad away", partial(expressions.measure_spring, distance=d)) for d in (1e-4, 1e-6, 1e-8)),
    ),
    Case(
        "F11",
        "an explicit inverse",
        "Chains of 3 to 8 links: an adjugate would divide by a determinant, and lose digits.",
        "No more than two divisions for each joint, errors of 10 u cond(M) at most, and in a straight chain of 8 links "
        "backward errors of 10 u, which determinants that are multiplied out exceed.",
        (
            *(Trial(f"{n} links", partial(expressions.measure_inverse, size=n)) for n in (3, 5, 8)),
            Trial("determinants", partial(expressions.measure_determinants, size=8)),
        ),
    ),
    Case(
        "F12",
        "sums of angles",
        "Torques that are the sine of a sum of two or three angles up to 1e12 rad, and of an arm that folds.",
        "4 u (1 + |q1| + |q2| + …) at any angle; within a turn 10 u with two angles, 20 u with three.",
        tuple(Trial(f"{k} angles", partial(expressions.measure_sums, parallel=k)) for k in (2, 3)),
    ),
    Case(
        "F13",
        "huge angles",
        "M and c at angles of 1e8 rad; the sine of 1e22.",
        "1e-13 by addition theorems, what a sum has lost with sums of angles; sin(1e22) to 4 u.",
        (Trial("1e8 rad", expressions.measure_huge), Trial("1e22 rad", expressions.measure_sine)),
    ),
    Case(
        "F14",
        "compilers that change arithmetic",
        "Levels of optimisation, contraction, and flags that give up IEEE arithmetic.",
        "Results agree to 1e-13; fast-math and its parts are refused; 1e-310 / 2 is not 0 after loading kernels. With "
        "fast-math, the rest of a sum vanishes, and a pivot that is no number passes.",
        (
            Trial("flags", compilation.measure_flags),
            Trial("refusals", compilation.measure_refusals),
            Trial("fast-math", compilation.measure_fast_math),
        ),
    ),
    Case(
        "F15",
        "single precision",
        "The chains of F01 and F02 in float32, six states each.",
        "EXP2 errs by 1e-5 at most up to 50 links; EXP1 by 1e-2, or there is a status.",
        tuple(
            Trial(f"{n} links, {kind}", partial(chains.measure_single, kind=kind, size=n), n > 20)
            for kind in ("straight", "spatial")
            for n in (6, 20, 50)
        ),
    ),
    Case(
        "F16",
        "drift off constraints",
        "A pendulum of a point mass on a rod by RK4, 10 s with steps of 1e-2 and 1e-3 s: in x and y with Baumgarte's "
        "method, alpha = beta from 0 to 2.7 / h, and in its angle; and on a rod of the model, by the methods of "
        "simulations.",
        "In x and y: stable to h alpha = 2, divergent at 2.7; drifts as an independent program found them, to 5 %; at "
        "alpha = 5 / s the error of the place is at most twice the error with alpha = 0. The same bound holds in the "
        "angle, in which no drift is possible, and on the rod with the default gains, projection or partitioning; "
        "projection and partitioning drift by 1e-12 m at most, and gains above 1 / h are refused.",
        (
            *(Trial(f"x and y, h = {h:g} s", partial(integration.measure_baumgarte, step=h)) for h in (1e-2, 1e-3)),
            *(Trial(f"angle, h = {h:g} s", partial(integration.measure_place, step=h)) for h in (1e-2, 1e-3)),
            *(Trial(f"rod, h = {h:g} s", partial(loops.measure_rod, step=h)) for h in (1e-2, 1e-3)),
        ),
    ),
    Case(
        "F17",
        "energy and phase",
        "The same pendulum: orders of methods, RK4 and the midpoint rule over 2000 s, implicit Euler.",
        "Orders to a tenth; RK4's loss of energy goes with T h^5; Gauss collocation's error of energy does not grow. "
        "The error of the place is reported beside it: a small one does not follow from the other.",
        (
            Trial("orders", integration.measure_orders),
            Trial("RK4, 200 s", partial(integration.measure_runge_kutta, long=False)),
            Trial("RK4, 2000 s", partial(integration.measure_runge_kutta, long=True), is_long=True),
            Trial("midpoint rule", integration.measure_midpoint),
            Trial("midpoint rule, 2000 s", partial(integration.measure_midpoint, duration=2000.0), is_long=True),
            Trial("damping", integration.measure_damping, is_long=True),
        ),
    ),
    Case(
        "F18",
        "stiff joints",
        "A slider with spring and damper of eigenvalue -1.33e5 1/s, beside the pendulum.",
        "Explicit methods take t lambda / 3.3 steps, in proportion to t, and warn; Radau takes fewer than 2000 "
        "evaluations in 10 s, and agrees at all times with a run ten times as tight to 1e-6.",
        (Trial("explicit", integration.measure_explicit), Trial("implicit", integration.measure_implicit)),
    ),
    Case(
        "F19",
        "collocation too coarse",
        "The swing-up of a cart-pole on meshes of 4 to 80 intervals of degree 3 and 5, of 20 to 1280 of degree 1; and "
        "on a fixed grid of 20 constant inputs, with 1 to 32 steps of Radau in each.",
        "The report shows the defect by re-simulation, which decides the accuracy; it falls with order 2 at least. On "
        "the fixed grid, cost and defect have the order 2 d - 1 of Radau's method, to a tenth. 80 intervals of degree "
        "5 have 1e-6, and from one optimum all representations have its cost to 1e-8. The report shows "
        "the results from the guess of the problem.",
        (
            *(
                Trial(f"fixed inputs, degree {d}", partial(optimisation.measure_control_grid, degree=d), is_long=True)
                for d in optimisation.GRID_STEPS
            ),
            Trial("degree 1", optimisation.measure_lowest_degree, is_long=True),
            Trial("degree 3", optimisation.measure_meshes, is_long=True),
            Trial("degree 5, 80 intervals", optimisation.measure_fine_mesh, is_long=True),
            Trial("the solver's word", optimisation.believe_success),
        ),
    ),
    Case(
        "F20",
        "quadrature at degree 1",
        "Weights of all schemes; a cost as an expression at degree 1, where some tables have half of it.",
        "Weights sum to 1, and integrate 2d - 2 (Radau) or 2d - 1 (Legendre) powers, to 1e-12; the cost is its sum.",
        (Trial("weights", optimisation.measure_quadrature), Trial("cost", optimisation.measure_halved_cost)),
    ),
    Case(
        "F21",
        "local minima",
        "The swing-up with 80 intervals from forty random starts, the same for all representations: noise of 3 rad and "
        "3 m at every point, random inputs.",
        "Three minima are reached: 57.95, the published 58.81, and 303.5, each to 0.5 %; how many starts end in each, "
        "and how many fail with which status, is reported.",
        (
            *(
                Trial(r.value, partial(optimisation.measure_minima, representation=r), is_long=True)
                for r in Representation
            ),
            Trial("one start", optimisation.start_once),
        ),
    ),
    Case(
        "F22",
        "motions that run away",
        "x'' = rate^2 sin x + u for 2 s from a guess of zeros; exp(rate T) up to 2e17.",
        "Solved in 50 iterations at most, in all representations and by multiple shooting; the end is met to 1e-7.",
        tuple(Trial(f"rate {r:g}", partial(optimisation.measure_runaway, rate=r)) for r in (5.0, 10.0, 20.0)),
        "Single shooting, which is not offered.",
    ),
    Case(
        "F23",
        "what solvers say",
        "Too little force, a guess that is not a number, a saddle, too many equations, contradictions, a constraint "
        "twice, a start at a lock.",
        "In each case its own status; a limit of iterations is none of them. The guess never comes back as a solution.",
        (
            Trial("statuses", optimisation.measure_statuses),
            Trial("a start at a lock", optimisation.measure_locked_start),
            Trial("IPOPT alone", optimisation.ask_ipopt),
        ),
    ),
    Case(
        "F24",
        "redundant loop constraints",
        "Bricard's mechanism, whose five equations have rank 4 in every pose; two four-bars of equal rods, whose four "
        "equations have rank 2 where all rods are on one line, for 10 s and 10 such poses, and close to one.",
        "The rank by screws is the number of kept equations, and the redundant one is reported; energy is kept to 1e-9 "
        "J over 10 s; after 10 s the four-bars are in the right place to 1e-5 m, or a status names a loop, or "
        "Baumgarte's method warns. Towards the line, accelerations keep three digits, or a status names a loop, but "
        "not before 1e-6 rad. LU of all five equations returns numbers where it should fail.",
        (
            Trial("rank of Bricard's equations", loops.measure_ranks),
            Trial("Bricard, 10 s", loops.measure_bricard),
            Trial("four-bars, 10 s", loops.measure_passages),
            Trial("four-bars, towards a line", loops.measure_level),
        ),
    ),
    Case(
        "F25",
        "derivatives",
        "A spatial chain of four links: Jacobians, Hessians and their patterns.",
        "Jacobians agree with differences of fourth order to 1e-10; Taylor's remainder is of order 2; Hessians are "
        "symmetric to 1e-13; no entry of a pattern vanishes everywhere.",
        (Trial("4 links", partial(derivatives.measure_derivatives, size=4)),),
    ),
    Case(
        "F26",
        "quaternions off length 1",
        "A free body, five states, its quaternion times -1, 1 + 1e-6, 0.5, 1e-3, 1e3, 1e-100 and 1e100.",
        "Errors of 1e-14 at most, against the closed form: a quaternion and its opposite are one attitude.",
        (Trial("lengths", orientations.measure_lengths),),
    ),
    Case(
        "F27",
        "a floating base near the lock of its angles",
        "A symmetric top without forces, whose pitch passes close to pi/2, for 10 s: with a quaternion, with three "
        "angles; and accelerations at the lock itself.",
        "Orientations as in closed form: to 1e-8 with a quaternion, to 1e-6 with angles and an adaptive method, to "
        "1e-5 by RK4 with a quaternion; at the lock a status names a turn of the base.",
        (Trial("past the lock", orientations.measure_lock),),
    ),
    Case(
        "F28",
        "a pulse between steps",
        "A mass of 1 kg, and a force of 1 kN for 1 ms within 1 s.",
        "Place and speed after 1 s to 1e-8, by every method.",
        (Trial("1 ms", events.measure_pulse),),
    ),
    Case(
        "F29",
        "smooth friction that should stick",
        "A block under 4 N, with friction of 5 N that is smooth over 0.01 and 0.001 m/s.",
        "The block creeps with the speed at which friction is 4 N, to 1e-6. Explicit methods need short steps.",
        tuple(Trial(f"{v:g} m/s", partial(events.measure_friction, speed=v)) for v in events.SPEEDS),
    ),
    Case(
        "F30",
        "lengths that vanish",
        "A spring between two points that meet, or are 1e-3 to 1e-300 m apart.",
        "Force and slope to 1e-15, also where the points meet; with a rest length, a status names the spring.",
        (Trial("a spring", modelling.measure_vanishing_length),),
    ),
    Case(
        "F31",
        "inertias from CAD programs",
        "Twenty plates in random attitudes, written with 3 to 9 digits; a tensor with a missing decimal point.",
        "Every plate is taken, with a warning where its rounded tensor belongs to no body; the tensor is refused.",
        (Trial("plates", modelling.measure_rounded_inertias),),
    ),
    Case(
        "F32",
        "expressions that explode",
        "Accelerations of chains of 2 to 5 links, by Lagrange's equations in CasADi; operations of 12 and 24 links.",
        "Equal to 1e-10; operations grow with order 3 (EXP1) and 1.4 (EXP2) at most.",
        (Trial("chains", modelling.measure_growth),),
    ),
    Case(
        "F33",
        "other units",
        "Two slides and two turns, with numbers in mm and g, km and kt, nm and t, Mm and mg.",
        "The same accelerations to 1e-12, and no status.",
        (Trial("units", modelling.measure_units),),
    ),
    Case(
        "F34",
        "an angle and the same angle",
        "An arm of 1 kg m2 is to turn to 350 degrees in 1 s with the least integral of the squared torque.",
        "By the direction as target, the cost of 10 degrees the other way, to 1e-7; by the value, of 350 degrees.",
        (Trial("350 degrees", orientations.measure_turns),),
    ),
    Case(
        "F35",
        "hard contacts and long steps",
        "A ball of 0.2 kg falls 0.5 m on ground of 1e5 N/m without losses, and bounces for 3 s; a contact takes 4 ms.",
        "Energy to 1e-6 by adaptive methods, to 1e-3 by RK4 with 50 steps in a contact; where steps are too long, a "
        "warning.",
        (Trial("bounces", events.measure_bounces),),
    ),
    Case(
        "F36",
        "ends on limits",
        "Two masses that come to rest where their rails and a row end, never backwards, in four forms; and random "
        "motions, cranes and arms at their limits, with rows twice, fixed variables and no interior.",
        "Costs as in closed form, to 1e-6. Every problem that IPOPT solves is solved by default, and no lower cost is "
        "nearby, to 1e-6. `mbs` alone is right, or has no answer.",
        (
            Trial("two masses", limits.measure_masses),
            Trial("random problems", limits.measure_random, is_long=True),
        ),
    ),
)
