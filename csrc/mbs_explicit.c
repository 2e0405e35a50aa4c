/* Integrate a motion explicitly, with closed loops or without. */
#include "mbs_explicit.h"
#include "mbs_entries.h"
#include "mbs_least.h"
#include "mbs_loads.h"

#include <math.h>

#define RANK 1e-8     /* a pivot of J below this part of the first is 0: rounding over it is 1e-8 of the accelerations */
#define NEAR 0.02     /* a smallest pivot below this part of the first: stages are closed too */
#define SINGULAR 1e-4 /* below this part: accelerations by orthogonal decomposition, which squares no pivot */
#define NOISY 1e-6    /* of the accelerations: the most that is taken for rounding */
#define WORN 0.5      /* of the determinant of the best dependent joints: where the present ones have less, they are changed */
#define ITERATIONS 25 /* of Newton's method */
#define SLOW 0.1      /* a change above this part of the one before: J is computed anew */
#define SETTLED 1e-15 /* a change below this, absolute or relative, ends an iteration, */
#define NOISE 1e-11   /* and one below this where changes shrink no more: rounding over a small pivot */
#define JUMP 0.1      /* of the speeds: closing a loop may not change them by more in a step */
#define STILL 1e-10 /* m/s, rad/s: slower velocities are rounding of rest, and may change by any part of themselves */
#define CONTRADICTION 1e-6 /* of the equations: those left out at a singular pose must hold to this part */
#define SHORTEST 1e-14     /* of the time */
#define HALVINGS 40        /* to leave a guard that is 0 at the start */
#define CLOSEST 4          /* roundings of a step: the place of an event in it */

typedef struct {
    const mbs_explicit *p;
    const mbs_manner *how;
    mbs_outcome *out;
    casadi_int free;     /* joints that are not driven, */
    casadi_int *moves;   /* by their entries of qd */
    casadi_int *depends; /* e dependent joints */
    casadi_int *best;    /* n: the dependent joints that would be best, then others */
    casadi_int *row;     /* e: exchanged rows of LU */
    casadi_real *J;      /* e x n */
    casadi_real *B;      /* n x e: equations in the free joints, or e x e: in the dependent ones */
    casadi_real *M;      /* n x n: its Cholesky factor for free joints */
    casadi_real *x, *g, *saved, *sum, *k;
    mbs_least least;
    mbs_load_room load;
    const casadi_real *inputs, *courses; /* rows for each stage, or NULL */
    casadi_int row_of_step;
    casadi_real last;  /* the smallest pivot of J, relative to the largest: small near a singular pose; */
    casadi_real least_pivot; /* the least of these in a step */
    casadi_real gap;   /* the largest |h| before the last closing */
    casadi_real volume; /* the logarithm of the dependent joints' determinant */
    casadi_real *first, *tried;         /* nq + n: the rates at the start of a step, the end of a shorter one */
    casadi_real *hold;                  /* n: the forces that hold joints, of a mechanism with loops */
    casadi_real *start, *end, *between; /* guards and then their rates, in a step */
    casadi_real lowest, fraction; /* of the guards at the stages of a step, and where in it */
    int is_watching;   /* stages note the lowest guard */
    int is_ready;      /* J is decomposed, or dependent joints are chosen */
} mbs_run;

/* Evaluate a kernel; a mechanism without loops has none of theirs, and they would compute nothing. */
static int call(mbs_call kernel)
{
    return kernel.f ? kernel.f(kernel.arg, kernel.res, 0, 0, 0) : 0;
}

static casadi_int find_largest(casadi_int size, const casadi_real *x)
{
    casadi_int i, best = 0;
    for (i = 1; i < size; ++i)
        if (fabs(x[i]) > fabs(x[best]) || x[i] != x[i]) /* NaN stays */
            best = i;
    return best;
}

static casadi_real measure(casadi_int size, const casadi_real *x)
{
    return size ? fabs(x[find_largest(size, x)]) : 0;
}

static int fail(mbs_run *r, int status, const casadi_real *equations)
{
    r->out->loop = r->p->e ? (int)r->p->loop[find_largest(r->p->e, equations)] : 0;
    return status;
}

casadi_int mbs_explicit_reals(const mbs_explicit *p, casadi_int stages)
{
    const casadi_int size = p->nq + p->n;
    const casadi_int guards = p->modes ? 2 * size + 6 * p->modes->guards + p->n : 0;
    const casadi_int loads = p->modes && p->modes->loads ? mbs_loads_reals(p->modes->loads, p->n) : 0;
    return 2 * p->e * p->n + p->n * p->n + 5 * p->e + 4 * p->n + size * (stages + 1) + guards + loads;
}

casadi_int mbs_explicit_integers(const mbs_explicit *p)
{
    return 2 * p->n + 3 * p->e + (p->modes && p->modes->loads ? 2 * p->n : 0);
}

static mbs_run open_run(const mbs_explicit *p, const mbs_manner *how, casadi_real *reals, casadi_int *integers,
                        mbs_outcome *out)
{
    mbs_run r;
    casadi_int i, k;
    r.p = p, r.how = how, r.out = out, r.gap = 0, r.inputs = r.courses = 0, r.row_of_step = 0, r.is_ready = 0, r.last = r.least_pivot = 1, r.free = 0;
    r.moves = integers, r.depends = r.moves + p->n, r.best = r.depends + p->e, r.row = r.best + p->n, r.least.column = r.row + p->e;
    r.J = reals, r.B = r.J + p->e * p->n, r.M = r.B + p->e * p->n, r.least.factor = r.M + p->n * p->n;
    r.least.size = r.least.factor + p->e, r.least.y = r.least.size + 2 * p->e, r.x = r.least.y + p->n;
    r.g = r.x + 2 * p->n, r.saved = r.g + 2 * p->e, r.sum = r.saved + p->n, r.k = r.sum + p->nq + p->n;
    r.least.A = r.B, r.least.e = p->e, r.least.n = 0, r.least.rank = 0;
    r.first = r.k + (p->nq + p->n) * how->stages, r.tried = r.first + p->nq + p->n, r.start = r.tried + p->nq + p->n;
    r.end = r.start + (p->modes ? 2 * p->modes->guards : 0), r.between = r.end + (r.end - r.start);
    r.hold = r.between + (r.end - r.start);
    if (p->modes && p->modes->loads)
        r.load = mbs_open_loads(p->modes->loads, p->n, r.hold + p->n, r.least.column + p->e);
    r.lowest = r.fraction = 0, r.is_watching = 0;
    for (i = 0, k = 0; i < p->n; ++i)
        if (k < p->d && p->driven[k] == i)
            ++k;
        else if (!p->modes || !p->modes->held[i])
            r.moves[r.free++] = i;
    out->evaluations = out->rejected = out->switches = out->steps = 0;
    out->status = out->loop = 0;
    out->pivot = 1, out->gap = 0;
    return r;
}

