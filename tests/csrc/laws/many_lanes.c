/* The laws of kernels in many states for four states at a time. */
#define MBS_STATES 4
#include "many.c"
