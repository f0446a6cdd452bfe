/* The four operations: each builds a patch, asks the guards (the cheapest first), and does it or leaves all as it was. */
#include <string.h>

#include "guarded.h"

/* Below this quality a triangle has no normal to speak of, and may turn. */
#define FLAT_QUALITY 0.02

/* Least cosine between the normals of a face before and after, and of the two faces that an edge flip makes. */
#define LEAST_TURN 0.5
#define LEAST_FLIP_TURN 0.3

/* No operation leaves a triangle worse than this: it would be degenerate for all purposes. */
#define LEAST_QUALITY 1e-9

/* What counts as better. */
#define GAIN 1e-6

static int refuse(Guarded *g, int guard)
{
    g->counts[guard]++;
    return 0;
}

static void add_face(Patch *patch, int32_t a, int32_t b, int32_t c, int32_t replaces)
{
    int32_t *vertices = patch->vertices[patch->n_new];
    vertices[0] = a;
    vertices[1] = b;
    vertices[2] = c;
    patch->replaces[patch->n_new++] = replaces;
}

static void add_edge(Patch *patch, int32_t a, int32_t b)
{
    patch->edges[patch->n_edges][0] = a;
    patch->edges[patch->n_edges++][1] = b;
}

/* Measure the new faces; the worst q, and their mean. */
static double shape_patch(const Guarded *g, Patch *patch, double *mean)
{
    double worst = INFINITY, sum = 0;
    for (int32_t i = 0; i < patch->n_new; i++) {
        const int32_t *v = patch->vertices[i];
        const double q = shape_of(place(g, v[0]), place(g, v[1]), place(g, v[2]), patch->normal[i]);
        patch->quality[i] = q;
        worst = q < worst ? q : worst;
        sum += q;
    }
    *mean = sum / patch->n_new;
    return worst;
}

static double old_quality(const Guarded *g, const Patch *patch, double *mean)
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

/* 1 if no face turns over, and each has an area for certain. */
static int keeps_sides(const Guarded *g, const Patch *patch)
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

/* Mark the vertices of the new faces as changed, and take their shape over to the faces `numbers`. */
static void settle(Guarded *g, const Patch *patch, const int32_t *numbers)
{
    g->clock++;
    for (int32_t i = 0; i < patch->n_new; i++) {
        const int64_t face = numbers[i];
        memcpy(g->normal + 3 * face, patch->normal[i], sizeof patch->normal[i]);
        g->quality[face] = patch->quality[i];
        g->degenerate[face] = 0;
        for (int k = 0; k < 3; k++)
            g->touched[patch->vertices[i][k]] = g->clock;
    }
}

/* ------------------------------------------------------------------ relocation */

static void build_relocation(const Guarded *g, int32_t vertex, const int32_t *corners, int32_t count, Patch *patch)
{
    patch->n_old = patch->n_new = patch->n_edges = 0;
    for (int32_t i = 0; i < count; i++) {
        const int32_t c = corners[i], face = c / 3;
        patch->old[patch->n_old++] = face;
        add_face(patch, g->faces[3 * face], g->faces[3 * face + 1], g->faces[3 * face + 2], face);
        add_edge(patch, vertex, g->faces[next_corner(c)]);
    }
}

static int relocation_improves(const Guarded *g, Patch *patch, int goal)
{
    double old_mean, mean;
    const double old_worst = old_quality(g, patch, &old_mean), worst = shape_patch(g, patch, &mean);
    if (worst < LEAST_QUALITY)
        return 0;
    if (goal == GOAL_WORST)
        return worst > old_worst + GAIN;
    if (goal == GOAL_MEAN)
        return worst > old_worst + 1e-9 || (worst >= g->settings.floor && mean > old_mean + GAIN);
    const double kept = 0.8 * old_worst;
    return worst >= (kept < g->settings.floor ? kept : g->settings.floor);
}

static int vertex_within(Guarded *g, int32_t vertex)
{
    double nearest[3];
    const int32_t face = vhp_nearest_reference(g, place(g, vertex), g->settings.deviation, NULL, 0, g->near[vertex],
                                               nearest);
    if (face < 0)
        return 0;
    g->near[vertex] = face;
    return 1;
}

