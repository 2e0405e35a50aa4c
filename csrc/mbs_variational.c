/* Variational steps of a fixed length: see mbs_variational.h. */
#include "mbs_variational.h"
#include "mbs_dense.h"
#include "mbs_entries.h"

#include <float.h>
#include <math.h>

#define LOST 1e3      /* a pivot below n LOST epsilon of its diagonal entry has lost its digits */

/* One end of a step. */
typedef struct {
    casadi_real *q, *M, *B; /* nq, n x n; M w differentiated along the group, n x n */
    casadi_real *gap, *J;   /* e, e x n */
} mbs_place;

typedef struct {
    const mbs_variational *p;
    casadi_real h;
    mbs_place near, far;
    casadi_real *matrix, *right; /* (n + e) squared, n + e */
    casadi_real *A, *along, *by_w, *product; /* n x n */
    casadi_real *K, *N;          /* n x nq, nq x n */
    casadi_real *G, *x, *momentum; /* n */
    casadi_int *pivots;
} mbs_work;

casadi_int mbs_variational_reals(const mbs_variational *p)
{
    const casadi_int n = p->n, e = p->e, whole = n + e;
    return 2 * (p->nq + 2 * n * n + e + e * n) + whole * whole + whole + 4 * n * n + 2 * n * p->nq + 3 * n;
}

casadi_int mbs_variational_integers(const mbs_variational *p)
{
    return p->n + p->e;
}

static casadi_real *open_place(const mbs_variational *p, mbs_place *place, casadi_real *reals)
{
    place->q = reals, place->M = place->q + p->nq, place->B = place->M + p->n * p->n;
    place->gap = place->B + p->n * p->n, place->J = place->gap + p->e;
    return place->J + p->e * p->n;
}

static mbs_work open_work(const mbs_variational *p, casadi_real h, casadi_real *reals, casadi_int *integers)
{
    const casadi_int n = p->n, whole = n + p->e;
    mbs_work w;
    w.p = p, w.h = h, w.pivots = integers;
    reals = open_place(p, &w.near, reals);
    w.matrix = open_place(p, &w.far, reals), w.right = w.matrix + whole * whole, w.A = w.right + whole;
    w.along = w.A + n * n, w.by_w = w.along + n * n, w.product = w.by_w + n * n;
    w.K = w.product + n * n, w.N = w.K + n * p->nq, w.G = w.N + p->nq * n, w.x = w.G + n, w.momentum = w.x + n;
    return w;
}

static mbs_group group(const mbs_variational *p)
{
    const mbs_group own = {p->nq, p->attitudes, p->scalars, p->attitude, p->place, p->rate};
    return own;
}

static int call(mbs_call kernel)
{
    return kernel.f ? kernel.f(kernel.arg, kernel.res, 0, 0, 0) : 0;
}

/* C = A B, of rows x inner and inner x cols. */
static void multiply(casadi_int rows, casadi_int inner, casadi_int cols, const casadi_real *A, const casadi_real *B,
                     casadi_real *C)
{
    casadi_int i, j, k;
    for (i = 0; i < rows; ++i)
        for (j = 0; j < cols; ++j) {
            casadi_real sum = 0;
            for (k = 0; k < inner; ++k)
                sum += A[i * inner + k] * B[k * cols + j];
            C[i * cols + j] = sum;
        }
}

/* Add f a~ b~ = f (b a^T - a.b 1) to a block of a matrix with rows of n. */
static void add_crosses(casadi_real f, const casadi_real *a, const casadi_real *b, casadi_int n, casadi_real *block)
{
    const casadi_real both = dot(a, b);
    int i, j;
    for (i = 0; i < 3; ++i)
        for (j = 0; j < 3; ++j)
            block[i * n + j] += f * (b[i] * a[j] - (i == j ? both : 0));
}

/* Add f a~. */
static void add_tilde(casadi_real f, const casadi_real *a, casadi_int n, casadi_real *block)
{
    block[1] -= f * a[2], block[2] += f * a[1];
    block[n] += f * a[2], block[n + 2] -= f * a[0];
    block[2 * n] -= f * a[1], block[2 * n + 1] += f * a[0];
}

static casadi_real find_s(casadi_real square)
{
    return square < STRAIGHT ? 1.0 / 12 : (1 - 1 / find_k(square)) / square;
}

