#include "laws.h"

#include <stdlib.h>

#include "../../../csrc/mbs_stepping.c"

/* --- a cone problem that is answered as a law wants ------------------------------------------------------------------ */

static casadi_real answers[16], answered; /* impulses, and their residual */
static int asked, gives_up;               /* how often; at which question it fails */
static enum { GIVEN, PUSHED } manner;     /* as in `answers`, or as stops push, each alone */

casadi_int mbs_cone_reals(casadi_int rows)
{
    return rows + 5;
}

casadi_int mbs_cone_integers(casadi_int rows)
{
    return rows + 3;
}

int mbs_cone_solve(const mbs_cone *p, casadi_real tolerance, casadi_real *P, mbs_cone_effort *effort,
                   casadi_real *reals, casadi_int *integers)
{
    casadi_int k;
    LAW("the tolerance is passed on", tolerance == 1e-9);
    for (k = 0; k < mbs_cone_reals(p->rows); ++k)
        reals[k] = NAN;
    for (k = 0; k < mbs_cone_integers(p->rows); ++k)
        integers[k] = -1;
    for (k = 0; k < p->rows; ++k)
        P[k] = manner == GIVEN ? answers[k] : fmax(0, -p->free[k] / p->W[k * (p->rows + 1)]);
    effort->residual = answered, effort->sweeps += 3, effort->steps += 5;
    return ++asked == gives_up;
}

/* --- solids that meet where a law wants ------------------------------------------------------------------------------ */

static mbs_spot met[2];

casadi_int mbs_solids_reals(const mbs_solid *first, const mbs_solid *other)
{
    return first->points + other->points;
}

casadi_int mbs_solids_meet(const mbs_solid *first, const casadi_real *place_first, const casadi_real *axes_first,
                           const mbs_solid *other, const casadi_real *place_other, const casadi_real *axes_other,
                           casadi_int most, mbs_spot *spots, casadi_real *reals)
{
    casadi_int k;
    LAW("each solid has its own pose", place_first[0] == 1 && axes_first[0] == 2 && place_other[0] == 3 && axes_other[0] == 4);
    LAW("a pair has room for its points", most == 2);
    for (k = 0; k < mbs_solids_reals(first, other); ++k)
        reals[k] = NAN;
    for (k = 0; k < most; ++k)
        spots[k] = met[k];
    return most;
}

/* --- a plant: Phi = M qdd + C qd + K q - push - v,
    and points whose velocities are `speeds` qd ------------------------ */

static casadi_real q[4], qd[3], qdd[3], v[2], Phi[3], clearance[2], direction[6], kinetic[1], potential[1], power[1];
static casadi_real mass[9], damping[9], stiffness[12], changes[12], speeds[18], push[3], height[2], restitution[2];
static casadi_real coefficient[2], added, noise, wrong, touched[4];
static const casadi_int every[18] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17}, places[3] = {0,
    1, 3};
static mbs_stop stops[2];
static mbs_brake brakes[2];
static mbs_stepping plant;
static mbs_stepping_record record;
static mbs_stepper s;
static casadi_real *reals;
static casadi_int *integers;
static int evaluated, fails;
enum { NONE, LINEARISED, RESIDUAL, TOUCHING, CHANGE, ENERGY_OF, WORK };

static int find_forces(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int memory)
{
    casadi_int i, k;
    (void)arg, (void)res;
    LAW("kernels have no memory", !iw && !w && !memory);
    ++evaluated;
    for (i = 0; i < plant.n; ++i) {
        Phi[i] = -push[i] + (evaluated % 2 ? noise : -noise) - (i < plant.m ? v[i] : 0);
        for (k = 0; k < plant.n; ++k)
            Phi[i] += mass[i * plant.n + k] * qdd[k] + damping[i * plant.n + k] * qd[k];
        for (k = 0; k < plant.group.nq; ++k)
            Phi[i] += stiffness[i * plant.group.nq + k] * q[k];
    }
    return fails == RESIDUAL ? 11 : 0;
}

static casadi_real inertia[9];

static int differentiate(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int memory)
{
    casadi_int k;
    for (k = 0; k < plant.n * plant.n; ++k)
        inertia[k] = wrong * mass[k];
    find_forces(arg, res, iw, w, memory);
    return fails == LINEARISED ? 12 : 0;
}

static int touch(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int memory)
{
    casadi_int k;
    (void)arg, (void)res;
    LAW("kernels have no memory", !iw && !w && !memory);
    for (k = 0; k < 4; ++k)
        touched[k] = q[k];
    for (k = 0; k < plant.points; ++k)
        clearance[k] = height[k];
    return fails == TOUCHING ? 13 : 0;
}

static int change(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int memory)
{
    (void)arg, (void)res;
    LAW("kernels have no memory", !iw && !w && !memory);
    return fails == CHANGE ? 14 : 0;
}

static int find_energy(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int memory)
{
    casadi_int i, k;
    (void)arg, (void)res;
    LAW("kernels have no memory", !iw && !w && !memory);
    kinetic[0] = 0, potential[0] = added;
    for (i = 0; i < plant.n; ++i) {
        potential[0] -= push[i] * q[i];
        for (k = 0; k < plant.n; ++k) {
            kinetic[0] += mass[i * plant.n + k] * qd[i] * qd[k] / 2;
            potential[0] += stiffness[i * plant.n + k] * q[i] * q[k] / 2;
        }
    }
    return fails == ENERGY_OF ? 15 : 0;
}

static int find_power(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int memory)
{
    casadi_int i, k;
    (void)arg, (void)res;
    LAW("kernels have no memory", !iw && !w && !memory);
    power[0] = 0;
    for (i = 0; i < plant.n; ++i) {
        power[0] += i < plant.m ? v[i] * qd[i] : 0;
        for (k = 0; k < plant.n; ++k)
            power[0] -= damping[i * plant.n + k] * qd[i] * qd[k];
    }
    return fails == WORK ? 16 : 0;
}

static void lay_entries(mbs_entries *to, const casadi_real *from, casadi_int count)
{
    to->nonzeros = from, to->entries = count, to->place = every;
}

/* Open a stepper in a room of exactly the numbers that are asked for. */
static void reopen(casadi_real h)
{
    const casadi_int room = mbs_stepping_reals(&plant);
    casadi_int k;
    free(reals), free(integers);
    reals = malloc((size_t)room * sizeof *reals);
    for (k = 0; k < room; ++k)
        reals[k] = NAN; /* nothing is read before it is written */
    integers = calloc((size_t)mbs_stepping_integers(&plant), sizeof *integers);
    s = open_stepper(&plant, h, reals, integers);
}

