/* One step of Radau collocation with closed loops: see mbs_radau.h. */
#include "mbs_radau.h"
#include "mbs_dense.h"

#include <math.h>

typedef struct {
    const mbs_radau *p;
    casadi_real h;
    casadi_int r, size;       /* equations of a stage, and of all */
    casadi_real *matrix, *right; /* size x size, size */
    casadi_real *square;      /* s x s: A A */
    casadi_real *B;           /* n x e */
    casadi_real *by_q, *by_v; /* of the equations of a stage: r x n */
    casadi_real *by_mu;       /* r x e: by_q B */
    casadi_real *moving;      /* s x n: v + B mu */
    const casadi_real *courses;
} mbs_work;

casadi_int mbs_radau_reals(const mbs_radau *p)
{
    const casadi_int r = p->n + 2 * p->e, size = p->s * r;
    return size * size + size + p->s * p->s + p->n * p->e + 2 * r * p->n + r * p->e + p->s * p->n;
}

casadi_int mbs_radau_integers(const mbs_radau *p)
{
    return p->s * (p->n + 2 * p->e);
}

static mbs_work open_work(const mbs_radau *p, casadi_real h, const casadi_real *courses, casadi_real *reals)
{
    mbs_work w;
    casadi_int i, j, k;
    w.p = p, w.h = h, w.courses = courses, w.r = p->n + 2 * p->e, w.size = p->s * w.r;
    w.matrix = reals, w.right = w.matrix + w.size * w.size, w.square = w.right + w.size;
    w.B = w.square + p->s * p->s, w.by_q = w.B + p->n * p->e, w.by_v = w.by_q + w.r * p->n;
    w.by_mu = w.by_v + w.r * p->n, w.moving = w.by_mu + w.r * p->e;
    for (i = 0; i < p->s; ++i)
        for (k = 0; k < p->s; ++k) {
            casadi_real sum = 0;
            for (j = 0; j < p->s; ++j)
                sum += p->A[i * p->s + j] * p->A[j * p->s + k];
            w.square[i * p->s + k] = sum;
        }
    return w;
}

static int call(mbs_call kernel)
{
    return kernel.f ? kernel.f(kernel.arg, kernel.res, 0, 0, 0) : 0;
}

/* Write a matrix row by row, times a factor, into an array of zeros. */
static void fill(mbs_entries entries, casadi_real factor, casadi_real *full)
{
    casadi_int k;
    for (k = 0; k < entries.entries; ++k)
        full[entries.place[k]] = factor * entries.nonzeros[k];
}

static void clear(casadi_int size, casadi_real *x)
{
    casadi_int k;
    for (k = 0; k < size; ++k)
        x[k] = 0;
}

static void copy(casadi_int size, const casadi_real *x, casadi_real *y)
{
    casadi_int k;
    for (k = 0; k < size; ++k)
        y[k] = x[k];
}

/* B = J^T at the start of the step; driven joints have no correction. */
static int write_correction(mbs_work *w, const casadi_real *q0, const casadi_real *v0)
{
    const mbs_radau *p = w->p;
    casadi_int i, k;
    int status;
    copy(p->n, q0, p->q);
    copy(p->n, v0, p->qd);
    status = call(p->rates);
    if (status)
        return status;
    clear(p->n * p->e, w->by_q);
    fill(p->J, 1, w->by_q);
    for (k = 0; k < p->e; ++k)
        for (i = 0; i < p->n; ++i)
            w->B[i * p->e + k] = w->by_q[k * p->n + i];
    for (k = 0; k < p->d; ++k)
        clear(p->e, w->B + p->driven[k] * p->e);
    return 0;
}

/* Write coordinates and velocities at the stages. */
static void place(mbs_work *w, const casadi_real *q0, const casadi_real *v0, const casadi_real *z, casadi_real *q,
                  casadi_real *v)
{
    const mbs_radau *p = w->p;
    const casadi_int n = p->n, s = p->s;
    casadi_int i, j, k, a;
    for (i = 0; i < s; ++i) {
        copy(n, v0, v + i * n);
        for (j = 0; j < s; ++j)
            for (a = 0; a < n; ++a)
                v[i * n + a] += w->h * p->A[i * s + j] * z[j * w->r + a];
        for (k = 0; k < p->d; ++k)
            v[i * n + p->driven[k]] = w->courses[(3 * i + 1) * p->d + k];
        for (a = 0; a < n; ++a) {
            casadi_real rate = v[i * n + a];
            for (k = 0; k < p->e; ++k)
                rate += w->B[a * p->e + k] * z[i * w->r + n + p->e + k];
            w->moving[i * n + a] = rate;
        }
    }
    for (i = 0; i < s; ++i) {
        copy(n, q0, q + i * n);
        for (j = 0; j < s; ++j)
            for (a = 0; a < n; ++a)
                q[i * n + a] += w->h * p->A[i * s + j] * w->moving[j * n + a];
        for (k = 0; k < p->d; ++k)
            q[i * n + p->driven[k]] = w->courses[3 * i * p->d + k];
    }
}

