/* Friction by the load of joints in accelerations and guards: of two joints with one bearing each, by hand. */
#include "laws.h"

#include <math.h>
#include <stdlib.h>

#include "../../../csrc/mbs_explicit.c"
#include "../../../csrc/mbs_least.c"

/* M = (2, 1; 1, 3), and forces that push. The bearing of joint 0 carries 10 + 0.3 a0 + 0.2 a1 along y, the one of joint 1
 * carries 7 + 0.1 a0 - 0.4 a1 along x and 3 along z, at the accelerations a. */
static casadi_real q[2], qd[2], *rest, left[2], push[2], values[4], force[3], moment[1], *room;
static casadi_real sign[2], torque[2], fading[2], slowness[2], coefficient[2], fall[2], hold[2], side[2], level[2];
static const casadi_real mass[4] = {2, 1, 1, 3};
static const casadi_int every[4] = {0, 1, 2, 3}, lines[3] = {2, 1, 5}, owner[2] = {0, 1}, columns[2] = {0, 1};
static casadi_real units[18], nothing[18];
static casadi_int *numbers, held[2], kind[2], joint[2], fired[2];
static const casadi_real A[1] = {0}, b[1] = {1}, c[1] = {0};
static mbs_explicit plant;
static mbs_modes modes;
static mbs_loads loads;
static mbs_manner manner;
static mbs_outcome outcome;
static int poses, reactions, failing; /* calls, and which call of reactions fails: -1, the one of poses */

#define KERNEL(name) \
    static int name(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int memory)

KERNEL(find_residual)
{
    int i;
    (void)arg, (void)res, (void)iw, (void)w, (void)memory;
    for (i = 0; i < 2; ++i)
        left[i] = mass[2 * i] * rest[0] + mass[2 * i + 1] * rest[1] - push[i];
    return 0;
}

KERNEL(find_mass)
{
    (void)arg, (void)res, (void)iw, (void)w, (void)memory;
    return 0;
}

KERNEL(find_poses)
{
    (void)arg, (void)res, (void)iw, (void)w, (void)memory;
    ++poses;
    return failing < 0 ? 5 : 0;
}

KERNEL(find_reactions)
{
    (void)arg, (void)res, (void)iw, (void)w, (void)memory;
    force[0] = 10 + 0.3 * rest[0] + 0.2 * rest[1]; /* y of joint 0, x and z of joint 1 */
    force[1] = 7 + 0.1 * rest[0] - 0.4 * rest[1];
    force[2] = 3;
    return ++reactions == failing ? 9 : 0;
}

/* All frames have the axes of the base, and the bearing of joint 1 counts by half of its force. */
static mbs_run open_here(void)
{
    static const casadi_int turns[6] = {0, 7, 14, 3, 10, 17};
    static const casadi_real ones[6] = {1, 1, 1, 1, 1, 1};
    int i;
    memset(&plant, 0, sizeof plant), memset(&modes, 0, sizeof modes), memset(&loads, 0, sizeof loads);
    memset(&manner, 0, sizeof manner), memset(units, 0, sizeof units);
    free(rest), rest = calloc(2, sizeof *rest);
    for (i = 0; i < 2; ++i) {
        q[i] = qd[i] = push[i] = sign[i] = torque[i] = fading[i] = slowness[i] = coefficient[i] = fall[i] = hold[i] = 0;
        held[i] = 0, side[i] = 1, level[i] = 0, kind[i] = MBS_FORCE, joint[i] = i;
    }
    for (i = 0; i < 9; i += 4)
        units[i] = 1, units[9 + i] = 0.5;
    poses = reactions = failing = 0;
    plant.n = plant.nq = 2, plant.q = q, plant.qd = qd, plant.rest = rest, plant.r = left, plant.modes = &modes;
    plant.M.nonzeros = mass, plant.M.entries = 4, plant.M.place = every;
    plant.residual.f = find_residual, plant.mass.f = find_mass;
    modes.held = held, modes.sign = sign, modes.torque = torque, modes.fall = fading, modes.slowness = slowness;
    modes.guards = 2, modes.kind = kind, modes.joint = joint, modes.place = joint, modes.side = side, modes.level = level;
    modes.fired = fired, modes.loads = &loads;
    loads.bearings = loads.joints = 2, loads.axes = 6, loads.owner = owner, loads.frame = columns;
    loads.by_force = units, loads.by_moment = nothing, loads.coefficient = coefficient, loads.fall = fall, loads.hold = hold;
    loads.force.nonzeros = force, loads.force.entries = 3, loads.force.place = lines;
    loads.moment.nonzeros = moment, loads.turn.nonzeros = ones, loads.turn.entries = 6, loads.turn.place = turns;
    loads.reactions.f = find_reactions, loads.poses.f = find_poses;
    manner.stages = 1, manner.order = 1, manner.A = A, manner.b = b, manner.c = c;
    free(room), room = calloc((size_t)mbs_explicit_reals(&plant, 1), sizeof *room);
    free(numbers), numbers = malloc((size_t)mbs_explicit_integers(&plant) * sizeof *numbers);
    for (i = 0; i < mbs_explicit_integers(&plant); ++i)
        numbers[i] = 1 << 24; /* nobody reads what nobody wrote */
    return open_run(&plant, &manner, room, numbers, &outcome);
}

