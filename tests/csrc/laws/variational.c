#include "laws.h"

#include <math.h>
#include <stdlib.h>

#include "../../../csrc/mbs_dense.c"
#include "../../../csrc/mbs_variational.c"

/* --- plants of any mass matrix M(q),
    at most quadratic in q: energies and forces follow ------------------------------ */

enum { MOST = 8 };
static casadi_real q[MOST], qd[MOST], qdd[MOST], v[2], Phi[MOST], gap[2], noise, weak, fastest, moving;
static casadi_real masses[MOST * MOST], stiff[MOST * MOST], damped[MOST * MOST], loops[2 * MOST], rates[MOST * MOST];
static casadi_real damping[MOST * MOST], stiffness[MOST * MOST], pull[MOST], curve[2], line[2 * MOST], offset[2];
static casadi_int every[MOST * MOST];
static mbs_attitude attitude[1];
static mbs_variational plant;
static void (*find_mass)(const casadi_real *at, casadi_real *M);
static int evaluated, asked[4], fails[4]; /* dynamics, change, closure, jacobian: at which call they fail */
static const mbs_variational_end ending = {1e-14, 1e-10, 20};

/* The rates of q by velocities, nq x n. */
static void find_rates(const casadi_real *at, casadi_real *N)
{
    casadi_int i, k;
    memset(N, 0, (size_t)(plant.nq * plant.n) * sizeof *N);
    for (k = 0; k < plant.scalars; ++k)
        N[plant.place[k] * plant.n + plant.rate[k]] = 1;
    for (k = 0; k < plant.attitudes; ++k)
        for (i = 0; i < 3; ++i) {
            const mbs_attitude a = attitude[k];
            casadi_real axis[3] = {0, 0, 0}, seen[3] = {0, 0, 0};
            casadi_int j;
            axis[i] = 1;
            add_cross(0.5, at + a.first, axis, seen);
            for (j = 0; j < 3; ++j)
                N[(a.first + j) * plant.n + a.spin + i] = seen[j] + at[a.first + 3] / 2 * axis[j];
            N[(a.first + 3) * plant.n + a.spin + i] = -at[a.first + i] / 2;
            rotate(at + a.first, axis);
            for (j = 0; j < 3 && a.is_free; ++j)
                N[(a.first - 3 + j) * plant.n + a.spin - 3 + i] = axis[j];
        }
}

/* d(M(q) x) / dq, n x nq: central differences of a square are exact. */
static void find_stiff(const casadi_real *x, casadi_real *K)
{
    casadi_real at[MOST], M[MOST * MOST];
    casadi_int i, j, k, side;
    memset(K, 0, (size_t)(plant.n * plant.nq) * sizeof *K);
    for (j = 0; j < plant.nq; ++j)
        for (side = -1; side < 2; side += 2) {
            memcpy(at, q, sizeof at);
            at[j] += (casadi_real)side;
            find_mass(at, M);
            for (i = 0; i < plant.n; ++i)
                for (k = 0; k < plant.n; ++k)
                    K[i * plant.nq + j] += (casadi_real)side * M[i * plant.n + k] * x[k] / 2;
        }
}

/* d(M x) along motions, n x n. */
static void find_along(const casadi_real *x, casadi_real *B)
{
    casadi_real K[MOST * MOST], N[MOST * MOST];
    find_stiff(x, K), find_rates(q, N);
    multiply(plant.n, plant.nq, plant.n, K, N, B);
}

/* Forces that are not of inertia. */
static casadi_real force(casadi_int i, const casadi_real *at, const casadi_real *w)
{
    casadi_real sum = pull[i] + (i < plant.m ? v[i] : 0);
    casadi_int k;
    for (k = 0; k < plant.n; ++k)
        sum -= damping[i * plant.n + k] * w[k];
    for (k = 0; k < plant.nq; ++k)
        sum -= stiffness[i * plant.nq + k] * at[k];
    return sum;
}

/* Phi by Euler and Poincare: d(M w)/dt and turns of momenta, less the energy's derivative and forces. */
static void find_forces(const casadi_real *w, casadi_real *to)
{
    casadi_real M[MOST * MOST], B[MOST * MOST], p[MOST];
    casadi_int i, k;
    find_mass(q, M), find_along(w, B);
    for (i = 0; i < plant.n; ++i) {
        to[i] = -force(i, q, w), p[i] = 0;
        for (k = 0; k < plant.n; ++k) {
            to[i] += M[i * plant.n + k] * qdd[k] + (B[i * plant.n + k] - B[k * plant.n + i] / 2) * w[k];
            p[i] += M[i * plant.n + k] * w[k];
        }
    }
    for (k = 0; k < plant.attitudes; ++k) {
        const casadi_int spin = attitude[k].spin;
        add_cross(1, w + spin, p + spin, to + spin);
        if (attitude[k].is_free) {
            add_cross(1, w + spin, p + spin - 3, to + spin - 3);
            add_cross(1, w + spin - 3, p + spin - 3, to + spin);
        }
    }
}

static int dynamics(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int memory)
{
    casadi_real at[MOST], side[MOST];
    casadi_int i, j;
    (void)arg, (void)res;
    LAW("kernels have no memory", !iw && !w && !memory);
    find_mass(q, masses), find_stiff(qdd, stiff), find_forces(qd, Phi);
    for (i = 0; i < plant.n; ++i)
        for (j = 0; j < plant.nq; ++j)
            stiff[i * plant.nq + j] += stiffness[i * plant.nq + j];
    for (j = 0; j < plant.n; ++j) {
        memcpy(at, qd, sizeof at);
        at[j] += 1, find_forces(at, side);
        for (i = 0; i < plant.n; ++i)
            damped[i * plant.n + j] = side[i] / 2;
        at[j] -= 2, find_forces(at, side);
        for (i = 0; i < plant.n; ++i)
            damped[i * plant.n + j] -= side[i] / 2;
    }
    ++evaluated;
    for (i = 0, moving = 0; i < plant.n; ++i)
        moving = fmax(moving, fabs(qd[i]));
    fastest = fmax(fastest, moving);
    for (i = 0; i < plant.n; ++i)
        Phi[i] += evaluated / 6 % 2 ? noise : -noise;
    return ++asked[0] == fails[0] ? 11 : 0;
}

