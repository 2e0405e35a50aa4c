#include "laws.h"

#include <math.h>
#include <stdlib.h>

#include "../../../csrc/mbs_explicit.c"
#include "../../../csrc/mbs_least.c"

/* --- a plant of four joints, the third of which may be driven,
    with equations line.q + curve q.q / 2 = offset ---------------- */

enum { N = 4 };
static casadi_real q[N + 1], qd[N], v[2], course[3], rest[N], qdd[N], left[N], h[2], hd[2], gamma_of[2], qt[N + 1];
static casadi_real mass[N * N], J[2 * N], line[2 * N], curve[2], offset[2], push[N], wrong, noise, sign[N], torque[N];
static casadi_real zeros[N];
static const casadi_int every[16] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15}, driven[1] = {2},
    loop[2] = {4, 9};
static casadi_int held[N];
static mbs_explicit plant;
static mbs_modes modes;
static mbs_manner manner;
static mbs_outcome outcome;
static casadi_real *room;
static casadi_int *numbers;
static const casadi_real A[4] = {0, 0, 1, 0}, b[2] = {0.5, 0.5}, c[2] = {0, 1};
enum { DIRECT, RESIDUAL, MASS, CLOSURE, RATES, JACOBIAN, CHANGE, GUIDE, INPUTS, KINDS };
static int calls[KINDS], fails[KINDS]; /* how often, and at which call one fails */

static int count(int kind, casadi_int *iw, casadi_real *w, int memory)
{
    LAW("kernels have no memory", !iw && !w && !memory);
    return ++calls[kind] == fails[kind] ? 11 + kind : 0;
}

#define KERNEL(name) \
    static int name(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int memory)

KERNEL(find_accelerations)
{
    (void)arg, (void)res;
    return count(DIRECT, iw, w, memory);
}

KERNEL(find_residual)
{
    casadi_int i, k;
    (void)arg, (void)res;
    for (i = 0; i < N; ++i)
        for (k = 0, left[i] = -push[i]; k < N; ++k)
            left[i] += mass[N * i + k] * rest[k];
    return count(RESIDUAL, iw, w, memory);
}

KERNEL(find_mass)
{
    (void)arg, (void)res;
    return count(MASS, iw, w, memory);
}

KERNEL(find_gaps)
{
    casadi_int i, k;
    (void)arg, (void)res;
    for (i = 0; i < plant.e; ++i)
        for (k = 0, h[i] = (calls[CLOSURE] % 2 ? noise : -noise) - offset[i]; k < N; ++k)
            h[i] += (line[N * i + k] + curve[i] * q[k] / 2) * q[k];
    return count(CLOSURE, iw, w, memory);
}

KERNEL(find_rates)
{
    casadi_int i, k;
    (void)arg, (void)res;
    for (i = 0; i < plant.e; ++i)
        for (k = 0, hd[i] = calls[RATES] % 2 ? noise : -noise; k < N; ++k)
            hd[i] += (line[N * i + k] + curve[i] * q[k]) * qd[k];
    return count(RATES, iw, w, memory);
}

KERNEL(find_jacobian)
{
    casadi_int i, k;
    (void)arg, (void)res;
    for (i = 0; i < plant.e; ++i)
        for (k = 0, gamma_of[i] = 0; k < N; ++k) {
            J[N * i + k] = (1 + wrong) * (line[N * i + k] + curve[i] * q[k]);
            gamma_of[i] += curve[i] * qd[k] * qd[k];
        }
    return count(JACOBIAN, iw, w, memory);
}

KERNEL(change)
{
    casadi_int k;
    (void)arg, (void)res;
    for (k = 0; k < N; ++k)
        qt[k] = 2 * qd[k];
    qt[N] = qd[0] + qd[3];
    return count(CHANGE, iw, w, memory);
}

static casadi_real asked_at[9];

/* Note the time of a question, the last one first. */
static void note(casadi_real t)
{
    int k;
    for (k = 8; k > 0; --k)
        asked_at[k] = asked_at[k - 1];
    asked_at[0] = t;
}

static int lead(casadi_real t)
{
    note(t);
    course[0] = 10 + t, course[1] = 20 + t, course[2] = 30 + t;
    return ++calls[GUIDE] == fails[GUIDE];
}

static int give(casadi_real t)
{
    note(t);
    v[0] = 100 + t;
    return ++calls[INPUTS] == fails[INPUTS];
}

static void lay_entries(mbs_entries *to, const casadi_real *from, casadi_int size)
{
    to->nonzeros = from, to->entries = size, to->place = every;
}

static mbs_run open_here(void)
{
    casadi_int k;
    free(room), free(numbers);
    room = malloc((size_t)mbs_explicit_reals(&plant, manner.stages) * sizeof *room);
    for (k = 0; k < mbs_explicit_reals(&plant, manner.stages); ++k)
        room[k] = NAN;
    numbers = calloc((size_t)mbs_explicit_integers(&plant), sizeof *numbers);
    return open_run(&plant, &manner, room, numbers, &outcome);
}

