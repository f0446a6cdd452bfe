/* Decimation: collapses, the one of least error first, until few enough triangles are left.
 *
 * Every collapse leaves the surface manifold and free of contacts, as all guarded operations do. Its error is that of
 * the planes of the original faces (quadrics.h). If there is a limit on the deviation, the original vertices are the
 * samples that have to stay covered, and the original surface is the reference: it is attached here, as each vertex
 * and sample is known to lie on its faces, so that a mesh for decimation is made without both.
 *
 * An edge has up to four attempts, each with an entry of its own in the queue: where the guards refuse one, the next
 * takes its place there, at its own cost. */
#include <stdlib.h>
#include <string.h>

#include "edge_queue.h"
#include "guarded.h"
#include "quadrics.h"

/* Mirrored in decimating.py: where the remaining vertex goes. */
enum { PLACE_OPTIMAL, PLACE_MIDDLE, PLACE_END };

/* Why it ended. Mirrored in decimating.py. */
enum { ENDED_TARGET, ENDED_EDGE_LENGTH, ENDED_ERROR, ENDED_REFUSED, ENDED_WORK };

/* Attempts at an edge: where the planes want the vertex; not so far from the middle; at the better end, or the middle;
 * at the other end. From an end the optimal placement moves on so that the volume stays. */
enum { ATTEMPT_BEST, ATTEMPT_NEAR, ATTEMPT_END, ATTEMPT_OTHER_END, ATTEMPTS };

/* How much the distance from the middle of the edge counts in the first two attempts, as a part of the planes' weight:
 * nothing but where these leave the place open; and enough to keep it near. */
static const double pulls[2] = {1e-8, 3e-2};

/* Farthest place from the middle, in lengths of the edge. */
#define FARTHEST 1.5

/* A face of the reference this near to a vertex (as a part of the reach, squared) will do as well as the nearest. */
#define NEAR_ENOUGH 0.25

/* What the squared length of an edge adds to its squared error: of edges without error the shortest goes first. */
#define LENGTH_SHARE 1e-7

/* Mirrored by `_Decimation` in decimating.py. */
typedef struct {
    int64_t target_faces;
    double edge_length;  /* mm; end when the mean edge is as long */
    double max_error;    /* mm; end at this error of a collapse */
    double min_quality;  /* no collapse leaves a worse triangle, unless there was a worse one before */
    int32_t place;
    int32_t with_contacts; /* 0: do not look for contacts, for an estimate */
} Decimation;

typedef struct {
    Guarded *g;
    const Decimation *settings;
    Quadric *quadrics;  /* by vertex, about `origin` */
    int32_t *stamps;    /* by vertex: number of changes of its quadric */
    double origin[3];
    EdgeQueue *queue;
    int limited;        /* there is a limit on the deviation */
} Work;

/* An edge as it is found in the queue. */
typedef struct {
    int32_t a, b;
    int32_t corner;       /* opposite to it */
    const double *at_a, *at_b;
    double middle[3];
    Quadric quadric;
} Edge;

static int32_t corner_opposite(const Guarded *g, int32_t a, int32_t b)
{
    int32_t ring[MAX_RING];
    const int32_t count = vhp_ring(g, a, ring);
    for (int32_t i = 0; i < count; i++) {
        if (g->faces[next_corner(ring[i])] == b)
            return previous_corner(ring[i]);
        if (g->faces[previous_corner(ring[i])] == b)
            return next_corner(ring[i]);
    }
    return -1;
}

static void look_at(const Work *work, int32_t a, int32_t b, Edge *edge)
{
    edge->a = a;
    edge->b = b;
    edge->at_a = place(work->g, a);
    edge->at_b = place(work->g, b);
    for (int d = 0; d < 3; d++)
        edge->middle[d] = 0.5 * (edge->at_a[d] + edge->at_b[d]);
    vhp_quadric_add(&work->quadrics[a], &work->quadrics[b], &edge->quadric);
}

static double error_at(const Work *work, const Edge *edge, const double *position)
{
    double x[3];
    subtract(position, work->origin, x);
    return vhp_quadric_error(&edge->quadric, x);
}

/* The place of the least error; with a constraint on the volume unless `normal` is NULL. 0 if it is far away. */
static int optimum(const Work *work, const Edge *edge, int attempt, const double *normal, double offset, double *x)
{
    double middle[3];
    subtract(edge->middle, work->origin, middle);
    if (!vhp_quadric_minimize(&edge->quadric, middle, pulls[attempt], normal, offset, x))
        return 0;
    for (int d = 0; d < 3; d++)
        x[d] += work->origin[d];
    return squared_distance(x, edge->middle) <= FARTHEST * FARTHEST * squared_distance(edge->at_a, edge->at_b);
}

