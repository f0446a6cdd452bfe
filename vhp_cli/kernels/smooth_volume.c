/* The volume of each component of a mesh, and an offset of its vertices that restores it. */
#include <float.h>
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "vector.h"
#include "vhp.h"

enum { MOST_STEPS = 50 };

/* A component's search for its offset. */
typedef struct {
    double offset, best_offset, best; /* where it is, where the volume came nearest, and by how much it missed there */
    double tolerance;
    int done;
} Search;

static int32_t find_root(int32_t *parent, int32_t i)
{
    while (parent[i] != i) {
        parent[i] = parent[parent[i]];
        i = parent[i];
    }
    return i;
}

/* Label the vertices of faces that are joined through common vertices, in the order of the lowest vertex of each
   component; -1 where no face uses the vertex. Returns the number of components. */
VHP_EXPORT int32_t vhp_smooth_components(const int32_t *faces, int64_t n, int64_t n_vertices, int32_t *label)
{
    /* The labels serve as the forest: the lower root wins, so that a root is the lowest vertex of its component. */
    for (int64_t v = 0; v < n_vertices; v++)
        label[v] = -1;
    for (int64_t corner = 0; corner < 3 * n; corner++)
        label[faces[corner]] = faces[corner];
    for (int64_t f = 0; f < n; f++)
        for (int k = 1; k < 3; k++) {
            int32_t one = find_root(label, faces[3 * f]), two = find_root(label, faces[3 * f + k]);
            if (one < two)
                label[two] = one;
            else
                label[one] = two;
        }
    for (int64_t v = 0; v < n_vertices; v++)
        if (label[v] >= 0)
            label[v] = find_root(label, (int32_t)v);
    int32_t components = 0;
    for (int64_t v = 0; v < n_vertices; v++)
        if (label[v] >= 0)
            label[v] = label[v] == (int32_t)v ? components++ : label[label[v]];
    return components;
}

/* Volume of every component: the sum of the signed tetrahedra between its faces and its anchor.

   label    (n_vertices): component of each vertex
   anchors  (n_components, 3)
   volumes  (n_components), out
   spreads  (n_components), out, or NULL: to the rounding error of a volume as 1 is to DBL_EPSILON */
VHP_EXPORT void vhp_smooth_volumes(const double *vertices, const int32_t *faces, int64_t n, const int32_t *label,
                                      int64_t n_components, const double *anchors, double *volumes, double *spreads)
{
    for (int64_t i = 0; i < n_components; i++) {
        volumes[i] = 0;
        if (spreads)
            spreads[i] = 0;
    }
    for (int64_t f = 0; f < n; f++) {
        int32_t component = label[faces[3 * f]];
        const double *a = vertices + 3 * (int64_t)faces[3 * f];
        double from_anchor[3], u[3], v[3], normal[3];
        subtract(a, anchors + 3 * (int64_t)component, from_anchor);
        subtract(vertices + 3 * (int64_t)faces[3 * f + 1], a, u);
        subtract(vertices + 3 * (int64_t)faces[3 * f + 2], a, v);
        cross(u, v, normal);
        volumes[component] += dot(from_anchor, normal) / 6;
        if (spreads)
            spreads[component] += sqrt(dot(from_anchor, from_anchor) * dot(u, u) * dot(v, v)) / 6;
    }
}

/* How fast the volume of each component grows when its vertices move along their normals with unit speed. */
static void growth(const double *vertices, const int32_t *faces, int64_t n, const int32_t *label, int64_t n_components,
                   const double *anchors, const double *normals, double *rates)
{
    for (int64_t i = 0; i < n_components; i++)
        rates[i] = 0;
    for (int64_t f = 0; f < n; f++) {
        int32_t component = label[faces[3 * f]];
        double from_anchor[3][3], normal[3];
        for (int k = 0; k < 3; k++)
            subtract(vertices + 3 * (int64_t)faces[3 * f + k], anchors + 3 * (int64_t)component, from_anchor[k]);
        for (int k = 0; k < 3; k++) {
            cross(from_anchor[(k + 1) % 3], from_anchor[(k + 2) % 3], normal);
            rates[component] += dot(normals + 3 * (int64_t)faces[3 * f + k], normal) / 6;
        }
    }
}

