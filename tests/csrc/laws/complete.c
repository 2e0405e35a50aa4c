#include "laws.h"

#include <math.h>

#include "../../../csrc/stages/complete.c"

/* Blocks of n equations in the n columns after the second, above a row that is none of them. */
enum { MOST = 6, FIRST = 2, WIDTH = 3 };
static unsigned seed = 5;
static real dense[MOST * MOST], numbers[MOST * (MOST + 1) + 32], a[MOST * MOST], work[MOST];
static int begin[MOST + FIRST], end[MOST + FIRST], row_of[MOST * (MOST + 1) + 32], row[MOST], column[MOST],
    largest[MOST], nonzero[MOST];
static mbs_stages_complete c;

static real draw(void)
{
    seed = seed * 1103515245u + 12345u;
    return (real)(seed / 65536 % 2001) / 1000 - 1;
}

static void factorise(int n, real zero, real small, int room)
{
    const mbs_stages_least_pivots least = {zero, small, room};
    mbs_stages_matrix A = {n + 1, FIRST + n, begin, end, row_of, 0, numbers};
    int i, j, at = 0;
    for (j = 0; j < FIRST + n; ++j) {
        begin[j] = at;
        for (i = 0; i <= n; ++i)
            if (i == n || j < FIRST || dense[i * MOST + j - FIRST] != 0)
                row_of[at] = i, numbers[at++] = i == n || j < FIRST ? 77 : dense[i * MOST + j - FIRST];
        end[j] = at;
    }
    A.count = at;
    c.n = n, c.rank = 99, c.a = a, c.row = row, c.column = column, c.work = work;
    c.largest = largest, c.nonzero = nonzero;
    for (i = 0; i < MOST * MOST; ++i)
        a[i] = (real)NAN;
    for (i = 0; i < MOST; ++i)
        work[i] = (real)NAN, row[i] = column[i] = largest[i] = nonzero[i] = -1;
    mbs_stages_factorise_completely(&c, &A, FIRST, &least);
}

/* Draw a block of a rank: the last rows are sums of two others; zeros are at places of chance. */
static void draw_block(int n, int rank)
{
    int i, j;
    memset(dense, 0, sizeof dense);
    for (i = 0; i < n; ++i)
        for (j = 0; j < n; ++j)
            dense[i * MOST + j] = i >= rank ? dense[j] * (rank > 0) - 2 * dense[(rank > 1 ? 1 : 0) * MOST + j] * (rank > 1)
                                            : i == j ? 3 : draw() > 0 ? draw() : 0;
}

/* Right-hand sides that hold: all equations do, by unknowns of which those without a pivot are 0. */
static void solve_all(int n, int rank)
{
    real wanted[MOST * WIDTH], B[MOST * WIDTH], X[MOST * WIDTH], b[MOST], x[MOST], y[MOST], across[MOST];
    int i, j, k, pivots = 0;
    draw_block(n, rank);
    factorise(n, 1e-9, 1e-9, 0);
    LAW("a block has its rank", c.rank == rank);
    for (i = 0; i < n * WIDTH; ++i)
        wanted[i] = draw();
    for (i = 0; i < n; ++i)
        for (k = 0; k < WIDTH; ++k)
            for (j = 0, B[i * WIDTH + k] = 0; j < n; ++j)
                B[i * WIDTH + k] += dense[i * MOST + j] * wanted[j * WIDTH + k];
    for (i = 0; i < n; ++i)
        b[i] = B[i * WIDTH];
    LAW("equations that hold leave nothing", mbs_stages_solve_completely(&c, b, x) < 1e-12);
    mbs_stages_solve_rows_completely(&c, WIDTH, WIDTH, B, X);
    for (i = 0; i < n; ++i) {
        real sum = 0;
        for (j = 0; j < n; ++j)
            sum += dense[i * MOST + j] * x[j];
        LAW("and are solved", real_abs(sum - b[i]) < 1e-11);
        for (k = 0; k < WIDTH; ++k) {
            for (j = 0, sum = 0; j < n; ++j)
                sum += dense[i * MOST + j] * (X[j * WIDTH + k] - wanted[j * WIDTH + k]);
            LAW("in all columns", real_abs(sum) < 1e-11);
        }
        for (k = 0; k < WIDTH; ++k)
            LAW("unknowns without a pivot are 0", x[i] != 0 || X[i * WIDTH + k] == 0);
        LAW("alike", real_abs(x[i] - X[i * WIDTH]) < 1e-11);
        pivots += x[i] != 0;
    }
    LAW("by as many unknowns as there are pivots", pivots <= rank);
    for (i = 0; i < n; ++i)
        y[i] = draw();
    for (j = 0; j < n; ++j)
        for (i = 0, across[j] = 0; i < n; ++i)
            across[j] += dense[i * MOST + j] * y[i];
    mbs_stages_solve_completely_transposed(&c, across, y);
    for (j = 0, pivots = 0; j < n; ++j) {
        real sum = 0;
        for (i = 0; i < n; ++i)
            sum += dense[i * MOST + j] * y[i];
        LAW("across too", real_abs(sum - across[j]) < 1e-11);
        pivots += y[j] != 0;
    }
    LAW("by as many rows", pivots <= rank);
    if (rank == n || rank < 2)
        return;
    for (i = 0; i < n; ++i)
        b[i] = i == n - 1 ? 1 : 0;
    LAW("equations that contradict others leave their residual", mbs_stages_solve_completely(&c, b, x) > 0.1);
}

/* Rows (4 0 0), (0 1 0), (0 1 e): the last pivot is e beside its row. */
static void limits(void)
{
    int k;
    for (k = 0; k < 2; ++k) {
        memset(dense, 0, sizeof dense);
        dense[0] = 4, dense[MOST + 1] = dense[2 * MOST + 1] = 1, dense[2 * MOST + 2] = k ? 1.1e-6 : 0.9e-6;
        factorise(3, 1e-6, 1e-6, 0);
        LAW("a pivot is above a part of its row", c.rank == 2 + k);
        factorise(3, 1e-9, 1e-6, 1);
        LAW("small ones are left while there is room", c.rank == 2 + k);
        factorise(3, 1e-9, 1e-3, 1);
        LAW("whatever they are", c.rank == 2);
        factorise(3, 1e-9, 1e-3, 0);
        LAW("and else used", c.rank == 3);
        factorise(3, 1e-9, 2, 2);
        LAW("as many as there is no room for", c.rank == 1);
        LAW("the best ones first, beside their rows", row[0] == 0 && column[0] == 0);
        dense[0] = 0;
        factorise(3, 1e-9, 1e-9, 0);
        LAW("a row of zeros has none", c.rank == 2);
    }
    dense[0] = 0.5, dense[1] = 1, dense[MOST] = 300, dense[MOST + 1] = 1, dense[2] = dense[MOST + 2] = 0;
    factorise(2, 1e-9, 1e-9, 0);
    LAW("sizes of rows do not count", row[0] == 0 && column[0] == 1 && c.rank == 2);
}

int main(void)
{
    int n, rank, turn;
    for (turn = 0; turn < 6; ++turn)
        for (n = 1; n <= MOST; ++n)
            for (rank = 0; rank <= n && !broken; ++rank)
                solve_all(n, rank);
    limits();
    return broken > 0;
}