/* M^-1 f */
static void accelerate_by(const casadi_real *f, casadi_real *a)
{
    a[0] = (3 * f[0] - f[1]) / 5, a[1] = (2 * f[1] - f[0]) / 5;
}

static int alike(casadi_real a, casadi_real x)
{
    return fabs(a - x) <= 1e-12 * (1 + fabs(x));
}

/* The first joint slides: a = M^-1 (push - friction N e0), N the force of its bearing at a. */
static void one(casadi_real way, casadi_real speed)
{
    const casadi_real state[4] = {0.5, 0.25, way * speed, 0};
    const casadi_real friction = 0.2 + 0.1 * exp(-speed * speed / 16);
    casadi_real f[2], a[2], *rate;
    mbs_run r = open_here();
    sign[0] = way, coefficient[0] = 0.2, fall[0] = 0.1, slowness[0] = 0.25, hold[0] = 1, push[0] = 4, push[1] = -2;
    LAW("integers have room, two for each joint and two for its load", mbs_explicit_integers(&plant) == 8);
    LAW("accelerations are found", evaluate(&r, 0, 0, state) == 0);
    rate = r.k + 2;
    f[0] = 4 - way * friction * (10 + 0.3 * rate[0] + 0.2 * rate[1]), f[1] = -2;
    accelerate_by(f, a);
    LAW("friction is by the load that there is with it", alike(rate[0], a[0]) && alike(rate[1], a[1]));
    LAW("by two forces of bearings", poses == 1 && reactions == 2);
    torque[0] = 3;
    LAW("other friction of the joint is added", evaluate(&r, 0, 0, state) == 0);
    f[0] = 4 - way * (3 + friction * (10 + 0.3 * rate[0] + 0.2 * rate[1]));
    accelerate_by(f, a);
    LAW("to it", alike(rate[0], a[0]) && alike(rate[1], a[1]));
    fall[0] = 0, torque[0] = 0;
    LAW("friction may be the same at all speeds", evaluate(&r, 0, 0, state) == 0);
    f[0] = 4 - way * 0.2 * (10 + 0.3 * rate[0] + 0.2 * rate[1]);
    accelerate_by(f, a);
    LAW("then", alike(rate[0], a[0]) && alike(rate[1], a[1]));
}

