/* A mechanism for FMI, of any version.
 *
 * States are the coordinates and velocities of joints that are not driven; driven joints have inputs. Value references count the time, states, their derivatives, inputs, outputs,
 * parameters, and the longest step of co-simulation. Derivatives by states and inputs come from generated functions.
 * Loops are kept closed by a projection of the states after every step. */
#include "mbs_fmi.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define MODEL mbs_fmi_model
#define STATES ((mbs_fmi_reference)MODEL.states)
#define WHOLE (MODEL.coordinates + MODEL.velocities) /* of states and driven joints */
#define FIRST_STATE ((mbs_fmi_reference)1)
#define FIRST_DERIVATIVE (FIRST_STATE + STATES)
#define FIRST_INPUT (FIRST_DERIVATIVE + STATES)
#define FIRST_OUTPUT (FIRST_INPUT + (mbs_fmi_reference)MODEL.inputs)
#define FIRST_PARAMETER (FIRST_OUTPUT + (mbs_fmi_reference)MODEL.outputs)
#define STEP (FIRST_PARAMETER + (mbs_fmi_reference)MODEL.parameters)
#define DRIFT 1e-9 /* of a state, absolute or relative: the most that model exchange goes on with */

typedef mbs_fmi_instance instance;

/* --- numbers --- */

int mbs_fmi_fail(instance *c, const char *message)
{
    c->report(c, message);
    return 1;
}

static int call(instance *c, mbs_fmi_function f)
{
    return f ? f(c->numbers) : 0;
}

static int set_up(instance *c)
{
    if (!c->is_set_up && call(c, MODEL.setup))
        return mbs_fmi_fail(c, "the parameters admit no mechanism");
    c->is_set_up = 1;
    return 0;
}

static int evaluate(instance *c)
{
    char text[120];
    int k, status;
    mbs_real *rates = c->numbers + MODEL.results;
    if (c->is_known)
        return 0;
    if (set_up(c))
        return 1;
    for (k = 0; !MODEL.rates && k < MODEL.coordinates; ++k)
        rates[k] = c->numbers[MODEL.coordinates + k];
    if (call(c, MODEL.rates) || call(c, MODEL.places))
        return mbs_fmi_fail(c, "rates or outputs cannot be computed");
    status = call(c, MODEL.accelerations);
    if (status) {
        snprintf(text, sizeof text, "the accelerations cannot be computed at joint %d, at time %.9g", status, c->time);
        return mbs_fmi_fail(c, text);
    }
    c->is_known = 1;
    return 0;
}

static void change(instance *c)
{
    c->is_known = 0;
}

/* Put the time where forces read it. */
static void show_time(instance *c, double time)
{
    if (MODEL.clock >= 0) {
        c->numbers[MODEL.clock] = (mbs_real)time;
        change(c);
    }
}

void mbs_fmi_set_time(instance *c, double time)
{
    c->time = time;
    show_time(c, time);
}

/* Return the number of a value reference, or NULL. */
static mbs_real *find(instance *c, mbs_fmi_reference r)
{
    if (r >= FIRST_STATE && r < FIRST_DERIVATIVE)
        return c->numbers + MODEL.state[r - FIRST_STATE];
    if (r >= FIRST_DERIVATIVE && r < FIRST_INPUT)
        return c->numbers + MODEL.results + MODEL.state[r - FIRST_DERIVATIVE];
    if (r >= FIRST_INPUT && r < FIRST_OUTPUT)
        return c->numbers + MODEL.input[r - FIRST_INPUT];
    if (r >= FIRST_OUTPUT && r < FIRST_PARAMETER)
        return c->numbers + MODEL.results + WHOLE + (r - FIRST_OUTPUT);
    if (r >= FIRST_PARAMETER && r < STEP)
        return c->numbers + MODEL.parameter + (r - FIRST_PARAMETER);
    return NULL;
}

static int is_computed(mbs_fmi_reference r)
{
    return (r >= FIRST_DERIVATIVE && r < FIRST_INPUT) || (r >= FIRST_OUTPUT && r < FIRST_PARAMETER);
}

int mbs_fmi_get(instance *c, const mbs_fmi_reference references[], size_t count, double values[])
{
    size_t k;
    for (k = 0; k < count; ++k) {
        const mbs_real *place = find(c, references[k]);
        if (is_computed(references[k]) && evaluate(c))
            return 1;
        if (references[k] == 0)
            values[k] = c->time;
        else if (references[k] == STEP)
            values[k] = c->step;
        else if (place)
            values[k] = (double)*place;
        else
            return mbs_fmi_fail(c, "there is no variable of this value reference");
    }
    return 0;
}

