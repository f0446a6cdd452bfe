/* Triangulate the near-planar loop of a hole in its projection: ear clipping, then edge flips up to the constrained
   Delaunay triangulation. Turns and crossings of the projected polygon are decided exactly. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "fill.h"
#include "predicates.h"
#include "vhp.h"

/* The polygon as seen along its area vector (Newell): (n, 2), counter-clockwise. 0 if it has no area. */
static int project(const Polygon *polygon, double *flat)
{
    const int64_t n = polygon->n;
    double normal[3], u[3], v[3];
    const double *origin = polygon->points;
    area_vector(polygon, normal);
    const double length = sqrt(dot(normal, normal));
    if (!(length > 0))
        return 0;
    int least = 0;
    for (int d = 0; d < 3; d++) {
        normal[d] /= length;
        least = fabs(normal[d]) < fabs(normal[least]) ? d : least;
    }
    double axis[3] = {0, 0, 0};
    axis[least] = 1;
    cross(normal, axis, u);
    const double size = sqrt(dot(u, u));
    for (int d = 0; d < 3; d++)
        u[d] /= size;
    cross(normal, u, v);
    for (int64_t i = 0; i < n; i++) {
        double from_origin[3];
        subtract(polygon->points + 3 * i, origin, from_origin);
        flat[2 * i] = dot(from_origin, u);
        flat[2 * i + 1] = dot(from_origin, v);
    }
    return 1;
}

static inline int turn(const double *flat, int64_t a, int64_t b, int64_t c)
{
    return orient2d(flat[2 * a], flat[2 * a + 1], flat[2 * b], flat[2 * b + 1], flat[2 * c], flat[2 * c + 1]);
}

static int between(double x, double a, double b)
{
    return (a <= x && x <= b) || (b <= x && x <= a);
}

/* Whether point c, in line with a and b, lies on the segment. */
static int on_segment(const double *flat, int64_t a, int64_t b, int64_t c)
{
    return between(flat[2 * c], flat[2 * a], flat[2 * b]) && between(flat[2 * c + 1], flat[2 * a + 1], flat[2 * b + 1]);
}

static int segments_meet(const double *flat, int64_t a, int64_t b, int64_t c, int64_t d)
{
    const int abc = turn(flat, a, b, c), abd = turn(flat, a, b, d);
    if (abc * abd > 0)
        return 0;
    const int cda = turn(flat, c, d, a), cdb = turn(flat, c, d, b);
    if (cda * cdb > 0)
        return 0;
    if (abc || abd || cda || cdb)
        return abc * abd < 0 || cda * cdb < 0 || (!abc && on_segment(flat, a, b, c)) ||
               (!abd && on_segment(flat, a, b, d)) || (!cda && on_segment(flat, c, d, a)) ||
               (!cdb && on_segment(flat, c, d, b));
    return on_segment(flat, a, b, c) || on_segment(flat, a, b, d) || on_segment(flat, c, d, a);
}

/* Whether no two edges of the flat polygon meet apart from their common corner. Exact. */
static int is_simple(const double *flat, int64_t n)
{
    for (int64_t i = 0; i < n; i++) {
        const int64_t i2 = i + 1 < n ? i + 1 : 0, i3 = i2 + 1 < n ? i2 + 1 : 0;
        if (!turn(flat, i, i2, i3) && (on_segment(flat, i, i2, i3) || on_segment(flat, i2, i3, i)))
            return 0;
        const double left = fmin(flat[2 * i], flat[2 * i2]), right = fmax(flat[2 * i], flat[2 * i2]);
        const double low = fmin(flat[2 * i + 1], flat[2 * i2 + 1]), high = fmax(flat[2 * i + 1], flat[2 * i2 + 1]);
        for (int64_t j = i + 2; j < n; j++) {
            const int64_t j2 = j + 1 < n ? j + 1 : 0;
            if (j2 == i || (flat[2 * j] < left && flat[2 * j2] < left) ||
                (flat[2 * j] > right && flat[2 * j2] > right) || (flat[2 * j + 1] < low && flat[2 * j2 + 1] < low) ||
                (flat[2 * j + 1] > high && flat[2 * j2 + 1] > high))
                continue;
            if (segments_meet(flat, i, i2, j, j2))
                return 0;
        }
    }
    return 1;
}

