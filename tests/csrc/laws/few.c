#include "laws.h"

#include "../../../csrc/stages/few.c"

/* Whole numbers, as products of whole matrices give them by the plain sums here. */
enum { ROWS = 9, WIDTH = 68, SHIFT = 4, N = 8 };
static unsigned seed = 7;

static real draw(void)
{
    seed = seed * 1103515245u + 12345u;
    return (real)((int)(seed / 65536 % 13) + 1);
}

/* Rows 2, 3 and 6 have five numbers and more, row 4 none; no row has one in the first columns. */
static void fill(real A[ROWS][WIDTH])
{
    int i, j;
    for (i = 0; i < ROWS; ++i)
        for (j = 0; j < WIDTH; ++j)
            A[i][j] = 0;
    for (i = 0; i < ROWS; ++i)
        for (j = 0; j < (i == 4 ? 0 : i == 3 ? WIDTH - SHIFT : i == 2 || i == 6 ? 5 : 1 + i % 4); ++j)
            A[i][SHIFT + (7 * i + (i == 3 ? 1 : 13) * j) % (WIDTH - SHIFT)] = draw();
}

static void draw_all(int count, real *a)
{
    int i;
    for (i = 0; i < count; ++i)
        a[i] = draw();
}

static int is_few(int i)
{
    return i != 2 && i != 3 && i != 6;
}

static void lists(const mbs_stages_few *f, real A[ROWS][WIDTH])
{
    int i, j, t;
    for (i = 0; i < ROWS; ++i) {
        LAW("rows with few numbers have lists", (f->count[i] >= 0) == is_few(i));
        for (j = 0, t = 0; is_few(i) && j < WIDTH; ++j)
            if (A[i][j] != 0)
                LAW("of all of them", f->column[i * MBS_STAGES_FEW + t++] == j);
        LAW("and of no other", !is_few(i) || t == f->count[i]);
    }
    LAW("rows that are alike are counted", mbs_stages_count_alike(f, 0, ROWS) == 2);
    LAW("from each on", mbs_stages_count_alike(f, 2, ROWS) == 2 && mbs_stages_count_alike(f, 3, ROWS) == 1);
    LAW("to the last", mbs_stages_count_alike(f, 7, ROWS) == 2 && mbs_stages_count_alike(f, 4, 5) == 1);
}

static void rows(const mbs_stages_few *f, real A[ROWS][WIDTH])
{
    real x[WIDTH], y[WIDTH], was[WIDTH], by[ROWS];
    int i, j;
    draw_all(WIDTH, x), draw_all(WIDTH, was), draw_all(ROWS, by);
    for (i = 0; i < ROWS; ++i) {
        real sum = 0;
        memcpy(y, was, sizeof y);
        mbs_stages_add_row_few(f, i, WIDTH, 2, A[i], y);
        for (j = 0; j < WIDTH; ++j) {
            sum += A[i][j] * x[j];
            LAW("a row is added", y[j] == was[j] + 2 * A[i][j]);
        }
        LAW("a product of rows has all numbers", mbs_stages_dot_few(f, i, WIDTH, A[i], x) == sum);
    }
    memcpy(y, was, sizeof y);
    mbs_stages_add_rows_few(f, ROWS, WIDTH, by, A[0], WIDTH, y);
    for (j = 0; j < WIDTH; ++j) {
        real sum = was[j];
        for (i = 0; i < ROWS; ++i)
            sum += by[i] * A[i][j];
        LAW("rows are added by numbers", y[j] == sum);
    }
}

/* Products without the first row, and without the first columns, which hold 0. */
static void products(const mbs_stages_few *f, real A[ROWS][WIDTH], int lower)
{
    static real Z[N][WIDTH], M[WIDTH][WIDTH], was[WIDTH][WIDTH], P[N][N], W[N][WIDTH], before[N][WIDTH];
    const int all = WIDTH - SHIFT;
    int i, j, l;
    draw_all(N * WIDTH, Z[0]), draw_all(WIDTH * WIDTH, M[0]), draw_all(N * WIDTH, W[0]);
    for (i = 0; i < N; ++i)
        for (j = 0; j <= i; ++j)
            P[i][j] = P[j][i] = draw();
    memcpy(was, M, sizeof M), memcpy(before, W, sizeof W);
    mbs_stages_gram_few(f, 1, SHIFT, N, all, all, lower, A[1] + SHIFT, WIDTH, Z[0], WIDTH, M[0], WIDTH);
    for (i = 0; i < all; ++i)
        for (j = 0; j < (lower ? i + 1 : WIDTH); ++j) {
            real sum = was[i][j];
            for (l = 0; l < N && j < all; ++l)
                sum += A[1 + l][SHIFT + i] * Z[l][j];
            LAW("a product of columns is added", M[i][j] == sum);
        }
    mbs_stages_product_few(f, 1, SHIFT, N, all, P[0], N, A[1] + SHIFT, WIDTH, W[0], WIDTH);
    for (i = 0; i < N; ++i)
        for (j = 0; j < WIDTH; ++j) {
            real sum = before[i][j];
            for (l = 0; l < N && j < all; ++l)
                sum += P[i][l] * A[1 + l][SHIFT + j];
            LAW("a product with rows is added", W[i][j] == sum);
        }
}

/* The lower triangle of a symmetric sum. */
static void squares(const mbs_stages_few *f, real A[ROWS][WIDTH], int twice)
{
    static real Z[ROWS][WIDTH], M[WIDTH][WIDTH], was[WIDTH][WIDTH];
    int i, j, l;
    draw_all(ROWS * WIDTH, Z[0]);
    for (i = 0; i < WIDTH; ++i)
        for (j = 0; j < WIDTH; ++j)
            M[i][j] = was[i][j] = j <= i ? draw() : 0;
    mbs_stages_square_few(f, ROWS, WIDTH, twice, A[0], WIDTH, Z[0], WIDTH, M[0], WIDTH);
    for (i = 0; i < WIDTH; ++i)
        for (j = 0; j <= i; ++j) {
            real sum = was[i][j];
            for (l = 0; l < ROWS; ++l)
                sum += A[l][i] * Z[l][j] + (twice ? Z[l][i] * A[l][j] : 0);
            LAW("a symmetric sum has both parts, or one", M[i][j] == sum);
        }
}

int main(void)
{
    static real A[ROWS][WIDTH];
    int count[ROWS], column[ROWS * MBS_STAGES_FEW], turn, i;
    fill(A);
    for (turn = 0; turn < 2; ++turn) {
        mbs_stages_few f = {count, column}, none = {NULL, NULL};
        mbs_stages_find_few(&f, ROWS, WIDTH, A[0], WIDTH);
        lists(&f, A);
        mbs_stages_find_few(&none, ROWS, WIDTH, A[0], WIDTH);
        rows(turn ? &none : &f, A);
        products(turn ? &none : &f, A, 0), products(turn ? &none : &f, A, 1);
        squares(turn ? &none : &f, A, 0), squares(turn ? &none : &f, A, 1);
        mbs_stages_find_few(&f, ROWS, LEAST_WIDTH - 4, A[0], WIDTH);
        for (i = 0; i < ROWS; ++i)
            LAW("short rows have none", f.count[i] < 0);
    }
    return broken > 0;
}