/* The end to which an attempt merges the edge; -1 if it may not. */
static int32_t end_of(const Work *work, const Edge *edge, int attempt)
{
    const int a_frozen = work->g->marks[edge->a] & FROZEN, b_frozen = work->g->marks[edge->b] & FROZEN;
    if (a_frozen || b_frozen)
        return attempt == ATTEMPT_END ? (a_frozen ? edge->a : edge->b) : -1;
    const int a_is_better = error_at(work, edge, edge->at_a) <= error_at(work, edge, edge->at_b);
    return a_is_better == (attempt == ATTEMPT_END) ? edge->a : edge->b;
}

/* Cost of an attempt; negative if there is none. */
static double cost_of(const Work *work, const Edge *edge, int attempt)
{
    const double square = squared_distance(edge->at_a, edge->at_b);
    const int is_free = !((work->g->marks[edge->a] | work->g->marks[edge->b]) & FROZEN);
    double x[3];
    if (work->settings->place == PLACE_MIDDLE) {
        if (attempt != ATTEMPT_END)
            return -1;
        return square;
    }
    if (attempt == ATTEMPT_BEST || attempt == ATTEMPT_NEAR) {
        if (work->settings->place != PLACE_OPTIMAL || !is_free || !optimum(work, edge, attempt, NULL, 0, x))
            return -1;
        return error_at(work, edge, x) + LENGTH_SHARE * square;
    }
    const int32_t end = end_of(work, edge, attempt);
    return end < 0 ? -1 : error_at(work, edge, place(work->g, end)) + LENGTH_SHARE * square;
}

/* Put the next attempt at an edge into the queue, from `attempt` on. */
static int enqueue(Work *work, const Edge *edge, int attempt)
{
    if (work->g->marks[edge->a] & work->g->marks[edge->b] & FROZEN)
        return 1;
    for (; attempt < ATTEMPTS; attempt++) {
        const double cost = cost_of(work, edge, attempt);
        if (cost < 0 || !(cost <= 1e300))
            continue;
        const EdgeEntry entry = {
            cost, {edge->a, edge->b}, {work->stamps[edge->a], work->stamps[edge->b]}, attempt, -1};
        return vhp_queue_push(work->queue, &entry);
    }
    return 1;
}

static int enqueue_all(Work *work)
{
    const Guarded *g = work->g;
    vhp_queue_clear(work->queue);
    for (int32_t c = 0; c < 3 * g->n_faces; c++) {
        if (g->faces[c] < 0 || g->across[c] < c)
            continue;
        const int32_t p = g->faces[next_corner(c)], q = g->faces[previous_corner(c)];
        Edge edge;
        look_at(work, p < q ? p : q, p < q ? q : p, &edge);
        if (!enqueue(work, &edge, 0))
            return 0;
    }
    return 1;
}

/* Volume that the faces about an edge enclose with its middle, and how it depends on the place of the vertex into
 * which it is merged: 6 V = normal . (x - middle). */
static double volume_constraint(const Guarded *g, const Patch *patch, int32_t kept, const double *middle, double *normal)
{
    double offset = 0, p[3], q[3], r[3], product[3];
    normal[0] = normal[1] = normal[2] = 0;
    for (int32_t i = 0; i < patch->n_old; i++) {
        const int32_t *v = g->faces + 3 * (int64_t)patch->old[i];
        subtract(place(g, v[0]), middle, p);
        subtract(place(g, v[1]), middle, q);
        subtract(place(g, v[2]), middle, r);
        cross(q, r, product);
        offset += dot(p, product);
    }
    for (int32_t i = 0; i < patch->n_new; i++) {
        const int32_t *v = patch->vertices[i];
        const int at = v[0] == kept ? 0 : v[1] == kept ? 1 : 2;
        subtract(place(g, v[(at + 1) % 3]), middle, p);
        subtract(place(g, v[(at + 2) % 3]), middle, q);
        cross(p, q, product);
        for (int d = 0; d < 3; d++)
            normal[d] += product[d];
    }
    return offset;
}

