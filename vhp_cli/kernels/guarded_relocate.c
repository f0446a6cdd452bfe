/* Relocation: a vertex goes to another place, with all faces around it. */
#include "guarded.h"

static void build_patch(const Guarded *g, int32_t vertex, const int32_t *corners, int32_t count, Patch *patch)
{
    vhp_patch_begin(patch);
    for (int32_t i = 0; i < count; i++) {
        const int32_t c = corners[i], face = c / 3, *v = g->faces + 3 * (int64_t)face;
        vhp_patch_take(patch, face);
        vhp_patch_add(patch, v[0], v[1], v[2], face);
        vhp_patch_edge(patch, vertex, g->faces[next_corner(c)]);
    }
}

static int improves(const Guarded *g, Patch *patch, int goal)
{
    double old_mean, mean;
    const double old_worst = vhp_old_quality(g, patch, &old_mean), worst = vhp_new_quality(g, patch, &mean);
    if (worst < LEAST_QUALITY)
        return 0;
    if (goal == GOAL_WORST)
        return worst > old_worst + GAIN;
    if (goal == GOAL_MEAN)
        return worst > old_worst + 1e-9 || (worst >= g->settings.floor && mean > old_mean + GAIN);
    const double kept = 0.8 * old_worst;
    return worst >= (kept < g->settings.floor ? kept : g->settings.floor);
}

/* Move a vertex to a position, of which `near` is a face of the reference near it, or -1. */
int vhp_relocate(Guarded *g, int32_t vertex, const double *position, int32_t near, int goal)
{
    int32_t corners[MAX_RING];
    Patch patch;
    if (g->marks[vertex] & FROZEN)
        return 0;
    const int32_t count = vhp_ring(g, vertex, corners);
    if (count < 3) {
        g->counts[REFUSED_TOPOLOGY]++;
        return 0;
    }
    build_patch(g, vertex, corners, count, &patch);
    const Trial trial = vhp_try_place(g, vertex, position, near);
    const int guard = improves(g, &patch, goal) ? vhp_refusing_guard(g, &patch, vertex, 0) : REFUSED_QUALITY;
    if (guard >= 0)
        return vhp_take_back(g, &trial, guard);
    vhp_settle(g, &patch, patch.old, patch.n_old);
    g->counts[DONE_RELOCATION]++;
    return 1;
}
