#include "kkt.h"

#include "../../../csrc/stages/condense.c"

/* Kinds of stages with inner equations, in more than one group of stages, and a last stage that has none. */
static const kkt_shape sparse_stages = {
    {{6, 8, 6, 2, 5, SPARSE}, {6, 9, 7, 1, 6, APART}, {6, 4, 1, 1, 0, DENSE}}, 12, {0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1,
        2}};
static const kkt_shape full_stages = {{{2, 7, 5, 1, 3, DENSE}, {2, 4, 1, 1, 0, SPARSE}, {0}}, 7, {0, 0, 0, 0, 0, 0, 1}};
static const kkt_shape inner_alone = {{{1, 5, 3, 1, 3, DENSE}, {1, 2, 1, 1, 1, SPARSE}, {0}}, 3, {0, 0, 1}};
static const kkt_shape many_inner = {{{1, 15, 13, 0, 12, DENSE}, {0}, {0}}, 2, {0}};
static const kkt_shape *const shapes[] = {&sparse_stages, &full_stages, &inner_alone};

static void vary(int turn)
{
    int k;
    for (k = 0; k < shape.stages; ++k)
        vary_stage(k, turn);
}

static void solve_all(void)
{
    mbs_stages_recursion *r = &kkt->recursion;
    int turn, k;
    for (turn = 0; turn < 5; ++turn) {
        r->plain = turn == 2;
        vary(turn);
        LAW("what is convex is factorised", mbs_stages_factorise(r, 0) == -1 && r->dependent == 0 && r->singular == 0);
        for (k = 0; k < shape.stages; ++k)
            LAW("by derivatives that are there", !r->stage[k].inner.stale || sizes[k].inner == 0);
        solve_kkt("a system is solved");
        solve_kkt("and again");
        vary(turn + 1);
        mbs_stages_factorise(r, 1);
        solve_kkt("what is condensed stays");
        for (k = 0; k < shape.stages; ++k)
            if ((k + turn) % 2)
                draw_stage(k);
    }
}

/* Groups of at most four stages of one kind. */
static void group(void)
{
    static const int begin[13] = {0, 4, 4, 4, 4, 6, 6, 10, 10, 10, 10, 11, 12};
    int k;
    open_kkt(&sparse_stages, 0);
    for (k = 0; k <= 12; ++k)
        LAW("groups begin where the kind changes, or after four", mbs_stages_group(&kkt->recursion, k) == begin[k]);
    for (k = 0; k < 12; ++k)
        if (begin[k] == k)
            LAW("and end where the next one begins", mbs_stages_after_group(&kkt->recursion, k) == begin[k + 1]);
}

/* Where variables are in the recursion, and how inner ones follow the others. */
static void place(void)
{
    mbs_stages_recursion *r;
    const mbs_stages_stage *t;
    real z[MOST], out[MOST], outer[MOST], sum;
    int i, j;
    open_kkt(&sparse_stages, 0);
    r = &kkt->recursion, t = &r->stage[1];
    mbs_stages_factorise(r, 0);
    for (i = 0; i < t->n; ++i) {
        const int inner = i >= 6 && i < 11;
        LAW("inner variables have no place", mbs_stages_outer(t, i) == (inner ? -1 : i < 6 ? i : i - 5));
        LAW("they alone have a variation", (mbs_stages_variation(t, i) != NULL) == inner);
        z[i] = 1 + (real)i, out[i] = 100;
    }
    for (i = 0; i < 5; ++i)
        for (j = 0; j < 9; ++j) {
            int l;
            for (l = 0, sum = entries[1][0][i * MOST + (j < 6 ? j : j + 5)]; l < 5; ++l)
                sum += entries[1][0][i * MOST + 6 + l] * mbs_stages_variation(t, 6 + l)[j];
            LAW("equations hold where the others change", real_abs(sum) < (real)1e-12);
        }
    r->stage[1].curvature = 0.5;
    mbs_stages_apply_curvature(t, z, out);
    for (i = 0; i < t->n; ++i)
        LAW("curvature is of the others", out[i] == (i >= 6 && i < 11 ? 100 : 100 + z[i] / 2));
    r->stage[1].curvature = 0;
    mbs_stages_apply_curvature(t, z, out);
    for (i = 0; i < t->n; ++i)
        LAW("where there is some", out[i] == (i >= 6 && i < 11 ? 100 : 100 + z[i] / 2));
    for (i = 0; i < MOST; ++i)
        outer[i] = i < 9 ? draw() : 0;
    mbs_stages_condense_gradient(t, z, out);
    for (i = 0; i < t->dense.width; ++i) {
        for (j = 0, sum = i < 6 ? z[i] : i < 9 ? z[i + 5] : 0; j < 5; ++j)
            sum += i < 9 ? mbs_stages_variation(t, 6 + j)[i] * z[6 + j] : 0;
        LAW("a slope by the others has the part of inner ones",
            i < 9 ? real_abs(out[i] - sum) < (real)1e-12 : out[i] == 0);
    }
    memset(t->inner.constant, 0, 5 * sizeof *t->inner.constant);
    mbs_stages_expand(t, outer, z);
    for (i = 0; i < 5; ++i) {
        for (j = 0, sum = 0; j < t->n; ++j)
            sum += entries[1][0][i * MOST + j] * z[j];
        LAW("variables that belong to each other hold them", real_abs(sum) < (real)1e-12);
    }
    for (i = 0; i < 9; ++i)
        LAW("the others are as they are", z[i < 6 ? i : i + 5] == outer[i]);
}

