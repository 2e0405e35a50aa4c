#include "laws.h"

#include <stdlib.h>

#include "../../../csrc/stages/matrix.c"

/* Matrices of whole numbers, with a pattern and without: all operations are the same as on the full one. */
enum { MOST = 7 };
static unsigned seed = 5;
static real full[MOST * MOST], numbers[MOST * MOST];
static int begin[MOST], end[MOST], row_of[MOST * MOST];

static int draw(int choices)
{
    seed = seed * 1103515245u + 12345u;
    return (int)(seed / 65536 % (unsigned)choices);
}

/* Draw a matrix; `lower`: its lower triangle alone. Columns of a pattern are apart,
    with a number between that is none. */
static mbs_stages_matrix make(int rows, int columns, int is_sparse, int lower)
{
    mbs_stages_matrix A = {rows, columns, NULL, NULL, NULL, 0, numbers};
    int i, j, at = 0;
    for (j = 0; j < columns; ++j) {
        begin[j] = at;
        for (i = 0; i < rows; ++i) {
            const int is_there = (!is_sparse || draw(3) > 0) && (!lower || i >= j);
            full[i * MOST + j] = is_there ? (real)(draw(13) - 6) : 0;
            if (is_there || !is_sparse)
                row_of[at] = i, numbers[at++] = is_there ? full[i * MOST + j] : 1e6;
        }
        end[j] = at;
        if (is_sparse)
            row_of[at] = 0, numbers[at++] = 1e6;
    }
    A.count = at;
    if (is_sparse)
        A.begin = begin, A.end = end, A.row = row_of;
    return A;
}

static void products(int rows, int columns, int is_sparse)
{
    const mbs_stages_matrix A = make(rows, columns, is_sparse, 0);
    const int from = columns > 2 ? 1 : 0, to = columns > 3 ? columns - 1 : columns;
    real x[MOST], y[MOST], ahead[MOST], back[MOST], all[MOST], across[MOST], most[MOST], dense[MOST * (MOST + 1)];
    int i, j;
    for (i = 0; i < MOST; ++i)
        x[i] = (real)(draw(9) - 4), y[i] = (real)(draw(9) - 4), ahead[i] = back[i] = all[i] = across[i] = most[i] = 5;
    mbs_stages_matrix_apply(&A, from, to, x, ahead);
    mbs_stages_matrix_apply_transposed(&A, from, to, y, back);
    mbs_stages_matrix_apply_both(&A, x, all, y, across);
    mbs_stages_matrix_row_maxima(&A, most);
    for (i = 0; i < MOST * (MOST + 1); ++i)
        dense[i] = 77;
    mbs_stages_matrix_spread(&A, 0, dense, columns + 1);
    for (i = 0; i < MOST; ++i) {
        real part = 5, sum = 5, largest = 0;
        for (j = 0; j < columns && i < rows; ++j) {
            sum += full[i * MOST + j] * x[j], part += j >= from && j < to ? full[i * MOST + j] * x[j] : 0;
            largest = real_abs(full[i * MOST + j]) > largest ? real_abs(full[i * MOST + j]) : largest;
            LAW("a matrix is spread", dense[i * (columns + 1) + j] == full[i * MOST + j]);
        }
        LAW("columns are applied", ahead[i] == part && all[i] == sum);
        LAW("rows have their largest entry", most[i] == (i < rows ? largest : 5));
        LAW("and zeros beside it", i >= rows || dense[i * (columns + 1) + columns] == 0);
    }
    LAW("in its room", dense[rows * (columns + 1)] == 77);
    for (j = 0; j < MOST; ++j) {
        real sum = 5;
        for (i = 0; i < rows && j < columns; ++i)
            sum += full[i * MOST + j] * y[i];
        LAW("and across", back[j] == (j >= from && j < to ? sum : 5) && across[j] == (j < columns ? sum : 5));
    }
}

