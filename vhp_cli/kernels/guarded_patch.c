/* Building a patch, judging it by all guards (the cheapest first), and taking note when it is done. */
#include <string.h>

#include "guarded.h"

/* Below this quality a triangle has no normal to speak of, and may turn. */
#define FLAT_QUALITY 0.02

/* Least cosine between the normals of a face before and after. */
#define LEAST_TURN 0.5

void vhp_patch_begin(Patch *patch)
{
    patch->n_old = patch->n_new = patch->n_edges = 0;
}

void vhp_patch_take(Patch *patch, int32_t face)
{
    patch->old[patch->n_old++] = face;
}

void vhp_patch_add(Patch *patch, int32_t a, int32_t b, int32_t c, int32_t replaces)
{
    int32_t *vertices = patch->vertices[patch->n_new];
    vertices[0] = a;
    vertices[1] = b;
    vertices[2] = c;
    patch->replaces[patch->n_new++] = replaces;
}

void vhp_patch_edge(Patch *patch, int32_t a, int32_t b)
{
    patch->edges[patch->n_edges][0] = a;
    patch->edges[patch->n_edges++][1] = b;
}

double vhp_new_quality(const Guarded *g, Patch *patch, double *mean)
{
    double worst = INFINITY, sum = 0;
    for (int32_t i = 0; i < patch->n_new; i++) {
        const int32_t *v = patch->vertices[i];
        const double *a = place(g, v[0]), *b = place(g, v[1]), *c = place(g, v[2]);
        const double q = shape_of(a, b, c, patch->normal[i]);
        patch->quality[i] = q;
        patch->shortest[i] = shortest_of(a, b, c);
        worst = q < worst ? q : worst;
        sum += q;
    }
    *mean = sum / patch->n_new;
    return worst;
}

double vhp_old_quality(const Guarded *g, const Patch *patch, double *mean)
{
    double worst = INFINITY, sum = 0;
    for (int32_t i = 0; i < patch->n_old; i++) {
        const double q = g->quality[patch->old[i]];
        worst = q < worst ? q : worst;
        sum += q;
    }
    *mean = sum / patch->n_old;
    return worst;
}

Trial vhp_try_place(Guarded *g, int32_t vertex, const double *position, int32_t near)
{
    double *xyz = place(g, vertex);
    const Trial trial = {vertex, g->near[vertex], {xyz[0], xyz[1], xyz[2]}};
    memmove(xyz, position, sizeof trial.xyz); /* it may be the place itself */
    round_to_file(g, xyz);
    if (near >= 0)
        g->near[vertex] = near;
    return trial;
}

int vhp_take_back(Guarded *g, const Trial *trial, int guard)
{
    memcpy(place(g, trial->vertex), trial->xyz, sizeof trial->xyz);
    g->near[trial->vertex] = trial->near;
    g->counts[guard]++;
    return 0;
}

int vhp_keeps_sides(const Guarded *g, const Patch *patch)
{
    for (int32_t i = 0; i < patch->n_new; i++) {
        const int32_t *v = patch->vertices[i], old = patch->replaces[i];
        if (old >= 0 && g->quality[old] > FLAT_QUALITY &&
            dot(patch->normal[i], g->normal + 3 * (int64_t)old) < LEAST_TURN)
            return 0;
        if (vhp_projection_axis(place(g, v[0]), place(g, v[1]), place(g, v[2])) < 0)
            return 0;
    }
    return 1;
}

static int vertex_within(Guarded *g, int32_t vertex)
{
    double nearest[3];
    const int32_t face =
        vhp_nearest_reference(g, place(g, vertex), g->settings.deviation, NULL, 0, g->near[vertex], nearest);
    if (face < 0)
        return 0;
    g->near[vertex] = face;
    return 1;
}

int vhp_keeps_edges(const Guarded *g, const Patch *patch)
{
    double before = INFINITY, after = INFINITY;
    for (int32_t i = 0; i < patch->n_new; i++)
        after = patch->shortest[i] < after ? patch->shortest[i] : after;
    if (after >= g->settings.edge_floor * g->settings.edge_floor)
        return 1;
    for (int32_t i = 0; i < patch->n_old; i++)
        before = g->shortest[patch->old[i]] < before ? g->shortest[patch->old[i]] : before;
    return after >= before;
}

int vhp_refusing_guard(Guarded *g, const Patch *patch, int32_t moved, int thorough)
{
    if (!vhp_keeps_edges(g, patch))
        return REFUSED_QUALITY;
    if (!vhp_keeps_sides(g, patch))
        return REFUSED_NORMAL;
    if ((moved >= 0 && !vertex_within(g, moved)) || !vhp_patch_within(g, patch, thorough))
        return REFUSED_ENVELOPE;
    if (!vhp_patch_covers(g, patch, 0))
        return REFUSED_COVERAGE;
    return vhp_patch_meets(g, patch) ? REFUSED_CONTACT : -1;
}

void vhp_settle(Guarded *g, const Patch *patch, const int32_t *numbers, int32_t n_boxes)
{
    g->clock++;
    for (int32_t i = 0; i < patch->n_new; i++) {
        const int64_t face = numbers[i];
        memcpy(g->normal + 3 * face, patch->normal[i], sizeof patch->normal[i]);
        g->quality[face] = patch->quality[i];
        g->shortest[face] = patch->shortest[i];
        g->degenerate[face] = 0;
        for (int k = 0; k < 3; k++)
            g->touched[patch->vertices[i][k]] = g->clock;
    }
    vhp_move_samples(g, patch, numbers);
    for (int32_t i = 0; i < n_boxes; i++)
        vhp_boxes_refit(g, numbers[i]);
}
