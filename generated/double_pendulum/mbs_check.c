#include "mbs_private.h"
/* Comparisons of kernels that must agree; mbs_check.h tells what each compares. */
#include "mbs_check.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define STATES 5

/* What may differ, relative to the largest of the numbers that are compared. Faults of equations change leading digits.
 *
 * ROUNDING: two ways to one number differ by a few epsilon, and by more the more cancels on the way. DIFFERENCES: of
 * central differences with two steps, extrapolated, rounding (epsilon / step) and truncation (step^4 times the fifth
 * derivatives) leave epsilon^(3/4) or less with steps of epsilon^(1/4). The rest is for models with stiff forces and
 * numbers of unlike sizes.
 * ACCELERATIONS: rounding times the condition number of the mass matrix, which no kernel tells: half of the digits.
 *
 * A force law that saturates steeply has derivatives in which everything cancels: 1 - tanh^2 keeps an error of epsilon
 * where it vanishes. So a derivative may also differ by rounding of the largest number of its kernel; and no single step
 * suits every slope, so a column that differs is compared with other steps: up to LONGER times as long, and shorter
 * ones as long as rounding allows. */
#define ROUNDING (1e3 * (double)MBS_EPSILON)
#define DIFFERENCES (1e2 * pow((double)MBS_EPSILON, 2.0 / 3.0))
#define ACCELERATIONS sqrt((double)MBS_EPSILON)
#define STEP pow((double)MBS_EPSILON, 1.0 / 4.0)
#define LONGER 16.0
#define UNSURE 4.0 /* what a slope may be off by, in parts of its correction */
#define SHORTEST ((double)MBS_EPSILON / DIFFERENCES)

const casadi_real *mbs_check_p = 0, *mbs_check_h = 0, *mbs_check_theta = 0;

/* -- calls ------------------------------------------------------------------------------------------------------ */

/* A kernel with its inputs and results. */
typedef struct {
    const mbs_face *face;
    casadi_real **in, **out;
} call;

/* A pattern is: rows, columns, then 1 (dense), or column pointers and rows. */
static size_t count_nonzeros(const casadi_int *pattern)
{
    return (size_t)(pattern[2] == 1 ? pattern[0] * pattern[1] : pattern[2 + pattern[1]]);
}

/* The place of nonzero k in the matrix, column by column. */
static casadi_int find_place(const casadi_int *pattern, casadi_int k)
{
    casadi_int column = 0;
    if (pattern[2] == 1)
        return k;
    while (pattern[3 + column] <= k)
        ++column;
    return column * pattern[0] + pattern[3 + pattern[1] + k];
}

/* The entry at a row and column of a matrix that is given by its nonzeros. */
static double find_entry(const casadi_int *pattern, const casadi_real *nonzeros, casadi_int row, casadi_int column)
{
    casadi_int k;
    if (pattern[2] == 1)
        return (double)nonzeros[column * pattern[0] + row];
    for (k = pattern[2 + column]; k < pattern[3 + column]; ++k)
        if (pattern[3 + pattern[1] + k] == row)
            return (double)nonzeros[k];
    return 0.0;
}

static void *allocate(size_t count, size_t size)
{
    void *memory = calloc(count ? count : 1, size);
    if (!memory) {
        fputs("out of memory\n", stderr);
        exit(2);
    }
    return memory;
}

/* Draw numbers between -1 and 1 by a linear congruential generator (Numerical Recipes) that starts from the input's
 * name and the state. Their 23 bits are exact in single precision too. */
static void draw(casadi_real *values, size_t count, const char *name, int state)
{
    unsigned long x = 2166136261UL + (unsigned long)state;
    size_t k;
    for (; *name; ++name)
        x = ((x ^ (unsigned char)*name) * 16777619UL) & 0xFFFFFFFFUL;
    for (k = 0; k < count; ++k) {
        x = (x * 1664525UL + 1013904223UL) & 0xFFFFFFFFUL;
        values[k] = (casadi_real)((double)(x >> 8) / 8388608.0 - 1.0);
    }
}

static call open_call(const mbs_face *face)
{
    const size_t n_in = (size_t)face->n_in(), n_out = (size_t)face->n_out();
    call c;
    size_t i;
    c.face = face;
    c.in = allocate(n_in, sizeof *c.in);
    c.out = allocate(n_out, sizeof *c.out);
    for (i = 0; i < n_in; ++i)
        c.in[i] = allocate(count_nonzeros(face->sparsity_in((casadi_int)i)), sizeof **c.in);
    for (i = 0; i < n_out; ++i)
        c.out[i] = allocate(count_nonzeros(face->sparsity_out((casadi_int)i)), sizeof **c.out);
    return c;
}