/* Note the smallest pivot of J, as a part of the largest. */
static void see(mbs_run *r, casadi_real pivot)
{
    r->last = pivot;
    r->least_pivot = pivot < r->least_pivot ? pivot : r->least_pivot;
    r->out->pivot = pivot < r->out->pivot ? pivot : r->out->pivot;
}

/* --- the equations of loops ---------------------------------------------------------------------------------------- */

static int differentiate(mbs_run *r)
{
    const int status = call(r->p->jacobian);
    mbs_fill_entries(r->p->J, r->p->e * r->p->n, r->J);
    return status;
}

/* Write to `best` the dependent joints with the largest pivots of J, by elimination with exchanges of rows and columns in B;
 * return the logarithm of the size of their determinant. */
static casadi_real find_best(mbs_run *r)
{
    const casadi_int e = r->p->e, f = r->free;
    casadi_real volume = 0;
    casadi_int i, j, k;
    for (j = 0; j < f; ++j)
        r->best[j] = r->moves[j];
    for (i = 0; i < e; ++i)
        for (j = 0; j < f; ++j)
            r->B[i * f + j] = r->J[i * r->p->n + r->moves[j]];
    for (k = 0; k < e; ++k) {
        casadi_int at = k * f + k, row, column;
        for (i = k; i < e; ++i)
            for (j = k; j < f; ++j)
                if (fabs(r->B[i * f + j]) > fabs(r->B[at]))
                    at = i * f + j;
        row = at / f, column = at % f;
        if (!(fabs(r->B[at]) > 0))
            break;
        volume += log(fabs(r->B[at]));
        for (j = 0; j < f; ++j) {
            const casadi_real x = r->B[k * f + j];
            r->B[k * f + j] = r->B[row * f + j];
            r->B[row * f + j] = x;
        }
        for (i = 0; i < e; ++i) {
            const casadi_real x = r->B[i * f + k];
            r->B[i * f + k] = r->B[i * f + column];
            r->B[i * f + column] = x;
        }
        i = r->best[k], r->best[k] = r->best[column], r->best[column] = i;
        for (i = k + 1; i < e; ++i) {
            const casadi_real factor = r->B[i * f + k] / r->B[k * f + k];
            for (j = k; j < f; ++j)
                r->B[i * f + j] -= factor * r->B[k * f + j];
        }
    }
    return volume;
}

static casadi_real factorise_dependent(mbs_run *r)
{
    const casadi_int e = r->p->e;
    casadi_int i, j;
    for (i = 0; i < e; ++i)
        for (j = 0; j < e; ++j)
            r->B[i * e + j] = r->J[i * r->p->n + r->depends[j]];
    return mbs_lu_factorise(e, r->B, r->row, &r->volume);
}

/* Write to least.A the equations in free joints, with the mass matrix's factor L as B = J L^-T, and decompose them. */
static void factorise_free(mbs_run *r, int weighs)
{
    const casadi_int e = r->p->e, f = r->free;
    casadi_int i, j;
    for (i = 0; i < e; ++i) {
        for (j = 0; j < f; ++j)
            r->B[i * f + j] = r->J[i * r->p->n + r->moves[j]];
        if (weighs)
            mbs_cholesky_forward(f, r->M, r->B + i * f);
    }
    r->least.n = f;
    see(r, mbs_least_factorise(&r->least, RANK));
}

/* Compute the Cholesky factor of the mass matrix of free joints. */
static int factorise_mass(mbs_run *r)
{
    const casadi_int n = r->p->n, f = r->free;
    const int status = call(r->p->mass);
    casadi_int i, j;
    int lost;
    if (status)
        return status;
    mbs_fill_entries(r->p->M, n * n, r->M);
    for (i = 0; i < f && f < n; ++i) /* in place: free joints stand in order */
        for (j = 0; j <= i; ++j)
            r->M[i * f + j] = r->M[r->moves[i] * n + r->moves[j]];
    lost = mbs_cholesky(f, r->M);
    return lost ? (int)r->moves[lost - 1] + 1 : 0;
}

/* Compute and decompose J at q. */
static int prepare(mbs_run *r)
{
    int status = differentiate(r);
    if (status)
        return status;
    if (r->how->keeping == MBS_PARTITIONING) {
        see(r, factorise_dependent(r));
        return r->last > RANK ? 0 : fail(r, MBS_DEPENDENT, r->J);
    }
    if (r->how->keeping == MBS_MASS_PROJECTION && (status = factorise_mass(r)) != 0)
        return status;
    factorise_free(r, r->how->keeping == MBS_MASS_PROJECTION);
    return 0;
}

/* Be ready for a step from q: choose dependent joints where the present ones are worn. A choice holds for a whole step, since
 * its stages must be corrected in one way. */
static int renew(mbs_run *r)
{
    casadi_real volume;
    casadi_int k;
    int status = 0;
    if (!r->p->e || r->how->keeping == MBS_BAUMGARTE)
        return 0;
    if (r->how->keeping != MBS_PARTITIONING) {
        status = r->is_ready ? 0 : prepare(r);
        r->is_ready = 1;
        return status;
    }
    status = differentiate(r);
    if (status)
        return status;
    volume = find_best(r);
    see(r, r->is_ready ? factorise_dependent(r) : 0);
    if (!(r->last > 0 && r->volume > volume + log(WORN))) {
        for (k = 0; k < r->p->e; ++k)
            r->depends[k] = r->best[k];
        r->out->switches += r->is_ready;
        see(r, factorise_dependent(r));
    }
    r->is_ready = 1;
    return r->last > RANK ? 0 : fail(r, MBS_DEPENDENT, r->J);
}

/* Write the change of velocities (n, in x) that changes the equations by -g, with the J that is decomposed. */
static void correct(mbs_run *r, const casadi_real *g)
{
    const casadi_int n = r->p->n, e = r->p->e;
    casadi_int k;
    for (k = 0; k < e; ++k)
        r->g[k] = -g[k];
    for (k = 0; k < n; ++k)
        r->x[k] = 0;
    if (r->how->keeping == MBS_PARTITIONING) {
        mbs_lu_solve(e, r->B, r->row, r->g, r->g + e);
        for (k = 0; k < e; ++k)
            r->x[r->depends[k]] = r->g[k];
        return;
    }
    mbs_least_solve(&r->least, r->g, r->x + n);
    if (r->how->keeping == MBS_MASS_PROJECTION)
        mbs_cholesky_backward(r->free, r->M, r->x + n);
    for (k = 0; k < r->free; ++k)
        r->x[r->moves[k]] = r->x[n + k];
}

