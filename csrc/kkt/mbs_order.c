/* Approximate minimum degree on the quotient graph: see mbs_order.h.
 *
 * An eliminated unknown becomes an element, the set of the unknowns that it joined. The neighbours of an unknown are
 * a list of elements, then a list of unknowns; both stay in the memory of its first neighbours, since they never grow.
 * Unknowns with the same neighbours form one supervariable, which counts all its members. */
#include "mbs_order.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define NONE (-1)
#define FEW 64  /* neighbours that any unknown may have */
#define MANY 5  /* times the root of the number of unknowns: neighbours that it may have in larger systems */

typedef struct {
    int n, total; /* nodes; unknowns that they hold */
    int eliminated;
    /* of unknowns: what they touch, `elements` elements, then `unknowns` unknowns, from list[start] on */
    int *list, *start, *elements, *unknowns;
    int *size;   /* members; 0: eliminated or merged; negative while it belongs to the newest element */
    int *degree; /* an upper bound of the members of other supervariables that it is joined with */
    int *member, *last; /* of a supervariable: its members as a chain, and the end of the chain */
    int *credit;  /* members with a pivot, less members without one; of an element: over all unknowns that it absorbed */
    char *listed; /* whether it may be eliminated */
    /* by degree: chains of supervariables that may be eliminated */
    int *head, *next, *previous;
    int least;
    /* of elements, which keep the name of their unknown: the members, from pool[begin] on */
    int *begin, *extent;
    int *weight; /* members, counted as unknowns; 0: absorbed */
    long long *outside; /* stamp + members outside of the newest element */
    long long stamp;
    int *pool;
    size_t used, room;
    int *bucket, *link, *seen, *touched; /* to find supervariables that touch the same */
} graph;

static void enlist(graph *g, int i)
{
    const int d = g->degree[i], follower = g->head[d];
    g->next[i] = follower;
    g->previous[i] = NONE;
    if (follower != NONE)
        g->previous[follower] = i;
    g->head[d] = i;
    g->listed[i] = 1;
    if (d < g->least)
        g->least = d;
}

static void unlist(graph *g, int i)
{
    if (!g->listed[i])
        return;
    g->listed[i] = 0;
    if (g->previous[i] != NONE)
        g->next[g->previous[i]] = g->next[i];
    else
        g->head[g->degree[i]] = g->next[i];
    if (g->next[i] != NONE)
        g->previous[g->next[i]] = g->previous[i];
}

/* Take the supervariable of least degree. */
static int choose(graph *g)
{
    int i;
    while (g->least < g->total && g->head[g->least] == NONE)
        ++g->least;
    if (g->least >= g->total) {
        for (i = g->n; i-- > 0;)
            if (g->size[i] > 0 && !g->listed[i])
                enlist(g, i); /* they wait for each other */
        while (g->head[g->least] == NONE)
            ++g->least;
    }
    i = g->head[g->least];
    unlist(g, i);
    return i;
}

/* Let i join the newest element, if it has not yet. */
static int join(graph *g, int i)
{
    const int size = g->size[i];
    if (size <= 0)
        return 0;
    g->size[i] = -size;
    g->pool[g->used++] = i;
    unlist(g, i);
    return size;
}

/* Make p an element, which absorbs the elements that p touches; returns -1 if memory runs out. */
static int eliminate(graph *g, int p)
{
    const int *list = g->list + g->start[p];
    size_t wanted = g->used + (size_t)g->unknowns[p];
    int k, m, weight = 0;
    for (k = 0; k < g->elements[p]; ++k)
        wanted += (size_t)g->extent[list[k]];
    if (wanted > g->room) {
        const size_t room = 2 * wanted;
        int *pool = realloc(g->pool, room * sizeof *pool);
        if (!pool)
            return -1;
        g->pool = pool;
        g->room = room;
    }
    g->eliminated += g->size[p];
    g->size[p] = 0;
    g->begin[p] = (int)g->used;
    for (k = 0; k < g->elements[p]; ++k) {
        const int e = list[k];
        if (!g->weight[e])
            continue;
        for (m = 0; m < g->extent[e]; ++m)
            weight += join(g, g->pool[g->begin[e] + m]);
        g->weight[e] = 0;
        g->credit[p] += g->credit[e];
    }
    for (k = 0; k < g->unknowns[p]; ++k)
        weight += join(g, list[g->elements[p] + k]);
    g->extent[p] = (int)g->used - g->begin[p];
    g->weight[p] = weight;
    return 0;
}

/* Count, for each element that touches the newest one, the members outside of that. */
static void count_outside(graph *g, int p)
{
    int m, k;
    for (m = 0; m < g->extent[p]; ++m) {
        const int i = g->pool[g->begin[p] + m], size = -g->size[i], *list = g->list + g->start[i];
        for (k = 0; k < g->elements[i]; ++k) {
            const int e = list[k];
            if (!g->weight[e])
                continue;
            if (g->outside[e] < g->stamp)
                g->outside[e] = g->stamp + g->weight[e];
            g->outside[e] -= size;
        }
    }
}

