#include "laws.h"

#include <math.h>
#include <stdlib.h>

#include "../../../csrc/mbs_dense.c"
#include "../../../csrc/mbs_radau.c"

/* --- a plant: Phi = (M + q0^2/2 1) qdd + C qd + K q - pull - v - J^T lam,
    with equations line.q + curve q.q / 2 = offset ---- */

enum { MOST = 4 };
static casadi_real q[MOST], qd[MOST], qdd[MOST], lam[2], v[2], Phi[MOST], gap[2], hd[2], noise, bent;
static casadi_real mass[MOST * MOST], damping[MOST * MOST], stiffness[MOST * MOST], pull[MOST], line[2 * MOST];
static casadi_real curve[2], offset[2], J[2 * MOST], R[2 * MOST], by_q[MOST * MOST], M[MOST * MOST], L[MOST * 2];
static casadi_int every[MOST * MOST], driven[2];
static const casadi_real A[4] = {5.0 / 12, -1.0 / 12, 0.75, 0.25}; /* at 1/3 and 1 */
static mbs_radau plant;
static int asked[3], fails[3]; /* dynamics, closure, rates: at which call they fail */

static int find_rates(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int memory)
{
    casadi_int i, k;
    (void)arg, (void)res;
    LAW("kernels have no memory", !iw && !w && !memory);
    for (i = 0; i < plant.e; ++i) {
        hd[i] = 0;
        for (k = 0; k < plant.n; ++k) {
            J[i * plant.n + k] = line[i * plant.n + k] + curve[i] * q[k];
            R[i * plant.n + k] = curve[i] * qd[k];
            hd[i] += J[i * plant.n + k] * qd[k];
        }
    }
    return ++asked[2] == fails[2] ? 13 : 0;
}

static int dynamics(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int memory)
{
    casadi_int i, k, n = plant.n;
    find_rates(arg, res, iw, w, memory), --asked[2];
    for (i = 0; i < n; ++i) {
        Phi[i] = bent * q[0] * q[0] / 2 * qdd[i] - pull[i] - (i < plant.m ? v[i] : 0) + (asked[0] / 2 % 2 ? noise : -noise);
        for (k = 0; k < n; ++k) {
            Phi[i] += mass[i * n + k] * qdd[k] + damping[i * n + k] * qd[k] + stiffness[i * n + k] * q[k];
            by_q[i * n + k] = stiffness[i * n + k] + (k == 0 ? bent * q[0] * qdd[i] : 0);
            M[i * n + k] = mass[i * n + k] + (i == k ? bent * q[0] * q[0] / 2 : 0);
        }
        for (k = 0; k < plant.e; ++k) {
            Phi[i] -= J[k * n + i] * lam[k];
            L[i * plant.e + k] = -J[k * n + i];
            by_q[i * n + i] -= curve[k] * lam[k];
        }
    }
    return ++asked[0] == fails[0] ? 11 : 0;
}

static int closure(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int memory)
{
    casadi_int i, k;
    find_rates(arg, res, iw, w, memory), --asked[2];
    for (i = 0; i < plant.e; ++i) {
        gap[i] = -offset[i];
        for (k = 0; k < plant.n; ++k)
            gap[i] += (line[i * plant.n + k] + curve[i] * q[k] / 2) * q[k];
    }
    return ++asked[1] == fails[1] ? 12 : 0;
}

static void lay(mbs_entries *to, const casadi_real *from, casadi_int count)
{
    to->nonzeros = from, to->entries = count, to->place = every;
}

static casadi_real *reals;
static casadi_int *integers;

/* Begin anew with unit masses, in a room of exactly the numbers that are asked for,
    which are none before they are written. */
