/* Linear equations and Newton's steps in kernels, for one state or (algebra_lanes.c) four: factors multiplied out, by
 * matrices that need exchanges, and the pivots that are refused. Each state has its own matrix. */
#include <math.h>

#include "../../../csrc/mbs_columns.h"
#include "../../../csrc/mbs_general.h"
#include "../../../csrc/mbs_newton.h"
#include "../../../csrc/mbs_symmetric.h"
#include "../../../csrc/mbs_tree.h"

#include <stdio.h>
#include <string.h>

static int broken;

#define LAW(text, condition) ((condition) ? (void)0 : (void)(++broken, printf("%s: %s\n", text, #condition)))

enum { MOST = 6, WIDTH = 3, STATES = MBS_ABREAST };

static unsigned seed = 1;

/* Between -1 and 1. */
static double draw(void)
{
    seed = 1664525u * seed + 1013904223u;
    return (double)(seed >> 8) / 8388608.0 - 1;
}

static double *at(mbs_real *a, int k, int state)
{
    return (double *)(a + k) + state;
}

static double get(const mbs_real *a, int k, int state)
{
    return ((const double *)(a + k))[state];
}

static mbs_real every(double x)
{
    return MBS_EVERY(x);
}

/* Draw a matrix for each state, where what would be the first pivot of many is tiny. */
static void draw_matrix(int n, int is_symmetric, mbs_real *A)
{
    int i, j, s;
    for (s = 0; s < STATES; ++s)
        for (i = 0; i < n; ++i)
            for (j = 0; j < n; ++j) {
                const double x = i == j && n > 1 && draw() < 0.3 ? (is_symmetric ? 0 : 1e-18) : draw();
                *at(A, i * n + j, s) = is_symmetric && j < i ? get(A, j * n + i, s) : x;
            }
}

/* Whether A X = B, or AT X = B, to rounding. */
static int solves(int n, const mbs_real *A, const mbs_real *X, const mbs_real *B, int width, int is_transposed)
{
    int i, j, c, s, is_so = 1;
    for (s = 0; s < STATES; ++s)
        for (i = 0; i < n; ++i)
            for (c = 0; c < width; ++c) {
                double sum = -get(B, i * width + c, s), size = fabs(sum);
                for (j = 0; j < n; ++j) {
                    const double term = get(A, is_transposed ? j * n + i : i * n + j, s) * get(X, j * width + c, s);
                    sum += term, size += fabs(term);
                }
                is_so &= fabs(sum) <= 3e-13 * size;
            }
    return is_so;
}

static void solve_general(void)
{
    int n, k, i, j, s;
    for (n = 1; n <= MOST; ++n)
        for (k = 0; k < 30; ++k) {
            mbs_real A[MOST * MOST], F[MOST * MOST], scales[MOST], B[MOST * WIDTH], X[MOST * WIDTH];
            int exchanges[MOST * STATES];
            draw_matrix(n, 0, A);
            for (i = 0; i < n * WIDTH; ++i)
                for (s = 0; s < STATES; ++s)
                    *at(B, i, s) = draw();
            memcpy(F, A, sizeof F), memcpy(X, B, sizeof X);
            LAW("a matrix has factors", mbs_factorise_general(n, every(1e-13), F, scales, exchanges) == 0);
            for (s = 0; s < STATES; ++s)
                for (i = 0; i < n; ++i)
                    for (j = 0; j < i; ++j)
                        LAW("which grow little", fabs(get(F, i * n + j, s)) <= 1);
            mbs_solve_general(n, F, exchanges, WIDTH, X);
            LAW("they solve", solves(n, A, X, B, WIDTH, 0));
            memcpy(X, B, sizeof X);
            mbs_solve_transposed(n, F, exchanges, WIDTH, X);
            LAW("transposed too", solves(n, A, X, B, WIDTH, 1));
        }
}

static int factorise(double threshold, double a, double b, double c, double d)
{
    mbs_real A[4], scales[2];
    int exchanges[2 * STATES], k;
    const double given[] = {a, b, c, d};
    for (k = 0; k < 4; ++k)
        A[k] = every(k == 3 ? 1000.0 : k == 0); /* other states have good pivots */
    for (k = 0; k < 4; ++k)
        *at(A, k, STATES - 1) = given[k];
    return mbs_factorise_general(2, every(threshold), A, scales, exchanges);
}

