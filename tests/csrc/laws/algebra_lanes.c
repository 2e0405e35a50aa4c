/* The laws of linear equations and Newton's steps in kernels for four states at a time. */
#define MBS_STATES 4
#include "algebra.c"