/* Begin anew with n free joints of unit mass. */
static void anew(casadi_int n, casadi_int points, casadi_int stop, casadi_int brake, casadi_real h)
{
    casadi_int k;
    memset(&plant, 0, sizeof plant), memset(&record, 0, sizeof record), memset(q, 0, sizeof q);
    memset(mass, 0, sizeof mass), memset(damping, 0, sizeof damping), memset(stiffness, 0, sizeof stiffness);
    memset(push, 0, sizeof push), memset(speeds, 0, sizeof speeds), memset(v, 0, sizeof v);
    memset(stops, 0, sizeof stops), memset(brakes, 0, sizeof brakes), memset(answers, 0, sizeof answers);
    for (k = 0; k < n; ++k)
        mass[k * (n + 1)] = 1;
    plant.n = n, plant.points = points, plant.stops = stop, plant.brakes = brake;
    plant.q = q, plant.qd = qd, plant.qdd = qdd, plant.v = v, plant.Phi = Phi, plant.clearance = clearance;
    plant.direction = direction, plant.kinetic = kinetic, plant.potential = potential, plant.power = power;
    lay_entries(&plant.K, stiffness, n * n), lay_entries(&plant.C, damping, n * n), lay_entries(&plant.M, inertia,
        n * n);
    lay_entries(&plant.J, speeds, 3 * points * n);
    plant.linearised.f = differentiate, plant.residual.f = find_forces, plant.energy.f = find_energy;
    plant.work.f = find_power, plant.touching.f = touch;
    plant.group.nq = plant.group.scalars = n, plant.group.place = plant.group.rate = every;
    plant.restitution = restitution, plant.coefficient = coefficient, plant.stop = stops, plant.brake = brakes;
    for (k = 0; k < 2; ++k) {
        restitution[k] = coefficient[k] = 0, height[k] = 1;
        direction[3 * k] = direction[3 * k + 1] = 0, direction[3 * k + 2] = 1;
    }
    asked = gives_up = evaluated = fails = NONE, added = noise = answered = 0, wrong = 1, manner = GIVEN;
    reopen(h);
}

static void set(casadi_int size, casadi_real *to, casadi_real a, casadi_real b, casadi_real c)
{
    const casadi_real from[3] = {a, b, c};
    casadi_int k;
    for (k = 0; k < size; ++k)
        to[k] = from[k];
}

static int same(casadi_real a, casadi_real b)
{
    return fabs(a - b) <= 1e-13 * fmax(fabs(a), fabs(b));
}

/* --- laws ------------------------------------------------------------------------------------------------------------ */

static char uses[2000];

static void use(const void *first, casadi_int size)
{
    casadi_int k;
    for (k = 0; k < size; ++k)
        ++uses[(const casadi_real *)first - reals + k];
}

static void rooms(void)
{
    casadi_int k, once = 1;
    anew(3, 2, 2, 1, 1);
    plant.group.nq = 4; /* 9 rows */
    LAW("a row holds two states, two losses and three components of each point",
        mbs_stepping_width(&plant) == 2 * 7 + 2 + 6);
    LAW("integers are by block, and of cone problems", mbs_stepping_integers(&plant) == 3 * 9 + 12);
    reopen(0.5);
    use(s.q0, 4), use(s.qm, 4), use(s.v0, 3), use(s.vm, 3), use(s.v1, 3), use(s.vf, 3), use(s.x, 3), use(s.r, 3);
    use(s.old, 3), use(s.diagonal, 3), use(s.A, 9), use(s.K, 12), use(s.N, 12), use(s.slide, 18), use(s.J, 27);
    use(s.B, 27), use(s.W, 81), use(s.free, 9), use(s.bias, 9), use(s.P, 9), use(s.grip, 9), use(s.cone, 14);
    use(s.moved, 9), use(s.normal, 6);
    for (k = 0; k < 2000; ++k)
        once &= uses[k] == (k < mbs_stepping_reals(&plant));
    LAW("arrays share no number, and leave none", once);
    LAW("nor integers", s.first == s.kind + 9 && s.owner == s.first + 9 && s.integers == s.owner + 9);
    LAW("a stepper begins with whole restitutions",
        s.factor == 1 && s.h == 0.5 && s.rows == 0 && s.blocks == 0 && s.reached == 0);
}

static void middles(void)
{
    anew(3, 0, 0, 0, 0.5);
    plant.group.nq = 4, plant.group.place = places, plant.m = 2;
    reopen(0.5);
    s.v = answers;
    answers[0] = 7, answers[1] = 8;
    set(3, s.q0, 1, 2, 3), s.q0[3] = 4;
    set(3, s.v0, 1, -2, 3), set(3, s.v1, 3, 4, -7);
    place(&s);
    LAW("the velocity of the middle is the mean", qd[0] == 2 && qd[1] == 1 && qd[2] == -2 && s.vm[2] == -2);
    LAW("accelerations are over the whole step", qdd[0] == 4 && qdd[1] == 12 && qdd[2] == -20);
    LAW("half a step leads to it", q[0] == 1.5 && q[1] == 2.25 && q[2] == 3 && q[3] == 3.5 && s.qm[3] == 3.5);
    LAW("with the inputs of the step", v[0] == 7 && v[1] == 8);
}

/* Whether A of a plant, once it is decomposed, solves A x = b for two right-hand sides. */
static int solves(const casadi_real *A)
{
    static const casadi_real x[6] = {1, -2, 3, 0.5, -1, 4};
    casadi_real b[6] = {0};
    casadi_int i, j, k;
    int is_right = 1;
    for (i = 0; i < 3; ++i)
        for (k = 0; k < 3; ++k)
            for (j = 0; j < 2; ++j)
                b[2 * i + j] += A[3 * i + k] * x[2 * k + j];
    solve(&s, 2, b);
    for (i = 0; i < 6; ++i)
        is_right &= fabs(b[i] - x[i]) < 1e-13;
    return is_right;
}

static void matrices(void)
{
    static const casadi_real full[9] = {4, 1, 5, -1, 3, 0.25, 0.5, -0.75, 5}, tree[9] = {4, 1, 0.5, -1, 3, 0, 0.5, 0,
        5};
    static const casadi_real upper[9] = {4, 0, 0, 0.5, 3, -1, 0, 2, 5}, lower[9] = {4, 0, 0.25, 0, 3, 0, 0, 2, 5};
    const casadi_real least = 3 * 1e3 * 2.220446049250313e-16;
    casadi_int k;
    anew(3, 0, 0, 0, 1);
    set(3, s.diagonal, 4, 3, 5);
    memcpy(s.A, full, sizeof full);
    LAW("a full matrix is decomposed", factorise(&s) == 0 && solves(full));
    memcpy(s.A, tree, sizeof tree);
    LAW("one of a tree too", factorise(&s) == 0 && solves(tree));
    LAW("without entries between branches", s.A[5] == 0 && s.A[7] == 0);
    memcpy(s.A, upper, sizeof upper);
    LAW("any entry may be missing", factorise(&s) == 0 && solves(upper));
    memcpy(s.A, lower, sizeof lower);
    LAW("or there", factorise(&s) == 0 && solves(lower));
    for (k = 0; k < 3; ++k) {
        memset(s.A, 0, 9 * sizeof *s.A);
        s.A[0] = s.A[4] = s.A[8] = 1, set(3, s.diagonal, 1, 1, 1);
        s.A[4 * k] = 2 * 1.01 * least, s.diagonal[k] = 2;
        LAW("a small pivot has digits", factorise(&s) == 0);
        s.A[4 * k] = 2 * 0.99 * least;
        LAW("a smaller one has lost them", factorise(&s) == MBS_SINGULAR);
        s.A[4 * k] = NAN;
        LAW("as one that is no number", factorise(&s) == MBS_SINGULAR);
    }
}

