/* The factorisation of sparse indefinite systems: solutions and inertia by dense methods that are written out here, orders
 * of elimination, partners of unknowns that have no pivot. */
#include <stdlib.h>

static long memory_left = -1; /* which of the next requests for memory fails, or none */

static int lacks(void)
{
    return memory_left >= 0 && memory_left-- == 0;
}

#define malloc(size) (lacks() ? 0 : malloc(size))
#define calloc(count, size) (lacks() ? 0 : calloc(count, size))
#define realloc(from, size) (lacks() ? 0 : realloc(from, size))
#include "../../../csrc/kkt/mbs_front.c"
#define update update_graph
#include "../../../csrc/kkt/mbs_order.c"
#undef update
#undef NONE
#include "../../../csrc/kkt/mbs_partners.c"
#undef NONE
#include "../../../csrc/kkt/mbs_ldl.c"
#include "../../../csrc/kkt/mbs_plan.c"

#include "laws.h"

enum { N = 42 };

static unsigned seed = 11;

static double draw(void)
{
    seed = seed * 1103515245u + 12345u;
    return (double)(seed / 65536 % 2001) / 1000 - 1;
}

static double least; /* the size of the smallest eigenvalue that was found last */

/* Eigenvalues below zero, by Jacobi's rotations. */
static int count_negative(int n, const double *matrix)
{
    static double a[N * N];
    int sweep, p, q, k, count = 0;
    memcpy(a, matrix, (size_t)(n * n) * sizeof *a);
    for (sweep = 0; sweep < 9; ++sweep)
        for (p = 0; p < n; ++p)
            for (q = p + 1; q < n; ++q) {
                const double t = (a[q * n + q] - a[p * n + p]) / 2, b = a[p * n + q];
                const double way = b == 0 ? 0 : (t < 0 ? -b : b) / (fabs(t) + sqrt(t * t + b * b));
                const double c = 1 / sqrt(1 + way * way), s = way * c;
                for (k = 0; k < n; ++k) {
                    const double x = a[k * n + p], y = a[k * n + q];
                    a[k * n + p] = c * x - s * y, a[k * n + q] = s * x + c * y;
                }
                for (k = 0; k < n; ++k) {
                    const double x = a[p * n + k], y = a[q * n + k];
                    a[p * n + k] = c * x - s * y, a[q * n + k] = s * x + c * y;
                }
            }
    for (p = 0, least = HUGE_VAL; p < n; ++p)
        count += a[p * n + p] < 0, least = fmin(least, fabs(a[p * n + p]));
    return count;
}

/* A system as the solver takes it: of each pair of entries one, above or below the diagonal by turns. */
typedef struct {
    int n, variables, start[N + 1], row[N * N];
    double dense[N * N], value[N * N], right[N];
} sparse;

static void gather(sparse *s)
{
    int i, j, at = 0;
    for (j = 0; j < s->n; ++j) {
        s->start[j] = at;
        for (i = 0; i < s->n; ++i) {
            const int is_given = i == j || ((i + j) % 2 && i < s->variables && j < s->variables ? i < j : i > j);
            if (is_given && (i == j || s->dense[i * s->n + j] != 0))
                s->row[at] = i, s->value[at++] = s->dense[i * s->n + j];
        }
        s->right[j] = draw();
    }
    s->start[s->n] = at;
}

/* [H JT; J 0] at random: each row of J has a large entry of another variable. */
static void fill(sparse *s, int variables, int multipliers, double density, double kept)
{
    const int n = variables + multipliers;
    int i, j;
    memset(s, 0, sizeof *s);
    s->n = n, s->variables = variables;
    for (i = 0; i < n; ++i)
        for (j = 0; j <= i; ++j) {
            double x = (draw() + 1) / 2 < density ? draw() : 0;
            if (i == j)
                x = i < variables && (draw() + 1) / 2 < kept ? 2 * draw() + 0.1 : 0;
            else if (i >= variables && j >= variables)
                x = 0;
            else if (i - variables == j)
                x = 3 + draw();
            s->dense[i * n + j] = s->dense[j * n + i] = x;
        }
    gather(s);
}

