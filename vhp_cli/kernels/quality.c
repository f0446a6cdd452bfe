/* Size and shape of the triangles, area, volume and dihedral angles. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#include "vector.h"
#include "vhp.h"

/* Indices into `totals`, mirrored in surface.py. */
enum {
    R_OUT_MIN,
    R_OUT_SUM,
    R_OUT_MAX,
    AREA,
    VOLUME,
    SURFACE_MOMENT,                     /* 3 values */
    VOLUME_MOMENT = SURFACE_MOMENT + 3, /* 3 values */
    REFERENCE = VOLUME_MOMENT + 3       /* 3 values: the point about which the moments are taken */
};

/* A triangle is degenerate if its area is below this share of its longest edge squared: the area of a triangle with
   collinear corners is not exactly 0 in floating point. */
static const double DEGENERATE = 1e-12;

typedef struct {
    double q, r_out, area;
    int degenerate;
} Shape;

/* q = 2 r_in / r_out = 16 A^2 / (a b c (a + b + c)) and r_out = a b c / (4 A) from two edge vectors and their cross
   product; a degenerate triangle has r_out = half its longest edge (thesis 2.1.3, 2.1.4). */
static Shape shape_of(const double *u, const double *v, const double *normal)
{
    double w[3];
    subtract(v, u, w);
    double a = sqrt(dot(u, u)), b = sqrt(dot(v, v)), c = sqrt(dot(w, w));
    double longest = a > b ? a : b;
    longest = longest > c ? longest : c;
    double product = a * b * c, perimeter = a + b + c, square = dot(normal, normal);
    Shape shape;
    shape.area = 0.5 * sqrt(square);
    shape.degenerate = !(shape.area > DEGENERATE * longest * longest); /* true for NaN as well */
    shape.q = product * perimeter > 0 ? 4 * square / (product * perimeter) : 0;
    if (shape.q > 1)
        shape.q = 1;
    shape.r_out = shape.degenerate ? 0.5 * longest : 0.25 * product / shape.area;
    return shape;
}

/* The same for triangles so small or large that the fourth powers of their edges leave the range of a double. */
static Shape shape_of_extreme(const double *u, const double *v, double largest)
{
    int exponent;
    if (!isfinite(largest))
        return (Shape){.q = 0, .r_out = NAN, .area = NAN, .degenerate = 1};
    double scaled_u[3], scaled_v[3], normal[3];
    frexp(largest, &exponent);
    for (int axis = 0; axis < 3; axis++) {
        scaled_u[axis] = ldexp(u[axis], -exponent);
        scaled_v[axis] = ldexp(v[axis], -exponent);
    }
    cross(scaled_u, scaled_v, normal);
    Shape shape = shape_of(scaled_u, scaled_v, normal);
    shape.area = ldexp(shape.area, 2 * exponent);
    shape.r_out = ldexp(shape.r_out, exponent);
    return shape;
}

static inline double largest_of(const double *u, const double *v)
{
    double largest = 0;
    for (int axis = 0; axis < 3; axis++) {
        double x = fabs(u[axis]), y = fabs(v[axis]);
        largest = x > largest ? x : largest;
        largest = y > largest ? y : largest;
    }
    return largest;
}

/* Quality of every face and the sums over the surface.

   component        (n), label below n_components, or -1 (counted in the totals only)
   q                (n), out
   degenerate       (n), out: numbers of the degenerate faces; returns how many there are, -1 when memory runs out
   component_volume, component_area   (n_components), out; the volume about a vertex of the component
   totals           out: see the enum. The volume is taken about the mean of the vertices, so that the figure is
                    accurate far from the origin. */