/* Begin anew with e equations in joints of masses that are coupled, without forces. */
static mbs_run anew(casadi_int e, int keeping)
{
    static const casadi_real M[N * N] = {4, 1, 0.5, -1, 1, 5, 0.25, 2, 0.5, 0.25, 6, 1, -1, 2, 1, 7};
    static const casadi_real lines[2 * N] = {1, 2, -1, 0.5, 3, -1, 2, 1};
    memset(&plant, 0, sizeof plant), memset(&modes, 0, sizeof modes), memset(&manner, 0, sizeof manner);
    memset(calls, 0, sizeof calls), memset(fails, 0, sizeof fails), memset(push, 0, sizeof push);
    memset(q, 0, sizeof q), memset(qd, 0, sizeof qd), memset(curve, 0, sizeof curve), memset(offset, 0, sizeof offset);
    memset(sign, 0, sizeof sign), memset(torque, 0, sizeof torque), memset(held, 0, sizeof held);
    memcpy(mass, M, sizeof M), memcpy(line, lines, sizeof lines), wrong = noise = 0;
    plant.n = plant.nq = N, plant.e = e, plant.q = q, plant.qd = qd, plant.v = v, plant.course = course,
        plant.rest = rest;
    plant.qdd = qdd, plant.r = left, plant.h = h, plant.hd = hd, plant.gamma = gamma_of, plant.qt = qt;
    lay_entries(&plant.M, mass, N * N), lay_entries(&plant.J, J, e * N);
    plant.residual.f = find_residual, plant.mass.f = find_mass, plant.closure.f = find_gaps, plant.rates.f = find_rates;
    plant.jacobian.f = find_jacobian, plant.driven = plant.place = driven, plant.loop = loop;
    modes.held = held, modes.sign = sign, modes.torque = torque, modes.fall = modes.slowness = zeros;
    manner.stages = 2, manner.order = 2, manner.A = A, manner.b = b, manner.c = c, manner.keeping = keeping;
    manner.guide = lead;
    return open_here();
}

static mbs_run drive(casadi_int e, int keeping)
{
    anew(e, keeping);
    plant.d = 1;
    return open_here();
}

static int near_by(casadi_real a, casadi_real d)
{
    return fabs(a - d) <= 1e-13 * fmax(1, fmax(fabs(a), fabs(d)));
}

static void set(casadi_real *to, casadi_real a, casadi_real d, casadi_real e, casadi_real f)
{
    to[0] = a, to[1] = d, to[2] = e, to[3] = f;
}

static casadi_real total(const casadi_real *a, const casadi_real *d)
{
    return a[0] * d[0] + a[1] * d[1] + a[2] * d[2] + a[3] * d[3];
}

/* --- laws ------------------------------------------------------------------------------------------------------------ */

static char uses[2000];

static void use(const casadi_real *first, casadi_int size)
{
    casadi_int k;
    for (k = 0; k < size; ++k)
        ++uses[first - room + k];
}

static void rooms(void)
{
    casadi_int k, with;
    for (with = 0; with < 2; ++with) {
        int once = 1;
        mbs_run r;
        anew(2, MBS_PROJECTION);
        plant.nq = 5, modes.guards = 3, plant.modes = with ? &modes : 0;
        r = open_here(), memset(uses, 0, sizeof uses);
        use(r.J, 8), use(r.B, 8), use(r.M, 16), use(r.least.factor, 2), use(r.least.size, 4), use(r.least.y, 4);
        use(r.x, 8), use(r.g, 4), use(r.saved, 4), use(r.sum, 9), use(r.k, 18);
        if (with)
            use(r.first, 9), use(r.tried, 9), use(r.start, 6), use(r.end, 6), use(r.between, 6), use(r.hold, 4);
        for (k = 0; k < 2000; ++k)
            once &= uses[k] == (k < mbs_explicit_reals(&plant, 2));
        LAW("arrays share no number, and leave none", once);
        LAW("nor integers", r.depends == numbers + 4 && r.best == r.depends + 2 && r.row == r.best + 4);
        LAW("to the last", r.least.column == r.row + 2 && mbs_explicit_integers(&plant) == 4 + 2 + 4 + 2 + 2);
        LAW("equations are found where they are written", r.least.A == r.B && r.least.e == 2);
    }
}

static void sizes(void)
{
    static const casadi_real x[4] = {1, -3, 2, 3}, none[3] = {1, NAN, 5};
    mbs_run r = anew(2, MBS_PROJECTION);
    LAW("the largest is the first of its size", find_largest(4, x) == 1 && find_largest(1, x) == 0);
    LAW("what is no number is larger", find_largest(3, none) == 1 && measure(3, none) != measure(3, none));
    LAW("sizes have no sign", measure(4, x) == 3 && measure(0, x) == 0);
    LAW("a failure names the loop of the worst equation", fail(&r, MBS_OPEN, x) == MBS_OPEN && outcome.loop == 9);
    LAW("whichever it is", fail(&r, MBS_OPEN, x + 1) == MBS_OPEN && outcome.loop == 4);
    plant.e = 0;
    LAW("if there is one", fail(&r, 5, x) == 5 && outcome.loop == 0);
    r.last = r.least_pivot = outcome.pivot = 1;
    see(&r, 0.5), r.least_pivot = 0.7, see(&r, 0.6);
    LAW("the least pivot is kept, of a step and of all", r.last == 0.6 && r.least_pivot == 0.6 && outcome.pivot == 0.5);
    see(&r, 0.9);
    LAW("which a larger one leaves", r.last == 0.9 && r.least_pivot == 0.6 && outcome.pivot == 0.5);
}

/* The determinant of three columns of rows of N numbers. */
static casadi_real determine(const casadi_real *a, casadi_int i, casadi_int j, casadi_int k)
{
    const casadi_real *d = a + 5, *e = a + 10;
    return a[i] * (d[j] * e[k] - d[k] * e[j]) - a[j] * (d[i] * e[k] - d[k] * e[i]) + a[k] * (d[i] * e[j] - d[j] * e[i]);
}

/* Equations in four of five joints: the first chosen has the largest entry of all; the determinant is of those chosen. */
static void choices(void)
{
    casadi_real own[15], B[15];
    casadi_int moves[4] = {0, 1, 3, 4}, best[5], k, i, at;
    unsigned seed = 7;
    int turn;
    mbs_run r = anew(2, MBS_PARTITIONING);
    plant.e = 3, plant.n = 5, r.free = 4, r.moves = moves, r.best = best, r.J = own, r.B = B;
    for (turn = 0; turn < 50; ++turn) {
        casadi_real volume, most = 0;
        for (k = 0; k < 15; ++k)
            seed = seed * 1103515245u + 12345u, own[k] = (casadi_real)(seed / 65536 % 2001) / 1000 - 1;
        volume = find_best(&r);
        for (k = 0, at = -1; k < 3; ++k)
            for (i = 0; i < 4; ++i)
                if (fabs(own[5 * k + moves[i]]) > most)
                    most = fabs(own[5 * k + moves[i]]), at = moves[i];
        LAW("the first dependent joint has the largest entry", best[0] == at);
        LAW("all are free joints, each once",
            best[0] + best[1] + best[2] + best[3] == 8 && best[0] * best[1] * best[2] * best[3] == 0
            && best[0] != best[1] && best[1] != best[2] && best[2] != best[3]);
        LAW("the volume is their determinant",
            fabs(volume - log(fabs(determine(own, best[0], best[1], best[2])))) < 1e-10);
    }
}