/* What every plan keeps. */
static void check_plan(const mbs_plan *p, const sparse *s)
{
    char seen[N * N] = {0};
    int f, k;
    for (k = 0; k < p->n; ++k) {
        LAW("each unknown is eliminated once", !seen[p->order[k]]);
        seen[p->order[k]] = 1;
    }
    memset(seen, 0, sizeof seen);
    for (f = 0; f < p->fronts; ++f) {
        LAW("fronts have unknowns", p->first[f + 1] > p->first[f]);
        LAW("and give what is left to a later one",
            p->parent[f] == MBS_NONE ? p->begin[f + 1] == p->begin[f] : p->parent[f] > f && p->begin[f + 1] > p->begin[f]);
        for (k = p->begin[f]; k < p->begin[f + 1]; ++k)
            LAW("others come later, ascending",
                p->rows[k] >= p->first[f + 1] && (k == p->begin[f] || p->rows[k] > p->rows[k - 1]));
        for (k = p->from[f]; k < p->from[f + 1]; ++k) {
            LAW("each entry goes to one front", !seen[p->which[k]]);
            seen[p->which[k]] = 1;
            LAW("into its lower triangle", p->at_row[k] >= p->at_column[k]);
        }
    }
    LAW("all unknowns are in fronts", p->first[p->fronts] == s->n && p->from[p->fronts] == s->start[s->n]);
}

static mbs_met solve(const sparse *s, int all, double threshold, double *off)
{
    const mbs_pivoting pivoting = {threshold, 1e-20};
    char weak[N + 1] = {0};
    int partner[N + 1], i, j;
    double room[2 * N + 1], x[N + 1], most = 1e-300, size = 0;
    mbs_plan *plan;
    mbs_factors *factors;
    mbs_met met;
    mbs_mark_weak(s->n, s->start, s->row, s->value, weak, room);
    LAW("partners are found", mbs_find_partners(s->n, s->start, s->row, s->value, weak, all, partner) == 0);
    plan = mbs_make_plan(s->n, s->start, s->row, weak, partner);
    check_plan(plan, s);
    factors = mbs_make_factors(plan);
    LAW("factors hold their plan", mbs_plan_of(factors) == plan);
    mbs_release_plan(plan);
    met = mbs_factorise(factors, s->value, &pivoting);
    met = mbs_factorise(factors, s->value, &pivoting); /* once more, in the same memory */
    memcpy(x, s->right, sizeof s->right);
    if (!met.zeros)
        mbs_solve(factors, x);
    for (i = 0, *off = 0; i < s->n; ++i) {
        double sum = -s->right[i];
        for (j = 0; j < s->n; ++j)
            sum += s->dense[i * s->n + j] * x[j], size = fmax(size, fabs(x[j]));
        most = fmax(most, fabs(sum));
    }
    *off = most / (1 + size);
    mbs_free_factors(factors);
    return met;
}

static void systems(void)
{
    static sparse s;
    double off;
    int turn, all, i, negative, solved = 0;
    for (turn = 0; turn < 60; ++turn) {
        const int variables = 1 + turn % 24, multipliers = variables * (turn % 4) / 4;
        fill(&s, variables, multipliers, turn % 5 == 4 ? 1 : 0.1 + 0.1 * (turn % 3), turn % 3 ? 0.6 : 1);
        for (i = 0; i < variables && turn % 7 == 6; ++i) /* definite where nothing else is there */
            s.dense[i * s.n + i] = 40;
        gather(&s);
        negative = count_negative(s.n, s.dense);
        if (least < 1e-3)
            continue;
        ++solved;
        for (all = 0; all < 2; ++all) {
            const mbs_met met = solve(&s, all, 1e-8, &off);
            LAW("a regular system has all pivots", met.failed == 0 && met.zeros == 0);
            LAW("their signs are those of the eigenvalues", met.negative == negative);
            LAW("solutions have nearly all digits", off < 1e-7);
            LAW("sizes are told", met.front >= 1 && met.front <= s.n && met.entries >= s.n && met.delayed >= 0);
        }
        solve(&s, 1, 0.1, &off);
        LAW("a high threshold keeps more of them", off < 1e-11);
    }
    LAW("most systems at random are regular", solved > 40);
    for (turn = 0; turn < 4; ++turn) { /* more unknowns than a panel, half of them without own pivots */
        fill(&s, N - 3 * turn, 0, 1, 1);
        for (i = 0; i < s.n * s.n; ++i)
            if (i / s.n < s.n / 2 && i % s.n < s.n / 2)
                s.dense[i] = 0;
        gather(&s);
        LAW("dense ones, too", solve(&s, 0, 0.01, &off).negative == count_negative(s.n, s.dense) && off < 1e-9);
    }
}

