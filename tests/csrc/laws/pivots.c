#include "laws.h"

#include <math.h>

#include "../../../csrc/stages/pivots.c"

/* --- blocks of n equations that begin at the third column,
    above rows that are none of them -------------------------- */

enum { MOST = 7, FIRST = 2, ROOM = 64, LANE_COUNT = MBS_STAGES_TOGETHER };
static unsigned seed = 9;
static real dense[LANE_COUNT][MOST * MOST], value[LANE_COUNT][ROOM + 32], block[ROOM], sizes[MOST];
static char marks[ROOM];
static int spots[2 * MOST], begin[MOST + FIRST + 1], end[MOST + FIRST + 1], row_of[ROOM + 32], count;
static int row[MOST], column[MOST], entry[MOST + 1], entry_at[ROOM], entry_place[ROOM], lower[MOST + 1],
    lower_place[ROOM];
static int lower_row[ROOM], upper[MOST + 1], upper_place[ROOM], upper_column[ROOM];
static real lowers[LANE_COUNT * ROOM], inverses[LANE_COUNT * MOST], uppers[LANE_COUNT * ROOM], work[LANE_COUNT * MOST];
static const mbs_stages_factors factors = {lowers, inverses, uppers};
static mbs_stages_pivots p;
static mbs_stages_matrix A;

static real draw(void)
{
    seed = seed * 1103515245u + 12345u;
    return (real)(seed / 65536 % 2001) / 1000 - 1;
}

/* Lay out the nonzeros of a pattern, between columns of other variables and above two rows. */
static void open_block(int n, const char *there)
{
    int i, j, k;
    memset(&p, 0, sizeof p), memset(&A, 0, sizeof A);
    p.n = n, p.first = FIRST, p.capacity = n * n - n, p.row = row, p.column = column, p.entry = entry;
    p.entry_at = entry_at, p.entry_place = entry_place, p.lower = lower, p.lower_place = lower_place;
    p.lower_row = lower_row, p.upper = upper, p.upper_place = upper_place, p.upper_column = upper_column;
    for (j = 0, count = 0; j < FIRST + n; ++j) {
        begin[j] = count;
        for (i = 0; i < n + 2; ++i)
            if (i >= n || j < FIRST || there[i * n + j - FIRST]) {
                for (k = 0; k < LANE_COUNT; ++k)
                    value[k][count] = i >= n || j < FIRST ? 77 : dense[k][i * n + j - FIRST];
                row_of[count++] = i;
            }
        end[j] = count;
    }
    A.rows = n + 2, A.columns = FIRST + n, A.begin = begin, A.end = end, A.row = row_of, A.value = value[0];
    for (i = 0; i < ROOM; ++i) /* nothing is read before it is written */
        block[i] = (real)NAN, marks[i] = 9;
    for (i = 0; i < LANE_COUNT * ROOM; ++i)
        lowers[i] = uppers[i] = (real)NAN;
    for (i = 0; i < LANE_COUNT * MOST; ++i)
        work[i] = inverses[i] = (real)NAN;
    for (i = 0; i < MOST; ++i)
        sizes[i] = (real)NAN;
    memset(spots, 9, sizeof spots);
}

static int choose(real zero)
{
    return mbs_stages_choose_pivots(&p, &A, block, sizes, marks, spots, zero);
}

static void fill_all(char *there, char what)
{
    memset(there, what, MOST * MOST);
}

static mbs_stages_together gather(int stages)
{
    mbs_stages_together all;
    int k;
    memset(&all, 0, sizeof all);
    all.count = stages;
    for (k = 0; k < stages; ++k)
        all.value[k] = value[k];
    return all;
}

/* Right-hand sides side by side, of one stage. */
static void solve_rows(int n, int lane, int width)
{
    enum { WIDEST = 64 };
    static real R[MOST * WIDEST], was[MOST * WIDEST], X[MOST * WIDEST];
    int i, j, c;
    for (i = 0; i < MOST * WIDEST; ++i)
        R[i] = was[i] = draw(), X[i] = 99;
    mbs_stages_solve_rows(&p, &factors, lane, width, WIDEST, R, X);
    for (i = 0; i < n; ++i)
        for (c = 0; c < WIDEST; ++c) {
            real sum = -was[i * WIDEST + c];
            for (j = 0; j < n; ++j)
                sum += dense[lane][i * n + j] * X[j * WIDEST + c];
            LAW("rows are solved", c >= width || real_abs(sum) < 1e-7);
            LAW("no more lines of them than asked", c < mbs_stages_lines(width) || X[i * WIDEST + c] == 99);
        }
}