/* Inner equations that do not give their variables: some of these go to the recursion, with their rows. */
static void defer_some(void)
{
    mbs_stages_recursion *r;
    real z[MOST] = {0}, out[MOST] = {0};
    int turn, k, i, l;
    for (turn = 0; turn < 4; ++turn) {
        open_kkt(&full_stages, turn % 2);
        r = &kkt->recursion;
        for (i = 0; i < 2; ++i) {
            vary(turn + i);
            for (k = 0; k < 6; ++k) {
                draw_stage(k);
                if ((k + turn + i) % 3 == 0)
                    lose_rank(k, turn < 2 ? 2 : 1);
            }
            LAW("singular inner equations are counted", mbs_stages_factorise(r, 0) == -1 && r->singular == 2);
            LAW("no row is lost", r->dependent == 0);
            solve_kkt("variables without equations are found with the others");
            vary(turn + i + 1);
            mbs_stages_factorise(r, 1);
            solve_kkt("with other compliances too");
            r->plain = 1;
            mbs_stages_factorise(r, 0);
            solve_kkt("or without curvature");
            r->plain = 0;
        }
        for (k = 0; k < 6; ++k) {
            const mbs_stages_inner *y = &r->stage[k].inner;
            LAW("as many are found so", y->deferred == ((k + turn + 1) % 3 ? 0 : turn < 2 ? 1 : 2));
            r->stage[k].curvature = 2;
            for (i = 0; i < r->stage[k].n; ++i)
                z[i] = 1, out[i] = 0;
            mbs_stages_apply_curvature(&r->stage[k], z, out);
            for (i = 0, l = 0; i < 3; ++i)
                l += out[2 + i] != 0;
            LAW("they have curvature", l == y->deferred);
        }
    }
}

/* Where states that no inner equation reads are skipped, a stage may lose rank, and have it again. */
static void defer_apart(void)
{
    mbs_stages_recursion *r;
    int turn, k;
    open_kkt(&sparse_stages, 0);
    r = &kkt->recursion;
    for (turn = 0; turn < 4; ++turn) {
        vary(turn);
        for (k = 6; k < 11; ++k)
            draw_stage(k);
        for (k = 7; k < 10 && turn % 2 == 0; k += 2)
            memset(&entries[k][0][2 * MOST + 6], 0, 6 * sizeof(real)), write_stage(k);
        LAW("some stages have singular equations",
            mbs_stages_factorise(r, 0) == -1 && r->singular == (turn % 2 ? 0 : 2));
        solve_kkt("all are solved whichever they are");
    }
}

/* More inner variables without an equation than there is room for: they stay,
    and their rows must hold by themselves. */
static void leave_many(void)
{
    mbs_stages_recursion *r;
    int i;
    open_kkt(&many_inner, 0);
    r = &kkt->recursion;
    for (i = 3; i < 12; ++i)
        memset(&entries[0][0][i * MOST], 0, MOST * sizeof(real));
    write_stage(0);
    mbs_stages_factorise(r, 0);
    LAW("one stage has singular equations", r->singular == 1 && r->stage[0].inner.missing == 9);
    LAW("as many variables as there is room for are found with others", r->stage[0].inner.deferred == 8);
    LAW("rows without numbers depend on others", r->dependent == 8);
    draw_right();
    for (i = 3; i < 12; ++i)
        rc[r->stage[0].e + i] = 0;
    mbs_stages_sweep(r, rw, rc, dw, dy);
    LAW("the equations hold", row_residual() < (real)1e-10 && r->left < (real)1e-10);
    for (i = 3; i < 12; ++i)
        rc[r->stage[0].e + i] = (real)0.25;
    mbs_stages_sweep(r, rw, rc, dw, dy);
    LAW("or leave what they lack", near(r->left, (real)0.25));
    for (i = 3; i < 12; ++i)
        rc[r->stage[0].e + i] = 0;
    mbs_stages_sweep(r, rw, rc, dw, dy);
    LAW("each time anew", r->left < (real)1e-10);
}

