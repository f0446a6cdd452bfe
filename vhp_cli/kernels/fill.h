/* The polygon of a hole, and what its triangulations share. */
#ifndef VHP_FILL_H
#define VHP_FILL_H

#include <stdint.h>

#include "vector.h"

typedef struct {
    const double *points; /* (n, 3) */
    int64_t n;
    const int64_t *banned; /* sorted keys lower * n + upper */
    int64_t n_banned;
} Polygon;

static inline int is_banned(const Polygon *polygon, int64_t i, int64_t j)
{
    const int64_t key = i < j ? i * polygon->n + j : j * polygon->n + i;
    int64_t low = 0, high = polygon->n_banned;
    while (low < high) {
        const int64_t middle = low + (high - low) / 2;
        if (polygon->banned[middle] < key)
            low = middle + 1;
        else
            high = middle;
    }
    return low < polygon->n_banned && polygon->banned[low] == key;
}

static inline void face_normal(const double *a, const double *b, const double *c, double *normal)
{
    double u[3], v[3];
    subtract(b, a, u);
    subtract(c, a, v);
    cross(u, v, normal);
}

/* Twice the area vector of the polygon (Newell). */
static inline void area_vector(const Polygon *polygon, double *vector)
{
    vector[0] = vector[1] = vector[2] = 0;
    for (int64_t i = 1; i + 1 < polygon->n; i++) {
        double part[3];
        face_normal(polygon->points, polygon->points + 3 * i, polygon->points + 3 * (i + 1), part);
        for (int d = 0; d < 3; d++)
            vector[d] += part[d];
    }
}

/* Constrained Delaunay triangulation of the projection along the area vector (fill_plane.c). Returns the number of
 * faces, n - 2; 0 if there is none, as where the projection crosses itself; -1 if memory runs out. */
int64_t vhp_fill_in_plane(const Polygon *polygon, int32_t *faces);

#endif
