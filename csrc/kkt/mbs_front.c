/* Dense elimination within a front: see mbs_front.h. */
#include "mbs_front.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

#define COLUMNS 4       /* columns of a tile of the remainder; its rows are MBS_LANES */
#define GOOD 0.01       /* ratio of a pivot to its column from which on none better is looked for */
#define LOOKS 3         /* columns that are looked at for a better one */
#define PANEL 32        /* candidates for pivots that are looked at, and updated, at once */
#define CANCELLED 1e-14 /* a determinant, relative to the terms of its difference */

static double larger(double a, double b)
{
    return a > b ? a : b;
}

/* A front while it is eliminated. */
typedef struct {
    double *a;
    int rows, stride, pivots;
    int done, next; /* unknowns that are eliminated; the candidate that is looked at first */
    int first, end; /* the panel: the pivots since `first` have not updated the columns from `end` on */
    double *d;
    int *name;
    double *old; /* D LT, by rows, `pitch` apart */
    size_t pitch;
} state;

static double *entry(const state *s, int i, int j)
{
    return i >= j ? s->a + (size_t)j * (size_t)s->stride + i : s->a + (size_t)i * (size_t)s->stride + j;
}

/* Exchange unknowns i < j, both at least `done` and below `pivots`. */
static void exchange(state *s, int i, int j)
{
    double *a = s->a;
    const size_t stride = (size_t)s->stride;
    int k;
    double t;
    if (i == j)
        return;
    for (k = 0; k < i; ++k) {
        double *column = a + (size_t)k * stride;
        t = column[i], column[i] = column[j], column[j] = t;
    }
    for (k = i + 1; k < j; ++k) {
        double *x = a + (size_t)i * stride + k, *y = a + (size_t)k * stride + j;
        t = *x, *x = *y, *y = t;
    }
    for (k = j + 1; k < s->rows; ++k) {
        double *x = a + (size_t)i * stride + k, *y = a + (size_t)j * stride + k;
        t = *x, *x = *y, *y = t;
    }
    t = *entry(s, i, i), *entry(s, i, i) = *entry(s, j, j), *entry(s, j, j) = t;
    k = s->name[i], s->name[i] = s->name[j], s->name[j] = k;
}

/* The largest of n numbers, whatever their signs. */
static double peak(const double *a, int n)
{
    double most[MBS_LANES] = {0.0}, top = 0.0;
    int i, m;
    if (n < MBS_LANES) {
        for (i = 0; i < n; ++i)
            top = larger(top, fabs(a[i]));
        return top;
    }
    for (i = 0; i < n; i += MBS_LANES) {
        const double *at = a + (i + MBS_LANES > n ? n - MBS_LANES : i); /* the last ones overlap */
        for (m = 0; m < MBS_LANES; ++m) {
            const double x = fabs(at[m]);
            most[m] = x > most[m] ? x : most[m];
        }
    }
    for (m = 0; m < MBS_LANES / 2; ++m)
        most[m] = larger(most[m], most[m + MBS_LANES / 2]);
    return larger(larger(most[0], most[1]), larger(most[2], most[3]));
}

/* What is off the diagonal of a column. */
typedef struct {
    int row;                     /* of the largest entry among the candidates for pivots, or -1 */
    double among, second, below; /* that entry, the next one among them, and the largest one of all other rows */
} view;

static view look(const state *s, int c)
{
    const double *diagonal = entry(s, c, c), *across = s->a + (size_t)s->done * (size_t)s->stride + c;
    view found = {-1, 0.0, 0.0, 0.0};
    int i;
#define MEET(entry)                                    \
    {                                                  \
        const double x = fabs(entry);                  \
        if (x > found.among) {                         \
            found.second = found.among;                \
            found.among = x;                           \
            found.row = i;                             \
        } else                                         \
            found.second = larger(found.second, x);    \
    }
    for (i = s->done; i < c; ++i, across += s->stride)
        MEET(*across)
    for (++i; i < s->end; ++i)
        MEET(diagonal[i - c])
#undef MEET
    found.below = peak(diagonal + (s->end - c), s->rows - s->end);
    return found;
}

