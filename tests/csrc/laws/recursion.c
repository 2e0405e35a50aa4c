#include "kkt.h"

#include "../../../csrc/stages/recursion.c"

/* Kinds with inner equations and without, dense and sparse; stages of one kind follow each other in more than one
 * group. */
static const kkt_shape plain_stages = {{{3, 5, 2, 2, 0, DENSE}, {2, 4, 1, 1, 0, SPARSE}, {2, 3, 1, 1, 0, SPARSE}}, 6,
    {0, 0, 1, 1, 1, 2}};
static const kkt_shape inner_stages = {
    {{6, 8, 6, 2, 5, SPARSE}, {6, 9, 7, 1, 6, APART}, {6, 3, 1, 1, 0, DENSE}}, 12, {0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1,
        2}};
static const kkt_shape dense_inner = {{{2, 9, 5, 1, 4, DENSE}, {2, 4, 1, 1, 0, SPARSE}, {0}}, 7, {0, 0, 0, 0, 0, 0, 1}};
static const kkt_shape full_stages = {{{2, 4, 1, 2, 0, DENSE}, {0}, {0}}, 6, {0}};
static const kkt_shape no_states = {{{0, 5, 2, 2, 1, DENSE}, {0}, {0}}, 1, {0}};
static const kkt_shape one_state = {{{1, 5, 2, 1, 1, DENSE}, {1, 4, 1, 1, 0, SPARSE}, {0}}, 6, {0, 0, 0, 0, 0, 1}};
static const kkt_shape carried_states = {{{7, 4, 2, 1, 0, CARRIED}, {7, 8, 6, 2, 5, CARRIED}, {7, 3, 1, 1, 0, DENSE}}, 8,
    {0, 0, 1, 1, 1, 1, 1, 2}};
static const kkt_shape tight_stages = {{{4, 1, 1, 1, 0, DENSE}, {4, 1, 2, 1, 0, DENSE}, {0}}, 2, {0, 1}};
static const kkt_shape *const shapes[] = {&plain_stages, &inner_stages, &dense_inner, &no_states, &one_state,
    &carried_states};

/* Vary all stages, let dynamics give where they may, and fix some variables: inner ones too, and first states. */
static void vary(int turn)
{
    mbs_stages_recursion *r = &kkt->recursion;
    int k, i;
    for (k = 0; k < shape.stages; ++k) {
        const mbs_stages_stage *t = &r->stage[k];
        vary_stage(k, turn);
        for (i = 0; i < t->next; ++i)
            r->compliance[t->d + i] = r->soft_dynamics ? (real)(1 + i) / 8 : 0;
        for (i = 0; i < t->n; ++i) {
            const int is_first = k == 0 && i < t->nx && turn % 2;
            const int is_chosen = (k + turn) % 3 == 1 && i == t->nx + turn % t->nv;
            const int is_soft = (k + turn) % 3 == 2 && i == 0 && r->soft_dynamics;
            kkt->fixed[t->w + i] = (char)(is_first || is_chosen || is_soft);
        }
    }
}

/* All systems of a shape: new right-hand sides, new numbers, and new compliances and curvature alone. */
static void solve_all(void)
{
    mbs_stages_recursion *r = &kkt->recursion;
    int turn, k;
    for (turn = 0; turn < 6; ++turn) {
        r->soft_dynamics = turn > 3, r->plain = turn == 2;
        vary(turn);
        LAW("what is convex is factorised", mbs_stages_factorise(r, 0) == -1);
        LAW("no rows depend on others", r->dependent == 0 && r->singular == 0);
        solve_kkt("a system is solved");
        solve_kkt("and again");
        vary(turn + 1);
        LAW("with other compliances", mbs_stages_factorise(r, 1) == -1);
        solve_kkt("what is condensed stays");
        for (k = 0; k < shape.stages; ++k)
            if ((k + turn) % 2)
                draw_stage(k);
    }
}

