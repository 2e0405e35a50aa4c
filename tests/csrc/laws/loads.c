/* Loads of joints N = sum |c + D N|: by hand where all forces lie along one axis, and in a plane. */
#include "laws.h"

#include "../../../csrc/mbs_least.c"
#include "../../../csrc/mbs_loads.h"

#define BEARINGS 4

static casadi_real reals[256];
static casadi_int integers[8];
static const casadi_int owner[BEARINGS] = {0, 2, 2, 3};
static mbs_loads loads;

/* Begin with joints 0, 2 and 3 of four, of which joint 2 has two bearings. */
static mbs_load_room begin(casadi_int d)
{
    mbs_load_room room;
    memset(&loads, 0, sizeof loads);
    loads.bearings = BEARINGS, loads.owner = owner;
    LAW("there is room", mbs_loads_reals(&loads, 4) <= 256);
    memset(reals, 0, sizeof reals);
    room = mbs_open_loads(&loads, 4, reals, integers);
    room.d = d, room.sliding[0] = 0, room.sliding[1] = 2, room.sliding[2] = 3;
    return room;
}

/* With c = N - S N along one axis, and D = S along it, the loads are N; joint 2 has two equal bearings. */
static void along_an_axis(casadi_real part)
{
    static const casadi_real S[9] = {0.2, 0.3, 0.1, 0.3, 0.1, 0.2, 0.1, 0.3, 0.3}, N[3] = {5, 6, 4};
    static const casadi_int joint[BEARINGS] = {0, 1, 1, 2};
    mbs_load_room room = begin(3);
    casadi_int k, j;
    for (k = 0; k < BEARINGS; ++k) {
        const casadi_real share = k == 1 || k == 2 ? 0.5 : 1;
        casadi_real own = N[joint[k]];
        for (j = 0; j < 3; ++j) {
            own -= part * S[3 * joint[k] + j] * N[j];
            room.D[3 * BEARINGS * j + 3 * k + 1] = share * part * S[3 * joint[k] + j];
        }
        room.c[3 * k + 1] = share * own;
    }
    LAW("loads are found", mbs_find_loads(&loads, &room) == 0);
    for (j = 0; j < 3; ++j)
        LAW("they are the ones by hand", fabs(room.N[j] - N[j]) < 1e-13);
}

/* N = |(3, 4 N/5)| has the solution 5; N = |(3, N)| has none. */
static void across(void)
{
    mbs_load_room room = begin(1);
    room.c[0] = 3, room.D[1] = 0.8;
    LAW("a force across the other is found", mbs_find_loads(&loads, &room) == 0 && fabs(room.N[0] - 5) < 1e-14);
    room.D[1] = 1;
    LAW("a load that grows as itself is not", mbs_find_loads(&loads, &room) == MBS_LOADED);
    room.D[1] = -1.5;
    LAW("nor one that grows faster, either way", mbs_find_loads(&loads, &room) == MBS_LOADED);
    room.c[0] = 0;
    LAW("without a force there is no load", mbs_find_loads(&loads, &room) == 0 && room.N[0] == 0);
}

/* Two loads of which each depends on the other by 1.2 alone, and on itself not: the radius of S is 1.2, or 1.2 of one. */
static void radius(void)
{
    mbs_load_room room = begin(2);
    room.c[0] = 1, room.c[3] = 1;
    room.D[3] = 1.2, room.D[3 * BEARINGS] = 1.2;
    LAW("loads that grow in a circle are not known", mbs_find_loads(&loads, &room) == MBS_LOADED);
    room.D[3 * BEARINGS] = 0.5; /* N0 = 1 + N1/2, N1 = 1 + 1.2 N0 */
    LAW("where the circle shrinks, they are", mbs_find_loads(&loads, &room) == 0);
    LAW("by both equations", fabs(room.N[0] - 3.75) < 1e-14 && fabs(room.N[1] - 5.5) < 1e-14);
    room.c[0] = NAN;
    LAW("numbers that are none have no loads", mbs_find_loads(&loads, &room) == MBS_LOADED);
}

/* A force along x of a joint that is turned by a quarter about z is one along -y of its frame, of which the bearing's share
 * is doubled; a moment about z counts by a third of it along x. */
static void bearing(void)
{
    static const casadi_int frame[1] = {1}, six[6] = {0, 1, 2, 3, 4, 5}, nine[9] = {3, 4, 5, 9, 10, 11, 15, 16, 17};
    static const casadi_real turn[9] = {0, -1, 0, 1, 0, 0, 0, 0, 1}, force[6] = {0, 7, 0, 0, 0, 0}, moment[6] = {0, 0, 0, 0, 0, 9};
    static const casadi_real by_force[9] = {2, 0, 0, 0, 2, 0, 0, 0, 2}, by_moment[9] = {0, 0, 1.0 / 3, 0, 0, 0, 0, 0, 0};
    mbs_load_room room;
    casadi_real found[3];
    memset(&loads, 0, sizeof loads);
    loads.bearings = 1, loads.joints = 2, loads.axes = 6, loads.owner = owner, loads.frame = frame;
    loads.by_force = by_force, loads.by_moment = by_moment;
    loads.force.nonzeros = force, loads.moment.nonzeros = moment, loads.turn.nonzeros = turn;
    loads.force.entries = loads.moment.entries = 6, loads.turn.entries = 9;
    loads.force.place = loads.moment.place = six, loads.turn.place = nine;
    room = mbs_open_loads(&loads, 1, reals, integers);
    mbs_fill_entries(loads.turn, 18, room.turn);
    mbs_bear(&loads, &room, found);
    LAW("forces are turned into the joint's frame", fabs(found[0] - 3) < 1e-14 && fabs(found[1] + 14) < 1e-14 && found[2] == 0);
}

int main(void)
{
    along_an_axis(1), along_an_axis((casadi_real)1.5);
    across(), radius(), bearing();
    return broken > 0;
}