/* A vector across both equations in the free joints 0, 1 and 3. */
static void cross_equations(casadi_real *across)
{
    const casadi_real *a = J, *d = J + N;
    set(across, a[1] * d[3] - a[3] * d[1], a[3] * d[0] - a[0] * d[3], 0, a[0] * d[1] - a[1] * d[0]);
}

static void corrections(void)
{
    const casadi_real g[2] = {3, -5};
    casadi_real across[N], moved[N];
    casadi_int i, k;
    int keeping;
    for (keeping = MBS_PARTITIONING; keeping <= MBS_MASS_PROJECTION; ++keeping) {
        mbs_run r = drive(2, keeping);
        r.depends[0] = 3, r.depends[1] = 0, r.last = 7;
        LAW("equations are decomposed", prepare(&r) == 0 && calls[JACOBIAN] == 1);
        LAW("with masses where these weigh", calls[MASS] == (keeping == MBS_MASS_PROJECTION));
        LAW("and their least pivot", r.last > 0.1 && r.last < 1);
        correct(&r, g);
        for (i = 0; i < 2; ++i)
            LAW("a correction takes away what is open", near_by(total(J + N * i, r.x), -g[i]));
        LAW("driven joints have none", r.x[2] == 0);
        cross_equations(across);
        for (i = 0; i < N; ++i)
            for (k = 0, moved[i] = 0; k < N; ++k)
                moved[i] += mass[N * i + k] * r.x[k];
        if (keeping == MBS_PARTITIONING)
            LAW("independent joints neither", r.x[1] == 0);
        else
            LAW("it is the least", fabs(total(across, keeping == MBS_PROJECTION ? r.x : moved)) < 1e-12);
        fails[JACOBIAN] = calls[JACOBIAN] + 1;
        LAW("a kernel that fails is named", prepare(&r) == 11 + JACOBIAN);
        fails[MASS] = calls[MASS] + 1;
        LAW("as that of masses", prepare(&r) == (keeping == MBS_MASS_PROJECTION ? 11 + MASS : 0));
    }
    for (keeping = 0; keeping < 2; ++keeping) {
        mbs_run r = anew(2, MBS_PARTITIONING);
        memset(line, 0, sizeof line), line[0] = 1, line[N + 1] = keeping ? 1.01e-8 : 0.99e-8;
        r.depends[0] = 0, r.depends[1] = 1;
        LAW("dependent equations cannot be closed", prepare(&r) == (keeping ? 0 : MBS_DEPENDENT));
        LAW("which names a loop", keeping || outcome.loop == 4);
        r = anew(2, MBS_PROJECTION);
        memset(line, 0, sizeof line), line[0] = 1, line[N + 1] = keeping ? 1.01e-8 : 0.99e-8;
        LAW("least corrections leave one out", prepare(&r) == 0 && r.least.rank == 1 + keeping);
    }
}

static void masses(void)
{
    casadi_int i, j, k;
    mbs_run r = drive(1, MBS_PROJECTION);
    LAW("masses of free joints are decomposed", factorise_mass(&r) == 0);
    for (i = 0; i < 3; ++i)
        for (j = 0; j <= i; ++j) {
            casadi_real sum = 0;
            for (k = 0; k <= j; ++k)
                sum += r.M[3 * i + k] * r.M[3 * j + k];
            LAW("as a square", near_by(sum, mass[N * r.moves[i] + r.moves[j]]));
        }
    mass[15] = 0;
    LAW("a joint without mass is named by its number", factorise_mass(&r) == 4);
    mass[0] = -1;
    LAW("the first of them", factorise_mass(&r) == 1);
    fails[MASS] = 4;
    LAW("or the kernel", factorise_mass(&r) == 11 + MASS);
    r = anew(1, MBS_PROJECTION);
    LAW("all joints may be free", factorise_mass(&r) == 0 && r.M[0] == 2 && near_by(r.M[N], 0.5));
}

static void reading(void)
{
    static const casadi_real times[2] = {0, 1}, lengths[2] = {0.5, 0.25}, starts[4 * N + 2] = {0};
    casadi_real ends[4 * N + 2];
    mbs_run r = anew(1, MBS_PROJECTION);
    (void)r;
    fails[JACOBIAN] = 1;
    mbs_explicit_read(&plant, &manner, 2, times, lengths, NULL, NULL, starts, ends, room, numbers, &outcome);
    LAW("a part begins with its loops", outcome.status == 11 + JACOBIAN && calls[RESIDUAL] == 0 && calls[MASS] == 0);
}

