/* The first face that each of many rays meets: how thick a wall is under a point of its surface. */
#include <math.h>
#include <string.h>

#include "tree.h"
#include "vector.h"
#include "vhp.h"

/* A ray, seen along itself: axis z is the one along which its direction is longest, and the shear moves
 * every point along x and y so that the ray runs along z (Woop, Benthin & Wald 2013, Watertight ray/triangle
 * intersection). An edge is then left or right of the ray by one product of coordinates, the same but for
 * its sign for both faces at the edge: no ray slips through between them. */
typedef struct {
    const double *origin, *direction;
    double inverse[3];     /* 1 / direction; unused where that is 0 */
    int x, y, z;
    double shear_x, shear_y, scale;
    double nearest;        /* how far up to now, in units of the direction */
} Ray;

static void ray_of(Ray *ray, const double *origin, const double *direction)
{
    ray->origin = origin;
    ray->direction = direction;
    ray->z = 0;
    for (int d = 0; d < 3; d++) {
        ray->inverse[d] = direction[d] != 0 ? 1 / direction[d] : 0;
        if (fabs(direction[d]) > fabs(direction[ray->z]))
            ray->z = d;
    }
    ray->x = (ray->z + 1) % 3;
    ray->y = (ray->z + 2) % 3;
    ray->scale = 1 / direction[ray->z];
    ray->shear_x = direction[ray->x] * ray->scale;
    ray->shear_y = direction[ray->y] * ray->scale;
    ray->nearest = INFINITY;
}

/* 1 if the ray may meet the box at or before its nearest hit, and not before `behind`. */
static inline int ray_meets_box(const Ray *ray, const float *box, double behind)
{
    double enter = behind, leave = ray->nearest;
    for (int d = 0; d < 3; d++) {
        const double low = (double)box[d] - ray->origin[d], high = (double)box[3 + d] - ray->origin[d];
        if (ray->direction[d] == 0) {
            if (low > 0 || high < 0)
                return 0;
            continue;
        }
        const double at_low = low * ray->inverse[d], at_high = high * ray->inverse[d];
        const double first = at_low < at_high ? at_low : at_high, last = at_low < at_high ? at_high : at_low;
        /* Outward by more than the roundings. */
        const double early = first * (first > 0 ? 1 - 1e-14 : 1 + 1e-14);
        const double late = last * (last > 0 ? 1 + 1e-14 : 1 - 1e-14);
        enter = early > enter ? early : enter;
        leave = late < leave ? late : leave;
    }
    return enter <= leave;
}

/* Place along the ray at which it meets the face, or infinity. */
static double meet_face(const Tree *tree, int64_t face, const Ray *ray)
{
    double x[3], y[3], z[3];
    for (int k = 0; k < 3; k++) {
        double offset[3];
        subtract(corner(tree, face, k), ray->origin, offset);
        z[k] = offset[ray->z];
        x[k] = offset[ray->x] - ray->shear_x * z[k];
        y[k] = offset[ray->y] - ray->shear_y * z[k];
    }
    const double u = x[2] * y[1] - y[2] * x[1];
    const double v = x[0] * y[2] - y[0] * x[2];
    const double w = x[1] * y[0] - y[1] * x[0];
    if ((u < 0 || v < 0 || w < 0) && (u > 0 || v > 0 || w > 0))
        return INFINITY;
    const double sum = u + v + w;
    if (sum == 0)
        return INFINITY;
    return (u * z[0] + v * z[1] + w * z[2]) / sum * ray->scale;
}

/* The first face with an area that the ray meets, but for `ignored`; -1 if there is none. */
static int64_t first_face(const Tree *tree, Ray *ray, int32_t ignored, double behind)
{
    int64_t waiting[WALK_DEPTH], found = -1;
    int count = 0;
    waiting[count++] = 0;
    while (count) {
        const int64_t node = waiting[--count];
        if (!ray_meets_box(ray, node_box(tree, node), behind))
            continue;
        if (!is_leaf(tree, node)) {
            /* The half toward which the ray comes first, by the middles of the boxes, goes on top. */
            const float *left = node_box(tree, 2 * node + 1), *right = node_box(tree, 2 * node + 2);
            double ahead = 0;
            for (int d = 0; d < 3; d++)
                ahead += ((double)left[d] + left[3 + d] - right[d] - right[3 + d]) * ray->direction[d];
            waiting[count++] = 2 * node + (ahead > 0 ? 1 : 2);
            waiting[count++] = 2 * node + (ahead > 0 ? 2 : 1);
            continue;
        }
        const int64_t end = leaf_begin(tree, node + 1);
        for (int64_t face = leaf_begin(tree, node); face < end && face < tree->n_regular; face++) {
            if (tree->numbers[face] == ignored || !ray_meets_box(ray, face_box(tree, face), behind))
                continue;
            const double place = meet_face(tree, face, ray);
            if (place >= behind && place < ray->nearest) {
                ray->nearest = place;
                found = face;
            }
        }
    }
    return found;
}

/* First hit of each ray that starts at a point and runs along its direction, which has the length 1.
 *
 * ignored (n_rays): a face, as numbered by the caller, that the ray passes; -1: none. Points up to `behind`
 * before the start count as at it. distances, cosines (n_rays): how far, and the cosine of the angle between
 * the ray and the normal of the face it meets; faces (n_rays). Infinity, 0 and -1 where there is none. */
VHP_EXPORT void vhp_first_hits(const Tree *tree, const double *points, const double *directions,
                               const int32_t *ignored, int64_t n_rays, double behind, double *distances,
                               double *cosines, int32_t *faces)
{
    for (int64_t i = 0; i < n_rays; i++) {
        Ray ray;
        int64_t face = -1;
        const double *direction = directions + 3 * i;
        distances[i] = INFINITY;
        cosines[i] = 0;
        faces[i] = -1;
        if (!(dot(direction, direction) > 0.5) || !tree->n_regular)
            continue;
        ray_of(&ray, points + 3 * i, direction);
        face = first_face(tree, &ray, ignored[i], -behind);
        if (face < 0)
            continue;
        const Plane plane = plane_of(corner(tree, face, 0), corner(tree, face, 1), corner(tree, face, 2));
        const double length = sqrt(dot(plane.normal, plane.normal));
        distances[i] = ray.nearest > 0 ? ray.nearest : 0;
        cosines[i] = length > 0 ? dot(plane.normal, direction) / length : 0;
        faces[i] = tree->numbers[face];
    }
}