/* A row of e that is a sum of inner ones leaves rounding alone, which is no pivot. */
static void repeat_rows(void)
{
    mbs_stages_recursion *r;
    int turn, k, i, j;
    for (turn = 0; turn < 2; ++turn) {
        open_kkt(&full_stages, 0);
        r = &kkt->recursion;
        for (k = 0; k < 6; ++k) {
            for (j = 0; j < MOST; ++j)
                for (i = 0, entries[k][0][3 * MOST + j] = 0; i < 3; ++i)
                    entries[k][0][3 * MOST + j] += entries[k][0][i * MOST + j] * (real)(i + 1) * (real)1e6;
            entries[k][0][3 * MOST] += turn ? (real)100 : 0;
            write_stage(k);
        }
        LAW("a row that follows from inner ones", mbs_stages_factorise(r, 0) == -1);
        LAW("depends on them", r->dependent == (turn ? 0 : 6));
        draw_right();
        for (k = 0; k < 6 && !turn; ++k) {
            const int e = r->stage[k].e;
            rc[e + 3] = (real)1e6 * (rc[e] + 2 * rc[e + 1] + 3 * rc[e + 2]);
        }
        mbs_stages_sweep(r, rw, rc, dw, dy);
        LAW("a little more is a row", row_residual() < (real)1e-4 && slope_residual() < (real)1e-4);
    }
}

/* Any entry of the variation may be too large, either way. */
static void grow(void)
{
    mbs_stages_stage *t;
    int i, j;
    open_kkt(&full_stages, 0);
    t = &kkt->recursion.stage[0];
    memset(t->inner.V, 0, (size_t)(t->inner.n * t->inner.ld) * sizeof *t->inner.V);
    for (i = 0; i < t->inner.n; ++i)
        for (j = 0; j < t->dense.width; ++j) {
            real *entry = &t->inner.V[i * t->inner.ld + j];
            *entry = (i + j) % 2 ? 2 : -2;
            LAW("an entry grows", grows(t, (real)1.9) && !grows(t, 2));
            *entry = 0;
        }
}

/* Inner variables that follow the others by large factors cost digits: their small pivots are left to the recursion. */
static void mind(void)
{
    const real little[] = {(real)2.1 / MBS_STAGES_GROWTH, (real)0.5 / MBS_STAGES_GROWTH, (real)0.5 / MBS_STAGES_GROWTH};
    static const int at[] = {1, 2, 5};
    mbs_stages_recursion *r;
    int i, j, k;
    open_kkt(&full_stages, 0);
    r = &kkt->recursion;
    for (k = 0; k < 6; ++k) {
        for (i = 0; i < 3; ++i)
            for (j = 0; j < 8; ++j)
                entries[k][0][i * MOST + j] = (real)(i == j - 2) + (real)(i == 2 && (j == 3 || j == 6)) +
                    (real)(i == 0 && j == 7);
        for (i = 0; i < 3; ++i)
            if (at[i] == k)
                entries[k][0][2 * MOST + 4] = little[i];
        write_stage(k);
    }
    LAW("small pivots are used at first", mbs_stages_factorise(r, 0) == -1 && r->singular == 0);
    r->lost = 0;
    LAW("growth is borne while no digits are lost", mbs_stages_mind_growth(r, 0) == 0);
    r->lost = 1;
    LAW("growth is minded from a stage on", mbs_stages_mind_growth(r, 3) == 1);
    LAW("of all stages with too much of it", mbs_stages_mind_growth(r, 0) == 1);
    LAW("once", mbs_stages_mind_growth(r, 0) == 0);
    for (k = 0; k < 6; ++k)
        LAW("these are condensed anew",
            r->stage[k].inner.stale == (k == 2 || k == 5) && r->stage[k].inner.careful == (k == 2 || k == 5));
    LAW("their small pivots are none", mbs_stages_factorise(r, 0) == -1 && r->singular == 2);
    for (k = 0; k < 6; ++k)
        LAW("each", r->stage[k].inner.deferred == (k == 2 || k == 5));
    draw_right();
    mbs_stages_sweep(r, rw, rc, dw, dy);
    LAW("and all is solved", row_residual() < (real)1e-9);
    mbs_stages_forget_orders(r);
    for (k = 0; k < 6; ++k)
        LAW("a new solve begins without it",
            !r->stage[k].inner.careful && r->stage[k].inner.stale && !r->stage[k].inner.own);
    mbs_stages_factorise(r, 0);
    LAW("with pivots of all sizes", r->singular == 0);
}

