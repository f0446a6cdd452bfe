/* Exact relations of two triangles that are not degenerate. */
#ifndef VHP_TRIANGLES_H
#define VHP_TRIANGLES_H

#include "predicates.h"

/* How two faces meet. Crossing: their relative interiors meet and their planes differ. Coplanar:
 * their interiors overlap in one plane. Fold and duplicate are the same for faces that share an
 * edge, or all three vertices. Touch: any other point in common (a vertex or edge on the other). */
enum { APART = 0, KIND_TOUCH = 1, KIND_COPLANAR = 2, KIND_CROSSING = 3, KIND_FOLD = 4, KIND_DUPLICATE = 5, KINDS = 6 };

/* Coordinate axis along which the triangle is seen with an area other than zero, preferably a
 * large one; -1 if its area is exactly zero. */
int vhp_projection_axis(const double *a, const double *b, const double *c);

/* Closed triangles a and b (three vertices each) without a shared vertex. */
int vhp_triangles_meet(const double *const a[3], const double *const b[3]);

/* Triangles (v, p, q) and (v, r, s) in one plane: how they meet apart from v. */
int vhp_corners_meet(const double *v, const double *p, const double *q, const double *r, const double *s);

/* Triangles (a, b, c) and (a, b, d) in one plane: KIND_FOLD if they lie on each other. */
int vhp_wings_meet(const double *a, const double *b, const double *c, const double *d);

/* 1 if the point lies on the closed triangle. */
int vhp_point_on_triangle(const double *point, const double *a, const double *b, const double *c);

/* Triangles (v, p, q) and (v, r, s): how they meet apart from v.
 *
 * If the planes differ, each triangle cuts their common line in a segment that starts at v, or only
 * in v. Seen from the side to which its normal n1 points, the first triangle lies counter-clockwise
 * around v, so its segment points along n1 x n2 if p is on the upper side of the other plane and
 * against it if q is; for the second triangle it is the other way round. So four signs decide. */
static inline int triangles_at_vertex_meet(const double *v, const double *p, const double *q, const double *r,
                                           const double *s)
{
    const Plane first = plane_of(v, p, q);
    const int side_r = plane_side(&first, r), side_s = plane_side(&first, s);
    if (side_r * side_s > 0)
        return APART;
    if (side_r == 0 && side_s == 0)
        return vhp_corners_meet(v, p, q, r, s);
    const Plane second = plane_of(v, r, s);
    const int side_p = plane_side(&second, p), side_q = plane_side(&second, q);
    if (side_p * side_q > 0 || (side_p > side_q) == (side_r > side_s))
        return APART;
    return side_p * side_q < 0 && side_r * side_s < 0 ? KIND_CROSSING : KIND_TOUCH;
}

/* Triangles (a, b, c) and (a, b, d). */
static inline int triangles_at_edge_meet(const double *a, const double *b, const double *c, const double *d)
{
    return orient3d(a, b, c, d) ? APART : vhp_wings_meet(a, b, c, d);
}

#endif