/* Update the neighbours of a member i of the newest element p. Returns an upper bound for the number of its neighbours
 * outside p, and a hash of its neighbours. */
static int refresh(graph *g, int p, int i, unsigned *hash)
{
    int *list = g->list + g->start[i];
    const int elements = g->elements[i], unknowns = g->unknowns[i];
    int k, kept = 0, count = 0, degree = 0;
    unsigned sum = (unsigned)p;
    for (k = 0; k < unknowns; ++k) {
        const int j = list[elements + k];
        if (g->size[j] > 0) {
            g->touched[count++] = j;
            degree += g->size[j];
            sum += (unsigned)j;
        }
    }
    for (k = 0; k < elements; ++k) {
        const int e = list[k];
        if (!g->weight[e])
            continue;
        if (g->outside[e] == g->stamp) { /* nothing outside: p holds all of it */
            g->weight[e] = 0;
            g->credit[p] += g->credit[e];
            continue;
        }
        degree += (int)(g->outside[e] - g->stamp);
        sum += (unsigned)e;
        list[kept++] = e;
    }
    list[kept++] = p;
    memcpy(list + kept, g->touched, (size_t)count * sizeof *list);
    g->elements[i] = kept;
    g->unknowns[i] = count;
    *hash = sum % (unsigned)g->n;
    return degree;
}

/* Return whether a supervariable has pivots, by itself or through eliminated neighbours. */
static int has_pivots(const graph *g, int i)
{
    const int *list = g->list + g->start[i];
    int k, credit = g->credit[i];
    for (k = 0; k < g->elements[i]; ++k)
        credit += g->credit[list[k]];
    return credit >= 0;
}

static void append(graph *g, int i, int j)
{
    g->member[g->last[i]] = j;
    g->last[i] = g->last[j];
    g->size[j] = 0;
}

/* Tell whether j touches what was marked as touched by i. */
static int touches_same(const graph *g, int i, int j, int mark)
{
    const int *list = g->list + g->start[j];
    int k;
    if (g->elements[i] != g->elements[j] || g->unknowns[i] != g->unknowns[j])
        return 0;
    for (k = 0; k < g->elements[j] + g->unknowns[j]; ++k)
        if (g->seen[list[k]] != mark)
            return 0;
    return 1;
}

/* Merge the members of a bucket that touch the same. */
static void merge(graph *g, int first, int *mark)
{
    int i, j, k, before;
    for (i = first; i != NONE; i = g->link[i]) {
        const int *list = g->list + g->start[i];
        if (g->link[i] == NONE)
            return;
        ++*mark;
        for (k = 0; k < g->elements[i] + g->unknowns[i]; ++k)
            g->seen[list[k]] = *mark;
        for (before = i, j = g->link[i]; j != NONE; j = g->link[j])
            if (touches_same(g, i, j, *mark)) {
                g->size[i] += g->size[j];
                g->credit[i] += g->credit[j];
                append(g, i, j);
                g->link[before] = g->link[j];
            } else
                before = j;
    }
}

/* Give the members of the newest element their new degrees; those joined with nothing else go with p. */
static void update(graph *g, int p, int *mark)
{
    const int *members = g->pool + g->begin[p];
    const int extent = g->extent[p];
    int m, kept = 0;
    unsigned *hash = (unsigned *)g->touched + g->n;
    for (m = 0; m < extent; ++m) {
        const int i = members[m], degree = refresh(g, p, i, &hash[m]);
        if (g->elements[i] == 1 && !g->unknowns[i]) {
            g->credit[p] += g->credit[i];
            g->eliminated -= g->size[i];
            g->weight[p] += g->size[i];
            append(g, p, i);
            continue;
        }
        if (degree < g->degree[i])
            g->degree[i] = degree;
        g->link[i] = g->bucket[hash[m]];
        g->bucket[hash[m]] = i;
    }
    for (m = 0; m < extent; ++m) {
        const int first = g->bucket[hash[m]];
        g->bucket[hash[m]] = NONE;
        if (first != NONE)
            merge(g, first, mark);
    }
    for (m = 0; m < extent; ++m) {
        const int i = members[m], size = -g->size[i], rest = g->total - g->eliminated - size;
        int degree;
        if (!size)
            continue;
        g->size[i] = size;
        degree = g->degree[i] + g->weight[p] - size;
        g->degree[i] = degree < rest ? degree : rest;
        if (has_pivots(g, i))
            enlist(g, i);
        g->pool[g->begin[p] + kept++] = i;
    }
    g->extent[p] = kept;
    g->used = (size_t)(g->begin[p] + kept);
    g->stamp += g->total + 1;
}