static void singular(void)
{
    static sparse s;
    double off;
    int i, turn;
    for (turn = 0; turn < 10; ++turn) {
        fill(&s, 8 + turn, 3, 0.4, 1);
        for (i = 0; i < s.n; ++i)
            s.dense[(s.n - 1) * s.n + i] = s.dense[i * s.n + s.n - 1] = 0;
        gather(&s);
        LAW("a multiplier of nothing has no pivot", solve(&s, turn % 2, 1e-8, &off).zeros == 1);
    }
    fill(&s, 3, 0, 0, 1);
    memset(s.dense, 0, sizeof s.dense), gather(&s);
    LAW("nothing has no pivot", solve(&s, 0, 1e-8, &off).zeros == 3);
    s.value[1] = NAN;
    LAW("nor has no number", solve(&s, 0, 1e-8, &off).zeros >= 1);
}

/* Dense elimination: L D LT of the pivots, and what is left, beside the unknowns that follow. */
static void fronts(void)
{
    static double A[N * N], front[N * 64 + 64], work[N * 56], d[2 * N];
    int name[N], turn, i, j, k;
    for (turn = 0; turn < 40; ++turn) {
        const int rows = 2 + turn % 40, pivots = turn % 4 ? rows - rows / 3 : rows, stride = mbs_stride(rows), last = pivots == rows;
        const mbs_pivoting pivoting = {turn % 2 ? 0.1 : 1e-8, 1e-20};
        double off = 0, size = 0;
        mbs_eliminated e;
        memset(front, 0, sizeof front);
        for (i = 0; i < rows; ++i)
            for (name[i] = i, j = 0; j <= i; ++j)
                A[i * N + j] = A[j * N + i] = i == j && i % 3 == turn % 3 ? 0 : draw();
        for (j = 0; j < rows; ++j)
            for (i = j; i < rows; ++i)
                front[j * stride + i] = A[i * N + j];
        e = mbs_eliminate(front, rows, stride, pivots, last, &pivoting, d, name, work);
        LAW("pivots are found", e.eliminated <= pivots && (e.eliminated == pivots || !last) && e.zeros == 0);
        for (i = 0; i < rows; ++i)
            for (j = 0; j <= i; ++j) {
                double sum = i < e.eliminated || j < e.eliminated || last ? 0 : front[j * stride + i];
                for (k = 0; k < e.eliminated && k <= j + 1; ++k) {
                    const double l = i == k ? 1 : i > k ? front[k * stride + i] : 0, own = d[2 * k];
                    const double m = j == k ? 1 : j > k ? front[k * stride + j] : 0;
                    sum += l * own * m;
                    if (d[2 * k + 1] != 0) {
                        const double l2 = i == k + 1 ? 1 : i > k + 1 ? front[(k + 1) * stride + i] : 0;
                        const double m2 = j == k + 1 ? 1 : j > k + 1 ? front[(k + 1) * stride + j] : 0;
                        sum += d[2 * k + 1] * (l * m2 + l2 * m);
                    }
                }
                off = fmax(off, fabs(sum - A[name[i] * N + name[j]]));
            }
        for (k = 0; k < e.eliminated; ++k)
            for (i = mbs_lane(k); i < stride; ++i) {
                LAW("above its diagonal L is 0", i > k || front[k * stride + i] == 0);
                LAW("and below its last row", i < rows || front[k * stride + i] == 0);
                size = fmax(size, fabs(front[k * stride + i]));
            }
        LAW("L D LT and the remainder are the system", off < (turn % 2 ? 1e-11 : 1e-6));
        LAW("a threshold bounds the factors", turn % 2 == 0 || size < 100);
        for (i = 0; i < rows; ++i)
            for (j = 0; j < i; ++j)
                LAW("each name is there once, and rows of others stay", name[i] != name[j] && (i < pivots || name[i] == i));
    }
}