static void anew(casadi_int n, casadi_int e, casadi_int d)
{
    casadi_int k;
    memset(&plant, 0, sizeof plant), memset(mass, 0, sizeof mass), memset(damping, 0, sizeof damping);
    memset(stiffness, 0, sizeof stiffness), memset(pull, 0, sizeof pull), memset(line, 0, sizeof line);
    memset(asked, 0, sizeof asked), memset(fails, 0, sizeof fails);
    noise = bent = curve[0] = curve[1] = offset[0] = offset[1] = 0;
    for (k = 0; k < MOST * MOST; ++k)
        every[k] = k;
    for (k = 0; k < n; ++k)
        mass[k * (n + 1)] = 1;
    plant.n = n, plant.e = e, plant.d = d, plant.s = 2, plant.A = A, plant.driven = driven;
    plant.q = q, plant.qd = qd, plant.qdd = qdd, plant.lam = lam, plant.v = v, plant.Phi = Phi, plant.gap = gap,
        plant.hd = hd;
    lay(&plant.K, by_q, n * n), lay(&plant.C, damping, n * n), lay(&plant.M, M, n * n), lay(&plant.L, L, n * e);
    lay(&plant.G, J, e * n), lay(&plant.R, R, e * n), lay(&plant.J, J, e * n);
    plant.dynamics.f = dynamics;
    if (e)
        plant.closure.f = closure, plant.rates.f = find_rates;
    free(reals), free(integers);
    reals = malloc((size_t)mbs_radau_reals(&plant) * sizeof *reals);
    for (k = 0; k < mbs_radau_reals(&plant); ++k)
        reals[k] = NAN;
    integers = calloc((size_t)mbs_radau_integers(&plant), sizeof *integers);
}

static int same(casadi_real a, casadi_real b)
{
    return fabs(a - b) <= 1e-13 * fmax(1, fmax(fabs(a), fabs(b)));
}

/* --- laws ------------------------------------------------------------------------------------------------------------ */

static char uses[2000];

static void use(const casadi_real *first, casadi_int size)
{
    casadi_int k;
    for (k = 0; k < size; ++k)
        ++uses[first - reals + k];
}

static void rooms(void)
{
    casadi_int k;
    int once = 1;
    mbs_work w;
    anew(3, 2, 0);
    w = open_work(&plant, 0.5, 0, reals);
    LAW("a stage has equations of motion, of loops and of their rates", w.r == 7 && w.size == 14);
    use(w.matrix, 196), use(w.right, 14), use(w.square, 4), use(w.B, 6), use(w.by_q, 21), use(w.by_v, 21);
    use(w.by_mu, 14), use(w.moving, 6);
    for (k = 0; k < 2000; ++k)
        once &= uses[k] == (k < mbs_radau_reals(&plant));
    LAW("arrays share no number, and leave none", once && mbs_radau_integers(&plant) == 14);
    LAW("coordinates are by the square of A",
        same(w.square[0], 1.0 / 9) && same(w.square[1], -1.0 / 18) && same(w.square[2],
            0.5) && fabs(w.square[3]) < 1e-16);
}

/* A plant with everything, whose last two joints may be driven. */
static void load(casadi_int d)
{
    casadi_int i;
    anew(3, 2, d);
    driven[0] = 1, driven[1] = 2, bent = 1, curve[0] = 1, curve[1] = -0.5, offset[0] = 2;
    for (i = 0; i < 6; ++i)
        line[i] = (casadi_real)(i % 4);
    for (i = 0; i < 9; ++i)
        damping[i] = (casadi_real)(i % 5) / 4, stiffness[i] = (casadi_real)(i % 7) / 2;
    for (i = 0; i < 3; ++i)
        pull[i] = (casadi_real)(i + 1);
    mass[1] = mass[3] = 0.5;
    plant.m = 1;
}

static const casadi_real q0[3] = {0.5, -1, 2}, v0[3] = {1, 0.25, -0.5}, h = 0.5, inputs[2] = {3, 5};
static const casadi_real courses[12] = {7, 6, 8, 5, 9, 4, 17, 16, 18, 15, 19, 14};
static const casadi_real z0[14] = {0.5, -1, 2, 3, -2, 0.1, 0.2, 1, 0.75, -0.5, -1, 2.5, -0.3, 0.15};

