/* Time stepping with rigid contacts, stops and dry friction: see mbs_stepping.h. */
#include "mbs_stepping.h"
#include "mbs_entries.h"

#include <float.h>
#include <math.h>

#define CONVERGED 1e-12 /* of velocities: the change of the last iteration */
#define AGREES 1e-10    /* the same, where iterations shrink no more: rounding */
#define CLOSER 10       /* times the residual of cone problems, likewise */
#define ITERATIONS 40   /* of a step, */
#define LATE 15         /* and after how many AGREES is the tolerance of cone problems, and closed contacts stay as they are */
#define SLOW 0.2        /* by which an iteration shrinks, else there is a new matrix */
#define LOST 1e3        /* a pivot below n LOST epsilon of its diagonal entry has lost its digits */
#define HALVES 16       /* of the interval in which the factor of restitutions lies */
#define CREATED 1e-9    /* of the energy of impulses: less is rounding */
#define STILL 1e-10     /* of velocities: a slower joint that is held rests */
#define ENERGY 1e-13    /* of energies: less is rounding */
#define SHORTER 1e-3    /* of the kinetic energy, at most, in one step */
#define NEAR 1e-11      /* m: a distance that is as short is none: two bodies may fall side by side before impulses */
#define MOVES 1e-14     /* m: a point whose normal moves the bodies by less cannot be pushed */

typedef struct {
    const mbs_stepping *p;
    casadi_real h, factor, reached; /* factor of restitutions; residual of the last cone problem */
    const casadi_real *v;  /* inputs of the step */
    casadi_real *q0, *v0, *qm, *vm, *v1, *vf, *x, *r, *old; /* nq twice, n */
    casadi_real *A, *K, *N, *slide;                   /* n x n, n x nq, nq x n, 3 points x n */
    casadi_real *twist, *moved, *normal, *room;       /* 6 pairs x n; 3 x n; 3 for each point; for solids */
    mbs_spot *spots;
    casadi_real *J, *B, *W, *free, *bias, *P, *grip;  /* rows x n, n x rows, rows x rows, rows */
    casadi_real *diagonal, *cone;
    casadi_int *kind, *first, *owner, *integers;      /* by block; its place among the impulses */
    casadi_int rows, blocks;
} mbs_stepper;

/* Count the points of contact, with the most that pairs of solids have. */
static casadi_int count_points(const mbs_stepping *p)
{
    casadi_int k, count = p->points;
    for (k = 0; k < p->pairs; ++k)
        count += p->pair[k].spots;
    return count;
}

static casadi_int count_rows(const mbs_stepping *p)
{
    return 3 * count_points(p) + p->stops + p->brakes;
}

/* Return how many numbers the points of one pair take, and the room to find them. */
static casadi_int measure_pairs(const mbs_stepping *p, casadi_int *room)
{
    casadi_int k, most = 0;
    for (k = 0, *room = 0; k < p->pairs; ++k) {
        const casadi_int own = mbs_solids_reals(p->pair[k].first, p->pair[k].other);
        *room = own > *room ? own : *room;
        most = p->pair[k].spots > most ? p->pair[k].spots : most;
    }
    return most * (casadi_int)(sizeof(mbs_spot) / sizeof(casadi_real));
}

casadi_int mbs_stepping_width(const mbs_stepping *p)
{
    return 2 * (p->group.nq + p->n) + 2 + 3 * count_points(p);
}

casadi_int mbs_stepping_reals(const mbs_stepping *p)
{
    const casadi_int n = p->n, nq = p->group.nq, most = count_rows(p);
    casadi_int room;
    const casadi_int spots = measure_pairs(p, &room);
    return 2 * nq + 8 * n + n * n + 2 * n * nq + 3 * p->points * n + 2 * n * most + most * most + 4 * most
           + mbs_cone_reals(most) + (6 * p->pairs + 3) * n + 3 * count_points(p) + room + spots;
}

casadi_int mbs_stepping_integers(const mbs_stepping *p)
{
    return 3 * count_rows(p) + mbs_cone_integers(count_rows(p));
}