/* Move q along velocities x for a unit of time. */
static int move(mbs_run *r)
{
    const mbs_explicit *p = r->p;
    casadi_int k;
    int status = 0;
    if (!p->change.f) {
        for (k = 0; k < p->n; ++k)
            p->q[k] += r->x[k];
        return 0;
    }
    for (k = 0; k < p->n; ++k) {
        r->saved[k] = p->qd[k];
        p->qd[k] = r->x[k];
    }
    status = call(p->change);
    for (k = 0; k < p->nq && !status; ++k)
        p->q[k] += p->qt[k];
    for (k = 0; k < p->n; ++k)
        p->qd[k] = r->saved[k];
    return status;
}

/* Put q on h = 0. `way` adds up the changes since J was computed. */
static int close_coordinates(mbs_run *r, casadi_real *way)
{
    const mbs_explicit *p = r->p;
    casadi_real before = 0;
    casadi_int i;
    int status = prepare(r);
    *way = 0;
    for (i = 0; i < ITERATIONS && !status; ++i) {
        casadi_real change, size;
        status = call(p->closure);
        if (status)
            return status;
        r->gap = i ? r->gap : measure(p->e, p->h);
        correct(r, p->h);
        change = measure(p->n, r->x);
        size = change / (1 + measure(p->nq, p->q));
        if (!(change - change == 0))
            return fail(r, MBS_OPEN, p->h);
        status = move(r);
        *way += change;
        if (status || size <= SETTLED || 10 * size * *way <= SETTLED)
            return status;
        if (i && size > SLOW * before) {
            if (size <= NOISE)
                return 0;
            status = prepare(r);
            *way = 0;
        }
        before = size;
    }
    return status ? status : fail(r, MBS_OPEN, p->h);
}

/* Put qd on J qd = 0, with J at most `way` away. */
static int close_velocities(mbs_run *r, casadi_real way)
{
    const mbs_explicit *p = r->p;
    casadi_real before = 0;
    casadi_int i, k;
    int status = way > 1e-3 ? prepare(r) : 0;
    for (i = 0; i < ITERATIONS && !status; ++i) {
        casadi_real change, size;
        status = call(p->rates);
        if (status)
            return status;
        correct(r, p->hd);
        change = measure(p->n, r->x);
        size = change / (1 + measure(p->n, p->qd));
        if (!(change - change == 0))
            return fail(r, MBS_OPEN, p->hd);
        for (k = 0; k < p->n; ++k)
            p->qd[k] += r->x[k];
        if (size <= SETTLED || 10 * size * way <= SETTLED)
            return 0;
        if (i && size > SLOW * before) {
            if (size <= NOISE)
                return 0;
            status = prepare(r);
        }
        before = size;
    }
    return status ? status : fail(r, MBS_OPEN, p->hd);
}

static int restore(mbs_run *r)
{
    casadi_real way;
    const int status = close_coordinates(r, &way);
    return status ? status : close_velocities(r, way);
}

/* Put driven joints where they are at time t of stage i. */
static int guide(mbs_run *r, casadi_real t, casadi_int i)
{
    const mbs_explicit *p = r->p;
    casadi_int k;
    if (!r->courses && r->how->guide && r->how->guide(t))
        return MBS_STOPPED;
    for (k = 0; k < 3 * p->d && r->courses; ++k)
        p->course[k] = r->courses[(r->row_of_step + i) * 3 * p->d + k];
    for (k = 0; k < p->d; ++k) {
        p->q[p->place[k]] = p->course[k];
        p->qd[p->driven[k]] = p->course[p->d + k];
    }
    return 0;
}

/* --- accelerations ------------------------------------------------------------------------------------------------- */

/* Return the friction of a joint that slides. */
static casadi_real brake(const mbs_explicit *p, casadi_int i)
{
    const mbs_modes *m = p->modes;
    casadi_real x;
    if (!m || m->sign[i] == 0)
        return 0;
    x = p->qd[i] * m->slowness[i];
    return -m->sign[i] * (m->torque[i] + (m->fall[i] != 0 ? m->fall[i] * exp(-x * x) : 0));
}

/* Write the forces of bearings at accelerations (n), at the pose whose turns are there. */
static int bear(mbs_run *r, const casadi_real *qdd, casadi_real *forces)
{
    casadi_int k;
    int status;
    for (k = 0; k < r->p->n; ++k)
        r->p->rest[k] = qdd[k];
    status = call(r->p->modes->loads->reactions);
    if (!status)
        mbs_bear(r->p->modes->loads, &r->load, forces);
    return status;
}

/* Write the rotations of joints' frames. */
static int turn(mbs_run *r)
{
    const mbs_loads *m = r->p->modes->loads;
    const int status = call(m->poses);
    mbs_fill_entries(m->turn, 3 * m->axes, r->load.turn);
    return status;
}

/* Write the accelerations by a load of 1 on a sliding joint. */
static void press(mbs_run *r, casadi_int joint, casadi_real *column)
{
    const mbs_explicit *p = r->p;
    const mbs_modes *m = p->modes;
    const casadi_real s = p->qd[joint] * m->slowness[joint], fall = m->loads->fall[joint];
    const casadi_real force = -m->sign[joint] * (m->loads->coefficient[joint] + (fall != 0 ? fall * exp(-s * s) : 0));
    casadi_real *y = r->x + p->n;
    casadi_int k;
    for (k = 0; k < r->free; ++k)
        y[k] = r->moves[k] == joint ? force : 0;
    mbs_cholesky_forward(r->free, r->M, y);
    mbs_cholesky_backward(r->free, r->M, y);
    for (k = 0; k < p->n; ++k)
        column[k] = 0;
    for (k = 0; k < r->free; ++k)
        column[r->moves[k]] = y[k];
}

/* Add the friction by loads to the accelerations in x, with the factor of the mass matrix. Forces of bearings are affine in
 * the accelerations: each column of D is a difference, by a load of the size of the reactions. */
static int rub(mbs_run *r)
{
    const mbs_explicit *p = r->p;
    const mbs_loads *m = p->modes->loads;
    mbs_load_room *l = &r->load;
    const casadi_int n = p->n, size = 3 * m->bearings;
    casadi_real scale;
    casadi_int i, j, k;
    int status;
    for (i = 0, l->d = 0; i < n; ++i)
        if (p->modes->sign[i] != 0 && m->hold[i] > 0)
            l->sliding[l->d++] = i;
    if (!l->d)
        return 0;
    if ((status = turn(r)) != 0 || (status = bear(r, r->x, l->c)) != 0)
        return status;
    scale = measure(m->force.entries, m->force.nonzeros);
    scale = scale > 0 ? scale : 1;
    for (j = 0; j < l->d; ++j) {
        casadi_real *column = l->column + j * n, *D = l->D + j * size;
        press(r, l->sliding[j], column);
        for (k = 0; k < n; ++k)
            r->saved[k] = r->x[k] + scale * column[k];
        if ((status = bear(r, r->saved, D)) != 0)
            return status;
        for (k = 0; k < size; ++k)
            D[k] = (D[k] - l->c[k]) / scale;
    }
    if ((status = mbs_find_loads(m, l)) != 0)
        return status;
    for (j = 0; j < l->d; ++j)
        for (k = 0; k < n; ++k)
            r->x[k] += l->N[j] * l->column[j * n + k];
    return 0;
}