static void refuse_pivots(void)
{
    LAW("dependent columns have no pivot", factorise(1e-14, 1, 2, 2, 4) == 2);
    LAW("nor a column of zeros", factorise(1e-14, 0, 2, 0, 4) == 1);
    LAW("nor no numbers", factorise(1e-14, NAN, 2, 0, 4) == 1);
    LAW("a pivot is measured by its column", factorise(0.005, 4, 100, 1, 26) == 0);
    LAW("and may be too small", factorise(0.02, 4, 100, 1, 26) == 2);
    LAW("the first column by its own", factorise(0.02, 1, 100, 1, 1000) == 0);
    LAW("at the threshold too", factorise(0.5, 2, 2, 1, 2) == 2 && factorise(0.49, 2, 2, 1, 2) == 0);
}

static void solve_symmetric(void)
{
    int n, k, i, s, pairs = 0;
    for (n = 1; n <= MOST; ++n)
        for (k = 0; k < 60; ++k) {
            mbs_real A[MOST * MOST], F[MOST * MOST], scales[MOST], B[MOST * WIDTH], X[MOST * WIDTH];
            int exchanges[MOST * STATES];
            draw_matrix(n, 1, A);
            for (i = 0; i < n * WIDTH; ++i)
                for (s = 0; s < STATES; ++s)
                    *at(B, i, s) = draw();
            memcpy(F, A, sizeof F), memcpy(X, B, sizeof X);
            LAW("a symmetric matrix has factors", mbs_factorise_symmetric(n, every(1e-13), F, scales, exchanges) == 0);
            mbs_solve_symmetric(n, F, exchanges, WIDTH, X);
            LAW("which solve", solves(n, A, X, B, WIDTH, 0));
            for (i = 0; i < n * STATES; ++i)
                pairs += exchanges[i] < 0;
        }
    LAW("pivots of two rows are among them", pairs > 100);
}

static int choose(int n, const double *A, int k, int *p)
{
    return mbs_choose_block(n, A, k, p);
}

static void choose_pivots(void)
{
    static const double wide[] = {0, 1, 2, 2, 1, 0, 0, 0, 2, 0, 0, 0, 2, 0, 0, 0};
    double two[] = {41, 64, 64, 0}, three[] = {1, 10, 3, 10, 6, 5, 3, 5, 0}, swapped[] = {0, 0, 1, 0, 1e-3, 0, 1, 0, 0};
    double scales[3], pair[] = {0, 3, 3, 0}, unknown[] = {1, 0, 0, NAN}, b[] = {5, 7, 2};
    int p = -1, exchanges[3];
    LAW("the largest entry below is the partner", mbs_find_partner(3, three, 0) == 1 && mbs_find_partner(3, swapped, 0) == 2);
    LAW("the first of equal ones", mbs_find_partner(4, wide, 0) == 2);
    LAW("a large diagonal is a pivot", choose(2, two, 0, &p) == 1 && p == 0);
    two[0] = 40;
    LAW("a small one is a part of two", choose(2, two, 0, &p) == 2 && p == 1);
    LAW("the last one stands alone", choose(2, two, 1, &p) == 1 && p == 1);
    LAW("a pair", choose(3, three, 0, &p) == 2 && p == 1);
    three[4] = 7;
    LAW("or the partner alone", choose(3, three, 0, &p) == 1 && p == 1);
    three[4] = 0, three[5] = three[7] = 100;
    LAW("or the first, where the partner's row is large", choose(3, three, 0, &p) == 1 && p == 0);
    three[5] = three[7] = 64;
    LAW("as far as it grows", choose(3, three, 0, &p) == 2 && p == 1);
    LAW("an exchange of a pair", mbs_factorise_symmetric_alone(2, 1e-14, pair, scales, exchanges) == 0 && exchanges[0] == -2
        && exchanges[1] == -2);
    LAW("scales go with their rows", mbs_factorise_symmetric_alone(3, 0.5, swapped, scales, exchanges) == 0);
    mbs_solve_symmetric_alone(3, swapped, exchanges, 1, b);
    LAW("so do right sides", b[0] == 2 && fabs(b[1] - 7000) < 1e-9 && b[2] == 5);
    memset(pair, 0, sizeof pair);
    LAW("zeros have no pivot", mbs_factorise_symmetric_alone(2, 0, pair, scales, exchanges) == 1);
    LAW("nor has what is unknown", mbs_factorise_symmetric_alone(2, 0, unknown, scales, exchanges) == 2);
    two[0] = 1, two[1] = two[2] = 1, two[3] = 1.25;
    LAW("a pivot exceeds a part of its row", mbs_factorise_symmetric_alone(2, 0.2, two, scales, exchanges) == 2);
    two[0] = 1, two[1] = two[2] = 1, two[3] = 1.25;
    LAW("and is taken then", mbs_factorise_symmetric_alone(2, 0.19, two, scales, exchanges) == 0);
}