static void renewals(void)
{
    mbs_run r = anew(0, MBS_PARTITIONING);
    LAW("without loops nothing is renewed", renew(&r) == 0 && calls[JACOBIAN] == 0);
    r = anew(1, MBS_BAUMGARTE);
    LAW("nor where loops stay open", renew(&r) == 0 && calls[JACOBIAN] == 0 && !r.is_ready);
    r = anew(1, MBS_PROJECTION);
    LAW("equations are decomposed at the start", renew(&r) == 0 && calls[JACOBIAN] == 1 && r.is_ready == 1);
    LAW("alone", renew(&r) == 0 && calls[JACOBIAN] == 1);
    r = anew(1, MBS_PROJECTION);
    fails[JACOBIAN] = 1;
    LAW("by a kernel that may fail", renew(&r) == 11 + JACOBIAN);
    r = anew(1, MBS_PARTITIONING);
    set(line, 1, 0.75, 0, 0);
    LAW("dependent joints are chosen", renew(&r) == 0 && r.depends[0] == 0 && outcome.switches == 0 && r.is_ready == 1);
    set(line, 0.505, 1, 0, 0);
    LAW("they stay while they have half of the best determinant",
        renew(&r) == 0 && r.depends[0] == 0 && calls[JACOBIAN] == 2);
    set(line, 0.495, 1, 0, 0);
    LAW("and then are others", renew(&r) == 0 && r.depends[0] == 1 && outcome.switches == 1);
    set(line, 1, 0, 0, 0);
    LAW("also where they have none", renew(&r) == 0 && r.depends[0] == 0 && outcome.switches == 2);
    set(line, 0, 0, 0, 0);
    LAW("equations without joints cannot be closed", renew(&r) == MBS_DEPENDENT && outcome.loop == 4);
    fails[JACOBIAN] = calls[JACOBIAN] + 1;
    LAW("a kernel that fails is named", renew(&r) == 11 + JACOBIAN);
    r = anew(2, MBS_PARTITIONING);
    memset(line, 0, sizeof line), line[1] = 1, line[N + 3] = 1e-7;
    LAW("all dependent joints are chosen", renew(&r) == 0 && r.depends[0] == 1 && r.depends[1] == 3);
    line[N + 3] = 0.99e-8;
    LAW("which depend on each other where a pivot is lost", renew(&r) == MBS_DEPENDENT);
    line[N + 3] = 1.01e-8;
    LAW("but not before", renew(&r) == 0);
}

static void moves(void)
{
    mbs_run r = anew(1, MBS_PROJECTION);
    set(q, 1, 2, 3, 4), set(qd, 5, 6, 7, 8), set(r.x, 0.5, -1, 2, 3);
    LAW("coordinates move along velocities", move(&r) == 0 && q[0] == 1.5 && q[1] == 1 && q[2] == 5 && q[3] == 7);
    plant.change.f = change, plant.nq = 5;
    r = open_here();
    set(q, 1, 2, 3, 4), q[4] = 5, set(qd, 5, 6, 7, 8), set(r.x, 0.5, -1, 2, 3), r.sum[0] = 9;
    LAW("or by their rates", move(&r) == 0 && q[0] == 2 && q[1] == 0 && q[2] == 7 && q[3] == 10 && q[4] == 8.5);
    LAW("and velocities stay", qd[0] == 5 && qd[1] == 6 && qd[2] == 7 && qd[3] == 8 && r.sum[0] == 9);
    fails[CHANGE] = 2;
    LAW("a kernel that fails moves nothing", move(&r) == 11 + CHANGE && q[0] == 2 && qd[0] == 5);
}

/* One equation q0 = offset, of which only the size counts. */
static mbs_run open_gap(casadi_real at, casadi_real gap)
{
    mbs_run r = anew(1, MBS_PROJECTION);
    set(line, 1, 0, 0, 0), q[0] = at, offset[0] = at + gap;
    return r;
}

static void closings(void)
{
    casadi_real way = 7;
    int k;
    mbs_run r = open_gap(0, 0.25);
    LAW("a gap is closed", close_coordinates(&r, &way) == 0 && q[0] == 0.25 && r.gap == 0.25);
    LAW("a second look shows it", calls[CLOSURE] == 2 && calls[JACOBIAN] == 1 && way == 0.25);
    for (k = 0; k < 4; ++k) { /* ten times the square of a change is its error, beside 1 + |q| */
        const casadi_real at = k < 2 ? 0 : 999, part = k % 2 ? 1.05e-8 : 0.95e-8;
        r = open_gap(at, part * sqrt(1 + at));
        LAW("small changes need no look", close_coordinates(&r, &way) == 0 && calls[CLOSURE] == (k % 2 ? 2 : 1));
    }
    r = open_gap(0, 0.25), wrong = 0.1;
    LAW("equations are kept while changes shrink to a tenth", close_coordinates(&r, &way) == 0 && calls[JACOBIAN] == 1);
    LAW("until they are rounding", fabs(q[0] - 0.25) < 2e-15 && calls[CLOSURE] > 10 && fabs(way - 0.25) < 1e-14);
    r = open_gap(0, 0.25), wrong = 0.15;
    LAW("and are decomposed anew else", close_coordinates(&r, &way) == 0 && calls[JACOBIAN] == calls[CLOSURE] - 1);
    LAW("from where the way counts", fabs(q[0] - 0.25) < 2e-9 && way < 2e-8 && way > 0);
    for (k = 0; k < 2; ++k) {
        r = open_gap(0, 0.25), noise = 1.25 * (k ? 0.52e-11 : 0.48e-11); /* twice as much each time, of 1.25 */
        LAW("noise ends a closing",
            close_coordinates(&r, &way) == 0 && calls[CLOSURE] == 3 + k && calls[JACOBIAN] == 1 + k);
    }
    r = open_gap(0, 0.25), noise = 1e-3;
    LAW("or it fails", close_coordinates(&r, &way) == MBS_OPEN && calls[CLOSURE] == 25 && outcome.loop == 4);
    r = open_gap(0, NAN);
    LAW("what is no number cannot be closed", close_coordinates(&r, &way) == MBS_OPEN && calls[CLOSURE] == 1);
    r = open_gap(0, 0.25), fails[CLOSURE] = 2;
    LAW("a kernel that fails is named", close_coordinates(&r, &way) == 11 + CLOSURE);
    r = open_gap(0, 0.25), fails[JACOBIAN] = 1;
    LAW("at the start", close_coordinates(&r, &way) == 11 + JACOBIAN && calls[CLOSURE] == 0);
    r = open_gap(0, 0.25), fails[JACOBIAN] = 2, wrong = 0.5;
    LAW("and later", close_coordinates(&r, &way) == 11 + JACOBIAN && calls[CLOSURE] == 2);
    r = open_gap(0, 0.25), plant.change.f = change, fails[CHANGE] = 1;
    LAW("and where it moves", close_coordinates(&r, &way) == 11 + CHANGE && calls[CLOSURE] == 1);
    r = anew(2, MBS_MASS_PROJECTION);
    curve[0] = 1, offset[0] = 8, offset[1] = -3, set(q, 2, 1, -1, 0.5);
    LAW("two loops are closed together", close_coordinates(&r, &way) == 0 && find_gaps(0, 0, 0, 0, 0) == 0);
    LAW("to rounding", fabs(h[0]) < 1e-14 && fabs(h[1]) < 1e-14);
}