/* Move the free vertices of each component by one distance along their normals so that it has its target volume again;
   the distance by Newton's method on the volume, a cubic polynomial in it.

   vertices  (n_vertices, 3), in and out
   fixed     (n_vertices): 1 where a vertex stays
   normals   (n_vertices, 3), in and out: of unit length on entry, 0 where the vertex is fixed on return
   targets, spreads   (n_components): volumes to reach, and as vhp_smooth_volumes returns them for these
   closed    (n_components): 1 where the sign of the volume tells outside from inside; where it has changed, there is
             nothing to restore
   tolerance relative to the targets; where rounding does not allow it, as near as rounding does
   misses    (n_components), out: 1 where the volume was not reached; the component is then as on entry
   Returns 0, or -1 when memory runs out. */
VHP_EXPORT int32_t vhp_smooth_match(double *vertices, int64_t n_vertices, const int32_t *faces, int64_t n,
                                     const int32_t *label, int64_t n_components, const double *anchors,
                                     const uint8_t *fixed, double *normals, const double *targets,
                                     const double *spreads, const uint8_t *closed, double tolerance,
                                     uint8_t *misses)
{
    size_t count = (size_t)n_components + 1, size = 3 * (size_t)n_vertices + 1;
    Search *searches = calloc(count, sizeof *searches);
    double *volumes = malloc(count * sizeof *volumes), *rates = malloc(count * sizeof *rates);
    double *base = malloc(size * sizeof *base);
    if (!searches || !volumes || !rates || !base) {
        free(searches);
        free(volumes);
        free(rates);
        free(base);
        return VHP_OUT_OF_MEMORY;
    }
    memcpy(base, vertices, 3 * (size_t)n_vertices * sizeof *base);
    for (int64_t v = 0; v < n_vertices; v++)
        for (int axis = 0; fixed[v] && axis < 3; axis++)
            normals[3 * v + axis] = 0;
    for (int64_t i = 0; i < n_components; i++) {
        double rounding = 4 * DBL_EPSILON * spreads[i], relative = tolerance * fabs(targets[i]);
        searches[i].best = INFINITY;
        searches[i].tolerance = relative > rounding ? relative : rounding;
    }
    int64_t left = n_components;
    for (int step = 0; left && step < MOST_STEPS; step++) {
        vhp_smooth_volumes(vertices, faces, n, label, n_components, anchors, volumes, NULL);
        growth(vertices, faces, n, label, n_components, anchors, normals, rates);
        for (int64_t i = 0; i < n_components; i++) {
            Search *search = searches + i;
            if (search->done)
                continue;
            double excess = volumes[i] - targets[i];
            if (step == 0 && closed[i] && volumes[i] * targets[i] < 0)
                excess = NAN;
            if (fabs(excess) < search->best) {
                search->best = fabs(excess);
                search->best_offset = search->offset;
            }
            search->offset -= excess / rates[i];
            /* Not so in a component that can't grow or has turned inside out. */
            if (search->best <= search->tolerance || !isfinite(search->offset)) {
                search->done = 1;
                left--;
            }
            if (search->done || step == MOST_STEPS - 1)
                search->offset = search->best <= search->tolerance ? search->best_offset : 0;
        }
        for (int64_t v = 0; v < n_vertices; v++)
            for (int axis = 0; label[v] >= 0 && axis < 3; axis++)
                vertices[3 * v + axis] = base[3 * v + axis] + searches[label[v]].offset * normals[3 * v + axis];
    }
    for (int64_t i = 0; i < n_components; i++)
        misses[i] = !(searches[i].best <= searches[i].tolerance);
    free(searches);
    free(volumes);
    free(rates);
    free(base);
    return 0;
}
