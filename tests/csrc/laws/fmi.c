/* FMI units: values by reference, derivatives, steps, saved states; all figures are of closed forms. */
#include "fmi.h"

#include "../../../csrc/fmi/mbs_fmi.c"

#undef malloc

enum { T, AT_X, AT_XD, BY_X, BY_XD, GIVEN_U, GIVEN_Y, GIVEN_YD, GIVEN_YDD, PUT_OUT, GIVEN_K, LONGEST, BEYOND };

static char said[200];
static int complaints;

static void hear(instance *c, const char *message)
{
    (void)c;
    ++complaints;
    snprintf(said, sizeof said, "%s", message);
}

static int hears(const char *message)
{
    const int is_so = complaints == 1 && !strncmp(said, message, strlen(message));
    complaints = 0;
    return is_so;
}

static instance begin(const mbs_fmi_mechanism *model)
{
    instance c;
    memset(&c, 0, sizeof c);
    c.report = hear;
    present = model;
    last = widest = 1e9, setups = evaluations = complaints = 0;
    LAW("an instance opens by its token", mbs_fmi_open(&c, model->token) == 0 && complaints == 0);
    return c;
}

static double get(instance *c, mbs_fmi_reference r)
{
    double value = NAN;
    return mbs_fmi_get(c, &r, 1, &value) ? NAN : value;
}

static int set(instance *c, mbs_fmi_reference r, double value)
{
    return mbs_fmi_set(c, &r, 1, &value);
}

static void open_and_close(void)
{
    instance c = {hear, 0, 0, 0, 0, NULL, NULL};
    present = &guided;
    LAW("another token is refused", mbs_fmi_open(&c, "guide") == 1 && hears("the token is not this model's"));
    LAW("and none", mbs_fmi_open(&c, NULL) == 1 && hears("the token"));
    for (left = 0; left < 2; ++left) {
        const long before = left;
        LAW("so is a machine without memory", mbs_fmi_open(&c, "guided") == 1 && hears("there is no memory"));
        left = before;
    }
    left = -1;
    c = begin(&guided);
    LAW("the first step is the model's", c.step == 0.1 && c.time == 0);
    set(&c, AT_X, 9), set(&c, LONGEST, 0.3), mbs_fmi_set_time(&c, 4);
    LAW("numbers change", get(&c, AT_X) == 9 && get(&c, LONGEST) == 0.3 && get(&c, T) == 4 && get(&c, BY_X) == -1);
    mbs_fmi_begin(&c);
    LAW("and begin again", get(&c, AT_X) == 0.5 && get(&c, LONGEST) == 0.1 && get(&c, T) == 0 && c.numbers[CLOCK] == 0);
    LAW("what depends on them is computed again", same(get(&c, BY_XD), 12.25) && setups == 2 && evaluations == 2);
    mbs_fmi_close(&c);
}