/* Move the vertex into which an edge is merged across the surface so that the volume stays, if that is not far. */
static void shift_to_volume(const Guarded *g, const Patch *patch, int32_t kept, const Edge *edge, double *position)
{
    double normal[3], from_middle[3];
    const double offset = volume_constraint(g, patch, kept, edge->middle, normal), square = dot(normal, normal);
    subtract(position, edge->middle, from_middle);
    const double way = square > 0 ? (offset - dot(normal, from_middle)) / square : 0;
    if (way * way * square > squared_distance(edge->at_a, edge->at_b))
        return;
    for (int d = 0; d < 3; d++)
        position[d] += way * normal[d];
}

/* 1 if a vertex is within reach of the reference; notes the face there. */
static int vertex_within(Guarded *g, int32_t vertex)
{
    const double reach = g->settings.deviation * g->settings.deviation;
    const Tree *tree = g->reference;
    const int32_t hint = g->near[vertex];
    double nearest[3];
    if (hint >= 0 && vhp_nearest_on_triangle(place(g, vertex), corner(tree, hint, 0), corner(tree, hint, 1),
                                             corner(tree, hint, 2), nearest) <= NEAR_ENOUGH * reach)
        return 1;
    const int32_t face = vhp_nearest_reference(g, place(g, vertex), g->settings.deviation, NULL, 0, hint, nearest);
    if (face >= 0)
        g->near[vertex] = face; /* put back by vhp_take_back */
    return face >= 0;
}

/* The guard that refuses the new faces about a vertex, or -1. */
static int refusing_guard(Work *work, Patch *patch, int32_t kept)
{
    Guarded *g = work->g;
    double mean;
    const double old_worst = vhp_old_quality(g, patch, &mean), worst = vhp_new_quality(g, patch, &mean);
    const double floor = work->settings->min_quality;
    if (worst < LEAST_QUALITY || worst < (floor < old_worst ? floor : old_worst))
        return REFUSED_QUALITY;
    if (!vhp_keeps_sides(g, patch))
        return REFUSED_NORMAL;
    if (work->limited && !(vertex_within(g, kept) && vhp_patch_within(g, patch, 0) && vhp_patch_covers(g, patch, 0)))
        return REFUSED_COVERAGE;
    return work->settings->with_contacts && vhp_patch_meets(g, patch) ? REFUSED_CONTACT : -1;
}

/* Collapse an edge: -1 if done, else the guard that refused it. */
static int collapse(Work *work, Edge *edge, int attempt)
{
    Guarded *g = work->g;
    Patch patch;
    int32_t gone_ring[MAX_RING];
    double position[3], normal[3];
    int32_t kept = g->marks[edge->b] & FROZEN ? edge->b : edge->a;
    const int32_t gone = kept == edge->a ? edge->b : edge->a;
    const int32_t corner = corner_opposite(g, edge->a, edge->b);
    const int32_t n_gone = corner < 0 ? -1 : vhp_plan_collapse(g, corner, kept, &patch, gone_ring);
    if (n_gone < 0) {
        g->counts[REFUSED_TOPOLOGY]++;
        return REFUSED_TOPOLOGY;
    }
    if (g->marks[kept] & FROZEN) {
        memcpy(position, place(g, kept), sizeof position);
    } else if (work->settings->place == PLACE_MIDDLE) {
        memcpy(position, edge->middle, sizeof position);
    } else if (attempt >= ATTEMPT_END) {
        const double *end = place(g, end_of(work, edge, attempt));
        memcpy(position, end, sizeof position);
        if (work->settings->place == PLACE_OPTIMAL)
            shift_to_volume(g, &patch, kept, edge, position);
    } else {
        const double offset = volume_constraint(g, &patch, kept, edge->middle, normal);
        if (!optimum(work, edge, attempt, normal, offset, position) &&
            !optimum(work, edge, attempt, NULL, 0, position)) {
            g->counts[REFUSED_ENVELOPE]++;
            return REFUSED_ENVELOPE;
        }
    }
    const Trial trial = vhp_try_place(g, kept, position, -1);
    const int guard = refusing_guard(work, &patch, kept);
    if (guard >= 0) {
        vhp_take_back(g, &trial, guard);
        return guard;
    }
    vhp_do_collapse(g, corner, kept, gone_ring, n_gone, &patch);
    work->quadrics[kept] = edge->quadric;
    work->stamps[kept]++;
    work->stamps[gone]++;
    return -1;
}

