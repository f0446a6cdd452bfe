/* Flip: two faces at an edge get the other diagonal. */
#include "guarded.h"

/* Least cosine between the normals of the new faces, and between them and the better of the old ones. */
#define LEAST_FLIP_TURN 0.3

static int refuse(Guarded *g, int guard)
{
    g->counts[guard]++;
    return 0;
}

static int unevenness(const Guarded *g, int32_t vertex, int change)
{
    const int wanted = g->marks[vertex] & BOUNDARY ? 3 : 6, off = g->valence[vertex] + change - wanted;
    return off * off;
}

/* Give the two faces (a, b, c) and (b, a, d) at the edge opposite to a corner the other diagonal: (a, d, c), (d, b, c). */
static void turn_edge(Guarded *g, int32_t corner)
{
    const int32_t opposite = g->across[corner], first = corner / 3, second = opposite / 3;
    const int32_t at_a = next_corner(corner), at_b = previous_corner(corner);
    const int32_t a = g->faces[at_a], b = g->faces[at_b], c = g->faces[corner], d = g->faces[opposite];
    const int32_t bc = g->across[at_a], ca = g->across[at_b];
    const int32_t ad = g->across[next_corner(opposite)], db = g->across[previous_corner(opposite)];
    const int32_t upper[3] = {a, d, c}, lower[3] = {d, b, c};
    const int32_t upper_across[3] = {3 * second + 1, ca, ad}, lower_across[3] = {bc, 3 * first, db};
    vhp_set_face(g, first, upper, upper_across);
    vhp_set_face(g, second, lower, lower_across);
    vhp_set_corner(g, a, 3 * first);
    vhp_set_corner(g, d, 3 * first + 1);
    vhp_set_corner(g, c, 3 * first + 2);
    vhp_set_corner(g, b, 3 * second + 1);
    g->valence[a]--;
    g->valence[b]--;
    g->valence[c]++;
    g->valence[d]++;
}

/* The edge opposite to a corner may be replaced by the other diagonal, as far as vertices and valences tell. */
static int may_flip(const Guarded *g, int32_t corner)
{
    const int32_t opposite = g->across[corner];
    if (opposite < 0)
        return 0;
    const int32_t a = g->faces[next_corner(corner)], b = g->faces[previous_corner(corner)];
    const int32_t c = g->faces[corner], d = g->faces[opposite];
    return c != d && !((g->marks[a] | g->marks[b] | g->marks[c] | g->marks[d]) & PINCHED) &&
           !(g->marks[a] & g->marks[b] & FROZEN) && g->valence[a] > (g->marks[a] & BOUNDARY ? 1 : 3) &&
           g->valence[b] > (g->marks[b] & BOUNDARY ? 1 : 3);
}

/* Replace the edge a, b opposite to a corner by the other diagonal of its two faces (a, b, c) and (b, a, d). */
int vhp_flip(Guarded *g, int32_t corner, int goal)
{
    Patch patch;
    if (!may_flip(g, corner))
        return 0;
    const int32_t opposite = g->across[corner], first = corner / 3, second = opposite / 3;
    const int32_t a = g->faces[next_corner(corner)], b = g->faces[previous_corner(corner)];
    const int32_t c = g->faces[corner], d = g->faces[opposite];
    if (goal == FLIP_BALANCE && unevenness(g, a, -1) + unevenness(g, b, -1) + unevenness(g, c, 1) +
            unevenness(g, d, 1) >= unevenness(g, a, 0) + unevenness(g, b, 0) + unevenness(g, c, 0) + unevenness(g, d, 0))
        return 0;

    vhp_patch_begin(&patch);
    vhp_patch_take(&patch, first);
    vhp_patch_take(&patch, second);
    vhp_patch_add(&patch, a, d, c, -1);
    vhp_patch_add(&patch, d, b, c, -1);
    vhp_patch_edge(&patch, c, d);
    double mean;
    const double old_worst = vhp_old_quality(g, &patch, &mean), worst = vhp_new_quality(g, &patch, &mean);
    if (worst < LEAST_QUALITY || (goal == FLIP_QUALITY && worst <= old_worst + GAIN) ||
        (goal == FLIP_BALANCE && (worst < g->settings.floor || worst < 0.7 * old_worst)))
        return 0;
    const double *old_first = g->normal + 3 * (int64_t)first, *old_second = g->normal + 3 * (int64_t)second;
    const double *better = g->quality[first] > g->quality[second] ? old_first : old_second;
    if ((dot(patch.normal[0], patch.normal[1]) < LEAST_FLIP_TURN && dot(old_first, old_second) > LEAST_FLIP_TURN) ||
        dot(patch.normal[0], better) < LEAST_FLIP_TURN || dot(patch.normal[1], better) < LEAST_FLIP_TURN)
        return refuse(g, REFUSED_NORMAL);
    if (vhp_joined(g, c, d))
        return refuse(g, REFUSED_TOPOLOGY);
    const int guard = vhp_refusing_guard(g, &patch, -1, 1);
    if (guard >= 0)
        return refuse(g, guard);

    turn_edge(g, corner);
    vhp_settle(g, &patch, patch.old, 2);
    g->counts[DONE_FLIP]++;
    return 1;
}

/* Flip the edge opposite to a corner and move the vertex there to a position on it, in one: a cap on a crease, which
 * neither operation alone can do away with. Only if the worst triangle gets better. */
int vhp_flip_onto(Guarded *g, int32_t corner, const double *position, int32_t near)
{
    int32_t corners[MAX_RING];
    Patch patch;
    if (!may_flip(g, corner))
        return 0;
    const int32_t opposite = g->across[corner], first = corner / 3, second = opposite / 3;
    const int32_t a = g->faces[next_corner(corner)], b = g->faces[previous_corner(corner)];
    const int32_t c = g->faces[corner], d = g->faces[opposite];
    const int32_t count = g->marks[c] & FROZEN ? -1 : vhp_ring(g, c, corners);
    if (count < 3 || count >= MAX_RING - 1)
        return 0;
    vhp_patch_begin(&patch);
    for (int32_t i = 0; i < count; i++) {
        const int32_t face = corners[i] / 3, *v = g->faces + 3 * (int64_t)face;
        vhp_patch_take(&patch, face);
        vhp_patch_edge(&patch, c, g->faces[next_corner(corners[i])]);
        if (face == first)
            vhp_patch_add(&patch, a, d, c, second);
        else
            vhp_patch_add(&patch, v[0], v[1], v[2], face);
    }
    vhp_patch_take(&patch, second);
    vhp_patch_add(&patch, d, b, c, second);
    vhp_patch_edge(&patch, c, d);

    double mean;
    const double old_worst = vhp_old_quality(g, &patch, &mean);
    const Trial trial = vhp_try_place(g, c, position, near);
    const double worst = vhp_new_quality(g, &patch, &mean);
    int guard;
    if (worst < LEAST_QUALITY || worst <= old_worst + GAIN)
        guard = REFUSED_QUALITY;
    else if (vhp_joined(g, c, d))
        guard = REFUSED_TOPOLOGY;
    else
        guard = vhp_refusing_guard(g, &patch, c, 1);
    if (guard >= 0)
        return vhp_take_back(g, &trial, guard);
    turn_edge(g, corner);
    vhp_settle(g, &patch, patch.old, patch.n_old);
    g->counts[DONE_FLIP]++;
    g->counts[DONE_RELOCATION]++;
    return 1;
}