/* Compute accelerations (n, in x) from M, c, J and gamma, with Baumgarte's terms, by the joints' own ones that loops change
 * least in the norm of M. */
static int solve(mbs_run *r)
{
    const mbs_explicit *p = r->p;
    const casadi_int n = p->n, e = p->e, f = r->free;
    const casadi_real alpha = r->how->alpha, beta = r->how->beta;
    casadi_real scale;
    casadi_int i, k;
    int status;
    for (k = 0; k < n; ++k)
        p->rest[k] = 0;
    for (k = 0; k < p->d; ++k)
        p->rest[p->driven[k]] = p->course[2 * p->d + k];
    if ((status = call(p->residual)) != 0 || (status = factorise_mass(r)) != 0)
        return status;
    for (k = 0; k < n; ++k)
        r->x[k] = p->rest[k];
    for (k = 0; k < f; ++k)
        r->x[n + k] = brake(p, r->moves[k]) - p->r[r->moves[k]];
    mbs_cholesky_forward(f, r->M, r->x + n);
    mbs_cholesky_backward(f, r->M, r->x + n);
    for (k = 0; k < f; ++k)
        r->x[r->moves[k]] = r->x[n + k];
    if (!e)
        return p->modes && p->modes->loads ? rub(r) : 0;
    if ((status = differentiate(r)) != 0)
        return status;
    if (r->how->keeping == MBS_BAUMGARTE && ((status = call(p->closure)) != 0 || (status = call(p->rates)) != 0))
        return status;
    for (i = 0; i < e; ++i) {
        casadi_real sum = -p->gamma[i];
        for (k = 0; k < n; ++k)
            sum -= r->J[i * n + k] * r->x[k];
        if (r->how->keeping == MBS_BAUMGARTE)
            sum -= 2 * alpha * p->hd[i] + beta * beta * p->h[i];
        r->g[i] = sum;
    }
    scale = measure(e, r->g);
    factorise_free(r, 1);
    if (mbs_least_solve(&r->least, r->g, r->x + n) > CONTRADICTION * (1 + scale))
        return fail(r, MBS_DEPENDENT, r->g);
    mbs_cholesky_backward(f, r->M, r->x + n);
    for (k = 0; k < f; ++k)
        r->x[r->moves[k]] += r->x[n + k];
    return 0;
}

/* Write the derivative of (q, qd) at plant's q and qd. */
static int accelerate(mbs_run *r, casadi_real *rate)
{
    const mbs_explicit *p = r->p;
    casadi_int k;
    int status = 0, is_solved = 0;
    ++r->out->evaluations;
    if (p->direct.f && !p->modes && r->how->keeping != MBS_BAUMGARTE && r->last > SINGULAR) {
        status = call(p->direct);
        is_solved = !status;
        if (status && (status <= p->n || !p->e))
            return status;
    }
    if (!is_solved && (status = solve(r)) != 0)
        return status;
    for (k = 0; k < p->n; ++k)
        rate[p->nq + k] = is_solved ? p->qdd[k] : r->x[k];
    status = p->change.f ? call(p->change) : 0;
    for (k = 0; k < p->nq; ++k)
        rate[k] = p->change.f ? p->qt[k] : p->qd[k];
    return status;
}

/* --- steps --------------------------------------------------------------------------------------------------------- */

static void lay(mbs_run *r, const casadi_real *y)
{
    casadi_int k;
    for (k = 0; k < r->p->nq; ++k)
        r->p->q[k] = y[k];
    for (k = 0; k < r->p->n; ++k)
        r->p->qd[k] = y[r->p->nq + k];
}

static void take(const mbs_run *r, casadi_real *y)
{
    casadi_int k;
    for (k = 0; k < r->p->nq; ++k)
        y[k] = r->p->q[k];
    for (k = 0; k < r->p->n; ++k)
        y[r->p->nq + k] = r->p->qd[k];
}

/* Write y = x + h sum of weights[j] k_j, over the first `count` stages. */
static void combine(const mbs_run *r, casadi_int count, const casadi_real *weights, casadi_real h, const casadi_real *x,
                    casadi_real *y)
{
    const casadi_int size = r->p->nq + r->p->n;
    casadi_int c, j;
    for (c = 0; c < size; ++c)
        y[c] = 0;
    for (j = 0; j < count; ++j)
        if (weights[j] != 0)
            for (c = 0; c < size; ++c)
                y[c] += weights[j] * r->k[size * j + c];
    for (c = 0; c < size; ++c)
        y[c] = x ? x[c] + h * y[c] : h * y[c];
}

/* Take the forces of loops out of the residual r, which then holds the forces on held joints: J^T lam, with the lam that
 * leave nothing on free joints but their friction. */
static int subtract_loops(mbs_run *r)
{
    const mbs_explicit *p = r->p;
    casadi_int i, k;
    const int status = differentiate(r);
    if (status)
        return status;
    factorise_free(r, 0);
    for (k = 0; k < r->free; ++k)
        r->x[k] = p->r[r->moves[k]] - brake(p, r->moves[k]);
    mbs_least_weigh(&r->least, r->x, r->g);
    for (k = 0; k < p->n; ++k) {
        r->hold[k] = p->r[k];
        for (i = 0; i < p->e; ++i)
            r->hold[k] -= r->J[i * p->n + k] * r->g[i];
    }
    return 0;
}