static mbs_stepper open_stepper(const mbs_stepping *p, casadi_real h, casadi_real *reals, casadi_int *integers)
{
    const casadi_int n = p->n, nq = p->group.nq, most = count_rows(p);
    casadi_int room;
    mbs_stepper s;
    measure_pairs(p, &room);
    s.p = p, s.h = h, s.factor = 1, s.reached = 0, s.v = 0, s.rows = s.blocks = 0;
    s.q0 = reals, s.qm = s.q0 + nq, s.v0 = s.qm + nq, s.vm = s.v0 + n, s.v1 = s.vm + n, s.vf = s.v1 + n;
    s.x = s.vf + n, s.r = s.x + n, s.old = s.r + n, s.diagonal = s.old + n, s.A = s.diagonal + n, s.K = s.A + n * n;
    s.N = s.K + n * nq, s.slide = s.N + nq * n, s.J = s.slide + 3 * p->points * n, s.B = s.J + most * n;
    s.W = s.B + n * most, s.free = s.W + most * most, s.bias = s.free + most, s.P = s.bias + most, s.grip = s.P + most;
    s.cone = s.grip + most, s.twist = s.cone + mbs_cone_reals(most), s.moved = s.twist + 6 * p->pairs * n;
    s.normal = s.moved + 3 * n, s.room = s.normal + 3 * count_points(p), s.spots = (mbs_spot *)(s.room + room);
    s.kind = integers, s.first = s.kind + most, s.owner = s.first + most, s.integers = s.owner + most;
    return s;
}

static int call(mbs_call kernel)
{
    return kernel.f ? kernel.f(kernel.arg, kernel.res, 0, 0, 0) : 0;
}

static void clear(casadi_int size, casadi_real *x)
{
    casadi_int k;
    for (k = 0; k < size; ++k)
        x[k] = 0;
}

static casadi_real total(casadi_int size, const casadi_real *a, const casadi_real *b)
{
    casadi_real sum = 0;
    casadi_int k;
    for (k = 0; k < size; ++k)
        sum += a[k] * b[k];
    return sum;
}

static casadi_real largest(casadi_int size, const casadi_real *x)
{
    casadi_real most = 0;
    casadi_int k;
    for (k = 0; k < size; ++k)
        most = fmax(most, fabs(x[k]));
    return most;
}

/* Put the middle of the step, for the velocity v1, where kernels read. */
static void place(mbs_stepper *s)
{
    const mbs_stepping *p = s->p;
    casadi_int i;
    for (i = 0; i < p->n; ++i) {
        s->vm[i] = (s->v0[i] + s->v1[i]) / 2;
        s->x[i] = s->h / 2 * s->vm[i];
        p->qd[i] = s->vm[i];
        p->qdd[i] = (s->v1[i] - s->v0[i]) / s->h;
    }
    mbs_move(p->group, s->q0, s->x, s->qm);
    write(p->group.nq, 1, s->qm, p->q);
    write(p->m, 1, s->v, p->v);
}

/* Eliminate in A from the last row to the first: rows of other branches of a tree have zeros there, and stay. */
static int factorise(mbs_stepper *s)
{
    const casadi_int n = s->p->n;
    casadi_int i, j, k;
    for (k = n - 1; k >= 0; --k) {
        const casadi_real *row = s->A + k * n, pivot = row[k];
        if (!(pivot > n * LOST * DBL_EPSILON * s->diagonal[k]))
            return MBS_SINGULAR;
        for (i = 0; i < k; ++i) {
            casadi_real *above = s->A + i * n;
            if (above[k] != 0) {
                const casadi_real factor = above[k] /= pivot;
                for (j = 0; j < k; ++j)
                    above[j] -= factor * row[j];
            }
        }
    }
    return 0;
}

