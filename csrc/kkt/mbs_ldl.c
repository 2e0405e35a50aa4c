/* Multifrontal elimination along a plan: see mbs_ldl.h.
 *
 * A front takes its own unknowns, then the unknowns for which its children found no pivots, then its others. Its
 * remainder goes on a stack, and its parent takes it from there. */
#include "mbs_ldl.h"

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

/* Numbers that become more as they must, aligned for vectors of MBS_LANES. */
typedef struct {
    void *memory;
    double *at;
    size_t used, room;
} numbers;

typedef struct {
    int *at;
    size_t used, room;
} names;

/* A front that has been eliminated. */
typedef struct {
    int eliminated, rows, stride;
    size_t L, D, names; /* where they begin */
} block;

/* What a front leaves: the lower triangle of `delayed` unknowns, whose names stand on a stack, and its others. */
typedef struct {
    int front, delayed, rows;
    size_t at;
} rest;

struct mbs_factors {
    mbs_plan *plan;
    block *blocks;
    numbers values; /* L and D of each block; behind them the front that is being eliminated */
    names names;    /* of the rows of each block */
    numbers work, pivots, stack;
    names waiting, place;
    rest *rests; /* a stack as well */
    int open;
    double *solution, *local;
};

static int hold_numbers(numbers *n, size_t wanted)
{
    if (wanted > n->room) {
        enum { LINE = MBS_LANES * sizeof(double) };
        const size_t room = wanted + wanted / 2;
        void *memory = malloc(room * sizeof(double) + LINE);
        double *at;
        if (!memory)
            return -1;
        at = (double *)((char *)memory + (LINE - (uintptr_t)memory % LINE));
        if (n->used)
            memcpy(at, n->at, n->used * sizeof *at);
        free(n->memory);
        n->memory = memory;
        n->at = at;
        n->room = room;
    }
    return 0;
}

static int hold_names(names *n, size_t wanted)
{
    if (wanted > n->room) {
        const size_t room = wanted + wanted / 2;
        int *at = realloc(n->at, room * sizeof *at);
        if (!at)
            return -1;
        n->at = at;
        n->room = room;
    }
    return 0;
}

/* A front while it is filled. */
typedef struct {
    int own, delayed, rows, stride;
} shape;

static double *open_numbers(const mbs_factors *f)
{
    return f->values.at + f->values.used;
}

/* Where the plan's place of an unknown is, when others that waited stand between. */
static int shift(const shape *s, int place)
{
    return place < s->own ? place : place + s->delayed;
}

/* Add what a child left; its unknowns that wait get the places from `at` on. */
static void add_rest(mbs_factors *f, const rest *r, const shape *s, int at)
{
    const mbs_plan *plan = f->plan;
    const int *other = plan->place + plan->begin[r->front];
    const double *column = f->stack.at + r->at;
    double *front = open_numbers(f);
    int *place = f->place.at, i, j;
    for (i = 0; i < r->delayed; ++i)
        place[i] = at + i;
    for (; i < r->rows; ++i)
        place[i] = shift(s, other[i - r->delayed]);
    for (j = 0; j < r->rows; ++j, column += r->rows) {
        double *to = front + (size_t)place[j] * (size_t)s->stride;
        if (j < r->delayed)
            for (i = j; i < r->rows; ++i) {
                const int low = place[i] < place[j] ? place[i] : place[j], high = place[i] + place[j] - low;
                front[(size_t)low * (size_t)s->stride + (size_t)high] += column[i];
            }
        else
            for (i = j; i < r->rows; ++i)
                to[place[i]] += column[i];
    }
}

/* Make room for front k, and name its unknowns. Returns how many rests it takes, or -1 if memory runs out. */
static int open_front(mbs_factors *f, int k, shape *s)
{
    const mbs_plan *plan = f->plan;
    int i, children = 0, *name;
    s->own = plan->first[k + 1] - plan->first[k];
    s->delayed = 0;
    while (children < f->open && plan->parent[f->rests[f->open - 1 - children].front] == k)
        s->delayed += f->rests[f->open - 1 - children++].delayed;
    s->rows = s->own + s->delayed + plan->begin[k + 1] - plan->begin[k];
    s->stride = mbs_stride(s->rows);
    if (hold_names(&f->names, f->names.used + (size_t)s->rows) || hold_names(&f->place, (size_t)s->rows))
        return -1;
    if (hold_numbers(&f->values, f->values.used + (size_t)(s->rows + 2) * (size_t)s->stride + MBS_LANES) ||
        hold_numbers(&f->work, (size_t)(s->own + s->delayed) * (size_t)(s->stride + MBS_LANES)) ||
        hold_numbers(&f->pivots, 2 * (size_t)(s->own + s->delayed)))
        return -1;
    name = f->names.at + f->names.used;
    for (i = 0; i < s->own; ++i)
        *name++ = plan->first[k] + i;
    f->waiting.used -= (size_t)s->delayed;
    for (i = 0; i < s->delayed; ++i)
        *name++ = f->waiting.at[f->waiting.used + (size_t)i];
    for (i = plan->begin[k]; i < plan->begin[k + 1]; ++i)
        *name++ = plan->rows[i];
    return children;
}

