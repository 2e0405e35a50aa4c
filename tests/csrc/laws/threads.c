/* The team of threads: each stage is done once, by threads that are awake or asleep, and whatever the system refuses. */
#define _POSIX_C_SOURCE 200112L

#include "laws.h"

#include <pthread.h>
#include <sched.h>
#include <stdlib.h>
#include <time.h>

#define MOST 64

static __thread int held; /* locks, by this thread */
static int wrong, destroyed[3], made, refused_lock = 9, refused_thread = 1000;

static void expect(int is_so)
{
    if (!is_so)
        __atomic_add_fetch(&wrong, 1, __ATOMIC_SEQ_CST);
}

static int lock(pthread_mutex_t *m)
{
    expect(held++ == 0);
    return pthread_mutex_lock(m);
}

static int unlock(pthread_mutex_t *m)
{
    expect(held-- == 1);
    return pthread_mutex_unlock(m);
}

/* Who waits or wakes without the lock misses a call between a look and the sleep. */
static int sleep_until(pthread_cond_t *c, pthread_mutex_t *m)
{
    expect(held == 1);
    return pthread_cond_wait(c, m);
}

static int wake_one(pthread_cond_t *c)
{
    expect(held == 1);
    return pthread_cond_signal(c);
}

static int wake_all(pthread_cond_t *c)
{
    expect(held == 1);
    return pthread_cond_broadcast(c);
}

static int make_lock(pthread_mutex_t *m, const pthread_mutexattr_t *a)
{
    return made++ == refused_lock ? 1 : pthread_mutex_init(m, a);
}

static int make_condition(pthread_cond_t *c, const pthread_condattr_t *a)
{
    return made++ == refused_lock ? 1 : pthread_cond_init(c, a);
}

static int end_lock(pthread_mutex_t *m)
{
    ++destroyed[0];
    return pthread_mutex_destroy(m);
}

static int end_condition(pthread_cond_t *c)
{
    ++destroyed[1];
    return pthread_cond_destroy(c);
}

static int make_thread(pthread_t *t, const pthread_attr_t *a, void *(*f)(void *), void *data)
{
    return refused_thread-- == 0 ? 1 : pthread_create(t, a, f, data);
}

static void give_way(void)
{
    sched_yield();
}

/* Threads fall asleep at once. */
static int look_again(void)
{
    return 0;
}

#define sched_yield look_again
#define pthread_mutex_lock lock
#define pthread_mutex_unlock unlock
#define pthread_cond_wait sleep_until
#define pthread_cond_signal wake_one
#define pthread_cond_broadcast wake_all
#define pthread_mutex_init make_lock
#define pthread_cond_init make_condition
#define pthread_mutex_destroy end_lock
#define pthread_cond_destroy end_condition
#define pthread_create make_thread
#include "../../../csrc/threads/mbs_threads.c"

static mbs_threads *start(int workers)
{
    void *memory;
    destroyed[0] = destroyed[1] = made = 0;
    if (posix_memalign(&memory, 64, mbs_threads_bytes(workers)))
        exit(2);
    memset(memory, 0x55, mbs_threads_bytes(workers));
    return mbs_threads_start(memory, workers);
}

static void stop(mbs_threads *t)
{
    mbs_threads_stop(t);
    free(t);
}

/* What the stages of a round see. */
typedef struct {
    int times[MOST], worker[MOST], calls, longest, others, ended;
    int wanted; /* other workers that the caller waits for in its first stage */
} round_of;

static void do_stages(void *data, int from, int to, int worker)
{
    round_of *r = data;
    int k;
    __atomic_add_fetch(&r->calls, 1, __ATOMIC_SEQ_CST);
    expect(from < to && to <= MOST);
    for (k = from; k < to; ++k) {
        __atomic_add_fetch(&r->times[k], 1, __ATOMIC_SEQ_CST);
        r->worker[k] = worker;
    }
    if (to - from > r->longest)
        r->longest = to - from;
    if (worker)
        __atomic_add_fetch(&r->others, 1, __ATOMIC_SEQ_CST);
    while (!worker && load(&r->others) < r->wanted)
        give_way();
    if (worker && r->wanted) { /* who comes late to the end */
        const struct timespec while_others_end = {0, 20000000};
        nanosleep(&while_others_end, NULL);
    }
    __atomic_add_fetch(&r->ended, 1, __ATOMIC_SEQ_CST);
}

static int is_done(const round_of *r, int count)
{
    int k, is_so = r->calls == r->ended;
    for (k = 0; k < MOST; ++k)
        is_so &= r->times[k] == (k < count);
    return is_so;
}