/* Positions and rates of stages by their definition; `own` is the Jacobian at the start. */
static void stand(const casadi_real *z, const casadi_real *own, casadi_real *at, casadi_real *rates)
{
    casadi_real moving[6];
    casadi_int i, j, k;
    for (i = 0; i < 2; ++i)
        for (k = 0; k < 3; ++k) {
            const casadi_int is_driven = plant.d && k > 0;
            rates[3 * i + k] = v0[k];
            for (j = 0; j < 2; ++j)
                rates[3 * i + k] += h * A[2 * i + j] * z[7 * j + k];
            if (is_driven)
                rates[3 * i + k] = courses[6 * i + 1 + k];
            moving[3 * i + k] = rates[3 * i + k];
            for (j = 0; j < 2 && !is_driven; ++j)
                moving[3 * i + k] += own[3 * j + k] * z[7 * i + 5 + j];
        }
    for (i = 0; i < 2; ++i)
        for (k = 0; k < 3; ++k) {
            at[3 * i + k] = q0[k];
            for (j = 0; j < 2; ++j)
                at[3 * i + k] += h * A[2 * i + j] * moving[3 * j + k];
            if (plant.d && k > 0)
                at[3 * i + k] = courses[6 * i + k - 1];
        }
}

/* Write the equations of both stages. */
static int write_all(mbs_work *w, const casadi_real *z, casadi_real *at, casadi_real *rates)
{
    casadi_int i;
    int status = 0;
    place(w, q0, v0, z, at, rates);
    for (i = 0; i < 2 && !status; ++i) {
        status = evaluate(w, i, z, inputs, at, rates);
        write_rows(w, i);
    }
    return status;
}

static void equations(void)
{
    casadi_real at[6], rates[6], wanted[12], own[6], right[14], matrix[196], z[14];
    const casadi_real step = 1e-5;
    casadi_int d, i, k, j;
    mbs_work w;
    for (d = 0; d < 2; ++d) {
        load(2 * d);
        w = open_work(&plant, h, courses, reals);
        LAW("loops have a correction", write_correction(&w, q0, v0) == 0);
        memcpy(q, q0, sizeof q0), find_rates(0, 0, 0, 0, 0), memcpy(own, J, sizeof own);
        for (i = 0; i < 3; ++i)
            for (k = 0; k < 2; ++k)
                LAW("along the Jacobian at the start, but for driven joints",
                    w.B[2 * i + k] == (d && i > 0 ? 0 : own[3 * k + i]));
        stand(z0, own, wanted, wanted + 6);
        LAW("equations are written", write_all(&w, z0, at, rates) == 0);
        for (i = 0; i < 6; ++i)
            LAW("stages are integrals of accelerations", same(at[i], wanted[i]) && same(rates[i], wanted[6 + i]));
        memcpy(right, w.right, sizeof right), memcpy(matrix, w.matrix, sizeof matrix);
        for (i = 0; i < 2; ++i) {
            memcpy(q, at + 3 * i, sizeof q0), memcpy(qd, rates + 3 * i, sizeof v0), memcpy(qdd, z0 + 7 * i,
                3 * sizeof *qdd);
            memcpy(lam, z0 + 7 * i + 3, sizeof lam), v[0] = inputs[i];
            if (d)
                qdd[1] = courses[6 * i + 4], qdd[2] = courses[6 * i + 5];
            dynamics(0, 0, 0, 0, 0), closure(0, 0, 0, 0, 0);
            for (k = 0; k < 3; ++k)
                LAW("motion", right[7 * i + k] == Phi[k]);
            for (k = 0; k < 2; ++k)
                LAW("loops and their rates have the size of accelerations",
                    same(right[7 * i + 3 + k], 4 * gap[k]) && same(right[7 * i + 5 + k], 2 * hd[k]));
        }
        for (j = 0; j < 14 && !d; ++j) {
            memcpy(z, z0, sizeof z);
            z[j] += step, write_all(&w, z, at, rates), memcpy(right, w.right, sizeof right);
            z[j] -= 2 * step, write_all(&w, z, at, rates);
            for (i = 0; i < 14; ++i)
                LAW("equations are differentiated",
                    fabs((right[i] - w.right[i]) / (2 * step) - matrix[14 * i + j]) < 1e-8);
        }
    }
    memcpy(w.matrix, matrix, sizeof matrix), memcpy(w.right, right, sizeof right);
    fix(&w);
    for (i = 0; i < 14; ++i) {
        LAW("accelerations of driven joints are known", w.right[i] == (i % 7 == 1 || i % 7 == 2 ? 0 : right[i]));
        for (j = 0; j < 14; ++j)
            LAW("and move nothing",
                w.matrix[14 * i + j] == (i % 7 == 1 || j % 7 == 1 || i % 7 == 2 || j % 7 == 2 ? i == j : matrix[14 * i + j]));
    }
    for (k = 0; k < 3; ++k) {
        load(0);
        w = open_work(&plant, h, courses, reals);
        write_correction(&w, q0, v0);
        asked[k] = 0, fails[k] = 2;
        LAW("a kernel that fails is named", write_all(&w, z0, at, rates) == 11 + k);
    }
    fails[2] = 0, asked[2] = 0, fails[2] = 1;
    LAW("at the start too", write_correction(&w, q0, v0) == 13);
}