/* Inner variables that their equations do not give are found with the others; their rows are rows of these. */
static void defer(void)
{
    mbs_stages_recursion *r = &kkt->recursion;
    int turn, k;
    for (turn = 0; turn < 3; ++turn) {
        vary(turn);
        for (k = 0; k < shape.stages; ++k) {
            draw_stage(k);
            if ((k + turn) % 2 && sizes[k].inner > 2)
                lose_rank(k, sizes[k].inner - 2);
        }
        LAW("what does not give its variables is factorised", mbs_stages_factorise(r, 0) == -1 && r->singular > 0);
        solve_kkt("by the others");
    }
}

/* The response to first states is the solution where these move as they are asked to, and nothing else asks. */
static void respond(void)
{
    mbs_stages_recursion *r = &kkt->recursion;
    real first[MOST];
    int i;
    r->soft_dynamics = r->plain = 0;
    vary(1);
    kkt->fixed[0] = (char)(shape.stages % 2);
    mbs_stages_factorise(r, 0);
    draw_right();
    mbs_stages_sweep(r, rw, rc, dw, dy);
    draw_right();
    for (i = 0; i < MOST; ++i)
        first[i] = draw();
    memset(rw, 0, sizeof rw), memset(rc, 0, sizeof rc);
    mbs_stages_respond(r, first, rc, dw, dy);
    LAW("rows hold where first states move", row_residual() < (real)1e-10);
    LAW("and the cost is least", slope_residual() < (real)1e-9);
    LAW("fixed first states move as they must", keeps_fixed(first, r->stage[0].nx));
}

/* Products with the derivatives of all rows, by their entries. */
static void multiply(void)
{
    const mbs_stages_recursion *r = &kkt->recursion;
    real wanted[ALL] = {0}, forces[ALL], rows[ALL], wanted_rows[ALL] = {0}, both[ALL];
    int k, which, i, j;
    draw_right();
    memcpy(forces, rc, sizeof forces), memcpy(rows, rc, sizeof rows), memcpy(both, rw, sizeof both);
    for (k = 0; k < shape.stages; ++k) {
        const mbs_stages_stage *t = &r->stage[k];
        for (which = 0; which < 3; ++which)
            for (i = 0; i < kkt_rows(k, which); ++i) {
                const int at = (which == 0 ? t->e : which == 1 ? t->d : t->g) + i;
                for (j = 0; j < t->n; ++j) {
                    wanted[t->w + j] += entries[k][which][i * MOST + j] * rc[at];
                    wanted_rows[at] += entries[k][which][i * MOST + j] * rw[t->w + j];
                }
                if (which == 1) {
                    wanted[r->stage[k + 1].w + i] -= rc[at];
                    wanted_rows[at] -= rw[r->stage[k + 1].w + i];
                }
            }
    }
    mbs_stages_add_transposed(r, rc, forces);
    for (k = 0; k < shape.stages; ++k)
        mbs_stages_add_stage_both(r, k, rw, rows, rc, both);
    for (i = 0; i < kkt->variables; ++i) {
        LAW("forces of all rows are added", real_abs(forces[i] - rc[i] - wanted[i]) < (real)1e-12);
        LAW("stage by stage too", real_abs(both[i] - rw[i] - wanted[i]) < (real)1e-12);
    }
    for (i = 0; i < kkt->rows; ++i)
        LAW("with the changes of all rows", real_abs(rows[i] - rc[i] - wanted_rows[i]) < (real)1e-12);
}

/* No number depends on how workers cut the stages. */
static void cut_stages(const kkt_shape *of)
{
    real alone[2][ALL];
    const unsigned before = kkt_seed;
    int turn;
    for (turn = 0; turn < 2; ++turn) {
        kkt_seed = before;
        open_kkt(of, turn);
        vary(1);
        mbs_stages_factorise(&kkt->recursion, 0);
        kkt_seed = before;
        draw_right();
        mbs_stages_sweep(&kkt->recursion, rw, rc, dw, dy);
        LAW("a team computes the same variables", !turn || !memcmp(alone[0], dw, (size_t)kkt->variables * sizeof *dw));
        LAW("and multipliers", !turn || !memcmp(alone[1], dy, (size_t)kkt->rows * sizeof *dy));
        memcpy(alone[0], dw, sizeof dw), memcpy(alone[1], dy, sizeof dy);
    }
}