static void fill_front(mbs_factors *f, int k, const shape *s, int children, const double *value)
{
    const mbs_plan *plan = f->plan;
    double *front = open_numbers(f);
    int e, j, at = s->own + s->delayed;
    for (j = 0; j < s->rows; ++j) {
        const int from = mbs_lane(j);
        memset(front + (size_t)j * (size_t)s->stride + from, 0, (size_t)(s->stride - from) * sizeof *front);
    }
    for (e = plan->from[k]; e < plan->from[k + 1]; ++e) {
        const int i = shift(s, plan->at_row[e]);
        j = shift(s, plan->at_column[e]);
        front[(size_t)j * (size_t)s->stride + (size_t)i] += value[plan->which[e]];
    }
    while (children-- > 0) {
        const rest *r = f->rests + --f->open;
        at -= r->delayed;
        add_rest(f, r, s, at);
        f->stack.used = r->at;
    }
}

/* Keep the factors of a front, and leave the rest to its parent. Returns -1 if memory runs out. */
static int close_front(mbs_factors *f, int k, const shape *s, int eliminated)
{
    const int left = s->rows - eliminated, delayed = s->own + s->delayed - eliminated;
    const size_t size = (size_t)eliminated * (size_t)s->stride;
    block *b = f->blocks + k;
    rest *r = f->rests + f->open;
    int i, j;
    if (hold_numbers(&f->stack, f->stack.used + (size_t)left * (size_t)left) ||
        hold_names(&f->waiting, f->waiting.used + (size_t)delayed))
        return -1;
    b->eliminated = eliminated;
    b->rows = s->rows;
    b->stride = s->stride;
    b->L = f->values.used;
    b->D = b->L + size;
    b->names = f->names.used;
    f->names.used += (size_t)s->rows;
    r->front = k;
    r->delayed = delayed;
    r->rows = left;
    r->at = f->stack.used;
    for (i = 0; i < delayed; ++i)
        f->waiting.at[f->waiting.used++] = f->names.at[b->names + (size_t)(eliminated + i)];
    for (j = 0; j < left; ++j) {
        double *to = f->stack.at + f->stack.used + (size_t)j * (size_t)left;
        const double *from = open_numbers(f) + (size_t)(eliminated + j) * (size_t)s->stride + eliminated;
        memcpy(to + j, from + j, (size_t)(left - j) * sizeof *to);
    }
    f->stack.used += (size_t)left * (size_t)left;
    f->open += left > 0;
    for (i = 0; i < 2 * eliminated; ++i)
        f->values.at[b->D + (size_t)i] = f->pivots.at[i];
    f->values.used = b->D + (size_t)mbs_stride(2 * eliminated);
    return 0;
}

mbs_met mbs_factorise(mbs_factors *f, const double *value, const mbs_pivoting *pivoting)
{
    const mbs_plan *plan = f->plan;
    mbs_met met = {0};
    int k;
    f->values.used = f->names.used = f->stack.used = f->waiting.used = 0;
    f->open = 0;
    for (k = 0; k < plan->fronts; ++k) {
        const int root = plan->parent[k] == MBS_NONE;
        shape s;
        mbs_eliminated e;
        const int children = open_front(f, k, &s);
        if (children < 0)
            break;
        fill_front(f, k, &s, children, value);
        e = mbs_eliminate(open_numbers(f), s.rows, s.stride, s.own + s.delayed, root, pivoting, f->pivots.at,
                          f->names.at + f->names.used, f->work.at);
        met.negative += e.negative;
        met.zeros += e.zeros;
        met.front = s.rows > met.front ? s.rows : met.front;
        if (root)
            s.rows = e.eliminated; /* what has no pivot is left out */
        else
            met.delayed += s.own + s.delayed - e.eliminated;
        if (close_front(f, k, &s, e.eliminated))
            break;
    }
    met.failed = k < plan->fronts;
    met.entries = (long)f->values.used;
    return met;
}