/* Evaluate the equations of a stage, and their derivatives. Equations of h are scaled by 1/h^2, of J v by 1/h. */
static int evaluate(mbs_work *w, casadi_int i, const casadi_real *z, const casadi_real *inputs, const casadi_real *q,
                    const casadi_real *v)
{
    const mbs_radau *p = w->p;
    const casadi_int n = p->n, e = p->e;
    const casadi_real position = 1 / (w->h * w->h), velocity = 1 / w->h;
    casadi_real *right = w->right + i * w->r;
    casadi_int k, a, b;
    int status;
    copy(n, q + i * n, p->q);
    copy(n, v + i * n, p->qd);
    copy(n, z + i * w->r, p->qdd);
    copy(e, z + i * w->r + n, p->lam);
    copy(p->m, inputs + i * p->m, p->v);
    for (k = 0; k < p->d; ++k)
        p->qdd[p->driven[k]] = w->courses[(3 * i + 2) * p->d + k];
    status = call(p->dynamics);
    status = status ? status : call(p->closure);
    status = status ? status : call(p->rates);
    if (status)
        return status;
    copy(n, p->Phi, right);
    for (k = 0; k < e; ++k) {
        right[n + k] = position * p->gap[k];
        right[n + e + k] = velocity * p->hd[k];
    }
    clear(w->r * n, w->by_q);
    clear(w->r * n, w->by_v);
    fill(p->K, 1, w->by_q);
    fill(p->G, position, w->by_q + n * n);
    fill(p->R, velocity, w->by_q + (n + e) * n);
    fill(p->C, 1, w->by_v);
    fill(p->J, velocity, w->by_v + (n + e) * n);
    for (a = 0; a < w->r; ++a)
        for (k = 0; k < e; ++k) {
            casadi_real sum = 0;
            for (b = 0; b < n; ++b)
                sum += w->by_q[a * n + b] * w->B[b * e + k];
            w->by_mu[a * e + k] = sum;
        }
    return 0;
}

/* Write the rows of a stage. */
static void write_rows(mbs_work *w, casadi_int i)
{
    const mbs_radau *p = w->p;
    const casadi_int n = p->n, e = p->e, s = p->s, r = w->r;
    casadi_real *rows = w->matrix + i * r * w->size;
    casadi_int a, b, k;
    for (k = 0; k < s; ++k) {
        const casadi_real once = w->h * p->A[i * s + k], twice = w->h * w->h * w->square[i * s + k];
        for (a = 0; a < r; ++a) {
            casadi_real *block = rows + a * w->size + k * r;
            for (b = 0; b < n; ++b)
                block[b] = twice * w->by_q[a * n + b] + once * w->by_v[a * n + b];
            clear(e, block + n);
            for (b = 0; b < e; ++b)
                block[n + e + b] = once * w->by_mu[a * e + b];
        }
    }
    for (k = 0; k < p->M.entries; ++k)
        rows[p->M.place[k] / n * w->size + i * r + p->M.place[k] % n] += p->M.nonzeros[k];
    for (k = 0; k < p->L.entries; ++k)
        rows[p->L.place[k] / e * w->size + i * r + n + p->L.place[k] % e] += p->L.nonzeros[k];
}

/* Make the accelerations of driven joints known: their change is 0. */
static void fix(mbs_work *w)
{
    const mbs_radau *p = w->p;
    casadi_int i, k, a;
    for (i = 0; i < p->s; ++i)
        for (k = 0; k < p->d; ++k) {
            const casadi_int own = i * w->r + p->driven[k];
            clear(w->size, w->matrix + own * w->size);
            for (a = 0; a < w->size; ++a)
                w->matrix[a * w->size + own] = 0;
            w->matrix[own * w->size + own] = 1;
            w->right[own] = 0;
        }
}

casadi_int mbs_radau_step(const mbs_radau *p, mbs_radau_end end, casadi_real h, const casadi_real *inputs,
                          const casadi_real *courses, const casadi_real *q0, const casadi_real *v0,
                          const casadi_real *weights, casadi_real *z, casadi_real *q, casadi_real *v,
                          casadi_real *reals, casadi_int *integers)
{
    mbs_work w = open_work(p, h, courses, reals);
    casadi_real last = INFINITY;
    casadi_int turn, i, a;
    if (p->e && write_correction(&w, q0, v0))
        return 0;
    for (turn = 1; turn <= end.most; ++turn) {
        casadi_real size = 0;
        place(&w, q0, v0, z, q, v);
        for (i = 0; i < p->s; ++i) {
            if (evaluate(&w, i, z, inputs, q, v))
                return 0;
            write_rows(&w, i);
        }
        fix(&w);
        if (mbs_factorise(1, w.size, w.matrix, integers))
            return 0;
        mbs_solve(1, w.size, w.matrix, integers, 1, w.right);
        for (a = 0; a < w.size; ++a) {
            const casadi_real change = fabs(w.right[a]) * weights[a % w.r];
            z[a] -= w.right[a];
            size = change > size || change != change ? change : size; /* NaN stays */
        }
        if (!(size - size == 0))
            return 0;
        if (size <= end.converged || (last / 2 < size && size <= end.noise)) {
            place(&w, q0, v0, z, q, v);
            return turn;
        }
        last = size;
    }
    return 0;
}