static const mbs_radau_end ending = {1e-13, 1e-9, 20};

/* A force that grows with time: accelerations are linear, so velocities are exact at all stages,
    and places at the end. */
static void forces(void)
{
    const casadi_real start[2] = {2, -1}, push[4] = {1 + 6 * 0.5 / 3, 0, 1 + 6 * 0.5, 0}, weights[2] = {1, 1};
    casadi_real z[4] = {0, 0, 0, 0}, at[4], rates[4];
    anew(2, 0, 0);
    plant.m = 2, mass[0] = 2, mass[3] = 4;
    LAW("a step is made",
        mbs_radau_step(&plant, ending, 0.5, push, 0, start, start, weights, z, at, rates, reals, integers) == 2);
    LAW("by accelerations", same(z[0], 1) && same(z[2], 2) && z[1] == 0 && z[3] == 0);
    LAW("velocities are their integrals",
        same(rates[2], 2 + 0.5 * (0.5 + 3 * 0.25)) && same(rates[0], 2 + 0.5 * (0.5 / 3 + 3 * 0.25 / 9)));
    LAW("places are at the end",
        same(at[2], 2 + 2 * 0.5 + 0.5 * (0.125 + 0.125)) && same(at[3], -1.5) && same(at[1], -1 - 0.5 / 3));
}

/* A point on a circle, and a driven joint that moves another by a loop. */
static void loops(void)
{
    const casadi_real start[2] = {0.6, -0.8}, speed[2] = {0.4, 0.3}, weights[4] = {1, 1, 1, 1}, none[1] = {0};
    const casadi_real course[6] = {0.1, 0.5, 2, 0.3, 1.5, 4}, from[2] = {0, 0};
    casadi_real z[8] = {0}, at[4], rates[4];
    casadi_int turns, i;
    anew(2, 1, 0);
    curve[0] = 1, offset[0] = 0.5, pull[1] = -2;
    turns = mbs_radau_step(&plant, ending, 0.1, none, 0, start, speed, weights, z, at, rates, reals, integers);
    LAW("a step is made", turns > 2 && turns < 7);
    for (i = 0; i < 2; ++i) {
        LAW("loops are closed at each stage", same(at[2 * i] * at[2 * i] + at[2 * i + 1] * at[2 * i + 1], 1));
        LAW("and their rates", fabs(at[2 * i] * rates[2 * i] + at[2 * i + 1] * rates[2 * i + 1]) < 1e-13);
        LAW("by multipliers",
            fabs(z[4 * i] - at[2 * i] * z[4 * i + 2]) < 1e-12
            && fabs(z[4 * i + 1] + 2 - at[2 * i + 1] * z[4 * i + 2]) < 1e-12);
    }
    LAW("with energy", fabs(rates[2] * rates[2] + rates[3] * rates[3] + 4 * at[3] - 0.25 + 3.2) < 2e-5);
    anew(2, 1, 1);
    driven[0] = 0, line[0] = 2, line[1] = -1, memset(z, 0, sizeof z), z[0] = z[4] = 7; /* q1 = 2 q0 */
    turns = mbs_radau_step(&plant, ending, 0.5, none, course, from, from, weights, z, at, rates, reals, integers);
    LAW("a joint is driven", turns > 0 && at[0] == 0.1 && at[2] == 0.3 && rates[0] == 0.5 && rates[2] == 1.5);
    LAW("and others by it", same(at[1], 0.2) && same(at[3], 0.6) && same(rates[1], 1) && same(rates[3], 3));
}

