/* Passes of guarded operations over the whole mesh. Each returns the number of operations done, or -1 if memory
 * runs out; the order of the work depends on the mesh alone. */
#include <stdlib.h>
#include <string.h>

#include "guarded.h"

#define UNLIMITED 1e300

/* A vertex is projected onto the reference from at most this many wanted lengths away, onto a face that looks
 * nearly its way. */
#define PROJECTION_REACH 0.3
#define PROJECTION_COSINE 0.2

/* A smaller move, in wanted lengths, is not worth its guards. */
#define LEAST_MOVE 0.01

/* An edge to work on, with the ratio of its length to the wanted one. */
typedef struct {
    double ratio;
    int32_t corner, a, b; /* opposite corner; ends when it was found */
} Candidate;

static int longest_first(const void *first, const void *second)
{
    const Candidate *a = first, *b = second;
    if (a->ratio != b->ratio)
        return a->ratio > b->ratio ? -1 : 1;
    return a->corner < b->corner ? -1 : a->corner > b->corner;
}

static int shortest_first(const void *first, const void *second)
{
    const Candidate *a = first, *b = second;
    if (a->ratio != b->ratio)
        return a->ratio < b->ratio ? -1 : 1;
    return a->corner < b->corner ? -1 : a->corner > b->corner;
}

static inline double edge_ratio(const Guarded *g, int32_t a, int32_t b)
{
    return distance(place(g, a), place(g, b)) / (0.5 * (g->size[a] + g->size[b]));
}

/* All edges with two faces and a ratio above `least` and below `most`. */
static Candidate *list_edges(const Guarded *g, double least, double most, int64_t *count)
{
    int64_t room = 1024;
    Candidate *list = malloc((size_t)room * sizeof *list);
    *count = 0;
    for (int32_t c = 0; list && c < 3 * g->n_faces; c++) {
        if (g->faces[c] < 0 || g->across[c] < c) /* dead, on the boundary, or seen from the other side */
            continue;
        const int32_t a = g->faces[next_corner(c)], b = g->faces[previous_corner(c)];
        const double ratio = edge_ratio(g, a, b);
        if (!(ratio > least && ratio < most))
            continue;
        if (*count == room) {
            room *= 2;
            Candidate *grown = realloc(list, (size_t)room * sizeof *list);
            if (!grown)
                free(list);
            list = grown;
            if (!list)
                break;
        }
        const Candidate found = {ratio, c, a, b};
        list[(*count)++] = found;
    }
    return list;
}

/* The edge is still where it was found. */
static int is_current(const Guarded *g, const Candidate *edge)
{
    return g->faces[edge->corner] >= 0 && g->faces[next_corner(edge->corner)] == edge->a &&
           g->faces[previous_corner(edge->corner)] == edge->b;
}

/* Where a vertex would lie well: the centroid of its faces (weighted by their area in units of the wanted length,
 * or all alike), moved into the plane of its normal. 0 if it has no normal. */
int vhp_centre_of_ring(const Guarded *g, int32_t vertex, int weighted, double *target, double *normal)
{
    int32_t ring[MAX_RING];
    double sum[3] = {0, 0, 0}, total = 0, offset[3];
    const double *own = place(g, vertex);
    const int32_t count = vhp_ring(g, vertex, ring);
    normal[0] = normal[1] = normal[2] = 0;
    for (int32_t i = 0; i < count; i++) {
        const int32_t *v = g->faces + 3 * (int64_t)(ring[i] / 3);
        const double *a = place(g, v[0]), *b = place(g, v[1]), *c = place(g, v[2]);
        double ab[3], ac[3], product[3];
        subtract(b, a, ab);
        subtract(c, a, ac);
        cross(ab, ac, product);
        const double size = (g->size[v[0]] + g->size[v[1]] + g->size[v[2]]) / 3;
        const double weight = weighted ? sqrt(dot(product, product)) / (size * size) : 1;
        for (int d = 0; d < 3; d++) {
            normal[d] += product[d];
            sum[d] += weight * ((a[d] - own[d]) + (b[d] - own[d]) + (c[d] - own[d])) / 3;
        }
        total += weight;
    }
    const double length = sqrt(dot(normal, normal));
    if (!(length > 0) || !(total > 0))
        return 0;
    for (int d = 0; d < 3; d++) {
        normal[d] /= length;
        offset[d] = sum[d] / total;
    }
    const double height = dot(offset, normal);
    for (int d = 0; d < 3; d++)
        target[d] = own[d] + offset[d] - height * normal[d];
    return 1;
}

/* Nearest point of the reference to a place wanted for a vertex; the face, or -1. */
int32_t vhp_project(Guarded *g, int32_t vertex, const double *wanted, const double *normal, double *projected)
{
    const double far = PROJECTION_REACH * g->size[vertex];
    return vhp_nearest_reference(g, wanted, far > g->settings.deviation ? far : g->settings.deviation, normal,
                                 PROJECTION_COSINE, g->near[vertex], projected);
}