static int change(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int memory)
{
    (void)arg, (void)res;
    LAW("kernels have no memory", !iw && !w && !memory);
    find_rates(q, rates);
    return ++asked[1] == fails[1] ? 12 : 0;
}

/* Equations line.q + curve q.q / 2 = offset, of all coordinates. */
static int closure(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int memory)
{
    casadi_int i, k;
    (void)arg, (void)res;
    LAW("kernels have no memory", !iw && !w && !memory);
    for (i = 0; i < plant.e; ++i) {
        gap[i] = -offset[i];
        for (k = 0; k < plant.nq; ++k)
            gap[i] += line[i * plant.nq + k] * q[k] + curve[i] * q[k] * q[k] / 2;
    }
    return ++asked[2] == fails[2] ? 13 : 0;
}

static int jacobian(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int memory)
{
    casadi_real N[MOST * MOST], by_q[MOST];
    casadi_int i, k;
    (void)arg, (void)res;
    LAW("kernels have no memory", !iw && !w && !memory);
    find_rates(q, N);
    for (i = 0; i < plant.e; ++i) {
        for (k = 0; k < plant.nq; ++k)
            by_q[k] = line[i * plant.nq + k] + curve[i] * q[k];
        multiply(1, plant.nq, plant.n, by_q, N, loops + i * plant.n);
    }
    return ++asked[3] == fails[3] ? 14 : 0;
}

static void lay(mbs_entries *to, const casadi_real *from, casadi_int count)
{
    to->nonzeros = from, to->entries = count, to->place = every;
}

static void anew(casadi_int n, casadi_int nq, casadi_int e, void (*mass)(const casadi_real *, casadi_real *))
{
    casadi_int k;
    memset(&plant, 0, sizeof plant), memset(q, 0, sizeof q), memset(damping, 0, sizeof damping);
    memset(stiffness, 0, sizeof stiffness), memset(pull, 0, sizeof pull), memset(line, 0, sizeof line);
    memset(asked, 0, sizeof asked), memset(fails, 0, sizeof fails);
    noise = 0, weak = 1, evaluated = 0, curve[0] = curve[1] = offset[0] = offset[1] = 0;
    for (k = 0; k < MOST * MOST; ++k)
        every[k] = k;
    find_mass = mass;
    plant.n = n, plant.nq = nq, plant.e = e, plant.q = q, plant.qd = qd, plant.qdd = qdd, plant.v = v;
    plant.Phi = Phi, plant.gap = gap;
    lay(&plant.K, stiff, n * nq), lay(&plant.C, damped, n * n), lay(&plant.M, masses, n * n);
    lay(&plant.J, loops, e * n), lay(&plant.N, rates, nq * n);
    plant.dynamics.f = dynamics, plant.scalars = n, plant.place = plant.rate = every, plant.attitude = attitude;
    if (e)
        plant.closure.f = closure, plant.jacobian.f = jacobian;
}

static casadi_real *reals;
static casadi_int *integers;

/* Open the work of a step in a room of exactly the numbers that are asked for,
    which are none before they are written. */
static mbs_work open_here(casadi_real h)
{
    casadi_int k;
    free(reals), free(integers);
    reals = malloc((size_t)mbs_variational_reals(&plant) * sizeof *reals);
    for (k = 0; k < mbs_variational_reals(&plant); ++k)
        reals[k] = NAN;
    integers = calloc((size_t)mbs_variational_integers(&plant), sizeof *integers);
    return open_work(&plant, h, reals, integers);
}

static casadi_int run(casadi_real h, casadi_int steps, const casadi_real *inputs, casadi_real *states,
                      casadi_real *speeds, casadi_real *guess, casadi_int *iterations)
{
    open_here(h);
    return mbs_variational_run(&plant, ending, h, steps, inputs, plant.m, states, speeds, guess, iterations, reals,
        integers);
}

static void unit(const casadi_real *at, casadi_real *M)
{
    casadi_int k;
    (void)at;
    for (k = 0; k < plant.n * plant.n; ++k)
        M[k] = k % (plant.n + 1) == 0 ? 2 : 0;
}

static casadi_int hole;

/* An entry that is no number. */
static void unknown(const casadi_real *at, casadi_real *M)
{
    unit(at, M);
    M[hole] = NAN;
}

/* A point of mass 2 in polar coordinates. */
static void polar(const casadi_real *at, casadi_real *M)
{
    M[0] = 2, M[1] = M[2] = 0, M[3] = 2 * at[0] * at[0];
}

/* A slider and a free body whose centre is not its origin, coupled by the body's attitude. */
static void body(const casadi_real *at, casadi_real *M)
{
    static const casadi_real m = 3, c[3] = {0.25, -0.5, 0.125}, inertia[9] = {3, 0.25, 0.5, 0.25, 4, -0.125, 0.5,
        -0.125, 5};
    const casadi_real *u = at + 4, s = at[7], a[3] = {0.5, -0.25, 0.75};
    casadi_int i, j;
    memset(M, 0, 49 * sizeof *M);
    M[0] = 4 + at[0] * at[0] / 4;
    for (i = 0; i < 3; ++i) {
        M[(1 + i) * 8] = m;
        for (j = 0; j < 3; ++j)
            M[(4 + i) * 7 + 4 + j] = inertia[3 * i + j];
    }
    add_tilde(m, c, 7, M + 4 * 7 + 1), add_tilde(-m, c, 7, M + 7 + 4);
    for (i = 0; i < 3; ++i) { /* R^T a of a quaternion of any length */
        const casadi_int k = (i + 1) % 3, l = (i + 2) % 3;
        const casadi_real seen = (s * s - dot(u, u)) * a[i] + 2 * u[i] * dot(u,
            a) - 2 * s * (u[k] * a[l] - u[l] * a[k]);
        M[4 + i] = M[(4 + i) * 7] = weak * seen;
    }
}