static void read_and_write(void)
{
    instance c = begin(&guided);
    const mbs_fmi_reference some[] = {PUT_OUT, T, AT_XD}, bad[] = {AT_X, BEYOND};
    const double two[] = {1, 2};
    double found[3];
    LAW("states, inputs, parameters are the numbers", get(&c, AT_X) == 0.5 && get(&c, AT_XD) == -1 && get(&c, GIVEN_U) == 3
        && get(&c, GIVEN_Y) == 0.25 && get(&c, GIVEN_YD) == 2 && get(&c, GIVEN_YDD) == 4 && get(&c, GIVEN_K) == 1.5);
    LAW("and take no evaluation", evaluations == 0 && setups == 0);
    LAW("rates are velocities", get(&c, BY_X) == -1);
    LAW("and accelerations", same(get(&c, BY_XD), -3 * 0.5 + 3 + 0.75 + 10));
    LAW("several are read at once", mbs_fmi_get(&c, some, 3, found) == 0 && found[0] == 3 && found[1] == 0 && found[2] == -1);
    LAW("all by one evaluation", evaluations == 1 && setups == 1);
    LAW("a new input is seen", set(&c, GIVEN_U, 4) == 0 && same(get(&c, BY_XD), 13.25) && evaluations == 2 && setups == 1);
    LAW("so is a parameter", set(&c, GIVEN_K, 0.5) == 0 && same(get(&c, BY_XD), 14.25) && setups == 2);
    LAW("the first input changes no set-up", set(&c, GIVEN_YDD, 4) == 0 && get(&c, PUT_OUT) == 3 && setups == 2);
    mbs_fmi_set_time(&c, 2);
    LAW("forces read the time", same(get(&c, BY_XD), 16.25) && get(&c, T) == 2);
    LAW("the step is a number too", set(&c, LONGEST, 0.25) == 0 && get(&c, LONGEST) == 0.25);
    LAW("that is positive", set(&c, LONGEST, 0) == 1 && hears("the variable of this value reference cannot be set"));
    LAW("values are finite", set(&c, AT_X, NAN) == 1 && hears("a value is not finite") && set(&c, AT_X, INFINITY) == 1);
    complaints = 0;
    LAW("computed ones cannot be set", set(&c, BY_X, 1) && set(&c, BY_XD, 1) && set(&c, PUT_OUT, 1) && complaints == 3);
    LAW("nor the time", set(&c, T, 1) == 1 && complaints == 4);
    complaints = 0;
    LAW("nor what is not there", mbs_fmi_set(&c, bad, 2, two) == 1 && hears("the variable"));
    LAW("which cannot be read", mbs_fmi_get(&c, bad, 2, found) == 1 && hears("there is no variable"));
    LAW("parameters may admit nothing", set(&c, GIVEN_K, -1) == 0 && mbs_fmi_get(&c, some, 1, found) == 1
        && hears("the parameters admit no mechanism"));
    LAW("as long as they stand", isnan(get(&c, BY_X)) && hears("the parameters"));
    set(&c, GIVEN_K, 1), set(&c, AT_X, 77);
    LAW("outputs may fail", isnan(get(&c, PUT_OUT)) && hears("rates or outputs cannot be computed"));
    set(&c, AT_X, 1), last = 1;
    LAW("accelerations too", isnan(get(&c, BY_XD)) && hears("the accelerations cannot be computed at joint 7, at time 2"));
    mbs_fmi_close(&c);
}

static void give_states(void)
{
    instance c = begin(&guided);
    const double new[] = {2, -3};
    double found[3] = {0};
    LAW("the states are counted", mbs_fmi_count_states() == 2);
    LAW("and read", mbs_fmi_get_states(&c, found, 2) == 0 && found[0] == 0.5 && found[1] == -1);
    LAW("and their rates", mbs_fmi_get_rates(&c, found, 2) == 0 && found[0] == -1 && same(found[1], 12.25));
    LAW("and set", mbs_fmi_set_states(&c, new, 2) == 0 && get(&c, AT_X) == 2 && get(&c, AT_XD) == -3);
    LAW("rates are of the new ones", mbs_fmi_get_rates(&c, found, 2) == 0 && found[0] == -3 && same(found[1], 7.75));
    LAW("all of them", mbs_fmi_get_states(&c, found, 1) == 1 && hears("the number of states is another"));
    LAW("not more", mbs_fmi_set_states(&c, found, 3) == 1 && mbs_fmi_get_rates(&c, found, 3) == 1 && complaints == 2);
    last = -1, complaints = 0;
    mbs_fmi_set_time(&c, 0);
    LAW("without accelerations there are no rates", mbs_fmi_get_rates(&c, found, 2) == 1 && hears("the accelerations"));
    mbs_fmi_close(&c);
}

