/* Join two loops by a band of triangles, as the cut through the wall of a vessel.

   After Fuchs, Kedem and Uselton 1977 (Optimal surface reconstruction from planar contours): a band is a path through
   the grid of pairs of corners, a step along either loop adds a triangle, and the best path is found by dynamic
   programming, here for several pairs to begin with. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#include "vector.h"
#include "vhp.h"

/* Mirrored in repairing.py. */
enum { BY_LENGTH = 0, BY_AREA = 1 };

static double step_cost(const double *a, const double *b, const double *c, int method)
{
    double u[3], v[3], normal[3];
    subtract(b, a, u);
    subtract(c, a, v);
    cross(u, v, normal);
    if (method == BY_AREA)
        return sqrt(dot(normal, normal));
    /* (a, b) is the new chord. */
    return dot(u, u);
}

typedef struct {
    const double *outer, *inner; /* (n, 3) and (m, 3), running the same way round */
    int64_t n, m;
    int method;
    double *cost;      /* one row of m + 1 */
    uint8_t *from;     /* (n + 1, m + 1): 1 if the last step was along the inner loop */
} Band;

static const double *outer_at(const Band *band, int64_t i) { return band->outer + 3 * (i % band->n); }
static const double *inner_at(const Band *band, int64_t j) { return band->inner + 3 * (j % band->m); }

/* Least cost of a band that begins between corner 0 of the outer loop and `start` of the inner one. */
static double best_path(Band *band, int64_t start)
{
    for (int64_t i = 0; i <= band->n; i++)
        for (int64_t j = 0; j <= band->m; j++) {
            const double *a = outer_at(band, i), *b = inner_at(band, start + j);
            double along_outer = INFINITY, along_inner = INFINITY;
            if (i)
                along_outer = band->cost[j] + step_cost(a, b, outer_at(band, i + band->n - 1), band->method);
            if (j)
                along_inner = band->cost[j - 1] + step_cost(a, b, inner_at(band, start + j + band->m - 1), band->method);
            band->from[i * (band->m + 1) + j] = along_inner < along_outer;
            band->cost[j] = i || j ? fmin(along_outer, along_inner) : 0;
        }
    return band->cost[band->m];
}

/* Triangulate the band between two loops that run the same way round.

   outer (n, 3), inner (m, 3)
   starts  (n_starts): corners of the inner loop to begin with, opposite corner 0 of the outer one
   method  BY_LENGTH: least sum of the squares of the chords; BY_AREA: least area
   faces   (n + m, 3), out: corners, those of the inner loop counted from n; the outer loop is run along, the inner one
           against its direction
   Returns 0, or -1 if memory runs out. */
VHP_EXPORT int32_t vhp_fill_band(const double *outer, int64_t n, const double *inner, int64_t m, const int32_t *starts,
                                 int64_t n_starts, int32_t method, int32_t *faces)
{
    Band band = {outer, inner, n, m, method, malloc(((size_t)m + 1) * sizeof(double)),
                 malloc(((size_t)n + 1) * ((size_t)m + 1))};
    if (!band.cost || !band.from) {
        free(band.cost);
        free(band.from);
        return VHP_OUT_OF_MEMORY;
    }
    int64_t best = 0;
    double least = INFINITY;
    for (int64_t s = 0; s < n_starts; s++) {
        const double cost = best_path(&band, starts[s]);
        if (cost < least) {
            least = cost;
            best = s;
        }
    }
    if (n_starts > 1)
        best_path(&band, starts[best]);
    int64_t i = n, j = m;
    for (int64_t f = 0; f < n + m; f++) {
        const int32_t a = (int32_t)(i % n), b = (int32_t)(n + (starts[best] + j) % m);
        int32_t *face = faces + 3 * f;
        if (band.from[i * (m + 1) + j]) {
            j--;
            face[0] = a;
            face[1] = b;
            face[2] = (int32_t)(n + (starts[best] + j) % m);
        } else {
            i--;
            face[0] = (int32_t)(i % n);
            face[1] = a;
            face[2] = b;
        }
    }
    free(band.cost);
    free(band.from);
    return 0;
}
