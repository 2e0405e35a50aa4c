/* Impulses of contacts with dry friction: see mbs_cone.h. */
#include "mbs_cone.h"
#include "mbs_dense.h"

#include <math.h>

#define ROUNDING 1e-14 /* a residual that is as small is not made smaller, */
#define FINE 1e-12     /* nor one that Newton's method left so small */
#define SHIFTS 3       /* of the diagonal, in turn */
#define SWEEPS 10      /* of Gauss-Seidel, before Newton's method */
#define STEPS 12       /* of Newton's method in a row */
#define ROUNDS 60      /* of both, with more sweeps each */
#define EAGER 4        /* rounds that go on to FINE */
#define CUTS 5         /* of a step of Newton's method in halves */
#define LEAPS 40       /* whole steps, whatever the residual: points that share a load badly change their modes so */

static const casadi_real SHIFT[SHIFTS] = {1e-7, 1e-5, 1e-9};

typedef struct {
    const mbs_cone *p;
    casadi_real scale;                                     /* of impulses */
    casadi_real shift;                                     /* of the diagonal */
    casadi_real *rho, *w, *gap, *trial, *best, *kept, *matrix; /* rows; rows x rows */
    casadi_int *pivots;
} mbs_solver;

casadi_int mbs_cone_reals(casadi_int rows)
{
    return 6 * rows + rows * rows;
}

casadi_int mbs_cone_integers(casadi_int rows)
{
    return rows;
}

static casadi_real find_speed(const mbs_cone *p, casadi_int row, const casadi_real *P)
{
    const casadi_real *W = p->W + row * p->rows;
    casadi_real sum = p->free[row];
    casadi_int k;
    for (k = 0; k < p->rows; ++k)
        sum += W[k] * P[k];
    return sum;
}

static casadi_real clip(casadi_real x, casadi_real bound)
{
    return x > bound ? bound : x < -bound ? -bound : x;
}

/* Shorten a vector of two entries to a length. */
static void shorten(casadi_real length, casadi_real *t)
{
    const casadi_real own = hypot(t[0], t[1]);
    if (own > length)
        t[0] *= length / own, t[1] *= length / own;
}

/* Write rho, and the scale of impulses at a guess. */
static void scale(mbs_solver *s, const casadi_real *P)
{
    const mbs_cone *p = s->p;
    casadi_real most = 0;
    casadi_int i, k;
    for (i = 0; i < p->rows; ++i)
        most = fmax(most, p->W[i * (p->rows + 1)]);
    s->scale = 0;
    for (i = 0; i < p->rows; ++i) {
        s->rho[i] = most > 0 ? 1 / fmax(p->W[i * (p->rows + 1)], 1e-12 * most) : 1;
        s->scale = fmax(s->scale, s->rho[i] * fabs(p->free[i]));
    }
    for (k = 0; k < p->blocks; ++k)
        if (p->kind[k] == MBS_TOUCH) { /* friction acts alike in all directions of the plane */
            const casadi_int t = p->first[k] + 1, n = p->rows;
            const casadi_real a = p->W[t * (n + 1)], d = p->W[(t + 1) * (n + 1)], b = p->W[t * n + t + 1];
            const casadi_real largest = (a + d) / 2 + hypot((a - d) / 2, b);
            s->rho[t] = s->rho[t + 1] = 1 / fmax(largest, 1e-12 * most);
        }
    for (i = 0; i < p->rows; ++i)
        s->scale = fmax(s->scale, fabs(P[i]));
}