static void close_call(call c)
{
    casadi_int i;
    for (i = 0; i < c.face->n_in(); ++i)
        free(c.in[i]);
    for (i = 0; i < c.face->n_out(); ++i)
        free(c.out[i]);
    free(c.in);
    free(c.out);
}

/* The numbers of an input that are the same in all states; NULL for others. */
static const casadi_real *find_given(const char *name)
{
    static const casadi_real roundoff = sizeof roundoff < sizeof(double) ? 5.9604644775390625e-8 : 1.1102230246251565e-16;
    if (!strcmp(name, "unit"))
        return &roundoff;
    if (!strcmp(name, "p") || !strcmp(name, "given_p"))
        return mbs_check_p;
    return !strcmp(name, "h") ? mbs_check_h : !strcmp(name, "theta") ? mbs_check_theta : 0;
}

/* Fill the inputs with those of a state. */
static void set_state(call c, int state)
{
    casadi_int i;
    for (i = 0; i < c.face->n_in(); ++i) {
        const char *name = c.face->name_in(i);
        const size_t count = count_nonzeros(c.face->sparsity_in(i));
        const casadi_real *given = find_given(name);
        if (!given)
            draw(c.in[i], count, name, state);
        else if (count)
            memcpy(c.in[i], given, count * sizeof *c.in[i]);
    }
}

/* The input of a name; NULL if there is none. */
static casadi_real *find_input(call c, const char *name)
{
    casadi_int i;
    for (i = 0; i < c.face->n_in(); ++i)
        if (!strcmp(c.face->name_in(i), name))
            return c.in[i];
    return 0;
}

/* Set an input of a name, if there is one, to zeros. */
static void clear_input(call c, const char *name)
{
    casadi_int i;
    for (i = 0; i < c.face->n_in(); ++i)
        if (!strcmp(c.face->name_in(i), name))
            memset(c.in[i], 0, count_nonzeros(c.face->sparsity_in(i)) * sizeof *c.in[i]);
}

/* -- comparisons ------------------------------------------------------------------------------------------------ */

/* A comparison so far. */
typedef struct {
    double worst; /* the largest difference, as a fraction of what is allowed */
    int failed;   /* the status of a kernel that failed */
} verdict;

static void run(call c, verdict *v)
{
    const int status = c.face->call((const casadi_real **)c.in, c.out, 0, 0, 0);
    if (status)
        v->failed = status;
}

/* Judge a difference by what is allowed; one that is no number stays the worst. */
static void judge(verdict *v, double difference, double allowed)
{
    const double part = difference == 0.0 ? 0.0 : fabs(difference) / allowed;
    if (!(part <= v->worst) && v->worst == v->worst)
        v->worst = part;
}

static int report(verdict v, double tolerance, const char *f, const char *relation, const char *g)
{
    const int is_fault = v.failed || !(v.worst <= 1.0);
    printf("%-5s  %s %s %s: ", is_fault ? "FAULT" : "ok", f, relation, g);
    if (v.failed)
        printf("a kernel failed with status %d\n", v.failed);
    else
        printf("differ by %.1e, %.1e allowed\n", v.worst * tolerance, tolerance);
    return is_fault;
}

static double maximum(double a, double b)
{
    return fabs(b) > a ? fabs(b) : a;
}

static double find_largest(const casadi_real *values, size_t count)
{
    double largest = 0.0;
    size_t k;
    for (k = 0; k < count; ++k)
        largest = maximum(largest, (double)values[k]);
    return largest;
}

/* The largest of all results of a kernel. */
static double find_largest_result(call c)
{
    double largest = 0.0;
    casadi_int o;
    for (o = 0; o < c.face->n_out(); ++o)
        largest = maximum(largest, find_largest(c.out[o], count_nonzeros(c.face->sparsity_out(o))));
    return largest;
}

/* Two calls of f, up and down by a step from a state. */
typedef struct {
    call up, down;
    double distance; /* of one input between them, as it is rounded */
} pair;

static pair open_pair(const mbs_face *f)
{
    pair p;
    p.up = open_call(f);
    p.down = open_call(f);
    p.distance = 0.0;
    return p;
}

static void close_pair(pair p)
{
    close_call(p.up);
    close_call(p.down);
}