/* A(f x), n x n. */
static void trivialise(const mbs_variational *p, casadi_real f, const casadi_real *x, casadi_real *A)
{
    const casadi_int n = p->n;
    casadi_int k;
    for (k = 0; k < n * n; ++k)
        A[k] = k % (n + 1) == 0;
    for (k = 0; k < p->attitudes; ++k) {
        const mbs_attitude a = p->attitude[k];
        const casadi_real *w = x + a.spin, square = dot(w, w);
        add_tilde(-f / 2, w, n, A + a.spin * (n + 1));
        add_crosses(find_s(square), w, w, n, A + a.spin * (n + 1));
        if (a.is_free) {
            const casadi_int first = a.spin - 3;
            casadi_real c[3];
            write(3, f * find_k(square), w, c);
            add_tilde(-0.5, c, n, A + first * (n + 1));
            add_tilde(-f / 2, x + first, n, A + first * n + a.spin);
            add_crosses(f / 4, c, x + first, n, A + first * n + a.spin);
        }
    }
}

/* Add h d(A(x)^T p) / dx to a matrix with rows of `cols`. */
static void add_slopes(mbs_attitude a, casadi_real h, const casadi_real *x, const casadi_real *momentum, casadi_int cols,
                       casadi_real *matrix)
{
    const casadi_real *w = x + a.spin, *p = momentum + a.spin, square = dot(w, w), along = dot(w, p);
    const casadi_real k = find_k(square), s = find_s(square);
    const int is_straight = square < STRAIGHT;
    const casadi_real by_k = is_straight ? 1.0 / 6 : (1 + square * k * k / 4 - k) / square;
    const casadi_real by_s = is_straight ? 0 : (by_k / (k * k) - 2 * s) / square;
    casadi_real *turns = matrix + a.spin * (cols + 1);
    int i, j, l;
    add_tilde(-h / 2, p, cols, turns);
    for (i = 0; i < 3; ++i)
        for (j = 0; j < 3; ++j)
            turns[i * cols + j] += h * (s * ((i == j ? along : 0) + w[i] * p[j] - 2 * p[i] * w[j])
                                        + by_s * (along * w[i] - square * p[i]) * w[j]);
    if (a.is_free) {
        const casadi_real *d = w - 3, *f = p - 3;
        casadi_real *shifts = matrix + (a.spin - 3) * (cols + 1), seen[3], by_w[9] = {0}, slopes[9], c[3];
        write(3, k, w, c);
        write(3, 1, f, seen);
        add_cross(0.5, c, f, seen);
        add_tilde(-0.5, f, 3, by_w);
        for (i = 0; i < 3; ++i) /* -f~/2 dc/dw, with dc/dw = k 1 + by_k w w^T */
            for (j = 0; j < 3; ++j) {
                const casadi_real *row = by_w + 3 * i;
                slopes[3 * i + j] = k * row[j] + by_k * dot(row, w) * w[j];
            }
        for (i = 0; i < 3; ++i)
            for (j = 0; j < 3; ++j)
                shifts[i * cols + 3 + j] += h * slopes[3 * i + j];
        add_tilde(-h / 2, seen, cols, shifts + 3 * cols);
        write(9, 0, by_w, by_w);
        add_tilde(0.5, d, 3, by_w);
        for (i = 0; i < 3; ++i)
            for (j = 0; j < 3; ++j)
                for (l = 0; l < 3; ++l)
                    turns[i * cols + j] += h * by_w[3 * i + l] * slopes[3 * l + j];
    }
}

/* Evaluate everything of an end of a step that depends on its place, or is linear in w. */
static int place(mbs_work *k, mbs_place *end, const casadi_real *w)
{
    const mbs_variational *p = k->p;
    const casadi_int n = p->n, nq = p->nq;
    casadi_int i, j;
    int status;
    write(nq, 1, end->q, p->q);
    write(n, 0, w, p->qd);
    write(n, 1, w, p->qdd);
    write(p->m, 0, p->v, p->v);
    status = call(p->dynamics);
    if (status)
        return status;
    mbs_fill_entries(p->M, n * n, end->M);
    mbs_fill_entries(p->K, n * nq, k->K);
    write(n, 0, w, p->qdd);
    status = call(p->dynamics);
    for (i = 0; i < p->K.entries; ++i)
        k->K[p->K.place[i]] -= p->K.nonzeros[i];
    write(n, 1, w, p->qd);
    status = status ? status : call(p->change);
    status = status ? status : call(p->closure);
    status = status ? status : call(p->jacobian);
    if (status)
        return status;
    if (p->change.f) {
        mbs_fill_entries(p->N, nq * n, k->N);
        multiply(n, nq, n, k->K, k->N, end->B);
    } else {
        write(n * n, 1, k->K, end->B);
    }
    if (p->e) {
        write(p->e, 1, p->gap, end->gap);
        mbs_fill_entries(p->J, p->e * n, end->J);
    }
    for (i = 0; i < n; ++i)
        for (j = 0; j < n; ++j)
            if (!(end->M[i * n + j] - end->M[i * n + j] == 0))
                return -1;
    return 0;
}