static void speeds(void)
{
    int k;
    mbs_run r = open_gap(0, 0);
    qd[0] = 0.25, qd[1] = 3;
    prepare(&r);
    LAW("rates are closed", close_velocities(&r, 1e-3) == 0 && qd[0] == 0 && qd[1] == 3);
    LAW("with equations of nearby", calls[JACOBIAN] == 1 && calls[RATES] == 2);
    qd[0] = 0.25;
    LAW("or else anew", close_velocities(&r, 1.1e-3) == 0 && calls[JACOBIAN] == 2 && calls[RATES] == 4);
    for (k = 0; k < 4; ++k) {
        r = open_gap(0, 0), prepare(&r), qd[0] = k % 2 ? 1.05e-11 : 0.95e-11, qd[1] = k < 2 ? 0 : 999;
        qd[0] *= 1 + qd[1];
        LAW("small changes need no look", close_velocities(&r, 1e-5) == 0 && calls[RATES] == (k % 2 ? 2 : 1));
    }
    r = open_gap(0, 0), prepare(&r), qd[0] = 0.9e-15;
    LAW("nor do roundings", close_velocities(&r, 1e-3) == 0 && calls[RATES] == 1);
    r = open_gap(0, 0), wrong = 0.08, prepare(&r), qd[0] = 0.25;
    LAW("equations are kept while changes shrink to a tenth", close_velocities(&r, 1e-3) == 0 && calls[JACOBIAN] == 1);
    LAW("until they are rounding", fabs(qd[0]) < 1e-14 && calls[RATES] > 9);
    r = open_gap(0, 0), wrong = 0.125, prepare(&r), qd[0] = 0.25;
    LAW("and are decomposed anew else", close_velocities(&r, 1e-3) == 0 && calls[JACOBIAN] == calls[RATES] - 1);
    for (k = 0; k < 2; ++k) {
        r = open_gap(0, 0), prepare(&r), noise = k ? 1.05e-11 : 0.95e-11;
        noise /= 2;
        LAW("noise ends a closing", (close_velocities(&r, 1e-3) == 0) == !k && calls[RATES] == (k ? 25 : 2));
        LAW("or it fails", k == 0 || outcome.loop == 4);
    }
    r = open_gap(0, 0), prepare(&r), qd[0] = NAN;
    LAW("what is no number cannot be closed", close_velocities(&r, 0) == MBS_OPEN && calls[RATES] == 1);
    r = open_gap(0, 0), prepare(&r), qd[0] = 1, fails[RATES] = 2;
    LAW("a kernel that fails is named", close_velocities(&r, 1e-3) == 11 + RATES);
    r = open_gap(0, 0), prepare(&r), fails[JACOBIAN] = 2;
    LAW("at the start", close_velocities(&r, 1) == 11 + JACOBIAN && calls[RATES] == 0);
    r = open_gap(0, 0), wrong = 0.5, prepare(&r), qd[0] = 1, fails[JACOBIAN] = 2;
    LAW("and later", close_velocities(&r, 1e-3) == 11 + JACOBIAN && calls[RATES] == 2);
    r = open_gap(0, 0.25), qd[0] = 1;
    LAW("coordinates and rates are closed", restore(&r) == 0 && q[0] == 0.25 && qd[0] == 0);
    r = open_gap(0, 0.25), fails[CLOSURE] = 1;
    LAW("or not", restore(&r) == 11 + CLOSURE && calls[RATES] == 0);
}

static void courses(void)
{
    static const casadi_int two[2] = {0, 3};
    const casadi_real rows[12] = {0, 0, 0, 0, 0, 0, 1, 2, 3, 4, 5, 6}, many[12] = {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11,
        12};
    casadi_real six[6];
    mbs_run r = drive(0, MBS_PROJECTION);
    LAW("joints are driven by a function",
        guide(&r, 0.5, 1) == 0 && q[2] == 10.5 && qd[2] == 20.5 && q[0] == 0 && q[1] == 0);
    fails[GUIDE] = 2;
    LAW("which may stop a run", guide(&r, 0.5, 1) == MBS_STOPPED);
    r.courses = rows, r.row_of_step = 2;
    LAW("or by rows", guide(&r, 0.5, 1) == 0 && q[2] == 4 && qd[2] == 5 && course[2] == 6 && calls[GUIDE] == 2);
    LAW("of a stage", guide(&r, 0.5, 0) == 0 && q[2] == 1 && course[2] == 3);
    anew(0, MBS_PROJECTION);
    plant.d = 2, plant.driven = plant.place = two, plant.course = six;
    r = open_here(), r.courses = many, r.row_of_step = 1;
    LAW("rows have all driven joints",
        guide(&r, 0.5, 0) == 0 && q[0] == 7 && q[3] == 8 && qd[0] == 9 && qd[3] == 10 && six[5] == 12);
    r = drive(0, MBS_PROJECTION);
    manner.guide = 0, course[0] = 7, course[1] = 8;
    LAW("or stay", guide(&r, 0.5, 1) == 0 && q[2] == 7 && qd[2] == 8);
}

