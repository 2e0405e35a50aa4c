/* Matching by augmenting paths: see mbs_partners.h. */
#include "mbs_partners.h"

#include <math.h>
#include <stdlib.h>

#define NONE (-1)
#define WEAK 1e-6 /* ratio of a diagonal entry to the largest of its column up to which it is no pivot */

/* The edges between variables and multipliers, from both ends. */
typedef struct {
    int n, variables;
    int *begin, *other; /* the neighbours of i: other[begin[i]], ... */
    double *entry;      /* what joins them */
    int *mate;
    int *from;  /* of a node met on the way: the one that it was met from, or NONE */
    int *queue; /* nodes to go on from */
} sides;

/* Variables end where no entry off the diagonal lies in a later row and column both. */
static int count_variables(int n, const int *start, const int *row)
{
    int j, k, count = 0;
    for (j = 0; j < n; ++j)
        for (k = start[j]; k < start[j + 1]; ++k) {
            const int low = row[k] < j ? row[k] : j;
            if (row[k] != j && low >= count)
                count = low + 1;
        }
    return count;
}

int mbs_mark_weak(int n, const int *start, const int *row, const double *value, char *weak, double *work)
{
    double *most = work, *own = work + n;
    int i, j, k, count = 0;
    for (i = 0; i < n; ++i)
        most[i] = own[i] = 0.0;
    for (j = 0; j < n; ++j)
        for (k = start[j]; k < start[j + 1]; ++k) {
            const double x = fabs(value[k]);
            i = row[k];
            if (i == j)
                own[i] = x;
            else {
                most[i] = x > most[i] ? x : most[i];
                most[j] = x > most[j] ? x : most[j];
            }
        }
    for (i = 0; i < n; ++i)
        if (!weak[i] && own[i] <= WEAK * most[i]) {
            weak[i] = 1;
            ++count;
        }
    return count;
}

static void list_edges(sides *s, const int *start, const int *row, const double *value)
{
    int i, j, k, *place = s->begin;
    for (i = 0; i <= s->n + 1; ++i)
        place[i] = 0;
#define CROSSES(i, j) (((i) < s->variables) != ((j) < s->variables))
    for (j = 0; j < s->n; ++j)
        for (k = start[j]; k < start[j + 1]; ++k)
            if (CROSSES(row[k], j) && value[k] != 0.0) {
                ++place[row[k] + 2];
                ++place[j + 2];
            }
    for (i = 0; i < s->n; ++i)
        place[i + 2] += place[i + 1];
    for (j = 0; j < s->n; ++j)
        for (k = start[j]; k < start[j + 1]; ++k) {
            i = row[k];
            if (CROSSES(i, j) && value[k] != 0.0) {
                s->entry[place[i + 1]] = s->entry[place[j + 1]] = fabs(value[k]);
                s->other[place[i + 1]++] = j;
                s->other[place[j + 1]++] = i;
            }
        }
#undef CROSSES
}

/* Match i with the free unknown that has the largest entry with it. */
static void match_largest(sides *s, int i)
{
    int k, best = NONE;
    double most = 0.0;
    for (k = s->begin[i]; k < s->begin[i + 1]; ++k)
        if (s->mate[s->other[k]] == NONE && s->entry[k] > most) {
            most = s->entry[k];
            best = s->other[k];
        }
    if (best != NONE) {
        s->mate[i] = best;
        s->mate[best] = i;
    }
}

/* Match i, changing the mates of others, along the shortest path to a free unknown. Marks are cleared. */
static void match_along_path(sides *s, int i)
{
    int head = 0, tail = 0, met = 0, k, end = NONE;
    int *seen = s->queue + s->n;
    s->queue[tail++] = i;
    while (head < tail && end == NONE) {
        const int at = s->queue[head++];
        for (k = s->begin[at]; k < s->begin[at + 1] && end == NONE; ++k) {
            const int j = s->other[k];
            if (s->from[j] != NONE)
                continue;
            s->from[j] = at;
            seen[met++] = j;
            if (s->mate[j] == NONE)
                end = j;
            else
                s->queue[tail++] = s->mate[j];
        }
    }
    while (end != NONE) {
        const int at = s->from[end], next = at == i ? NONE : s->mate[at];
        s->mate[at] = end;
        s->mate[end] = at;
        end = next;
    }
    while (met-- > 0)
        s->from[seen[met]] = NONE;
}

/* Match the unknowns from `from` to `end` - 1 that are marked, or all of them: first with free ones. */
static void match(sides *s, int from, int end, const char *marked)
{
    int i;
    for (i = from; i < end; ++i)
        if ((!marked || marked[i]) && s->mate[i] == NONE)
            match_largest(s, i);
    for (i = from; i < end; ++i)
        if ((!marked || marked[i]) && s->mate[i] == NONE)
            match_along_path(s, i);
}

int mbs_find_partners(int n, const int *start, const int *row, const double *value, const char *weak, int all,
                      int *partner)
{
    const size_t room = (size_t)n + 2, edges = 2 * (size_t)start[n] + 1;
    int *integers = malloc((5 * room + edges) * sizeof *integers), i;
    double *numbers = malloc(edges * sizeof *numbers);
    sides s = {0};
    if (integers && numbers) {
        s.n = n;
        s.begin = integers;
        s.mate = partner;
        s.from = integers + room;
        s.queue = integers + 2 * room;
        s.other = integers + 5 * room;
        s.entry = numbers;
        s.variables = count_variables(n, start, row);
        list_edges(&s, start, row, value);
        for (i = 0; i < n; ++i)
            s.mate[i] = s.from[i] = NONE;
        match(&s, 0, s.variables, weak);
        if (all)
            match(&s, s.variables, n, 0);
    }
    i = integers && numbers ? 0 : -1;
    free(integers);
    free(numbers);
    return i;
}