static void free_body(void)
{
    static const casadi_int slider[1] = {0};
    anew(7, 8, 0, body);
    attitude[0].first = 4, attitude[0].spin = 4, attitude[0].is_free = 1;
    plant.attitudes = plant.scalars = 1, plant.place = plant.rate = slider, plant.change.f = change;
}

/* A ball joint alone, whose body has three moments of inertia. */
static void top(const casadi_real *at, casadi_real *M)
{
    (void)at;
    memset(M, 0, 9 * sizeof *M);
    M[0] = 1, M[4] = 2, M[8] = 2.5;
}

static void ball(void)
{
    anew(3, 4, 0, top);
    attitude[0].first = 0, attitude[0].spin = 0, attitude[0].is_free = 0;
    plant.attitudes = 1, plant.scalars = 0, plant.change.f = change;
}

static int same(casadi_real a, casadi_real b)
{
    return fabs(a - b) <= 1e-13 * fmax(1, fmax(fabs(a), fabs(b)));
}

static casadi_real total(casadi_int size, const casadi_real *a, const casadi_real *b)
{
    casadi_real sum = 0;
    casadi_int k;
    for (k = 0; k < size; ++k)
        sum += a[k] * b[k];
    return sum;
}

static casadi_real differ(casadi_int size, const casadi_real *a, const casadi_real *b)
{
    casadi_real most = 0;
    casadi_int k;
    for (k = 0; k < size; ++k)
        most = a[k] - b[k] == a[k] - b[k] ? fmax(most, fabs(a[k] - b[k])) : INFINITY;
    return most;
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
    anew(3, 5, 2, unit);
    w = open_here(0.5);
    use(w.near.q, 5), use(w.near.M, 9), use(w.near.B, 9), use(w.near.gap, 2), use(w.near.J, 6);
    use(w.far.q, 5), use(w.far.M, 9), use(w.far.B, 9), use(w.far.gap, 2), use(w.far.J, 6);
    use(w.matrix, 25), use(w.right, 5), use(w.A, 9), use(w.along, 9), use(w.by_w, 9), use(w.product, 9);
    use(w.K, 15), use(w.N, 15), use(w.G, 3), use(w.x, 3), use(w.momentum, 3);
    for (k = 0; k < 2000; ++k)
        once &= uses[k] == (k < mbs_variational_reals(&plant));
    LAW("arrays share no number, and leave none", once);
    LAW("rows of a matrix can be exchanged",
        mbs_variational_integers(&plant) == 5 && w.pivots == integers && w.h == 0.5);
}

static void crosses(void)
{
    const casadi_real a[3] = {1, -2, 3}, b[3] = {0.5, 4, -1}, c[3] = {2, 7, -5};
    casadi_real block[15], seen[3], once[3] = {0, 0, 0}, twice[3] = {0, 0, 0}, K[6] = {1, 2, 3, 4, 5, 6}, out[4];
    int i;
    memset(block, 0, sizeof block), add_tilde(2, a, 5, block);
    add_cross(2, a, c, once);
    for (i = 0; i < 3; ++i)
        LAW("a~ c is a x c", dot(block + 5 * i, c) == once[i]);
    memset(block, 0, sizeof block), memset(once, 0, sizeof once);
    add_crosses(2, a, b, 5, block);
    add_cross(1, b, c, once), add_cross(2, a, once, twice);
    for (i = 0; i < 3; ++i)
        LAW("a~ b~ c is a x (b x c)", dot(block + 5 * i, c) == twice[i]);
    LAW("each alone", block[3] == 0 && block[4] == 0 && block[8] == 0 && block[9] == 0);
    multiply(2, 3, 1, K, c, seen);
    LAW("a product has rows times columns", seen[0] == 1 && seen[1] == 13);
    multiply(2, 1, 2, c, a, out);
    LAW("all of them", out[0] == 2 && out[1] == -4 && out[2] == 7 && out[3] == -14);
}

/* The motion along x + dx is the one along x, and then along A(-x)^-1 dx; A(x) is A of the motion back. */
static void turns(void)
{
    static const casadi_real ways[4][7] = {{0.5, 1, -2, 0.75, 0.9, -0.4, 1.3}, {0, 0, 0, 0, 0, 0, 0},
                                           {1, 3, 2, -1, 2.9e-4, -8e-4, 4e-4}, {0, 1, 0, 0, 0, 0, 1.1e-3}};
    const casadi_real begin[8] = {1, 2, 3, 4, 0.1, -0.7, 0.5, 0.5}, step = 1e-5;
    casadi_real ahead[8], behind[8], there[8], moved[8], x[7], A[49], back[49], part[7];
    casadi_int pivots[7], k, i, j;
    mbs_group g;
    free_body();
    g = group(&plant);
    for (k = 0; k < 4; ++k)
        for (j = 0; j < 7; ++j) {
            trivialise(&plant, -1, ways[k], A);
            for (i = 0; i < 7; ++i)
                x[i] = -ways[k][i], part[i] = i == j ? step : 0;
            trivialise(&plant, 1, x, back);
            LAW("A of a motion back is A back", differ(49, A, back) == 0);
            mbs_factorise(1, 7, A, pivots), mbs_solve(1, 7, A, pivots, 1, part);
            mbs_move(g, begin, ways[k], there);
            mbs_move(g, there, part, ahead);
            for (i = 0; i < 7; ++i)
                part[i] = -part[i], x[i] = ways[k][i] + (i == j ? step : 0);
            mbs_move(g, there, part, behind);
            for (i = 0; i < 8; ++i)
                there[i] = (ahead[i] - behind[i]) / (2 * step);
            mbs_move(g, begin, x, ahead);
            x[j] -= 2 * step;
            mbs_move(g, begin, x, behind);
            for (i = 0; i < 8; ++i)
                moved[i] = (ahead[i] - behind[i]) / (2 * step);
            LAW("a motion is differentiated by A", differ(8, there, moved) < 2e-9);
        }
    LAW("the limit of s is a twelfth", find_s(0) == 1.0 / 12 && find_s(0.99e-6) == 1.0 / 12);
    LAW("from which it grows", fabs(find_s(1.01e-6) * 12 - 1) < 3e-8 && fabs(find_s(1) - (1 - 0.5 / tan(0.5))) < 1e-15);
}