/* Write the guards at the plant's state, then their rates; the rates of forces are 0. `rate` holds the rates of the state. */
static int guard(mbs_run *r, const casadi_real *rate, casadi_real *values)
{
    const mbs_explicit *p = r->p;
    const mbs_modes *m = p->modes;
    const casadi_real *hold = p->e ? r->hold : p->r;
    const mbs_loads *loads = m->loads;
    casadi_int k;
    int status = 0, is_held = 0;
    for (k = 0; k < m->guards; ++k)
        is_held |= m->kind[k] == MBS_FORCE;
    for (k = 0; k < p->n && is_held; ++k)
        p->rest[k] = rate[p->nq + k];
    if (is_held && (status = call(p->residual)) != 0)
        return status;
    if (is_held && p->e && (status = subtract_loops(r)) != 0)
        return status;
    if (is_held && loads && ((status = turn(r)) != 0 || (status = bear(r, rate + p->nq, r->load.c)) != 0))
        return status;
    for (k = 0; k < m->guards; ++k) {
        const casadi_int i = m->joint[k];
        const casadi_real x = m->kind[k] == MBS_PLACE ? p->q[m->place[k]] : m->kind[k] == MBS_SPEED ? p->qd[i] : hold[i];
        const casadi_real slope = m->kind[k] == MBS_PLACE ? p->qd[i] : m->kind[k] == MBS_SPEED ? rate[p->nq + i] : 0;
        values[k] = m->side[k] * (x - m->level[k]);
        if (loads && m->kind[k] == MBS_FORCE && loads->hold[i] > 0)
            values[k] += loads->hold[i] * mbs_add_loads(loads, r->load.c, i);
        values[m->guards + k] = m->side[k] * slope;
    }
    return 0;
}

/* Note where in a step a guard is lowest, at stage i. */
static int watch(mbs_run *r, casadi_int i)
{
    const casadi_int count = r->p->modes->guards;
    const int status = guard(r, r->k + (r->p->nq + r->p->n) * i, r->between);
    casadi_int k;
    for (k = 0; k < count && !status; ++k)
        if (r->between[k] < r->lowest) {
            r->lowest = r->between[k];
            r->fraction = r->how->c[i];
        }
    return status;
}

/* Compute the rates of stage i at time t and state y. */
static int evaluate(mbs_run *r, casadi_real t, casadi_int i, const casadi_real *y)
{
    casadi_int k;
    int status;
    lay(r, y);
    status = guide(r, t, i);
    if (!status && i && r->p->e
        && (r->how->keeping == MBS_PARTITIONING || (r->how->keeping != MBS_BAUMGARTE && r->last < NEAR)))
        status = restore(r);
    for (k = 0; k < r->p->m && r->inputs; ++k)
        r->p->v[k] = r->inputs[(r->row_of_step + i) * r->p->m + k];
    if (!status && !r->inputs && r->how->inputs && r->how->inputs(t))
        status = MBS_STOPPED;
    if (!status)
        status = accelerate(r, r->k + (r->p->nq + r->p->n) * i);
    return !status && i && r->is_watching ? watch(r, i) : status;
}

/* Take a step from x, whose rates are there if `is_ready`, to y; the stages are in k. */
static int step(mbs_run *r, casadi_real t, casadi_real h, const casadi_real *x, int is_ready, casadi_real *y)
{
    const casadi_int stages = r->how->stages, size = r->p->nq + r->p->n;
    casadi_int i;
    int status = 0;
    for (i = is_ready ? 1 : 0; i < stages && !status; ++i) {
        combine(r, i, r->how->A + i * stages, h, x, r->sum);
        status = evaluate(r, t + r->how->c[i] * h, i, r->sum);
    }
    if (status)
        return status;
    combine(r, stages, r->how->b, h, x, y);
    return mbs_is_finite(size, y) ? 0 : MBS_RUNAWAY;
}

/* Close the loops at the end of a step, whose first stage is in k. */
static int finish(mbs_run *r, casadi_real t, casadi_real h, casadi_real *y)
{
    const mbs_explicit *p = r->p;
    casadi_real speed = 0, jump = 0;
    casadi_int k;
    int status;
    if (!p->e && !p->d)
        return 0;
    lay(r, y);
    status = guide(r, t, r->how->stages);
    if (!status && p->e && r->how->keeping != MBS_BAUMGARTE)
        status = restore(r);
    if (status)
        return status;
    for (k = 0; k < p->n; ++k) {
        const casadi_real gain = fabs(y[p->nq + k]) + h * fabs(r->k[p->nq + k]), change = fabs(p->qd[k] - y[p->nq + k]);
        speed = gain > speed ? gain : speed;
        jump = change > jump ? change : jump;
    }
    if (p->e && r->how->keeping != MBS_BAUMGARTE && jump > JUMP * speed && jump > STILL) {
        lay(r, y);
        if ((status = guide(r, t, r->how->stages)) != 0 || (status = call(p->rates)) != 0)
            return status;
        return fail(r, MBS_BRANCHED, p->hd);
    }
    take(r, y);
    r->out->gap = p->e && r->gap > r->out->gap ? r->gap : r->out->gap;
    return 0;
}

/* Return the error of the step from x to y relative to the tolerances, in the root mean square. Near a singular pose,
 * where accelerations err by epsilon over the square of the smallest pivot, an error of this size is tolerated. */
static casadi_real estimate(mbs_run *r, casadi_real h, const casadi_real *x, const casadi_real *y)
{
    const casadi_int size = r->p->nq + r->p->n;
    const casadi_real noise = 100 * MBS_EPSILON / (r->least_pivot * r->least_pivot + 100 * MBS_EPSILON / NOISY);
    const casadi_real rounding = h * noise * measure(size, r->k);
    casadi_real squares[2] = {0, 0};
    casadi_int i, c;
    for (i = 0; i < r->how->estimates; ++i) {
        combine(r, r->how->stages, r->how->E + i * r->how->stages, 1, 0, r->sum);
        for (c = 0; c < size; ++c) {
            const casadi_real a = fabs(x[c]), b = fabs(y[c]);
            const casadi_real part = r->sum[c] / (r->how->atol + rounding + r->how->rtol * (a > b ? a : b));
            squares[i] += part * part;
        }
    }
    if (r->how->estimates == 1)
        return h * sqrt(squares[0] / (casadi_real)size);
    if (squares[0] == 0)
        return 0;
    return h * squares[0] / sqrt((squares[0] + 0.01 * squares[1]) * (casadi_real)size);
}

/* Choose a first step by the sizes of the first two derivatives (Hairer, Norsett, Wanner, section II.4). */
static int begin(mbs_run *r, casadi_real t, const casadi_real *x, casadi_real *h)
{
    const casadi_int size = r->p->nq + r->p->n;
    casadi_real d[3] = {0, 0, 0}, guess, most;
    casadi_int c;
    int status;
    for (c = 0; c < size; ++c) {
        const casadi_real scale = r->how->atol + r->how->rtol * fabs(x[c]);
        d[0] += x[c] / scale * (x[c] / scale);
        d[1] += r->k[c] / scale * (r->k[c] / scale);
    }
    guess = d[0] < 1e-10 * (casadi_real)size || d[1] < 1e-10 * (casadi_real)size ? 1e-6 : 0.01 * sqrt(d[0] / d[1]);
    for (c = 0; c < size; ++c)
        r->sum[c] = x[c] + guess * r->k[c];
    status = evaluate(r, t + guess, 1, r->sum);
    for (c = 0; c < size && !status; ++c) {
        const casadi_real part = (r->k[size + c] - r->k[c]) / (r->how->atol + r->how->rtol * fabs(x[c]));
        d[2] += part * part;
    }
    d[2] = sqrt(d[2] / (casadi_real)size) / guess;
    d[1] = sqrt(d[1] / (casadi_real)size);
    most = d[1] > d[2] ? d[1] : d[2];
    *h = most <= 1e-15 ? 1e-6 : pow(0.01 / most, 1 / (casadi_real)r->how->order);
    if (*h > 100 * guess)
        *h = 100 * guess;
    return status;
}