static void linearisations(void)
{
    static const casadi_real M[9] = {8, 1, 0, 1, 9, 2, 0, 2, 7}, C[9] = {3, 2, 0, 0, 4, -2, 6, 0, 0};
    static const casadi_real K[12] = {1, 0, 2, 3, 0, 5, 0, 1, 4, 0, -1, 0}, N[12] = {1, 0, 2, 0, 3, 0, 1, 1, 0, 0, 4,
        0};
    casadi_real A[9];
    casadi_int i, k, j;
    anew(3, 0, 0, 0, 0.5);
    set(3, s.q0, 0, 0, 0), set(3, s.v0, 0, 0, 0), set(3, s.v1, 0, 0, 0);
    memcpy(mass, M, sizeof M), memcpy(damping, C, sizeof C), memcpy(stiffness, K, 9 * sizeof *K);
    for (k = 0; k < 9; ++k)
        A[k] = M[k] + C[k] / 4 + K[k] / 16;
    stiffness[8] = 99, lay_entries(&plant.K, stiffness, 8), A[8] -= K[8] / 16;
    LAW("a matrix is made", linearise(&s, &record) == 0 && record.jacobians == 1 && record.kernel == 0);
    LAW("of masses, damping by half a step and stiffness by its square", solves(A));
    LAW("pivots are judged by masses", s.diagonal[0] == 8 && s.diagonal[1] == 9 && s.diagonal[2] == 7);
    plant.change.f = change, plant.group.nq = 4;
    reopen(0.5);
    set(3, s.q0, 0, 0, 0), s.q0[3] = 0, set(3, s.v0, 0, 0, 0), set(3, s.v1, 0, 0, 0);
    memcpy(stiffness, K, sizeof K), memcpy(changes, N, sizeof N);
    lay_entries(&plant.K, stiffness, 11), lay_entries(&plant.N, changes, 11); /* what is not there is 0 */
    for (i = 0; i < 3; ++i)
        for (j = 0; j < 3; ++j) {
            A[3 * i + j] = M[3 * i + j] + C[3 * i + j] / 4;
            for (k = 0; k < 4; ++k)
                A[3 * i + j] += K[4 * i + k] * N[3 * k + j] / 16;
        }
    LAW("stiffness is by rates of coordinates where these are not velocities",
        linearise(&s, &record) == 0 && solves(A));
    fails = CHANGE;
    LAW("a kernel that fails is named", linearise(&s, &record) == MBS_KERNEL && record.kernel == 14);
    fails = LINEARISED;
    LAW("each", linearise(&s, &record) == MBS_KERNEL && record.kernel == 12 && record.jacobians == 4);
    fails = NONE;
    set(3, Phi, 4, -2, 1), set(3, s.v1, 1, 2, 3);
    linearise(&s, &record);
    set(3, Phi, 4, -2, 1), s.old[0] = 5, s.x[0] = 6;
    release(&s);
    LAW("nothing else changes", s.old[0] == 5 && s.x[0] == 6);
    for (i = 0; i < 3; ++i) {
        casadi_real sum = 0.5 * Phi[i];
        for (k = 0; k < 3; ++k)
            sum += A[3 * i + k] * (s.vf[k] - s.v1[k]);
        LAW("velocities without impulses leave no forces", fabs(sum) < 1e-13);
    }
}

static void directions(void)
{
    static const casadi_real normals[6][3] = {{1, 0, 0}, {0, -1, 0}, {0, 0, 1}, {0.36, 0.48, -0.8}, {0.8, -0.36,
        0.48}, {0.48, 0.8, 0.36}};
    static const int least[6] = {1, 0, 0, 0, 1, 2};
    int k, i;
    for (k = 0; k < 6; ++k) {
        const casadi_real *n = normals[k];
        casadi_real t[6] = {9, 9, 9, 9, 9, 9}, third[3] = {0, 0, 0};
        cross_normal(n, t);
        add_cross(1, n, t, third);
        LAW("directions across a normal have length one", same(dot(t, t), 1) && same(dot(t + 3, t + 3), 1));
        LAW("and are across it and each other", fabs(dot(t, n)) < 1e-15 && fabs(dot(t + 3, t)) < 1e-15);
        for (i = 0; i < 3; ++i)
            LAW("in the order of a screw", fabs(third[i] - t[3 + i]) < 1e-15);
        LAW("the first lies across the axis that is most across the normal", t[least[k]] == 0);
    }
}

static void closings(void)
{
    const casadi_real row[2] = {1, -2};
    anew(2, 0, 0, 0, 0.5);
    set(2, s.v0, 1, 2, 0), set(2, s.vf, 3, 2, 0); /* -3, -1 */
    LAW("a distance of the way is closed", closes(&s, row, 1, 0));
    LAW("a larger one is open", !closes(&s, row, 1 + 1e-10, 0));
    LAW("by half of the restitution less", closes(&s, row, 0.75, 0.5) && !closes(&s, row, 0.75 + 1e-10, 0.5));
    s.vf[0] = 6; /* 2 */
    LAW("the way is by the mean of both velocities", closes(&s, row, 0.25, 0) && !closes(&s, row, 0.25 + 1e-10, 0));
}