/* Accelerations of joints with two loops: forces beyond M qdd are along the equations. */
static void accelerations(void)
{
    casadi_real across[N], sum[N], scale;
    casadi_int i, k, d;
    int keeping, which;
    for (keeping = MBS_PROJECTION; keeping <= MBS_BAUMGARTE; ++keeping)
        for (d = 0; d < 2; ++d) {
            mbs_run r = d ? drive(2, keeping) : anew(2, keeping);
            manner.alpha = 3, manner.beta = 5, curve[0] = 1, curve[1] = -0.5, set(q, 0.5, -1, 2, 1), set(qd, 1, -2,
                0.5, 3);
            set(push, 1, 2, 3, 4), plant.modes = &modes, torque[1] = 0.75, sign[1] = -1, set(rest, 9, 9, 9, 9);
            r = open_here(), course[2] = 6;
            LAW("accelerations are found", solve(&r) == 0);
            if (d)
                LAW("of driven joints by their course", r.x[2] == 6);
            find_gaps(0, 0, 0, 0, 0), find_rates(0, 0, 0, 0, 0);
            for (i = 0; i < 2; ++i)
                LAW("they go along loops", near_by(total(J + N * i, r.x), -gamma_of[i]
                    - (keeping == MBS_BAUMGARTE ? 6 * hd[i] + 25 * h[i] : 0)));
            for (i = 0; i < N; ++i)
                for (k = 0, sum[i] = -push[i] - (i == 1 ? 0.75 : 0); k < N; ++k)
                    sum[i] += mass[N * i + k] * r.x[k];
            if (d) {
                cross_equations(across);
                LAW("forces of loops are along the equations", fabs(total(across, sum)) < 1e-12);
            } else
                for (which = 0; which < 4; ++which) { /* three joints at a time */
                    const casadi_int a = which == 0, m = which < 2 ? 2 : 1, z = which == 3 ? 2 : 3;
                    LAW("in all joints", fabs(sum[a] * (J[m] * J[N + z] - J[z] * J[N + m])
                        - sum[m] * (J[a] * J[N + z] - J[z] * J[N + a]) + sum[z] * (J[a] * J[N + m] - J[m] * J[N + a])) < 1e-11);
                }
        }
    for (which = RESIDUAL; which <= JACOBIAN; ++which) {
        mbs_run r = anew(1, MBS_BAUMGARTE);
        fails[which] = 1;
        LAW("a kernel that fails is named", solve(&r) == 11 + which);
    }
    for (which = 0; which < 2; ++which)
        for (k = 0; k < 2; ++k) { /* two equations of one left side: 1 + scale is 2 or 101 */
            mbs_run r = anew(2, MBS_BAUMGARTE);
            memcpy(line + N, line, N * sizeof *line), manner.beta = 1, scale = k ? 100 : 1;
            offset[0] = scale, offset[1] = scale - (which ? 1.02e-6 : 0.98e-6) * (1 + scale);
            LAW("equations that contradict each other have no accelerations", solve(&r) == (which ? MBS_DEPENDENT : 0));
            LAW("which names the loop", !which || outcome.loop == 4);
        }
}

static void choices_of_ways(void)
{
    casadi_real rate[9];
    mbs_run r;
    int k;
    for (k = 0; k < 6; ++k) {
        anew(1, k == 2 ? MBS_BAUMGARTE : MBS_PROJECTION);
        plant.direct.f = k == 1 ? 0 : find_accelerations, plant.modes = k == 3 ? &modes : 0;
        r = open_here(), r.last = k == 4 ? 0.99e-4 : k == 5 ? 1.01e-4 : 1, set(qdd, 5, 6, 7, 8), set(qd, 1, 2, 3, 4);
        LAW("accelerations are found",
            accelerate(&r, rate) == 0 && outcome.evaluations == 1 && rate[0] == 1 && rate[3] == 4);
        LAW("by their own kernel where it may be asked",
            calls[DIRECT] == (k == 0 || k == 5) && calls[MASS] == !(k == 0 || k == 5));
        LAW("which is taken", (rate[4] == 5 && rate[7] == 8) == (k == 0 || k == 5));
    }
    for (k = 0; k < 4; ++k) { /* status 11, of eleven joints or fewer */
        anew(k % 2, MBS_PROJECTION);
        plant.direct.f = find_accelerations, fails[DIRECT] = 1;
        r = open_here();
        if (k > 1)
            plant.n = 11;
        LAW("a kernel that fails otherwise than by a mass is asked no more",
            (k == 1 ? accelerate(&r, rate) == 0 : accelerate(&r, rate) == 11) && calls[MASS] == (k == 1));
    }
    anew(1, MBS_PROJECTION);
    plant.change.f = change, plant.nq = 5;
    r = open_here(), set(qd, 1, 2, 3, 4);
    LAW("coordinates may have rates", accelerate(&r, rate) == 0 && rate[0] == 2 && rate[3] == 8 && rate[4] == 5);
    LAW("beside accelerations",
        near_by(line[0] * rate[5] + line[1] * rate[6] + line[2] * rate[7] + line[3] * rate[8], 0));
    fails[CHANGE] = 2;
    LAW("of a kernel that may fail", accelerate(&r, rate) == 11 + CHANGE);
    fails[RESIDUAL] = calls[RESIDUAL] + 1;
    LAW("as others", accelerate(&r, rate) == 11 + RESIDUAL);
}

static void states(void)
{
    const casadi_real y[9] = {1, 2, 3, 4, 5, 6, 7, 8, 9}, weights[2] = {2, 0.5};
    casadi_real z[10] = {0, 0, 0, 0, 0, 0, 0, 0, 0, 77};
    casadi_int k;
    mbs_run r = anew(1, MBS_PROJECTION);
    plant.nq = 5;
    r = open_here();
    lay(&r, y), take(&r, z);
    LAW("a state has coordinates, then velocities", q[0] == 1 && q[4] == 5 && qd[0] == 6 && qd[3] == 9);
    for (k = 0; k < 9; ++k)
        LAW("and is read back", z[k] == y[k]);
    LAW("alone", z[9] == 77);
    for (k = 0; k < 18; ++k)
        r.k[k] = k < 9 ? 1 : 4;
    combine(&r, 2, weights, 0.5, y, z);
    LAW("stages are added by their weights", z[0] == 3 && z[8] == 11);
    combine(&r, 1, weights, 0.5, 0, z);
    LAW("from anywhere", z[0] == 1 && z[8] == 1 && z[9] == 77);
}