/* y = D^-1 y */
static void divide(const double *D, int n, double *y)
{
    int i;
    for (i = 0; i < n; ++i) {
        const double a = D[2 * i], b = D[2 * i + 1];
        if (b == 0.0)
            y[i] /= a;
        else {
            const double c = D[2 * i + 2], t = a / b, u = c / b, scale = 1.0 / (b * (t * u - 1.0));
            const double one = y[i], two = y[i + 1];
            y[i] = scale * (u * one - two);
            y[++i] = scale * (t * two - one);
        }
    }
}

void mbs_solve(const mbs_factors *f, double *x)
{
    const mbs_plan *plan = f->plan;
    double *solution = f->solution, *y = f->local;
    int i, j, k;
    for (k = 0; k < plan->n; ++k)
        solution[k] = x[plan->order[k]];
    for (k = 0; k < plan->fronts; ++k) {
        const block *b = f->blocks + k;
        const int *name = f->names.at + b->names;
        const double *L = f->values.at + b->L;
        for (i = 0; i < b->eliminated; ++i)
            y[i] = solution[name[i]];
        for (i = b->eliminated; i < b->stride; ++i)
            y[i] = 0.0;
        for (j = 0; j < b->eliminated; ++j, L += b->stride) {
            const int from = mbs_lane(j + 1);
            mbs_subtract(b->stride - from, y[j], L + from, y + from);
        }
        for (i = b->eliminated; i < b->rows; ++i)
            solution[name[i]] += y[i];
        divide(f->values.at + b->D, b->eliminated, y);
        for (i = 0; i < b->eliminated; ++i)
            solution[name[i]] = y[i];
    }
    for (k = plan->fronts; k-- > 0;) {
        const block *b = f->blocks + k;
        const int *name = f->names.at + b->names;
        const double *L = f->values.at + b->L;
        for (i = 0; i < b->rows; ++i)
            y[i] = solution[name[i]];
        for (; i < b->stride; ++i)
            y[i] = 0.0;
        for (j = b->eliminated; j-- > 0;) {
            const int from = mbs_lane(j + 1);
            y[j] -= mbs_dot(b->stride - from, L + (size_t)j * (size_t)b->stride + from, y + from);
        }
        for (i = 0; i < b->eliminated; ++i)
            solution[name[i]] = y[i];
    }
    for (k = 0; k < plan->n; ++k)
        x[plan->order[k]] = solution[k];
}

/* Numbers of all blocks and of the largest front, if none has to wait. */
static size_t expect_numbers(const mbs_plan *plan)
{
    size_t blocks = 0, front = 0;
    int k;
    for (k = 0; k < plan->fronts; ++k) {
        const int own = plan->first[k + 1] - plan->first[k], rows = own + plan->begin[k + 1] - plan->begin[k];
        const size_t stride = (size_t)mbs_stride(rows), size = (size_t)(rows + 2) * stride + MBS_LANES;
        blocks += (size_t)own * stride + (size_t)mbs_stride(2 * own);
        front = size > front ? size : front;
    }
    return blocks + front;
}

mbs_factors *mbs_make_factors(mbs_plan *plan)
{
    mbs_factors *f = calloc(1, sizeof *f);
    const size_t fronts = (size_t)plan->fronts + 1, n = (size_t)plan->n + MBS_LANES;
    if (!f)
        return 0;
    f->plan = plan;
    ++plan->holders;
    f->blocks = malloc(fronts * sizeof *f->blocks);
    f->rests = malloc(fronts * sizeof *f->rests);
    f->solution = malloc(n * sizeof *f->solution);
    f->local = malloc(n * sizeof *f->local);
    if (!f->blocks || !f->rests || !f->solution || !f->local || hold_numbers(&f->values, expect_numbers(plan))) {
        mbs_free_factors(f);
        return 0;
    }
    return f;
}

const mbs_plan *mbs_plan_of(const mbs_factors *f)
{
    return f->plan;
}

void mbs_free_factors(mbs_factors *f)
{
    if (!f)
        return;
    mbs_release_plan(f->plan);
    free(f->blocks);
    free(f->rests);
    free(f->solution);
    free(f->local);
    free(f->values.memory);
    free(f->names.at);
    free(f->work.memory);
    free(f->pivots.memory);
    free(f->stack.memory);
    free(f->waiting.at);
    free(f->place.at);
    free(f);
}