static void spread(void)
{
    int workers, count;
    for (workers = 1; workers <= 5; ++workers) {
        mbs_threads *t = start(workers);
        LAW("all threads start", mbs_threads_count(t) == workers);
        for (count = 1; count <= MOST; count += 3) {
            round_of r = {{0}, {0}, 0, 0, 0, 0, 0};
            mbs_threads_spread(t, count, do_stages, &r);
            LAW("each stage is done once, when a round ends", is_done(&r, count));
            LAW("in portions of a share", workers == 1 || r.longest <= (count + workers - 1) / workers / 4 + 1 || count == 1);
            LAW("alone in one part", (workers > 1 && count > 1) || (r.calls == 1 && r.worker[0] == 0));
        }
        stop(t);
        LAW("what was made is ended", destroyed[0] == 1 && destroyed[1] == 2);
    }
}

/* Wait until every other thread sleeps. */
static int sleep_all(mbs_threads *t)
{
    while (load(&t->asleep) < t->started - 1)
        give_way();
    return load(&t->asleep) == t->started - 1;
}

static void wake(void)
{
    mbs_threads *t = start(3);
    int k;
    for (k = 0; k < 3; ++k) {
        round_of r = {{0}, {0}, 0, 0, 0, 0, 1};
        LAW("threads without work sleep", sleep_all(t));
        mbs_threads_spread(t, 40, do_stages, &r);
        LAW("and wake for it", r.others > 0);
        LAW("a round ends with its last stage", is_done(&r, 40));
    }
    LAW("they sleep at the end too", sleep_all(t));
    stop(t);
}

static void share_stages(void)
{
    static const int counts[] = {2, 7, 40, 41};
    mbs_threads *t = start(4);
    int i, k;
    for (k = 0; k < 4; ++k) {
        int from = 0;
        share_out(t, counts[k]);
        for (i = 0; i < 4; ++i) {
            const share *s = &t->share[i];
            const int own = s->end - s->next;
            LAW("shares follow each other", s->next == from);
            LAW("are equal but for one stage", own == counts[k] / 4 || own == counts[k] / 4 + 1);
            LAW("and are taken in four portions", own == 0 || (s->portion >= 1 && 4 * s->portion >= own && 4 * (s->portion - 1) < own));
            from = s->end;
        }
        LAW("to the last one", from == counts[k]);
    }
    t->state = 0;
    LAW("closed work is not joined", join(t) == 0 && t->state == 0);
    t->state = OPEN;
    LAW("open work is", join(t) == 1 && t->state == OPEN + MEMBER);
    t->state = 0;
    stop(t);
}

static void take_own_shares(void)
{
    mbs_threads *t = start(1);
    round_of r = {{0}, {0}, 0, 0, 0, 0, 0};
    share four[4];
    int k;
    t->workers = 4, t->share = four, t->task = do_stages, t->data = &r;
    share_out(t, 40);
    four[2].next = 28; /* as others have left it */
    work(t, 2);
    for (k = 0; k < 40; ++k)
        LAW("what is left is taken", r.times[k] == !(k >= 20 && k < 28) && (!r.times[k] || r.worker[k] == 2));
    t->workers = 1;
    stop(t);
}

static void refuse(void)
{
    static const int locks[3][2] = {{0, 0}, {1, 0}, {1, 1}};
    round_of r = {{0}, {0}, 0, 0, 0, 0, 0};
    mbs_threads *t;
    for (refused_lock = 0; refused_lock < 3; ++refused_lock) {
        t = start(3);
        LAW("without locks there are no threads", mbs_threads_count(t) == 1);
        memset(&r, 0, sizeof r);
        mbs_threads_spread(t, 20, do_stages, &r);
        LAW("the caller does all", is_done(&r, 20) && r.calls == 1);
        stop(t);
        LAW("what was made is ended alone", destroyed[0] == locks[refused_lock][0] && destroyed[1] == locks[refused_lock][1]);
    }
    refused_lock = 9, refused_thread = 1;
    t = start(4);
    LAW("threads may be refused", mbs_threads_count(t) == 2);
    memset(&r, 0, sizeof r);
    mbs_threads_spread(t, 20, do_stages, &r);
    LAW("others do their shares", is_done(&r, 20));
    stop(t);
    refused_thread = 1000;
}

int main(void)
{
    spread();
    wake();
    share_stages();
    take_own_shares();
    refuse();
    LAW("conditions are awaited and told under the lock alone", wrong == 0 && held == 0);
    return broken > 0;
}