/* Unknowns wait that have no pivot in their front: too small beside their column. */
static void waiting(void)
{
    double front[8 * 3 + 8] = {0}, d[6], work[3 * 16];
    const mbs_pivoting pivoting = {0.1, 1e-3};
    int name[3] = {0, 1, 2};
    mbs_eliminated e;
    front[0] = 0.05, front[2] = 1, front[8 + 1] = -2, front[16 + 2] = 5;
    e = mbs_eliminate(front, 3, 8, 2, 0, &pivoting, d, name, work);
    LAW("a pivot below the threshold waits", e.eliminated == 1 && e.negative == 1 && name[0] == 1 && name[1] == 0);
    LAW("the other is taken", d[0] == -2 && d[1] == 0 && e.zeros == 0);
    LAW("and the remainder has it", front[8 + 1] == 0.05 && front[8 + 2] == 1 && front[16 + 2] == 5);
    memset(front, 0, sizeof front), name[0] = 0, name[1] = 1;
    front[0] = 0.05, front[2] = 0.4, front[8 + 1] = -2, front[16 + 2] = 5;
    e = mbs_eliminate(front, 3, 8, 2, 0, &pivoting, d, name, work);
    LAW("one above it does not", e.eliminated == 2 && name[2] == 2 && near(front[16 + 2], 5 - 0.16 / 0.05));
    memset(front, 0, sizeof front), name[0] = 0, name[1] = 1;
    front[0] = 0.9e-3, front[8 + 1] = 1.1e-3;
    e = mbs_eliminate(front, 2, 8, 2, 1, &pivoting, d, name, work);
    LAW("what is not above zero is none", e.eliminated == 1 && e.zeros == 1 && d[0] == 1.1e-3);
    memset(front, 0, sizeof front), name[0] = 0, name[1] = 1;
    front[0] = 1e-3, front[1] = 2, front[8 + 1] = 1e-3;
    e = mbs_eliminate(front, 2, 8, 2, 1, &pivoting, d, name, work);
    LAW("two unknowns are a pivot together, of both signs", e.eliminated == 2 && e.negative == 1 && fabs(d[1]) == 2);
    memset(front, 0, sizeof front), name[0] = 0, name[1] = 1;
    front[0] = -3, front[1] = 0.1, front[8 + 1] = -4;
    e = mbs_eliminate(front, 2, 8, 2, 1, &pivoting, d, name, work);
    LAW("signs count", e.eliminated == 2 && e.negative == 2);
}

/* Two unknowns (0.5, 1; 1, 0.25) beside a third one, by 4 and 2. */
static void pairs(void)
{
    double front[8 * 3 + 8] = {0};
    const state s = {front, 3, 8, 2, 0, 0, 0, 2, 0, 0, 0, 0};
    pivot best = {-1, -1, 0};
    view of;
    front[0] = 0.5, front[1] = 1, front[2] = 4, front[8 + 1] = 0.25, front[8 + 2] = 2;
    of = look(&s, 0);
    LAW("a column is seen", of.row == 1 && of.among == 1 && of.second == 0 && of.below == 4);
    consider_pair(&s, 0, &of, 1e-20, &best);
    LAW("a pair is as good as its inverse is small", best.first == 0 && best.second == 1 && near(best.ratio, 0.875 / 5));
    front[2] = of.below = 100, best.ratio = 0;
    consider_pair(&s, 0, &of, 1e-20, &best);
    LAW("or one of both is better alone", best.first == 1 && best.second == -1 && best.ratio == 0.125);
    front[2] = of.below = front[8 + 2] = 0.1, best.ratio = 0;
    consider_pair(&s, 0, &of, 1e-20, &best);
    LAW("far better beside small numbers", near(best.ratio, 0.875 / 0.15));
    front[2] = of.below = front[8 + 2] = 0;
    consider_pair(&s, 0, &of, 1e-20, &best);
    LAW("a pair beside nothing is the best", best.first == 0 && best.second == 1 && best.ratio == HUGE_VAL);
}