static void run_pair(pair *p, casadi_int input, casadi_int k, double step, verdict *v)
{
    casadi_real *up = &p->up.in[input][k], *down = &p->down.in[input][k];
    const casadi_real at = *up;
    *up = (casadi_real)((double)at + step);
    *down = (casadi_real)((double)at - step);
    p->distance = (double)*up - (double)*down;
    run(p->up, v);
    run(p->down, v);
    *up = *down = at;
}

static double find_slope(const pair *p, casadi_int o, size_t k)
{
    return ((double)p->up.out[o][k] - (double)p->down.out[o][k]) / p->distance;
}

/* A Jacobian at a state, and the pairs of calls of f around it. */
typedef struct {
    call jac;
    pair far, near; /* near by half the distance */
} slopes;

/* Judge an input's column of a Jacobian, one result after the other, by slopes between calls of f: the near ones correct
 * the far ones (Richardson). Where a force law is steep, the correction shows how far off slopes are. */
static void judge_column(verdict *v, const slopes *s, casadi_int input, casadi_int place)
{
    const mbs_face *f = s->far.up.face;
    const double floor = ROUNDING * maximum(find_largest_result(s->jac), find_largest_result(s->far.up));
    casadi_int o;
    for (o = 0; o < f->n_out(); ++o) {
        const casadi_int *pattern = f->sparsity_out(o), block = o * f->n_in() + input;
        const casadi_int *blocks = s->jac.face->sparsity_out(block);
        const size_t count = count_nonzeros(pattern);
        const double size = find_largest(s->jac.out[block], count_nonzeros(blocks));
        const double allowed = floor + DIFFERENCES * maximum(size, find_largest(s->far.up.out[o], count));
        size_t k;
        for (k = 0; k < count; ++k) {
            const double closer = find_slope(&s->near, o, k), slope = (4.0 * closer - find_slope(&s->far, o, k)) / 3.0;
            const casadi_int row = find_place(pattern, (casadi_int)k);
            judge(v, slope - find_entry(blocks, s->jac.out[block], row, place), allowed + UNSURE * fabs(slope - closer));
        }
    }
}

/* Judge nonzero k of an input with one step. */
static verdict judge_step(slopes *s, casadi_int input, casadi_int k, double step)
{
    verdict v = {0.0, 0};
    run_pair(&s->far, input, k, step, &v);
    run_pair(&s->near, input, k, step / 2, &v);
    judge_column(&v, s, input, find_place(s->far.up.face->sparsity_in(input), k));
    return v;
}

static int passes(verdict v)
{
    return !v.failed && v.worst <= 1.0;
}

/* Judge nonzero k of an input with the usual step; where it differs, with the step that suits best. */
static void compare_column(verdict *v, slopes *s, casadi_int input, casadi_int k)
{
    verdict best = judge_step(s, input, k, STEP);
    double step;
    for (step = LONGER * STEP; !passes(best) && step > SHORTEST; step /= 4.0) {
        const verdict other = judge_step(s, input, k, step);
        if (!other.failed && !(other.worst >= best.worst))
            best = other;
    }
    if (best.failed)
        v->failed = best.failed;
    judge(v, best.worst, 1.0);
}

int mbs_check_jacobian(const mbs_face *f, const mbs_face *jac)
{
    slopes s;
    verdict v = {0.0, 0};
    int state;
    s.far = open_pair(f);
    s.near = open_pair(f);
    s.jac = open_call(jac);
    for (state = 0; state < STATES && !v.failed; ++state) {
        casadi_int i;
        set_state(s.far.up, state);
        set_state(s.far.down, state);
        set_state(s.near.up, state);
        set_state(s.near.down, state);
        set_state(s.jac, state);
        run(s.jac, &v);
        for (i = 0; i < f->n_in(); ++i) {
            const casadi_int count = f->diff_in(i) ? (casadi_int)count_nonzeros(f->sparsity_in(i)) : 0;
            casadi_int k;
            for (k = 0; k < count; ++k)
                compare_column(&v, &s, i, k);
        }
    }
    close_pair(s.far);
    close_pair(s.near);
    close_call(s.jac);
    return report(v, DIFFERENCES, jac->name, "against differences of", f->name);
}