/* One joint of mass 1 under a force of 2: accelerations change from 0 to 2 in both stages. */
static casadi_int step_one(casadi_real converged, casadi_real fine, casadi_int most, casadi_real weight)
{
    const casadi_real none[1] = {0}, weights[1] = {weight};
    const mbs_radau_end end = {converged, fine, most};
    casadi_real z[2] = {0, 0}, at[2], rates[2];
    anew(1, 0, 0);
    pull[0] = 2;
    return mbs_radau_step(&plant, end, 0.5, none, 0, none, none, weights, z, at, rates, reals, integers);
}

static void endings(void)
{
    const casadi_real none[3] = {0, 0, 0}, weights[3] = {0.25, 1, 1}, wrong[1] = {1.5};
    casadi_real z[6], at[6], rates[6];
    casadi_int i, k;
    mbs_radau_end end = {0, 0, 9};
    LAW("a small change ends an iteration", step_one(1.01, 0, 9, 0.5) == 1);
    LAW("by its weight",
        step_one(0.99, 0, 9, 0.5) == 2 && step_one(1.01, 0, 9, 1) == 2 && step_one(2.01, 0, 9, 1) == 1);
    LAW("noise does not end the first one", step_one(0, 3, 9, 1) == 2);
    LAW("there are as many as may be",
        step_one(0.99, 0, 2, 0.5) == 2 && step_one(0.99, 0, 1, 0.5) == 0 && step_one(9, 0, 0, 1) == 0);
    for (i = 0; i < 3; ++i) {
        anew(1, 0, 0);
        memset(z, 0, sizeof z), noise = 1, end.noise = i ? 0.51 : 0.49; /* of 2 each time */
        end.noise *= i > 1 ? 0.1 : 1;
        LAW("noise ends an iteration that shrinks no more",
            (mbs_radau_step(&plant, end, 0.5, none, 0, none, none, weights, z, at, rates, reals,
                integers) > 0) == (i == 1));
    }
    anew(1, 0, 0); /* a matrix of 1.5 masses: each change is a third of the one before, 1, 1/3, ... of 4/3 */
    memset(z, 0, sizeof z), pull[0] = 2, lay(&plant.M, wrong, 1);
    end.noise = 1, end.converged = 1e-3;
    LAW("one that shrinks goes on",
        mbs_radau_step(&plant, end, 0.5, none, 0, none, none, weights, z, at, rates, reals, integers) == 7);
    for (i = 0; i < 3; ++i) {
        anew(3, 0, 0);
        memset(z, 0, sizeof z), pull[i] = NAN;
        LAW("no number is no step",
            mbs_radau_step(&plant, ending, 0.5, none, 0, none, none, weights, z, at, rates, reals, integers) == 0);
    }
    anew(1, 0, 0);
    memset(z, 0, sizeof z), mass[0] = 0;
    LAW("nor is a singular matrix",
        mbs_radau_step(&plant, ending, 0.5, none, 0, none, none, weights, z, at, rates, reals, integers) == 0);
    for (k = 1; k < 6; ++k) {
        anew(1, 0, 0);
        memset(z, 0, sizeof z), pull[0] = 2, fails[0] = (int)k;
        LAW("nor a kernel that fails",
            (mbs_radau_step(&plant, ending, 0.5, none, 0, none, none, weights, z, at, rates, reals,
                integers) == 0) == (k < 5));
    }
    anew(2, 1, 0);
    memset(z, 0, sizeof z), fails[2] = 1, line[0] = 1;
    LAW("at the start too",
        mbs_radau_step(&plant, ending, 0.5, none, 0, none, none, weights, z, at, rates, reals, integers) == 0
        && asked[0] == 0);
}

int main(void)
{
    rooms(), equations(), forces(), loops(), endings();
    return broken > 0;
}
