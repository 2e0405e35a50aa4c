/* Points at which two solids touch: see mbs_solids.h. */
#include "mbs_solids.h"

#include <math.h>

#define PARALLEL 1e-7 /* the sine between edges that count as parallel */
#define FACES 1e-9    /* of the size: an axis of edges must part solids by more than one of a face, by this */
#define SAME 1e-9     /* of the size: points that are nearer are one */
#define LIES 1e-12    /* of the size: a point that is so near to a line lies on it */

typedef struct {
    const mbs_solid *shape;
    casadi_real *point, *normal; /* 3 each, in the base frame, from the origin of the second solid's frame */
} mbs_body;

typedef struct {
    mbs_body a, b;
    casadi_real size, radius, shift[3]; /* of both solids; the sum of the radii; the origin */
    casadi_real *ring, *next;           /* corners of a polygon, 3 each */
    casadi_int room;                    /* the largest number of corners of a polygon */
    casadi_int count, most;
    mbs_spot *spots;
} mbs_pair;

/* A direction from the second solid to the first one, and how far apart they are along it. */
typedef struct {
    casadi_real gap, n[3];
    casadi_int edges[2]; /* that cross, or -1 */
} mbs_axis;

static casadi_real dot3(const casadi_real *a, const casadi_real *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross3(const casadi_real *a, const casadi_real *b, casadi_real *c)
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

/* Write a + t (b - a). */
static void go(const casadi_real *a, const casadi_real *b, casadi_real t, casadi_real *x)
{
    casadi_int i;
    for (i = 0; i < 3; ++i)
        x[i] = a[i] + t * (b[i] - a[i]);
}

static void less(const casadi_real *a, const casadi_real *b, casadi_real *x)
{
    casadi_int i;
    for (i = 0; i < 3; ++i)
        x[i] = a[i] - b[i];
}

static casadi_int count_sides(const mbs_solid *s)
{
    casadi_int k, most = 0;
    for (k = 0; k < s->faces; ++k)
        if (s->start[k + 1] - s->start[k] > most)
            most = s->start[k + 1] - s->start[k];
    return most;
}

casadi_int mbs_solids_reals(const mbs_solid *first, const mbs_solid *other)
{
    return 3 * (first->points + first->faces + other->points + other->faces)
           + 6 * (count_sides(first) + count_sides(other) + 2);
}

static casadi_real *place(const mbs_solid *shape, const casadi_real *origin, const casadi_real *axes,
                          const casadi_real *shift, mbs_body *body, casadi_real *reals)
{
    casadi_int k, i, j;
    body->shape = shape, body->point = reals, body->normal = reals + 3 * shape->points;
    for (k = 0; k < shape->points + shape->faces; ++k, reals += 3) {
        const casadi_int is_point = k < shape->points;
        const casadi_real *own = is_point ? shape->point + 3 * k : shape->normal + 3 * (k - shape->points);
        for (i = 0; i < 3; ++i) {
            reals[i] = is_point ? origin[i] - shift[i] : 0;
            for (j = 0; j < 3; ++j)
                reals[i] += axes[3 * j + i] * own[j];
        }
    }
    return reals;
}

static casadi_real find_size(const mbs_solid *s)
{
    casadi_real most = 0;
    casadi_int k;
    for (k = 0; k < s->points; ++k)
        most = fmax(most, dot3(s->point + 3 * k, s->point + 3 * k));
    return sqrt(most);
}

static mbs_pair open_pair(const mbs_solid *first, const casadi_real *place_first, const casadi_real *axes_first,
                          const mbs_solid *other, const casadi_real *place_other, const casadi_real *axes_other,
                          casadi_int most, mbs_spot *spots, casadi_real *reals)
{
    mbs_pair p;
    const casadi_int sides = count_sides(first) + count_sides(other) + 2;
    casadi_int i;
    for (i = 0; i < 3; ++i)
        p.shift[i] = place_other[i];
    p.size = find_size(first) + find_size(other), p.radius = first->radius + other->radius;
    reals = place(first, place_first, axes_first, p.shift, &p.a, reals);
    p.ring = place(other, place_other, axes_other, p.shift, &p.b, reals);
    p.next = p.ring + 3 * sides, p.room = sides;
    p.count = 0, p.most = most, p.spots = spots;
    return p;
}

/* Return the largest n.x of a solid's points, and which it is. */
static casadi_real support(const mbs_body *s, const casadi_real *n, casadi_real sign, casadi_int *which)
{
    casadi_real most = -INFINITY;
    casadi_int k;
    for (k = 0; k < s->shape->points; ++k) {
        const casadi_real along = sign * dot3(n, s->point + 3 * k);
        if (along > most)
            most = along, *which = k;
    }
    return most;
}

static void set_axis(mbs_axis *axis, casadi_real gap, const casadi_real *n, casadi_real sign, casadi_int i, casadi_int j)
{
    casadi_int k;
    axis->gap = gap, axis->edges[0] = i, axis->edges[1] = j;
    for (k = 0; k < 3; ++k)
        axis->n[k] = sign * n[k];
}

/* Look along the normals of a solid's faces; `sign` is -1 for the first solid, whose normals point to the other one. */
static void look_at_faces(const mbs_body *own, const mbs_body *other, casadi_real sign, mbs_axis *best)
{
    casadi_int k, which;
    for (k = 0; k < own->shape->faces; ++k) {
        const casadi_real *n = own->normal + 3 * k;
        const casadi_real *on = own->point + 3 * own->shape->corner[own->shape->start[k]];
        const casadi_real gap = -support(other, n, -1, &which) - dot3(n, on);
        if (gap > best->gap)
            set_axis(best, gap, n, sign, -1, -1);
    }
}

/* Return whether the arcs of normals of two edges cross, so that both support their solids along one direction. */
static int arcs_cross(const mbs_pair *p, const casadi_int *e, const casadi_int *f)
{
    const casadi_real *A = p->a.normal + 3 * e[2], *B = p->a.normal + 3 * e[3];
    const casadi_real *C = p->b.normal + 3 * f[2], *D = p->b.normal + 3 * f[3]; /* seen from -C and -D */
    casadi_real ba[3], dc[3], cba, dba, adc, bdc;
    cross3(B, A, ba), cross3(D, C, dc);
    cba = -dot3(C, ba), dba = -dot3(D, ba), adc = dot3(A, dc), bdc = dot3(B, dc);
    return cba * dba < 0 && adc * bdc < 0 && cba * bdc > 0;
}

static void look_at_edges(const mbs_pair *p, mbs_axis *best)
{
    casadi_int i, j, which;
    for (i = 0; i < p->a.shape->edges; ++i)
        for (j = 0; j < p->b.shape->edges; ++j) {
            const casadi_int *e = p->a.shape->edge + 4 * i, *f = p->b.shape->edge + 4 * j;
            const casadi_int is_solid = e[2] >= 0 && f[2] >= 0;
            casadi_real d[3], g[3], n[3], length, sign, gap;
            if (is_solid && !arcs_cross(p, e, f))
                continue;
            less(p->a.point + 3 * e[1], p->a.point + 3 * e[0], d);
            less(p->b.point + 3 * f[1], p->b.point + 3 * f[0], g);
            cross3(d, g, n);
            length = sqrt(dot3(n, n));
            if (!(length > PARALLEL * sqrt(dot3(d, d) * dot3(g, g))))
                continue;
            n[0] /= length, n[1] /= length, n[2] /= length;
            if (is_solid) { /* normals of the second solid's edge point to the first one */
                sign = dot3(n, p->b.normal + 3 * f[2]) + dot3(n, p->b.normal + 3 * f[3]) < 0 ? -1 : 1;
                less(p->a.point + 3 * e[0], p->b.point + 3 * f[0], g);
                gap = sign * dot3(n, g);
            } else {
                const casadi_real up = -support(&p->a, n, -1, &which) - support(&p->b, n, 1, &which);
                const casadi_real down = -support(&p->a, n, 1, &which) - support(&p->b, n, -1, &which);
                sign = up < down ? -1 : 1, gap = fmax(up, down);
            }
            if (gap > best->gap)
                set_axis(best, gap, n, sign, i, j);
        }
}

/* Find the axis along which sharp hulls are the furthest apart. */
static mbs_axis find_axis(const mbs_pair *p)
{
    mbs_axis face, edge;
    casadi_real n[3];
    casadi_int which;
    face.gap = edge.gap = -INFINITY;
    look_at_faces(&p->b, &p->a, 1, &face);
    look_at_faces(&p->a, &p->b, -1, &face);
    look_at_edges(p, &edge);
    if (edge.gap > face.gap + FACES * p->size)
        return edge;
    if (face.gap > -INFINITY)
        return face;
    /* points, or segments in a line: along what joins them */
    less(p->a.point, p->b.point, n);
    if (!(dot3(n, n) > 0))
        n[0] = n[1] = 0, n[2] = 1;
    which = 0;
    set_axis(&face, 0, n, 1 / sqrt(dot3(n, n)), -1, -1);
    face.gap = -support(&p->a, face.n, -1, &which) - support(&p->b, face.n, 1, &which);
    return face;
}

/* Add a point in the middle between two surfaces, `gap` apart along n, if none is there. */
static void add(mbs_pair *p, const casadi_real *middle, const casadi_real *n, casadi_real gap)
{
    mbs_spot *spot = p->spots;
    casadi_real d[3];
    casadi_int k, i, last;
    for (k = 0; k < p->count; ++k) {
        for (i = 0; i < 3; ++i)
            d[i] = p->spots[k].at[i] - p->shift[i] - middle[i];
        if (dot3(d, d) <= SAME * SAME * p->size * p->size && dot3(p->spots[k].normal, n) > 1 - SAME)
            return;
    }
    if (p->count < p->most)
        spot += p->count++;
    else { /* the furthest one makes room */
        for (k = 0, last = 0; k < p->count; ++k)
            if (p->spots[k].gap > p->spots[last].gap)
                last = k;
        spot += last;
        if (spot->gap <= gap)
            return;
    }
    spot->gap = gap;
    for (i = 0; i < 3; ++i)
        spot->at[i] = p->shift[i] + middle[i], spot->normal[i] = n[i];
}

/* --- sharp hulls --- */

/* Return the face that looks the most along `sign` n. */
static casadi_int find_face(const mbs_body *s, const casadi_real *n, casadi_real sign)
{
    casadi_int k, best = 0;
    for (k = 1; k < s->shape->faces; ++k)
        if (sign * dot3(n, s->normal + 3 * k) > sign * dot3(n, s->normal + 3 * best))
            best = k;
    return best;
}

/* Cut a polygon by the side of n x (b - a) at a, seen along n; return its new number of corners. */
static casadi_int cut(mbs_pair *p, casadi_int corners, const casadi_real *a, const casadi_real *b, const casadi_real *n)
{
    casadi_real along[3], inward[3], d[3], here, there, length, *swap = p->ring;
    casadi_int k, found = 0;
    less(b, a, along);
    cross3(n, along, inward);
    length = sqrt(dot3(inward, inward));
    for (k = 0; k < corners; ++k) {
        const casadi_real *x = p->ring + 3 * k, *y = p->ring + 3 * ((k + 1) % corners);
        int is_in, goes_on;
        less(x, a, d), here = dot3(inward, d), is_in = here >= -LIES * p->size * length;
        less(y, a, d), there = dot3(inward, d), goes_on = there >= -LIES * p->size * length;
        if (is_in && found < p->room)
            go(x, x, 0, p->next + 3 * found++);
        if (is_in != goes_on && found < p->room)
            go(x, y, here / (here - there), p->next + 3 * found++);
    }
    p->ring = p->next, p->next = swap;
    return found;
}

/* Return how far a plane is from a point, along n. */
static casadi_real reach(const mbs_body *s, casadi_int face, const casadi_real *x, const casadi_real *n)
{
    const casadi_real *own = s->normal + 3 * face;
    casadi_real d[3];
    less(s->point + 3 * s->shape->corner[s->shape->start[face]], x, d);
    return dot3(own, d) / dot3(own, n);
}

/* Add the corners of the polygon that two faces share, seen along n. */
static void add_faces(mbs_pair *p, const mbs_axis *axis)
{
    const casadi_int own = find_face(&p->a, axis->n, -1), other = find_face(&p->b, axis->n, 1);
    const mbs_solid *A = p->a.shape, *B = p->b.shape;
    const casadi_int sides = B->start[other + 1] - B->start[other];
    casadi_int k, i, corners = 0;
    for (k = A->start[own]; k < A->start[own + 1]; ++k, ++corners)
        for (i = 0; i < 3; ++i)
            p->ring[3 * corners + i] = p->a.point[3 * A->corner[k] + i];
    for (k = 0; k < sides && corners; ++k) {
        const casadi_int *c = B->corner + B->start[other];
        corners = cut(p, corners, p->b.point + 3 * c[k], p->b.point + 3 * c[(k + 1) % sides], axis->n);
    }
    for (k = 0; k < corners; ++k) {
        const casadi_real *x = p->ring + 3 * k, up = reach(&p->a, own, x, axis->n), down = reach(&p->b, other, x, axis->n);
        casadi_real middle[3];
        for (i = 0; i < 3; ++i)
            middle[i] = x[i] + (up + down) / 2 * axis->n[i];
        add(p, middle, axis->n, up - down);
    }
}

/* Write where on two segments they are nearest: s and t, from 0 to 1. Returns whether they are parallel. */
static int approach(const casadi_real *a, const casadi_real *b, const casadi_real *c, const casadi_real *d,
                    casadi_real *s, casadi_real *t)
{
    casadi_real u[3], v[3], r[3], uu, vv, uv, ur, vr, det;
    less(b, a, u), less(d, c, v), less(a, c, r);
    uu = dot3(u, u), vv = dot3(v, v), uv = dot3(u, v), ur = dot3(u, r), vr = dot3(v, r);
    det = uu * vv - uv * uv;
    if (!(det > PARALLEL * PARALLEL * uu * vv))
        return 1;
    *s = (uv * vr - vv * ur) / det, *t = (uu * vr - uv * ur) / det;
    return 0;
}

static const casadi_real *end_of(const mbs_body *body, casadi_int edge, casadi_int which)
{
    return body->point + 3 * body->shape->edge[4 * edge + which];
}

/* Add the point where two edges cross. */
static void add_crossing(mbs_pair *p, const mbs_axis *axis)
{
    casadi_real s, t, x[3], y[3], middle[3];
    if (approach(end_of(&p->a, axis->edges[0], 0), end_of(&p->a, axis->edges[0], 1), end_of(&p->b, axis->edges[1], 0),
                 end_of(&p->b, axis->edges[1], 1), &s, &t))
        return;
    if (axis->gap > 0 && !(s >= 0 && s <= 1 && t >= 0 && t <= 1))
        return;
    go(end_of(&p->a, axis->edges[0], 0), end_of(&p->a, axis->edges[0], 1), fmin(1, fmax(0, s)), x);
    go(end_of(&p->b, axis->edges[1], 0), end_of(&p->b, axis->edges[1], 1), fmin(1, fmax(0, t)), y);
    go(x, y, 0.5, middle);
    add(p, middle, axis->n, axis->gap - p->radius);
}

/* Add the deepest corner, where nothing else is found. */
static void add_deepest(mbs_pair *p, const mbs_axis *axis)
{
    casadi_int own = 0, other = 0, i;
    casadi_real middle[3];
    support(&p->a, axis->n, -1, &own), support(&p->b, axis->n, 1, &other);
    for (i = 0; i < 3; ++i) /* of a solid with faces, the corner of the other one is deep in it */
        middle[i] = p->a.shape->faces && !p->b.shape->faces ? p->b.point[3 * other + i] + axis->gap / 2 * axis->n[i]
                                                            : p->a.point[3 * own + i] - axis->gap / 2 * axis->n[i];
    add(p, middle, axis->n, axis->gap - p->radius);
}

static void meet_sharp(mbs_pair *p, const mbs_axis *axis)
{
    casadi_real least = INFINITY;
    casadi_int k;
    if (axis->edges[0] >= 0)
        add_crossing(p, axis);
    if (p->radius == 0 && p->a.shape->faces && p->b.shape->faces)
        add_faces(p, axis);
    for (k = 0; k < p->count; ++k)
        least = fmin(least, p->spots[k].gap);
    if (least > 0 && (axis->gap <= p->radius || !p->a.shape->faces || !p->b.shape->faces))
        add_deepest(p, axis);
}

/* --- round hulls --- */

/* Add two points of the hulls that are nearest to each other, if they are apart. */
static void add_near(mbs_pair *p, const casadi_real *x, const casadi_real *y)
{
    casadi_real n[3], middle[3], length;
    casadi_int i;
    less(x, y, n);
    length = sqrt(dot3(n, n));
    if (!(length > LIES * p->size))
        return;
    for (i = 0; i < 3; ++i) {
        n[i] /= length;
        middle[i] = (x[i] + y[i] + n[i] * (p->b.shape->radius - p->a.shape->radius)) / 2;
    }
    add(p, middle, n, length - p->radius);
}

/* Return whether a point above a face lies within its sides. */
static int is_over(const mbs_body *s, casadi_int face, const casadi_real *x)
{
    const casadi_int *c = s->shape->corner + s->shape->start[face];
    const casadi_int sides = s->shape->start[face + 1] - s->shape->start[face];
    casadi_real along[3], inward[3], d[3];
    casadi_int k;
    for (k = 0; k < sides; ++k) {
        const casadi_real *a = s->point + 3 * c[k];
        less(s->point + 3 * c[(k + 1) % sides], a, along);
        cross3(s->normal + 3 * face, along, inward);
        less(x, a, d);
        if (dot3(inward, d) < 0)
            return 0;
    }
    return 1;
}

/* Write the point of a hull that is nearest to one outside. */
static void find_nearest(const mbs_body *s, const casadi_real *x, casadi_real *y)
{
    casadi_real best = INFINITY, d[3], u[3], z[3];
    casadi_int k, i;
    for (k = 0; k < s->shape->faces; ++k) {
        const casadi_real *n = s->normal + 3 * k;
        casadi_real above;
        less(x, s->point + 3 * s->shape->corner[s->shape->start[k]], d);
        above = dot3(n, d);
        if (above >= 0 && above < best && is_over(s, k, x)) {
            best = above;
            for (i = 0; i < 3; ++i)
                y[i] = x[i] - above * n[i];
        }
    }
    for (k = 0; k < s->shape->edges || (k == 0 && s->shape->points == 1); ++k) {
        const casadi_real *a = s->shape->edges ? end_of(s, k, 0) : s->point, *b = s->shape->edges ? end_of(s, k, 1) : a;
        casadi_real length;
        less(b, a, u), less(x, a, d);
        length = dot3(u, u);
        go(a, b, length > 0 ? fmin(1, fmax(0, dot3(u, d) / length)) : 0, z);
        less(x, z, d);
        if (sqrt(dot3(d, d)) < best) {
            best = sqrt(dot3(d, d));
            for (i = 0; i < 3; ++i)
                y[i] = z[i];
        }
    }
}

static void meet_round(mbs_pair *p)
{
    casadi_real x[3], y[3], s, t;
    casadi_int k, j;
    for (k = 0; k < p->a.shape->points; ++k) {
        find_nearest(&p->b, p->a.point + 3 * k, y);
        add_near(p, p->a.point + 3 * k, y);
    }
    for (k = 0; k < p->b.shape->points; ++k) {
        find_nearest(&p->a, p->b.point + 3 * k, x);
        add_near(p, x, p->b.point + 3 * k);
    }
    for (k = 0; k < p->a.shape->edges; ++k)
        for (j = 0; j < p->b.shape->edges; ++j) {
            const casadi_real *a = end_of(&p->a, k, 0), *b = end_of(&p->a, k, 1);
            const casadi_real *c = end_of(&p->b, j, 0), *d = end_of(&p->b, j, 1);
            if (approach(a, b, c, d, &s, &t) || !(s > 0 && s < 1 && t > 0 && t < 1))
                continue;
            go(a, b, s, x), go(c, d, t, y);
            add_near(p, x, y);
        }
}

static void meet(mbs_pair *p, int is_exact)
{
    const mbs_axis axis = find_axis(p);
    const int is_sharp = p->radius == 0 && p->a.shape->faces && p->b.shape->faces;
    if (axis.gap > LIES * p->size && (is_exact || !is_sharp))
        meet_round(p);
    else if (is_exact)
        add_deepest(p, &axis);
    else
        meet_sharp(p, &axis);
}

casadi_int mbs_solids_meet(const mbs_solid *first, const casadi_real *place_first, const casadi_real *axes_first,
                           const mbs_solid *other, const casadi_real *place_other, const casadi_real *axes_other,
                           casadi_int most, mbs_spot *spots, casadi_real *reals)
{
    mbs_pair p = open_pair(first, place_first, axes_first, other, place_other, axes_other, most, spots, reals);
    meet(&p, 0);
    return p.count;
}

void mbs_solids_distance(const mbs_solid *first, const casadi_real *place_first, const casadi_real *axes_first,
                         const mbs_solid *other, const casadi_real *place_other, const casadi_real *axes_other,
                         mbs_spot *nearest, casadi_real *reals)
{
    mbs_pair p = open_pair(first, place_first, axes_first, other, place_other, axes_other, 1, nearest, reals);
    meet(&p, 1);
}