/* Edges of a graph, each at both ends. */
typedef struct {
    int n, start[402], adjacent[4000];
} graph_of;

static void connect(graph_of *g, int n, int edges, int (*const edge)[2])
{
    int i, e;
    g->n = n, g->start[0] = 0;
    for (i = 0; i < n; ++i) {
        int at = g->start[i];
        for (e = 0; e < edges; ++e)
            if (edge[e][0] == i || edge[e][1] == i)
                g->adjacent[at++] = edge[e][0] + edge[e][1] - i;
        g->start[i + 1] = at;
    }
}

/* The edges that elimination in an order adds. */
static int count_fill(const graph_of *g, const int *order)
{
    static char joined[400][400], done[400];
    int i, j, k, l, fill = 0;
    memset(joined, 0, sizeof joined), memset(done, 0, sizeof done);
    for (i = 0; i < g->n; ++i)
        for (k = g->start[i]; k < g->start[i + 1]; ++k)
            joined[i][g->adjacent[k]] = 1;
    for (k = 0; k < g->n; ++k) {
        i = order[k], done[i] = 1;
        for (j = 0; j < g->n; ++j)
            for (l = 0; l < j && joined[i][j] && !done[j]; ++l)
                if (joined[i][l] && !done[l] && !joined[j][l])
                    joined[j][l] = joined[l][j] = 1, ++fill;
    }
    return fill;
}

static void orders(void)
{
    static graph_of g;
    static int edge[2000][2], order[400], partner[400], place[400];
    char weak[400] = {0};
    int turn, i, k, e;
    for (i = 0; i < 400; ++i)
        partner[i] = -1;
    for (turn = 0; turn < 12; ++turn) {
        const int n = 2 + 10 * turn;
        for (i = 1; i < n; ++i) /* a chain, a star, or a tree at random */
            edge[i - 1][0] = i, edge[i - 1][1] = turn % 3 == 0 ? i - 1 : turn % 3 == 1 ? 0 : (int)((draw() + 1) / 2.001 * i);
        connect(&g, n, n - 1, edge);
        LAW("there is an order", mbs_order(n, g.start, g.adjacent, weak, partner, order) == 0);
        for (i = 0; i < n; ++i)
            place[i] = -1;
        for (k = 0; k < n; ++k)
            LAW("of each unknown", place[order[k]] == -1 && (place[order[k]] = k) >= 0);
        LAW("a tree gets no fill", count_fill(&g, order) == 0);
    }
    for (e = 0, i = 0; i < 144; ++i) { /* a grid of 12 by 12 */
        if (i % 12)
            edge[e][0] = i, edge[e++][1] = i - 1;
        if (i >= 12)
            edge[e][0] = i, edge[e++][1] = i - 12;
    }
    connect(&g, 144, e, edge);
    mbs_order(144, g.start, g.adjacent, weak, partner, order);
    e = count_fill(&g, order);
    for (k = 0; k < 144; ++k)
        order[k] = k;
    LAW("a grid gets much less than row by row", e * 2 < count_fill(&g, order));
    for (e = 0, i = 0; i < 300; ++i) { /* a chain, whose unknowns are all joined with the first */
        if (i > 1)
            edge[e][0] = i, edge[e++][1] = 0;
        if (i > 0)
            edge[e][0] = i, edge[e++][1] = i - 1;
    }
    connect(&g, 300, e, edge);
    mbs_order(300, g.start, g.adjacent, weak, partner, order);
    LAW("an unknown with too many neighbours is the last", order[299] == 0);
    weak[299] = 1, partner[299] = 0, partner[0] = 299;
    mbs_order(300, g.start, g.adjacent, weak, partner, order);
    for (k = 0; k < 300; ++k)
        place[order[k]] = k;
    LAW("a weak one whose partner that is waits for another", place[299] > place[298]);
    for (weak[299] = 0, i = 0; i < 300; ++i)
        partner[i] = -1;
    LAW("too many are more than 64, or 5 roots", mbs_most_neighbours(4) == 64 && mbs_most_neighbours(10000) == 500);
    LAW("which are few in a large system", mbs_most_neighbours(170) == 65);
}