static void slopes(void)
{
    static const casadi_real ways[4][7] = {{0.5, 1, -2, 0.75, 0.9, -0.4, 1.3}, {0, 1, 2, 3, 0, 0, 0},
                                           {1, 3, 2, -1, 2.9e-4, -8e-4, 4e-4}, {0, 1, 0, 0, 0, 0, 1.1e-3}};
    static const casadi_real p[7] = {2, -1, 3, 0.5, 4, -2, 1.5};
    const casadi_real step = 1e-5;
    casadi_real A[49], found[63], wanted[63], ahead[7], behind[7], x[7];
    casadi_int k, i, j;
    free_body();
    for (k = 0; k < 4; ++k) {
        memset(found, 0, sizeof found), memset(wanted, 0, sizeof wanted);
        add_slopes(attitude[0], 0.5, ways[k], p, 9, found);
        for (j = 0; j < 7; ++j) {
            memcpy(x, ways[k], sizeof x);
            x[j] += step, trivialise(&plant, 1, x, A), multiply(1, 7, 7, p, A, ahead);
            x[j] -= 2 * step, trivialise(&plant, 1, x, A), multiply(1, 7, 7, p, A, behind);
            for (i = 0; i < 7; ++i)
                wanted[9 * i + j] = 0.5 * (ahead[i] - behind[i]) / (2 * step);
        }
        LAW("turned momenta are differentiated", differ(63, found, wanted) < 4e-9);
    }
}

static const casadi_real somewhere[8] = {0.5, 2, -1, 0.25, 0.1, -0.7, 0.5, 0.5};
static const casadi_real speed[7] = {0.75, 1, -0.5, 0.25, 0.5, -0.4, 0.9};

/* Put both ends of a step along w there. */
static mbs_work stand(casadi_real h, const casadi_real *w)
{
    mbs_work k = open_here(h);
    memcpy(k.near.q, somewhere, (size_t)plant.nq * sizeof *q);
    write(plant.n, h, w, k.x);
    mbs_move(group(&plant), k.near.q, k.x, k.far.q);
    return k;
}

static void places(void)
{
    const casadi_real none[1] = {0};
    casadi_real M[49], B[49];
    casadi_int i;
    int kind, call_of;
    mbs_work k;
    free_body();
    stiffness[3] = 5, damping[1] = 3, plant.m = 1;
    k = stand(0.5, speed);
    v[0] = NAN, memset(qd, 0, sizeof qd);
    qd[0] = 100, v[0] = 7, fastest = 0;
    LAW("an end is evaluated at rest", place(&k, &k.near, speed) == 0 && fastest == 0);
    memcpy(q, somewhere, sizeof q);
    body(q, M), find_along(speed, B);
    LAW("with its mass matrix", differ(49, M, k.near.M) == 0);
    LAW("and momenta differentiated along motions", differ(49, B, k.near.B) < 1e-14);
    LAW("without inputs, and with the velocity for what follows", v[0] == 0 && differ(7, qd, speed) == 0);
    anew(3, 3, 2, unit);
    curve[1] = 2, offset[0] = 1, line[2] = 4, line[4] = 5;
    k = stand(0.5, speed);
    stiffness[0] = 5;
    LAW("loops have gaps", place(&k, &k.near, speed) == 0 && k.near.gap[0] == -5 && k.near.gap[1] == 15.25);
    LAW("and a Jacobian",
        k.near.J[2] == 4 && k.near.J[0] == 0 && k.near.J[3] == 1 && k.near.J[4] == 9 && k.near.J[5] == -2);
    LAW("forces do not count", differ(9, k.near.B, k.near.B) == 0 && k.near.B[0] == 0);
    for (kind = 0; kind < 4; ++kind)
        for (call_of = 1; call_of < 3; ++call_of) {
            anew(3, 3, 2, unit);
            plant.change.f = change;
            k = stand(0.5, speed);
            fails[kind] = call_of;
            LAW("a kernel that fails is named", place(&k, &k.near, speed) == (kind && call_of > 1 ? 0 : 11 + kind));
            if (kind && call_of > 1)
                LAW("whenever it does", place(&k, &k.far, speed) == 11 + kind);
        }
    anew(2, 2, 0, polar);
    k = stand(0.5, speed);
    k.near.q[0] = INFINITY;
    LAW("masses are finite", place(&k, &k.near, speed) != 0);
    for (hole = 0; hole < 9; ++hole) {
        anew(3, 3, 0, unknown);
        k = stand(0.5, speed);
        LAW("all of them", place(&k, &k.near, speed) != 0);
    }
    anew(3, 3, 2, unit);
    plant.change.f = change, line[0] = 4;
    plant.M.entries = plant.K.entries = plant.C.entries = plant.N.entries = plant.J.entries = 1;
    k = stand(0.5, speed);
    LAW("entries that are not there are 0", place(&k, &k.near, speed) == 0 && push(&k, &k.near, none, speed) == 0);
    for (i = 0; i < 9; ++i) {
        LAW("of masses", k.near.M[i] == (i == 0 ? 2 : 0) && k.near.B[i] == 0 && k.by_w[i] == 0);
        LAW("of rates", k.K[i] == 0 && k.N[i] == (i == 0));
        LAW("of loops", i > 5 || k.near.J[i] == (i == 0 ? 4 : 0));
    }
    anew(2, 2, 0, polar);
    k = stand(0.5, speed);
    k.near.q[0] = NAN;
    LAW("and numbers", place(&k, &k.near, speed) != 0);
}