/* Blocks of four stages with one pattern: all are solved, and across. */
static void solve_all(int n, real part, int stages)
{
    char there[MOST * MOST];
    real b[LANE_COUNT][MOST], x[LANE_COUNT * MOST], across[LANE_COUNT * MOST];
    const real *given[LANE_COUNT];
    mbs_stages_together all;
    int i, j, k, nonzeros = 0;
    for (i = 0; i < n * n; ++i)
        there[i] = i % (n + 1) == 0 || draw() < 2 * part - 1, nonzeros += there[i];
    for (k = 0; k < LANE_COUNT; ++k)
        for (i = 0; i < n * n; ++i)
            dense[k][i] = there[i] ? (i % (n + 1) == 0 ? 3 : draw()) : 0;
    for (i = 0; i < n; ++i) /* rows in another order */
        for (j = 0; j < n && i + 1 < n && draw() > 0; ++j) {
            const char was = there[i * n + j];
            there[i * n + j] = there[(i + 1) * n + j], there[(i + 1) * n + j] = was;
            for (k = 0; k < LANE_COUNT; ++k) {
                const real own = dense[k][i * n + j];
                dense[k][i * n + j] = dense[k][(i + 1) * n + j], dense[k][(i + 1) * n + j] = own;
            }
        }
    open_block(n, there);
    if (choose((real)1e-9))
        return; /* rows were mixed up to none */
    LAW("a block has an order", p.ready == 1);
    for (i = 0, j = 0; i < n; ++i)
        j += 1 << row[i] | 1 << (column[i] + 16);
    LAW("of all rows and columns", j == (1 << n) - 1 + ((1 << n) - 1) * (1 << 16));
    LAW("and all of its nonzeros", entry[0] == 0 && entry[n] == nonzeros);
    all = gather(stages);
    mbs_stages_factorise_together(&p, &all, &factors, work, (real)1e-9);
    for (k = 0; k < stages; ++k) {
        given[k] = b[k];
        for (i = 0; i < n; ++i)
            b[k][i] = draw(), across[LANE_COUNT * i + k] = b[k][i];
    }
    for (k = stages; k < LANE_COUNT; ++k)
        for (i = 0; i < n; ++i)
            across[LANE_COUNT * i + k] = 0;
    mbs_stages_solve_together(&p, &factors, given, stages, x, work);
    for (k = 0; k < stages; ++k)
        for (i = 0; i < n && all.failed[k] < 0; ++i) {
            real sum = -b[k][i];
            for (j = 0; j < n; ++j)
                sum += dense[k][i * n + j] * x[LANE_COUNT * j + k];
            LAW("equations are solved", real_abs(sum) < 1e-7);
        }
    mbs_stages_solve_together_transposed(&p, &factors, across, x, work);
    for (k = 0; k < stages; ++k)
        for (j = 0; j < n && all.failed[k] < 0; ++j) {
            real sum = -b[k][j];
            for (i = 0; i < n; ++i)
                sum += dense[k][i * n + j] * x[LANE_COUNT * i + k];
            LAW("and across", real_abs(sum) < 1e-7);
        }
    LAW("a sound block does not fail", all.failed[0] < 0);
    for (k = 0; k < stages; ++k)
        if (all.failed[k] < 0)
            solve_rows(n, k, 4 * (1 + k + 5 * (n % 3)));
}

/* An arrow: its head is eliminated last, and nothing is filled; a line likewise. */
static void sparse_ones(void)
{
    char there[MOST * MOST];
    int i, n = MOST;
    fill_all(there, 0);
    for (i = 0; i < n; ++i)
        there[i] = there[i * n] = there[i * (n + 1)] = 1;
    for (i = 0; i < n * n; ++i)
        dense[0][i] = there[i] ? (i % (n + 1) ? 1 : 4) : 0;
    open_block(n, there);
    LAW("an arrow has factors without more nonzeros", choose((real)1e-9) == 0 && lower[n] + upper[n] == 2 * (n - 1));
    LAW("its head comes last, or the one before", row[n - 1] == 0 || row[n - 2] == 0);
    open_block(n, there), p.capacity = 2 * (n - 1);
    LAW("there may be as many as there is room for", choose((real)1e-9) == 0);
    open_block(n, there), p.capacity = 2 * (n - 1) - 1;
    LAW("but no more", choose((real)1e-9) == -1);
    for (i = 0; i < n; ++i)
        there[i] = there[i * n] = i == 0;
    for (i = 0; i + 1 < n; ++i)
        there[i * n + i + 1] = there[(i + 1) * n + i] = 1;
    for (i = 0; i < n * n; ++i)
        dense[0][i] = there[i] ? (i % (n + 1) ? 1 : 4) : 0;
    open_block(n, there);
    LAW("a line too", choose((real)1e-9) == 0 && lower[n] + upper[n] == 2 * (n - 1));
    fill_all(there, 1), n = 3;
    for (i = 0; i < 9; ++i)
        dense[0][i] = draw() + (i % 4 ? 0 : 3);
    open_block(n, there);
    LAW("a full one is full", choose((real)1e-9) == 0 && lower[n] == 3 && upper[n] == 3);
}