/* Two points of two bodies, above each other: heights are judged at the middle that v0 leads to. */
static void contacts(void)
{
    static const casadi_real way[12] = {0, 1, 2, 0, -1, 0.5, 1, 0, 0, 3, 0.25, -2};
    casadi_real t[6], *J;
    casadi_int r, i;
    anew(2, 2, 0, 0, 0.5);
    memcpy(speeds, way, sizeof way);
    restitution[0] = 0.5, restitution[1] = 0.25, coefficient[0] = 0.3, coefficient[1] = 0.7;
    direction[3] = 0.36, direction[4] = 0.48, direction[5] = 0.8;
    set(2, s.q0, 1, -1, 0), set(2, s.v0, 4, -8, 0), set(2, s.vf, 0, 0, 0);
    /* the first: n.J = (-1, 0.5), -8 at the start; J (h/2 v0) = -2: at the start g = height + 2,
        within the step it falls
     * by (1 - 0.25) 0.25 8 = 1.5 */
    height[0] = -0.5, height[1] = 100;
    s.r[0] = 5;
    LAW("a contact is added", add_points(&s, &record) == 0 && s.blocks == 1 && s.rows == 3 && record.kernel == 0);
    LAW("nothing else changes", s.r[0] == 5);
    LAW("distances are judged in the middle", touched[0] == 2 && touched[1] == -3);
    LAW("with its friction", s.kind[0] == MBS_TOUCH && s.first[0] == 0 && s.owner[0] == 0 && s.grip[0] == 0.3);
    LAW("its normal velocity at the start is thrown back in part, the others are not",
        same(s.bias[0], -4) && s.bias[1] == 0 && s.bias[2] == 0);
    cross_normal(direction, t);
    for (i = 0; i < 2; ++i) {
        LAW("its first row is along the normal", s.J[i] == way[4 + i]);
        for (r = 0; r < 2; ++r)
            LAW("the others are across it",
                same(s.J[2 * (r + 1) + i], t[3 * r] * way[i] + t[3 * r + 1] * way[2 + i] + t[3 * r + 2] * way[4 + i]));
    }
    s.rows = s.blocks = 0, height[0] += 1e-10;
    LAW("one that stays open is left out", add_points(&s, &record) == 0 && s.rows == 0 && s.blocks == 0);
    height[1] = -100;
    LAW("the second alone", add_points(&s, &record) == 0 && s.rows == 3 && s.owner[0] == 3 && s.grip[0] == 0.7);
    cross_normal(direction + 3, t);
    for (i = 0; i < 2; ++i) {
        LAW("by its own normal", same(s.J[i], 0.36 * way[6 + i] + 0.48 * way[8 + i] + 0.8 * way[10 + i]));
        for (r = 0; r < 2; ++r)
            LAW("and its own directions",
                same(s.J[2 * (r + 1) + i],
                    t[3 * r] * way[6 + i] + t[3 * r + 1] * way[8 + i] + t[3 * r + 2] * way[10 + i]));
    }
    height[0] = -100, s.rows = s.blocks = 0;
    LAW("both", add_points(&s, &record) == 0 && s.rows == 6 && s.blocks == 2 && s.first[1] == 3);
    J = s.J + 6;
    LAW("each in its rows", J[0] != 0 && same(J[0], 0.36 * way[6] + 0.48 * way[8] + 0.8 * way[10]) && s.J[0] == way[4]);
    LAW("restitution is of velocities that approach", s.bias[3] == 0);
    s.rows = s.blocks = 0, set(2, s.v0, -4, 8, 0);
    LAW("alone", add_points(&s, &record) == 0 && s.rows == 6 && s.bias[0] == 0 && same(s.bias[3], 0.25 * -3.52));
    LAW("and of none across normals",
        total(2, s.J + 2, s.v0) < 0 && total(2, s.J + 4, s.v0) < 0 && s.bias[1] == 0 && s.bias[2] == 0);
    s.rows = s.blocks = 0, height[1] = 100, lay_entries(&plant.J, speeds, 11), speeds[11] = NAN;
    for (i = 0; i < 12; ++i)
        s.slide[i] = NAN;
    height[1] = -100;
    LAW("entries that are not there are 0", add_points(&s, &record) == 0 && s.rows == 6);
    for (i = 0; i < 12; ++i)
        LAW("all", s.J[i] == s.J[i]);
    height[1] = 100, lay_entries(&plant.J, speeds, 12), speeds[11] = way[11];
    s.rows = s.blocks = 0, speeds[4] = 1e-14, speeds[5] = 0;
    LAW("what cannot be pushed is left out", add_points(&s, &record) == 0 && s.rows == 0);
    speeds[4] = 1.01e-14;
    LAW("more can", add_points(&s, &record) == 0 && s.rows == 3);
    fails = TOUCHING;
    LAW("a kernel that fails is named", add_points(&s, &record) == MBS_KERNEL && record.kernel == 13);
    anew(1, 0, 0, 0, 1);
    fails = TOUCHING;
    LAW("without points there is nothing to ask", collect(&s, &record) == 0);
}

/* Two stops and two brakes of joints with M = (2 1; 1 3), whose inverse is (3 -1; -1 2) / 5. */
static void collections(void)
{
    anew(2, 0, 2, 2, 0.5);
    mass[0] = 2, mass[1] = mass[2] = 1, mass[3] = 3;
    set(2, s.q0, 0, 0, 0), set(2, s.v0, 0, 0, 0), set(2, s.v1, 0, 0, 0);
    linearise(&s, &record);
    set(2, s.q0, 5, -3, 0), set(2, s.v0, 2, -4, 0), set(2, s.vf, 2, -4, 0);
    stops[0].side = -1, stops[0].place = 0, stops[0].rate = 0, stops[0].level = 6, stops[0].restitution = 0.5;
    stops[1].side = 1, stops[1].place = 1, stops[1].rate = 1, stops[1].level = -5, stops[1].restitution = 0;
    /* the first is 1 away and nears it by 0.75 in the step, the second is 2 away and nears it by 2 */
    brakes[0].rate = 1, brakes[0].torque = 3, brakes[0].fall = 2, brakes[0].slowness = 0.25, brakes[0].still = 100;
    brakes[1].rate = 0, brakes[1].torque = 7, brakes[1].still = 100;
    LAW("rows are collected", collect(&s, &record) == 0);
    LAW("stops that are reached, then brakes",
        s.blocks == 3 && s.rows == 3 && s.kind[0] == MBS_PUSH && s.kind[2] == MBS_BRAKE);
    LAW("by their own numbers", s.owner[0] == 1 && s.owner[1] == 2 && s.owner[2] == 3 && s.first[1] == 1);
    LAW("stops have no grip", s.grip[0] == 0);
    LAW("brakes have friction, which falls with speed",
        same(s.grip[1], 0.5 * (3 + 2 * exp(-1))) && same(s.grip[2], 3.5));
    LAW("each has its row", s.J[0] == 0 && s.J[1] == 1 && s.J[2] == 0 && s.J[3] == 1 && s.J[4] == 1 && s.J[5] == 0);
    LAW("and no bias", s.bias[0] == 0 && s.bias[1] == 0 && s.bias[2] == 0);
    LAW("impulses change velocities by the inverse mass",
        same(s.W[0], 0.4) && same(s.W[1], 0.4) && same(s.W[2], -0.2) && same(s.W[6], -0.2) && same(s.W[8], 0.6));
    stops[0].level = 5.75, brakes[0].still = 11, s.v0[1] = 0;
    LAW("a stop that is reached has its side", collect(&s, &record) == 0 && s.rows == 3 && s.owner[0] == 0);
    LAW("and is thrown back", s.J[0] == -1 && s.J[1] == 0 && s.bias[0] == -1);
    LAW("a joint at rest has its own friction", s.grip[1] == 5.5);
    s.v0[1] = -4;
    LAW("all", collect(&s, &record) == 0 && s.rows == 4 && s.J[2] == 0 && s.J[3] == 1 && s.J[6] == 1 && s.J[7] == 0);
    LAW("and their matrix", same(s.W[0], 0.6) && same(s.W[1], 0.2) && same(s.W[2], 0.2) && same(s.W[3], -0.6)
        && same(s.W[4], 0.2) && same(s.W[7], -0.2) && same(s.W[12], -0.6) && same(s.W[14], -0.2) && same(s.W[15], 0.6));
    anew(2, 2, 1, 1, 0.5);
    set(2, s.q0, 0, 0, 0), set(2, s.v0, 0, 0, 0), set(2, s.v1, 0, 0, 0);
    linearise(&s, &record), release(&s);
    LAW("stops and brakes are numbered after points", collect(&s, &record) == 0 && s.owner[0] == 6 && s.owner[1] == 7);
}

