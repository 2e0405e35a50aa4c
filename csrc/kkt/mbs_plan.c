/* Order, elimination tree, fronts: see mbs_plan.h. Liu, 1990, for the tree. */
#include "mbs_plan.h"

#include <stdlib.h>
#include <string.h>

#include "mbs_order.h"

#define NONE MBS_NONE

/* What a front takes, in nanoseconds, about: to begin with, for an entry, for a product. */
#define PER_FRONT 150.0
#define PER_ENTRY 0.5
#define PER_PRODUCT 0.15

static int *integers(size_t count)
{
    return malloc((count ? count : 1) * sizeof(int));
}

/* The neighbours of each unknown, each edge listed at both ends: neighbour[(*begin)[i]] .. . */
static int *make_neighbours(int n, const int *start, const int *row, int **begin)
{
    int *neighbour = integers(2 * (size_t)start[n]), *place = calloc((size_t)n + 2, sizeof *place);
    int j, k;
    *begin = place;
    if (!neighbour || !place) {
        free(neighbour);
        return 0;
    }
    for (j = 0; j < n; ++j)
        for (k = start[j]; k < start[j + 1]; ++k)
            if (row[k] != j) {
                ++place[row[k] + 2];
                ++place[j + 2];
            }
    for (j = 0; j < n; ++j)
        place[j + 2] += place[j + 1];
    for (j = 0; j < n; ++j)
        for (k = start[j]; k < start[j + 1]; ++k)
            if (row[k] != j) {
                neighbour[place[row[k] + 1]++] = j;
                neighbour[place[j + 1]++] = row[k];
            }
    return neighbour;
}

/* The tree of eliminations: parent[k] is the first that k is joined with when it is eliminated. */
static void make_tree(int n, const int *begin, const int *neighbour, const int *order, const int *rank, int *parent,
                      int *ancestor)
{
    int k, m;
    for (k = 0; k < n; ++k) {
        const int i = order[k];
        parent[k] = ancestor[k] = NONE;
        for (m = begin[i]; m < begin[i + 1]; ++m) {
            int j = rank[neighbour[m]];
            while (j < k && ancestor[j] != k) {
                const int up = ancestor[j];
                ancestor[j] = k;
                if (up == NONE) {
                    parent[j] = k;
                    break;
                }
                j = up;
            }
        }
    }
}

/* Number the nodes of a forest, of which `kept` are meant, children right before their parents: sequence[position]. */
static int traverse(int n, const int *parent, const char *kept, int *sequence, int *child, int *next)
{
    int k, node, top, count = 0;
    int *stack = sequence; /* grows from the end, which the sequence has not reached yet */
    for (k = 0; k <= n; ++k)
        child[k] = NONE;
    for (k = n; k-- > 0;)
        if (kept[k]) {
            const int up = parent[k] == NONE ? n : parent[k];
            next[k] = child[up];
            child[up] = k;
        }
    for (node = child[n]; node != NONE; node = next[node]) {
        top = n;
        stack[--top] = node;
        while (top < n) {
            const int down = child[stack[top]];
            if (down == NONE) {
                const int done = stack[top++];
                sequence[count++] = done;
            } else {
                child[stack[top]] = next[down];
                stack[--top] = down;
            }
        }
    }
    return count;
}

/* A plan under construction. Unknowns have their positions in the order as numbers, and a front has the number of its
 * last unknown. */
typedef struct {
    int n;
    int *begin, *neighbour;
    int *order, *rank;
    int *parent;
    int *list, *length; /* of an unknown: pool[list], ... are those it is joined with, and perhaps some before it */
    int *count;         /* of these after it */
    int *front;         /* the front of an unknown */
    int *own;           /* of a front: how many unknowns */
    int *into;          /* the front that it was merged into, or itself */
    char *kept;
    int *child, *next, *mark;
    int *memory, *pool;
    size_t used, room;
} draft;