/* --- events -------------------------------------------------------------------------------------------------------- */

/* Take a step of length h from x to `tried`, and write the guards there to `values` and their rates; stage 0 is in `first`. */
static int try_step(mbs_run *r, casadi_real t, casadi_real h, const casadi_real *x, casadi_real *values)
{
    const casadi_int size = r->p->nq + r->p->n;
    casadi_int c;
    int status;
    for (c = 0; c < size; ++c)
        r->k[c] = r->first[c];
    status = step(r, t, h, x, 1, r->tried);
    if (!status)
        status = finish(r, t + h, h, r->tried);
    if (!status)
        status = evaluate(r, t + h, 0, r->tried);
    return status ? status : guard(r, r->k, values);
}

static int has_guards(const mbs_run *r)
{
    return r->p->modes && r->p->modes->guards;
}

/* Return whether a guard is below 0. */
static int is_below(casadi_int count, const casadi_real *values)
{
    casadi_int k;
    for (k = 0; k < count; ++k)
        if (values[k] < 0)
            return 1;
    return 0;
}

/* Find the first time at which a guard is 0 in a step of length h, where one is below 0: write the state there to y, and
 * the length of the step to there. */
static int locate(mbs_run *r, casadi_real t, casadi_real *h, const casadi_real *x, casadi_real *y)
{
    const casadi_int size = r->p->nq + r->p->n, count = r->p->modes->guards;
    const casadi_real least = CLOSEST * MBS_EPSILON * *h;
    casadi_int *fired = r->p->modes->fired, k, i;
    casadi_real *low = r->start, *high = r->end, *middle = r->between, lo = 0, hi = *h;
    int status = 0, side = 0;
    for (k = 0; k < count; ++k) /* a guard may be 0 at the start: the joint has just left it */
        fired[k] = high[k] < 0;
    for (i = 0; i < HALVINGS; ++i) {
        int is_left = 1;
        for (k = 0; k < count; ++k)
            is_left &= !(fired[k] && low[k] <= 0);
        if (is_left || hi - lo <= least)
            break;
        lo = hi / 2;
        if ((status = try_step(r, t, lo, x, low)) != 0)
            return status;
        if (is_below(count, low)) {
            for (k = 0; k < count; ++k) {
                high[k] = low[k], fired[k] = low[k] < 0;
                low[k] = 0;
            }
            hi = lo, lo = 0;
        }
    }
    for (i = 0; i < 200 && hi - lo > least; ++i) {
        casadi_real at = hi;
        for (k = 0; k < count; ++k)
            if (high[k] < 0) {
                const casadi_real root = lo + (hi - lo) * low[k] / (low[k] - high[k]);
                at = root < at ? root : at;
            }
        if (i > 30)
            at = lo + (hi - lo) / 2;
        at = at < lo + least / 2 ? lo + least / 2 : at > hi - least / 2 ? hi - least / 2 : at;
        if (!(at > lo && at < hi)) /* neighbours */
            break;
        if ((status = try_step(r, t, at, x, middle)) != 0)
            return status;
        if (is_below(count, middle)) {
            for (k = 0; k < count; ++k) {
                high[k] = middle[k], fired[k] = high[k] < 0;
                low[k] = side == 1 ? low[k] / 2 : low[k]; /* Illinois: the end that stays has less weight */
            }
            hi = at, side = 1;
        } else {
            for (k = 0; k < count; ++k) {
                low[k] = middle[k];
                high[k] = side == -1 ? high[k] / 2 : high[k];
            }
            lo = at, side = -1;
        }
    }
    status = try_step(r, t, hi, x, middle);
    for (k = 0; k < size; ++k)
        y[k] = r->tried[k];
    *h = hi;
    return status;
}

/* Return the fraction of a step at which the cubic through a guard and its rates at both ends is lowest, or 0, if both
 * ends are above 0 and it may be below 0 between them. */
static casadi_real find_dip(casadi_real h, casadi_real a, casadi_real da, casadi_real b, casadi_real db)
{
    const casadi_real c3 = 2 * (a - b) + h * (da + db), c2 = 3 * (b - a) - h * (2 * da + db), c1 = h * da;
    const casadi_real root = c2 * c2 - 3 * c3 * c1;
    const casadi_real s = -c1 / (c2 + sqrt(root)), value = a + s * (c1 + s * (c2 + s * c3));
    return da < 0 && db > 0 && s > 0 && s < 1 && value < 0.25 * (a < b ? a : b) ? s : 0;
}

/* After a step from x to y: look for an event in it. Leaves the rates at the end in stage 0 if there is none; else returns
 * MBS_EVENT, with the shorter step and its end. */
static int look(mbs_run *r, casadi_real t, casadi_real *h, const casadi_real *x, casadi_real *y)
{
    const casadi_int count = r->p->modes->guards, size = r->p->nq + r->p->n;
    const casadi_real *inputs = r->inputs, *courses = r->courses;
    casadi_real *start = r->start, *end = r->end, fractions[2] = {0, 0}, part = *h;
    casadi_int k, i;
    int status = 0, is_found = 0;
    r->inputs = r->courses = 0, r->is_watching = 0;
    fractions[0] = r->lowest < 0 ? r->fraction : 0;
    for (k = 0; k < size; ++k)
        r->first[k] = r->k[k];
    lay(r, x);
    status = guide(r, t, 0);
    if (!status && r->how->inputs && r->how->inputs(t))
        status = MBS_STOPPED;
    if (!status)
        status = guard(r, r->first, start);
    if (!status)
        status = evaluate(r, t + *h, 0, y);
    if (!status)
        status = guard(r, r->k, end);
    is_found = !status && is_below(count, end);
    for (k = 0; k < count && !status && !is_found; ++k) {
        const casadi_real dip = find_dip(*h, start[k], start[count + k], end[k], end[count + k]);
        fractions[1] = dip > 0 ? dip : fractions[1];
    }
    for (i = 0; i < 2 && !status && !is_found; ++i)
        if (fractions[i] > 0 && fractions[i] < 1) {
            part = fractions[i] * *h;
            status = try_step(r, t, part, x, end);
            is_found = !status && is_below(count, end);
        }
    if (!status && is_found && (status = locate(r, t, &part, x, y)) == 0) {
        *h = part;
        status = MBS_EVENT;
    } else if (!status && (fractions[0] > 0 || fractions[1] > 0)) /* the rates at the end were overwritten */
        status = evaluate(r, t + *h, 0, y);
    r->inputs = inputs, r->courses = courses;
    return status;
}