/* A tree of five: 1 on 0, 2 and 3 on 1, 4 on 3; the entries of L of each row, and of each column from the last row on. */
static const int starts[] = {0, 0, 1, 3, 5, 8}, ancestors[] = {0, 0, 1, 0, 1, 0, 1, 3};
#ifndef MBS_STATES
static const int below_starts[] = {0, 4, 7, 7, 8, 8};
static const int below[] = {4, 5, 3, 3, 2, 1, 1, 0, 4, 6, 3, 4, 2, 2, 4, 7};
#endif

static void make_tree(mbs_real *L, mbs_real *D, mbs_real *A)
{
    int i, j, k, d, s;
    for (s = 0; s < STATES; ++s) {
        double full[25] = {0};
        for (k = 0; k < 5; ++k) {
            full[k * 5 + k] = 1, *at(D, k, s) = 1.5 + draw();
            for (d = starts[k]; d < starts[k + 1]; ++d)
                full[k * 5 + ancestors[d]] = *at(L, d, s) = draw();
        }
        for (i = 0; i < 5; ++i)
            for (j = 0; j < 5; ++j) {
                *at(A, i * 5 + j, s) = 0;
                for (k = 0; k < 5; ++k)
                    *at(A, i * 5 + j, s) += full[k * 5 + i] * get(D, k, s) * full[k * 5 + j];
            }
    }
}

static int alike(double a, double b)
{
    return fabs(a - b) <= 1e-12;
}

static void solve_trees(void)
{
    mbs_real L[8], D[5], A[25], F[25], scales[5], lower[8], inverses[5];
    static mbs_real B[5 * 48], X[5 * 48];
#ifndef MBS_STATES
    static mbs_real Y[5 * 48];
#endif
    int k, s, width;
    make_tree(L, D, A);
    memcpy(F, A, sizeof F);
    LAW("a tree's matrix has factors", mbs_factorise_tree(5, starts, ancestors, every(1e-13), F, scales, lower, inverses) == 0);
    for (s = 0; s < STATES; ++s) {
        for (k = 0; k < 8; ++k)
            LAW("its own", alike(get(lower, k, s), get(L, k, s)));
        for (k = 0; k < 5; ++k)
            LAW("with the inverses of D", alike(get(inverses, k, s) * get(D, k, s), 1));
    }
    for (width = 1; width <= 48; width += width == 1 ? 15 : 16) {
        for (k = 0; k < 5 * width; ++k)
            for (s = 0; s < STATES; ++s)
                *at(B, k, s) = draw();
        memcpy(X, B, sizeof X);
        mbs_solve_tree(5, starts, ancestors, lower, inverses, width, X);
        LAW("which solve", solves(5, A, X, B, width, 0));
#ifndef MBS_STATES
        if (width % MBS_LANES)
            continue;
        memcpy(Y, B, sizeof Y);
        mbs_solve_columns(5, starts, ancestors, below_starts, below, lower, inverses, width, Y);
        LAW("many columns too", solves(5, A, Y, B, width, 0));
#endif
    }
    for (k = 4; k >= 0; --k) {
        make_tree(L, D, A);
        *at(D, k, STATES - 1) = 1e-3;
        for (s = 0; s < 25; ++s)
            F[s] = every(s % 6 == 0); /* the unit matrix */
        *at(F, k * 6, STATES - 1) = 0;
        LAW("a pivot of zero is named", mbs_factorise_tree(5, starts, ancestors, every(0), F, scales, lower, inverses) == k + 1);
    }
    for (s = 0; s < 25; ++s)
        F[s] = every(s % 6 == 0);
    *at(F, 0, STATES - 1) = 1.25, *at(F, 1, STATES - 1) = *at(F, 5, STATES - 1) = 1; /* the second step leaves 1/4 of it */
    memcpy(A, F, sizeof A);
    LAW("a pivot exceeds a part of its entry", mbs_factorise_tree(5, starts, ancestors, every(0.2), F, scales, lower, inverses) == 1);
    LAW("and is taken then", mbs_factorise_tree(5, starts, ancestors, every(0.19), A, scales, lower, inverses) == 0);
}