/* Move a vertex to a position, of which `near` is a face of the reference near it, or -1. */
int vhp_relocate(Guarded *g, int32_t vertex, const double *position, int32_t near, int goal)
{
    int32_t corners[MAX_RING];
    Patch patch;
    if (g->marks[vertex] & FROZEN)
        return 0;
    const int32_t count = vhp_ring(g, vertex, corners);
    if (count < 3)
        return refuse(g, REFUSED_TOPOLOGY);
    build_relocation(g, vertex, corners, count, &patch);

    double *xyz = place(g, vertex);
    const double old_xyz[3] = {xyz[0], xyz[1], xyz[2]};
    const int32_t old_near = g->near[vertex];
    memcpy(xyz, position, sizeof old_xyz);
    round_to_float(xyz);
    if (near >= 0)
        g->near[vertex] = near;
    int guard = -1;
    if (!relocation_improves(g, &patch, goal))
        guard = REFUSED_QUALITY;
    else if (!keeps_sides(g, &patch))
        guard = REFUSED_NORMAL;
    else if (!vertex_within(g, vertex) || !vhp_patch_within(g, &patch, 0))
        guard = REFUSED_ENVELOPE;
    else if (!vhp_patch_covers(g, &patch, 0))
        guard = REFUSED_COVERAGE;
    else if (vhp_patch_meets(g, &patch))
        guard = REFUSED_CONTACT;
    if (guard >= 0) {
        memcpy(xyz, old_xyz, sizeof old_xyz);
        g->near[vertex] = old_near;
        return refuse(g, guard);
    }
    settle(g, &patch, patch.old);
    vhp_move_samples(g, &patch, patch.old);
    for (int32_t i = 0; i < count; i++)
        vhp_boxes_refit(g, patch.old[i]);
    g->counts[DONE_RELOCATION]++;
    return 1;
}

