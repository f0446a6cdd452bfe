/* A point at which two triangles meet, for display: rounding moves it, the verdict that they meet is exact. */
#include <math.h>
#include <stdint.h>

#include "vector.h"
#include "vhp.h"

#define SLACK 1e-9 /* of the face, so that rounding at its border loses no point */

/* Add the points in which the edges of one triangle pass through the other to `sum`; returns their number. */
static int add_edge_crossings(const double *edges, const double *face, double *sum)
{
    double u[3], v[3], normal[3], heights[3], offset[3], product[3];
    int found = 0;
    subtract(face + 3, face, u);
    subtract(face + 6, face, v);
    cross(u, v, normal);
    const double size = dot(normal, normal);
    for (int k = 0; k < 3; k++) {
        subtract(edges + 3 * k, face, offset);
        heights[k] = dot(offset, normal);
    }
    for (int k = 0; k < 3; k++) {
        const int next = k == 2 ? 0 : k + 1;
        if (heights[k] * heights[next] > 0 || heights[k] == heights[next])
            continue;
        const double share = heights[k] / (heights[k] - heights[next]);
        double point[3];
        for (int d = 0; d < 3; d++)
            point[d] = edges[3 * k + d] + (edges[3 * next + d] - edges[3 * k + d]) * share;
        /* Barycentric coordinates in the plane of the face. */
        subtract(point, face, offset);
        cross(offset, v, product);
        const double s = dot(product, normal) / size;
        cross(u, offset, product);
        const double t = dot(product, normal) / size;
        if (!(s >= -SLACK && t >= -SLACK && s + t <= 1 + SLACK))
            continue;
        for (int d = 0; d < 3; d++)
            sum[d] += point[d];
        found++;
    }
    return found;
}

/* The middle between the two nearest corners. */
static void between_corners(const double *a, const double *b, double *point)
{
    double least = INFINITY, offset[3];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            subtract(a + 3 * i, b + 3 * j, offset);
            const double square = dot(offset, offset);
            if (!(square < least))
                continue;
            least = square;
            for (int d = 0; d < 3; d++)
                point[d] = 0.5 * (a[3 * i + d] + b[3 * j + d]);
        }
}

/* first, second (count, 3, 3): triangles that are known to meet; points (count, 3), out: the mean of the points in
 * which their edges pass through the other, and where there are none (in one plane, or lost to rounding) the middle
 * between the two nearest corners. */
VHP_EXPORT void vhp_contact_points(const double *first, const double *second, int64_t count, double *points)
{
    for (int64_t i = 0; i < count; i++) {
        const double *a = first + 9 * i, *b = second + 9 * i;
        double *point = points + 3 * i;
        double sum[3] = {0, 0, 0};
        int found = add_edge_crossings(a, b, sum);
        found += add_edge_crossings(b, a, sum);
        if (!found) {
            between_corners(a, b, point);
            continue;
        }
        for (int d = 0; d < 3; d++)
            point[d] = sum[d] / found;
    }
}
