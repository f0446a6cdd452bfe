/* How the half-edges of a mesh are glued, and what follows from it: coherent orientation and the fans at each vertex.

   A half-edge h = 3 f + k runs from corner k of face f to corner (k + 1) % 3. `mates[h]` is the half-edge of another
   face to which it is glued, or negative; glued half-edges may run in the same direction. */
#include <stdint.h>
#include <stdlib.h>

#include "predicates.h"
#include "triangles.h"
#include "vhp.h"

static inline int32_t next_half_edge(int32_t h) { return h % 3 == 2 ? h - 2 : h + 1; }

/* Walk over the glued half-edges of each patch and turn its faces to agree with its first one.

   faces (n, 3), mates (n, 3)
   turned    (n), out: 1 if a face has to be reversed
   patch     (n), out: number of the patch, in the order of the first faces
   twisted   (n), out: 1 at the number of a patch that can't be oriented, as a Moebius strip
   Returns the number of patches, or -1 if memory runs out. */
VHP_EXPORT int32_t vhp_orient_patches(const int32_t *faces, int64_t n, const int32_t *mates, uint8_t *turned,
                                      int32_t *patch, uint8_t *twisted)
{
    int32_t *waiting = malloc(((size_t)n + 1) * sizeof *waiting);
    int32_t n_patches = 0;
    if (!waiting)
        return VHP_OUT_OF_MEMORY;
    for (int64_t f = 0; f < n; f++)
        patch[f] = -1;
    for (int64_t seed = 0; seed < n; seed++) {
        int64_t first = 0, last = 0;
        if (patch[seed] >= 0)
            continue;
        twisted[n_patches] = 0;
        turned[seed] = 0;
        patch[seed] = n_patches;
        waiting[last++] = (int32_t)seed;
        while (first < last) {
            const int32_t f = waiting[first++];
            for (int32_t h = 3 * f; h < 3 * f + 3; h++) {
                const int32_t m = mates[h];
                if (m < 0)
                    continue;
                const int32_t other = m / 3;
                const uint8_t wanted = turned[f] ^ (uint8_t)(faces[h] == faces[m]);
                if (patch[other] < 0) {
                    patch[other] = n_patches;
                    turned[other] = wanted;
                    waiting[last++] = other;
                } else if (turned[other] != wanted) {
                    twisted[n_patches] = 1;
                }
            }
        }
        n_patches++;
    }
    free(waiting);
    return n_patches;
}

static int32_t find_root(int32_t *parent, int32_t i)
{
    while (parent[i] != i) {
        parent[i] = parent[parent[i]];
        i = parent[i];
    }
    return i;
}

static void unite(int32_t *parent, int32_t i, int32_t j)
{
    i = find_root(parent, i);
    j = find_root(parent, j);
    if (i < j)
        parent[j] = i;
    else
        parent[i] = j;
}

/* Give every fan its own vertex: corners are one vertex only if glued half-edges lead from one to the other.

   faces (n, 3), mates (n, 3), n_vertices
   split     (n, 3), out: the faces with the new vertex numbers; the first fan of a vertex keeps the number of it
   origin    (3 n), out: for each new number n_vertices, n_vertices + 1, ... the vertex it was
   Returns the count of new vertices, or -1 if memory runs out. */
VHP_EXPORT int64_t vhp_split_fans(const int32_t *faces, int64_t n, const int32_t *mates, int64_t n_vertices,
                                  int32_t *split, int32_t *origin)
{
    int32_t *parent = malloc((3 * (size_t)n + 1) * sizeof *parent);
    uint8_t *used = calloc((size_t)n_vertices + 1, 1);
    int64_t n_new = 0;
    if (!parent || !used) {
        free(parent);
        free(used);
        return VHP_OUT_OF_MEMORY;
    }
    for (int64_t h = 0; h < 3 * n; h++)
        parent[h] = (int32_t)h;
    for (int64_t i = 0; i < 3 * n; i++) {
        const int32_t h = (int32_t)i, m = mates[i];
        if (m < 0)
            continue;
        const int same = faces[h] == faces[m];
        unite(parent, h, same ? m : next_half_edge(m));
        unite(parent, next_half_edge(h), same ? next_half_edge(m) : m);
    }
    /* Roots are the first corners of their fans, so their numbers are known when the others need them. */
    for (int64_t i = 0; i < 3 * n; i++) {
        const int32_t root = find_root(parent, (int32_t)i), v = faces[i];
        if (root != i) {
            split[i] = split[root];
        } else if (!used[v]) {
            used[v] = 1;
            split[i] = v;
        } else {
            origin[n_new] = v;
            split[i] = (int32_t)(n_vertices + n_new++);
        }
    }
    free(parent);
    free(used);
    return n_new;
}

