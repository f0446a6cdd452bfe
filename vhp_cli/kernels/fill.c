/* Triangulate a hole: the polygon of its boundary loop, in space, without new vertices.

   The corners run in the direction of the cap: a face (i, j, k) with i < j < k agrees with the surface around. Chords
   that are edges of the surface already are `banned`: a second use would give that edge more than two faces.

   Minimum-weight triangulation by dynamic programming after Barequet and Sharir 1995 (Filling gaps in the boundary of a
   polyhedron) with the weight of Liepa 2003 (Filling holes in meshes): the largest angle between neighbouring faces,
   the surface around included, and among equals the least area. It takes time n^3, so of long loops the best ears are
   cut off first. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "fill.h"
#include "vhp.h"

/* Mirrored in repairing.py. */
enum { BY_ANGLE = 0, BY_AREA = 1, BY_PLANE = 2 };

/* Longest loop for the dynamic programme itself. */
#define MOST_CORNERS 220

/* Angles are compared by 1 - cos, in [0, 2]; no area: worse than any angle. Those that differ by less than the step
 * count as equal, or rounding would decide among flat triangulations, and not the area. */
#define NO_ANGLE 4.0
#define ANGLE_STEP 1e-3

/* 1 - cos of the angle between two normals; `NO_ANGLE` if one of them has no length, 0 if the second is missing. */
static double bend(const double *first, const double *second)
{
    if (isnan(second[0]))
        return 0;
    const double lengths = sqrt(dot(first, first)) * sqrt(dot(second, second));
    return lengths > 0 ? 1 - dot(first, second) / lengths : NO_ANGLE;
}

typedef struct {
    double angle, area;
} Weight;

static int is_less(Weight a, Weight b)
{
    return a.angle < b.angle || (a.angle == b.angle && a.area < b.area);
}

/* The dynamic programme over `count` corners of the polygon. rims (count, 3): normal of the face beyond the edge from
   corner i to i + 1. Writes count - 2 faces; returns their number, 0 if every triangulation needs a banned chord. */
static int64_t least_weight(const Polygon *polygon, const int32_t *corners, int64_t count, const double *rims,
                            int by_area, int32_t *faces)
{
    const size_t cells = (size_t)count * (size_t)count;
    Weight *best = malloc(cells * sizeof *best);
    int32_t *apex = malloc(cells * sizeof *apex);
    double *normals = malloc(3 * cells * sizeof *normals); /* of the face below each chord */
    int32_t *waiting = malloc(4 * (size_t)count * sizeof *waiting);
    int64_t written = VHP_OUT_OF_MEMORY;
    if (!best || !apex || !normals || !waiting)
        goto done;
    for (int64_t i = 0; i + 1 < count; i++) {
        best[i * count + i + 1] = (Weight){0, 0};
        memcpy(normals + 3 * (i * count + i + 1), rims + 3 * i, 3 * sizeof *normals);
    }
    for (int64_t gap = 2; gap < count; gap++)
        for (int64_t i = 0, k = gap; k < count; i++, k++) {
            const int64_t cell = i * count + k;
            const int is_last = gap == count - 1;
            best[cell] = (Weight){INFINITY, INFINITY};
            apex[cell] = -1;
            if (!is_last && is_banned(polygon, corners[i], corners[k]))
                continue;
            for (int64_t j = i + 1; j < k; j++) {
                const int64_t left = i * count + j, right = j * count + k;
                if (best[left].area == INFINITY || best[right].area == INFINITY)
                    continue;
                Weight weight = {fmax(best[left].angle, best[right].angle), best[left].area + best[right].area};
                if (weight.angle > best[cell].angle)
                    continue;
                double normal[3];
                face_normal(polygon->points + 3 * (int64_t)corners[i], polygon->points + 3 * (int64_t)corners[j],
                            polygon->points + 3 * (int64_t)corners[k], normal);
                const double area = sqrt(dot(normal, normal)) / 2;
                weight.area += area;
                if (!(area > 0)) {
                    weight.angle = NO_ANGLE;
                } else if (!by_area) {
                    double angle = fmax(bend(normal, normals + 3 * left), bend(normal, normals + 3 * right));
                    if (is_last)
                        angle = fmax(angle, bend(normal, rims + 3 * (count - 1)));
                    weight.angle = fmax(weight.angle, floor(angle / ANGLE_STEP) * ANGLE_STEP);
                }
                if (is_less(weight, best[cell])) {
                    best[cell] = weight;
                    apex[cell] = (int32_t)j;
                    memcpy(normals + 3 * cell, normal, sizeof normal);
                }
            }
        }
    written = 0;
    if (best[count - 1].area == INFINITY)
        goto done;
    int64_t depth = 0;
    waiting[depth++] = 0;
    waiting[depth++] = (int32_t)(count - 1);
    while (depth) {
        const int32_t k = waiting[--depth], i = waiting[--depth], j = apex[i * count + k];
        faces[3 * written] = corners[i];
        faces[3 * written + 1] = corners[j];
        faces[3 * written + 2] = corners[k];
        written++;
        if (j - i > 1) {
            waiting[depth++] = i;
            waiting[depth++] = j;
        }
        if (k - j > 1) {
            waiting[depth++] = j;
            waiting[depth++] = k;
        }
    }
done:
    free(best);
    free(apex);
    free(normals);
    free(waiting);
    return written;
}