/* Forces of two loops on free joints 0, 1, 3: what is left on the held one is not of loops. */
static void forces(void)
{
    const casadi_real lam[2] = {2, -3};
    casadi_int i;
    mbs_run r;
    anew(2, MBS_PROJECTION);
    held[2] = 1, plant.modes = &modes, sign[1] = -1, torque[1] = 0.75;
    r = open_here();
    LAW("a held joint is not free", r.free == 3 && r.moves[2] == 3);
    find_jacobian(0, 0, 0, 0, 0);
    for (i = 0; i < N; ++i)
        left[i] = J[i] * lam[0] + J[N + i] * lam[1] + (i == 1 ? 0.75 : i == 2 ? 5 : 0);
    LAW("forces of loops are taken out", subtract_loops(&r) == 0);
    LAW("and leave what holds a joint", near_by(r.hold[2], 5) && near_by(r.hold[1], 0.75));
    LAW("and nothing else", fabs(r.hold[0]) < 1e-13 && fabs(r.hold[3]) < 1e-13);
    fails[JACOBIAN] = 3;
    LAW("a kernel that fails is named", subtract_loops(&r) == 11 + JACOBIAN);
}

static void evaluations(void)
{
    const casadi_real y[8] = {0.25, 0, 0, 0, 1, 0, 0, 0}, inputs[6] = {1, 2, 3, 4, 5, 6};
    mbs_run r;
    int k;
    for (k = 0; k < 7; ++k) {
        r = anew(k == 6 ? 0 : 1, k == 0 || k == 5 ? MBS_PARTITIONING : k == 1 ? MBS_BAUMGARTE : MBS_PROJECTION);
        set(line, 1, 0, 0, 0), r.depends[0] = 0, r.last = k == 2 ? 0.0199 : k == 3 ? 0.0201 : 0.001;
        LAW("stages are evaluated", evaluate(&r, 0, k < 5 ? 1 : k == 6, y) == 0);
        LAW("with closed loops where these depend on it", (q[0] == 0) == (k == 0 || k == 2 || k == 4));
    }
    r = anew(1, MBS_PARTITIONING);
    fails[CLOSURE] = 1;
    r.depends[0] = 0;
    LAW("loops that stay open are named", evaluate(&r, 0, 1, y) == 11 + CLOSURE);
    r = anew(0, MBS_PROJECTION);
    plant.m = 2, manner.inputs = give;
    LAW("inputs are by a function", evaluate(&r, 0.5, 1, y) == 0 && v[0] == 100.5);
    fails[INPUTS] = 2;
    LAW("which may stop a run", evaluate(&r, 0.5, 1, y) == MBS_STOPPED);
    r.inputs = inputs, r.row_of_step = 1;
    LAW("or by rows", evaluate(&r, 0.5, 1, y) == 0 && v[0] == 5 && v[1] == 6 && calls[INPUTS] == 2);
    r = drive(0, MBS_PROJECTION);
    fails[GUIDE] = 1;
    LAW("courses may stop it too", evaluate(&r, 0.5, 1, y) == MBS_STOPPED && outcome.evaluations == 0);
}

/* The end of a step: a correction of velocities by 0.1 of speeds is a jump. */
static void ends(void)
{
    casadi_real y[8] = {0.25, 0, 0, 0, 0, 0, 0, 0};
    mbs_run r = anew(0, MBS_PROJECTION);
    int k;
    q[0] = 5;
    LAW("without loops a step ends where it is", finish(&r, 0, 1, y) == 0 && q[0] == 5 && y[0] == 0.25);
    for (k = 0; k < 4; ++k) { /* the fastest is 10, or 8 + h 4 */
        r = open_gap(0, 0), memset(r.k, 0, 16 * sizeof *r.k), memset(y, 0, sizeof y);
        y[0] = 0.25, y[4] = k % 2 ? 1.01 : -0.99, y[5] = k < 2 ? -10 : 8, r.k[5] = k < 2 ? 0 : -4;
        LAW("closing a loop changes no velocity by a tenth", finish(&r, 0, 0.5, y) == (k % 2 ? MBS_BRANCHED : 0));
        LAW("but closes it",
            k % 2 ? outcome.loop == 4 && y[0] == 0.25 : y[0] == 0 && y[4] == 0 && y[5] == (k < 2 ? -10 : 8));
        LAW("and notes the gap", outcome.gap == (k % 2 ? 0 : 0.25));
        r.gap = 0.1, outcome.gap = 0.3;
    }
    r = open_gap(0, 0), memset(r.k, 0, 16 * sizeof *r.k), memset(y, 0, sizeof y), y[4] = 0.99e-10;
    LAW("rest may change by any part", finish(&r, 0, 0.5, y) == 0 && y[4] == 0);
    y[4] = 1.01e-10;
    LAW("which ends above a tenth of a nanometre", finish(&r, 0, 0.5, y) == MBS_BRANCHED);
    r = open_gap(0, 0), memset(r.k, 0, 16 * sizeof *r.k), memset(y, 0, sizeof y), y[0] = 0.25, outcome.gap = 0.5;
    LAW("the largest gap is kept", finish(&r, 0, 0.5, y) == 0 && outcome.gap == 0.5);
    r = anew(1, MBS_BAUMGARTE);
    memset(r.k, 0, 16 * sizeof *r.k), y[0] = 0.25, y[4] = 5;
    LAW("Baumgarte's method closes nothing",
        finish(&r, 0, 0.5, y) == 0 && y[0] == 0.25 && y[4] == 5 && calls[CLOSURE] == 0);
    r = drive(0, MBS_PROJECTION);
    memset(r.k, 0, 16 * sizeof *r.k), y[2] = 0, y[6] = -100;
    LAW("driven joints are where they should",
        finish(&r, 0.5, 0.5, y) == 0 && y[2] == 10.5 && y[6] == 20.5 && outcome.gap == 0);
    fails[GUIDE] = 2;
    LAW("or the run stops", finish(&r, 0.5, 0.5, y) == MBS_STOPPED);
    r = open_gap(0, 0), memset(r.k, 0, 16 * sizeof *r.k), memset(y, 0, sizeof y), y[0] = 0.25, fails[CLOSURE] = 1;
    LAW("loops that stay open are named", finish(&r, 0, 0.5, y) == 11 + CLOSURE && y[0] == 0.25);
    fails[RATES] = calls[RATES] + 2, y[0] = 0, y[4] = 1;
    LAW("as a kernel that fails while a branch is named", finish(&r, 0, 0.5, y) == 11 + RATES);
}