/* Put A^-1 b in the place of b, n x cols. */
static void solve(const mbs_stepper *s, casadi_int cols, casadi_real *b)
{
    const casadi_int n = s->p->n;
    casadi_int i, j, k;
    for (k = n - 1; k > 0; --k)
        for (i = 0; i < k; ++i)
            if (s->A[i * n + k] != 0)
                for (j = 0; j < cols; ++j)
                    b[i * cols + j] -= s->A[i * n + k] * b[k * cols + j];
    for (k = 0; k < n; ++k) {
        for (i = 0; i < k; ++i)
            if (s->A[k * n + i] != 0)
                for (j = 0; j < cols; ++j)
                    b[k * cols + j] -= s->A[k * n + i] * b[i * cols + j];
        for (j = 0; j < cols; ++j)
            b[k * cols + j] /= s->A[k * (n + 1)];
    }
}

/* Evaluate Phi and A = M + h/2 C + h^2/4 K N at the middle, and factorise A. */
static int linearise(mbs_stepper *s, mbs_stepping_record *record)
{
    const mbs_stepping *p = s->p;
    const casadi_int n = p->n, nq = p->group.nq;
    const casadi_real h = s->h;
    casadi_int i, j, k;
    int status;
    place(s);
    status = call(p->linearised);
    status = status ? status : call(p->change);
    record->kernel = status;
    ++record->jacobians;
    if (status)
        return MBS_KERNEL;
    mbs_fill_entries(p->M, n * n, s->A);
    for (k = 0; k < n; ++k)
        s->diagonal[k] = s->A[k * (n + 1)];
    for (k = 0; k < p->C.entries; ++k)
        s->A[p->C.place[k]] += h / 2 * p->C.nonzeros[k];
    if (!p->change.f) {
        for (k = 0; k < p->K.entries; ++k)
            s->A[p->K.place[k]] += h * h / 4 * p->K.nonzeros[k];
        return factorise(s);
    }
    mbs_fill_entries(p->K, n * nq, s->K);
    mbs_fill_entries(p->N, nq * n, s->N);
    for (i = 0; i < n; ++i)
        for (k = 0; k < nq; ++k)
            if (s->K[i * nq + k] != 0)
                for (j = 0; j < n; ++j)
                    s->A[i * n + j] += h * h / 4 * s->K[i * nq + k] * s->N[k * n + j];
    return factorise(s);
}

/* Write vf = v1 - h A^-1 Phi, the velocities without impulses. */
static void release(mbs_stepper *s)
{
    casadi_int i;
    for (i = 0; i < s->p->n; ++i)
        s->r[i] = s->h * s->p->Phi[i];
    solve(s, 1, s->r);
    for (i = 0; i < s->p->n; ++i)
        s->vf[i] = s->v1[i] - s->r[i];
}

static void open_block(mbs_stepper *s, int kind, casadi_int owner, casadi_real grip)
{
    s->kind[s->blocks] = kind, s->first[s->blocks] = s->rows, s->owner[s->blocks] = owner;
    s->grip[s->blocks++] = grip;
}

/* Add a row, and what its velocity is compared with: e min(0, v) of the velocity at the start. */
static void close_row(mbs_stepper *s, casadi_real restitution)
{
    const casadi_real before = total(s->p->n, s->J + s->rows * s->p->n, s->v0);
    s->bias[s->rows++] = restitution * fmin(0, before);
}

/* Write two directions across a normal. */
static void cross_normal(const casadi_real *n, casadi_real *t)
{
    const casadi_real least = fmin(fabs(n[0]), fmin(fabs(n[1]), fabs(n[2])));
    casadi_real axis[3], length;
    clear(6, t);
    axis[0] = fabs(n[0]) == least;
    axis[1] = !axis[0] && fabs(n[1]) == least;
    axis[2] = !axis[0] && !axis[1];
    add_cross(1, n, axis, t);
    length = sqrt(dot(t, t));
    write(3, 1 / length, t, t);
    add_cross(1, n, t, t + 3);
}

/* Return whether a distance g, which the velocities v0 and vf change along a row, vanishes within the step. */
static int closes(const mbs_stepper *s, const casadi_real *row, casadi_real g, casadi_real restitution)
{
    const casadi_real before = total(s->p->n, row, s->v0), after = total(s->p->n, row, s->vf);
    return g + (1 - restitution / 2) * s->h / 2 * (before + after) <= NEAR;
}

