/* A team of POSIX threads: see mbs_threads.h.
 *
 * Each worker begins with its own share of the stages, so that their numbers stay in its processor's cache, and then
 * takes from the shares of others. `state` counts the threads at work, with a bit for work that is open to them. */
#define _POSIX_C_SOURCE 200112L

#include "mbs_threads.h"

#include <pthread.h>
#include <sched.h>

#define LINE 64    /* bytes of a cache line */
#define PORTIONS 4 /* of a share */
#define AWAKE 1000 /* looks for work before a thread sleeps */
#define LOCKS 3
#define OPEN 1
#define MEMBER 2

/* Stages that nobody has taken yet. */
typedef struct {
    int next, end, portion;
    char apart[LINE - 3 * sizeof(int)];
} share;

typedef struct {
    mbs_threads *threads;
    pthread_t thread;
    int worker;
} member;

struct mbs_threads {
    int workers, started; /* threads, and the caller's */
    int locks;            /* that were made: without all of them there are no threads */
    mbs_stages_task task;
    void *data;
    share *share;
    member *member;
    pthread_mutex_t lock; /* of sleeping threads */
    pthread_cond_t work, done;
    char apart[LINE];
    int state, round, asleep, ending; /* atomic */
};

static size_t round_up(size_t bytes)
{
    return (bytes + LINE - 1) / LINE * LINE;
}

size_t mbs_threads_bytes(int workers)
{
    return round_up(sizeof(mbs_threads)) + (size_t)workers * sizeof(share) +
           round_up((size_t)workers * sizeof(member));
}

static int load(const int *a)
{
    return __atomic_load_n(a, __ATOMIC_SEQ_CST);
}

static void work(mbs_threads *t, int worker)
{
    int i;
    for (i = 0; i < t->workers; ++i) {
        share *s = &t->share[(worker + i) % t->workers];
        int from;
        while (load(&s->next) < s->end &&
               (from = __atomic_fetch_add(&s->next, s->portion, __ATOMIC_SEQ_CST)) < s->end)
            t->task(t->data, from, from + s->portion < s->end ? from + s->portion : s->end, worker);
    }
}

/* Join the work if it is open. */
static int join(mbs_threads *t)
{
    int state = load(&t->state);
    while (state & OPEN)
        if (__atomic_compare_exchange_n(&t->state, &state, state + MEMBER, 0, __ATOMIC_SEQ_CST, __ATOMIC_SEQ_CST))
            return 1;
    return 0;
}

static void leave(mbs_threads *t)
{
    if (__atomic_sub_fetch(&t->state, MEMBER, __ATOMIC_SEQ_CST) == 0) {
        pthread_mutex_lock(&t->lock);
        pthread_cond_signal(&t->done);
        pthread_mutex_unlock(&t->lock);
    }
}

/* Wait for another round than the one that was seen. */
static void wait_for_work(mbs_threads *t, int seen)
{
    int i;
    for (i = 0; i < AWAKE; ++i) {
        if (load(&t->round) != seen)
            return;
        sched_yield();
    }
    pthread_mutex_lock(&t->lock);
    __atomic_add_fetch(&t->asleep, 1, __ATOMIC_SEQ_CST);
    while (load(&t->round) == seen)
        pthread_cond_wait(&t->work, &t->lock);
    __atomic_sub_fetch(&t->asleep, 1, __ATOMIC_SEQ_CST);
    pthread_mutex_unlock(&t->lock);
}

static void *serve(void *data)
{
    const member *m = data;
    mbs_threads *t = m->threads;
    int seen = 0;
    for (;;) {
        wait_for_work(t, seen);
        seen = load(&t->round);
        if (load(&t->ending))
            return NULL;
        if (join(t)) {
            work(t, m->worker);
            leave(t);
        }
    }
}

/* Begin a round; wake sleeping threads. */
static void call(mbs_threads *t)
{
    __atomic_add_fetch(&t->round, 1, __ATOMIC_SEQ_CST);
    if (load(&t->asleep) == 0)
        return;
    pthread_mutex_lock(&t->lock);
    pthread_cond_broadcast(&t->work);
    pthread_mutex_unlock(&t->lock);
}

/* Return how many there are: the lock, then its conditions. */
static int make_locks(mbs_threads *t)
{
    if (pthread_mutex_init(&t->lock, NULL))
        return 0;
    if (pthread_cond_init(&t->work, NULL))
        return 1;
    return pthread_cond_init(&t->done, NULL) ? 2 : LOCKS;
}

static void end_locks(mbs_threads *t)
{
    if (t->locks > 2)
        pthread_cond_destroy(&t->done);
    if (t->locks > 1)
        pthread_cond_destroy(&t->work);
    if (t->locks > 0)
        pthread_mutex_destroy(&t->lock);
}

mbs_threads *mbs_threads_start(void *memory, int workers)
{
    mbs_threads *t = memory;
    t->workers = workers;
    t->started = 1;
    t->share = (share *)((char *)memory + round_up(sizeof *t));
    t->member = (member *)(t->share + workers);
    t->state = t->round = t->asleep = t->ending = 0;
    t->locks = make_locks(t);
    for (; t->locks == LOCKS && t->started < workers; ++t->started) {
        member *m = &t->member[t->started];
        m->threads = t;
        m->worker = t->started;
        if (pthread_create(&m->thread, NULL, serve, m))
            break;
    }
    return t;
}

int mbs_threads_count(const mbs_threads *threads)
{
    return threads->started;
}

static void share_out(mbs_threads *t, int count)
{
    int i;
    for (i = 0; i < t->workers; ++i) {
        share *s = &t->share[i];
        s->next = (int)((long)count * i / t->workers);
        s->end = (int)((long)count * (i + 1) / t->workers);
        s->portion = (s->end - s->next + PORTIONS - 1) / PORTIONS;
    }
}

/* Wait for threads that are still at work. */
static void wait_for_members(mbs_threads *t)
{
    int i;
    for (i = 0; i < AWAKE; ++i) {
        if (load(&t->state) == 0)
            return;
        sched_yield();
    }
    pthread_mutex_lock(&t->lock);
    while (load(&t->state) != 0)
        pthread_cond_wait(&t->done, &t->lock);
    pthread_mutex_unlock(&t->lock);
}

void mbs_threads_spread(void *threads, int count, mbs_stages_task task, void *data)
{
    mbs_threads *t = threads;
    if (t->started == 1 || count == 1) {
        task(data, 0, count, 0);
        return;
    }
    t->task = task;
    t->data = data;
    share_out(t, count);
    __atomic_store_n(&t->state, OPEN, __ATOMIC_SEQ_CST);
    call(t);
    work(t, 0);
    __atomic_sub_fetch(&t->state, OPEN, __ATOMIC_SEQ_CST);
    wait_for_members(t);
}

void mbs_threads_stop(mbs_threads *threads)
{
    int i;
    __atomic_store_n(&threads->ending, 1, __ATOMIC_SEQ_CST);
    call(threads);
    for (i = 1; i < threads->started; ++i)
        pthread_join(threads->member[i].thread, NULL);
    end_locks(threads);
}