VHP_EXPORT int64_t vhp_quality(const double *vertices, int64_t n_vertices, const int32_t *faces, int64_t n,
                               const int32_t *component, int64_t n_components, double *q, int32_t *degenerate,
                               double *component_volume, double *component_area, double *totals)
{
    int64_t n_degenerate = 0;
    double mean[3] = {0, 0, 0}, surface_moment[3] = {0, 0, 0}, volume_moment[3] = {0, 0, 0};
    double area = 0, volume = 0, r_min = INFINITY, r_sum = 0, r_max = 0;
    int64_t *anchor = malloc(((size_t)n_components + 1) * sizeof *anchor); /* a vertex of each component */
    if (!anchor)
        return -1;
    for (int64_t i = 0; i < n_components; i++) {
        component_volume[i] = component_area[i] = 0;
        anchor[i] = -1;
    }
    for (int64_t i = 0; i < n_vertices; i++)
        for (int axis = 0; axis < 3; axis++)
            mean[axis] += vertices[3 * i + axis];
    for (int axis = 0; n_vertices && axis < 3; axis++)
        mean[axis] /= (double)n_vertices;

    for (int64_t i = 0; i < n; i++) {
        const double *a = vertices + 3 * (int64_t)faces[3 * i], *b = vertices + 3 * (int64_t)faces[3 * i + 1],
                     *c = vertices + 3 * (int64_t)faces[3 * i + 2];
        double u[3], v[3], normal[3], from_mean[3];
        subtract(b, a, u);
        subtract(c, a, v);
        cross(u, v, normal);
        double largest = largest_of(u, v);
        /* Edge lengths below 2^-200 or above 2^200 would under- or overflow in their fourth power. */
        Shape shape = largest == 0 || (largest > 6.2e-61 && largest < 1.6e60) ? shape_of(u, v, normal)
                                                                               : shape_of_extreme(u, v, largest);
        q[i] = shape.q;
        if (shape.degenerate)
            degenerate[n_degenerate++] = (int32_t)i;
        r_min = shape.r_out < r_min ? shape.r_out : r_min;
        r_max = shape.r_out > r_max ? shape.r_out : r_max;
        r_sum += shape.r_out;
        area += shape.area;
        subtract(a, mean, from_mean);
        double wedge = dot(from_mean, normal); /* six times the volume of the tetrahedron over this face */
        volume += wedge;
        for (int axis = 0; axis < 3; axis++) {
            double corner_sum = 3 * from_mean[axis] + u[axis] + v[axis];
            surface_moment[axis] += shape.area * corner_sum;
            volume_moment[axis] += wedge * corner_sum;
        }
        int32_t label = component[i];
        if (label < 0)
            continue;
        if (anchor[label] < 0)
            anchor[label] = faces[3 * i];
        double from_anchor[3];
        subtract(a, vertices + 3 * anchor[label], from_anchor);
        component_volume[label] += dot(from_anchor, normal);
        component_area[label] += shape.area;
    }
    free(anchor);
    for (int64_t i = 0; i < n_components; i++)
        component_volume[i] /= 6;
    totals[R_OUT_MIN] = r_min;
    totals[R_OUT_SUM] = r_sum;
    totals[R_OUT_MAX] = r_max;
    totals[AREA] = area;
    totals[VOLUME] = volume / 6;
    for (int axis = 0; axis < 3; axis++) {
        totals[SURFACE_MOMENT + axis] = surface_moment[axis] / 3;
        totals[VOLUME_MOMENT + axis] = volume_moment[axis] / 24;
        totals[REFERENCE + axis] = mean[axis];
    }
    return n_degenerate;
}

/* Angle between the half-planes that two faces span at their common edge, in degrees: 180 flat, 0 folded back.
   It does not depend on the orientation of the faces. NaN if a face has no area. Returns -1, or the number of the first
   edge that is not an edge of both its faces.

   With e the edge and p, q the vectors from its first vertex to the two opposite vertices, the normals e x p and
   e x q enclose the angle: its cosine and sine are in the ratio (e x p) . (e x q) : |e| |(e x p) . q|. */
VHP_EXPORT int64_t vhp_dihedral_angles(const double *vertices, const int32_t *faces, const int32_t *edges,
                                       const int32_t *edge_faces, int64_t n, double *degrees)
{
    const double per_radian = 57.29577951308232;
    for (int64_t i = 0; i < n; i++) {
        int32_t from = edges[2 * i], to = edges[2 * i + 1];
        const double *start = vertices + 3 * (int64_t)from;
        double edge[3], opposite[2][3], normal[2][3];
        subtract(vertices + 3 * (int64_t)to, start, edge);
        for (int side = 0; side < 2; side++) {
            const int32_t *face = faces + 3 * (int64_t)edge_faces[2 * i + side];
            int k = face[0] != from && face[0] != to ? 0 : face[1] != from && face[1] != to ? 1 : 2;
            int32_t third = face[k], one = face[k == 2 ? 0 : k + 1], two = face[k == 0 ? 2 : k - 1];
            if (!((one == from && two == to) || (one == to && two == from)))
                return i;
            subtract(vertices + 3 * (int64_t)third, start, opposite[side]);
            cross(edge, opposite[side], normal[side]);
        }
        double cosine = dot(normal[0], normal[1]), sine = sqrt(dot(edge, edge)) * fabs(dot(normal[0], opposite[1]));
        degrees[i] = cosine == 0 && sine == 0 ? NAN : atan2(sine, cosine) * per_radian;
    }
    return -1;
}