/* Return the only guard that fired, of a place, or -1. */
static casadi_int find_stop(const mbs_modes *m)
{
    casadi_int k, found = -1;
    for (k = 0; k < m->guards; ++k)
        if (m->fired[k]) {
            if (found >= 0 || m->kind[k] != MBS_PLACE)
                return -1;
            found = k;
        }
    return found;
}

/* At an event with the state y: pass an impact that needs no decision. Return MBS_EVENT for any other event; else write the
 * state `after`, and note the impact as ending in a row. */
static int bounce(mbs_run *r, casadi_real *y, casadi_real *after, casadi_int row)
{
    const mbs_explicit *p = r->p;
    mbs_modes *m = p->modes;
    const casadi_int stop = m->bounces < m->most && !p->e && !p->d && r->free == p->n ? find_stop(m) : -1;
    casadi_real *x = r->x, speed, fastest, impulse;
    casadi_int i, k;
    int status;
    if (stop < 0)
        return MBS_EVENT;
    i = m->joint[stop];
    speed = m->side[stop] * y[p->nq + i];
    if (!(speed < 0) || !(-m->restitution[i] * speed >= m->slow))
        return MBS_EVENT;
    for (k = 0; k < m->guards; ++k)
        if (k != stop && m->kind[k] == MBS_PLACE) {
            const casadi_real size = fabs(m->level[k]) > 1 ? fabs(m->level[k]) : 1;
            if (m->side[k] * (y[m->place[k]] - m->level[k]) <= m->touch * size)
                return MBS_EVENT;
        }
    y[m->place[stop]] = m->level[stop];
    fastest = measure(p->n, y + p->nq);
    lay(r, y);
    if ((status = factorise_mass(r)) != 0)
        return status;
    for (k = 0; k < p->n; ++k)
        x[k] = k == i;
    mbs_cholesky_forward(p->n, r->M, x);
    mbs_cholesky_backward(p->n, r->M, x);
    impulse = -(1 + m->restitution[i]) * speed / x[i];
    for (k = 0; k < p->nq; ++k)
        after[k] = y[k];
    for (k = 0; k < p->n; ++k)
        after[p->nq + k] = y[p->nq + k] + m->side[stop] * impulse * x[k];
    after[p->nq + i] = -m->restitution[i] * y[p->nq + i];
    for (k = 0; k < p->n; ++k)
        if (m->sign[k] != 0 && !(m->sign[k] * after[p->nq + k] > m->still * fastest))
            return MBS_EVENT;
    m->row[m->bounces] = row, m->guard[m->bounces] = stop, m->impulse[m->bounces] = impulse;
    ++m->bounces;
    return 0;
}

static int run_fixed(mbs_run *r, casadi_real h, casadi_int steps, casadi_real *times, casadi_real *states)
{
    const casadi_int size = r->p->nq + r->p->n;
    int status = 0;
    for (; r->out->steps < steps; ++r->out->steps, r->row_of_step += r->how->stages + 1) {
        const casadi_real t = times[r->out->steps];
        const casadi_real *x = states + size * r->out->steps;
        casadi_real *y = states + size * (r->out->steps + 1);
        status = renew(r);
        r->lowest = 0, r->is_watching = has_guards(r);
        if (!status)
            status = step(r, t, h, x, 0, y);
        if (!status)
            status = finish(r, times[r->out->steps + 1], h, y);
        if (!status && r->is_watching) {
            casadi_real length = h;
            status = look(r, t, &length, x, y);
            if (status == MBS_EVENT)
                times[++r->out->steps] = t + length;
        }
        if (status)
            break;
    }
    return status;
}

/* Return whether the last stage of a step is the first one of the next. */
static int ends_with_first(const mbs_run *r)
{
    const casadi_int last = r->how->stages - 1;
    casadi_int j;
    for (j = 0; j <= last; ++j)
        if (r->how->A[last * r->how->stages + j] != r->how->b[j])
            return 0;
    return !r->p->e && !r->p->d;
}

/* Write the rates at the end of a step, from which the next one begins. */
static int begin_next(mbs_run *r, casadi_real t, const casadi_real *y, int is_known)
{
    const casadi_int size = r->p->nq + r->p->n;
    casadi_int c;
    int status = renew(r);
    if (status || !is_known)
        return status ? status : evaluate(r, t, 0, y);
    for (c = 0; c < size; ++c)
        r->k[c] = r->k[size * (r->how->stages - 1) + c];
    return 0;
}

/* Return whether a step that failed may succeed when it is shorter. */
static int may_retry(int status)
{
    return status == MBS_RUNAWAY || status == MBS_OPEN || status == MBS_BRANCHED || status == MBS_DEPENDENT
           || status == MBS_LOADED || status > 0;
}

static int run_adaptive(mbs_run *r, casadi_real end, casadi_real *h, casadi_int steps, casadi_real *times,
                        casadi_real *states)
{
    const casadi_int size = r->p->nq + r->p->n;
    const int is_known = ends_with_first(r);
    int status = begin_next(r, times[0], states, 0), was_rejected = 0;
    if (!status && *h == 0)
        status = begin(r, times[0], states, h);
    while (!status && r->out->steps < steps && times[r->out->steps] < end) {
        const casadi_real t = times[r->out->steps], left = end - t;
        const casadi_real *x = states + size * r->out->steps;
        casadi_real *y = states + size * (r->out->steps + 1), length = *h, error = 0, factor;
        if (r->how->longest > 0 && length > r->how->longest)
            length = r->how->longest;
        if (length >= 0.99 * left)
            length = left;
        else if (2 * length > left)
            length = left / 2;
        r->least_pivot = r->last;
        r->lowest = 0, r->is_watching = has_guards(r);
        status = step(r, t, length, x, 1, y);
        if (!status)
            error = estimate(r, length, x, y);
        if (!status && error <= 1)
            status = finish(r, length == left ? end : t + length, length, y);
        if (!status && error <= 1 && r->is_watching) {
            casadi_real part = length;
            status = look(r, t, &part, x, y);
            if (status == MBS_EVENT) {
                times[++r->out->steps] = t + part;
                if (r->out->steps == steps || !(t + part > t))
                    return status;
                status = bounce(r, y, y + size, r->out->steps + 1);
                if (status)
                    return status;
                times[++r->out->steps] = t + part;
                status = begin_next(r, t + part, y + size, 0);
                was_rejected = 0;
                continue;
            }
        }
        if ((status && may_retry(status)) || error > 1 || error != error) {
            factor = status || error != error ? 0.25 : 0.9 * pow(error, -1 / (casadi_real)r->how->order);
            *h = length * (factor < 0.2 ? 0.2 : factor);
            ++r->out->rejected;
            was_rejected = 1;
            if (*h > SHORTEST * (fabs(t) + length)) {
                status = 0;
                continue;
            }
            status = status ? status : MBS_SHORT;
        }
        if (status)
            break;
        times[++r->out->steps] = length == left ? end : t + length;
        factor = error == 0 ? 10 : 0.9 * pow(error, -1 / (casadi_real)r->how->order);
        factor = factor > 10 ? 10 : factor;
        factor = was_rejected && factor > 1 ? 1 : factor;
        if (length * factor > *h || length == *h)
            *h = length * factor;
        was_rejected = 0;
        if (r->out->steps < steps && times[r->out->steps] < end && !r->is_watching) /* else the rates are there */
            status = begin_next(r, times[r->out->steps], y, is_known);
    }
    return status;
}