static void differentiate(void)
{
    static const double exact[3][5] = {{0, 1, 0, 0, 0}, {-3, 0, 1, 3, 5}, {1, 0, 0, 10, 0}};
    static const mbs_fmi_reference unknowns[] = {PUT_OUT, BY_X, BY_XD}, knowns[] = {GIVEN_YD, AT_X, GIVEN_U, GIVEN_Y, AT_XD};
    static const int rows[] = {2, 0, 1}, columns[] = {4, 0, 2, 3, 1};
    instance c = begin(&guided);
    double seed[5], found[5];
    int i, j, k;
    for (k = 0; k < 5; ++k) {
        for (j = 0; j < 5; ++j)
            seed[j] = j == k ? 2 : 0;
        LAW("derivatives are known", mbs_fmi_differentiate(&c, unknowns, 3, knowns, 5, seed, found, 0) == 0);
        for (i = 0; i < 3; ++i)
            LAW("by each known", same(found[i], 2 * exact[rows[i]][columns[k]]));
    }
    for (i = 0; i < 3; ++i) {
        for (j = 0; j < 3; ++j)
            seed[j] = j == i ? -1 : 0;
        LAW("adjoints too", mbs_fmi_differentiate(&c, unknowns, 3, knowns, 5, seed, found, 1) == 0);
        for (k = 0; k < 5; ++k)
            LAW("of each unknown", same(found[k], -exact[rows[i]][columns[k]]));
    }
    for (j = 0; j < 5; ++j)
        seed[j] = j + 1;
    mbs_fmi_differentiate(&c, unknowns + 2, 1, knowns, 5, seed, found, 0);
    LAW("products are summed", same(found[0], 5 * 1 - 3 * 2 + 1 * 3 + 3 * 4));
    mbs_fmi_differentiate(&c, knowns, 5, knowns, 5, seed, found, 0);
    for (j = 0; j < 5; ++j)
        LAW("a known is an output too, by itself", found[j] == j + 1);
    LAW("parameters are no unknowns", mbs_fmi_differentiate(&c, (mbs_fmi_reference[]){GIVEN_K}, 1, knowns, 5, seed, found, 0) == 1
        && hears("derivatives are known of"));
    LAW("nor knowns", mbs_fmi_differentiate(&c, unknowns, 3, (mbs_fmi_reference[]){PUT_OUT}, 1, seed, found, 0) == 1
        && hears("derivatives are known by"));
    LAW("nor rates", mbs_fmi_differentiate(&c, unknowns, 3, (mbs_fmi_reference[]){BY_X}, 1, seed, found, 0) == 1);
    complaints = 0;
    LAW("nor is the time", mbs_fmi_differentiate(&c, unknowns, 3, (mbs_fmi_reference[]){T}, 1, seed, found, 0) == 1);
    complaints = 0;
    for (k = 78; k < 80; ++k) {
        set(&c, AT_X, k);
        LAW("each part may fail", mbs_fmi_differentiate(&c, unknowns, 3, knowns, 5, seed, found, 0) == 1
            && hears("the derivatives cannot be computed"));
    }
    set(&c, GIVEN_K, -1), set(&c, AT_X, 1);
    LAW("so may the set-up", mbs_fmi_differentiate(&c, unknowns, 3, knowns, 5, seed, found, 0) == 1 && hears("the parameters"));
    mbs_fmi_close(&c);
}

/* Without a spring, the acceleration is of second order in time, and the method of Runge and Kutta is exact:
 * y = 1/4 + 2 t + 2 t^2, y' = 2 + 4 t, x'' = 3 + 3 y + 5 y' + t = 13.75 + 27 t + 6 t^2. */
static void step_exactly(void)
{
    static const double sizes[] = {0.3, 0.35, 0.05, 0};
    static const int counts[] = {3, 4, 1, 0};
    int k;
    for (k = 0; k < 4; ++k) {
        const double t = sizes[k];
        instance c = begin(&guided);
        set(&c, GIVEN_K, 0);
        LAW("a step is taken", mbs_fmi_advance(&c, 0, t) == 0 && complaints == 0);
        LAW("to its end", same(get(&c, T), t) && c.numbers[CLOCK] == c.time);
        LAW("as the velocity goes", same(get(&c, AT_XD), -1 + t * (13.75 + t * (13.5 + 2 * t))));
        LAW("and the coordinate", same(get(&c, AT_X), 0.5 + t * (-1 + t * (13.75 / 2 + t * (4.5 + t / 2)))));
        LAW("driven joints go on", same(get(&c, GIVEN_Y), 0.25 + t * (2 + 2 * t)) && same(get(&c, GIVEN_YD), 2 + 4 * t));
        LAW("in as few steps as are allowed", evaluations == 4 * counts[k] + 1);
        mbs_fmi_close(&c);
    }
}

