/* Collapse: the two ends of an edge become one. */
#include "guarded.h"

/* Number of vertices joined to both ends of the edge. */
static int common_neighbours(const Guarded *g, const int32_t *ring, int32_t count, int32_t kept)
{
    /* `gone` is not on the boundary, so the next corners about it name all its neighbours. */
    int common = 0;
    for (int32_t i = 0; i < count; i++) {
        const int32_t vertex = g->faces[next_corner(ring[i])];
        common += vertex != kept && vhp_joined(g, vertex, kept);
    }
    return common;
}

static int may_collapse(const Guarded *g, int32_t corner, int32_t kept, int32_t gone)
{
    if (g->across[corner] < 0 || (g->marks[gone] & FROZEN) || (g->marks[kept] & PINCHED))
        return 0;
    const int32_t c = g->faces[corner], d = g->faces[g->across[corner]];
    if (c == d || ((g->marks[c] | g->marks[d]) & PINCHED))
        return 0;
    const int32_t least_c = g->marks[c] & BOUNDARY ? 1 : 3, least_d = g->marks[d] & BOUNDARY ? 1 : 3;
    if (g->valence[c] <= least_c || g->valence[d] <= least_d)
        return 0;
    const int32_t merged = g->valence[kept] + g->valence[gone] - 4;
    return merged >= (g->marks[kept] & BOUNDARY ? 1 : 3) && merged <= MAX_RING;
}

/* Old and new faces; the two that vanish are the first old ones. */
static void build_patch(const Guarded *g, int32_t corner, int32_t kept, int32_t gone, const int32_t *kept_ring,
                        int32_t n_kept, const int32_t *gone_ring, int32_t n_gone, Patch *patch)
{
    const int32_t first = corner / 3, second = g->across[corner] / 3;
    vhp_patch_begin(patch);
    vhp_patch_take(patch, first);
    vhp_patch_take(patch, second);
    for (int32_t i = 0; i < n_kept + n_gone; i++) {
        const int32_t c = i < n_kept ? kept_ring[i] : gone_ring[i - n_kept], face = c / 3;
        if (face == first || face == second)
            continue;
        vhp_patch_take(patch, face);
        const int32_t *v = g->faces + 3 * (int64_t)face;
        vhp_patch_add(patch, v[0] == gone ? kept : v[0], v[1] == gone ? kept : v[1], v[2] == gone ? kept : v[2], face);
        vhp_patch_edge(patch, kept, g->faces[next_corner(c)]);
        if (g->across[next_corner(c)] < 0)
            vhp_patch_edge(patch, kept, g->faces[previous_corner(c)]);
    }
}

/* Take out the face of `corner` (one of the two at the collapsed edge) and join what lies on either side. */
static void cut_face(Guarded *g, int32_t corner, int32_t kept)
{
    const int32_t face = corner / 3, tip = g->faces[corner];
    int32_t sides[2] = {g->across[next_corner(corner)], g->across[previous_corner(corner)]};
    for (int k = 0; k < 2; k++)
        if (sides[k] >= 0)
            g->across[sides[k]] = sides[!k];
    for (int k = 0; k < 3; k++)
        g->faces[3 * (int64_t)face + k] = g->across[3 * (int64_t)face + k] = -1;
    g->valence[tip]--;
    g->valence[kept]--;
    g->n_live_faces--;
    vhp_boxes_remove(g, face);
    if (g->corner[tip] / 3 == face) {
        const int32_t side = sides[0] >= 0 ? sides[0] : sides[1];
        vhp_set_corner(g, tip, g->faces[next_corner(side)] == tip ? next_corner(side) : previous_corner(side));
    }
}

static void do_collapse(Guarded *g, int32_t corner, int32_t kept, int32_t gone, const int32_t *gone_ring,
                        int32_t n_gone, const Patch *patch)
{
    const int32_t opposite = g->across[corner], first = corner / 3, second = opposite / 3;
    for (int32_t i = 0; i < n_gone; i++)
        g->faces[gone_ring[i]] = kept;
    g->valence[kept] += g->valence[gone] - 2;
    g->valence[gone] = 0;
    g->corner[gone] = -1;
    cut_face(g, corner, kept);
    cut_face(g, opposite, kept);
    if (g->corner[kept] / 3 == first || g->corner[kept] / 3 == second || (g->marks[kept] & BOUNDARY)) {
        const int32_t *v = g->faces + 3 * (int64_t)patch->old[2];
        vhp_set_corner(g, kept, 3 * patch->old[2] + (v[0] == kept ? 0 : v[1] == kept ? 1 : 2));
    }
    vhp_settle(g, patch, patch->old + 2, patch->n_new);
}

