/* A team of POSIX threads for the solver of mbs_stages.h.
 *
 * Threads wait for work, first awake and then asleep. The caller's thread is worker 0, and does the work of threads that
 * come late. Needs POSIX threads, and atomic operations as gcc and clang have them. Lies in a folder of csrc: compile with
 * -I csrc/stages, and link with -pthread. */
#ifndef MBS_THREADS_H
#define MBS_THREADS_H

#include "mbs_stages.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct mbs_threads mbs_threads;

/* Return how many bytes of memory a team of `workers` needs, the caller's thread among them. */
size_t mbs_threads_bytes(int workers);

/* Start the threads, in memory that is aligned to 64 bytes. */
mbs_threads *mbs_threads_start(void *memory, int workers);

/* Return how many workers there are: fewer where the system started no more threads. */
int mbs_threads_count(const mbs_threads *threads);

/* `spread` of mbs_stages_team; `threads` is its pool. One call at a time. */
void mbs_threads_spread(void *threads, int count, mbs_stages_task task, void *data);

/* End the threads. */
void mbs_threads_stop(mbs_threads *threads);

#ifdef __cplusplus
}
#endif

#endif