/* x'' = -2 x: a step multiplies (x, x') by the first five terms of the exponential. */
static void step_a_spring(void)
{
    const double h = 0.1, a = 2 * h * h, stays = 1 - a / 2 + a * a / 24, turns = 1 - a / 6;
    instance c = begin(&guided);
    set(&c, GIVEN_K, 1), set(&c, GIVEN_U, -7), set(&c, GIVEN_Y, 0), set(&c, GIVEN_YD, 0), set(&c, GIVEN_YDD, 0);
    mbs_fmi_advance(&c, 7, 0);
    LAW("no time passes in a step of no length", get(&c, AT_X) == 0.5 && get(&c, T) == 7 && same(get(&c, BY_XD), -1));
    present = &(const mbs_fmi_mechanism){
        "still", 2, 2, 2, 4, 1, 1, 1, SIZE, RATES, K, CLOSED, -1, moving, given, start, 8, 0.1,
        prepare, NULL, accelerate, put_out, NULL, NULL, NULL, 0, first, 2, slopes, 7, row, column, place};
    c.numbers[CLOCK] = 7; /* which no time moves */
    LAW("a spring's step", mbs_fmi_advance(&c, 3, h) == 0 && same(get(&c, AT_X), 0.5 * stays - h * turns));
    LAW("and its velocity", same(get(&c, AT_XD), -stays - 2 * h * 0.5 * turns) && c.numbers[CLOCK] == 7 && c.time == 3 + h);
    LAW("the rates are of its end", same(get(&c, BY_XD), -2 * get(&c, AT_X)) && get(&c, BY_X) == get(&c, AT_XD));
    mbs_fmi_close(&c);
}

/* Two joints that are driven are all that moves. */
static void guide_all(void)
{
    static const int given_both[] = {X, Y, XD, YD, U, YDD};
    const mbs_fmi_mechanism both = {
        "both", 2, 2, 0, 6, 2, 1, 0, SIZE, RATES, K, CLOSED, -1, moving, given_both, start, 8, 0.1,
        prepare, NULL, rest, NULL, NULL, NULL, NULL, 0, first, 0, slopes, 0, row, column, place};
    const double t = 0.3;
    instance c = begin(&both);
    LAW("all are driven", mbs_fmi_advance(&c, 0, t) == 0 && same(c.numbers[X], 0.5 + t * (-1 + 1.5 * t)));
    LAW("each by its own", same(c.numbers[Y], 0.25 + t * (2 + 2 * t)) && same(c.numbers[XD], -1 + 3 * t)
        && same(c.numbers[YD], 2 + 4 * t));
    mbs_fmi_close(&c);
}

