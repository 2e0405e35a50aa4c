#include "laws.h"

#include <stdlib.h>

#include "../../../csrc/mbs_explicit.c"
#include "../../../csrc/mbs_least.c"

/* One equation in two joints, J = (1, 2), whose decomposed J is off by a part of it. */
static casadi_real qd[2], hd[1], h[1], q[2];
static int calls;

static int find_rates(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int memory)
{
    (void)arg, (void)res, (void)iw, (void)w, (void)memory;
    ++calls;
    hd[0] = qd[0] + 2 * qd[1];
    return 0;
}

/* Close velocities with a J that is off by `part`; return by how much they stay open. */
static casadi_real close_off(casadi_real part, casadi_real way, casadi_real a, casadi_real b)
{
    casadi_real B[1] = {1 + part}, volume, x[4], g[2];
    casadi_int depends[1] = {0}, row[1];
    mbs_explicit plant;
    mbs_manner manner;
    mbs_outcome outcome;
    mbs_run r;
    memset(&plant, 0, sizeof plant), memset(&manner, 0, sizeof manner), memset(&r, 0, sizeof r);
    memset(&outcome, 0, sizeof outcome);
    plant.n = plant.nq = 2, plant.e = 1, plant.q = q, plant.qd = qd, plant.h = h, plant.hd = hd, plant.rates.f = find_rates;
    manner.keeping = MBS_PARTITIONING;
    r.p = &plant, r.how = &manner, r.out = &outcome, r.B = B, r.row = row, r.depends = depends, r.x = x, r.g = g;
    mbs_lu_factorise(1, B, row, &volume);
    qd[0] = a, qd[1] = b, calls = 0;
    LAW("velocities can be closed", close_velocities(&r, way) == 0);
    LAW("dependent joints alone change", qd[1] == b);
    return fabs(qd[0] + 2 * qd[1]);
}

/* A correction of the second of three joints, 2 x = -6, leaves the others where they are. */
static void correct_alone(void)
{
    casadi_real B[1] = {2}, volume, x[6] = {7, 7, 7, 7, 7, 7}, g[2] = {0, 0}, gap[1] = {6};
    casadi_int depends[1] = {1}, row[1];
    mbs_call none;
    mbs_explicit plant;
    mbs_manner manner;
    mbs_run r;
    memset(&plant, 0, sizeof plant), memset(&manner, 0, sizeof manner), memset(&r, 0, sizeof r);
    memset(&none, 0, sizeof none);
    plant.n = plant.nq = 3, plant.e = 1, manner.keeping = MBS_PARTITIONING;
    r.p = &plant, r.how = &manner, r.B = B, r.row = row, r.depends = depends, r.x = x, r.g = g;
    mbs_lu_factorise(1, B, row, &volume);
    correct(&r, gap);
    LAW("dependent joints alone are corrected", x[0] == 0 && x[1] == -3 && x[2] == 0);
    LAW("a kernel that is not there computes nothing", call(none) == 0);
}

/* The largest entry is 5, of the second equation and joint; without that joint, the first equation moves the third by 3. */
static void choose_joints(void)
{
    casadi_real J[6] = {(casadi_real)0.1, 4, 3, -2, 5, 0}, B[6], volume;
    casadi_int moves[3] = {0, 1, 2}, best[3];
    mbs_explicit plant;
    mbs_run r;
    memset(&plant, 0, sizeof plant), memset(&r, 0, sizeof r);
    plant.n = 3, plant.e = 2, r.p = &plant, r.free = 3, r.moves = moves, r.best = best, r.J = J, r.B = B;
    volume = find_best(&r);
    LAW("the best dependent joints have the largest pivots", best[0] == 1 && best[1] == 2 && best[2] == 0);
    LAW("whose product is the determinant", fabs(volume - log(15)) < 1e-14);
    J[0] = 0, J[1] = 4, J[2] = 0, J[3] = 0;
    LAW("where equations repeat each other, there is one pivot", fabs(find_best(&r) - log(5)) < 1e-14 && best[0] == 1);
}

static casadi_real force[1], pull[1];

static int fall(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int memory)
{
    (void)arg, (void)res, (void)iw, (void)w, (void)memory;
    pull[0] = force[0];
    return 0;
}

/* Three parts of a motion by Euler's method, each with two rows of inputs: of its stage, and of its end. */
static void read_parts(void)
{
    static const casadi_real A[1] = {0}, b[1] = {1}, c[1] = {0}, times[3] = {0, 1, 2}, lengths[3] = {0.5, 0.25, 1};
    static const casadi_real inputs[6] = {1, -7, 20, -7, 300, -7}, starts[6] = {0, 1, 0, 2, 0, 3};
    casadi_real ends[6], reals[64];
    casadi_int integers[16], k;
    mbs_explicit plant;
    mbs_manner manner;
    mbs_outcome outcome;
    memset(&plant, 0, sizeof plant), memset(&manner, 0, sizeof manner);
    plant.n = plant.nq = plant.m = 1, plant.q = q, plant.qd = qd, plant.v = force, plant.qdd = pull, plant.direct.f = fall;
    manner.stages = 1, manner.order = 1, manner.A = A, manner.b = b, manner.c = c;
    LAW("there is room", mbs_explicit_reals(&plant, 1) <= 64 && mbs_explicit_integers(&plant) <= 16);
    mbs_explicit_read(&plant, &manner, 3, times, lengths, inputs, NULL, starts, ends, reals, integers, &outcome);
    LAW("all parts are read", outcome.status == 0 && outcome.steps == 3);
    for (k = 0; k < 3; ++k) {
        LAW("each from its own start", ends[2 * k] == lengths[k] * starts[2 * k + 1]);
        LAW("with its own inputs", ends[2 * k + 1] == starts[2 * k + 1] + lengths[k] * inputs[2 * k]);
    }
}