/* What it costs to cut off the corner between two others: the chord, much more if the face folds back, beside the
   surface around or against the area vector of the whole loop, so that reentrant corners come last. */
static double ear_cost(const Polygon *polygon, const double *whole, int32_t before, int32_t tip, int32_t after, const double *rim_before,
                       const double *rim_after)
{
    double normal[3], chord[3];
    if (is_banned(polygon, before, after))
        return INFINITY;
    const double *a = polygon->points + 3 * (int64_t)before, *b = polygon->points + 3 * (int64_t)tip,
                 *c = polygon->points + 3 * (int64_t)after;
    face_normal(a, b, c, normal);
    subtract(c, a, chord);
    const double angle = fmax(bend(normal, rim_before), bend(normal, rim_after));
    return dot(chord, chord) * (1 + angle) * (angle >= NO_ANGLE ? 1e12 : angle > 1 || dot(normal, whole) < 0 ? 1e6 : 1);
}

/* Cut off the cheapest ears until `MOST_CORNERS` are left. Fills `corners` and `rims` with what remains and returns the
   number of faces written, or -1 if memory runs out; fewer are cut if all chords are banned. */
static int64_t cut_ears(const Polygon *polygon, const double *all_rims, int32_t *corners, double *rims, int64_t *left,
                        int32_t *faces)
{
    const int64_t n = polygon->n;
    int32_t *before = calloc((size_t)n, sizeof *before), *after = calloc((size_t)n, sizeof *after);
    double *cost = malloc((size_t)n * sizeof *cost), whole[3];
    int64_t written = VHP_OUT_OF_MEMORY;
    if (!before || !after || !cost)
        goto done;
    memcpy(rims, all_rims, 3 * (size_t)n * sizeof *rims);
    area_vector(polygon, whole);
    for (int64_t i = 0; i < n; i++) {
        before[i] = (int32_t)(i ? i - 1 : n - 1);
        after[i] = (int32_t)(i + 1 < n ? i + 1 : 0);
    }
    for (int64_t i = 0; i < n; i++)
        cost[i] = ear_cost(polygon, whole, before[i], (int32_t)i, after[i], rims + 3 * (int64_t)before[i], rims + 3 * i);
    written = 0;
    int32_t start = 0;
    for (int64_t count = n; count > MOST_CORNERS; count--) {
        int32_t tip = -1, walk = start;
        do {
            if (cost[walk] < (tip < 0 ? INFINITY : cost[tip]))
                tip = walk;
            walk = after[walk];
        } while (walk != start);
        if (tip < 0)
            break;
        const int32_t a = before[tip], c = after[tip];
        faces[3 * written] = a;
        faces[3 * written + 1] = tip;
        faces[3 * written + 2] = c;
        written++;
        face_normal(polygon->points + 3 * (int64_t)a, polygon->points + 3 * (int64_t)tip,
                    polygon->points + 3 * (int64_t)c, rims + 3 * (int64_t)a);
        after[a] = c;
        before[c] = a;
        start = a;
        cost[a] = ear_cost(polygon, whole, before[a], a, c, rims + 3 * (int64_t)before[a], rims + 3 * (int64_t)a);
        cost[c] = ear_cost(polygon, whole, a, c, after[c], rims + 3 * (int64_t)a, rims + 3 * (int64_t)c);
    }
    /* What is left, in ascending order; rims move along with their corners. */
    *left = 0;
    int32_t first = start;
    for (int32_t walk = after[start]; walk != start; walk = after[walk])
        first = walk < first ? walk : first;
    int32_t walk = first;
    do {
        corners[*left] = walk;
        memmove(rims + 3 * *left, rims + 3 * (int64_t)walk, 3 * sizeof *rims);
        ++*left;
        walk = after[walk];
    } while (walk != first);
done:
    free(before);
    free(after);
    free(cost);
    return written;
}

/* Triangulate the polygon of a hole.

   points   (n, 3), n >= 3; the last corner is joined to the first
   rims     (n, 3): normal of the face beyond the edge from corner i to i + 1, of any length; NaN: none
   banned   (n_banned), sorted: chords lower * n + upper that must not be used
   method   BY_ANGLE, BY_AREA or BY_PLANE
   faces    (n - 2, 3), out
   Returns the number of faces, n - 2; 0 if the method finds none; -1 if memory runs out. */
VHP_EXPORT int64_t vhp_fill_loop(const double *points, int64_t n, const double *rims, const int64_t *banned,
                                 int64_t n_banned, int32_t method, int32_t *faces)
{
    const Polygon polygon = {points, n, banned, n_banned};
    if (method == BY_PLANE)
        return vhp_fill_in_plane(&polygon, faces);
    int32_t *corners = malloc((size_t)n * sizeof *corners);
    double *left_rims = malloc(3 * (size_t)n * sizeof *left_rims);
    int64_t left = 0, written = VHP_OUT_OF_MEMORY;
    if (corners && left_rims)
        written = cut_ears(&polygon, rims, corners, left_rims, &left, faces);
    if (written >= 0) {
        const int64_t rest = left > 2 * MOST_CORNERS
                                 ? 0
                                 : least_weight(&polygon, corners, left, left_rims, method == BY_AREA,
                                                faces + 3 * written);
        written = rest > 0 ? written + rest : rest;
    }
    free(corners);
    free(left_rims);
    return written;
}