/* Add a point of contact, with its distance at the place of v0 h/2, its normal, and the Jacobian of its velocity. */
static void add_point(mbs_stepper *s, casadi_int point, casadi_real g, const casadi_real *normal, const casadi_real *slide,
                      casadi_real restitution, casadi_real coefficient)
{
    const casadi_int n = s->p->n;
    casadi_real axes[9], *rows = s->J + s->rows * n;
    casadi_int i, r;
    write(3, 1, normal, axes);
    cross_normal(axes, axes + 3);
    for (r = 0; r < 3; ++r)
        for (i = 0; i < n; ++i)
            rows[r * n + i] = axes[3 * r] * slide[i] + axes[3 * r + 1] * slide[n + i] + axes[3 * r + 2] * slide[2 * n + i];
    g -= total(n, rows, s->x); /* at the start */
    if (largest(n, rows) <= MOVES || !closes(s, rows, g, restitution))
        return;
    write(3, 1, normal, s->normal + 3 * point);
    open_block(s, MBS_TOUCH, 3 * point, coefficient);
    close_row(s, restitution), close_row(s, 0), close_row(s, 0);
}

/* Add the points at which two solids touch, the first of which has a number. */
static void add_pair(mbs_stepper *s, casadi_int k, casadi_int point)
{
    const mbs_stepping *p = s->p;
    const mbs_meeting pair = p->pair[k];
    const casadi_int n = p->n;
    const casadi_real *v = s->twist + 6 * k * n, *turn = v + 3 * n;
    const casadi_int found = mbs_solids_meet(pair.first, p->places + 6 * k, p->axes + 18 * k, pair.other,
                                             p->places + 6 * k + 3, p->axes + 18 * k + 9, pair.spots, s->spots, s->room);
    casadi_int j, i, r;
    for (j = 0; j < found; ++j) {
        const casadi_real *at = s->spots[j].at;
        for (r = 0; r < 3; ++r) {
            const casadi_int a = (r + 1) % 3, b = (r + 2) % 3;
            for (i = 0; i < n; ++i)
                s->moved[r * n + i] = v[r * n + i] + turn[a * n + i] * at[b] - turn[b * n + i] * at[a];
        }
        add_point(s, point + j, s->spots[j].gap, s->spots[j].normal, s->moved, pair.restitution, pair.coefficient);
    }
}

static int add_points(mbs_stepper *s, mbs_stepping_record *record)
{
    const mbs_stepping *p = s->p;
    const casadi_int n = p->n;
    casadi_int k, i, point = p->points;
    for (i = 0; i < n; ++i)
        s->x[i] = s->h / 2 * s->v0[i];
    mbs_move(p->group, s->q0, s->x, p->q);
    record->kernel = call(p->touching);
    if (!record->kernel)
        record->kernel = call(p->meetings);
    if (record->kernel)
        return MBS_KERNEL;
    if (p->points)
        mbs_fill_entries(p->J, 3 * p->points * n, s->slide);
    for (k = 0; k < p->points; ++k)
        add_point(s, k, p->clearance[k], p->direction + 3 * k, s->slide + 3 * k * n, p->restitution[k], p->coefficient[k]);
    if (p->pairs)
        mbs_fill_entries(p->twist, 6 * p->pairs * n, s->twist);
    for (k = 0; k < p->pairs; point += p->pair[k++].spots)
        add_pair(s, k, point);
    return 0;
}