/* A plant with forces of all kinds: a free body on a slider, polar coordinates, or coordinates with loops. */
static void load(int kind)
{
    casadi_int i;
    if (kind == 0)
        free_body();
    else if (kind == 1)
        anew(2, 2, 0, polar);
    else {
        anew(3, 3, 2, unit);
        curve[0] = 1, line[1] = 1, curve[1] = -1, line[5] = 2, offset[0] = 1;
    }
    for (i = 0; i < plant.n; ++i) {
        pull[i] = (casadi_real)(i + 1), damping[i * plant.n + 1] = 0.5, damping[i * (plant.n + 1)] = 2;
        stiffness[i * plant.nq + 1] = -0.25;
    }
    plant.m = 1;
}

/* G is the derivative of the kinetic energy along motions, and the forces. */
static void pushes(void)
{
    const casadi_real inputs[1] = {3};
    casadi_real B[49], M[49], wanted, w[7], before[7], by_w[49];
    casadi_int i, j;
    int kind;
    mbs_work k;
    for (kind = 0; kind < 3; ++kind) {
        load(kind);
        k = stand(0.5, speed);
        place(&k, &k.near, speed);
        LAW("forces are evaluated", push(&k, &k.near, inputs, speed) == 0);
        memcpy(q, somewhere, sizeof q), find_along(speed, B), find_mass(q, M);
        for (i = 0; i < plant.n; ++i) {
            wanted = force(i, q, speed);
            for (j = 0; j < plant.n; ++j)
                wanted += B[j * plant.n + i] * speed[j] / 2;
            LAW("with the input", v[0] == 3);
            LAW("they are of energy and loads", same(k.G[i], wanted));
            LAW("at the momentum", same(k.momentum[i], total(plant.n, M + i * plant.n, speed)));
        }
        memcpy(by_w, k.by_w, (size_t)(plant.n * plant.n) * sizeof *by_w);
        for (j = 0; j < plant.n; ++j) {
            memcpy(w, speed, sizeof w);
            w[j] += 1, place(&k, &k.near, w), push(&k, &k.near, inputs, w);
            memcpy(before, k.G, (size_t)plant.n * sizeof *before);
            w[j] -= 2, place(&k, &k.near, w), push(&k, &k.near, inputs, w);
            for (i = 0; i < plant.n; ++i)
                LAW("and are differentiated", same(by_w[i * plant.n + j], (before[i] - k.G[i]) / 2));
        }
        place(&k, &k.near, speed);
        asked[0] = 0, fails[0] = 1;
        LAW("a kernel that fails is named", push(&k, &k.near, inputs, speed) == 11);
        asked[0] = 0, fails[0] = 2;
        LAW("whenever it does", push(&k, &k.near, inputs, speed) == 11);
    }
}

/* The equations of a step, and their derivatives by differences. */
static void linearisations(void)
{
    static const casadi_real z[9] = {0.8, 0.9, -0.6, 0.3, 0.45, -0.35, 0.8, 0, 0};
    const casadi_real inputs[1] = {3}, step = 1e-5;
    casadi_real there[9], right[9], A[49], M[49], p[7], J[14], matrix[81], sum, G[7], last[8];
    casadi_int i, j, whole;
    int kind;
    mbs_work k;
    for (kind = 0; kind < 3; ++kind) {
        const casadi_real h = kind ? 0.5 : 0.25;
        load(kind);
        whole = plant.n + plant.e;
        memcpy(there, z, sizeof there);
        if (kind == 2)
            there[3] = 1.5, there[4] = -0.5;
        k = stand(h, speed);
        LAW("equations are written", linearise(&k, speed, inputs, there) == 0);
        memcpy(right, k.right, (size_t)whole * sizeof *right), memcpy(last, k.far.q, (size_t)plant.nq * sizeof *last);
        memcpy(matrix, k.matrix, (size_t)(whole * whole) * sizeof *matrix);
        for (i = 0; i < plant.n; ++i)
            p[i] = h * there[i];
        trivialise(&plant, 1, p, A);
        memcpy(q, somewhere, sizeof q), find_mass(q, M), place(&k, &k.near, there), push(&k, &k.near, inputs, there);
        memcpy(G, k.G, (size_t)plant.n * sizeof *G);
        jacobian(0, 0, 0, 0, 0), memcpy(J, loops, sizeof J);
        for (i = 0; i < plant.n; ++i) {
            p[i] = total(plant.n, M + i * plant.n, there);
            right[i] += total(plant.n, M + i * plant.n, speed) + h / 2 * G[i];
            for (j = 0; j < plant.e; ++j)
                right[i] += h / 2 * J[j * plant.n + i] * there[plant.n + j];
        }
        memcpy(q, last, sizeof last), find_mass(q, M);
        closure(0, 0, 0, 0, 0);
        for (i = 0; i < plant.n; ++i)
            p[i] = (p[i] + total(plant.n, M + i * plant.n, there)) / 2;
        for (i = 0; i < plant.n; ++i) {
            for (j = 0, sum = 0; j < plant.n; ++j)
                sum += A[j * plant.n + i] * p[j];
            LAW("the mean momentum, turned back, is the one before and half a step of forces", same(right[i], sum));
        }
        for (i = 0; i < plant.e; ++i)
            LAW("loops are closed at the far end", right[plant.n + i] == gap[i] / h);
        for (j = 0; j < whole; ++j) {
            there[j] += step, linearise(&k, speed, inputs, there);
            memcpy(right, k.right, (size_t)whole * sizeof *right);
            there[j] -= 2 * step, linearise(&k, speed, inputs, there);
            there[j] += step;
            for (i = 0; i < whole; ++i)
                LAW("equations are differentiated",
                    fabs((right[i] - k.right[i]) / (2 * step) - matrix[i * whole + j]) < 3e-8);
        }
        for (i = 1; i < 7; ++i) { /* two at the near end, two at the far one, two of forces */
            asked[0] = 0, fails[0] = (int)i;
            LAW("a kernel that fails is named", linearise(&k, speed, inputs, there) == 11);
        }
    }
}