int mbs_check_adjoint(const mbs_face *f, const mbs_face *jac, const mbs_face *adj1)
{
    const casadi_int n_in = f->n_in(), n_out = f->n_out();
    call derivative = open_call(jac), adjoint = open_call(adj1);
    verdict v = {0.0, 0};
    int state;
    for (state = 0; state < STATES; ++state) {
        casadi_int i, o, r;
        double floor;
        size_t k;
        set_state(derivative, state);
        set_state(adjoint, state);
        run(derivative, &v);
        run(adjoint, &v);
        floor = ROUNDING * maximum(find_largest_result(derivative), find_largest_result(adjoint));
        for (i = 0; i < n_in; ++i) {
            const casadi_int *pattern = adj1->sparsity_out(i);
            for (k = 0; k < count_nonzeros(pattern); ++k) {
                const casadi_int place = find_place(pattern, (casadi_int)k);
                double sum = 0.0, size = 0.0;
                for (o = 0; o < n_out; ++o) {
                    const casadi_int *seeds = adj1->sparsity_in(n_in + n_out + o);
                    const casadi_int *blocks = jac->sparsity_out(o * n_in + i);
                    const double largest = find_largest(derivative.out[o * n_in + i], count_nonzeros(blocks));
                    for (r = 0; r < (casadi_int)count_nonzeros(seeds); ++r) {
                        const double seed = (double)adjoint.in[n_in + n_out + o][r];
                        sum += seed * find_entry(blocks, derivative.out[o * n_in + i], find_place(seeds, r), place);
                        size += fabs(seed) * largest;
                    }
                }
                judge(&v, sum - (double)adjoint.out[i][k], floor + ROUNDING * size);
            }
        }
    }
    close_call(derivative);
    close_call(adjoint);
    return report(v, ROUNDING, adj1->name, "against", jac->name);
}

/* Compare the first result of f with the end of that of g. */
static verdict compare_results(const mbs_face *f, const mbs_face *g, double tolerance)
{
    call a = open_call(f), b = open_call(g);
    const size_t count = count_nonzeros(f->sparsity_out(0));
    const size_t skipped = count_nonzeros(g->sparsity_out(0)) - count;
    verdict v = {0.0, 0};
    int state;
    for (state = 0; state < STATES; ++state) {
        double size;
        size_t k;
        set_state(a, state);
        set_state(b, state);
        run(a, &v);
        run(b, &v);
        size = find_largest(a.out[0], count);
        for (k = 0; k < count; ++k)
            judge(&v, (double)a.out[0][k] - (double)b.out[0][skipped + k], tolerance * size);
    }
    close_call(a);
    close_call(b);
    return v;
}

int mbs_check_equal(const mbs_face *f, const mbs_face *g)
{
    return report(compare_results(f, g, ROUNDING), ROUNDING, f->name, "against", g->name);
}

static int compare_reference(const mbs_face *f, const double *results, double tolerance)
{
    call c = open_call(f);
    verdict v = {0.0, 0};
    double size = 0.0;
    size_t k, all = 0;
    casadi_int o;
    set_state(c, 0);
    run(c, &v);
    for (o = 0; o < f->n_out(); ++o)
        all += count_nonzeros(f->sparsity_out(o));
    for (k = 0; k < all; ++k)
        size = maximum(size, results[k]);
    for (o = 0; o < f->n_out(); ++o) {
        const size_t count = count_nonzeros(f->sparsity_out(o));
        for (k = 0; k < count; ++k)
            judge(&v, (double)c.out[o][k] - results[k], tolerance * size);
        results += count;
    }
    close_call(c);
    return report(v, tolerance, f->name, "against", "50 digits");
}

int mbs_check_results(const mbs_face *f, const double *results)
{
    casadi_int i;
    for (i = 0; i < f->n_in(); ++i)
        if (!strcmp(f->name_in(i), "unit") && sizeof(casadi_real) < sizeof(double)) {
            printf("left   %s: the bounds to compare with are of doubles\n", f->name);
            return 0;
        }
    return compare_reference(f, results, ROUNDING);
}

int mbs_check_solution(const mbs_face *f, const double *results)
{
    return compare_reference(f, results, ACCELERATIONS);
}

int mbs_check_tail(const mbs_face *f, const mbs_face *g)
{
    return report(compare_results(f, g, ROUNDING), ROUNDING, f->name, "against the last of", g->name);
}

/* The changes of the first result of f, all together, where rounding moves the drawn inputs one at a time. */
static double find_spread(call at, call moved, verdict *v)
{
    const size_t results = count_nonzeros(at.face->sparsity_out(0));
    double sum = 0.0;
    casadi_int i;
    for (i = 0; i < at.face->n_in(); ++i) {
        const size_t count = find_given(at.face->name_in(i)) ? 0 : count_nonzeros(at.face->sparsity_in(i));
        size_t k, r;
        for (k = 0; k < count; ++k) {
            double largest = 0.0;
            moved.in[i][k] = (casadi_real)((double)at.in[i][k] * (1.0 + ROUNDING));
            run(moved, v);
            moved.in[i][k] = at.in[i][k];
            for (r = 0; r < results; ++r)
                largest = maximum(largest, (double)moved.out[0][r] - (double)at.out[0][r]);
            sum += largest;
        }
    }
    return sum;
}