/* Both slide, and the load of the second has two components. */
static void both(void)
{
    const casadi_real state[4] = {0, 0, 2, -3};
    casadi_real f[2], a[2], *rate;
    mbs_run r = open_here();
    sign[0] = 1, sign[1] = -1, coefficient[0] = 0.3, coefficient[1] = 0.4, hold[0] = hold[1] = 1, push[0] = 50, push[1] = -20;
    LAW("two joints may slide", evaluate(&r, 0, 0, state) == 0);
    rate = r.k + 2;
    f[0] = 50 - 0.3 * fabs(10 + 0.3 * rate[0] + 0.2 * rate[1]);
    f[1] = -20 + 0.4 * sqrt(pow(7 + 0.1 * rate[0] - 0.4 * rate[1], 2) + 9) / 2;
    accelerate_by(f, a);
    LAW("each by its own load", alike(rate[0], a[0]) && alike(rate[1], a[1]));
    hold[0] = 0;
    LAW("loads count for joints that have friction by them", evaluate(&r, 0, 0, state) == 0);
    f[0] = 50, f[1] = -20 + 0.4 * sqrt(pow(7 + 0.1 * rate[0] - 0.4 * rate[1], 2) + 9) / 2;
    accelerate_by(f, a);
    LAW("alone", alike(rate[0], a[0]) && alike(rate[1], a[1]));
    sign[1] = 0, poses = reactions = 0;
    LAW("without any that slides there are no loads", evaluate(&r, 0, 0, state) == 0 && poses == 0 && reactions == 0);
    LAW("and forces alone accelerate", alike(rate[0], 34) && alike(rate[1], -18));
}

/* A held joint: the other one alone moves. */
static void resting(void)
{
    const casadi_real state[4] = {0, 0, 0, 1};
    casadi_real *rate;
    mbs_run r;
    open_here(), held[0] = 1;
    r = open_run(&plant, &manner, room, numbers, &outcome);
    sign[1] = 1, coefficient[1] = 0.4, hold[0] = hold[1] = 1, push[1] = 9;
    LAW("a mechanism with a held joint moves", evaluate(&r, 0, 0, state) == 0);
    rate = r.k + 2;
    LAW("by the others", rate[0] == 0 && alike(3 * rate[1], 9 - 0.4 * sqrt(pow(7 - 0.4 * rate[1], 2) + 9) / 2));
}

/* What holds a joint: the forces on it, and `hold` times its load. */
static void guards(void)
{
    const casadi_real rate[4] = {0, 0, 2, -1};
    mbs_run r = open_here();
    hold[0] = 0.5, push[0] = 4, side[0] = -1, level[0] = 3, kind[1] = MBS_SPEED, qd[1] = 6, hold[1] = 8;
    LAW("guards are evaluated", guard(&r, rate, values) == 0 && poses == 1 && reactions == 1);
    LAW("a held joint bears more by its load", alike(values[0], -(2 * 2 - 1 - 4 - 3) + 0.5 * (10 + 0.6 - 0.2)));
    LAW("other guards do not", values[1] == 6);
    hold[0] = 0;
    LAW("nor joints without such friction", guard(&r, rate, values) == 0 && alike(values[0], -(2 * 2 - 1 - 4 - 3)));
    failing = -1;
    LAW("poses may fail", guard(&r, rate, values) == 5);
    failing = reactions + 1;
    LAW("and reactions", guard(&r, rate, values) == 9);
}

static void failures(void)
{
    const casadi_real state[4] = {0, 0, 1, 1};
    mbs_run r = open_here();
    sign[0] = 1, coefficient[0] = 0.2, hold[0] = 1;
    failing = -1;
    LAW("poses may fail", evaluate(&r, 0, 0, state) == 5);
    failing = 1, reactions = 0;
    LAW("and reactions", evaluate(&r, 0, 0, state) == 9);
    failing = 2, reactions = 0;
    LAW("also of a load", evaluate(&r, 0, 0, state) == 9);
    failing = 0, coefficient[0] = 1e3;
    LAW("and friction that grows as its load has no motion", evaluate(&r, 0, 0, state) == MBS_LOADED);
}

int main(void)
{
    one(1, 2), one(-1, 3), one(1, 0);
    both(), resting(), guards(), failures();
    free(room), free(numbers), free(rest);
    return broken > 0;
}