/* Count the struck rows of blocks of some kinds; the kind that follows is of an earlier step. */
static casadi_int struck(casadi_int blocks, casadi_int a, casadi_int b, casadi_int c, casadi_int later)
{
    casadi_int kind[4] = {a, b, c, later}, first[4], k, at = 0;
    mbs_stepper own;
    memset(&own, 0, sizeof own);
    own.blocks = blocks, own.kind = kind, own.first = first;
    for (k = 0; k < 4; ++k) {
        first[k] = at;
        at += kind[k] == MBS_TOUCH ? 3 : 1;
    }
    return count_struck(&own);
}

static void counts(void)
{
    LAW("nothing is struck where there is nothing", struck(0, MBS_TOUCH, MBS_TOUCH, MBS_TOUCH, MBS_TOUCH) == 0);
    LAW("nor are brakes", struck(2, MBS_BRAKE, MBS_BRAKE, MBS_TOUCH, MBS_TOUCH) == 0);
    LAW("a contact has three rows", struck(1, MBS_TOUCH, MBS_PUSH, MBS_PUSH, MBS_PUSH) == 3);
    LAW("a stop has one", struck(2, MBS_TOUCH, MBS_PUSH, MBS_TOUCH, MBS_TOUCH) == 4);
    LAW("brakes that follow are left out", struck(3, MBS_PUSH, MBS_TOUCH, MBS_BRAKE, MBS_PUSH) == 4);
    LAW("all of them", struck(3, MBS_TOUCH, MBS_BRAKE, MBS_BRAKE, MBS_PUSH) == 3);
}

/* Two joints of masses 1 and 1/2 with a stop for the first and a brake of the second. */
static void strike_two(void)
{
    anew(2, 0, 1, 1, 0.5);
    s.rows = s.blocks = 0;
    open_block(&s, MBS_PUSH, 0, 0), open_block(&s, MBS_BRAKE, 1, 9);
    s.first[1] = 1, s.rows = 2;
    set(2, s.J, 1, 0, 0), set(2, s.J + 2, 0, 1, 0), set(2, s.B, 1, 0, 0), set(2, s.B + 2, 0, 2, 0);
    set(2, s.W, 1, 0, 0), set(2, s.W + 2, 0, 2, 0), set(2, s.bias, -0.5, 0, 0);
    set(2, s.v0, -2, 4, 0), set(2, s.vf, -3, 5, 0);
}

static void strikes(void)
{
    casadi_real taken;
    int status = 0;
    strike_two();
    set(2, answers, 4, -1.5, 0), answered = 1e-11, s.factor = 0.5, record.residual = 1e-12;
    taken = strike(&s, 1e-9, &record, &status);
    LAW("an impulse is sought", status == 0 && asked == 1 && record.sweeps == 3 && record.newton == 5);
    LAW("by velocities without impulses, and a part of restitutions", same(s.free[0], -3.25) && s.free[1] == 5);
    LAW("velocities change by it", s.v1[0] == 1 && s.v1[1] == 2);
    LAW("contacts and stops take energy by the mean velocity", taken == 2);
    LAW("the residual is noted", s.reached == 1e-11 && record.residual == 1e-11);
    answered = 1e-12;
    strike(&s, 1e-9, &record, &status);
    LAW("as the largest", s.reached == 1e-12 && record.residual == 1e-11 && record.sweeps == 6 && record.newton == 10);
    s.kind[1] = MBS_PUSH; /* the second takes 1.5 times its mean velocity of 3 */
    LAW("all that are struck count", same(strike(&s, 1e-9, &record, &status), 2 + 4.5));
    gives_up = 4;
    strike(&s, 1e-9, &record, &status);
    LAW("a problem without solution ends a run", status == MBS_CONE);
    s.rows = s.blocks = 0, status = 0;
    LAW("without rows nothing is asked",
        strike(&s, 1e-9, &record, &status) == 0 && asked == 4 && !status && s.v1[1] == 5);
}

static void energies(void)
{
    int status = 0;
    strike_two();
    s.v0[0] = s.vf[0] = -1, answers[0] = 2 * (1 + 1.9e-9), answers[1] = 1; /* takes P - P^2 / 2, beside P^2 */
    LAW("impulses may create a rounding of their energy", keeps(&s, 1, 1e-9, &record, &status) && s.factor == 1);
    answers[0] = 2 * (1 + 2.1e-9);
    LAW("but no more", !keeps(&s, 0.75, 1e-9, &record, &status) && s.factor == 0.75);
    answers[0] = 0;
    LAW("none creates none", keeps(&s, 1, 1e-9, &record, &status));
    s.kind[1] = MBS_PUSH, set(2, answers, 1e-4, 2e-4, 0); /* the second takes less than nothing, beside 1e-8 + 8e-8 */
    s.v0[1] = 8e-13 - 0.5, s.vf[1] = 0.5 - 4e-4, s.v0[0] = 0.9e-13 - 0.5, s.vf[0] = 0.5 - 1e-4;
    LAW("sizes are of all rows", keeps(&s, 1, 1e-9, &record, &status));
    s.v0[1] = 9e-13 - 0.5;
    LAW("together", !keeps(&s, 1, 1e-9, &record, &status));
    strike_two();
    s.vf[1] = 0, manner = PUSHED, s.v0[0] = s.vf[0] = -1,
        s.bias[0] = -3; /* three times as fast: creates above a third */
    restrain(&s, 1e-9, &record, &status);
    LAW("restitutions shrink to the largest part that creates no energy", s.factor == 21845.0 / 65536 && asked == 18);
    LAW("which is taken", same(s.v1[0], 65535.0 / 65536));
    strike_two();
    s.vf[1] = 0, manner = PUSHED, s.v0[0] = s.vf[0] = -1, s.bias[0] = -0.5;
    restrain(&s, 1e-9, &record, &status);
    LAW("whole ones that create none stay", s.factor == 1 && asked == 1 && s.v1[0] == 0.5);
    strike_two();
    s.bias[0] = 0, answers[0] = 100;
    restrain(&s, 1e-9, &record, &status);
    LAW("without rebounds there is nothing to shrink", s.factor == 1 && asked == 1 && status == 0);
    strike_two();
    s.v0[0] = s.vf[0] = -1, answers[0] = 3, gives_up = 4;
    restrain(&s, 1e-9, &record, &status);
    LAW("a cone problem without solution ends it at once", asked == 4 && status == MBS_CONE);
}

static void guesses(void)
{
    const casadi_real impulses[8] = {1, 2, 3, 4, 5, 6, 7, 8};
    anew(2, 2, 1, 1, 1);
    open_block(&s, MBS_TOUCH, 3, 0), open_block(&s, MBS_BRAKE, 7, 0);
    s.first[1] = 3;
    guess(&s, impulses);
    LAW("impulses of before are a guess, in the order of rows",
        s.P[0] == 4 && s.P[1] == 5 && s.P[2] == 6 && s.P[3] == 8);
}

/* Solve for a step of a joint of mass m that is pushed by 3, by a matrix that is wrong by a factor: v1 = 3 h / m,
    to which
 * an iteration comes nearer by 1 - 1/factor. Returns the status. */
static int step_wrongly(casadi_real m, casadi_real factor)
{
    const casadi_real none[1] = {0};
    anew(1, 0, 0, 0, 0.5);
    s.q0[0] = s.v0[0] = s.v1[0] = 0, mass[0] = m, push[0] = 3, wrong = factor;
    return iterate(&s, 1e-9, none, &record);
}