/* Let the first pivot of a stage be too small for the order of its kind, although its equations give the variables. */
static void spoil(int k, int is_spoiled)
{
    int i, j;
    draw_stage(k);
    for (i = 0; i < 3; ++i)
        for (j = 2; j < 5; ++j)
            entries[k][0][i * MOST + j] = (real)((is_spoiled ? (i + 1) % 3 : i) == j - 2);
    write_stage(k);
}

/* An order that fails in more than one of four stages is given up; the first stage where it failed gives the next. */
static void give_up(void)
{
    mbs_stages_recursion *r;
    const mbs_stages_pivots *p;
    int turn, k, i;
    for (turn = 0; turn < 2; ++turn) {
        open_kkt(&full_stages, 0);
        r = &kkt->recursion, p = r->stage[0].inner.pivots;
        for (k = 0; k < 6; ++k)
            spoil(k, 0);
        mbs_stages_factorise(r, 0);
        for (i = 0; i < 3; ++i)
            LAW("an order has the pivots of its numbers", p->ready && p->column[i] == p->row[i]);
        for (k = 3; k < 4 + turn; ++k)
            spoil(k, 1);
        mbs_stages_factorise(r, 0);
        LAW("a stage whose pivots it spoils finds its own",
            r->stage[3].inner.own && !r->stage[2].inner.own && r->singular == 0);
        solve_kkt("exactly");
        mbs_stages_factorise(r, 0);
        for (i = 0; i < 3; ++i)
            LAW("an order that fails often is replaced",
                p->ready && p->row[i] == (turn ? (p->column[i] + 2) % 3 : p->column[i]));
        LAW("by the first stage where it failed", p->failed == turn + 1 && p->stages == 6);
        LAW("which needs no own one then", r->stage[3].inner.own == 1 - turn);
        LAW("while others do", r->stage[2].inner.own == turn);
        solve_kkt("all are solved");
        if (turn) /* the new order fails in four of six */
            mbs_stages_factorise(r, 0);
        for (i = 0; i < 3 && turn; ++i)
            LAW("and that one too", p->row[i] == p->column[i]);
    }
}

/* Stages with singular equations give no order: the next one does, after three tries in the next factorisation. */
static void try_orders(void)
{
    mbs_stages_recursion *r;
    const mbs_stages_pivots *p;
    int k, count;
    for (count = 0; count <= 6; ++count) {
        open_kkt(&full_stages, 0);
        r = &kkt->recursion, p = r->stage[0].inner.pivots;
        for (k = 0; k < count; ++k)
            lose_rank(k, 2);
        mbs_stages_factorise(r, 0);
        LAW("one of the first stages gives an order", p->ready == (count < 3));
        LAW("all is solved without one too", r->singular == count);
        solve_kkt("exactly");
        mbs_stages_factorise(r, 0);
        LAW("others are tried next", p->ready == (count < 6));
        solve_kkt("exactly too");
        mbs_stages_factorise(r, 0);
        LAW("where none gives one, the first is tried again", count < 6 || p->stage == 0 || p->stage == 3);
    }
}

/* A solve does not depend on the solves before it: it has the same digits. */
static void forget(void)
{
    static real fresh[STAGES][4][MOST * MOST];
    real before[2][ALL];
    mbs_stages_recursion *r;
    int turn, k;
    open_kkt(&full_stages, 0);
    r = &kkt->recursion;
    lose_rank(0, 2);
    memcpy(fresh, entries, sizeof fresh);
    for (turn = 0; turn < 2; ++turn) {
        const unsigned seed = 3;
        memcpy(entries, fresh, sizeof fresh);
        for (k = 0; k < 6; ++k)
            write_stage(k);
        mbs_stages_forget_orders(r);
        mbs_stages_factorise(r, 0);
        LAW("the first stage with an order gives it",
            r->stage[0].inner.pivots->ready && r->stage[0].inner.pivots->stage == 1);
        kkt_seed = seed;
        draw_right();
        mbs_stages_sweep(r, rw, rc, dw, dy);
        LAW("variables are the same", !turn || !memcmp(before[0], dw, (size_t)kkt->variables * sizeof *dw));
        LAW("and multipliers", !turn || !memcmp(before[1], dy, (size_t)kkt->rows * sizeof *dy));
        memcpy(before[0], dw, sizeof dw), memcpy(before[1], dy, sizeof dy);
        for (k = 0; k < 6; ++k)
            spoil(k, 1);
        mbs_stages_factorise(r, 0), mbs_stages_factorise(r, 0);
    }
}

int main(void)
{
    int i, turn;
    for (i = 0; i < 3; ++i)
        for (turn = 0; turn < 2; ++turn) {
            open_kkt(shapes[i], turn);
            solve_all();
        }
    group();
    place();
    defer_some();
    defer_apart();
    leave_many();
    repeat_rows();
    grow();
    mind();
    give_up();
    try_orders();
    forget();
    return broken > 0;
}