int mbs_most_neighbours(int n)
{
    const int many = (int)(MANY * sqrt((double)n));
    return many > FEW ? many : FEW;
}

/* Assign unknowns to nodes: one to each, or a pair that needs each other for a pivot; NONE for unknowns with too many
 * neighbours. */
static void assign_nodes(graph *g, int n, const int *start, const int *partner, int *node)
{
    const int most = mbs_most_neighbours(n);
    int i;
    for (i = 0; i < n; ++i) {
        const int mate = partner[i];
        if (start[i + 1] - start[i] > most)
            node[i] = NONE;
        else {
            ++g->total;
            node[i] = mate != NONE && mate < i && node[mate] != NONE ? node[mate] : g->n++;
        }
    }
}

/* List the neighbours of each node. */
static void start_graph(graph *g, int n, const int *start, const int *adjacent, const char *weak, const int *partner,
                        const int *node)
{
    int i, k, used = 0;
    for (k = 0; k <= n; ++k)
        g->head[k] = NONE;
    for (k = 0; k < g->n; ++k) {
        g->size[k] = g->elements[k] = g->unknowns[k] = g->degree[k] = g->weight[k] = g->credit[k] = 0;
        g->listed[k] = 0;
        g->member[k] = g->seen[k] = g->bucket[k] = NONE;
        g->last[k] = k;
        g->outside[k] = 0;
    }
    for (i = 0; i < n; ++i)
        if (node[i] != NONE) {
            const int alone = partner[i] == NONE || node[partner[i]] == NONE;
            ++g->size[node[i]];
            g->credit[node[i]] += weak[i] && alone ? -1 : !weak[i];
        }
    for (i = 0; i < n; ++i) {
        const int own = node[i], mate = partner[i];
        int both[2] = {i, mate}, b;
        if (own == NONE || (mate != NONE && mate < i && node[mate] == own))
            continue;
        g->start[own] = used;
        for (b = 0; b < g->size[own]; ++b)
            for (k = start[both[b]]; k < start[both[b] + 1]; ++k) {
                const int other = node[adjacent[k]];
                if (other != NONE && other != own && g->seen[other] != own) {
                    g->seen[other] = own;
                    g->list[used++] = other;
                    g->degree[own] += g->size[other];
                }
            }
        g->unknowns[own] = used - g->start[own];
    }
    for (k = 0; k < g->n; ++k)
        g->seen[k] = NONE;
    g->stamp = 1;
    for (g->least = n, k = g->n; k-- > 0;)
        if (g->credit[k] >= 0)
            enlist(g, k);
}

/* Write the members of the nodes in the order of their elimination, then the unknowns of no node. */
static void write_order(int n, const int *node, const int *sequence, int nodes, int *order, int *place)
{
    int i, k, used = 0;
    for (k = 0; k < nodes; ++k)
        place[sequence[k]] = 0;
    for (i = 0; i < n; ++i)
        if (node[i] != NONE)
            ++place[node[i]];
    for (k = 0; k < nodes; ++k) {
        const int size = place[sequence[k]];
        place[sequence[k]] = used;
        used += size;
    }
    for (i = 0; i < n; ++i)
        order[node[i] == NONE ? used++ : place[node[i]]++] = i;
}

int mbs_order(int n, const int *start, const int *adjacent, const char *weak, const int *partner, int *order)
{
    enum { INTEGERS = 21 };
    const size_t room = (size_t)n + 1;
    int k = 0, mark = 0, failed = 0;
    int *work = malloc((INTEGERS * room + (size_t)start[n]) * sizeof *work);
    graph g = {0};
    g.outside = malloc(room * sizeof *g.outside);
    g.listed = malloc(room);
    if (work && g.outside && g.listed) {
        int *node, *sequence;
        int **parts[] = {&g.start,    &g.elements, &g.unknowns, &g.size,   &g.degree,  &g.member, &g.last,
                         &g.head,     &g.next,     &g.previous, &g.begin,  &g.extent,  &g.weight, &g.bucket,
                         &g.link,     &g.seen,     &g.credit,   &node,     &sequence,
                         &g.touched};
        size_t part;
        for (part = 0; part < sizeof parts / sizeof *parts; ++part)
            *parts[part] = work + part * room;
        g.list = work + INTEGERS * room;
        assign_nodes(&g, n, start, partner, node);
        start_graph(&g, n, start, adjacent, weak, partner, node);
        while (k < g.n) {
            int i;
            const int p = choose(&g);
            failed = eliminate(&g, p);
            if (failed)
                break;
            count_outside(&g, p);
            update(&g, p, &mark);
            for (i = p; i != NONE; i = g.member[i])
                sequence[k++] = i;
        }
        if (!failed)
            write_order(n, node, sequence, g.n, order, g.link);
    } else
        failed = -1;
    free(work);
    free(g.outside);
    free(g.listed);
    free(g.pool);
    return failed;
}