/* New costs of the edges at a vertex. */
static int enqueue_around(Work *work, int32_t vertex)
{
    int32_t ring[MAX_RING];
    const int32_t count = vhp_ring(work->g, vertex, ring);
    for (int32_t i = 0; i < count; i++) {
        const int32_t other = work->g->faces[next_corner(ring[i])];
        Edge edge;
        look_at(work, vertex < other ? vertex : other, vertex < other ? other : vertex, &edge);
        if (!enqueue(work, &edge, 0))
            return 0;
    }
    return 1;
}

static double mean_edge(const Guarded *g)
{
    double sum = 0;
    int64_t count = 0;
    for (int32_t c = 0; c < 3 * g->n_faces; c++)
        if (g->faces[c] >= 0 && g->across[c] < c) {
            sum += distance(place(g, g->faces[next_corner(c)]), place(g, g->faces[previous_corner(c)]));
            count++;
        }
    return count ? sum / (double)count : 0;
}

/* Collapse edges from the queue until an end is reached; how it ended, or -1 if memory runs out. */
static int run_queue(Work *work, double *errors, int64_t *n_done)
{
    Guarded *g = work->g;
    const Decimation *settings = work->settings;
    const double most = settings->max_error * settings->max_error;
    int64_t next_look = g->n_live_faces;
    EdgeEntry entry;
    while (g->n_live_faces > settings->target_faces) {
        if (out_of_work(g))
            return g->failed ? VHP_OUT_OF_MEMORY : ENDED_WORK;
        if (g->n_live_faces <= next_look) {
            if (isfinite(settings->edge_length) && mean_edge(g) >= settings->edge_length)
                return ENDED_EDGE_LENGTH;
            if (settings->with_contacts && !vhp_boxes_build(g))
                return VHP_OUT_OF_MEMORY;
            next_look = g->n_live_faces - g->n_live_faces / 50 - 1;
        }
        if (!vhp_queue_pop(work->queue, &entry))
            return ENDED_REFUSED;
        const int32_t a = entry.vertex[0], b = entry.vertex[1];
        if (work->stamps[a] != entry.stamp[0] || work->stamps[b] != entry.stamp[1])
            continue;
        Edge edge;
        look_at(work, a, b, &edge);
        const double square = squared_distance(edge.at_a, edge.at_b);
        const double error = settings->place == PLACE_MIDDLE ? square : fmax(entry.cost - LENGTH_SHARE * square, 0);
        if (error > most)
            return ENDED_ERROR;
        const int guard = collapse(work, &edge, entry.attempt);
        if (guard == REFUSED_TOPOLOGY)
            continue; /* no place helps */
        if (guard >= 0) {
            if (!enqueue(work, &edge, entry.attempt + 1))
                return VHP_OUT_OF_MEMORY;
            continue;
        }
        const double before = *n_done ? errors[*n_done - 1] : 0;
        errors[(*n_done)++] = fmax(sqrt(error), before);
        if (!enqueue_around(work, g->corner[a] >= 0 ? a : b))
            return VHP_OUT_OF_MEMORY;
    }
    return ENDED_TARGET;
}

/* Every vertex is a sample, and belongs to one of its faces; 0 if memory runs out. */
static int sample_vertices(Guarded *g)
{
    const size_t n = (size_t)g->n_vertices;
    free(g->sample);
    free(g->next_sample);
    free(g->sample_place);
    free(g->loose);
    g->sample = malloc(3 * n * sizeof *g->sample + 1);
    g->next_sample = malloc(n * sizeof *g->next_sample + 1);
    g->sample_place = malloc(n * sizeof *g->sample_place + 1);
    g->loose = malloc(n * sizeof *g->loose + 1);
    if (!g->sample || !g->next_sample || !g->sample_place || !g->loose)
        return 0;
    memcpy(g->sample, g->xyz, 3 * n * sizeof *g->sample);
    g->n_samples = g->n_vertices;
    for (int32_t v = 0; v < g->n_vertices; v++) {
        g->next_sample[v] = -1;
        if (g->corner[v] < 0)
            continue;
        const int32_t face = g->corner[v] / 3;
        g->next_sample[v] = g->first_sample[face];
        g->first_sample[face] = v;
    }
    return 1;
}

