#include "laws.h"

#include "../../../csrc/stages/pivots.c"

int main(void)
{
    real column[6] = {(real)-0.5, 7, (real)0.02, 7, 0, 7};
    LAW("numbers are balanced, a stride apart", balance(column, 3, 2) == 0 && near(-column[0] * column[2], 1));
    LAW("by one factor", near(column[0] / column[2], -25) && column[4] == 0);
    LAW("the others stay", column[1] == 7 && column[3] == 7 && column[5] == 7);
    column[0] = 300, column[1] = (real)1e-4, column[2] = 100;
    LAW("rounding beside the largest does not count", balance(column, 3, 1) == 0 && near(column[0] * column[2], 1));
    column[0] = column[1] = 0;
    LAW("zeros cannot be balanced", balance(column, 2, 1) == -1);
    return broken > 0;
}