#ifdef MBS_STATES
/* Where the first substitution reaches all rows, or 3, 1 and 0; then the second one. */
static const int steps[] = {
    2, 0, 4, 3, 4, 3, 7, 1, 0, 2, 2, 2, 3, 1, 0, 1, 0, 4, 6, 5, 3, 4, 3, 2, 2, 1, 0, 0, 0,
    3, 0, 3, 1, 0, 3, 1, 0, 4, 3, 0, 0, 2, 2, 4,
    3, 0, 0, 1, 2, 0, 1, 2, 0, 1, 2, 2, 2, 3, 4, 3, 4, 0, 3, 5, 1, 4, 6, 7, 0,
};
static const int groups[] = {
    0, 44, 1, 0, 1, 5, 1, 10, 1, 15, 1, 20, 1, 25,
    29, 44, 2, 10, 2, 0, 2, 5, 0, 0, 0, 0, 0, 0,
};

static void solve_groups(void)
{
    enum { COLUMNS = 9, FULL = 6 };
    static const int reached[] = {3, 1, 0}, order[] = {6, 7, 8}; /* the columns of the first numbers of the second result */
    mbs_real L[8], D[5], A[25], inverses[5], right[5 * FULL + 3 * FULL], B[5 * COLUMNS], X[5 * COLUMNS], first[30], second[15];
    mbs_real *const results[] = {first, second};
    int c, k, s;
    make_tree(L, D, A);
    for (k = 0; k < 5; ++k)
        inverses[k] = every(1) / D[k];
    for (k = 0; k < 5 * COLUMNS; ++k)
        B[k] = every(0);
    for (k = 0; k < 8 * FULL; ++k)
        for (s = 0; s < STATES; ++s)
            *at(right, k, s) = draw();
    for (c = 0; c < FULL; ++c)
        for (k = 0; k < 5; ++k)
            B[(4 - k) * COLUMNS + c] = right[k * FULL + c];
    for (c = 0; c < 3; ++c)
        for (k = 0; k < 3; ++k)
            B[reached[k] * COLUMNS + FULL + c] = right[(5 + k) * FULL + c];
    mbs_solve_groups(5, 2, steps, groups, L, inverses, right, results);
    for (k = 0; k < 5; ++k) {
        for (c = 0; c < FULL; ++c)
            X[k * COLUMNS + c] = -first[c * 5 + k];
        for (c = 0; c < 3; ++c)
            X[k * COLUMNS + order[c]] = -second[(c + 2) % 3 * 5 + k];
    }
    LAW("columns in groups are solved for", solves(5, A, X, B, COLUMNS, 0));
}
#endif

static void give_columns(void)
{
    static const int places[] = {5, 0, 7};
    mbs_real B[12], block[6], some[3];
    int k;
    for (k = 0; k < 12; ++k)
        B[k] = every(k + 1);
    mbs_give_block(3, 2, 4, B, block);
    LAW("blocks are given by columns, negated", get(block, 0, 0) == -1 && get(block, 1, 0) == -5 && get(block, 2, 0) == -9
        && get(block, 3, 0) == -2 && get(block, 5, STATES - 1) == -10);
    mbs_give_places(3, places, B, some);
    LAW("so are places", get(some, 0, 0) == -6 && get(some, 1, 0) == -1 && get(some, 2, STATES - 1) == -8);
}