/* --- a plant of two joints: constant M, and forces that are linear in the coordinates ------------------------------ */

static casadi_real *room;
static casadi_int *numbers, fired[4], held[2], kind[4], joint[4], place[4], row_of[3], guard_of[3];
static casadi_real q2[2], qd2[2], rest[2], left[2], mass[4], stiffness[2], push[2], values[8];
static casadi_real sign[2], torque[2], fading[2], slowness[2], side[4], level[4], restitution[2], impulse_of[3];
static const casadi_int everywhere[4] = {0, 1, 2, 3};
static casadi_real A4[16], b4[4], c4[4], E4[8];
static mbs_explicit plant;
static mbs_modes modes;
static mbs_manner manner;
static mbs_outcome outcome;
static int evaluated, failing;

static int find_residual(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int memory)
{
    int i;
    (void)arg, (void)res, (void)iw, (void)w, (void)memory;
    ++evaluated;
    for (i = 0; i < 2; ++i)
        left[i] = mass[2 * i] * rest[0] + mass[2 * i + 1] * rest[1] + stiffness[i] * q2[i] - push[i];
    return failing == evaluated ? 1 : 0;
}

static int find_mass(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int memory)
{
    (void)arg, (void)res, (void)iw, (void)w, (void)memory;
    return 0;
}

/* Begin anew with unit masses, no forces, no guards, and the classical method of order four without estimates. */
static void anew(casadi_int guards)
{
    int i;
    memset(&plant, 0, sizeof plant), memset(&modes, 0, sizeof modes), memset(&manner, 0, sizeof manner);
    memset(A4, 0, sizeof A4), memset(E4, 0, sizeof E4), memset(held, 0, sizeof held);
    for (i = 0; i < 2; ++i) {
        q2[i] = qd2[i] = rest[i] = stiffness[i] = push[i] = sign[i] = torque[i] = fading[i] = slowness[i] = 0;
        restitution[i] = 0.5;
    }
    for (i = 0; i < 4; ++i)
        mass[i] = i == 0 || i == 3, kind[i] = MBS_PLACE, joint[i] = place[i] = i % 2, side[i] = 1, level[i] = 0;
    plant.n = plant.nq = 2, plant.q = q2, plant.qd = qd2, plant.rest = rest, plant.r = left;
    plant.M.nonzeros = mass, plant.M.entries = 4, plant.M.place = everywhere;
    plant.residual.f = find_residual, plant.mass.f = find_mass, plant.modes = &modes;
    modes.held = held, modes.sign = sign, modes.torque = torque, modes.fall = fading, modes.slowness = slowness;
    modes.guards = guards, modes.kind = kind, modes.joint = joint, modes.place = place, modes.side = side;
    modes.level = level, modes.fired = fired, modes.restitution = restitution, modes.row = row_of;
    modes.guard = guard_of, modes.impulse = impulse_of;
    modes.slow = 0.25, modes.still = 1e-3, modes.touch = 1e-2;
    A4[4] = A4[9] = 0.5, A4[14] = 1, c4[0] = 0, c4[1] = c4[2] = 0.5, c4[3] = 1;
    b4[0] = b4[3] = 1.0 / 6, b4[1] = b4[2] = 1.0 / 3;
    manner.stages = 4, manner.order = 4, manner.A = A4, manner.b = b4, manner.c = c4, manner.E = E4;
    manner.rtol = manner.atol = 1e-6;
    evaluated = failing = 0;
}

/* Make room for exactly the numbers that are asked for. */
static void make_room(void)
{
    free(room), free(numbers);
    room = calloc((size_t)mbs_explicit_reals(&plant, manner.stages), sizeof *room);
    numbers = calloc((size_t)mbs_explicit_integers(&plant), sizeof *numbers);
}

static mbs_run open_here(void)
{
    make_room();
    return open_run(&plant, &manner, room, numbers, &outcome);
}

static int alike(casadi_real a, casadi_real b)
{
    return fabs(a - b) <= 1e-12 * fmax(fabs(a), fabs(b));
}

static void openings(void)
{
    static const casadi_int driven[1] = {0};
    mbs_run r;
    anew(0);
    plant.d = 1, plant.driven = driven, held[1] = 1;
    outcome.evaluations = outcome.rejected = outcome.switches = outcome.steps = outcome.status = outcome.loop = 7;
    outcome.pivot = outcome.gap = 7;
    r = open_here();
    LAW("a run begins with nothing counted",
        !outcome.evaluations && !outcome.rejected && !outcome.switches && !outcome.steps && !outcome.status);
    LAW("and no pivot or gap seen", outcome.pivot == 1 && outcome.gap == 0 && outcome.loop == 0 && r.last == 1);
    LAW("joints that are driven or held are not free", r.free == 0);
    held[1] = 0;
    r = open_here();
    LAW("the others are", r.free == 1 && r.moves[0] == 1);
}