/* Collect the closed contacts and stops, and the friction of joints: J, and W = J A^-1 J^T. */
static int collect(mbs_stepper *s, mbs_stepping_record *record)
{
    const mbs_stepping *p = s->p;
    const casadi_int n = p->n, others = 3 * count_points(p);
    casadi_int k, i, j;
    int status;
    s->rows = s->blocks = 0;
    status = p->points || p->pairs ? add_points(s, record) : 0;
    if (status)
        return status;
    for (k = 0; k < p->stops; ++k) {
        const mbs_stop stop = p->stop[k];
        casadi_real *row = s->J + s->rows * n;
        clear(n, row);
        row[stop.rate] = stop.side;
        if (closes(s, row, stop.side * (s->q0[stop.place] - stop.level), stop.restitution)) {
            open_block(s, MBS_PUSH, others + k, 0);
            close_row(s, stop.restitution);
        }
    }
    for (k = 0; k < p->brakes; ++k) {
        const mbs_brake brake = p->brake[k];
        const casadi_real rate = s->v0[brake.rate], slow = rate * brake.slowness;
        const casadi_real force = rate == 0 ? brake.still : brake.torque + brake.fall * exp(-slow * slow);
        clear(n, s->J + s->rows * n);
        s->J[s->rows * n + brake.rate] = 1;
        open_block(s, MBS_BRAKE, others + p->stops + k, s->h * force);
        close_row(s, 0);
    }
    for (i = 0; i < n; ++i)
        for (j = 0; j < s->rows; ++j)
            s->B[i * s->rows + j] = s->J[j * n + i];
    solve(s, s->rows, s->B);
    clear(s->rows * s->rows, s->W);
    for (i = 0; i < s->rows; ++i)
        for (k = 0; k < n; ++k)
            if (s->J[i * n + k] != 0)
                for (j = 0; j < s->rows; ++j)
                    s->W[i * s->rows + j] += s->J[i * n + k] * s->B[k * s->rows + j];
    return 0;
}

static casadi_int count_own(const mbs_stepper *s, casadi_int block)
{
    return s->kind[block] == MBS_TOUCH ? 3 : 1;
}

/* Count the rows of contacts and stops; rows of brakes, which have no impulses of impacts, follow them. */
static casadi_int count_struck(const mbs_stepper *s)
{
    casadi_int k = s->blocks;
    while (k > 0 && s->kind[k - 1] == MBS_BRAKE)
        --k;
    return k ? s->first[k - 1] + count_own(s, k - 1) : 0;
}

/* Solve for the impulses, and write v1 = vf + A^-1 J^T P. Returns the energy that contacts and stops take. */
static casadi_real strike(mbs_stepper *s, casadi_real tolerance, mbs_stepping_record *record, int *status)
{
    const casadi_int n = s->p->n;
    const mbs_cone cone = {s->rows, s->blocks, s->kind, s->first, s->grip, s->W, s->free};
    mbs_cone_effort effort = {0, 0, 0};
    casadi_real taken = 0;
    casadi_int i;
    for (i = 0; i < s->rows; ++i)
        s->free[i] = total(n, s->J + i * n, s->vf) + s->factor * s->bias[i];
    if (s->rows && mbs_cone_solve(&cone, tolerance, s->P, &effort, s->cone, s->integers))
        *status = MBS_CONE;
    record->sweeps += effort.sweeps, record->newton += effort.steps;
    s->reached = effort.residual, record->residual = fmax(record->residual, effort.residual);
    for (i = 0; i < n; ++i)
        s->v1[i] = s->vf[i] + total(s->rows, s->B + i * s->rows, s->P);
    for (i = 0; i < count_struck(s); ++i)
        taken -= s->P[i] * (total(n, s->J + i * n, s->v0) + total(n, s->J + i * n, s->v1)) / 2;
    return taken;
}

/* Solve with a factor of all restitutions; return whether contacts and stops create no energy. */
static int keeps(mbs_stepper *s, casadi_real factor, casadi_real tolerance, mbs_stepping_record *record, int *status)
{
    casadi_real taken, size = 0;
    casadi_int i;
    s->factor = factor;
    taken = strike(s, tolerance, record, status);
    for (i = 0; i < count_struck(s); ++i)
        size += fabs(s->P[i] * total(s->rows, s->W + i * s->rows, s->P));
    return taken >= -CREATED * size;
}