/* Unknowns without own pivots: after a neighbour that has one, or with their partners. */
static void weak_ones(void)
{
    static graph_of g;
    static int edge[400][2], order[100], partner[100], place[100];
    char weak[100];
    int turn, i, k;
    for (turn = 0; turn < 20; ++turn) {
        const int n = 40, half = n / 2;
        int e = 0;
        for (i = 0; i < n; ++i)
            partner[i] = -1, weak[i] = (char)(i >= half);
        for (i = half; i < n; ++i) { /* multipliers of two variables each */
            edge[e][0] = i, edge[e++][1] = i - half;
            edge[e][0] = i, edge[e++][1] = (i - half + 1 + turn) % half;
        }
        for (i = 1; i < half; ++i)
            edge[e][0] = i, edge[e++][1] = i - 1;
        for (i = half; i < n && turn % 2; ++i)
            partner[i] = i - half, partner[i - half] = i;
        connect(&g, n, e, edge);
        mbs_order(n, g.start, g.adjacent, weak, partner, order);
        for (k = 0; k < n; ++k)
            place[order[k]] = k;
        for (i = half; i < n; ++i) {
            int before = 0;
            for (k = g.start[i]; k < g.start[i + 1]; ++k)
                before += place[g.adjacent[k]] < place[i];
            LAW("a multiplier waits for a variable", turn % 2 || before > 0);
            LAW("or goes with its partner", turn % 2 == 0 || abs(place[i] - place[i - half]) == 1);
        }
    }
}

/* The most pairs, by trying all partners of each variable in turn. */
static int most_pairs(const sparse *s, int i, int used)
{
    int k, best;
    if (i == s->variables)
        return 0;
    best = most_pairs(s, i + 1, used);
    for (k = s->variables; k < s->n; ++k)
        if (s->dense[i * s->n + k] != 0 && !(used >> k & 1)) {
            const int more = 1 + most_pairs(s, i + 1, used | 1 << k);
            best = more > best ? more : best;
        }
    return best;
}

static void partners(void)
{
    static sparse s;
    int partner[N], turn, i, j, pairs;
    char weak[N];
    for (turn = 0; turn < 60; ++turn) {
        const int variables = 2 + turn % 5, n = variables + 1 + turn % 4;
        memset(&s, 0, sizeof s), s.n = n, s.variables = variables;
        for (i = 0; i < variables; ++i)
            for (j = variables; j < n; ++j)
                s.dense[i * n + j] = s.dense[j * n + i] = draw() > 0.2 ? draw() + 2 : 0;
        s.dense[(variables - 1) * n + variables] = s.dense[variables * n + variables - 1] = 1; /* who is a variable is seen */
        gather(&s);
        memset(weak, 1, sizeof weak);
        LAW("partners are found", mbs_find_partners(n, s.start, s.row, s.value, weak, turn % 2, partner) == 0);
        for (i = pairs = 0; i < n; ++i) {
            LAW("a pair is mutual, and joined", partner[i] < 0 || (partner[partner[i]] == i && s.dense[i * n + partner[i]] != 0));
            pairs += partner[i] >= 0;
        }
        LAW("as many as there can be", pairs == 2 * most_pairs(&s, 0, 0));
        memset(weak, 0, sizeof weak);
        mbs_find_partners(n, s.start, s.row, s.value, weak, 0, partner);
        for (i = 0; i < n; ++i)
            LAW("strong unknowns need none", partner[i] < 0);
    }
}