static void estimates(void)
{
    const casadi_real x[4] = {3, -4, 0, 1}, y[4] = {2, 5, 0, -2};
    mbs_run r;
    int i;
    anew(0);
    manner.stages = 2, manner.estimates = 1, manner.rtol = 0.5, manner.atol = 0.25, E4[0] = -1, E4[1] = 2;
    r = open_here();
    for (i = 0; i < 8; ++i)
        r.k[i] = i < 4 ? 1 : 1 + i % 4; /* 1 1 1 1, 1 2 3 4: sums 1 3 5 7 */
    /* the scales are 1.75, 2.75, 0.25, 1.25 */
    LAW("errors are weighed by the larger of both states, in the root mean square",
        fabs(estimate(&r, 0.5, x, y) - 0.5 * sqrt((0.16 * 100 / 49 + 144.0 / 121 + 400 + 31.36) / 4)) < 1e-9);
    manner.rtol = manner.atol = 0, r.least_pivot = 0;
    LAW("at a singular pose a millionth of the rates is rounding", alike(estimate(&r, 0.5, x, y), sqrt(84.0 / 4) / 1e-6));
    r.least_pivot = 1e-5; /* 100 epsilon over its square: 2.2e-4 of them, which is limited to nearly 1e-6 */
    LAW("and near one", fabs(estimate(&r, 0.5, x, y) * 1e-6 / sqrt(21) - 1 - 1e-10 * 1e-6 / (100 * MBS_EPSILON)) < 1e-9);
    r.least_pivot = 1;
    LAW("else a hundred roundings", fabs(estimate(&r, 0.5, x, y) * 100 * MBS_EPSILON / sqrt(21) - 1) < 1e-7);
    manner.estimates = 2, manner.atol = 1, E4[2] = 3, E4[3] = 0; /* 3 3 3 3 */
    LAW("two estimates are those of DOP853", fabs(estimate(&r, 0.5, x, y) - 0.5 * 84 / sqrt((84 + 0.36) * 4)) < 1e-9);
    E4[2] = 0;
    LAW("of which the second may be none", fabs(estimate(&r, 0.5, x, y) - 0.5 * sqrt(21)) < 1e-9);
    E4[0] = E4[1] = 0, E4[2] = 3;
    LAW("no error is none, whatever the second one says", estimate(&r, 0.5, x, y) == 0);
}

/* The first step of Hairer, Norsett, Wanner: a motion from x with the rates k and the rates `later` after a guess. */
static casadi_real find_first(const casadi_real *x, casadi_real stiff, casadi_real order)
{
    casadi_real size[2] = {0, 0}, change = 0, k[4], guess, most, h;
    int i;
    for (i = 0; i < 4; ++i) {
        k[i] = i < 2 ? x[2 + i] : -stiff * x[i - 2];
        size[0] += pow(x[i] / (manner.atol + manner.rtol * fabs(x[i])), 2) / 4;
        size[1] += pow(k[i] / (manner.atol + manner.rtol * fabs(x[i])), 2) / 4;
    }
    guess = sqrt(size[0]) < 1e-5 || sqrt(size[1]) < 1e-5 ? 1e-6 : 0.01 * sqrt(size[0]) / sqrt(size[1]);
    for (i = 0; i < 4; ++i)
        change += pow((i < 2 ? guess * k[2 + i] : -stiff * guess * k[i - 2]) / (manner.atol + manner.rtol * fabs(x[i])), 2) / 4;
    most = fmax(sqrt(size[1]), sqrt(change) / guess);
    h = most <= 1e-15 ? 1e-6 : pow(0.01 / most, 1 / order);
    return fmin(h, 100 * guess);
}

static void first_steps(void)
{
    const casadi_real starts[6][4] = {{3, -2, 0.5, 1}, {1e-12, 0, 0, 0}, {0, 0, 0, 0},
                                      {1e-3, 0, 1e-9, 0}, {1e-12, 0, 1, 0}, {2e-10, 0, 0, 0}};
    const casadi_real stiff[4] = {0, 1e-12, 9, 1e8}, tolerances[3] = {1e-6, 1, 1e3};
    int i, j, k;
    for (i = 0; i < 6; ++i)
        for (j = 0; j < 4; ++j)
            for (k = 0; k < 3; ++k) {
                casadi_real h = 0;
                mbs_run r;
                anew(0);
                manner.order = 4 + i % 2, manner.atol = 1e-6 * tolerances[k], manner.rtol = 1e-4 * tolerances[k];
                stiffness[0] = stiffness[1] = stiff[j];
                r = open_here();
                evaluate(&r, 0, 0, starts[i]);
                LAW("a first step has a result", begin(&r, 0, starts[i], &h) == 0);
                LAW("a first step follows from the first two derivatives",
                    fabs(h / find_first(starts[i], stiff[j], (casadi_real)manner.order) - 1) < 1e-6);
            }
    anew(0);
    manner.order = 1, manner.atol = 1e-6, manner.rtol = 1e-4, push[0] = 1e9; /* of a coordinate of 0 with a speed of 1e4 */
    {
        const casadi_real x[4] = {0, 0, 1e4, 0};
        mbs_run r = open_here();
        casadi_real h;
        evaluate(&r, 0, 0, x);
        LAW("the first coordinate's second derivative counts", begin(&r, 0, x, &h) == 0 && fabs(h / 2e-17 - 1) < 1e-3);
    }
    anew(0);
    failing = 1;
    {
        mbs_run r = open_here();
        casadi_real h;
        LAW("or the status of a kernel", begin(&r, 0, starts[0], &h) == 1);
    }
}

static void dips(void)
{
    /* s^3 - 0.15 s^2 - 0.9 s + c is lowest at s = 0.6, by 0.378 below c; its ends are c and c - 0.05. */
    LAW("a cubic has its lowest place", fabs(find_dip(2, 0.4, -0.45, 0.35, 0.9) - 0.6) < 1e-14);
    LAW("which counts where it is a quarter of the lower end", fabs(find_dip(2, 0.46, -0.45, 0.41, 0.9) - 0.6) < 1e-14);
    LAW("but not above", find_dip(2, 0.5, -0.45, 0.45, 0.9) == 0 && find_dip(2, 0.45, -0.9, 0.5, 0.45) == 0);
    LAW("in a mirror too", fabs(find_dip(2, 0.35, -0.9, 0.4, 0.45) - 0.4) < 1e-14);
    LAW("a parabola has its own", fabs(find_dip(2, 0.26, -0.5, 0.26, 0.5) - 0.5) < 1e-14);
    LAW("a guard that falls at the end has none within", find_dip(1, 0.1, -1, 0.1, -1) == 0);
    LAW("nor has one that rises at the start", find_dip(1, 0.1, 1, 0.1, 1) == 0);
    LAW("nor one that rests at an end", find_dip(1, 0.1, 0, 0.1, 1) == 0 && find_dip(1, 0.1, -1, 0.1, 0) == 0);
}

