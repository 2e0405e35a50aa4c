#include "laws.h"

#include "../../../csrc/stages/step.c"

/* Two rows of two unknowns in room for three; the third row is of an earlier problem. */
static real lu[6], weight[3];
static int row[3], column[3];
static char used[2];
static mbs_stages_step step;

static void anew(real a, real b, real c, real d)
{
    const real numbers[6] = {a, b, 1000, c, d, 1000};
    int i;
    memset(&step, 0, sizeof step);
    step.n = 2, step.capacity = 3, step.rows = 2, step.lu = lu, step.row = row, step.column = column;
    memcpy(lu, numbers, sizeof lu);
    for (i = 0; i < 3; ++i)
        row[i] = i, column[i] = -1, weight[i] = 1000;
    used[0] = used[1] = 0;
    weigh_rows(&step, weight);
    weight[2] = 1;
}

int main(void)
{
    anew(1, 8, 4, 10);
    LAW("a row's weight is the inverse of its largest entry", near(weight[0], (real)0.25) && near(weight[1], (real)0.1));
    LAW("all unknowns have a pivot", eliminate_clear(&step, weight, used, 0, 2) == 2 && used[0] && used[1]);
    LAW("the first one in the row where its share is largest", row[0] == 1 && row[1] == 0 && column[0] == 0);
    LAW("with the factor of elimination below", near(lu[1], (real)0.125) && near(lu[4], 4 - (real)1.25));
    LAW("other rows are left alone", lu[2] == 1000 && lu[5] == 1000 && row[2] == 2);
    anew(1, 1, 5, 5);
    LAW("a small share in its row is no clear pivot", eliminate_clear(&step, weight, used, 0, 1) == 0 && !used[0]);
    anew(0, 0, 0, 0);
    LAW("nor is nothing", weight[0] == 0 && eliminate_clear(&step, weight, used, 0, 2) == 0);
    return broken > 0;
}