/* Whether corner b can be cut off: convex, the chord is free, and no corner lies in the closed triangle. */
static int is_ear(const Polygon *polygon, const double *flat, const int32_t *before, const int32_t *after, int32_t b)
{
    const int32_t a = before[b], c = after[b];
    if (turn(flat, a, b, c) <= 0 || (after[c] != a && is_banned(polygon, a, c)))
        return 0;
    for (int32_t p = after[c]; p != a; p = after[p])
        if (turn(flat, a, b, p) >= 0 && turn(flat, b, c, p) >= 0 && turn(flat, c, a, p) >= 0)
            return 0;
    return 1;
}

/* Ear clipping. Returns the number of faces, n - 2, or less if there is no more ear. */
static int64_t clip_ears(const Polygon *polygon, const double *flat, int32_t *before, int32_t *after, uint8_t *ear,
                         int32_t *faces)
{
    const int64_t n = polygon->n;
    int64_t written = 0, fruitless = 0, left = n;
    for (int64_t i = 0; i < n; i++) {
        before[i] = (int32_t)(i ? i - 1 : n - 1);
        after[i] = (int32_t)(i + 1 < n ? i + 1 : 0);
    }
    for (int64_t i = 0; i < n; i++)
        ear[i] = (uint8_t)is_ear(polygon, flat, before, after, (int32_t)i);
    for (int32_t b = 0; left > 2 && fruitless < 2 * left; b = after[b], fruitless++) {
        /* Marks get out of date one way only: a corner that was in the way is gone. So look again before giving up. */
        if (!ear[b] && !(fruitless >= left && is_ear(polygon, flat, before, after, b)))
            continue;
        const int32_t a = before[b], c = after[b];
        faces[3 * written] = a;
        faces[3 * written + 1] = b;
        faces[3 * written + 2] = c;
        written++;
        left--;
        after[a] = c;
        before[c] = a;
        if (left > 2) {
            ear[a] = (uint8_t)is_ear(polygon, flat, before, after, a);
            ear[c] = (uint8_t)is_ear(polygon, flat, before, after, c);
        }
        fruitless = -1;
    }
    return written;
}

/* Positive if d lies inside the circle through a, b, c (counter-clockwise), beyond rounding. */
static int in_circle(const double *flat, int32_t a, int32_t b, int32_t c, int32_t d)
{
    const double ax = flat[2 * a] - flat[2 * d], ay = flat[2 * a + 1] - flat[2 * d + 1];
    const double bx = flat[2 * b] - flat[2 * d], by = flat[2 * b + 1] - flat[2 * d + 1];
    const double cx = flat[2 * c] - flat[2 * d], cy = flat[2 * c + 1] - flat[2 * d + 1];
    const double aa = ax * ax + ay * ay, bb = bx * bx + by * by, cc = cx * cx + cy * cy;
    const double value = aa * (bx * cy - by * cx) + bb * (cx * ay - cy * ax) + cc * (ax * by - ay * bx);
    const double size = aa * (fabs(bx * cy) + fabs(by * cx)) + bb * (fabs(cx * ay) + fabs(cy * ax)) +
                        cc * (fabs(ax * by) + fabs(ay * bx));
    return value > 1e-12 * size;
}

/* Neighbours of the faces of a triangulated polygon: face across the edge from corner k, or -1. */
static int find_neighbours(const int32_t *faces, int64_t n_faces, int64_t n, int32_t *neighbours)
{
    /* Inner edges by their lower corner, chained. */
    int32_t *head = malloc((size_t)n * sizeof *head), *chain = malloc(3 * (size_t)n_faces * sizeof *chain);
    if (!head || !chain) {
        free(head);
        free(chain);
        return 0;
    }
    for (int64_t i = 0; i < n; i++)
        head[i] = -1;
    for (int32_t h = 0; h < 3 * n_faces; h++) {
        const int32_t a = faces[h], b = faces[h % 3 == 2 ? h - 2 : h + 1], low = a < b ? a : b;
        neighbours[h] = -1;
        for (int32_t g = head[low]; g >= 0; g = chain[g])
            if (faces[g] == b && faces[g % 3 == 2 ? g - 2 : g + 1] == a) {
                neighbours[h] = g / 3;
                neighbours[g] = h / 3;
            }
        chain[h] = head[low];
        head[low] = h;
    }
    free(head);
    free(chain);
    return 1;
}