static void weakness(void)
{
    const int start[5] = {0, 2, 4, 6, 7}, row[7] = {0, 3, 1, 3, 2, 3, 3};
    const double value[7] = {-1.1e-6, -1, 0.9e-6, 1, 5, 1e9, 0};
    char weak[4] = {0, 0, 0, 0};
    double work[8];
    LAW("a small diagonal entry is weak", mbs_mark_weak(4, start, row, value, weak, work) == 3);
    LAW("beside the largest of its column, of any sign", weak[0] == 0 && weak[1] == 1 && weak[2] == 1 && weak[3] == 1);
    weak[0] = 1;
    LAW("marks stay", mbs_mark_weak(4, start, row, value, weak, work) == 0 && weak[0] == 1);
    {
        const int lone[4] = {0, 1, 2, 3}, small[3] = {2, 1, 2};
        const double few[3] = {1e-3, 1e-10, 1e-2};
        int i;
        for (i = 0; i < 6; ++i)
            work[i] = 1, weak[i / 2] = 0;
        LAW("what has no diagonal entry is weak", mbs_mark_weak(3, lone, small, few, weak, work) == 1 && weak[0] == 1);
        LAW("what has nothing else is not", weak[1] == 0 && weak[2] == 0);
    }
}

/* A hub, joined with one of two weak unknowns of each pair: pairs go first, since they are the ends of a tree. */
static void hanging_pairs(void)
{
    static graph_of g;
    static int edge[20][2], order[21], partner[21];
    char weak[21];
    int i;
    for (i = 0; i < 10; ++i) {
        edge[2 * i][0] = 2 * i, edge[2 * i][1] = 2 * i + 1;
        edge[2 * i + 1][0] = 2 * i + 1, edge[2 * i + 1][1] = 20;
        partner[2 * i] = 2 * i + 1, partner[2 * i + 1] = 2 * i, weak[2 * i] = weak[2 * i + 1] = 1;
    }
    weak[20] = 0, partner[20] = -1;
    connect(&g, 21, 20, edge);
    mbs_order(21, g.start, g.adjacent, weak, partner, order);
    LAW("a pair needs no other pivot", order[20] == 20 || order[18] == 20);
    LAW("and is no reason for fill", count_fill(&g, order) == 0);
}

/* One front of eight unknowns: L with a stride of eight, D of sixteen numbers, and room for the front alone. */
static void rooms(void)
{
    static sparse s;
    const mbs_pivoting pivoting = {1e-8, 1e-20};
    int partner[8], i;
    char weak[8] = {0};
    mbs_plan *plan;
    mbs_factors *factors;
    fill(&s, 8, 0, 1, 1);
    for (i = 0; i < 8; ++i)
        s.dense[9 * i] = 40, partner[i] = -1;
    gather(&s);
    plan = mbs_make_plan(8, s.start, s.row, weak, partner);
    factors = mbs_make_factors(plan);
    LAW("room is expected", factors->values.room >= 80 && plan->fronts == 1);
    free(factors->values.memory), memset(&factors->values, 0, sizeof factors->values);
    hold_numbers(&factors->values, 48);
    LAW("of half as much again", factors->values.room == 72);
    for (i = 0; i < 48; ++i)
        factors->values.at[i] = i;
    factors->values.used = 48, hold_numbers(&factors->values, 73);
    for (i = 0; i < 48; ++i)
        LAW("what is there moves to new room", factors->values.at[i] == i);
    factors->values.used = 0;
    LAW("entries are those of L and D", mbs_factorise(factors, s.value, &pivoting).entries == 80 && factors->values.room >= 80);
    mbs_free_factors(factors), mbs_release_plan(plan);
}