/* At random poses, the equations of loops may nearly depend on each other, and rounding of the pose decides: the results
 * may also differ by their spread. */
int mbs_check_same_accelerations(const mbs_face *f, const mbs_face *g)
{
    call a = open_call(f), b = open_call(g), moved = open_call(f);
    const size_t count = count_nonzeros(f->sparsity_out(0));
    verdict v = {0.0, 0};
    int state;
    for (state = 0; state < STATES && !v.failed; ++state) {
        double allowed;
        size_t k;
        set_state(a, state);
        set_state(b, state);
        set_state(moved, state);
        run(a, &v);
        run(b, &v);
        allowed = ACCELERATIONS * find_largest(a.out[0], count) + find_spread(a, moved, &v);
        for (k = 0; k < count; ++k)
            judge(&v, (double)a.out[0][k] - (double)b.out[0][k], allowed);
    }
    close_call(a);
    close_call(b);
    close_call(moved);
    return report(v, ACCELERATIONS, f->name, "against", g->name);
}

int mbs_check_mass_matrix(const mbs_face *semi, const mbs_face *impl)
{
    call terms = open_call(semi), residual = open_call(impl), rest = open_call(impl);
    const size_t n = count_nonzeros(impl->sparsity_out(0));
    const casadi_int *M = semi->sparsity_out(0);
    const casadi_real *qdd = find_input(residual, "qdd");
    verdict v = {0.0, 0};
    int state;
    for (state = 0; state < STATES; ++state) {
        size_t i, j;
        double size;
        set_state(terms, state);
        set_state(residual, state);
        set_state(rest, state);
        clear_input(rest, "qdd");
        run(terms, &v);
        run(residual, &v);
        run(rest, &v);
        size = maximum(find_largest(terms.out[0], count_nonzeros(M)), find_largest(rest.out[0], n));
        for (i = 0; i < n; ++i) {
            double sum = (double)rest.out[0][i] - (double)residual.out[0][i];
            for (j = 0; j < n; ++j)
                sum += find_entry(M, terms.out[0], (casadi_int)i, (casadi_int)j) * (double)qdd[j];
            judge(&v, sum, ROUNDING * size);
        }
    }
    close_call(terms);
    close_call(residual);
    close_call(rest);
    return report(v, ROUNDING, semi->name, "(M) against", impl->name);
}

int mbs_check_bias(const mbs_face *semi, const mbs_face *impl)
{
    call terms = open_call(semi), rest = open_call(impl);
    const size_t n = count_nonzeros(impl->sparsity_out(0));
    verdict v = {0.0, 0};
    int state;
    for (state = 0; state < STATES; ++state) {
        size_t i;
        set_state(terms, state);
        set_state(rest, state);
        clear_input(rest, "qdd");
        clear_input(rest, "u");
        run(terms, &v);
        run(rest, &v);
        for (i = 0; i < n; ++i)
            judge(&v, (double)terms.out[1][i] - (double)rest.out[0][i], ROUNDING * find_largest(rest.out[0], n));
    }
    close_call(terms);
    close_call(rest);
    return report(v, ROUNDING, semi->name, "(c) against", impl->name);
}

int mbs_check_accelerations(const mbs_face *f, const mbs_face *impl)
{
    call forward = open_call(f), residual = open_call(impl), rest = open_call(impl);
    const size_t n = count_nonzeros(impl->sparsity_out(0));
    verdict v = {0.0, 0};
    int state;
    for (state = 0; state < STATES; ++state) {
        size_t i;
        set_state(forward, state);
        set_state(residual, state);
        set_state(rest, state);
        clear_input(rest, "qdd");
        run(forward, &v);
        memcpy(find_input(residual, "qdd"), forward.out[0], n * sizeof *forward.out[0]);
        run(residual, &v);
        run(rest, &v);
        for (i = 0; i < n; ++i)
            judge(&v, (double)residual.out[0][i], ACCELERATIONS * find_largest(rest.out[0], n));
    }
    close_call(forward);
    close_call(residual);
    close_call(rest);
    return report(v, ACCELERATIONS, f->name, "put into", impl->name);
}