/* A block (1 1; 1 1+e) of one stage, and others by its order. */
static void failures(void)
{
    char there[MOST * MOST];
    mbs_stages_together all;
    int k, i;
    fill_all(there, 1);
    for (k = 0; k < 2; ++k) {
        for (i = 0; i < LANE_COUNT; ++i)
            dense[i][0] = 4, dense[i][1] = dense[i][2] = 1, dense[i][3] = 3;
        dense[1][0] = dense[1][1] = dense[1][2] = 1, dense[1][3] = 1 + (real)(k ? 1.5e-6 : 1.3e-6); /* the root of 2 */
        open_block(2, there);
        LAW("a block has an order", choose((real)1e-9) == 0 && row[0] == 0 && column[0] == 0);
        all = gather(3);
        mbs_stages_factorise_together(&p, &all, &factors, work, (real)1e-6);
        LAW("a pivot is lost that is small beside its row", all.failed[1] == (k ? -1 : 1));
        LAW("of its stage alone", all.failed[0] == -1 && all.failed[2] == -1 && all.failed[3] == -1);
        LAW("where nothing is divided", (inverses[LANE_COUNT + 1] == 0) == !k && near(inverses[0], (real)0.25));
        dense[1][0] = (real)(k ? 1.1e-9 : 0.9e-9), dense[1][1] = dense[1][2] = 1, dense[1][3] = 0;
        open_block(2, there), choose((real)1e-9);
        all = gather(4);
        mbs_stages_factorise_together(&p, &all, &factors, work, (real)1e-30);
        LAW("or whose row is too large beside it", all.failed[1] == (k ? -1 : 0));
        dense[0][0] = dense[0][1] = dense[0][2] = 1, dense[0][3] = 1 + (real)(k ? 1.2e-6 : 0.8e-6);
        open_block(2, there);
        LAW("a block without a pivot has no order", choose((real)1e-6) == (k ? 0 : -1));
        dense[0][k] = dense[0][3 - k] = 0, dense[0][2 * k] = dense[0][2 + k] = 0;
        open_block(2, there);
        LAW("nor one with a row of zeros", choose((real)1e-9) == -1);
    }
}

static void balances(void)
{
    real column_of[6] = {(real)-0.5, 7, (real)0.02, 7, 0, 7};
    LAW("numbers are balanced, a stride apart", balance(column_of, 3, 2) == 0 && near(-column_of[0] * column_of[2], 1));
    LAW("by one factor", near(column_of[0] / column_of[2], -25) && column_of[4] == 0);
    LAW("the others stay", column_of[1] == 7 && column_of[3] == 7 && column_of[5] == 7);
    column_of[0] = 300, column_of[1] = (real)1e-4, column_of[2] = 100;
    LAW("rounding beside the largest does not count",
        balance(column_of, 3, 1) == 0 && near(column_of[0] * column_of[2], 1));
    column_of[0] = column_of[1] = 0;
    LAW("zeros cannot be balanced", balance(column_of, 2, 1) == -1);
}

/* Units of rows and columns do not decide. */
static void units(void)
{
    char there[MOST * MOST];
    int i, turn, n = 5;
    fill_all(there, 1);
    for (turn = 0; turn < 20; ++turn) {
        for (i = 0; i < n * n; ++i)
            dense[0][i] = draw(), there[i] = dense[0][i] < 0.4 || i % (n + 1) == 0, dense[0][i] *= there[i];
        open_block(n, there);
        if (choose((real)1e-9))
            continue;
        for (i = 0; i < n * n; ++i)
            dense[0][i] *= (real)(1 << 3 * (i / n)) / (real)(1 << 2 * (i % n));
        open_block(n, there);
        LAW("there is an order in other units", choose((real)1e-9) == 0);
    }
}

int main(void)
{
    int n, turn;
    balances();
    for (turn = 0; turn < 12; ++turn)
        for (n = 1; n <= MOST && !broken; ++n)
            solve_all(n, turn % 3 == 0 ? 1 : turn % 3 == 1 ? (real)0.6 : (real)0.3, 1 + turn % 4);
    sparse_ones(), failures(), units();
    return broken > 0;
}