/* ------------------------------------------------------------------ collapse */

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
static void build_collapse(const Guarded *g, int32_t corner, int32_t kept, int32_t gone, const int32_t *kept_ring,
                           int32_t n_kept, const int32_t *gone_ring, int32_t n_gone, Patch *patch)
{
    const int32_t first = corner / 3, second = g->across[corner] / 3;
    patch->n_old = patch->n_new = patch->n_edges = 0;
    patch->old[patch->n_old++] = first;
    patch->old[patch->n_old++] = second;
    for (int32_t i = 0; i < n_kept + n_gone; i++) {
        const int32_t c = i < n_kept ? kept_ring[i] : gone_ring[i - n_kept], face = c / 3;
        if (face == first || face == second)
            continue;
        patch->old[patch->n_old++] = face;
        const int32_t *v = g->faces + 3 * (int64_t)face;
        add_face(patch, v[0] == gone ? kept : v[0], v[1] == gone ? kept : v[1], v[2] == gone ? kept : v[2], face);
        add_edge(patch, kept, g->faces[next_corner(c)]);
        if (g->across[next_corner(c)] < 0)
            add_edge(patch, kept, g->faces[previous_corner(c)]);
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
    settle(g, patch, patch->old + 2);
    vhp_move_samples(g, patch, patch->old + 2);
    for (int32_t i = 2; i < patch->n_old; i++)
        vhp_boxes_refit(g, patch->old[i]);
}

static int collapse_improves(const Guarded *g, Patch *patch, double least_quality)
{
    double mean;
    const double old_worst = old_quality(g, patch, &mean), worst = shape_patch(g, patch, &mean);
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

/* Merge the edge opposite to a corner into its end `kept`, which goes to a position. `longest`: no edge that moves
 * may get longer than so many wanted lengths. */
int vhp_collapse(Guarded *g, int32_t corner, int32_t kept, const double *position, int32_t near, double least_quality,
                 double longest)
{
    int32_t kept_ring[MAX_RING], gone_ring[MAX_RING];
    Patch patch;
    const int32_t from = g->faces[next_corner(corner)], gone = from == kept ? g->faces[previous_corner(corner)] : from;
    if (!may_collapse(g, corner, kept, gone))
        return refuse(g, REFUSED_TOPOLOGY);
    const int32_t n_kept = vhp_ring(g, kept, kept_ring), n_gone = vhp_ring(g, gone, gone_ring);
    if (n_kept < 0 || n_gone < 0)
        return refuse(g, REFUSED_TOPOLOGY);
    build_collapse(g, corner, kept, gone, kept_ring, n_kept, gone_ring, n_gone, &patch);

    double *xyz = place(g, kept);
    const double old_xyz[3] = {xyz[0], xyz[1], xyz[2]};
    const int32_t old_near = g->near[kept];
    if (!(g->marks[kept] & FROZEN)) {
        memcpy(xyz, position, sizeof old_xyz);
        round_to_float(xyz);
        if (near >= 0)
            g->near[kept] = near;
    }
    int guard = -1;
    if (!collapse_improves(g, &patch, least_quality) || has_longer_edge(g, &patch, longest))
        guard = REFUSED_QUALITY;
    else if (!keeps_sides(g, &patch))
        guard = REFUSED_NORMAL;
    else if (common_neighbours(g, gone_ring, n_gone, kept) != 2)
        guard = REFUSED_TOPOLOGY;
    else if (!vertex_within(g, kept) || !vhp_patch_within(g, &patch, 1))
        guard = REFUSED_ENVELOPE;
    else if (!vhp_patch_covers(g, &patch, 0))
        guard = REFUSED_COVERAGE;
    else if (vhp_patch_meets(g, &patch))
        guard = REFUSED_CONTACT;
    if (guard >= 0) {
        memcpy(xyz, old_xyz, sizeof old_xyz);
        g->near[kept] = old_near;
        return refuse(g, guard);
    }
    do_collapse(g, corner, kept, gone, gone_ring, n_gone, &patch);
    g->counts[DONE_COLLAPSE]++;
    return 1;
}

/* ------------------------------------------------------------------ flip */

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

    patch.n_old = patch.n_new = patch.n_edges = 0;
    patch.old[patch.n_old++] = first;
    patch.old[patch.n_old++] = second;
    add_face(&patch, a, d, c, -1);
    add_face(&patch, d, b, c, -1);
    add_edge(&patch, c, d);
    double mean;
    const double old_worst = old_quality(g, &patch, &mean), worst = shape_patch(g, &patch, &mean);
    if (worst < LEAST_QUALITY || (goal == FLIP_QUALITY && worst <= old_worst + GAIN) ||
        (goal == FLIP_BALANCE && (worst < g->settings.floor || worst < 0.7 * old_worst)))
        return 0;
    const double *old_first = g->normal + 3 * (int64_t)first, *old_second = g->normal + 3 * (int64_t)second;
    const double *better = g->quality[first] > g->quality[second] ? old_first : old_second;
    if ((dot(patch.normal[0], patch.normal[1]) < LEAST_FLIP_TURN && dot(old_first, old_second) > LEAST_FLIP_TURN) ||
        dot(patch.normal[0], better) < LEAST_FLIP_TURN || dot(patch.normal[1], better) < LEAST_FLIP_TURN ||
        !keeps_sides(g, &patch))
        return refuse(g, REFUSED_NORMAL);
    if (vhp_joined(g, c, d))
        return refuse(g, REFUSED_TOPOLOGY);
    if (!vhp_patch_within(g, &patch, 1))
        return refuse(g, REFUSED_ENVELOPE);
    if (!vhp_patch_covers(g, &patch, 0))
        return refuse(g, REFUSED_COVERAGE);
    if (vhp_patch_meets(g, &patch))
        return refuse(g, REFUSED_CONTACT);

    turn_edge(g, corner);
    settle(g, &patch, patch.old);
    vhp_move_samples(g, &patch, patch.old);
    vhp_boxes_refit(g, first);
    vhp_boxes_refit(g, second);
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
    patch.n_old = patch.n_new = patch.n_edges = 0;
    for (int32_t i = 0; i < count; i++) {
        const int32_t face = corners[i] / 3, *v = g->faces + 3 * (int64_t)face;
        patch.old[patch.n_old++] = face;
        add_edge(&patch, c, g->faces[next_corner(corners[i])]);
        if (face == first)
            add_face(&patch, a, d, c, second);
        else
            add_face(&patch, v[0], v[1], v[2], face);
    }
    patch.old[patch.n_old++] = second;
    add_face(&patch, d, b, c, second);
    add_edge(&patch, c, d);

    double *xyz = place(g, c), mean;
    const double old_xyz[3] = {xyz[0], xyz[1], xyz[2]}, old_worst = old_quality(g, &patch, &mean);
    const int32_t old_near = g->near[c];
    memcpy(xyz, position, sizeof old_xyz);
    round_to_float(xyz);
    if (near >= 0)
        g->near[c] = near;
    const double worst = shape_patch(g, &patch, &mean);
    int guard = -1;
    if (worst < LEAST_QUALITY || worst <= old_worst + GAIN)
        guard = REFUSED_QUALITY;
    else if (!keeps_sides(g, &patch))
        guard = REFUSED_NORMAL;
    else if (vhp_joined(g, c, d))
        guard = REFUSED_TOPOLOGY;
    else if (!vertex_within(g, c) || !vhp_patch_within(g, &patch, 1))
        guard = REFUSED_ENVELOPE;
    else if (!vhp_patch_covers(g, &patch, 0))
        guard = REFUSED_COVERAGE;
    else if (vhp_patch_meets(g, &patch))
        guard = REFUSED_CONTACT;
    if (guard >= 0) {
        memcpy(xyz, old_xyz, sizeof old_xyz);
        g->near[c] = old_near;
        return refuse(g, guard);
    }
    turn_edge(g, corner);
    settle(g, &patch, patch.old);
    vhp_move_samples(g, &patch, patch.old);
    for (int32_t i = 0; i < patch.n_old; i++)
        vhp_boxes_refit(g, patch.old[i]);
    g->counts[DONE_FLIP]++;
    g->counts[DONE_RELOCATION]++;
    return 1;
}

/* ------------------------------------------------------------------ split */

/* Put a vertex into the middle of the edge a, b opposite to a corner, with the faces (a, b, c) and (b, a, d). */
int32_t vhp_split(Guarded *g, int32_t corner)
{
    Patch patch;
    const int32_t opposite = g->across[corner];
    if (opposite < 0 || g->n_live_faces + 2 > g->settings.max_faces)
        return -1;
    if (!vhp_guarded_reserve(g, g->n_vertices + 1, g->n_faces + 2)) {
        g->failed = 1;
        return -1;
    }
    const int32_t at_a = next_corner(corner), at_b = previous_corner(corner), first = corner / 3, second = opposite / 3;
    const int32_t a = g->faces[at_a], b = g->faces[at_b], c = g->faces[corner], d = g->faces[opposite];
    const int32_t m = (int32_t)g->n_vertices;
    if (c == d || (g->marks[a] & g->marks[b] & FROZEN))
        return -1;
    double *xyz = place(g, m);
    for (int k = 0; k < 3; k++)
        xyz[k] = 0.5 * (place(g, a)[k] + place(g, b)[k]);
    round_to_float(xyz);
    patch.n_old = patch.n_new = patch.n_edges = 0;
    patch.old[patch.n_old++] = first;
    patch.old[patch.n_old++] = second;
    add_face(&patch, a, m, c, first);
    add_face(&patch, m, a, d, second);
    add_face(&patch, m, b, c, first);
    add_face(&patch, b, m, d, second);
    double mean;
    const double old_worst = old_quality(g, &patch, &mean), worst = shape_patch(g, &patch, &mean);
    if (worst < LEAST_QUALITY && worst < 0.1 * old_worst) {
        refuse(g, REFUSED_QUALITY);
        return -1;
    }
    if (!keeps_sides(g, &patch)) {
        refuse(g, REFUSED_NORMAL);
        return -1;
    }
    if (vhp_patch_meets(g, &patch)) {
        refuse(g, REFUSED_CONTACT);
        return -1;
    }
    vhp_patch_covers(g, &patch, 1);

    g->n_vertices++;
    g->size[m] = 0.5 * (g->size[a] + g->size[b]);
    g->near[m] = g->near[a] >= 0 ? g->near[a] : g->near[b];
    g->component[m] = g->component[a];
    g->marks[m] = 0;
    g->valence[m] = 4;
    g->valence[c]++;
    g->valence[d]++;
    const int32_t third = (int32_t)g->n_faces, fourth = third + 1;
    g->n_faces += 2;
    g->n_live_faces += 2;
    g->first_sample[third] = g->first_sample[fourth] = -1;
    const int32_t bc = g->across[at_a], ca = g->across[at_b];
    const int32_t ad = g->across[next_corner(opposite)], db = g->across[previous_corner(opposite)];
    const int32_t numbers[4] = {first, second, third, fourth};
    const int32_t across[4][3] = {{3 * third + 1, ca, 3 * second + 2},
                                  {ad, 3 * fourth, 3 * first + 2},
                                  {bc, 3 * first, 3 * fourth + 2},
                                  {3 * second + 1, db, 3 * third + 2}};
    for (int i = 0; i < 4; i++)
        vhp_set_face(g, numbers[i], patch.vertices[i], across[i]);
    g->corner[m] = 3 * first + 1;
    vhp_set_corner(g, a, 3 * first);
    vhp_set_corner(g, b, 3 * third + 1);
    vhp_set_corner(g, c, 3 * first + 2);
    vhp_set_corner(g, d, 3 * second + 2);
    settle(g, &patch, numbers);
    vhp_move_samples(g, &patch, numbers);
    vhp_boxes_refit(g, first);
    vhp_boxes_refit(g, second);
    vhp_boxes_insert(g, third, first);
    vhp_boxes_insert(g, fourth, second);
    g->counts[DONE_SPLIT]++;
    return m;
}