/* Solve with the largest factor of restitutions that creates no energy, as Newton's law may with friction. */
static void restrain(mbs_stepper *s, casadi_real tolerance, mbs_stepping_record *record, int *status)
{
    casadi_real low = 0, high = 1;
    casadi_int half, i, rebounds = 0;
    for (i = 0; i < s->rows; ++i)
        rebounds |= s->bias[i] != 0;
    if (keeps(s, 1, tolerance, record, status) || !rebounds)
        return;
    for (half = 0; half < HALVES && !*status; ++half) {
        const casadi_real middle = (low + high) / 2;
        if (keeps(s, middle, tolerance, record, status))
            low = middle;
        else
            high = middle;
    }
    if (!*status)
        keeps(s, low, tolerance, record, status);
}

static void guess(mbs_stepper *s, const casadi_real *impulses)
{
    casadi_int k, i;
    for (k = 0; k < s->blocks; ++k)
        for (i = 0; i < count_own(s, k); ++i)
            s->P[s->first[k] + i] = impulses[s->owner[k] + i];
}

/* Find the matrices and the closed rows at the middle for v1, with a guess of the impulses. */
static int renew(mbs_stepper *s, const casadi_real *impulses, mbs_stepping_record *record)
{
    int status = linearise(s, record);
    if (status)
        return status;
    release(s);
    status = collect(s, record);
    if (!status)
        guess(s, impulses);
    return status;
}

/* Solve for v1. */
static int iterate(mbs_stepper *s, casadi_real tolerance, const casadi_real *impulses, mbs_stepping_record *record)
{
    const casadi_int n = s->p->n;
    casadi_real change = INFINITY, before, size;
    casadi_int k, i;
    int status = renew(s, impulses, record), renewed = 1;
    if (status)
        return status;
    for (k = 0; k < ITERATIONS; ++k) {
        ++record->iterations;
        write(n, 1, s->v1, s->old);
        if (k == 0)
            restrain(s, tolerance, record, &status);
        else
            strike(s, tolerance, record, &status);
        if (status)
            return status;
        before = change, change = 0;
        if (!mbs_is_finite(n, s->v1))
            return MBS_INFINITE;
        for (i = 0; i < n; ++i)
            change = fmax(change, fabs(s->v1[i] - s->old[i]));
        size = fmax(largest(n, s->v0), fmax(largest(n, s->vf), largest(n, s->v1)));
        if (change <= CONVERGED * size)
            return 0;
        if (k > 1 && change > before / 2 && change <= fmax(k < LATE ? AGREES : tolerance, CLOSER * s->reached) * size)
            return 0;
        if (!renewed && change > SLOW * before && k < LATE) {
            status = renew(s, impulses, record);
            renewed = 1;
            if (status)
                return status;
            continue;
        }
        renewed = 0;
        place(s);
        record->kernel = call(s->p->residual);
        if (record->kernel)
            return MBS_KERNEL;
        release(s);
    }
    return MBS_DIVERGED;
}

/* Set velocities of joints to 0 that stops or friction hold, and that are rounding of it. */
static void hold(mbs_stepper *s)
{
    const mbs_stepping *p = s->p;
    const casadi_real still = STILL * fmax(largest(p->n, s->v0), largest(p->n, s->vf));
    casadi_int k;
    for (k = 0; k < s->blocks; ++k) {
        const casadi_int own = s->owner[k] - 3 * count_points(p);
        const casadi_real P = s->P[s->first[k]];
        casadi_real *rate;
        if (s->kind[k] == MBS_TOUCH || !(s->kind[k] == MBS_PUSH ? P > 0 : fabs(P) < s->grip[k]))
            continue;
        rate = s->v1 + (s->kind[k] == MBS_PUSH ? p->stop[own].rate : p->brake[own - p->stops].rate);
        if (fabs(*rate) <= still)
            *rate = 0;
    }
}

/* Add what impacts and friction took to losses. */
static void add_losses(const mbs_stepper *s, casadi_real *losses)
{
    const casadi_int n = s->p->n;
    casadi_int k, i;
    for (k = 0; k < s->blocks; ++k)
        for (i = 0; i < count_own(s, k); ++i) {
            const casadi_int r = s->first[k] + i;
            const casadi_real *row = s->J + r * n;
            losses[i > 0 || s->kind[k] == MBS_BRAKE] -= s->P[r] * (total(n, row, s->v0) + total(n, row, s->v1)) / 2;
        }
}