/* A turn of no number has no derivative. */
static void unknown_turns(void)
{
    const casadi_real none[1] = {0}, z[3] = {NAN, 0, 0};
    mbs_work k;
    ball();
    k = open_here(0.5);
    memcpy(k.near.q, somewhere + 4, 4 * sizeof *q);
    LAW("turns of no number end a step", linearise(&k, speed, none, z) != 0);
}

static void definite(void)
{
    static const casadi_real M[9] = {4, 2, -1, 2, 5, 0.5, -1, 0.5, 3};
    const casadi_real least = 3 * 1e3 * 2.220446049250313e-16;
    casadi_real factor[9], bad[9];
    casadi_int i, j, k;
    LAW("a definite matrix has a factor", is_definite(3, M, factor));
    for (i = 0; i < 3; ++i)
        for (j = 0; j <= i; ++j) {
            casadi_real sum = 0;
            for (k = 0; k <= j; ++k)
                sum += factor[3 * i + k] * factor[3 * j + k];
            LAW("whose square it is", same(sum, M[3 * i + j]));
        }
    for (k = 0; k < 3; ++k) {
        memset(bad, 0, sizeof bad);
        bad[0] = bad[4] = bad[8] = 1;
        bad[4 * k] = -1;
        LAW("others have none", !is_definite(3, bad, factor));
        bad[4 * k] = NAN;
        LAW("as no number", !is_definite(3, bad, factor));
        bad[4 * k] = 0;
        LAW("nor nothing at all", !is_definite(3, bad, factor));
        for (j = 0; j < k; ++j) {
            bad[4 * k] = 4, bad[4 * j] = 1, bad[3 * k + j] = bad[3 * j + k] = sqrt(4 - 4.1 * least);
            LAW("a small pivot keeps digits", is_definite(3, bad, factor));
            bad[3 * k + j] = bad[3 * j + k] = sqrt(4 - 3.9 * least);
            LAW("a smaller one does not", !is_definite(3, bad, factor));
            bad[3 * k + j] = bad[3 * j + k] = 0;
        }
    }
}

/* M qd = p + J^T lam with J qd = 0, for the momentum p = A(-x)^T p/2 + h/2 G at the far end. */
static void releases(void)
{
    const casadi_real inputs[1] = {3};
    casadi_real after[7], A[49], N[49], p[7], rest[7], back[7], lam[2], J[14];
    casadi_int i, j;
    int kind;
    mbs_work k;
    for (kind = 0; kind < 3; ++kind) {
        load(kind);
        k = stand(0.5, speed);
        place(&k, &k.near, speed), place(&k, &k.far, speed);
        LAW("velocities follow", release(&k, inputs, speed, after) == 0);
        memcpy(lam, k.right + plant.n, (size_t)plant.e * sizeof *lam);
        push(&k, &k.far, inputs, speed);
        for (i = 0; i < plant.n; ++i)
            back[i] = -0.5 * speed[i];
        trivialise(&plant, 1, back, A);
        memcpy(q, somewhere, sizeof q), find_mass(q, N);
        for (i = 0; i < plant.n; ++i)
            p[i] = total(plant.n, N + i * plant.n, speed) / 2;
        memcpy(q, k.far.q, (size_t)plant.nq * sizeof *q), find_mass(q, N);
        jacobian(0, 0, 0, 0, 0), memcpy(J, loops, sizeof J);
        for (i = 0; i < plant.n; ++i)
            p[i] += total(plant.n, N + i * plant.n, speed) / 2;
        for (i = 0; i < plant.n; ++i) {
            rest[i] = total(plant.n, N + i * plant.n, after) - k.h / 2 * k.G[i];
            for (j = 0; j < plant.n; ++j)
                rest[i] -= A[j * plant.n + i] * p[j];
            for (j = 0; j < plant.e; ++j)
                rest[i] -= J[j * plant.n + i] * lam[j];
            LAW("from the momentum", fabs(rest[i]) < 1e-12);
        }
        for (j = 0; j < plant.e; ++j)
            LAW("along loops", fabs(total(plant.n, J + j * plant.n, after)) < 1e-14);
        asked[0] = 0, fails[0] = 2;
        LAW("a kernel that fails ends it", release(&k, inputs, speed, after) != 0);
    }
    load(1);
    k = stand(0.5, speed);
    place(&k, &k.near, speed), place(&k, &k.far, speed);
    k.far.M[3] = -1;
    LAW("negative masses too", release(&k, inputs, speed, after) != 0);
    load(2);
    k = stand(0.5, speed);
    place(&k, &k.near, speed), place(&k, &k.far, speed);
    k.far.M[0] = k.far.M[4] = k.far.M[8] = -1;
    LAW("but loops are judged by their matrix", release(&k, inputs, speed, after) == 0);
    write(6, 0, k.far.J, k.far.J);
    LAW("which is singular where they depend on each other", release(&k, inputs, speed, after) != 0);
}

/* One joint of mass 2 from q = 3, v = -1 under a force of 8, with h = 1/2: w = v + h/2 4 = 0,
    by a change of 1 from v, which
 * counts 1 / (1 + 1) + (1/2) / (1 + 3) = 0.625. */