static void iterations(void)
{
    const casadi_real none[2] = {0, 0};
    int k;
    LAW("one iteration is enough for linear forces, a second shows it", step_wrongly(2, 1) == 0 && s.v1[0] == 0.75);
    LAW("by one matrix", record.iterations == 2 && record.jacobians == 1 && evaluated == 2);
    LAW("a matrix stays while iterations shrink by a fifth", step_wrongly(2, 1.24) == 0 && record.jacobians == 1);
    LAW("as many as its error needs",
        fabs(s.v1[0] - 0.75) < 1e-12 && record.iterations == 2 + (int)(log(1e-12) / log(1 - 1 / 1.24)));
    LAW("a matrix that shrinks less is made anew", step_wrongly(2, 1.26) == 0 && record.jacobians > 1);
    LAW("not twice in a row", record.jacobians <= 1 + record.iterations / 2);
    LAW("whatever the size of velocities",
        step_wrongly(2e4, 1.24) == 0 && record.iterations == 2 + (int)(log(1e-12) / log(1 - 1 / 1.24)));
    LAW("or", step_wrongly(2e-4, 1.24) == 0 && record.iterations == 2 + (int)(log(1e-12) / log(1 - 1 / 1.24)));
    anew(1, 0, 0, 0, 0.5);
    s.q0[0] = s.v0[0] = s.v1[0] = 0;
    LAW("rest stays", iterate(&s, 1e-9, none, &record) == 0 && record.iterations == 1);
    LAW("iterations end", step_wrongly(2, 10) == MBS_DIVERGED && record.iterations == 40);
    for (k = 0; k < 3; ++k) {
        const casadi_real sizes[3] = {0.95e-10, 0.95e-9, 1.05e-9};
        anew(1, 0, 0, 0, 0.5); /* noise changes the velocity by 2 h noise each time, of 1 */
        s.q0[0] = 0, s.v0[0] = s.v1[0] = 1, noise = sizes[k];
        LAW("noise ends an iteration where it is small", (iterate(&s, 1e-9, none, &record) == 0) == (k < 2));
        LAW("at the third, or late within the tolerance", record.iterations == (k ? k == 1 ? 16 : 40 : 3));
    }
    for (k = 0; k < 4; ++k) {
        anew(1, 0, 0, 1, 0.5);
        s.q0[0] = 0, s.v0[0] = s.v1[0] = k < 2 ? 1 : 100, noise = k % 2 ? 1.05e-6 : 0.95e-6;
        noise *= k < 2 ? 1 : 100, answered = 1e-7;
        LAW("so does noise of cone problems, beside velocities",
            (iterate(&s, 1e-9, none, &record) == 0) == (k % 2 == 0));
    }
    anew(1, 0, 0, 0, 0.5);
    s.q0[0] = s.v0[0] = s.v1[0] = 0, push[0] = NAN;
    LAW("what is no number ends it", iterate(&s, 1e-9, none, &record) == MBS_INFINITE && record.iterations == 1);
    anew(1, 0, 0, 0, 0.5);
    s.q0[0] = s.v0[0] = s.v1[0] = 0, push[0] = 1, fails = LINEARISED;
    LAW("a kernel that fails does", iterate(&s, 1e-9, none, &record) == MBS_KERNEL && record.iterations == 0);
    fails = RESIDUAL;
    LAW("in later iterations too", iterate(&s, 1e-9, none, &record) == MBS_KERNEL && record.kernel == 11);
    anew(1, 0, 1, 0, 0.5);
    s.q0[0] = s.v0[0] = s.v1[0] = -1, stops[0].side = 1, push[0] = 1, gives_up = 1, manner = PUSHED;
    LAW("and a cone problem that has no solution", iterate(&s, 1e-9, none, &record) == MBS_CONE);
    s.v1[0] = -1, gives_up = 3; /* the second time */
    LAW("at any iteration", iterate(&s, 1e-9, none, &record) == MBS_CONE);
    anew(1, 0, 1, 0, 0.5);
    s.q0[0] = s.v0[0] = s.v1[0] = -1, stops[0].side = 1, stops[0].restitution = 3, manner = PUSHED, s.factor = 0;
    LAW("restitutions shrink at the first iteration", iterate(&s, 1e-9, none, &record) == 0);
    LAW("and stay there", same(s.v1[0], 65535.0 / 65536) && asked == 19);
}

static void holds(void)
{
    anew(2, 0, 1, 2, 1);
    stops[0].rate = 0, brakes[0].rate = 0, brakes[1].rate = 1;
    set(2, s.v0, 2, -5, 0), set(2, s.vf, 10, 0, 0);
    s.rows = s.blocks = 0;
    open_block(&s, MBS_PUSH, 0, 0);
    s.P[0] = 1, set(2, s.v1, 0.99e-9, 1e-12, 0), s.P[1] = 0, s.kind[1] = MBS_BRAKE, s.owner[1] = 2, s.first[1] = 1,
        s.grip[1] = 1;
    hold(&s); /* the second block is of an earlier step */
    LAW("a joint that a stop pushes rests where it is slow", s.v1[0] == 0 && s.v1[1] == 1e-12);
    s.v1[0] = -1.01e-9, hold(&s);
    LAW("faster ones move", s.v1[0] == -1.01e-9);
    s.v1[0] = -1e-10, s.P[0] = 0, hold(&s);
    LAW("as where nothing pushes", s.v1[0] == -1e-10);
    s.vf[0] = 0, s.P[0] = 1, s.v1[0] = 0.51e-9, hold(&s);
    LAW("beside the fastest velocity of either", s.v1[0] == 0.51e-9);
    s.v1[0] = 0.49e-9, hold(&s);
    LAW("alone", s.v1[0] == 0);
    s.blocks = 0, open_block(&s, MBS_BRAKE, 2, 3);
    s.P[0] = -2.9, set(2, s.v1, 1e-12, 1e-12, 0), hold(&s);
    LAW("a brake that sticks holds its own joint", s.v1[0] == 1e-12 && s.v1[1] == 0);
    s.P[0] = -3, s.v1[1] = 1e-12, hold(&s);
    LAW("one that slides does not", s.v1[1] == 1e-12);
    anew(2, 1, 1, 1, 1);
    stops[0].rate = 0, brakes[0].rate = 1, s.blocks = 0;
    set(2, s.v0, 2, -5, 0), set(2, s.vf, 10, 0, 0), set(2, s.v1, 1e-12, 1e-12, 0);
    open_block(&s, MBS_TOUCH, 0, 1), s.P[0] = 1, hold(&s);
    LAW("contacts hold no joint", s.v1[0] == 1e-12 && s.v1[1] == 1e-12);
    s.blocks = 0, open_block(&s, MBS_PUSH, 3, 0), hold(&s);
    LAW("stops are numbered after points", s.v1[0] == 0 && s.v1[1] == 1e-12);
    s.blocks = 0, open_block(&s, MBS_BRAKE, 4, 3), hold(&s);
    LAW("and brakes after these", s.v1[1] == 0);
}

