/* Exact relations of two triangles: the general case and the coplanar ones (see triangles.h). */
#include "triangles.h"

#include "vhp.h"

int vhp_projection_axis(const double *a, const double *b, const double *c)
{
    const Plane p = plane_of(a, b, c);
    int axis = 0;
    if (fabs(p.normal[1]) > fabs(p.normal[0]))
        axis = 1;
    if (fabs(p.normal[2]) > fabs(p.normal[axis]))
        axis = 2;
    for (int tries = 0; tries < 3; tries++, axis = (axis + 1) % 3)
        if (orient2d_along(axis, a, b, c))
            return axis;
    return -1;
}

/* All of `other` lies outside the line through edge p, q of a triangle that runs round as `turn`:
 * -1 strictly, 0 if some of it lies on the line, 1 if not outside. */
static int outside_edge(int axis, int turn, const double *p, const double *q, const double *const other[3])
{
    int nearest = -1;
    for (int k = 0; k < 3; k++) {
        const int side = turn * orient2d_along(axis, p, q, other[k]);
        if (side > nearest)
            nearest = side;
    }
    return nearest;
}

/* Two triangles in one plane: two convex sets are apart (have no common interior) exactly if the line
 * through an edge of one of them separates them strictly (weakly). */
static int coplanar_triangles_meet(const double *const a[3], const double *const b[3])
{
    const int axis = vhp_projection_axis(a[0], a[1], a[2]);
    const int turn_a = orient2d_along(axis, a[0], a[1], a[2]), turn_b = orient2d_along(axis, b[0], b[1], b[2]);
    int kind = KIND_COPLANAR;
    for (int e = 0; e < 3; e++) {
        const int next = e == 2 ? 0 : e + 1;
        const int of_b = outside_edge(axis, turn_a, a[e], a[next], b);
        const int of_a = outside_edge(axis, turn_b, b[e], b[next], a);
        if (of_a < 0 || of_b < 0)
            return APART;
        if (of_a == 0 || of_b == 0)
            kind = KIND_TOUCH;
    }
    return kind;
}

/* Bring the vertex that is alone on its side of the other plane to the front, keeping the cyclic
 * order; returns 1 if it is on the positive side, -1 on the negative. A vertex on the plane counts
 * to the pair unless both others are on one side or on the plane with it. */
static int lone_vertex_first(const double *vertices[3], const int sides[3])
{
    static const int next[3] = {1, 2, 0};
    int lone = 0, side = 0;
    for (int k = 0; k < 3 && !side; k++) {
        const int s = sides[k], t = sides[next[k]], u = sides[next[next[k]]];
        if (s > 0 && t <= 0 && u <= 0)
            side = 1;
        else if (s < 0 && t >= 0 && u >= 0)
            side = -1;
        else if (s == 0 && t == u) /* both strictly on one side; three zeros never come here */
            side = -t;
        lone = k;
    }
    const double *first = vertices[lone], *second = vertices[next[lone]], *third = vertices[next[next[lone]]];
    vertices[0] = first;
    vertices[1] = second;
    vertices[2] = third;
    return side;
}

static inline int on_one_side(const int sides[3])
{
    return (sides[0] > 0 && sides[1] > 0 && sides[2] > 0) || (sides[0] < 0 && sides[1] < 0 && sides[2] < 0);
}

static inline int straddles(const int sides[3])
{
    return (sides[0] > 0 || sides[1] > 0 || sides[2] > 0) && (sides[0] < 0 || sides[1] < 0 || sides[2] < 0);
}

static inline void swap(const double **p, const double **q)
{
    const double *kept = *p;
    *p = *q;
    *q = kept;
}

/* Guigue & Devillers 2003, Fast and robust triangle-triangle overlap test using orientation
 * predicates: each triangle cuts the common line of the planes in a closed interval. With a0 and b0
 * alone above the other's plane, the line runs along na x nb; the interval of a ends at a0a2 and
 * a0a1, that of b at b0b1 and b0b2, and the order of two ends is an orient3d. */