static int improves(const Guarded *g, Patch *patch, double least_quality)
{
    double mean;
    const double old_worst = vhp_old_quality(g, patch, &mean), worst = vhp_new_quality(g, patch, &mean);
    if (worst < LEAST_QUALITY)
        return 0;
    if (least_quality < 0)
        return worst > old_worst + GAIN;
    return worst > (least_quality < old_worst ? least_quality : old_worst);
}

static int has_longer_edge(const Guarded *g, const Patch *patch, double longest)
{
    for (int32_t i = 0; i < patch->n_edges; i++) {
        const int32_t a = patch->edges[i][0], b = patch->edges[i][1];
        if (distance(place(g, a), place(g, b)) > longest * 0.5 * (g->size[a] + g->size[b]))
            return 1;
    }
    return 0;
}

int vhp_plan_collapse(const Guarded *g, int32_t corner, int32_t kept, Patch *patch, int32_t *gone_ring)
{
    int32_t kept_ring[MAX_RING];
    const int32_t from = g->faces[next_corner(corner)], gone = from == kept ? g->faces[previous_corner(corner)] : from;
    if (!may_collapse(g, corner, kept, gone))
        return -1;
    const int32_t n_kept = vhp_ring(g, kept, kept_ring), n_gone = vhp_ring(g, gone, gone_ring);
    if (n_kept < 0 || n_gone < 0 || common_neighbours(g, gone_ring, n_gone, kept) != 2)
        return -1;
    build_patch(g, corner, kept, gone, kept_ring, n_kept, gone_ring, n_gone, patch);
    return n_gone;
}

void vhp_do_collapse(Guarded *g, int32_t corner, int32_t kept, const int32_t *gone_ring, int32_t n_gone,
                     const Patch *patch)
{
    const int32_t from = g->faces[next_corner(corner)], gone = from == kept ? g->faces[previous_corner(corner)] : from;
    do_collapse(g, corner, kept, gone, gone_ring, n_gone, patch);
    g->counts[DONE_COLLAPSE]++;
}

/* Merge the edge opposite to a corner into its end `kept`, which goes to a position. `longest`: no edge that moves
 * may get longer than so many wanted lengths. */
int vhp_collapse(Guarded *g, int32_t corner, int32_t kept, const double *position, int32_t near, double least_quality,
                 double longest)
{
    int32_t kept_ring[MAX_RING], gone_ring[MAX_RING];
    Patch patch;
    const int32_t from = g->faces[next_corner(corner)], gone = from == kept ? g->faces[previous_corner(corner)] : from;
    const int allowed = may_collapse(g, corner, kept, gone);
    const int32_t n_kept = allowed ? vhp_ring(g, kept, kept_ring) : -1;
    const int32_t n_gone = allowed ? vhp_ring(g, gone, gone_ring) : -1;
    if (n_kept < 0 || n_gone < 0) {
        g->counts[REFUSED_TOPOLOGY]++;
        return 0;
    }
    build_patch(g, corner, kept, gone, kept_ring, n_kept, gone_ring, n_gone, &patch);

    if (g->marks[kept] & FROZEN) {
        position = place(g, kept);
        near = -1;
    }
    const Trial trial = vhp_try_place(g, kept, position, near);
    int guard;
    if (!improves(g, &patch, least_quality) || has_longer_edge(g, &patch, longest))
        guard = REFUSED_QUALITY;
    else if (common_neighbours(g, gone_ring, n_gone, kept) != 2)
        guard = REFUSED_TOPOLOGY;
    else
        guard = vhp_refusing_guard(g, &patch, kept, 1);
    if (guard >= 0)
        return vhp_take_back(g, &trial, guard);
    do_collapse(g, corner, kept, gone, gone_ring, n_gone, &patch);
    g->counts[DONE_COLLAPSE]++;
    return 1;
}