static void losses(void)
{
    casadi_real taken[2] = {0, 0};
    casadi_int k;
    anew(2, 1, 1, 1, 1);
    s.blocks = s.rows = 0;
    open_block(&s, MBS_TOUCH, 0, 1), s.rows = 3, open_block(&s, MBS_PUSH, 3, 0), s.rows = 4, open_block(&s,
        MBS_BRAKE, 4, 1);
    for (k = 0; k < 5; ++k)
        set(2, s.J + 2 * k, (casadi_real)(k + 1), -1, 0), s.P[k] = (casadi_real)(1 << (2 * k));
    set(2, s.v0, 1, 3, 0), set(2, s.v1, 3, 3, 0); /* mean velocities -1, 1, 3, 5, 7 */
    add_losses(&s, taken);
    LAW("impacts take energy along normals", taken[0] == -(1.0 * -1 + 64 * 5));
    LAW("friction takes it across, and in brakes", taken[1] == -(4.0 * 1 + 16 * 3 + 256 * 7));
}

/* A joint of mass 2 under a load: a step of 1/2 in which an impulse takes energy. */
static int balance_one(casadi_real allowed, casadi_real *q1, casadi_real *taken)
{
    anew(1, 0, 1, 1, 0.5);
    plant.m = 1, s.v = answers, answers[0] = 3;
    mass[0] = 2, push[0] = -8, damping[0] = 0.5, s.q0[0] = 1, s.v0[0] = -4, s.v1[0] = 2, s.vf[0] = 0;
    s.blocks = s.rows = 0, open_block(&s, MBS_PUSH, 0, 0), s.rows = 1, s.J[0] = 1, s.P[0] = 1;
    record.allowed = allowed;
    return balance(&s, q1, taken, &record);
}

/* The mean velocity is -1: inputs give 1/2 (-3 - 1/2), an impulse takes 1; at the end 1/2 the energy is 4 + 4. */
static void balances(void)
{
    casadi_real q1[1], taken[2];
    LAW("energy within its balance stays", balance_one(20, q1, taken) == 0 && s.v1[0] == 2 && record.kernel == 0);
    LAW("the step ends where its mean velocity leads", q1[0] == 0.5 && q[0] == 0.5 && qd[0] == 2);
    LAW("the balance has the work of the middle, less what impulses took",
        same(record.allowed, 20 - 1.75 - 1) && taken[0] == 1);
    s.blocks = 2, s.kind[1] = MBS_BRAKE, s.owner[1] = 1, s.first[1] = 0, s.J[0] = 1, s.v0[0] = -4, s.v1[0] = 2,
        record.allowed = 20;
    s.P[1] = 1, s.grip[1] = 0;
    LAW("and friction", balance(&s, q1, taken, &record) == 0 && same(record.allowed, 20 - 1.75 - 2) && taken[1] == 1);
    balance_one(8 + 2.75 - 1e-6, q1, taken);
    LAW("an excess is taken from velocities", fabs(mass[0] / 2 * s.v1[0] * s.v1[0] - (4 - 1e-6)) < 1e-14);
    balance_one(8 + 2.75 - 7e-13, q1, taken);
    LAW("a rounding is not", s.v1[0] == 2);
    balance_one(8 + 2.75 - 9e-13, q1, taken);
    LAW("which is a part of all energy", s.v1[0] < 2);
    balance_one(8 + 2.75 - 1, q1, taken);
    LAW("a step takes a thousandth at most", same(s.v1[0] * s.v1[0], 4 * (1 - 1e-3)));
    anew(1, 0, 0, 0, 0.5);
    s.q0[0] = 1, s.v0[0] = s.v1[0] = 0.5, s.vf[0] = 7, record.allowed = 0;
    LAW("however small",
        balance(&s, q1, taken, &record) == 0 && same(s.v1[0] * s.v1[0], 0.25 * (1 - 1e-3)) && s.vf[0] == 7);
    anew(1, 0, 0, 0, 0.5);
    s.q0[0] = 1, s.v0[0] = s.v1[0] = s.vf[0] = 0, added = -3, record.allowed = -4;
    LAW("at rest there is nothing to take", balance(&s, q1, taken, &record) == 0 && s.v1[0] == 0);
    anew(1, 0, 0, 0, 0.5);
    s.q0[0] = 0, s.v0[0] = s.v1[0] = 2, s.vf[0] = 0, added = -1e6, record.allowed = 2 - 1e6 - 0.95e-7;
    balance(&s, q1, taken, &record);
    LAW("the size of potential energy counts, not its sign", s.v1[0] == 2);
    record.allowed = 2 - 1e6 - 1.05e-7;
    balance(&s, q1, taken, &record);
    LAW("both ways", s.v1[0] < 2);
    balance_one(20, q1, taken);
    s.P[0] = -1, s.v0[0] = -4, s.v1[0] = 2, record.allowed = 20;
    balance(&s, q1, taken, &record);
    LAW("impulses never add to the balance", same(record.allowed, 20 - 1.75) && taken[0] == -1);
    balance_one(20, q1, taken);
    fails = WORK;
    LAW("a kernel that fails is named", balance(&s, q1, taken, &record) == MBS_KERNEL && record.kernel == 16);
    fails = ENERGY_OF;
    LAW("each", balance(&s, q1, taken, &record) == MBS_KERNEL && record.kernel == 15);
}

static void results(void)
{
    casadi_real impulses[8] = {9, 9, 9, 9, 9, 9, 9, 9}, vectors[6] = {9, 9, 9, 9, 9, 9}, t[6];
    int i;
    anew(2, 2, 1, 1, 1);
    direction[3] = 0.36, direction[4] = 0.48, direction[5] = 0.8;
    cross_normal(direction + 3, t);
    write(6, 1, direction, s.normal);
    s.blocks = s.rows = 0;
    open_block(&s, MBS_TOUCH, 3, 1), s.rows = 3, open_block(&s, MBS_BRAKE, 7, 1);
    set(3, s.P, 2, -3, 5), s.P[3] = 7;
    keep(&s, impulses, vectors);
    LAW("impulses are kept by point, stop and brake",
        impulses[3] == 2 && impulses[4] == -3 && impulses[5] == 5 && impulses[7] == 7);
    LAW("with none where nothing is closed", !impulses[0] && !impulses[1] && !impulses[2] && !impulses[6]);
    for (i = 0; i < 3; ++i) {
        LAW("points have vectors of their impulses",
            same(vectors[3 + i], 2 * direction[3 + i] - 3 * t[i] + 5 * t[3 + i]));
        LAW("or none", vectors[i] == 0);
    }
}