static void fail_to_step(void)
{
    instance c = begin(&guided);
    LAW("time goes on", mbs_fmi_advance(&c, 0, -0.1) == 1 && hears("the communication step is negative, or holds too many"));
    LAW("by numbers", mbs_fmi_advance(&c, 0, NAN) == 1 && hears("the communication step"));
    LAW("not too many", mbs_fmi_advance(&c, 0, 1e9) == 1 && hears("the communication step"));
    set(&c, GIVEN_K, 0), last = 1.25;
    LAW("a step may fail on its way", mbs_fmi_advance(&c, 1, 0.4) == 1 && hears("the accelerations cannot be computed"));
    LAW("and ends after the last good one", same(get(&c, T), 1.2) && c.numbers[CLOCK] == c.time);
    LAW("with the states of that time", same(get(&c, AT_XD), -1 + 0.2 * (14.75 + 0.2 * (13.5 + 0.4)))
        && same(get(&c, AT_X), 0.5 + 0.2 * (-1 + 0.2 * (14.75 / 2 + 0.2 * (4.5 + 0.1)))));
    LAW("and driven joints", same(get(&c, GIVEN_Y), 0.25 + 0.2 * 2.4) && same(get(&c, GIVEN_YD), 2.8));
    last = 1e9;
    LAW("the rates are of that time", same(get(&c, BY_XD), 3 + 3 * 0.73 + 14 + 1.2));
    mbs_fmi_close(&c);
    c = begin(&guided);
    set(&c, GIVEN_U, 1e308), set(&c, LONGEST, 100);
    LAW("numbers may overflow", mbs_fmi_advance(&c, 0, 100) == 1 && hears("the motion diverges"));
    LAW("the states are then the last good ones", get(&c, AT_X) == 0.5 && get(&c, AT_XD) == -1 && get(&c, T) == 0);
    mbs_fmi_close(&c);
    c = begin(&guided);
    last = 0.3;
    LAW("rates are known at the end", mbs_fmi_advance(&c, 0, 0.3) == 0 && mbs_fmi_advance(&c, 0.5, 0) == 1);
    mbs_fmi_close(&c);
}

static int stands(instance *c, double x, double y, double xd, double yd)
{
    return same(c->numbers[X], x) && same(c->numbers[Y], y) && same(c->numbers[XD], xd) && same(c->numbers[YD], yd);
}

static void keep_loops(void)
{
    instance c = begin(&looped);
    LAW("loops are closed at the start", mbs_fmi_initialise(&c) == 0 && stands(&c, 0.5, 1, -1, -2) && setups == 1);
    LAW("by which all is known", evaluations == 1 && c.numbers[RATES + Y] == -2);
    LAW("closed loops have not drifted", mbs_fmi_has_drifted(&c) == 0);
    c.numbers[Y] = 1 + 1e-10;
    LAW("nor by a few digits", mbs_fmi_has_drifted(&c) == 0);
    c.numbers[Y] = 1 + 1e-7;
    LAW("but by more", mbs_fmi_has_drifted(&c) == 1);
    c.numbers[Y] = 1, c.numbers[YD] = -2 + 1e-7;
    LAW("the velocities too", mbs_fmi_has_drifted(&c) == 1);
    c.numbers[X] = 1e6, c.numbers[Y] = 2e6 + 2e-3, c.numbers[YD] = -2;
    LAW("relative to large numbers", mbs_fmi_has_drifted(&c) == 0);
    c.numbers[Y] = NAN;
    LAW("what is no number has drifted", mbs_fmi_has_drifted(&c) == 1);
    c.numbers[X] = 1, c.numbers[Y] = 1, c.numbers[XD] = 0, c.numbers[YD] = 5;
    LAW("the next point is found", mbs_fmi_project(&c) == 0 && stands(&c, 0.6, 1.2, 2, 4) && c.is_known == 0);
    LAW("each step ends on the loop", mbs_fmi_advance(&c, 0, 0.2) == 0 && stands(&c, 1, 2, 2, 4));
    widest = 0.5;
    LAW("a loop that cannot be closed has drifted", mbs_fmi_has_drifted(&c) == 1 && complaints == 0);
    LAW("and is reported", mbs_fmi_project(&c) == 1 && hears("the loops cannot be closed, at time 0.2"));
    LAW("at the start", mbs_fmi_initialise(&c) == 1 && hears("the loops cannot be closed"));
    widest = 1;
    LAW("and its velocities", mbs_fmi_initialise(&c) == 1 && hears("the loops cannot be closed"));
    widest = 1.3;
    LAW("steps fail with it", mbs_fmi_advance(&c, 0, 0.1) == 0 && mbs_fmi_advance(&c, 0.1, 0.1) == 1);
    complaints = 0;
    set(&c, 5 + 4, 1); /* the parameter follows the time, four states and four rates */
    LAW("parameters are set up for it", mbs_fmi_has_drifted(&c) == 0 && setups == 2);
    set(&c, 5 + 4, -1);
    LAW("which may fail", mbs_fmi_initialise(&c) == 1 && mbs_fmi_project(&c) == 1 && complaints == 2);
    LAW("and is seen later", mbs_fmi_has_drifted(&c) == 0);
    mbs_fmi_close(&c);
    c = begin(&guided);
    LAW("open chains do not drift", mbs_fmi_has_drifted(&c) == 0 && mbs_fmi_project(&c) == 0 && setups == 0);
    LAW("and start as they stand", mbs_fmi_initialise(&c) == 0 && stands(&c, 0.5, 0.25, -1, 2) && evaluations == 1);
    mbs_fmi_close(&c);
    c = begin(&led);
    LAW("driven joints lead the others at once", mbs_fmi_advance(&c, 0, 0) == 0 && stands(&c, 0.125, 0.25, 1, 2));
    LAW("and at each step", mbs_fmi_advance(&c, 0, 0.1) == 0 && stands(&c, 0.235, 0.47, 1.2, 2.4));
    widest = 0.4;
    LAW("where the loop closes", mbs_fmi_advance(&c, 0.1, 0.1) == 1 && hears("the loops cannot be closed, at time 0.1"));
    mbs_fmi_close(&c);
}