int mbs_fmi_set(instance *c, const mbs_fmi_reference references[], size_t count, const double values[])
{
    size_t k;
    for (k = 0; k < count; ++k) {
        mbs_real *place = find(c, references[k]);
        if (!(values[k] - values[k] == 0))
            return mbs_fmi_fail(c, "a value is not finite");
        if (references[k] == STEP && values[k] > 0) {
            c->step = values[k];
            continue;
        }
        if (!place || is_computed(references[k]))
            return mbs_fmi_fail(c, "the variable of this value reference cannot be set");
        *place = (mbs_real)values[k];
        if (references[k] >= FIRST_PARAMETER)
            c->is_set_up = 0;
    }
    change(c);
    return 0;
}

/* --- derivatives --- */

static int find_unknown(mbs_fmi_reference r)
{
    if (r >= FIRST_DERIVATIVE && r < FIRST_INPUT)
        return (int)(r - FIRST_DERIVATIVE);
    return r >= FIRST_OUTPUT && r < FIRST_PARAMETER ? (int)(STATES + r - FIRST_OUTPUT) : -1;
}

static int find_known(mbs_fmi_reference r)
{
    if (r >= FIRST_STATE && r < FIRST_DERIVATIVE)
        return (int)(r - FIRST_STATE);
    return r >= FIRST_INPUT && r < FIRST_OUTPUT ? (int)(STATES + r - FIRST_INPUT) : -1;
}

static int slope(instance *c)
{
    int k;
    if (set_up(c))
        return 1;
    for (k = 0; k < MODEL.slopes; ++k)
        if (call(c, MODEL.slope[k]))
            return mbs_fmi_fail(c, "the derivatives cannot be computed");
    return 0;
}

/* Add one derivative, of unknown i by known j, to the sum that it is a part of. */
static void add(double value, size_t i, size_t j, const double seed[], double found[], int is_adjoint)
{
    found[is_adjoint ? j : i] += value * seed[is_adjoint ? i : j];
}

/* Add the derivatives of unknown i: of a state, which is an output too, by itself; else its row. */
static void add_row(const instance *c, const mbs_fmi_reference unknowns[], size_t i, const mbs_fmi_reference knowns[],
                    size_t n_knowns, const double seed[], double found[], int is_adjoint)
{
    const int row = find_unknown(unknowns[i]);
    size_t j;
    int k;
    for (j = 0; j < n_knowns; ++j)
        if (row < 0 && knowns[j] == unknowns[i])
            add(1, i, j, seed, found, is_adjoint);
    for (k = 0; k < MODEL.nonzeros; ++k)
        for (j = 0; MODEL.row[k] == row && j < n_knowns; ++j)
            if (MODEL.column[k] == find_known(knowns[j]))
                add(MODEL.place[k] < 0 ? 1 : (double)c->numbers[MODEL.place[k]], i, j, seed, found, is_adjoint);
}

int mbs_fmi_differentiate(instance *c, const mbs_fmi_reference unknowns[], size_t n_unknowns,
                          const mbs_fmi_reference knowns[], size_t n_knowns, const double seed[], double found[],
                          int is_adjoint)
{
    size_t i, j;
    for (i = 0; i < n_unknowns; ++i)
        if (find_unknown(unknowns[i]) < 0 && find_known(unknowns[i]) < 0)
            return mbs_fmi_fail(c, "derivatives are known of state derivatives and outputs");
    for (j = 0; j < n_knowns; ++j)
        if (find_known(knowns[j]) < 0)
            return mbs_fmi_fail(c, "derivatives are known by states and inputs");
    if (slope(c))
        return 1;
    for (i = 0; i < (is_adjoint ? n_knowns : n_unknowns); ++i)
        found[i] = 0;
    for (i = 0; i < n_unknowns; ++i)
        add_row(c, unknowns, i, knowns, n_knowns, seed, found, is_adjoint);
    return 0;
}

/* --- instances --- */

void mbs_fmi_begin(instance *c)
{
    memset(c->numbers, 0, (size_t)MODEL.size * sizeof *c->numbers);
    memcpy(c->numbers, MODEL.start, (size_t)MODEL.given * sizeof *c->numbers);
    c->time = 0;
    c->step = (double)MODEL.step;
    c->is_set_up = c->is_known = 0;
}