/* Take the unknowns in another order, in which parents still follow their children. */
static void reorder(draft *s, const int *sequence)
{
    int *order = s->list, *parent = s->length, k;
    for (k = 0; k < s->n; ++k)
        s->front[sequence[k]] = k;
    for (k = 0; k < s->n; ++k) {
        const int up = s->parent[sequence[k]];
        order[k] = s->order[sequence[k]];
        parent[k] = up == NONE ? NONE : s->front[up];
    }
    memcpy(s->order, order, (size_t)s->n * sizeof *order);
    memcpy(s->parent, parent, (size_t)s->n * sizeof *parent);
    for (k = 0; k < s->n; ++k)
        s->rank[s->order[k]] = k;
}

/* Collect the unknowns after k that it is joined with; returns how many, or -1 if memory runs out. */
static int collect(draft *s, int k)
{
    const int i = s->order[k];
    size_t wanted = s->used + (size_t)(s->begin[i + 1] - s->begin[i]);
    int c, m, count = 0, *found;
    for (c = s->child[k]; c != NONE; c = s->next[c])
        wanted += (size_t)s->length[c];
    if (wanted > s->room) {
        int *pool = realloc(s->pool, 2 * wanted * sizeof *pool);
        if (!pool)
            return -1;
        s->pool = pool;
        s->room = 2 * wanted;
    }
    found = s->pool + s->used;
    for (m = s->begin[i]; m < s->begin[i + 1]; ++m) {
        const int j = s->rank[s->neighbour[m]];
        if (j > k) {
            s->mark[j] = k;
            found[count++] = j;
        }
    }
    for (c = s->child[k]; c != NONE; c = s->next[c])
        for (m = 0; m < s->length[c]; ++m) {
            const int j = s->pool[s->list[c] + m];
            if (j > k && s->mark[j] != k) {
                s->mark[j] = k;
                found[count++] = j;
            }
        }
    return count;
}

/* Find the fronts: runs of unknowns, each coupled with the next and with the neighbours of the next. */
static int find_fronts(draft *s)
{
    int k, last;
    for (k = 0; k < s->n; ++k)
        s->mark[k] = s->child[k] = NONE;
    for (k = 0; k < s->n; ++k) {
        const int up = s->parent[k], count = collect(s, k);
        if (count < 0)
            return -1;
        s->count[k] = count;
        if (k > 0 && s->parent[k - 1] == k && s->count[k - 1] == count + 1) {
            s->list[k] = s->list[k - 1];
            s->length[k] = s->length[k - 1];
            s->own[k] = s->own[k - 1] + 1;
            s->kept[k - 1] = 0;
        } else {
            s->list[k] = (int)s->used;
            s->length[k] = count;
            s->own[k] = 1;
            s->used += (size_t)count;
        }
        s->kept[k] = 1;
        if (up != NONE) {
            s->next[k] = s->child[up];
            s->child[up] = k;
        }
    }
    for (last = k = s->n - 1; k >= 0; --k) {
        if (s->kept[k])
            last = k;
        s->front[k] = s->into[k] = last;
    }
    return 0;
}

/* Time to eliminate `own` unknowns that are joined with `others`. */
static double expect(double own, double others)
{
    const double rows = own + others;
    const double products = (rows * (rows + 1) * (2 * rows + 1) - others * (others + 1) * (2 * others + 1)) / 6;
    return PER_FRONT + PER_ENTRY * rows * rows + PER_PRODUCT * products;
}

/* Merge fronts into their parents where that saves time: it costs products with zeros, and saves a front. */
static void merge_fronts(draft *s)
{
    int f;
    for (f = 0; f < s->n; ++f) {
        int up;
        if (!s->kept[f])
            continue;
        if (s->parent[f] == NONE)
            continue;
        up = s->front[s->parent[f]];
        if (expect(s->own[f] + s->own[up], s->count[up]) <
            expect(s->own[f], s->count[f]) + expect(s->own[up], s->count[up])) {
            s->own[up] += s->own[f];
            s->into[f] = up;
            s->kept[f] = 0;
        }
    }
    for (f = s->n; f-- > 0;) /* parents first */
        s->into[f] = s->into[f] == f ? f : s->into[s->into[f]];
    for (f = 0; f < s->n; ++f)
        if (s->parent[f] != NONE)
            s->parent[f] = s->into[s->front[s->parent[f]]];
}