/* Write G of an end into k->G, and its derivative by w into k->by_w. */
static int push(mbs_work *k, const mbs_place *end, const casadi_real *inputs, const casadi_real *w)
{
    const mbs_variational *p = k->p;
    const casadi_int n = p->n;
    casadi_int i, j;
    int status;
    write(p->nq, 1, end->q, p->q);
    write(n, 0, w, p->qdd);
    write(p->m, 1, inputs, p->v);
    write(n, -1, w, p->qd);
    status = call(p->dynamics);
    if (status)
        return status;
    mbs_fill_entries(p->C, n * n, k->by_w);
    write(n, 1, w, p->qd);
    status = call(p->dynamics);
    if (status)
        return status;
    for (i = 0; i < p->C.entries; ++i)
        k->by_w[p->C.place[i]] += p->C.nonzeros[i]; /* twice the part that is even in w */
    for (i = 0; i < n; ++i)
        for (j = 0; j < n; ++j)
            k->by_w[i * n + j] = end->B[j * n + i] - k->by_w[i * n + j] / 2;
    multiply(n, n, 1, end->B, w, k->G);
    multiply(n, n, 1, end->M, w, k->momentum);
    for (i = 0; i < n; ++i)
        k->G[i] -= p->Phi[i];
    for (i = 0; i < p->attitudes; ++i) {
        const mbs_attitude a = p->attitude[i];
        add_cross(1, w + a.spin, k->momentum + a.spin, k->G + a.spin);
        if (a.is_free) {
            add_cross(1, w + a.spin - 3, k->momentum + a.spin - 3, k->G + a.spin);
            add_cross(1, w + a.spin, k->momentum + a.spin - 3, k->G + a.spin - 3);
        }
    }
    return 0;
}

/* Write the mean momentum of the step, (M0 + M1) w / 2. */
static void average(mbs_work *k, const casadi_real *w)
{
    const casadi_int n = k->p->n;
    casadi_int i, j;
    for (i = 0; i < n; ++i) {
        k->momentum[i] = 0;
        for (j = 0; j < n; ++j)
            k->momentum[i] += (k->near.M[i * n + j] + k->far.M[i * n + j]) * w[j] / 2;
    }
}

/* Write the equations for z = (w, lam) and their derivatives. */
static int linearise(mbs_work *k, const casadi_real *qd, const casadi_real *inputs, const casadi_real *z)
{
    const mbs_variational *p = k->p;
    const casadi_int n = p->n, e = p->e, whole = n + e;
    casadi_int i, j, l;
    int status;
    write(n, k->h, z, k->x);
    mbs_move(group(p), k->near.q, k->x, k->far.q);
    status = place(k, &k->near, z);
    status = status ? status : place(k, &k->far, z);
    status = status ? status : push(k, &k->near, inputs, z);
    if (status)
        return status;
    trivialise(p, -1, k->x, k->A);
    for (i = 0; i < n * n; ++i)
        k->along[i] = i % (n + 1) == 0 ? k->h : 0;
    if (mbs_factorise(1, n, k->A, k->pivots))
        return -1;
    mbs_solve(1, n, k->A, k->pivots, n, k->along);
    trivialise(p, 1, k->x, k->A);
    average(k, z);
    multiply(n, n, n, k->far.B, k->along, k->product);
    for (i = 0; i < n * n; ++i)
        k->product[i] = (k->near.M[i] + k->far.M[i] + k->product[i]) / 2;
    for (i = 0; i < whole * whole; ++i)
        k->matrix[i] = 0;
    for (i = 0; i < n; ++i) {
        casadi_real sum = -k->h / 2 * k->G[i];
        for (j = 0; j < n; ++j)
            sum += k->A[j * n + i] * k->momentum[j] - k->near.M[i * n + j] * qd[j];
        for (j = 0; j < e; ++j) {
            sum -= k->h / 2 * k->near.J[j * n + i] * z[n + j];
            k->matrix[i * whole + n + j] = -k->h / 2 * k->near.J[j * n + i];
        }
        k->right[i] = sum;
        for (j = 0; j < n; ++j) {
            casadi_real slope = -k->h / 2 * k->by_w[i * n + j];
            for (l = 0; l < n; ++l)
                slope += k->A[l * n + i] * k->product[l * n + j];
            k->matrix[i * whole + j] = slope;
        }
    }
    for (i = 0; i < p->attitudes; ++i)
        add_slopes(p->attitude[i], k->h, k->x, k->momentum, whole, k->matrix);
    for (i = 0; i < e; ++i) {
        k->right[n + i] = k->far.gap[i] / k->h;
        for (j = 0; j < n; ++j)
            for (l = 0; l < n; ++l)
                k->matrix[(n + i) * whole + j] += k->far.J[i * n + l] * k->along[l * n + j] / k->h;
    }
    return 0;
}