/* Each request for memory may fail: somebody says so, and all the rest is given back. */
static void scarce(void)
{
    static sparse s;
    const mbs_pivoting pivoting = {1e-8, 1e-20};
    char weak[N] = {0};
    double room[2 * N];
    int partner[N], k, is_enough = 0;
    fill(&s, 24, 6, 0.2, 0.5);
    mbs_mark_weak(s.n, s.start, s.row, s.value, weak, room);
    for (k = 0; !is_enough; ++k) {
        mbs_plan *plan = 0;
        mbs_factors *factors = 0;
        int is_done = 0;
        memory_left = k;
        if (mbs_find_partners(s.n, s.start, s.row, s.value, weak, 1, partner) == 0)
            plan = mbs_make_plan(s.n, s.start, s.row, weak, partner);
        if (plan)
            factors = mbs_make_factors(plan);
        if (factors)
            is_done = !mbs_factorise(factors, s.value, &pivoting).failed;
        is_enough = memory_left >= 0;
        LAW("where memory runs out nothing is done", is_done == is_enough);
        mbs_release_plan(plan), mbs_free_factors(factors);
    }
    LAW("all parts ask for some", k > 20);
    {
        static const int begin[3] = {0, 1, 2}, other[2] = {1, 0}, alone[2] = {-1, -1};
        int order[2];
        for (k = 0; k < 3; ++k) {
            memory_left = k;
            LAW("an order says so too", mbs_order(2, begin, other, "\0", alone, order) == -1);
        }
    }
    memory_left = -1;
}

/* The largest of a few numbers or of many, wherever it is. */
static void peaks(void)
{
    int n, i;
    for (n = 1; n < 20; ++n)
        for (i = 0; i < n; ++i) {
            double a[20] = {0};
            a[i] = i % 2 ? 3 : -3;
            LAW("each number counts", peak(a, n) == 3 && peak(a, i) == 0 && peak(a + i, 1) == 3);
        }
}

/* Factors of a band grow with its length, in fronts of few unknowns. */
static void bands(void)
{
    static int start[801], row[2400], partner[800];
    static double value[2400], x[800];
    static char weak[800];
    const mbs_pivoting pivoting = {1e-8, 1e-20};
    long entries[2];
    int turn, i, k;
    for (turn = 0; turn < 2; ++turn) {
        const int n = 400 * (turn + 1);
        mbs_plan *plan;
        mbs_factors *factors;
        mbs_met met;
        for (i = k = 0; i < n; ++i) {
            start[i] = k, partner[i] = -1, x[i] = i + 2 < n && i > 1 ? 8 : i == 0 || i == n - 1 ? 6 : 7;
            row[k] = i, value[k++] = 4;
            if (i + 1 < n)
                row[k] = i + 1, value[k++] = 1;
            if (i + 2 < n)
                row[k] = i + 2, value[k++] = 1;
        }
        start[n] = k;
        plan = mbs_make_plan(n, start, row, weak, partner);
        factors = mbs_make_factors(plan);
        LAW("the time to factorise is expected", plan->expected > 0 && plan->fronts > n / 60 && plan->fronts < n);
        met = mbs_factorise(factors, value, &pivoting);
        entries[turn] = met.entries;
        LAW("a definite band has pivots in turn", met.zeros == 0 && met.negative == 0 && met.delayed == 0 && met.front < 30);
        mbs_solve(factors, x);
        for (i = 0; i < n; ++i)
            LAW("and is solved", fabs(x[i] - 1) < 1e-13);
        mbs_release_plan(plan);
        mbs_free_factors(factors);
    }
    LAW("factors grow with the length", (double)entries[1] < 2.1 * (double)entries[0] && entries[0] < 400 * 60);
    mbs_free_factors(0), mbs_release_plan(0);
}

int main(void)
{
    systems(), singular(), fronts(), waiting(), pairs(), orders(), weak_ones(), partners(), weakness(), hanging_pairs(), rooms(), scarce(), peaks(), bands();
    return broken > 0;
}