/* A pivot: one unknown, or two; and how large it is beside the rest of its columns: 0, nothing; 1, as large. */
typedef struct {
    int first, second;
    double ratio;
} pivot;

static void prefer(pivot *best, int first, int second, double ratio)
{
    if (ratio > best->ratio) {
        best->first = first;
        best->second = second;
        best->ratio = ratio;
    }
}

/* Look at c and the row of its largest entry as a pair, and at that row alone. */
static void consider_pair(const state *s, int c, const view *of_c, double zero, pivot *best)
{
    const int r = of_c->row;
    const view of_r = look(s, r);
    const double a = *entry(s, c, c), b = *entry(s, r, c), d = *entry(s, r, r);
    const double x = fabs(a), y = fabs(b), z = fabs(d), scale = larger(x, larger(y, z));
    const double rest_c = larger(of_c->second, of_c->below);
    const double rest_r = larger(of_r.row == c ? of_r.second : of_r.among, of_r.below);
    const double det = fabs(a / scale * d - b / scale * b);
    if (det > zero && det > CANCELLED * scale) {
        const double growth = larger(z * rest_c + y * rest_r, y * rest_c + x * rest_r) / scale;
        prefer(best, c, r, growth > 0.0 ? det / growth : HUGE_VAL);
    }
    if (z > zero)
        prefer(best, r, -1, z / larger(rest_r, y));
}

/* Find a pivot that is good, or the best of those looked at: of some, if they meet the threshold, or of all. Look first
 * at candidates that have not been found bad lately. */
static pivot search(state *s, double threshold, double zero)
{
    pivot best = {-1, -1, 0.0};
    int looks, c = s->next;
    for (looks = 1; looks <= s->end - s->done; ++looks, ++c) {
        double x, top;
        view of_c;
        if (c < s->done || c >= s->end)
            c = s->done;
        of_c = look(s, c);
        x = fabs(*entry(s, c, c));
        top = larger(of_c.among, of_c.below);
        if (x > zero)
            prefer(&best, c, -1, top > 0.0 ? x / top : HUGE_VAL);
        if (best.ratio < GOOD && of_c.row >= 0 && of_c.among > zero)
            consider_pair(s, c, &of_c, zero, &best);
        if (best.ratio >= threshold && (best.ratio >= GOOD || looks >= LOOKS))
            break;
    }
    s->next = c + 1;
    return best;
}

/* Keep column k as it is before it becomes L's. */
static const double *keep(const state *s, int k)
{
    double *old = s->old + (size_t)k * s->pitch;
    memcpy(old, s->a + (size_t)k * (size_t)s->stride, (size_t)s->stride * sizeof *old);
    return old;
}

/* Subtract a column of L, times a number, from column i. */
static void update(const state *s, int i, double x, const double *column)
{
    const int from = mbs_lane(i);
    mbs_subtract(s->stride - from, x, column + from, s->a + (size_t)i * (size_t)s->stride + from);
}

/* Eliminate the next unknown, and update the columns of the panel. */
static void eliminate_one(state *s)
{
    const int k = s->done;
    double *column = s->a + (size_t)k * (size_t)s->stride;
    const double own = column[k], inverse = 1.0 / own, *old = keep(s, k);
    int i;
    for (i = mbs_lane(k); i <= k; ++i)
        column[i] = 0.0;
    for (i = mbs_lane(k); i < s->stride; ++i)
        column[i] *= inverse;
    for (i = k + 1; i < s->end; ++i)
        update(s, i, old[i], column);
    s->d[2 * k] = own;
    s->d[2 * k + 1] = 0.0;
    s->done = k + 1;
}

/* Eliminate the next two. */
static void eliminate_two(state *s)
{
    const int k = s->done;
    const size_t stride = (size_t)s->stride;
    double *one = s->a + (size_t)k * stride, *two = one + stride;
    const double a = one[k], b = one[k + 1], c = two[k + 1], t = a / b, u = c / b, f = 1.0 / (b * (t * u - 1.0));
    const double *old_one = keep(s, k), *old_two = keep(s, k + 1);
    int i;
    for (i = mbs_lane(k); i < k + 2; ++i)
        one[i] = two[i] = 0.0;
    for (i = mbs_lane(k); i < s->stride; ++i) {
        const double x = one[i], y = two[i];
        one[i] = f * (u * x - y);
        two[i] = f * (t * y - x);
    }
    for (i = k + 2; i < s->end; ++i) {
        update(s, i, old_one[i], one);
        update(s, i, old_two[i], two);
    }
    s->d[2 * k] = a;
    s->d[2 * k + 1] = b;
    s->d[2 * k + 2] = c;
    s->d[2 * k + 3] = 0.0;
    s->done = k + 2;
}