/* Move a vertex to the projection of `wanted`, and take the wanted length from there. */
int vhp_move_to(Guarded *g, int32_t vertex, const double *wanted, const double *normal, int goal)
{
    double projected[3];
    const int32_t face = vhp_project(g, vertex, wanted, normal, projected);
    if (face < 0 || !vhp_relocate(g, vertex, projected, face, goal))
        return 0;
    g->size[vertex] = vhp_reference_size(g, face, projected);
    return 1;
}

/* Split all edges longer than `factor` wanted lengths, the longest first. `settling`: the new vertices go to
 * where they lie well. */
VHP_EXPORT int64_t vhp_guarded_split(Guarded *g, double factor, int settling)
{
    int64_t count, done = 0;
    if (!vhp_boxes_build(g))
        return VHP_OUT_OF_MEMORY;
    Candidate *edges = list_edges(g, factor, UNLIMITED, &count);
    if (!edges)
        return VHP_OUT_OF_MEMORY;
    qsort(edges, (size_t)count, sizeof *edges, longest_first);
    for (int64_t i = 0; i < count && !out_of_work(g); i++) {
        if (!is_current(g, &edges[i]))
            continue;
        const int32_t middle = vhp_split(g, edges[i].corner);
        if (middle < 0)
            continue;
        done++;
        double target[3], normal[3];
        if (settling && vhp_centre_of_ring(g, middle, 0, target, normal))
            vhp_move_to(g, middle, target, normal, GOAL_KEEP);
    }
    free(edges);
    return g->failed ? VHP_OUT_OF_MEMORY : done;
}

/* Split edges by levels of length, so that none is split before one that is much longer; those between come out
 * well-shaped, where face by face they would end as fans of slivers. */
static int64_t split_by_levels(Guarded *g, double factor)
{
    const double level = 1.4;
    int64_t done = 0, count;
    double longest = 0;
    for (int32_t c = 0; c < 3 * g->n_faces; c++)
        if (g->faces[c] >= 0) {
            const double ratio = edge_ratio(g, g->faces[next_corner(c)], g->faces[previous_corner(c)]);
            longest = ratio > longest ? ratio : longest;
        }
    for (double at = longest / level; at > factor && !out_of_work(g); at /= level) {
        if ((count = vhp_guarded_split(g, at, 0)) < 0)
            return count;
        done += count;
    }
    for (int i = 0; i < 2; i++) {
        if ((count = vhp_guarded_split(g, factor, 0)) < 0)
            return count;
        done += count;
    }
    return done;
}

/* Collapse an edge to its middle on the reference, or to one of its ends. */
int vhp_try_collapse(Guarded *g, int32_t corner, double least_quality, double longest)
{
    const int32_t a = g->faces[next_corner(corner)], b = g->faces[previous_corner(corner)];
    const int a_frozen = g->marks[a] & FROZEN, b_frozen = g->marks[b] & FROZEN;
    if (g->across[corner] < 0 || (a_frozen && b_frozen))
        return 0;
    if (a_frozen || b_frozen)
        return vhp_collapse(g, corner, a_frozen ? a : b, NULL, -1, least_quality, longest);
    double middle[3], projected[3], normal[3], ignored[3];
    const double at_a[3] = {place(g, a)[0], place(g, a)[1], place(g, a)[2]};
    const double at_b[3] = {place(g, b)[0], place(g, b)[1], place(g, b)[2]};
    for (int d = 0; d < 3; d++)
        middle[d] = 0.5 * (at_a[d] + at_b[d]);
    const int32_t ends[2] = {a, b};
    vhp_look_around(g, ends, 2);
    const double size_a = g->size[a], size_b = g->size[b], smaller = size_a < size_b ? size_a : size_b;
    if (vhp_centre_of_ring(g, a, 0, ignored, normal)) {
        const int32_t face = vhp_project(g, a, middle, normal, projected);
        if (face >= 0 && vhp_collapse(g, corner, a, projected, face, least_quality, longest)) {
            g->size[a] = vhp_reference_size(g, face, projected);
            return 1;
        }
    }
    if (vhp_collapse(g, corner, a, at_a, g->near[a], least_quality, longest) ||
        vhp_collapse(g, corner, b, at_b, g->near[b], least_quality, longest)) {
        const int32_t kept = g->corner[a] >= 0 ? a : b;
        g->size[kept] = smaller;
        return 1;
    }
    return 0;
}

/* Nothing has changed around the vertices of a face since `time`. */
int vhp_face_unchanged(const Guarded *g, int32_t face, int32_t time)
{
    const int32_t *v = g->faces + 3 * (int64_t)face;
    return time >= 0 && g->touched[v[0]] <= time && g->touched[v[1]] <= time && g->touched[v[2]] <= time;
}