static void guards(void)
{
    const casadi_real rate[4] = {0, 0, 7, 11};
    mbs_run r;
    anew(4);
    kind[1] = MBS_SPEED, kind[2] = MBS_FORCE, side[0] = -1, side[2] = 3, level[0] = 5, level[1] = 1, level[2] = 0.5;
    q2[0] = 2, q2[1] = -3, qd2[0] = 0.5, qd2[1] = 4, push[0] = 100, mass[1] = 0.25;
    r = open_here();
    LAW("guards are evaluated", guard(&r, rate, values) == 0);
    LAW("of a coordinate", values[0] == 3 && values[4] == -0.5 && values[3] == -3 && values[7] == 4);
    LAW("of a velocity", values[1] == 3 && values[5] == 11);
    LAW("of the force that holds a joint, whose rate is not known",
        fabs(values[2] - 3 * (7 + 0.25 * 11 - 100 - 0.5)) < 1e-12 && values[6] == 0);
    evaluated = 0;
    modes.guards = 2;
    LAW("forces are computed for guards that read them", guard(&r, rate, values) == 0 && evaluated == 0);
    values[0] = 1, values[1] = 0;
    LAW("a guard of 0 holds", !is_below(2, values));
    values[1] = -1e-300;
    LAW("one below does not", is_below(2, values) && !is_below(1, values));
    q2[0] = 8, level[0] = 7, side[0] = -1, r.lowest = -1, r.fraction = 0.25;
    LAW("a stage is watched", watch(&r, 1) == 0 && r.lowest == -1 && r.fraction == 0.25);
    q2[0] = 9;
    LAW("and noted where a guard is lower", watch(&r, 1) == 0 && r.lowest == -2 && r.fraction == manner.c[1]);
    LAW("there are guards", has_guards(&r));
    modes.guards = 0;
    LAW("or none", !has_guards(&r));
    plant.modes = 0;
    LAW("of no modes", !has_guards(&r));
}

static void friction(void)
{
    anew(0);
    qd2[0] = 3, qd2[1] = -2, torque[0] = 5, fading[0] = 2, slowness[0] = 0.25, torque[1] = 7;
    LAW("a joint that does not slide is free", brake(&plant, 0) == 0);
    sign[0] = 1, sign[1] = -1;
    LAW("friction opposes sliding, and falls with the speed", near(brake(&plant, 0), -(5 + 2 * exp(-0.5625))));
    LAW("or is constant", brake(&plant, 1) == 7);
    plant.modes = 0;
    LAW("without modes there is none", brake(&plant, 0) == 0);
}

static casadi_real earliest, latest;

static int note_time(casadi_real t)
{
    earliest = fmin(earliest, t), latest = fmax(latest, t);
    return 0;
}

/* An event is sought at times of its step alone, from its start to its end. */
static void times_of_events(void)
{
    casadi_real h = 2, x[4] = {1, 0, 0, 0}, y[4];
    mbs_run r;
    anew(1);
    push[0] = -1, manner.atol = 1e9;
    r = open_here();
    evaluate(&r, 5, 0, x), step(&r, 5, h, x, 1, y);
    manner.inputs = note_time, earliest = 99, latest = -99;
    LAW("an event has inputs", look(&r, 5, &h, x, y) == MBS_EVENT && fabs(h - sqrt(2)) < 1e-14);
    LAW("of all times of its step", earliest == 5 && latest == 7);
    x[0] = 0.5 + 1e-3, x[2] = -1, push[0] = 1, h = 2;
    r = open_here();
    evaluate(&r, 5, 0, x), step(&r, 5, h, x, 1, y);
    earliest = 99, latest = -99;
    LAW("and where there is none", look(&r, 5, &h, x, y) == 0 && earliest == 5 && latest == 7);
}

