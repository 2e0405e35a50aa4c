#define MBS_STAGES_WIDE 1
#include "pivots.c"
