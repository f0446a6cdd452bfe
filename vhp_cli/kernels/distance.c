/* Distance of two triangles in double arithmetic (see distance.h).
 *
 * The distance is taken between a vertex and an edge, between the interiors of two edges or between
 * a vertex and the interior of a triangle; each case yields two points, and the least distance of
 * two points counts. Every candidate lies on its triangle up to rounding, so a distance is never too
 * small by more than rounding, a few u L (u = 2^-53, L the size of the two triangles and of the
 * distance; coordinates are subtracted first, so their absolute size has no influence beyond the one
 * rounding of each difference). Nor is it too large, since a wrong place along an edge or within a
 * triangle enters only squared: near-parallel edges use the cross product (error u / sin of the
 * angle, not its square), and slivers an orthogonal frame of base and height (the same); where the
 * angle is too small for that, the vertices and edges bound the same distance.
 * So the relative error is a few u L / distance: 1e-12 for a gap of 1e-3 L. */
#include "distance.h"

#include <math.h>

#include "vector.h"

/* The distance from a plane, or of two lines, rules out a pair if it is larger by this margin. Even for
 * a sliver the plane contains the triangle up to rounding; but nearly parallel edges leave the direction
 * in which they are farthest apart uncertain, and are compared in full: below this sine squared. */
#define SURELY (1 + 1e-6)
#define NEARLY_PARALLEL 0.01

/* origin + t * direction */
static inline void along(const double *origin, double t, const double *direction, double *point)
{
    for (int d = 0; d < 3; d++)
        point[d] = origin[d] + t * direction[d];
}

void vhp_shape_of(Shape *shape, const double *a, const double *b, const double *c)
{
    double length[3];
    shape->v[0] = a;
    shape->v[1] = b;
    shape->v[2] = c;
    shape->base = 0;
    for (int k = 0; k < 3; k++) {
        subtract(shape->v[k == 2 ? 0 : k + 1], shape->v[k], shape->edge[k]);
        length[k] = dot(shape->edge[k], shape->edge[k]);
        shape->inverse[k] = length[k] > 0 ? 1 / length[k] : 0;
        if (length[k] < length[shape->base])
            shape->base = k;
    }
    /* Height over the shortest edge: a needle's is known best there. */
    const double *base = shape->edge[shape->base];
    const double *back = shape->edge[shape->base == 0 ? 2 : shape->base - 1];
    const double inverse = shape->inverse[shape->base];
    shape->foot = -dot(back, base) * inverse;
    for (int d = 0; d < 3; d++)
        shape->height[d] = -back[d] - shape->foot * base[d];
    const double height = dot(shape->height, shape->height);
    shape->inverse_height = inverse > 0 && height > 0 ? 1 / height : 0;
    cross(base, shape->height, shape->normal);
    shape->inverse_normal = inverse * shape->inverse_height;
}

int vhp_plane_separates(const Shape *shape, const double *const points[3], double best)
{
    double heights[3], offset[3], least = INFINITY;
    for (int k = 0; k < 3; k++) {
        subtract(points[k], shape->v[0], offset);
        heights[k] = dot(offset, shape->normal);
        least = fabs(heights[k]) < least ? fabs(heights[k]) : least;
    }
    return heights[0] * heights[1] > 0 && heights[0] * heights[2] > 0 &&
           least * least * shape->inverse_normal > best * SURELY;
}

/* A vertex above the interior of a triangle. */
static inline double vertex_to_interior(const double *point, const Shape *shape, double best, double nearest[3])
{
    const double *origin = shape->v[shape->base], *base = shape->edge[shape->base];
    double offset[3];
    subtract(point, origin, offset);
    const double up = dot(offset, shape->height) * shape->inverse_height;
    if (!(up > 0 && up < 1))
        return best;
    const double place = dot(offset, base) * shape->inverse[shape->base];
    const double beside = place - up * shape->foot;
    if (!(beside > 0 && beside + up < 1))
        return best;
    for (int d = 0; d < 3; d++)
        offset[d] -= place * base[d] + up * shape->height[d];
    const double distance = dot(offset, offset);
    if (distance >= best)
        return best;
    subtract(point, offset, nearest);
    return distance;
}

static inline double vertex_to_edge(const double *point, const Shape *shape, int k, double best, double nearest[3])
{
    double offset[3];
    subtract(point, shape->v[k], offset);
    double t = dot(offset, shape->edge[k]) * shape->inverse[k];
    t = t > 0 ? (t < 1 ? t : 1) : 0;
    for (int d = 0; d < 3; d++)
        offset[d] -= t * shape->edge[k][d];
    const double distance = dot(offset, offset);
    if (distance >= best)
        return best;
    along(shape->v[k], t, shape->edge[k], nearest);
    return distance;
}

/* The interiors of two edges; `best` if one of them is nearest at an end. */
static inline double edge_to_edge(const Shape *a, int i, const Shape *b, int j, double best, double points[2][3])
{
    double normal[3], offset[3], moment[3];
    cross(a->edge[i], b->edge[j], normal);
    const double square = dot(normal, normal);
    if (!(square > 0))
        return best;
    subtract(b->v[j], a->v[i], offset);
    const double height = dot(offset, normal);
    if (height * height > best * square * SURELY && square * a->inverse[i] * b->inverse[j] > NEARLY_PARALLEL)
        return best;
    cross(offset, b->edge[j], moment);
    const double s = dot(moment, normal) / square;
    if (!(s > 0 && s < 1))
        return best;
    for (int d = 0; d < 3; d++)
        offset[d] -= s * a->edge[i][d];
    const double t = -dot(offset, b->edge[j]) * b->inverse[j];
    if (!(t > 0 && t < 1))
        return best;
    for (int d = 0; d < 3; d++)
        offset[d] += t * b->edge[j][d];
    const double distance = dot(offset, offset);
    if (distance >= best)
        return best;
    along(a->v[i], s, a->edge[i], points[0]);
    along(b->v[j], t, b->edge[j], points[1]);
    return distance;
}

static inline void copy(const double *from, double *to)
{
    to[0] = from[0];
    to[1] = from[1];
    to[2] = from[2];
}

double vhp_point_distance(const double *point, const Shape *shape, double best, double nearest[3])
{
    best = vertex_to_interior(point, shape, best, nearest);
    for (int k = 0; k < 3; k++)
        best = vertex_to_edge(point, shape, k, best, nearest);
    return best;
}

double vhp_shape_distance(const Shape *a, const Shape *b, double best, double points[2][3])
{
    for (int k = 0; k < 3; k++) {
        const double of_b = vhp_point_distance(b->v[k], a, best, points[0]);
        if (of_b < best) {
            copy(b->v[k], points[1]);
            best = of_b;
        }
        const double of_a = vhp_point_distance(a->v[k], b, best, points[1]);
        if (of_a < best) {
            copy(a->v[k], points[0]);
            best = of_a;
        }
    }
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            best = edge_to_edge(a, i, b, j, best, points);
    return best;
}