/* The height q0 = 1 - t^2 / 2 falls to the floor at t = sqrt(2); a step of two seconds ends at -1. */
static void events(void)
{
    casadi_real h = 2, x[4] = {1, 0, 0, 0}, y[4];
    mbs_run r;
    anew(1);
    push[0] = -1, manner.atol = 1e9;
    r = open_here();
    evaluate(&r, 0, 0, x);
    step(&r, 0, h, x, 1, y);
    LAW("a step over an event is cut there", look(&r, 0, &h, x, y) == MBS_EVENT && fabs(h - sqrt(2)) < 1e-14);
    LAW("with the state at it", fabs(y[0]) < 1e-14 && y[0] <= 0 && alike(y[2], -h));
    LAW("and the guard that fell", fired[0] == 1);
    LAW("by few steps", evaluated < 60);
    x[0] = 1, x[2] = 0, h = 1;
    r = open_here();
    evaluate(&r, 0, 0, x), step(&r, 0, h, x, 1, y);
    LAW("a step without one is whole", look(&r, 0, &h, x, y) == 0 && h == 1 && y[0] == 0.5);
    LAW("and leaves the rates at its end", alike(r.k[0], -1) && r.k[2] == -1);
    /* q0 = (t - 1)^2 / 2 - d dips below the floor by d, in a step from 0 to 2 */
    x[0] = 0.5 - 1e-3, x[2] = -1, push[0] = 1, h = 2;
    r = open_here();
    evaluate(&r, 0, 0, x), step(&r, 0, h, x, 1, y);
    LAW("a dip within a step is found", look(&r, 0, &h, x, y) == MBS_EVENT && fabs(h - 1 + sqrt(2e-3)) < 1e-13);
    modes.guards = 2, level[1] = -100, x[0] = 0.5 - 1e-3, h = 2;
    r = open_here();
    evaluate(&r, 0, 0, x), step(&r, 0, h, x, 1, y);
    LAW("of the first guard too", look(&r, 0, &h, x, y) == MBS_EVENT && fabs(h - 1 + sqrt(2e-3)) < 1e-13);
    modes.guards = 1, x[0] = 0.5 - 1e-3, h = 2;
    r = open_here();
    evaluate(&r, 0, 0, x), r.is_watching = 1, step(&r, 0, h, x, 1, y);
    LAW("stages note where they are lowest", alike(r.lowest, -0.501) && r.fraction == 0.5);
    x[0] = 0.5 + 1e-3, h = 2;
    r = open_here();
    evaluate(&r, 0, 0, x), step(&r, 0, h, x, 1, y);
    LAW("one that stays above is none", look(&r, 0, &h, x, y) == 0 && h == 2 && alike(y[0], x[0]));
    LAW("whose rates at the end stand there", alike(r.k[0], 1) && r.k[2] == 1);
    /* a guard that is 0 at the start and leaves it, and falls back at t = 1 */
    x[0] = 0, x[2] = 0.5, push[0] = -1, h = 1.5;
    r = open_here();
    evaluate(&r, 0, 0, x), step(&r, 0, h, x, 1, y);
    LAW("the way back to a guard is found, not the start", look(&r, 0, &h, x, y) == MBS_EVENT && fabs(h - 1) < 1e-14);
    x[0] = -1e-13, h = 1.5;
    r = open_here();
    evaluate(&r, 0, 0, x), step(&r, 0, h, x, 1, y);
    LAW("though rounding has put the start below", look(&r, 0, &h, x, y) == MBS_EVENT && fabs(h - 1) < 1e-12);
    /* a guard that is 0 at the start and falls at once */
    x[0] = 0, x[2] = -0.5, h = 1;
    r = open_here();
    evaluate(&r, 0, 0, x), step(&r, 0, h, x, 1, y);
    LAW("a guard that falls at once fires at once", look(&r, 0, &h, x, y) == MBS_EVENT && h < 1e-12);
    failing = evaluated + 7;
    x[0] = 1, h = 2;
    r = open_here();
    evaluate(&r, 0, 0, x), step(&r, 0, h, x, 1, y);
    LAW("a kernel that fails while an event is sought is no event", look(&r, 0, &h, x, y) == 1);
}

/* The first of two guards is the event; a stiff one, whose values are far from a line, is placed by few steps too. */
static void places(void)
{
    casadi_real h = 3, x[4] = {1, 2, 0, 0}, y[4];
    mbs_run r;
    int before;
    anew(2);
    push[0] = -1, push[1] = -4; /* at sqrt(2), and at 1 */
    r = open_here();
    evaluate(&r, 0, 0, x), step(&r, 0, h, x, 1, y);
    before = evaluated;
    LAW("the first of two events counts", look(&r, 0, &h, x, y) == MBS_EVENT && fabs(h - 1) < 1e-14);
    LAW("and alone", fired[0] == 0 && fired[1] == 1);
    LAW("placed by few steps", evaluated - before < 4 * 14);
    x[0] = 1, x[2] = -2, push[0] = 1, push[1] = 0, h = 2; /* 1 - 2 t + t^2 / 2: at 2 - sqrt(2) */
    r = open_here();
    evaluate(&r, 0, 0, x), step(&r, 0, h, x, 1, y);
    before = evaluated;
    LAW("a guard that falls ever more slowly", look(&r, 0, &h, x, y) == MBS_EVENT && fabs(h - 2 + sqrt(2)) < 1e-14);
    LAW("is placed by few steps as well", evaluated - before < 4 * 14 && fired[0] == 1 && fired[1] == 0);
    x[2] = 0, push[0] = -1, push[1] = -4;
    side[1] = 1e6, h = 1.5;
    r = open_here();
    evaluate(&r, 0, 0, x), step(&r, 0, h, x, 1, y);
    LAW("the size of a guard does not count", look(&r, 0, &h, x, y) == MBS_EVENT && fabs(h - 1) < 1e-14);
    push[1] = 0, x[1] = 1, x[3] = 0, stiffness[1] = 1e-9, push[0] = -0.5e-6, x[0] = 1e-6, h = 1000;
    side[1] = 1;
    r = open_here();
    evaluate(&r, 0, 0, x), step(&r, 0, h, x, 1, y);
    before = evaluated;
    LAW("a long step too", look(&r, 0, &h, x, y) == MBS_EVENT && fabs(h - 2) < 1e-11);
    LAW("by few steps, though the secant is flat", evaluated - before < 4 * 24);
}

/* M = 2 1, 1 3: an impulse p on the first joint changes the velocities by p (3, -1) / 5. */
static mbs_run fall_on_stop(casadi_real *y)
{
    mbs_run r;
    anew(2);
    mass[0] = 2, mass[1] = mass[2] = 1, mass[3] = 3, level[0] = 4, level[1] = -10;
    y[0] = 4 - 1e-14, y[1] = -9, y[2] = -2, y[3] = 1;
    fired[0] = 1, fired[1] = 0, modes.most = 2;
    r = open_here();
    return r;
}

