/* Points at which two solids touch, or would touch: convex hulls of points, rounded by radii.
 *
 * Normals point out of the other solid. Sharp hulls (both radii 0) have one normal n, the axis of the largest separation
 *
 *     s = max over n of (min of n.x over the first solid - max of n.y over the other one),
 *
 * over the normals of faces of both, and over the products of edges that support both (Gauss's arcs cross). Below 0,
 * -s is the depth: the least shift that parts them. The faces that look at each other, seen along n, have a polygon in
 * common; its corners are the points, with the distances along n. So a face on a face, or an edge on an edge, has all
 * points that bear. Where the polygon is empty, solids apart have no point; others touch at the deepest corner.
 *
 * Round hulls, apart from each other by d > 0 without their radii, touch by their parts: each corner and the nearest
 * point of the other hull, each two edges that cross; with their own normals, and distances less both radii.
 *
 * C99, reentrant, no allocation.
 */
#ifndef MBS_SOLIDS_H
#define MBS_SOLIDS_H

#include "mbs_abi.h"

#ifdef MBS_SINGLE /* names in object files say the precision */
#define mbs_solids_reals mbs_solids_reals_float
#define mbs_solids_meet mbs_solids_meet_float
#define mbs_solids_distance mbs_solids_distance_float
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* Corners of faces are in the order in which they go around, seen from outside: counterclockwise. A solid with one corner
 * or two has no faces. */
typedef struct {
    casadi_int points, faces, edges;
    casadi_real radius;
    const casadi_real *point;  /* 3 each, in the frame of the solid */
    const casadi_int *corner;  /* of all faces, one after the other */
    const casadi_int *start;   /* faces + 1: the first of each face in `corner` */
    const casadi_real *normal; /* 3 each, outward, of length 1 */
    const casadi_int *edge;    /* 4 each: two points, and the faces on both sides; -1: none */
} mbs_solid;

typedef struct {
    casadi_real gap, at[3], normal[3];
} mbs_spot;

/* Room for two solids. */
casadi_int mbs_solids_reals(const mbs_solid *first, const mbs_solid *other);

/* Write at most `most` points at which two solids touch; return how many. A pose is the place of the origin of the frame,
 * and its axes: 3 and 9 numbers, in columns. */
casadi_int mbs_solids_meet(const mbs_solid *first, const casadi_real *place_first, const casadi_real *axes_first,
                           const mbs_solid *other, const casadi_real *place_other, const casadi_real *axes_other,
                           casadi_int most, mbs_spot *spots, casadi_real *reals);

/* Write the distance of two solids, below 0 where they overlap, the middle between the points that are nearest, and the
 * normal there. */
void mbs_solids_distance(const mbs_solid *first, const casadi_real *place_first, const casadi_real *axes_first,
                         const mbs_solid *other, const casadi_real *place_other, const casadi_real *axes_other,
                         mbs_spot *nearest, casadi_real *reals);

#ifdef __cplusplus
}
#endif

#endif