/* Keep the energy at the end of a step within its balance: write the end's coordinates. */
static int balance(mbs_stepper *s, casadi_real *q1, casadi_real *losses, mbs_stepping_record *record)
{
    const mbs_stepping *p = s->p;
    const casadi_int n = p->n;
    casadi_real T, V, excess;
    casadi_int i;
    hold(s);
    place(s);
    record->kernel = call(p->work);
    if (record->kernel)
        return MBS_KERNEL;
    losses[0] = losses[1] = 0;
    add_losses(s, losses);
    record->allowed += s->h * *p->power - fmax(0, losses[0] + losses[1]);
    mbs_move(p->group, s->qm, s->x, q1);
    write(p->group.nq, 1, q1, p->q);
    write(n, 1, s->v1, p->qd);
    record->kernel = call(p->energy);
    if (record->kernel)
        return MBS_KERNEL;
    T = *p->kinetic, V = *p->potential, excess = T + V - record->allowed;
    if (excess > ENERGY * (T + fabs(V)) && T > 0) {
        const casadi_real part = sqrt(1 - fmin(SHORTER, excess / T));
        for (i = 0; i < n; ++i)
            s->v1[i] *= part;
    }
    return 0;
}

/* Write the impulses of the step, and their vectors in the base frame. */
static void keep(const mbs_stepper *s, casadi_real *impulses, casadi_real *vectors)
{
    const mbs_stepping *p = s->p;
    casadi_int k, i, j;
    clear(count_rows(p), impulses);
    clear(3 * count_points(p), vectors);
    for (k = 0; k < s->blocks; ++k) {
        for (i = 0; i < count_own(s, k); ++i)
            impulses[s->owner[k] + i] = s->P[s->first[k] + i];
        if (s->kind[k] == MBS_TOUCH) {
            casadi_real axes[9];
            write(3, 1, s->normal + s->owner[k], axes);
            cross_normal(axes, axes + 3);
            for (i = 0; i < 3; ++i)
                for (j = 0; j < 3; ++j)
                    vectors[s->owner[k] + j] += axes[3 * i + j] * s->P[s->first[k] + i];
        }
    }
}

/* Begin the balance of energy at a start. */
static int begin(mbs_stepper *s, mbs_stepping_record *record)
{
    const mbs_stepping *p = s->p;
    write(p->group.nq, 1, s->q0, p->q);
    write(p->n, 1, s->v0, p->qd);
    record->kernel = call(p->energy);
    record->allowed = *p->kinetic + *p->potential;
    return record->kernel ? MBS_KERNEL : 0;
}

casadi_int mbs_stepping_run(const mbs_stepping *p, casadi_real tolerance, casadi_real h, casadi_int steps,
                            const casadi_real *inputs, casadi_int v_step, const casadi_real *start, casadi_real *results,
                            casadi_real *impulses, mbs_stepping_record *record, int *status, casadi_real *reals,
                            casadi_int *integers)
{
    const casadi_int n = p->n, nq = p->group.nq;
    mbs_stepper s = open_stepper(p, h, reals, integers);
    casadi_int k;
    write(nq, 1, start, s.q0);
    write(n, 1, start + nq, s.v0);
    *status = record->allowed == record->allowed ? 0 : begin(&s, record);
    for (k = 0; k < steps && !*status; ++k, results += mbs_stepping_width(p)) {
        casadi_real *middle = results + nq + n, *losses = middle + nq + n;
        s.v = inputs + k * v_step;
        write(n, 1, s.v0, s.v1);
        *status = iterate(&s, tolerance, impulses, record);
        if (!*status)
            *status = balance(&s, results, losses, record);
        if (*status)
            break;
        write(nq, 1, s.qm, middle);
        write(n, 1, s.vm, middle + nq);
        keep(&s, impulses, losses + 2);
        write(n, 1, s.v1, results + nq);
        if (!mbs_is_finite(nq + n, results)) {
            *status = MBS_INFINITE;
            break;
        }
        write(nq, 1, results, s.q0);
        write(n, 1, s.v1, s.v0);
    }
    return k;
}