int mbs_fmi_open(instance *c, const char *token)
{
    c->numbers = c->work = NULL;
    if (!token || strcmp(token, MODEL.token))
        return mbs_fmi_fail(c, "the token is not this model's");
    c->numbers = malloc((size_t)MODEL.size * sizeof *c->numbers);
    c->work = malloc((5 * (size_t)STATES + 2 * (size_t)MODEL.driven) * sizeof *c->work);
    if (!c->numbers || !c->work) {
        mbs_fmi_close(c);
        return mbs_fmi_fail(c, "there is no memory for an instance");
    }
    mbs_fmi_begin(c);
    return 0;
}

void mbs_fmi_close(instance *c)
{
    free(c->numbers);
    free(c->work);
}

/* --- states --- */

size_t mbs_fmi_count_states(void)
{
    return STATES;
}

static int check_count(instance *c, size_t count)
{
    return count == STATES ? 0 : mbs_fmi_fail(c, "the number of states is another");
}

int mbs_fmi_get_states(instance *c, double states[], size_t count)
{
    size_t k;
    if (check_count(c, count))
        return 1;
    for (k = 0; k < count; ++k)
        states[k] = (double)c->numbers[MODEL.state[k]];
    return 0;
}

int mbs_fmi_set_states(instance *c, const double states[], size_t count)
{
    size_t k;
    if (check_count(c, count))
        return 1;
    for (k = 0; k < count; ++k)
        c->numbers[MODEL.state[k]] = (mbs_real)states[k];
    change(c);
    return 0;
}

int mbs_fmi_get_rates(instance *c, double rates[], size_t count)
{
    size_t k;
    if (check_count(c, count) || evaluate(c))
        return 1;
    for (k = 0; k < count; ++k)
        rates[k] = (double)c->numbers[MODEL.results + MODEL.state[k]];
    return 0;
}

/* --- closed loops --- */

static int report_open(instance *c)
{
    char text[100];
    snprintf(text, sizeof text, "the loops cannot be closed, at time %.9g", c->time);
    return mbs_fmi_fail(c, text);
}

int mbs_fmi_initialise(instance *c)
{
    mbs_real *const qd = c->numbers + MODEL.coordinates, *const closed = c->numbers + MODEL.closed;
    mbs_real *const closed_qd = closed + MODEL.coordinates, *const yd = closed_qd + MODEL.velocities;
    int k;
    if (set_up(c))
        return 1;
    if (MODEL.close) {
        if (MODEL.close(c->numbers))
            return report_open(c);
        memcpy(c->numbers, closed, (size_t)MODEL.coordinates * sizeof *closed);
        for (k = 0; k < MODEL.independents; ++k)
            yd[k] = qd[MODEL.independent[k]];
        if (MODEL.close_rates(c->numbers))
            return report_open(c);
        memcpy(qd, closed_qd, (size_t)MODEL.velocities * sizeof *qd);
        change(c);
    }
    return evaluate(c);
}

int mbs_fmi_has_drifted(instance *c)
{
    size_t k;
    if (!MODEL.project || set_up(c))
        return 0;
    if (MODEL.project(c->numbers))
        return 1;
    for (k = 0; k < STATES; ++k) {
        const mbs_real *place = c->numbers + MODEL.state[k];
        const double x = (double)*place, change = fabs((double)place[MODEL.closed] - x);
        if (!(change <= DRIFT * (1 + fabs(x))))
            return 1;
    }
    return 0;
}

int mbs_fmi_project(instance *c)
{
    if (!MODEL.project)
        return 0;
    if (set_up(c))
        return 1;
    if (MODEL.project(c->numbers))
        return report_open(c);
    memcpy(c->numbers, c->numbers + MODEL.closed, (size_t)WHOLE * sizeof *c->numbers);
    change(c);
    return 0;
}

/* --- steps --- */

static void save_states(const instance *c, mbs_real *states)
{
    size_t k;
    for (k = 0; k < STATES; ++k)
        states[k] = c->numbers[MODEL.state[k]];
}

static void restore_states(instance *c, const mbs_real *states)
{
    size_t k;
    for (k = 0; k < STATES; ++k)
        c->numbers[MODEL.state[k]] = states[k];
    change(c);
}

/* Return the place of a driven joint's coordinate; its velocity and acceleration are `driven` and 2 `driven` inputs on. */
static const int *find_driven(int joint)
{
    return MODEL.input + MODEL.inputs - 3 * MODEL.driven + joint;
}

static void save_driven(const instance *c, mbs_real *given)
{
    int k;
    for (k = 0; k < 2 * MODEL.driven; ++k)
        given[k] = c->numbers[*find_driven(k)];
}