/* Corner of face f at which the edge towards neighbour g starts. */
static int side_of(const int32_t *neighbours, int32_t f, int32_t g)
{
    return neighbours[3 * f] == g ? 0 : neighbours[3 * f + 1] == g ? 1 : 2;
}

/* Flip inner edges until they are locally Delaunay, at most `budget` times. */
static void make_delaunay(const Polygon *polygon, const double *flat, int32_t *faces, int32_t *neighbours,
                          int64_t n_faces, int64_t budget)
{
    for (int changed = 1; changed && budget > 0;) {
        changed = 0;
        for (int32_t f = 0; f < n_faces; f++)
            for (int k = 0; k < 3 && budget > 0; k++) {
                const int32_t g = neighbours[3 * f + k];
                if (g < f)
                    continue;
                const int m = side_of(neighbours, g, f);
                const int32_t a = faces[3 * f + k], b = faces[3 * f + (k + 1) % 3], c = faces[3 * f + (k + 2) % 3];
                const int32_t d = faces[3 * g + (m + 2) % 3];
                if (!in_circle(flat, a, b, c, d) || turn(flat, d, c, a) <= 0 || turn(flat, c, d, b) <= 0 ||
                    is_banned(polygon, c, d))
                    continue;
                /* f = (a, b, c), g = (b, a, d) become f = (a, d, c), g = (d, b, c). */
                const int32_t bc = neighbours[3 * f + (k + 1) % 3], ca = neighbours[3 * f + (k + 2) % 3];
                const int32_t ad = neighbours[3 * g + (m + 1) % 3], db = neighbours[3 * g + (m + 2) % 3];
                if (bc >= 0)
                    neighbours[3 * bc + side_of(neighbours, bc, f)] = g;
                if (ad >= 0)
                    neighbours[3 * ad + side_of(neighbours, ad, g)] = f;
                const int32_t upper[3] = {a, d, c}, lower[3] = {d, b, c};
                const int32_t beside_upper[3] = {ad, g, ca}, beside_lower[3] = {db, bc, f};
                memcpy(faces + 3 * f, upper, sizeof upper);
                memcpy(faces + 3 * g, lower, sizeof lower);
                memcpy(neighbours + 3 * f, beside_upper, sizeof beside_upper);
                memcpy(neighbours + 3 * g, beside_lower, sizeof beside_lower);
                changed = 1;
                budget--;
                break;
            }
    }
}

int64_t vhp_fill_in_plane(const Polygon *polygon, int32_t *faces)
{
    const size_t n = (size_t)polygon->n;
    double *flat = malloc(2 * n * sizeof *flat);
    int32_t *before = malloc(n * sizeof *before), *after = malloc(n * sizeof *after);
    int32_t *neighbours = malloc(3 * n * sizeof *neighbours);
    uint8_t *ear = malloc(n);
    int64_t written = VHP_OUT_OF_MEMORY;
    if (!flat || !before || !after || !neighbours || !ear)
        goto done;
    written = 0;
    if (!project(polygon, flat) || !is_simple(flat, polygon->n))
        goto done;
    written = clip_ears(polygon, flat, before, after, ear, faces);
    if (written < polygon->n - 2) {
        written = 0;
        goto done;
    }
    if (!find_neighbours(faces, written, polygon->n, neighbours)) {
        written = VHP_OUT_OF_MEMORY;
        goto done;
    }
    make_delaunay(polygon, flat, faces, neighbours, written, 40 * polygon->n + 1000);
done:
    free(flat);
    free(before);
    free(after);
    free(neighbours);
    free(ear);
    return written;
}