int vhp_triangles_meet(const double *const a[3], const double *const b[3])
{
    const Plane plane_a = plane_of(a[0], a[1], a[2]);
    const int sides_b[3] = {plane_side(&plane_a, b[0]), plane_side(&plane_a, b[1]), plane_side(&plane_a, b[2])};
    if (on_one_side(sides_b))
        return APART;
    if (!sides_b[0] && !sides_b[1] && !sides_b[2])
        return coplanar_triangles_meet(a, b);
    const Plane plane_b = plane_of(b[0], b[1], b[2]);
    const int sides_a[3] = {plane_side(&plane_b, a[0]), plane_side(&plane_b, a[1]), plane_side(&plane_b, a[2])};
    if (on_one_side(sides_a))
        return APART;

    const double *p[3] = {a[0], a[1], a[2]}, *q[3] = {b[0], b[1], b[2]};
    const int side_p = lone_vertex_first(p, sides_a), side_q = lone_vertex_first(q, sides_b);
    if (side_p < 0) /* turn the other plane over */
        swap(&q[1], &q[2]);
    if (side_q < 0)
        swap(&p[1], &p[2]);
    const int upper = -orient3d(p[0], p[1], q[0], q[1]);
    if (upper < 0)
        return APART;
    const int lower = orient3d(p[0], p[2], q[0], q[2]);
    if (lower < 0)
        return APART;
    return upper && lower && straddles(sides_a) && straddles(sides_b) ? KIND_CROSSING : KIND_TOUCH;
}

/* Place of direction v -> x in the angle from v -> p counter-clockwise to v -> q (less than 180
 * degrees): 1 inside, 0 on a leg, -1 outside. */
static int place_in_angle(int axis, int turn, const double *v, const double *p, const double *q, const double *x)
{
    const int after = turn * orient2d_along(axis, v, p, x), before = turn * orient2d_along(axis, v, x, q);
    if (after < 0 || before < 0)
        return -1;
    return after && before;
}

int vhp_corners_meet(const double *v, const double *p, const double *q, const double *r, const double *s)
{
    const int axis = vhp_projection_axis(v, p, q);
    const int turn_p = orient2d_along(axis, v, p, q), turn_r = orient2d_along(axis, v, r, s);
    const int r_in_pq = place_in_angle(axis, turn_p, v, p, q, r), s_in_pq = place_in_angle(axis, turn_p, v, p, q, s);
    const int p_in_rs = place_in_angle(axis, turn_r, v, r, s, p), q_in_rs = place_in_angle(axis, turn_r, v, r, s, q);
    if (r_in_pq > 0 || s_in_pq > 0 || p_in_rs > 0 || q_in_rs > 0)
        return KIND_COPLANAR;
    if (r_in_pq < 0 && s_in_pq < 0 && p_in_rs < 0 && q_in_rs < 0)
        return APART;
    /* Only legs meet: both pairs (the same angle), or one (side by side). */
    return r_in_pq == 0 && s_in_pq == 0 ? KIND_COPLANAR : KIND_TOUCH;
}

int vhp_wings_meet(const double *a, const double *b, const double *c, const double *d)
{
    const int axis = vhp_projection_axis(a, b, c);
    return orient2d_along(axis, a, b, c) == orient2d_along(axis, a, b, d) ? KIND_FOLD : APART;
}

int vhp_point_on_triangle(const double *point, const double *a, const double *b, const double *c)
{
    if (orient3d(a, b, c, point))
        return 0;
    const int axis = vhp_projection_axis(a, b, c);
    const int turn = orient2d_along(axis, a, b, c);
    return turn * orient2d_along(axis, a, b, point) >= 0 && turn * orient2d_along(axis, b, c, point) >= 0 &&
           turn * orient2d_along(axis, c, a, point) >= 0;
}

/* Kinds of `count` pairs of triangles (count, 2, 3, 3), for the tests; degenerate ones are apart. */
VHP_EXPORT void vhp_triangle_pairs(const double *pairs, int64_t count, uint8_t *kinds)
{
    for (int64_t i = 0; i < count; i++) {
        const double *t = pairs + 18 * i;
        const double *a[3] = {t, t + 3, t + 6}, *b[3] = {t + 9, t + 12, t + 15};
        kinds[i] = APART;
        if (vhp_projection_axis(a[0], a[1], a[2]) >= 0 && vhp_projection_axis(b[0], b[1], b[2]) >= 0)
            kinds[i] = (uint8_t)vhp_triangles_meet(a, b);
    }
}