/* Assign fronts and unknowns their final numbers: label[k] is the number of the draft's k. */
static void number(const draft *s, mbs_plan *plan, const int *sequence, int *label)
{
    int f, k;
    int *index = s->child;
    for (f = 0; f < plan->fronts; ++f)
        index[sequence[f]] = f;
    plan->first[0] = 0;
    for (f = 0; f < plan->fronts; ++f) {
        const int up = s->parent[sequence[f]];
        plan->first[f + 1] = plan->first[f] + s->own[sequence[f]];
        plan->expected += expect(s->own[sequence[f]], s->count[sequence[f]]);
        plan->parent[f] = up == NONE ? NONE : index[up];
        s->next[f] = plan->first[f];
    }
    for (k = 0; k < s->n; ++k) {
        const int place = s->next[index[s->into[s->front[k]]]]++;
        label[k] = place;
        plan->order[place] = s->order[k];
    }
}

/* List what the unknowns of each front are joined with besides each other, ascending, by distributing them twice. */
static int list_rows(const draft *s, mbs_plan *plan, const int *sequence, const int *label)
{
    const int n = s->n;
    int *begin = calloc((size_t)n + 2, sizeof *begin), *fronts, f, k, m;
    size_t total = 0;
    for (f = 0; f < plan->fronts; ++f)
        total += (size_t)s->count[sequence[f]];
    fronts = integers(total);
    plan->rows = integers(total);
    plan->place = integers(total);
    if (!begin || !fronts || !plan->rows || !plan->place) {
        free(begin);
        free(fronts);
        return -1;
    }
    for (f = 0; f < plan->fronts; ++f) {
        const int last = sequence[f];
        for (m = 0; m < s->length[last]; ++m) {
            const int j = s->pool[s->list[last] + m];
            if (j > last)
                ++begin[label[j] + 2];
        }
    }
    for (k = 0; k < n; ++k)
        begin[k + 2] += begin[k + 1];
    plan->begin[0] = 0;
    for (f = 0; f < plan->fronts; ++f) {
        const int last = sequence[f];
        for (m = 0; m < s->length[last]; ++m) {
            const int j = s->pool[s->list[last] + m];
            if (j > last)
                fronts[begin[label[j] + 1]++] = f;
        }
        plan->begin[f + 1] = plan->begin[f] + s->count[last];
        s->next[f] = plan->begin[f];
    }
    for (k = 0; k < n; ++k)
        for (m = begin[k]; m < begin[k + 1]; ++m)
            plan->rows[s->next[fronts[m]]++] = k;
    free(begin);
    free(fronts);
    return 0;
}

/* Find where each front's unknowns are: mark[k] is the place of k in front f. */
static void mark_places(const mbs_plan *plan, int f, int *mark)
{
    const int own = plan->first[f + 1] - plan->first[f];
    int k;
    for (k = 0; k < own; ++k)
        mark[plan->first[f] + k] = k;
    for (k = plan->begin[f]; k < plan->begin[f + 1]; ++k)
        mark[plan->rows[k]] = own + k - plan->begin[f];
}

/* Tell where what fronts leave, and the entries of the system, go. */
static int place_all(const draft *s, mbs_plan *plan, const int *start, const int *row)
{
    const int entries = start[s->n];
    int *front = s->front, *label = s->rank, *left = s->list, *child = s->child, *next = s->next;
    int f, j, k, c;
    plan->from = calloc((size_t)plan->fronts + 2, sizeof *plan->from);
    plan->which = integers(3 * (size_t)entries);
    if (!plan->from || !plan->which)
        return -1;
    plan->at_row = plan->which + entries;
    plan->at_column = plan->at_row + entries;
    for (f = 0; f < plan->fronts; ++f) {
        child[f] = NONE;
        for (k = plan->first[f]; k < plan->first[f + 1]; ++k) {
            front[k] = f;
            label[plan->order[k]] = k;
        }
    }
    for (f = plan->fronts; f-- > 0;)
        if (plan->parent[f] != NONE) {
            next[f] = child[plan->parent[f]];
            child[plan->parent[f]] = f;
        }
#define EARLIER(a, b) (label[a] < label[b] ? label[a] : label[b])
    for (j = 0; j < s->n; ++j)
        for (k = start[j]; k < start[j + 1]; ++k)
            ++plan->from[front[EARLIER(j, row[k])] + 2];
    for (f = 0; f < plan->fronts; ++f)
        plan->from[f + 2] += plan->from[f + 1];
    for (j = 0; j < s->n; ++j)
        for (k = start[j]; k < start[j + 1]; ++k) {
            const int place = plan->from[front[EARLIER(j, row[k])] + 1]++;
            plan->which[place] = k;
            plan->at_row[place] = label[row[k]];
            plan->at_column[place] = label[j];
        }
#undef EARLIER
    for (f = 0; f < plan->fronts; ++f) {
        mark_places(plan, f, left);
        for (k = plan->from[f]; k < plan->from[f + 1]; ++k) {
            const int a = left[plan->at_row[k]], b = left[plan->at_column[k]];
            plan->at_row[k] = a > b ? a : b;
            plan->at_column[k] = a > b ? b : a;
        }
        for (c = child[f]; c != NONE; c = next[c])
            for (k = plan->begin[c]; k < plan->begin[c + 1]; ++k)
                plan->place[k] = left[plan->rows[k]];
    }
    return 0;
}