/* Where the cost is not convex in what rows leave free, the stage is named; fixed variables need not be. */
static void curve(void)
{
    mbs_stages_recursion *r;
    int k, i;
    open_kkt(&plain_stages, 0);
    r = &kkt->recursion;
    for (k = shape.stages - 1; k >= 0; --k) {
        const mbs_stages_stage *t = &r->stage[k];
        real *own = r->diagonal + t->w + t->nx;
        for (i = 0; i < t->nv; ++i)
            own[i] = -400;
        LAW("a stage that is not convex is named", mbs_stages_factorise(r, 0) == k);
        for (i = 0; i < t->nv; ++i)
            own[i] = 6;
    }
    for (i = 0; i < r->stage[0].nx; ++i)
        r->diagonal[i] = -400;
    LAW("first states that are not, with the first one", mbs_stages_factorise(r, 0) == 0);
    for (i = 0; i < r->stage[0].nx; ++i)
        kkt->fixed[i] = 1;
    LAW("fixed ones need not be", mbs_stages_factorise(r, 0) == -1);
    solve_kkt("nor are they");
}

/* Rows that variables of their stage cannot meet are met by the states before: three of the first state's,
    by fixed ones too. */
static void pass_rows(void)
{
    int turn;
    for (turn = 0; turn < 2; ++turn) {
        open_kkt(&tight_stages, 0);
        kkt->fixed[2] = (char)turn;
        LAW("rows are passed", mbs_stages_factorise(&kkt->recursion, 0) == -1 && kkt->recursion.step[0].passed == 3);
        LAW("as many as can be met", kkt->recursion.dependent == 0);
        solve_kkt("they are");
    }
}

/* States that the dynamics alone read, each to give itself, are known by the pattern: whole lanes of them. */
static void carry(void)
{
    int k;
    open_kkt(&carried_states, 0);
    for (k = 0; k < shape.stages; ++k)
        LAW("states that are carried are counted", kkt->recursion.stage[k].carried == (k == 7 ? 0 : 4));
    open_kkt(&plain_stages, 0);
    for (k = 0; k < shape.stages; ++k)
        LAW("where there are some", kkt->recursion.stage[k].carried == 0);
}

/* A row that repeats another one depends on it; where it asks for something else, what is left is its lack. */
static void depend(void)
{
    mbs_stages_recursion *r;
    int k, j, turn;
    open_kkt(&full_stages, 0);
    r = &kkt->recursion;
    for (k = 0; k < 6; ++k) {
        for (j = 0; j < MOST && k % 2; ++j)
            entries[k][2][j] = 2 * entries[k][0][j];
        write_stage(k);
    }
    LAW("rows that repeat others", mbs_stages_factorise(r, 0) == -1);
    LAW("are counted", r->dependent == 3);
    draw_right();
    for (k = 1; k < 6; k += 2)
        rc[r->stage[k].g] = 2 * rc[r->stage[k].e];
    mbs_stages_sweep(r, rw, rc, dw, dy);
    LAW("they hold", row_residual() < (real)1e-10 && slope_residual() < (real)1e-9);
    LAW("and leave nothing", r->left < (real)1e-10);
    for (turn = 0; turn < 2; ++turn)
        for (k = 1; k < 6; k += 2) {
            const real lack = (real)(1 << (turn ? k : 12 - k));
            const real most = turn && k < 5 ? 0 : turn ? lack : (real)(1 << 11);
            rc[r->stage[k].g] = 2 * rc[r->stage[k].e] + lack;
            mbs_stages_sweep(r, rw, rc, dw, dy);
            LAW("or as much as they lack, the most of all",
                most == 0 || near(r->left, most) || near(r->left, most / 2));
        }
}

int main(void)
{
    int i, turn;
    for (i = 0; i < 6; ++i)
        for (turn = 0; turn < 2; ++turn) {
            open_kkt(shapes[i], turn);
            solve_all();
            respond();
            multiply();
        }
    carry();
    open_kkt(&dense_inner, 0);
    defer();
    open_kkt(&dense_inner, 1);
    defer();
    for (i = 0; i < 5; ++i)
        cut_stages(shapes[i]);
    curve();
    pass_rows();
    depend();
    return broken > 0;
}
