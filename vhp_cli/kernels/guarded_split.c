/* Split: an edge gets a vertex in its middle. */
#include "guarded.h"

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
    round_to_file(g, xyz);
    vhp_patch_begin(&patch);
    vhp_patch_take(&patch, first);
    vhp_patch_take(&patch, second);
    vhp_patch_add(&patch, a, m, c, first);
    vhp_patch_add(&patch, m, a, d, second);
    vhp_patch_add(&patch, m, b, c, first);
    vhp_patch_add(&patch, b, m, d, second);
    double mean;
    const double old_worst = vhp_old_quality(g, &patch, &mean), worst = vhp_new_quality(g, &patch, &mean);
    int guard = -1;
    if ((worst < LEAST_QUALITY && worst < 0.1 * old_worst) || !vhp_keeps_edges(g, &patch))
        guard = REFUSED_QUALITY;
    else if (!vhp_keeps_sides(g, &patch))
        guard = REFUSED_NORMAL;
    else if (vhp_patch_meets(g, &patch)) /* the middle is rounded, and so not quite on the edge */
        guard = REFUSED_CONTACT;
    if (guard >= 0) {
        g->counts[guard]++;
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
    vhp_settle(g, &patch, numbers, 2);
    vhp_boxes_insert(g, third, first);
    vhp_boxes_insert(g, fourth, second);
    g->counts[DONE_SPLIT]++;
    return m;
}