/* Collapse edges shorter than `factor` wanted lengths, the shortest first, where no triangle gets worse than
 * `least_quality` or the worst around, and no edge longer than `longest` wanted lengths. */
VHP_EXPORT int64_t vhp_guarded_collapse(Guarded *g, double factor, double least_quality, double longest)
{
    int64_t count, done = 0;
    if (!vhp_boxes_build(g))
        return VHP_OUT_OF_MEMORY;
    Candidate *edges = list_edges(g, -1, factor, &count);
    if (!edges)
        return VHP_OUT_OF_MEMORY;
    qsort(edges, (size_t)count, sizeof *edges, shortest_first);
    for (int64_t i = 0; i < count && !out_of_work(g); i++) {
        const Candidate *edge = &edges[i];
        if (!is_current(g, edge) || !(edge_ratio(g, edge->a, edge->b) < factor))
            continue;
        done += vhp_try_collapse(g, edge->corner, least_quality, longest);
    }
    free(edges);
    return g->failed ? VHP_OUT_OF_MEMORY : done;
}

/* Flip edges: goal FLIP_QUALITY where the worse triangle of the two gets better, FLIP_BALANCE where valences get
 * closer to six. */
VHP_EXPORT int64_t vhp_guarded_flip(Guarded *g, int goal)
{
    int32_t *tried = g->tried[goal == FLIP_QUALITY ? TRIED_FLIP_QUALITY : TRIED_FLIP_BALANCE];
    int64_t done = 0;
    if (!vhp_boxes_build(g))
        return VHP_OUT_OF_MEMORY;
    for (int32_t f = 0; f < g->n_faces && !out_of_work(g); f++) {
        if (!is_live(g, f) || vhp_face_unchanged(g, f, tried[f]))
            continue;
        int flipped = 0;
        for (int k = 0; k < 3 && !flipped; k++) {
            const int32_t c = 3 * f + k;
            if (g->across[c] >= 0)
                flipped = vhp_flip(g, c, goal);
        }
        done += flipped;
        if (!flipped)
            tried[f] = g->clock;
    }
    return g->failed ? VHP_OUT_OF_MEMORY : done;
}

/* Move every vertex by `step` towards where it lies well, along the reference, where its triangles get better. */
VHP_EXPORT int64_t vhp_guarded_relax(Guarded *g, double step)
{
    static const double parts[3] = {1, 0.3, 0.1};
    int32_t *tried = g->tried[TRIED_RELAX];
    int64_t done = 0;
    if (!vhp_boxes_build(g))
        return VHP_OUT_OF_MEMORY;
    for (int32_t v = 0; v < g->n_vertices && !out_of_work(g); v++) {
        double target[3], normal[3], wanted[3];
        if (g->corner[v] < 0 || (g->marks[v] & FROZEN) || (tried[v] >= 0 && g->touched[v] <= tried[v]))
            continue;
        const double own[3] = {place(g, v)[0], place(g, v)[1], place(g, v)[2]};
        int moved = 0;
        const int worth = vhp_centre_of_ring(g, v, 1, target, normal) &&
                          distance(target, own) * step > LEAST_MOVE * g->size[v];
        if (worth)
            vhp_look_around(g, &v, 1);
        if (worth)
            for (int i = 0; i < 3 && !moved; i++) {
                for (int d = 0; d < 3; d++)
                    wanted[d] = own[d] + parts[i] * step * (target[d] - own[d]);
                moved = vhp_move_to(g, v, wanted, normal, GOAL_MEAN);
            }
        done += moved;
        tried[v] = moved ? tried[v] : g->clock;
    }
    return g->failed ? VHP_OUT_OF_MEMORY : done;
}

/* The whole of it: edges to their wanted length, then the quality phase. */
VHP_EXPORT int64_t vhp_guarded_run(Guarded *g, int64_t iterations, int bulk)
{
    const double too_long = 1.35, too_short = 0.75, hopeless = 0.05;
    int64_t done = 0;
#define DO(pass)                      \
    do {                              \
        const int64_t did = (pass);   \
        if (did < 0)                  \
            return VHP_OUT_OF_MEMORY; \
        done += did;                  \
    } while (0)
    if (bulk) {
        DO(vhp_guarded_improve(g, hopeless, 4, 0));
        DO(split_by_levels(g, too_long));
        DO(vhp_guarded_improve(g, hopeless, 1, 0));
        for (int64_t i = 0; i < iterations && !out_of_work(g); i++) {
            if (i > 0)
                DO(vhp_guarded_split(g, too_long, 1));
            DO(vhp_guarded_collapse(g, too_short, 0.25, too_long));
            DO(vhp_guarded_flip(g, FLIP_QUALITY));
            DO(vhp_guarded_flip(g, FLIP_BALANCE));
            for (int k = 0; k < 3; k++)
                DO(vhp_guarded_relax(g, 0.8));
        }
    }
    DO(vhp_guarded_improve(g, g->settings.target_quality, 12, 1));
#undef DO
    return done;
}