/* Put driven joints where their accelerations bring them in the time since q and qd were `given`. */
static void guide(instance *c, const mbs_real *given, double since)
{
    const int d = MODEL.driven;
    const mbs_real t = (mbs_real)since;
    int k;
    for (k = 0; k < d; ++k) {
        const int *place = find_driven(k);
        const mbs_real qd = given[d + k], qdd = c->numbers[place[2 * d]];
        c->numbers[place[0]] = given[k] + t * (qd + (mbs_real)0.5 * t * qdd);
        c->numbers[place[d]] = qd + t * qdd;
    }
}

/* Take a step that begins `since` driven joints were given. */
static int step(instance *c, double since, double h)
{
    static const double when[] = {0, 0.5, 0.5, 1}, weight[] = {1.0 / 6, 1.0 / 3, 1.0 / 3, 1.0 / 6};
    const size_t n = STATES;
    const mbs_real *before = c->work + 4 * n, *given = before + n;
    size_t i, k;
    for (i = 0; i < 4; ++i) {
        for (k = 0; k < n; ++k)
            c->numbers[MODEL.state[k]] = before[k] + (mbs_real)(h * when[i]) * (i ? c->work[(i - 1) * n + k] : 0);
        guide(c, given, since + h * when[i]);
        show_time(c, c->time + h * when[i]);
        change(c);
        if (evaluate(c))
            return 1;
        for (k = 0; k < n; ++k)
            c->work[i * n + k] = c->numbers[MODEL.results + MODEL.state[k]];
    }
    for (k = 0; k < n; ++k) {
        mbs_real *const place = c->numbers + MODEL.state[k];
        mbs_real sum = 0;
        for (i = 0; i < 4; ++i)
            sum += (mbs_real)weight[i] * c->work[i * n + k];
        *place = before[k] + (mbs_real)h * sum;
        if (!(*place - *place == 0))
            return mbs_fmi_fail(c, "the motion diverges: its numbers overflow");
    }
    change(c);
    return mbs_fmi_project(c);
}

int mbs_fmi_advance(instance *c, double time, double size)
{
    const double steps = size / c->step;
    mbs_real *const before = c->work + 4 * STATES, *const given = before + STATES;
    long count, k;
    mbs_fmi_set_time(c, time);
    if (!(size >= 0) || !(steps < 1e9))
        return mbs_fmi_fail(c, "the communication step is negative, or holds too many steps");
    if (MODEL.driven && mbs_fmi_project(c)) /* new inputs open loops */
        return 1;
    count = (long)(steps * (1 - 1e-12)) + (size > 0);
    save_driven(c, given);
    for (k = 0; k < count; ++k) {
        const double since = size * (double)k / (double)count;
        save_states(c, before);
        if (step(c, since, size / (double)count)) {
            guide(c, given, since);
            restore_states(c, before);
            show_time(c, c->time);
            return 1;
        }
        mbs_fmi_set_time(c, time + size * (double)(k + 1) / (double)count);
    }
    return evaluate(c);
}

/* --- the saved state of an instance --- */

size_t mbs_fmi_count_bytes(void)
{
    return 2 * sizeof(double) + (size_t)MODEL.size * sizeof(mbs_real);
}

static void save(const instance *c, unsigned char *bytes)
{
    const double two[] = {c->time, c->step};
    memcpy(bytes, two, sizeof two);
    memcpy(bytes + sizeof two, c->numbers, (size_t)MODEL.size * sizeof *c->numbers);
}

void mbs_fmi_restore(instance *c, const unsigned char *bytes)
{
    double two[2];
    memcpy(two, bytes, sizeof two);
    memcpy(c->numbers, bytes + sizeof two, (size_t)MODEL.size * sizeof *c->numbers);
    c->time = two[0];
    c->step = two[1];
    c->is_set_up = c->is_known = 0;
}

int mbs_fmi_take(instance *c, void **state)
{
    if (!*state)
        *state = malloc(mbs_fmi_count_bytes());
    if (!*state)
        return mbs_fmi_fail(c, "there is no memory for a state");
    save(c, *state);
    return 0;
}

int mbs_fmi_write(instance *c, const void *state, unsigned char bytes[], size_t size)
{
    if (size != mbs_fmi_count_bytes())
        return mbs_fmi_fail(c, "the size of the state is another");
    memcpy(bytes, state, size);
    return 0;
}

int mbs_fmi_read(instance *c, const unsigned char bytes[], size_t size, void **state)
{
    if (size != mbs_fmi_count_bytes())
        return mbs_fmi_fail(c, "the size of the state is another");
    if (!*state)
        *state = malloc(size);
    if (!*state)
        return mbs_fmi_fail(c, "there is no memory for a state");
    memcpy(*state, bytes, size);
    return 0;
}

void mbs_fmi_drop(void **state)
{
    free(*state);
    *state = NULL;
}