static void impacts(void)
{
    casadi_real y[4], after[4];
    mbs_run r = fall_on_stop(y);
    LAW("an impact on a stop alone is passed", bounce(&r, y, after, 7) == 0 && modes.bounces == 1);
    LAW("on the stop", y[0] == 4 && after[0] == 4 && after[1] == y[1] && y[2] == -2);
    LAW("thrown back by its restitution", after[2] == 1);
    LAW("by an impulse on its joint alone", alike(6 + after[3] - 1, impulse_of[0]) && fabs(3 + 3 * (after[3] - 1)) < 1e-14);
    LAW("which is noted", row_of[0] == 7 && guard_of[0] == 0 && alike(impulse_of[0], 5));
    LAW("while there is room", bounce(&r, y, after, 8) == 0 && modes.bounces == 2 && bounce(&r, y, after, 9) == MBS_EVENT);
    r = fall_on_stop(y);
    side[0] = -1, y[2] = 2;
    LAW("from below too", bounce(&r, y, after, 7) == 0 && after[2] == -1 && alike(impulse_of[0], 5) && alike(after[3], 2));
    r = fall_on_stop(y);
    y[2] = -0.5;
    LAW("the slowest that is thrown back", bounce(&r, y, after, 1) == 0);
    y[2] = -0.499, y[0] = 4;
    LAW("slower ones are decided elsewhere", bounce(&r, y, after, 1) == MBS_EVENT);
    y[2] = 2;
    LAW("one that leaves is no impact", bounce(&r, y, after, 1) == MBS_EVENT);
    r = fall_on_stop(y);
    y[1] = -9.91;
    LAW("nor is it alone where another stop touches", bounce(&r, y, after, 1) == MBS_EVENT);
    y[1] = -9.89;
    LAW("which counts beside its place", bounce(&r, y, after, 1) == 0);
    r = fall_on_stop(y);
    level[1] = 0, y[1] = 0.0101;
    LAW("or beside 1", bounce(&r, y, after, 1) == 0);
    y[1] = 0.0099;
    LAW("at least", bounce(&r, y, after, 1) == MBS_EVENT);
    modes.touch = 0.25, y[1] = 0.25;
    LAW("at that distance, too", bounce(&r, y, after, 1) == MBS_EVENT);
    modes.touch = 1e-2, y[1] = 0.0099, kind[1] = MBS_SPEED;
    LAW("other guards touch nothing", bounce(&r, y, after, 1) == 0);
    r = fall_on_stop(y);
    fired[1] = 1;
    LAW("two that fire are decided elsewhere", bounce(&r, y, after, 1) == MBS_EVENT);
    fired[1] = 0, kind[0] = MBS_SPEED;
    LAW("and all but places", bounce(&r, y, after, 1) == MBS_EVENT);
    r = fall_on_stop(y);
    fired[0] = 0;
    LAW("where none fires nothing is passed", bounce(&r, y, after, 1) == MBS_EVENT);
    fired[0] = 1, modes.most = 0;
    LAW("nor where nothing may", bounce(&r, y, after, 1) == MBS_EVENT);
    r = fall_on_stop(y);
    r.free = 1;
    LAW("nor with held joints", bounce(&r, y, after, 1) == MBS_EVENT);
    r = fall_on_stop(y);
    sign[1] = -1; /* the second joint goes from 1 to 0 */
    LAW("a joint that slides the other way is decided elsewhere", bounce(&r, y, after, 1) == MBS_EVENT);
    sign[1] = 1, y[3] = 1 + 0.0019;
    LAW("one that comes to rest too, beside the fastest", bounce(&r, y, after, 1) == MBS_EVENT);
    y[3] = 1 + 0.0021;
    LAW("one that goes on is not", bounce(&r, y, after, 1) == 0);
    r = fall_on_stop(y);
    failing = 0, plant.e = 0, plant.d = 1;
    LAW("driven joints are decided elsewhere", bounce(&r, y, after, 1) == MBS_EVENT);
}

/* Constant accelerations by two stages, k0 = (v, a) and k1 = (v + h a, a), with the estimate (k1 - k0) / 2: the error of a
 * step of length h is h^2 |a| / 4, of one joint of two that accelerates. */
static void prepare_steps(casadi_real error)
{
    anew(0);
    manner.stages = 2, manner.order = 2, manner.estimates = 1, A4[2] = 1, A4[1] = 0, b4[0] = b4[1] = 0.5, c4[1] = 1;
    memset(E4, 0, sizeof E4);
    A4[0] = A4[1] = A4[3] = 0;
    E4[0] = -0.5, E4[1] = 0.5, manner.rtol = 0, manner.atol = 1, push[0] = 4 * error;
}

static casadi_real times[40], states[160], begins;

static void go(casadi_real end, casadi_real *h, casadi_int steps)
{
    make_room();
    times[0] = begins;
    states[0] = states[1] = states[2] = states[3] = 0;
    mbs_explicit_run(&plant, &manner, end, h, steps, 0, 0, times, states, room, numbers, &outcome);
}