/* Make the surface as it is the reference, by a tree over its faces; 0 if memory runs out. */
static int attach_reference(Guarded *g, const Tree *tree)
{
    int32_t *position = malloc((size_t)g->n_faces * sizeof *position + 1);
    double *normals = realloc(g->reference_normal, 3 * (size_t)tree->n_regular * sizeof *normals + 1);
    if (normals)
        g->reference_normal = normals;
    if (!position || !normals) {
        free(position);
        return 0;
    }
    for (int64_t f = 0; f < g->n_faces; f++)
        position[f] = -1;
    for (int64_t i = 0; i < tree->n_regular; i++) {
        position[tree->numbers[i]] = (int32_t)i;
        memcpy(normals + 3 * i, g->normal + 3 * (int64_t)tree->numbers[i], 3 * sizeof *normals);
    }
    for (int32_t c = 0; c < 3 * g->n_faces; c++)
        if (position[c / 3] >= 0)
            g->near[g->faces[c]] = position[c / 3];
    g->reference = tree;
    free(position);
    return 1;
}

static void add_planes(Work *work)
{
    const Guarded *g = work->g;
    for (int64_t f = 0; f < g->n_faces; f++) {
        double p[3][3];
        const int32_t *v = g->faces + 3 * f;
        Quadric plane;
        if (!is_live(g, f))
            continue;
        memset(&plane, 0, sizeof plane);
        for (int k = 0; k < 3; k++)
            subtract(place(g, v[k]), work->origin, p[k]);
        vhp_quadric_add_triangle(&plane, p[0], p[1], p[2]);
        for (int k = 0; k < 3; k++)
            vhp_quadric_add(&work->quadrics[v[k]], &plane, &work->quadrics[v[k]]);
    }
}

/* The middle of the box about the mesh: quadrics are the more precise, the smaller the coordinates. */
static void find_origin(const Guarded *g, double *origin)
{
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (int32_t v = 0; v < g->n_vertices; v++)
        for (int d = 0; d < 3 && g->corner[v] >= 0; d++) {
            low[d] = place(g, v)[d] < low[d] ? place(g, v)[d] : low[d];
            high[d] = place(g, v)[d] > high[d] ? place(g, v)[d] : high[d];
        }
    for (int d = 0; d < 3; d++)
        origin[d] = low[d] <= high[d] ? low[d] + 0.5 * (high[d] - low[d]) : 0;
}

/* Decimate a mesh that was made without reference and samples. `errors`: the largest error so far in mm, by collapse,
 * with room for half the faces; their number is `n_done`. `tree`: over these faces, or NULL for no limit on the
 * deviation; it must live as long as the mesh. `refused`: what the guards refused in the last round, as
 * `counts`. Returns how it ended, or -1 if memory runs out. */
VHP_EXPORT int vhp_guarded_decimate(Guarded *g, const Decimation *settings, const Tree *tree, double *errors,
                                    int64_t *n_done, int64_t *refused)
{
    Work work;
    int ended = VHP_OUT_OF_MEMORY;
    memset(&work, 0, sizeof work);
    work.g = g;
    work.settings = settings;
    work.limited = tree != NULL;
    work.quadrics = calloc((size_t)g->n_vertices + 1, sizeof *work.quadrics);
    work.stamps = calloc((size_t)g->n_vertices + 1, sizeof *work.stamps);
    work.queue = vhp_queue_create();
    *n_done = 0;
    if (work.quadrics && work.stamps && work.queue && (!tree || (sample_vertices(g) && attach_reference(g, tree)))) {
        find_origin(g, work.origin);
        add_planes(&work);
        int64_t before;
        do { /* what was refused may do, now that the surroundings have changed */
            before = *n_done;
            memcpy(refused, g->counts, sizeof g->counts);
            ended = enqueue_all(&work) ? run_queue(&work, errors, n_done) : VHP_OUT_OF_MEMORY;
        } while (ended == ENDED_REFUSED && *n_done > before);
        for (int k = 0; k < COUNTS; k++)
            refused[k] = g->counts[k] - refused[k];
    }
    free(work.quadrics);
    free(work.stamps);
    vhp_queue_free(work.queue);
    return ended;
}

/* The component of each vertex that a reading of the mesh writes. */
VHP_EXPORT void vhp_guarded_vertex_components(const Guarded *g, int32_t *components)
{
    for (int32_t v = 0; v < g->n_vertices; v++)
        if (g->corner[v] >= 0)
            *components++ = g->component[v];
}

/* Set the volumes that the restoration aims at, by component; NaN: none. */
VHP_EXPORT void vhp_guarded_want_volumes(Guarded *g, const double *volumes)
{
    memcpy(g->wanted_volume, volumes, (size_t)g->n_components * sizeof *volumes);
}