/* Write P - project(P - rho w) of all rows; return the largest. */
static casadi_real measure(mbs_solver *s, const casadi_real *P)
{
    const mbs_cone *p = s->p;
    casadi_real most = 0;
    casadi_int i, k;
    for (i = 0; i < p->rows; ++i)
        s->w[i] = find_speed(p, i, P);
    for (k = 0; k < p->blocks; ++k) {
        const casadi_int r = p->first[k];
        const casadi_real y = P[r] - s->rho[r] * s->w[r];
        casadi_real t[2];
        if (p->kind[k] == MBS_BRAKE) {
            s->gap[r] = P[r] - clip(y, p->grip[k]);
            continue;
        }
        s->gap[r] = P[r] - fmax(0, y);
        if (p->kind[k] == MBS_PUSH)
            continue;
        t[0] = P[r + 1] - s->rho[r + 1] * s->w[r + 1], t[1] = P[r + 2] - s->rho[r + 2] * s->w[r + 2];
        shorten(p->grip[k] * fmax(0, y), t);
        s->gap[r + 1] = P[r + 1] - t[0], s->gap[r + 2] = P[r + 2] - t[1];
    }
    for (i = 0; i < p->rows; ++i)
        most = s->gap[i] - s->gap[i] == 0 ? fmax(most, fabs(s->gap[i])) : INFINITY;
    return most;
}

/* Go through all blocks once, each by the impulses of the others. */
static void sweep(mbs_solver *s, casadi_real *P)
{
    const mbs_cone *p = s->p;
    casadi_int k;
    for (k = 0; k < p->blocks; ++k) {
        const casadi_int r = p->first[k];
        const casadi_real y = P[r] - s->rho[r] * find_speed(p, r, P);
        casadi_real t[2];
        P[r] = p->kind[k] == MBS_BRAKE ? clip(y, p->grip[k]) : fmax(0, y);
        if (p->kind[k] != MBS_TOUCH)
            continue;
        t[0] = P[r + 1] - s->rho[r + 1] * find_speed(p, r + 1, P);
        t[1] = P[r + 2] - s->rho[r + 2] * find_speed(p, r + 2, P);
        shorten(p->grip[k] * P[r], t);
        P[r + 1] = t[0], P[r + 2] = t[1];
    }
}

/* Write the row x of y = P - rho w differentiated by P, times a factor, onto a row of the matrix. */
static void add_row(mbs_solver *s, casadi_int row, casadi_int of, casadi_real factor)
{
    const casadi_int n = s->p->rows;
    const casadi_real *W = s->p->W + of * n;
    casadi_real *to = s->matrix + row * n;
    casadi_int k;
    for (k = 0; k < n; ++k)
        to[k] -= factor * s->rho[of] * W[k];
    to[of] += factor * (1 - s->shift);
}

/* Write 1 - dproject dy of all rows. */
static void differentiate(mbs_solver *s, const casadi_real *P)
{
    const mbs_cone *p = s->p;
    const casadi_int n = p->rows;
    casadi_int i, k;
    for (i = 0; i < n * n; ++i)
        s->matrix[i] = 0;
    for (k = 0; k < p->blocks; ++k) {
        const casadi_int r = p->first[k];
        const casadi_real y = P[r] - s->rho[r] * s->w[r];
        casadi_real t[2], length, radius;
        int a, b;
        if (p->kind[k] == MBS_BRAKE ? fabs(y) <= p->grip[k] : y > 0)
            add_row(s, r, r, 1);
        if (p->kind[k] != MBS_TOUCH || !(y > 0))
            continue;
        t[0] = P[r + 1] - s->rho[r + 1] * s->w[r + 1], t[1] = P[r + 2] - s->rho[r + 2] * s->w[r + 2];
        length = hypot(t[0], t[1]), radius = p->grip[k] * y;
        if (length <= radius) {
            add_row(s, r + 1, r + 1, 1), add_row(s, r + 2, r + 2, 1);
            continue;
        }
        for (a = 0; a < 2; ++a) {
            for (b = 0; b < 2; ++b)
                add_row(s, r + 1 + a, r + 1 + b, radius / length * ((a == b) - t[a] / length * (t[b] / length)));
            add_row(s, r + 1 + a, r, p->grip[k] * t[a] / length);
        }
    }
    for (i = 0; i < n * n; ++i)
        s->matrix[i] = (i % (n + 1) == 0) - s->matrix[i];
}