/* Inputs and courses are asked for at the times of stages and ends. */
static void times(void)
{
    const casadi_real x[8] = {0, 0, 0, 0, 0, 0, 0, 0};
    casadi_real y[8], h = 0, values[2];
    mbs_run r = anew(0, MBS_PROJECTION);
    manner.inputs = give, manner.guide = 0, manner.atol = 1;
    LAW("stages have their times", step(&r, 3, 0.5, x, 0, y) == 0 && asked_at[0] == 3.5 && asked_at[1] == 3);
    evaluate(&r, 3, 0, x);
    LAW("as a first guess has", begin(&r, 3, x, &h) == 0 && asked_at[0] == 3 + 1e-6);
    r = drive(0, MBS_PROJECTION);
    plant.modes = &modes;
    r = open_here();
    evaluate(&r, 3, 0, x), memcpy(r.first, r.k, 8 * sizeof *r.first);
    LAW("shorter steps end at their end",
        try_step(&r, 3, 0.5, x, values) == 0 && asked_at[0] == 3.5 && asked_at[1] == 3.5
        && asked_at[2] == 3.5 && asked_at[3] == 3);
}

/* The force that holds a joint, beside the forces of loops. */
static void holding(void)
{
    static const casadi_int kind[1] = {MBS_FORCE}, joint[1] = {2}, place[1] = {2};
    static const casadi_real side[1] = {-2}, level[1] = {3};
    const casadi_real rate[8] = {0, 0, 0, 0, 0, 0, 0, 0};
    casadi_real values[2] = {77, 77};
    mbs_run r;
    anew(2, MBS_PROJECTION);
    held[2] = 1, plant.modes = &modes, modes.guards = 1, modes.kind = kind, modes.joint = joint, modes.place = place;
    modes.side = side, modes.level = level, push[2] = 10;
    r = open_here();
    LAW("a force that holds a joint is a guard", guard(&r, rate, values) == 0 && near_by(values[0], -2 * (-10 - 3)));
    LAW("without a rate", values[1] == 0);
    fails[JACOBIAN] = 2;
    LAW("a kernel that fails is named", guard(&r, rate, values) == 11 + JACOBIAN);
    fails[RESIDUAL] = 3;
    LAW("each", guard(&r, rate, values) == 11 + RESIDUAL);
    anew(0, MBS_PROJECTION);
    held[0] = 1, plant.modes = &modes;
    r = open_here();
    LAW("a held joint rests", solve(&r) == 0 && r.x[0] == 0);
}

/* A point on a circle of radius 1 that turns by itself, by ways that keep it there. */
static void turns(void)
{
    static const casadi_real E[2] = {-1e-3, 1e-3};
    casadi_real length = 0.05, times[41], rows[41 * 8];
    int keeping, k;
    for (keeping = MBS_PARTITIONING; keeping <= MBS_BAUMGARTE; ++keeping) {
        casadi_real first = 0.05;
        anew(1, keeping);
        memset(line, 0, sizeof line), memset(mass, 0, sizeof mass), memset(rows, 0, sizeof rows);
        for (k = 0; k < N; ++k)
            mass[5 * k] = 2;
        for (k = 0; k < 11; ++k)
            times[k] = 0.05 * k;
        curve[0] = 1, offset[0] = 0.5, rows[0] = 1, rows[5] = 2, manner.alpha = manner.beta = 10;
        open_here();
        mbs_explicit_run(&plant, &manner, 0.5, &length, 10, 0, 0, times, rows, room, numbers, &outcome);
        LAW("all steps are taken", outcome.status == 0 && outcome.steps == 10);
        for (k = 1; k < 11; ++k) {
            const casadi_real *y = rows + 8 * k, open = y[0] * y[0] + y[1] * y[1] - 1, rate = y[0] * y[4] + y[1] * y[5];
            const casadi_real least = keeping == MBS_BAUMGARTE ? 5e-3 : 1e-14;
            LAW("loops stay closed", fabs(open) < least && fabs(rate) < 10 * least);
            LAW("and turn", fabs(atan2(y[1], y[0]) - 0.1 * k) < 1e-2 && y[2] == 0 && y[7] == 0);
        }
        LAW("with the gap that steps left",
            keeping == MBS_BAUMGARTE ? outcome.gap == 0 : outcome.gap > 1e-6 && outcome.gap < 1e-2);
        manner.estimates = 1, manner.E = E, manner.atol = manner.rtol = 1, manner.longest = 0.05;
        mbs_explicit_run(&plant, &manner, 0.5, &first, 40, 0, 0, times, rows, room, numbers, &outcome);
        LAW("steps that have an error end likewise", outcome.status == 0 && (keeping == MBS_BAUMGARTE || outcome.gap > 1e-6));
    }
}

int main(void)
{
    rooms(), sizes(), choices(), corrections(), masses(), reading(), renewals(), moves(), closings(), speeds(), courses();
    accelerations(), choices_of_ways(), states(), forces(), evaluations(), ends(), times(), holding(), turns();
    return broken > 0;
}