void mbs_explicit_run(const mbs_explicit *plant, const mbs_manner *manner, casadi_real end, casadi_real *h,
                      casadi_int steps, const casadi_real *inputs, const casadi_real *courses, casadi_real *times,
                      casadi_real *states, casadi_real *reals, casadi_int *integers, mbs_outcome *outcome)
{
    mbs_run r = open_run(plant, manner, reals, integers, outcome);
    r.inputs = inputs, r.courses = courses;
    if (plant->modes)
        plant->modes->bounces = 0;
    lay(&r, states);
    outcome->status = manner->estimates ? run_adaptive(&r, end, h, steps, times, states)
                                        : run_fixed(&r, *h, steps, times, states);
}

void mbs_explicit_read(const mbs_explicit *plant, const mbs_manner *manner, casadi_int count, const casadi_real *times,
                       const casadi_real *lengths, const casadi_real *inputs, const casadi_real *courses,
                       const casadi_real *starts, casadi_real *ends, casadi_real *reals, casadi_int *integers,
                       mbs_outcome *outcome)
{
    const casadi_int size = plant->nq + plant->n;
    mbs_run r = open_run(plant, manner, reals, integers, outcome);
    r.inputs = inputs, r.courses = courses;
    for (; outcome->steps < count && !outcome->status; ++outcome->steps, r.row_of_step += manner->stages + 1) {
        const casadi_real *x = starts + size * outcome->steps;
        casadi_real *y = ends + size * outcome->steps;
        const casadi_real t = times[outcome->steps], h = lengths[outcome->steps];
        lay(&r, x);
        r.is_ready = 0;
        outcome->status = renew(&r);
        if (!outcome->status)
            outcome->status = step(&r, t, h, x, 0, y);
        if (!outcome->status)
            outcome->status = finish(&r, t + h, h, y);
    }
}

/* --- series -------------------------------------------------------------------------------------------------------- */

static void copy(casadi_int size, const casadi_real *from, casadi_real *to)
{
    casadi_int c;
    for (c = 0; c < size; ++c)
        to[c] = from[c];
}

/* Keep the states at the outputs up to the end of `steps` steps; return the number of outputs that are passed. */
static casadi_int keep(const mbs_explicit *plant, const mbs_manner *manner, const mbs_series *series, casadi_int passed,
                       casadi_int steps, const casadi_real *times, const casadi_real *states, casadi_real *kept,
                       casadi_real *reals, casadi_int *integers, mbs_outcome *outcome)
{
    const casadi_int size = plant->nq + plant->n;
    casadi_int k = 0;
    for (; passed < series->outputs && series->times[passed] <= times[steps] + series->near; ++passed) {
        const casadi_real wanted = series->times[passed];
        casadi_real *to = kept + size * passed, length;
        while (k < steps - 1 && times[k + 1] < wanted)
            ++k;
        length = wanted - times[k];
        if (fabs(wanted - times[k + 1]) < series->near || length < series->near) {
            copy(size, states + size * (length < series->near ? k : k + 1), to);
            continue;
        }
        mbs_explicit_read(plant, manner, 1, times + k, &length, 0, 0, states + size * k, to, reals, integers, outcome);
        if (outcome->status)
            break;
    }
    return passed;
}

static int follow(const mbs_explicit *plant, const mbs_manner *manner, const mbs_series *series, casadi_real *kept,
                  casadi_real *length, casadi_real *times, casadi_real *states, casadi_real *reals, casadi_int *integers)
{
    const casadi_int size = plant->nq + plant->n;
    casadi_int passed = 0, left = series->most;
    mbs_outcome outcome;
    times[0] = series->begin;
    copy(size, kept, states);
    while (times[0] < series->end) {
        const casadi_int steps = left < series->chunk ? left : series->chunk;
        if (steps < 1)
            return MBS_LONG;
        mbs_explicit_run(plant, manner, series->end, length, steps, 0, 0, times, states, reals, integers, &outcome);
        if (outcome.status)
            return outcome.status;
        left -= outcome.steps;
        times[steps] = times[outcome.steps];
        copy(size, states + size * outcome.steps, states + size * steps);
        passed = keep(plant, manner, series, passed, outcome.steps, times, states, kept + size, reals, integers, &outcome);
        if (outcome.status)
            return outcome.status;
        times[0] = times[steps];
        copy(size, states + size * steps, states);
    }
    return 0;
}

void mbs_explicit_series(const mbs_explicit *plant, const mbs_manner *manner, const mbs_series *series, casadi_int first,
                         casadi_int last, casadi_real *kept, casadi_real *lengths, casadi_real *times,
                         casadi_real *states, casadi_real *reals, casadi_int *integers, int *status)
{
    const casadi_int size = (plant->nq + plant->n) * (1 + series->outputs);
    const casadi_int room = mbs_explicit_reals(plant, manner->stages), whole = mbs_explicit_integers(plant);
    casadi_int k, i;
    for (k = first; k < last; ++k) {
        for (i = 0; i < room; ++i) /* no digit depends on the motion before */
            reals[i] = 0;
        for (i = 0; i < whole; ++i)
            integers[i] = 0;
        for (i = 0; i < series->sets; ++i)
            copy(series->set[i].numbers, series->set[i].first + k * series->set[i].step, series->set[i].to);
        status[k] = follow(plant, manner, series, kept + size * k, lengths + k, times, states, reals, integers);
    }
}