static casadi_int solve_one(casadi_real converged, casadi_real fine, casadi_int most, casadi_real *z)
{
    const casadi_real before[1] = {-1}, none[1] = {0};
    const mbs_variational_end end = {converged, fine, most};
    mbs_work k;
    anew(1, 1, 0, unit);
    pull[0] = 8, z[0] = -1;
    k = open_here(0.5);
    k.near.q[0] = 3;
    return solve(&k, end, before, none, z);
}

static void endings(void)
{
    const casadi_real before[3] = {-1, 0, 0}, rest[3] = {0, 0, 0}, none[1] = {0};
    casadi_real z[5];
    casadi_int i;
    mbs_variational_end end = {0, 0, 9};
    mbs_work k;
    LAW("a short change ends an iteration", solve_one(0.626, 0, 9, z) == 1 && fabs(z[0]) < 1e-14);
    LAW("beside speeds and places", solve_one(0.624, 0, 9, z) == 2);
    LAW("noise does not end the first one", solve_one(0, 0.7, 9, z) == 2);
    LAW("there are as many as may be", solve_one(0.624, 0, 2, z) == 2 && solve_one(0.624, 0, 1, z) == 0);
    LAW("at least one", solve_one(0.626, 0, 0, z) == 0);
    for (i = 0; i < 3; ++i) {
        anew(1, 1, 0, unit); /* noise goes to and fro by h noise 2 / 2 / 2 */
        noise = 1e-3, k = open_here(0.5), k.near.q[0] = 0, z[0] = -1,
            end.noise = 2.5e-4 * (i ? 1.01 : 0.99) * (i > 1 ? 0.1 : 1);
        LAW("noise ends an iteration that shrinks no more", (solve(&k, end, before, none, z) > 0) == (i == 1));
    }
    pull[0] = NAN;
    LAW("no number ends it", solve(&k, end, before, none, z) == 0);
    anew(2, 2, 0, unit);
    pull[0] = NAN, k = open_here(0.5), k.near.q[0] = k.near.q[1] = 0, z[0] = z[1] = 0, end.converged = 1;
    LAW("in any joint", solve(&k, end, before, none, z) == 0);
    anew(3, 3, 1, unit);
    line[0] = 1, pull[0] = 4e6, k = open_here(0.5), memset(k.near.q, 0, 3 * sizeof *q), memset(z, 0, sizeof z);
    LAW("multipliers do not count", solve(&k, end, rest, none, z) == 1 && z[3] == -4e6);
    line[0] = 0;
    LAW("a singular matrix ends it", solve(&k, end, rest, none, z) == 0);
    line[0] = 1, asked[0] = 0, fails[0] = 1;
    LAW("and a kernel that fails", solve(&k, end, rest, none, z) == 0);
    ball();
    end.noise = 0, k = open_here(0.5), memcpy(k.near.q, somewhere + 4, 4 * sizeof *q);
    z[0] = 1e-3, z[1] = z[2] = 0, end.converged = 1e-3 * (1 + 0.5) * 1.01;
    LAW("turns have no place", solve(&k, end, rest, none, z) == 1);
    z[0] = 1e-3, end.converged = 1e-3 * (1 + 0.5) * 0.99, z[1] = z[2] = 0;
    LAW("beside which they are small", solve(&k, end, rest, none, z) == 2);
}

/* A mass on a spring by Stormer's and Verlet's method: w = v - h/2 w0^2 q, and back. */
static void springs(void)
{
    casadi_real states[2 * 41] = {1, 0}, speeds[40], guess[1] = {0}, w, x = 1, y = 0;
    const casadi_real h = 0.25;
    casadi_int turns = 5, k;
    anew(1, 1, 0, unit);
    stiffness[0] = 8; /* w0 = 2 */
    LAW("all steps are taken", run(h, 20, 0, states, speeds, guess, &turns) == 20);
    for (k = 0; k < 20; ++k) {
        w = y - h / 2 * 4 * x, x += h * w, y = w - h / 2 * 4 * x;
        LAW("a spring moves by Verlet's method",
            same(states[2 * k + 2], x) && same(states[2 * k + 3], y) && same(speeds[k], w));
    }
    LAW("iterations are counted: two, then one a step, since guesses are exact", turns == 26 && guess[0] == speeds[19]);
    states[0] = states[40], states[1] = -states[41];
    run(h, 20, 0, states, speeds, guess, &turns);
    LAW("and back", fabs(states[40] - 1) < 1e-13 && fabs(states[41]) < 1e-13);
}

/* A constant force of the inputs: the motion is exact, and the speed of a step follows from the one before. */
static void guesses(void)
{
    casadi_real states[2 * 11] = {1, -2}, speeds[10], guess[1], inputs[11 * 2];
    casadi_int turns = 0, k;
    for (k = 0; k < 22; ++k)
        inputs[k] = k % 2 ? NAN : 4;
    anew(1, 1, 0, unit);
    plant.m = 1, guess[0] = -2 - 0.25 * 2, open_here(0.5);
    LAW("all steps are taken",
        mbs_variational_run(&plant, ending, 0.5, 10, inputs, 2, states, speeds, guess, &turns, reals, integers) == 10);
    LAW("by one iteration each, since a guess is the solution", turns == 10);
    for (k = 1; k <= 10; ++k)
        LAW("by the force",
            same(states[2 * k], 1 - (casadi_real)k + 0.25 * (casadi_real)(k * k))
            && same(states[2 * k + 1], -2 + (casadi_real)k));
    for (k = 0; k < 22; ++k)
        inputs[k] = (casadi_real)(k / 2 % 2 ? 8 : 0); /* half of the near end's, half of the far end's */
    states[0] = 0, states[1] = 0;
    mbs_variational_run(&plant, ending, 0.5, 2, inputs, 2, states, speeds, guess, &turns, reals, integers);
    LAW("inputs are of both ends",
        same(states[3], 1) && same(states[2], 0) && same(states[5], 2) && same(states[4], 1));
}