/* Angle class of d around the axis a -> b, seen from half-plane c (not on the axis): 0 on it, 1 within the half turn
   that follows counter-clockwise, 2 opposite, 3 within the other half turn; 4 if d lies on the axis. */
static int angle_class(const double *a, const double *b, const double *c, const double *d)
{
    if (vhp_projection_axis(a, b, d) < 0)
        return 4;
    const int side = orient3d(a, b, c, d);
    if (side)
        return side > 0 ? 1 : 3;
    const int axis = vhp_projection_axis(a, b, c);
    return orient2d_along(axis, a, b, c) == orient2d_along(axis, a, b, d) ? 0 : 2;
}

/* Order the points around each axis counter-clockwise, as seen against its direction, from the first one that does not
   lie on it; exact. Points at the same angle keep their order, those on the axis come last.

   vertices (., 3), axes (m, 2), starts (m + 1): the points of axis e are points[starts[e]] to points[starts[e + 1] - 1]
   order     out: as `points`, their places, each counted from 0
   angles    out: as `order`, 0, 1, 2, ...: equal for points at the same angle; -1 for those on the axis
   Returns 0, or -1 if memory runs out. */
VHP_EXPORT int32_t vhp_radial_order(const double *vertices, const int32_t *axes, int64_t m, const int64_t *starts,
                                    const int32_t *points, int32_t *order, int32_t *angles)
{
    int64_t most = 0;
    for (int64_t e = 0; e < m; e++)
        most = starts[e + 1] - starts[e] > most ? starts[e + 1] - starts[e] : most;
    int *class_of = malloc(((size_t)most + 1) * sizeof *class_of);
    if (!class_of)
        return VHP_OUT_OF_MEMORY;
    for (int64_t e = 0; e < m; e++) {
        const double *a = vertices + 3 * (int64_t)axes[2 * e], *b = vertices + 3 * (int64_t)axes[2 * e + 1];
        const int32_t *own = points + starts[e], count = (int32_t)(starts[e + 1] - starts[e]);
        int32_t *sorted = order + starts[e], *angle = angles + starts[e];
        const double *reference = NULL;
        for (int32_t i = 0; i < count && !reference; i++)
            if (vhp_projection_axis(a, b, vertices + 3 * (int64_t)own[i]) >= 0)
                reference = vertices + 3 * (int64_t)own[i];
        for (int32_t i = 0; i < count; i++)
            class_of[i] = reference ? angle_class(a, b, reference, vertices + 3 * (int64_t)own[i]) : 4;
        /* Insertion: there are few points at an edge. */
        for (int32_t i = 0; i < count; i++) {
            const double *p = vertices + 3 * (int64_t)own[i];
            int32_t place = i;
            for (; place > 0; place--) {
                const int32_t before = sorted[place - 1];
                if (class_of[before] < class_of[i])
                    break;
                if (class_of[before] == class_of[i] &&
                    ((class_of[i] & 1) == 0 || orient3d(a, b, vertices + 3 * (int64_t)own[before], p) >= 0))
                    break;
                sorted[place] = before;
            }
            sorted[place] = i;
        }
        for (int32_t i = 0; i < count; i++) {
            const int32_t now = sorted[i], before = i ? sorted[i - 1] : now;
            if (class_of[now] == 4)
                angle[i] = -1;
            else if (!i)
                angle[i] = 0;
            else
                angle[i] = angle[i - 1] + (class_of[now] != class_of[before] ||
                                           ((class_of[now] & 1) && orient3d(a, b, vertices + 3 * (int64_t)own[before],
                                                                            vertices + 3 * (int64_t)own[now]) != 0));
        }
    }
    free(class_of);
    return 0;
}