static int start_draft(draft *s, int n, const int *start, const int *row, const char *weak, const int *partner)
{
    enum { INTEGERS = 14 };
    const size_t room = (size_t)n + 2;
    int **parts[] = {&s->order, &s->rank, &s->parent, &s->list, &s->length, &s->count, &s->front,
                     &s->own,   &s->into, &s->child,  &s->next, &s->mark};
    size_t part;
    int k;
    s->n = n;
    s->memory = integers(INTEGERS * room);
    s->kept = calloc(room, 1);
    s->neighbour = make_neighbours(n, start, row, &s->begin);
    if (!s->memory || !s->kept || !s->neighbour)
        return -1;
    for (part = 0; part < sizeof parts / sizeof *parts; ++part)
        *parts[part] = s->memory + part * room;
    if (mbs_order(n, s->begin, s->neighbour, weak, partner, s->order))
        return -1;
    for (k = 0; k < n; ++k) {
        s->rank[s->order[k]] = k;
        s->kept[k] = 1;
    }
    return 0;
}

static int make(draft *s, mbs_plan *plan, const int *start, const int *row, const char *weak, const int *partner)
{
    const int n = plan->n;
    int *sequence, *label;
    if (start_draft(s, n, start, row, weak, partner))
        return -1;
    sequence = s->memory + 12 * ((size_t)n + 2);
    label = s->memory + 13 * ((size_t)n + 2);
    make_tree(s->n, s->begin, s->neighbour, s->order, s->rank, s->parent, s->mark);
    traverse(s->n, s->parent, s->kept, sequence, s->child, s->next);
    reorder(s, sequence);
    if (find_fronts(s))
        return -1;
    merge_fronts(s);
    plan->fronts = traverse(s->n, s->parent, s->kept, sequence, s->child, s->next);
    plan->order = integers((size_t)s->n);
    plan->first = integers((size_t)plan->fronts + 1);
    plan->begin = integers((size_t)plan->fronts + 1);
    plan->parent = integers((size_t)plan->fronts);
    if (!plan->order || !plan->first || !plan->begin || !plan->parent)
        return -1;
    number(s, plan, sequence, label);
    return list_rows(s, plan, sequence, label) || place_all(s, plan, start, row);
}

mbs_plan *mbs_make_plan(int n, const int *start, const int *row, const char *weak, const int *partner)
{
    draft s = {0};
    mbs_plan *plan = calloc(1, sizeof *plan);
    int failed = -1;
    if (plan) {
        plan->holders = 1;
        plan->n = n;
        failed = make(&s, plan, start, row, weak, partner);
    }
    free(s.begin);
    free(s.neighbour);
    free(s.memory);
    free(s.pool);
    free(s.kept);
    if (failed) {
        mbs_release_plan(plan);
        return 0;
    }
    return plan;
}

void mbs_release_plan(mbs_plan *plan)
{
    if (!plan || --plan->holders > 0)
        return;
    free(plan->order);
    free(plan->first);
    free(plan->begin);
    free(plan->rows);
    free(plan->place);
    free(plan->parent);
    free(plan->from);
    free(plan->which);
    free(plan);
}