static void adaptive(void)
{
    casadi_real h = 1;
    prepare_steps(1.0 / 16); /* of a step of 1: the next may be 3.6 times as long */
    go(100, &h, 1);
    LAW("a step is made", outcome.status == 0 && outcome.steps == 1 && times[1] == 1 && alike(states[6], 0.25));
    LAW("the next one has 0.9 of the length that the tolerance allows", alike(h, 3.6) && outcome.rejected == 0);
    prepare_steps(1e-8), h = 1;
    go(100, &h, 1);
    LAW("at most ten times the last", alike(h, 10));
    prepare_steps(0), h = 1;
    go(100, &h, 1);
    LAW("without any error too", alike(h, 10));
    prepare_steps(1), h = 1;
    go(100, &h, 1);
    LAW("an error of the tolerance is accepted", outcome.rejected == 0 && alike(h, 0.9));
    prepare_steps(1), modes.guards = 1, side[0] = -1, level[0] = 1, h = 1; /* 2 t^2 rises to 1 */
    go(100, &h, 1);
    LAW("with the events of its step", outcome.status == MBS_EVENT && fabs(times[1] - sqrt(0.5)) < 1e-14);
    manner.atol = 1 - 4 * (100 * MBS_EPSILON / (1 + 100 * MBS_EPSILON / NOISY)), h = 1; /* and rounding: 1 in all */
    go(100, &h, 1);
    LAW("to the last digit", outcome.status == MBS_EVENT && fabs(times[1] - sqrt(0.5)) < 1e-14);
    prepare_steps(4), modes.guards = 1, side[0] = -1, level[0] = 1, h = 1;
    go(100, &h, 1);
    LAW("events of rejected steps do not count", outcome.status == MBS_EVENT && outcome.rejected == 1);
    prepare_steps(4), h = 1;
    go(100, &h, 1); /* 0.9 / 2, with an error of 0.81 */
    LAW("a larger one is rejected", outcome.rejected == 1 && alike(times[1], 0.45));
    LAW("after which no step grows", alike(h, 0.45));
    prepare_steps(1e4), h = 1;
    go(100, &h, 1); /* a fifth each time: 0.2, 0.04; then the error is 16, and the rest by 0.9 / 4 */
    LAW("a step falls to a fifth at least", outcome.rejected == 3 && fabs(times[1] - 0.009) < 1e-10);
    prepare_steps(1.0 / 16), h = 1, failing = 2;
    go(100, &h, 1);
    LAW("a kernel that fails costs three quarters", outcome.rejected == 1 && alike(times[1], 0.25));
    LAW("after which no step grows either", alike(h, 0.25));
    prepare_steps(1.0 / 16), h = 1, failing = 2;
    go(100, &h, 2);
    LAW("but the next ones do", outcome.rejected == 1 && alike(times[2], 0.5) && alike(h, 2.5));
    prepare_steps(0), push[0] = NAN, h = 1, begins = 1;
    go(100, &h, 1);
    LAW("steps are not shortened without end", outcome.status == MBS_RUNAWAY && outcome.steps == 0 && outcome.rejected == 24);
    prepare_steps(1), E4[0] = 1e20, h = 1;
    go(100, &h, 1);
    LAW("they have a shortest length beside the time", outcome.status == MBS_SHORT && outcome.rejected == 21);
    begins = 0;
    prepare_steps(0), failing = 1, h = 1;
    go(100, &h, 1);
    LAW("a kernel that fails at the start ends the run", outcome.status == 1 && outcome.steps == 0);
    prepare_steps(0), h = 1;
    go(100, &h, 3);
    LAW("rates are computed once where a step begins", outcome.evaluations == 6);
    prepare_steps(0), h = 1, b4[0] = 1, b4[1] = 0;
    go(100, &h, 3);
    LAW("and not again where they are known", outcome.evaluations == 4);
    prepare_steps(0), h = 1, b4[0] = 1, b4[1] = 0, push[0] = 2, push[1] = 3, manner.atol = 1e9;
    go(100, &h, 2); /* by the last stage, which is the end of Euler's step */
    h = times[2] - times[1];
    LAW("which are the ones at the end", alike(states[8], 2 * h * times[1]) && alike(states[9], 3 * h * times[1]));
    LAW("of velocities, too", alike(states[10], 2 * times[2]) && alike(states[11], 3 * times[2]));
    prepare_steps(0), h = 1;
    go(1.02, &h, 4);
    LAW("the last two steps have one length", outcome.steps == 2 && alike(times[1], 0.51));
    prepare_steps(0), h = 1;
    go(1.005, &h, 4);
    LAW("a hundredth is not left over", outcome.steps == 1 && times[1] == 1.005);
    prepare_steps(0), h = 1;
    go(1.8, &h, 4);
    LAW("what is left of less than two steps is halved", outcome.steps == 2 && alike(times[1], 0.9) && times[2] == 1.8);
    prepare_steps(0), h = 1;
    go(2.2, &h, 1);
    LAW("of more it is not", times[1] == 1);
    prepare_steps(1.0 / 16), h = 8;
    go(0.5, &h, 4);
    LAW("a short last step does not shorten the next ones", outcome.steps == 1 && alike(h, 8));
    prepare_steps(1.0 / 16), h = 1;
    go(0.5, &h, 4); /* of a step of a half, with an error of a sixty-fourth: 7.2 times as long */
    LAW("but it may lengthen them", alike(h, 3.6));
    LAW("a step that fails may be retried", may_retry(MBS_RUNAWAY) && may_retry(MBS_OPEN) && may_retry(MBS_BRANCHED));
    LAW("also where equations depend on each other, or a kernel fails", may_retry(MBS_DEPENDENT) && may_retry(1));
    LAW("but not where the caller stops it", !may_retry(MBS_STOPPED) && !may_retry(0) && !may_retry(MBS_EVENT));
}

static void ends(void)
{
    mbs_run r;
    anew(0);
    r = open_here();
    LAW("the classical method computes the rates anew", !ends_with_first(&r));
    A4[12] = b4[0], A4[13] = b4[1], A4[14] = b4[2], A4[15] = b4[3];
    LAW("a method whose last stage is its end does not", ends_with_first(&r));
    A4[15] = 0;
    LAW("each weight counts", !ends_with_first(&r));
    A4[15] = b4[3], plant.d = 1;
    LAW("driven joints are moved at the end", !ends_with_first(&r));
    plant.d = 0, plant.e = 1;
    LAW("loops are closed there", !ends_with_first(&r));
}

