/* The laws of motions for four states at a time. */
#define MBS_STATES 4
#include "rollout.c"