static void pass_on(void)
{
    static const int places[] = {1, 5, 8};
    mbs_real x[] = {every(2), every(3), every(4)}, full[10], y[3];
    int k;
    full[9] = every(-7);
    mbs_spread(3, places, x, 9, full);
    for (k = 0; k < 9; ++k)
        LAW("nonzeros have their places", get(full, k, 0) == (k == 1 ? 2 : k == 5 ? 3 : k == 8 ? 4 : 0));
    mbs_spread_symmetric(3, places, x, 3, full);
    for (k = 0; k < 9; ++k)
        LAW("on both sides of a diagonal", get(full, k, 0) == (k == 1 || k == 3 ? 2 : k == 5 || k == 7 ? 3 : k == 8 ? 4 : 0));
    LAW("nothing else is written", get(full, 9, 0) == -7);
    mbs_take(3, places, full, 1, y);
    LAW("they are taken", get(y, 0, 0) == 2 && get(y, 1, 0) == 3 && get(y, 2, 0) == 4);
    mbs_take(3, places, full, -1, y);
    LAW("or negated", get(y, 0, 0) == -2 && get(y, 1, 0) == -3 && get(y, 2, 0) == -4);
    mbs_copy(2, x, y);
    LAW("or copied", get(y, 0, 0) == 2 && get(y, 1, 0) == 3 && get(y, 2, 0) == -4);
}

/* Take a step in which all states agree; return whether the solution is found. */
static int step(int number, double a, double b, mbs_real *unknown, mbs_progress *progress)
{
    const mbs_real both[] = {every(a), every(b)};
    return mbs_take_step(number, 2, both, unknown, progress);
}

static void take_steps(void)
{
    mbs_real x[] = {every(0.5), every(1e6)};
    mbs_progress p;
    memset(&p, 0x11, sizeof p);
    LAW("a short step finds the solution", step(0, 1e-9, 1e-3, x, &p) == 1);
    LAW("and is taken", get(x, 0, 0) == 0.5 + 1e-9 && get(x, 1, STATES - 1) == 1e6 + 1e-3);
    LAW("at its limit too", step(0, 1.0 / (1 << 26), -1.0 / (1 << 26), x, &p) == 1);
    LAW("a long one does not", step(0, 1e-7, 0, x, &p) == 0 && step(0, 0, 1, x, &p) == 0 && step(0, -1e-7, 0, x, &p) == 0);
    step(0, 2e-8, 0, x, &p);
    LAW("a step is a tenth of the last", step(1, 0, 1e-2, x, &p) == 0 && step(2, 0, 9e-4, x, &p) == 1);
    step(0, 1, 0, x, &p);
    LAW("and short", step(1, 1e-3, 0, x, &p) == 0 && step(2, 1e-9, 1e-2 / 2, x, &p) == 1);
    step(0, 1, 1, x, &p);
    LAW("what is unknown is no solution", step(1, NAN, 0, x, &p) == 0 && step(2, 0, 0, x, &p) == 0);
    x[0] = every(0), x[1] = every(0);
    step(0, 0.5, 0.25, x, &p);
    LAW("the largest part counts", get(&p.size, 0, 0) == 0.5);
    step(1, 3.5, 0.25, x, &p);
    LAW("of large numbers", get(&p.size, 0, 0) == 0.875 && get(x, 0, 0) == 4 && get(x, 1, 0) == 0.5);
#ifdef MBS_STATES
    {
        mbs_real y[] = {every(1)}, d[] = {every(0)};
        *at(d, 0, 1) = 0.5;
        LAW("all states find it", mbs_take_step(0, 1, d, y, &p) == 0);
        d[0] = every(1e-10);
        LAW("at last", mbs_take_step(1, 1, d, y, &p) == 1);
        LAW("and stay where they found it", get(y, 0, 0) == 1 && get(y, 0, 1) == 1.5 + 1e-10);
    }
#endif
}

int main(void)
{
    solve_general();
    refuse_pivots();
    solve_symmetric();
    choose_pivots();
    solve_trees();
#ifdef MBS_STATES
    solve_groups();
#endif
    give_columns();
    pass_on();
    take_steps();
    return broken > 0;
}