static void save_and_restore(void)
{
    instance c = begin(&guided);
    const size_t size = mbs_fmi_count_bytes();
    unsigned char bytes[16 + sizeof(mbs_real) * SIZE];
    void *state = NULL, *other = NULL;
    LAW("the time, the step and the numbers are saved", size == sizeof bytes);
    set(&c, LONGEST, 0.2), mbs_fmi_set_time(&c, 3), get(&c, BY_XD);
    LAW("to new memory", mbs_fmi_take(&c, &state) == 0 && state);
    set(&c, LONGEST, 0.4), set(&c, AT_X, 8), set(&c, GIVEN_K, 9), mbs_fmi_set_time(&c, 4);
    LAW("a state has bytes", mbs_fmi_write(&c, state, bytes, size) == 0);
    mbs_fmi_restore(&c, state);
    LAW("and is taken up again", get(&c, LONGEST) == 0.2 && get(&c, T) == 3 && get(&c, AT_X) == 0.5 && get(&c, GIVEN_K) == 1.5);
    LAW("what depends on it is computed", setups == 1 && same(get(&c, BY_XD), 15.25) && setups == 2 && evaluations == 2);
    LAW("bytes are read", mbs_fmi_read(&c, bytes, size, &other) == 0 && other && !memcmp(other, state, size));
    bytes[0] ^= 1;
    LAW("to old memory too", mbs_fmi_read(&c, bytes, size, &other) == 0 && memcmp(other, state, size));
    LAW("so is a state saved", mbs_fmi_take(&c, &other) == 0 && !memcmp(other, state, 2 * sizeof(double)));
    LAW("of their number", mbs_fmi_write(&c, state, bytes, size - 1) == 1 && hears("the size of the state is another"));
    LAW("alone", mbs_fmi_read(&c, bytes, size + 1, &other) == 1 && hears("the size of the state is another"));
    mbs_fmi_drop(&state), mbs_fmi_drop(&other);
    LAW("it is freed", !state && !other);
    left = 0;
    LAW("memory may lack", mbs_fmi_take(&c, &state) == 1 && hears("there is no memory for a state"));
    LAW("also for bytes", mbs_fmi_read(&c, bytes, size, &state) == 1 && hears("there is no memory for a state"));
    left = -1;
    mbs_fmi_close(&c);
}

int main(void)
{
    open_and_close();
    read_and_write();
    give_states();
    differentiate();
    step_exactly();
    step_a_spring();
    guide_all();
    fail_to_step();
    keep_loops();
    save_and_restore();
    return broken > 0;
}