static void scales(int rows, int columns, int is_sparse)
{
    const mbs_stages_matrix A = make(rows, columns, is_sparse, 0);
    const real by_row[MOST] = {2, 3, 0.5, -1, 4, 7, 1}, by_column[MOST] = {1, -2, 8, 5, 0.25, 3, 2};
    real dense[MOST * MOST];
    int i, j;
    mbs_stages_matrix_scale(&A, by_row, by_column);
    mbs_stages_matrix_spread(&A, 0, dense, MOST);
    for (i = 0; i < rows; ++i)
        for (j = 0; j < columns; ++j)
            LAW("rows and columns are scaled", dense[i * MOST + j] == full[i * MOST + j] * by_row[i] * by_column[j]);
    for (j = 0; j < columns && is_sparse; ++j)
        LAW("numbers between columns are not", numbers[end[j]] == 1e6);
}

static void symmetric_ones(int n, int is_sparse)
{
    const mbs_stages_matrix A = make(n, n, is_sparse, 1);
    real x[MOST], y[MOST], dense[MOST * MOST], largest = 0;
    int i, j;
    for (i = 0; i < MOST; ++i)
        x[i] = (real)(draw(9) - 4), y[i] = 5;
    mbs_stages_matrix_apply_symmetric(&A, x, y);
    mbs_stages_matrix_spread(&A, 1, dense, MOST);
    for (i = 0; i < n; ++i) {
        real sum = 5;
        for (j = 0; j < n; ++j) {
            sum += (j <= i ? full[i * MOST + j] : full[j * MOST + i]) * x[j];
            LAW("the lower triangle is spread alone", dense[i * MOST + j] == full[i * MOST + j]);
        }
        LAW("it is applied both ways", y[i] == sum);
        largest = real_abs(full[i * (MOST + 1)]) > largest ? real_abs(full[i * (MOST + 1)]) : largest;
    }
    LAW("the diagonal has its largest entry", mbs_stages_matrix_diagonal(&A) == largest);
}

/* Rows of V times the first rows of a symmetric matrix, from the diagonal on, and another diagonal. */
static void rows_of(int n, int width)
{
    enum { WIDEST = 80 };
    const mbs_stages_matrix A = make(n, n, 1, 1);
    const int first = n > 2, count = n - first, ld = mbs_stages_lines(width) + 4;
    static real V[MOST * (WIDEST + 4)], Z[MOST * (WIDEST + 4)];
    int from[MOST], to[MOST], i, j, c;
    real diagonal[MOST];
    mbs_stages_part part;
    for (i = 0; i < MOST * (WIDEST + 4); ++i)
        V[i] = (real)(draw(9) - 4), Z[i] = 99;
    for (j = 0; j < count; ++j) {
        from[j] = begin[first + j] + (begin[first + j] < end[first + j] && row_of[begin[first + j]] == first + j);
        to[j] = end[first + j];
        diagonal[j] = (real)(draw(9) - 4);
    }
    part.first = first, part.count = count, part.begin = from, part.end = to, part.diagonal = diagonal;
    mbs_stages_matrix_multiply_rows(&A, &part, width, ld, V, Z);
    for (j = 0; j < count; ++j)
        for (c = 0; c < ld; c = c + 1 == width ? mbs_stages_lines(width) : c + 1) {
            real sum = c < width ? diagonal[j] * V[j * ld + c] : 99;
            for (i = j + 1; i < count && c < width; ++i)
                sum += full[(first + i) * MOST + first + j] * V[i * ld + c];
            LAW("rows are multiplied", Z[j * ld + c] == sum);
        }
}

int main(void)
{
    int rows, columns, is_sparse, turn;
    for (turn = 0; turn < 3; ++turn)
        for (is_sparse = 0; is_sparse < 2; ++is_sparse)
            for (rows = 1; rows < MOST; ++rows) {
                for (columns = 1; columns < MOST; ++columns)
                    products(rows, columns, is_sparse), scales(rows, columns, is_sparse);
                symmetric_ones(rows, is_sparse);
                for (columns = 4; columns < 77; columns += 4)
                    rows_of(rows, columns);
            }
    return broken > 0;
}