/* A free point in polar coordinates, and rigid bodies: momenta and their moments stay, and all motions go back. */
static void momenta(void)
{
    casadi_real states[16 * 41] = {1, 0, 0.5, 0.75}, speeds[7 * 40], guess[7] = {0.5, 0.75}, first[3], p[7], M[49];
    casadi_int turns = 0, k, i;
    anew(2, 2, 0, polar);
    LAW("all steps are taken", run(0.05, 40, 0, states, speeds, guess, &turns) == 40);
    for (k = 1; k <= 40; ++k)
        LAW("a point keeps its moment of momentum",
            fabs(states[4 * k] * states[4 * k] * states[4 * k + 3] - 0.75) < 1e-13);
    LAW("and moves straight", fabs(states[160] * states[160] - (4 + 4 * 0.5625)) < 4e-3); /* (1 + 2/2)^2 + (2 3/4)^2 */
    LAW("by few iterations", turns <= 40 * 4);
    states[0] = states[160], states[1] = states[161], states[2] = -states[162], states[3] = -states[163];
    guess[0] = -guess[0], guess[1] = -guess[1];
    run(0.05, 40, 0, states, speeds, guess, &turns);
    LAW("and back", fabs(states[160] - 1) < 1e-12 && fabs(states[161]) < 1e-12 && fabs(states[162] + 0.5) < 1e-12);
    ball();
    memcpy(states, somewhere + 4, 4 * sizeof *states);
    states[4] = 1, states[5] = -0.5, states[6] = 2, memcpy(guess, states + 4, 3 * sizeof *guess), turns = 0;
    LAW("all steps are taken", run(0.1, 40, 0, states, speeds, guess, &turns) == 40 && turns <= 40 * 5);
    for (k = 0; k <= 40; ++k) {
        const casadi_real *w = states + 7 * k + 4;
        p[0] = w[0], p[1] = 2 * w[1], p[2] = 2.5 * w[2], rotate(states + 7 * k, p);
        if (k == 0)
            memcpy(first, p, sizeof first);
        LAW("a top keeps its moment of momentum in space", differ(3, first, p) < 1e-13);
    }
    memcpy(states, states + 280, 4 * sizeof *states);
    for (i = 0; i < 3; ++i)
        states[4 + i] = -states[284 + i], guess[i] = -guess[i];
    run(0.1, 40, 0, states, speeds, guess, &turns);
    LAW("and back", differ(4, states + 280, somewhere + 4) < 1e-12 && fabs(states[284] + 1) < 1e-12);
    free_body();
    weak = 0;
    memcpy(states, somewhere, sizeof somewhere), memcpy(states + 8, speed, sizeof speed), memcpy(guess, speed,
        sizeof speed);
    turns = 0;
    LAW("all steps are taken", run(0.1, 40, 0, states, speeds, guess, &turns) == 40 && turns <= 40 * 6);
    for (k = 0; k <= 40; ++k) {
        const casadi_real *state = states + 15 * k;
        body(state, M);
        multiply(7, 7, 1, M, state + 8, p);
        rotate(state + 4, p + 1), rotate(state + 4, p + 4);
        add_cross(1, state + 1, p + 1, p + 4);
        if (k == 0)
            memcpy(speeds, p, sizeof p);
        LAW("a free body keeps its momentum and the moment of it", differ(6, speeds + 1, p + 1) < 2e-13);
    }
}

/* A point of mass 2 on a circle, q.q = 1, under a load. */
static void pendulums(void)
{
    casadi_real states[4 * 41] = {0.8, -0.6, 0.75, 1}, speeds[80], guess[3] = {0.75, 1, 0}, least = 1e9, most = -1e9;
    casadi_int turns = 0, k;
    anew(2, 2, 1, unit);
    curve[0] = 1, offset[0] = 0.5, pull[1] = -4;
    LAW("all steps are taken", run(0.05, 40, 0, states, speeds, guess, &turns) == 40 && turns <= 40 * 5);
    for (k = 0; k <= 40; ++k) {
        const casadi_real *s = states + 4 * k, energy = s[2] * s[2] + s[3] * s[3] + 4 * s[1];
        LAW("loops stay closed",
            fabs(s[0] * s[0] + s[1] * s[1] - 1) < 1e-13 && fabs(s[0] * s[2] + s[1] * s[3]) < 1e-13);
        least = fmin(least, energy), most = fmax(most, energy);
    }
    LAW("energy goes to and fro by the square of a step", most - least < 8e-3);
    states[0] = states[160], states[1] = states[161], states[2] = -states[162], states[3] = -states[163];
    guess[0] = -guess[0], guess[1] = -guess[1];
    run(0.05, 40, 0, states, speeds, guess, &turns);
    LAW("and back", fabs(states[160] - 0.8) < 1e-11 && fabs(states[162] + 0.75) < 1e-11);
}

/* Steps end before a kernel that fails: six calls in each iteration of which there are two, then four for both ends,
    and
 * two for the velocities. */
static void failures(void)
{
    casadi_real states[8] = {0, 1}, speeds[3], guess[1];
    casadi_int turns, k;
    for (k = 1; k <= 48; ++k) {
        anew(1, 1, 0, unit);
        guess[0] = states[0] = 0, states[1] = 1, pull[0] = 1, turns = 0, fails[0] = (int)k;
        LAW("steps before one that fails are taken",
            run(0.5, 3, 0, states, speeds, guess, &turns) == (k <= 18 ? 0 : k <= 30 ? 1 : k <= 42 ? 2 : 3));
    }
}

int main(void)
{
    rooms(), crosses(), turns(), slopes(), places(), pushes(), linearisations(), unknown_turns(), definite(),
        releases(), endings();
    springs(), guesses(), momenta(), pendulums(), failures();
    return broken > 0;
}