static void fixed_steps(void)
{
    casadi_real h = 0.5;
    int k;
    anew(1);
    push[0] = -1, level[0] = -1; /* -t^2/2 reaches -1 at sqrt(2), in the third step */
    for (k = 1; k < 40; ++k)
        times[k] = 0.5 * k;
    go(0, &h, 20);
    LAW("steps of one length end at an event", outcome.status == MBS_EVENT && outcome.steps == 3);
    LAW("whose time and state are written", fabs(times[3] - sqrt(2)) < 1e-14 && fabs(states[12] + 1) < 1e-14);
    LAW("after states at their times", alike(states[4], -0.125) && alike(states[8], -0.5));
    level[0] = -100;
    for (k = 1; k < 40; ++k)
        times[k] = 0.5 * k;
    go(0, &h, 20);
    LAW("or where they shall", outcome.status == 0 && outcome.steps == 20 && alike(states[80], -50) && outcome.evaluations == 20 * 5);
}

static void bounces(void)
{
    casadi_real h = 0;
    anew(1);
    push[0] = -1, level[0] = -0.5, modes.most = 3, modes.slow = 0.1; /* at 1; thrown back by half: again at 2, and at 2.5 */
    manner.estimates = 1, E4[0] = 1e-3, E4[3] = -1e-3, manner.atol = manner.rtol = 1;
    go(2.25, &h, 38);
    LAW("impacts are passed", outcome.status == 0 && times[outcome.steps] == 2.25 && modes.bounces == 2);
    LAW("with two rows at one time", times[row_of[0]] == times[row_of[0] - 1] && fabs(times[row_of[0]] - 1) < 1e-14);
    LAW("of the velocities before and after", alike(states[4 * row_of[0] - 2], -1) && alike(states[4 * row_of[0] + 2], 0.5));
    LAW("each", fabs(times[row_of[1]] - 2) < 1e-13 && fabs(states[4 * row_of[1] + 2] - 0.25) < 1e-13);
    LAW("and the motion goes on", fabs(states[4 * outcome.steps] + 0.5 - 0.25 * 0.25 + 0.03125) < 1e-13);
    modes.most = 1, h = 0;
    go(2.25, &h, 38);
    LAW("as many as may be", outcome.status == MBS_EVENT && modes.bounces == 1 && fabs(times[outcome.steps] - 2) < 1e-13);
}

static int fall_faster(casadi_real t)
{
    push[0] = -t;
    return 0;
}

/* -t^3/6 falls to -1/6 at 1, where -1/2 is thrown back by half. */
static void impacts_in_time(void)
{
    casadi_real h = 0;
    anew(1);
    level[0] = -1.0 / 6, modes.most = 3, modes.slow = 0.1, manner.inputs = fall_faster;
    manner.estimates = 1, E4[0] = 1e-3, E4[3] = -1e-3, manner.atol = manner.rtol = 1;
    go(1.2, &h, 38);
    LAW("after an impact time goes on", outcome.status == 0 && modes.bounces == 1 && times[outcome.steps] == 1.2);
    LAW("with the forces there", fabs(states[4 * outcome.steps] - (0.05 + 0.1 - 1.728 / 6)) < 1e-13);
    LAW("from its first rates on", fabs(states[4 * outcome.steps + 2] - (0.25 - 0.22)) < 1e-13);
}

static void series(void)
{
    static casadi_real kept[2][24], lengths[2], numbers_of[2] = {-1, -2};
    static const casadi_real outputs[5] = {0.125, 0.5, 1, 1 + 1e-12, 3};
    const mbs_parameters set = {numbers_of, 1, 1, push};
    mbs_series wanted;
    int status[2], k, i;
    prepare_steps(0);
    memset(&wanted, 0, sizeof wanted), memset(kept, 0, sizeof kept);
    wanted.end = 3, wanted.sets = 1, wanted.set = &set, wanted.outputs = 5, wanted.times = outputs, wanted.near = 1e-9;
    wanted.chunk = 3, wanted.most = 100, manner.atol = 1;
    for (k = 0; k < 2; ++k)
        lengths[k] = 1.0 / 3, kept[k][0] = 10 + k;
    make_room();
    mbs_explicit_series(&plant, &manner, &wanted, 0, 2, kept[0], lengths, times, states, room, numbers, status);
    for (k = 0; k < 2; ++k) {
        LAW("each motion of a series has its own status", status[k] == 0);
        for (i = 0; i < 5; ++i) {
            LAW("states are kept at the outputs, by its own numbers",
                fabs(kept[k][4 * (i + 1)] - (10 + k + 0.5 * numbers_of[k] * outputs[i] * outputs[i])) < 1e-8);
            LAW("velocities too", fabs(kept[k][4 * (i + 1) + 2] - numbers_of[k] * outputs[i]) < 1e-8);
        }
    }
    LAW("a motion ends exactly", fabs(kept[0][20] - 5.5) < 1e-12);
    wanted.most = 1, lengths[0] = lengths[1] = 0.01;
    mbs_explicit_series(&plant, &manner, &wanted, 1, 2, kept[0], lengths, times, states, room, numbers, status);
    LAW("a motion of too many steps ends", status[0] == 0 && status[1] == MBS_LONG);
}

int main(void)
{
    read_parts();
    openings();
    estimates();
    first_steps();
    dips();
    guards();
    friction();
    events();
    times_of_events();
    places();
    impacts();
    adaptive();
    ends();
    fixed_steps();
    bounces();
    impacts_in_time();
    series();
    choose_joints();
    correct_alone();
    LAW("one step is enough with the J of the place", close_off(0, 0, 5, 3) < 1e-14 && calls == 1);
    LAW("with another one, steps go on until they are rounding", close_off(1e-3, 1e-3, 5, 3) < 1e-14 && calls > 3);
    LAW("beside the velocities, which may be large", close_off(1e-3, 1e-3, 5e6, 3e6) < 1e-7 && calls > 3);
    LAW("or small", close_off(1e-3, 1e-3, 5e-3, 3e-3) < 1e-15 && calls > 2);
    return broken > 0;
}