/* Fall from 1 with -g t^2 / 2, g = 8, in steps of 1/8: exact by the midpoint rule. */
static void runs(void)
{
    const casadi_real start[2] = {1, 0}, moving[2] = {0.5, 3}, far[2] = {1.7e308, 1e308}, lands[2] = {0, -3};
    casadi_real inputs[8] = {-8, 99, -8, 99, -8, 99, -8, 99}, rows[4 * 6], impulses[1] = {0};
    casadi_int taken, k;
    int status = 7;
    anew(1, 0, 1, 0, 0);
    plant.m = 1, stops[0].side = 1, stops[0].level = -100, manner = PUSHED, record.allowed = NAN;
    taken = mbs_stepping_run(&plant, 1e-9, 0.125, 4, inputs, 2, start, rows, impulses, &record, &status, reals,
        integers);
    LAW("all steps are taken", taken == 4 && status == 0);
    for (k = 0; k < 4; ++k) {
        const casadi_real t = 0.125 * (casadi_real)(k + 1), *row = rows + 6 * k;
        LAW("with the inputs of each", same(row[0], 1 - 4 * t * t) && same(row[1], -8 * t));
        LAW("and their middles",
            same(row[3], -8 * (t - 0.0625)) && fabs(row[2] - (row[0] + 0.0625 * 8 * (t - 0.0625))) < 1e-14);
        LAW("and no losses", row[4] == 0 && row[5] == 0);
    }
    LAW("energy has its balance", same(record.allowed, 8 * (1 - rows[18])));
    record.allowed = 1e3;
    mbs_stepping_run(&plant, 1e-9, 0.125, 1, inputs, 2, start, rows, impulses, &record, &status, reals, integers);
    LAW("which goes on from an earlier one", fabs(record.allowed - 1e3 - 0.5) < 1e-12);
    stops[0].level = 0, record.allowed = NAN; /* reached within the fourth step, without restitution */
    taken = mbs_stepping_run(&plant, 1e-9, 0.125, 4, inputs, 2, start, rows, impulses, &record, &status, reals,
        integers);
    LAW("a stop holds", taken == 4 && status == 0 && rows[6 * 3 + 1] == 0);
    LAW("by an impulse, which takes energy", same(impulses[0], 4) && same(rows[22], 4 * 1.5) && rows[23] == 0);
    push[0] = NAN, record.allowed = NAN;
    taken = mbs_stepping_run(&plant, 1e-9, 0.125, 4, inputs, 2, start, rows, impulses, &record, &status, reals,
        integers);
    LAW("what is no number is no step", taken == 0 && status == MBS_INFINITE);
    push[0] = 0, stiffness[0] = 3, record.allowed = NAN;
    taken = mbs_stepping_run(&plant, 1e-9, 0.125, 0, inputs, 2, moving, rows, impulses, &record, &status, reals,
        integers);
    LAW("the balance begins with all energy", taken == 0 && status == 0 && same(record.allowed, 1.5 * 0.25 + 4.5));
    stiffness[0] = 0, inputs[0] = 0, record.iterations = 0, record.allowed = NAN;
    taken = mbs_stepping_run(&plant, 1e-9, 0.125, 1, inputs, 2, moving, rows, impulses, &record, &status, reals,
        integers);
    LAW("a motion without forces goes on by itself",
        taken == 1 && record.iterations == 1 && rows[0] == 0.5 + 3.0 / 8 && rows[1] == 3);
    record.allowed = NAN;
    taken = mbs_stepping_run(&plant, 1e-9, 1, 1, inputs, 2, far, rows, impulses, &record, &status, reals, integers);
    LAW("no place is infinite", taken == 0 && status == MBS_INFINITE);
    fails = ENERGY_OF, record.allowed = NAN;
    taken = mbs_stepping_run(&plant, 1e-9, 0.125, 4, inputs, 2, start, rows, impulses, &record, &status, reals,
        integers);
    LAW("a run whose energy is unknown does not begin", taken == 0 && status == MBS_KERNEL && record.kernel == 15);
    anew(1, 1, 0, 0, 0);
    memset(rows, 0, sizeof rows), speeds[2] = 1, height[0] = 0, set(3, answers, 4, 0, 0), record.allowed = NAN;
    taken = mbs_stepping_run(&plant, 1e-9, 0.125, 1, inputs, 2, lands, rows, rows + 12, &record, &status, reals,
        integers);
    LAW("a point has its impulse", taken == 1 && rows[8] == 4 && rows[6] == 0 && rows[7] == 0 && rows[1] == 1);
    LAW("and its losses", same(rows[4], -4 * (-3 + 1) / 2.0) && rows[5] == 0 && rows[12] == 4);
}

static int meet(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int memory)
{
    (void)arg, (void)res;
    LAW("kernels have no memory", !iw && !w && !memory);
    return fails == TOUCHING ? 17 : 0;
}

static void pairs(void)
{
    static const casadi_real poses[6] = {1, 0, 0, 3, 0, 0}, axes[18] = {2, 0, 0, 0, 0, 0, 0, 0, 0, 4};
    static const casadi_real twist[18] = {1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 5, 0, 7, 0, 11, 0, 0};
    const mbs_solid solid = {.points = 1};
    const mbs_meeting pair = {&solid, &solid, 2, 0.25, 0.5};
    casadi_int k, once = 1;
    casadi_real v[3];
    anew(3, 1, 1, 0, 0.1);
    plant.pairs = 1, plant.pair = &pair, plant.places = poses, plant.axes = axes, plant.meetings.f = meet;
    lay_entries(&plant.twist, twist, 18);
    memset(uses, 0, sizeof uses);
    reopen(0.1);
    use(s.twist, 18), use(s.moved, 9), use(s.normal, 9), use(s.room, 2), use((casadi_real *)s.spots, 14);
    for (k = 0; k < 2000; ++k)
        once &= uses[k] <= 1;
    LAW("arrays of pairs share no number, and end the room", once && (casadi_real *)s.spots + 14 == reals + mbs_stepping_reals(&plant));
    LAW("points of pairs have impulses", mbs_stepping_width(&plant) == 2 * 6 + 2 + 9);
    set(3, met[0].normal, 0, 0, 1), set(3, met[0].at, 2, 3, 4), met[0].gap = 0.3;
    set(3, met[1].normal, 0, 0, 1), set(3, met[1].at, 2, 3, 5), met[1].gap = 9;
    memset(s.q0, 0, 3 * sizeof *s.q0);
    set(3, s.v0, 0, 0, -4), set(3, s.vf, 0, 0, -4);
    LAW("points of pairs that close are collected", add_points(&s, &record) == 0 && s.blocks == 1 && s.rows == 3);
    LAW("after all others", s.owner[0] == 3 && s.grip[0] == 0.5 && s.kind[0] == MBS_TOUCH);
    /* the velocity is V + OM x at, with OM = (5 c, 7 b, 11 a) of qd = (a, b, c) */
    for (k = 0; k < 3; ++k)
        v[k] = s.J[k];
    LAW("along the normal they move by the twist", same(v[0], 0) && same(v[1], -7 * 2) && same(v[2], 1 + 5 * 3));
    LAW("they rebound by the law of their pair", same(s.bias[0], 0.25 * -4 * (1 + 5 * 3)));
    LAW("their normals are kept", s.normal[3] == 0 && s.normal[5] == 1);
    fails = TOUCHING, plant.touching.f = 0;
    LAW("a kernel that fails ends the step", add_points(&s, &record) == MBS_KERNEL && record.kernel == 17);
}

int main(void)
{
    rooms(), middles(), matrices(), linearisations(), directions(), closings(), contacts(), collections(), counts();
    pairs(), strikes(), energies(), guesses(), iterations(), holds(), losses(), balances(), results(), runs();
    return broken > 0;
}