/* Whether M has a Cholesky factor that keeps digits; the lower triangle of `factor` receives it. */
static int is_definite(casadi_int n, const casadi_real *M, casadi_real *factor)
{
    casadi_int i, j, k;
    for (j = 0; j < n; ++j)
        for (i = j; i < n; ++i) {
            casadi_real entry = M[i * n + j];
            for (k = 0; k < j; ++k)
                entry -= factor[i * n + k] * factor[j * n + k];
            if (i == j && !(entry > (casadi_real)n * LOST * DBL_EPSILON * M[j * n + j]))
                return 0;
            factor[i * n + j] = i == j ? sqrt(entry) : entry / factor[j * n + j];
        }
    return 1;
}

/* Solve M qd = p + J^T lam, J qd = 0 at the far end, for the velocities at the end of the step. */
static int release(mbs_work *k, const casadi_real *inputs, const casadi_real *w, casadi_real *qd)
{
    const mbs_variational *p = k->p;
    const casadi_int n = p->n, e = p->e, whole = n + e;
    casadi_int i, j;
    if (push(k, &k->far, inputs, w) || (!e && !is_definite(n, k->far.M, k->product)))
        return -1;
    trivialise(p, -1, k->x, k->A);
    average(k, w);
    for (i = 0; i < whole * whole; ++i)
        k->matrix[i] = 0;
    for (i = 0; i < n; ++i) {
        k->right[i] = k->h / 2 * k->G[i];
        for (j = 0; j < n; ++j) {
            k->right[i] += k->A[j * n + i] * k->momentum[j];
            k->matrix[i * whole + j] = k->far.M[i * n + j];
        }
        for (j = 0; j < e; ++j) {
            k->matrix[i * whole + n + j] = -k->far.J[j * n + i];
            k->matrix[(n + j) * whole + i] = k->far.J[j * n + i];
            k->right[n + j] = 0;
        }
    }
    if (mbs_factorise(1, whole, k->matrix, k->pivots))
        return -1;
    mbs_solve(1, whole, k->matrix, k->pivots, 1, k->right);
    write(n, 1, k->right, qd);
    return 0;
}

/* Solve for z = (w, lam); returns the number of iterations, or 0. */
static casadi_int solve(mbs_work *k, mbs_variational_end end, const casadi_real *qd, const casadi_real *inputs,
                        casadi_real *z)
{
    const mbs_variational *p = k->p;
    const casadi_int n = p->n, whole = n + p->e;
    casadi_real last = INFINITY;
    casadi_int turn, i;
    for (turn = 1; turn <= end.most; ++turn) {
        casadi_real size = 0;
        if (linearise(k, qd, inputs, z) || mbs_factorise(1, whole, k->matrix, k->pivots))
            return 0;
        mbs_solve(1, whole, k->matrix, k->pivots, 1, k->right);
        for (i = 0; i < whole; ++i) {
            z[i] -= k->right[i];
            if (i < n) {
                const casadi_real place = p->attitudes ? 0 : fabs(k->near.q[i]);
                const casadi_real change = fabs(k->right[i]) * (1 / (1 + fabs(qd[i])) + k->h / (1 + place));
                size = change > size || change != change ? change : size; /* NaN stays */
            }
        }
        if (!(size - size == 0))
            return 0;
        if (size <= end.converged || (last / 2 < size && size <= end.noise))
            return turn;
        last = size;
    }
    return 0;
}

casadi_int mbs_variational_run(const mbs_variational *p, mbs_variational_end end, casadi_real h, casadi_int steps,
                               const casadi_real *inputs, casadi_int v_step, casadi_real *states, casadi_real *speeds,
                               casadi_real *guess, casadi_int *iterations, casadi_real *reals, casadi_int *integers)
{
    const casadi_int n = p->n, row = p->nq + n;
    mbs_work k = open_work(p, h, reals, integers);
    casadi_int step, i;
    for (step = 0; step < steps; ++step) {
        const casadi_real *state = states + step * row, *qd = state + p->nq;
        casadi_real *next = states + (step + 1) * row;
        casadi_int turns;
        write(p->nq, 1, state, k.near.q);
        for (i = 0; i < n; ++i)
            guess[i] = 2 * qd[i] - guess[i]; /* the velocity of the last step was half a step before */
        turns = solve(&k, end, qd, inputs + step * v_step, guess);
        if (!turns)
            return step;
        *iterations += turns;
        write(n, h, guess, k.x);
        mbs_move(group(p), k.near.q, k.x, k.far.q);
        if (place(&k, &k.near, guess) || place(&k, &k.far, guess)
            || release(&k, inputs + (step + 1) * v_step, guess, next + p->nq))
            return step;
        if (!mbs_is_finite(p->nq, k.far.q) || !mbs_is_finite(n, next + p->nq))
            return step;
        write(p->nq, 1, k.far.q, next);
        write(n, 1, guess, speeds + step * n);
    }
    return steps;
}