/* Subtract L D LT, of the pivots from `from` on, from a tile: MBS_LANES rows from i on, COLUMNS columns from j on, or to
 * the one before `end`. */
static void subtract_tile(const state *s, int from, int i, int j, int end)
{
    const size_t stride = (size_t)s->stride;
    const int width = end - j < COLUMNS ? end - j : COLUMNS;
    const int height = s->rows - i < MBS_LANES ? s->rows - i : MBS_LANES;
    const double *l = s->a + (size_t)from * stride + i, *w = s->old + (size_t)from * s->pitch + j;
    double a[MBS_LANES] = {0.0}, b[MBS_LANES] = {0.0}, c[MBS_LANES] = {0.0}, d[MBS_LANES] = {0.0};
    const double *const sums[COLUMNS] = {a, b, c, d};
    int k, m, n;
    for (k = from; k < s->done; ++k, l += stride, w += s->pitch) {
        const double p = w[0], q = w[1], r = w[2], t = w[3];
        for (m = 0; m < MBS_LANES; ++m)
            a[m] += l[m] * p;
        for (m = 0; m < MBS_LANES; ++m)
            b[m] += l[m] * q;
        for (m = 0; m < MBS_LANES; ++m)
            c[m] += l[m] * r;
        for (m = 0; m < MBS_LANES; ++m)
            d[m] += l[m] * t;
    }
    for (n = 0; n < width; ++n) {
        double *to = s->a + (size_t)(j + n) * stride + i;
        for (m = 0; m < height; ++m)
            to[m] -= sums[n][m];
    }
}

/* Subtract L D LT, of the pivots from `from` on, from the columns `begin` .. `end` - 1. */
static void subtract_products(const state *s, int from, int begin, int end)
{
    int i, j;
    for (j = begin; j < end; j += COLUMNS)
        for (i = j; i < s->rows; i += MBS_LANES)
            subtract_tile(s, from, i, j, end);
}

/* Take further candidates into the panel. Returns 0 if there are none. */
static int widen(state *s)
{
    if (s->end == s->pivots)
        return 0;
    subtract_products(s, s->first, s->end, s->pivots);
    s->first = s->done;
    s->next = s->end;
    s->end = s->pivots - s->end < PANEL ? s->pivots : s->end + PANEL;
    return 1;
}

mbs_eliminated mbs_eliminate(double *front, int rows, int stride, int pivots, int last, const mbs_pivoting *pivoting,
                             double *d, int *name, double *work)
{
    state s = {front, rows, stride, pivots, 0, 0, 0, pivots < PANEL ? pivots : PANEL, d, name, work,
               (size_t)stride + MBS_LANES};
    mbs_eliminated result = {0, 0, 0};
    while (s.done < pivots) {
        const pivot best = search(&s, pivoting->threshold, pivoting->zero);
        if (best.ratio < pivoting->threshold) {
            if (widen(&s))
                continue;
            if (!last || !(best.ratio > 0.0))
                break;
        }
        exchange(&s, s.done, best.first);
        if (best.second < 0) {
            eliminate_one(&s);
            result.negative += d[2 * s.done - 2] < 0.0;
        } else {
            exchange(&s, s.done + 1, best.second == s.done ? best.first : best.second);
            eliminate_two(&s);
            {
                const double *pair = d + 2 * s.done - 4;
                const int opposite = pair[0] / pair[1] * (pair[2] / pair[1]) < 1.0;
                result.negative += opposite ? 1 : 2 * (pair[0] < 0.0);
            }
        }
    }
    if (last)
        result.zeros = pivots - s.done;
    else
        subtract_products(&s, 0, pivots, rows);
    result.eliminated = s.done;
    return result;
}