/* Write the step of Newton's method at P; return whether there is none. */
static int find_step(mbs_solver *s, const casadi_real *P, mbs_cone_effort *effort)
{
    const casadi_int n = s->p->rows;
    casadi_int i;
    measure(s, P);
    differentiate(s, P);
    ++effort->steps;
    for (i = 0; i < n; ++i)
        s->best[i] = s->gap[i];
    if (mbs_factorise(1, n, s->matrix, s->pivots))
        return 1;
    mbs_solve(1, n, s->matrix, s->pivots, 1, s->best);
    return 0;
}

/* Take steps of Newton's method while they make the residual smaller; return it. */
static casadi_real iterate(mbs_solver *s, casadi_real *P, casadi_real found, mbs_cone_effort *effort)
{
    const casadi_int n = s->p->rows;
    casadi_int i, step, cut;
    for (step = 0; step < STEPS && found > ROUNDING * s->scale; ++step) {
        casadi_real part = 1, next = found;
        if (find_step(s, P, effort))
            return found;
        for (cut = 0; cut < CUTS; ++cut, part /= 2) {
            for (i = 0; i < n; ++i)
                s->trial[i] = P[i] - part * s->best[i];
            next = measure(s, s->trial);
            if (next < found)
                break;
        }
        if (!(next < found))
            return found;
        for (i = 0; i < n; ++i)
            P[i] = s->trial[i];
        found = next;
    }
    return found;
}

/* Take whole steps of Newton's method from `part` P; keep the best place, and return its residual. */
static casadi_real leap(mbs_solver *s, casadi_real *P, casadi_real part, casadi_real found, mbs_cone_effort *effort)
{
    const casadi_int n = s->p->rows;
    casadi_int i, step;
    for (i = 0; i < n; ++i)
        s->kept[i] = P[i], s->trial[i] = part * P[i];
    for (step = 0; step < LEAPS && found > ROUNDING * s->scale; ++step) {
        casadi_real next;
        if (find_step(s, s->trial, effort))
            break;
        for (i = 0; i < n; ++i)
            s->trial[i] -= s->best[i];
        next = measure(s, s->trial);
        if (!(next < INFINITY))
            break;
        if (next < found) {
            for (i = 0; i < n; ++i)
                s->kept[i] = s->trial[i];
            found = next;
        }
    }
    for (i = 0; i < n; ++i)
        P[i] = s->kept[i];
    return found;
}

int mbs_cone_solve(const mbs_cone *p, casadi_real tolerance, casadi_real *P, mbs_cone_effort *effort,
                   casadi_real *reals, casadi_int *integers)
{
    const casadi_int n = p->rows;
    mbs_solver s;
    casadi_real found;
    casadi_int round, k;
    s.p = p, s.rho = reals, s.w = s.rho + n, s.gap = s.w + n, s.trial = s.gap + n, s.best = s.trial + n;
    s.kept = s.best + n, s.matrix = s.kept + n, s.pivots = integers, s.shift = SHIFT[0];
    scale(&s, P);
    found = measure(&s, P);
    for (round = 0; round < ROUNDS && found > ROUNDING * s.scale; ++round) {
        for (k = 0; k < SWEEPS * (round + 1) && round > 0; ++k, ++effort->sweeps)
            sweep(&s, P);
        scale(&s, P); /* a guess may have been far too large */
        found = iterate(&s, P, measure(&s, P), effort);
        for (k = 0; k < 2 * SHIFTS && round > 0 && found > fmin(FINE, tolerance) * s.scale; ++k) {
            s.shift = SHIFT[k / 2];
            found = leap(&s, P, k % 2 == 0, found, effort);
        }
        s.shift = SHIFT[0];
        if (found <= (round < EAGER ? fmin(FINE, tolerance) : tolerance) * s.scale)
            break;
    }
    effort->residual = s.scale > 0 ? found / s.scale : found;
    return !(found <= tolerance * s.scale);
}
