/* The envelope from the other side: points of the reference stay near the surface.
 *
 * Every sample of the reference belongs to a face of the mesh that is within reach, and when that face goes, another
 * one about the same place has to take it over. */
#include <stdlib.h>

#include "guarded.h"

/* A sample this near (as a part of the reach, squared) needs no nearer face. */
#define NEAR_ENOUGH 0.25

/* Face of the mesh nearest to a point within reach, among those that share a vertex with the new faces of a patch
 * and are not taken out by it (patch NULL: all faces); -1 if there is none. */
static int32_t nearest_face(Guarded *g, const double *point, const Patch *patch)
{
    double best = g->settings.deviation * g->settings.deviation;
    int32_t found = -1;
    int64_t count = 0;
    if (g->root < 0 || !vhp_push(g, &count, g->root))
        return -1;
    while (count) {
        const BoxNode *node = &g->nodes[g->stack[--count]];
        g->counts[WORK]++;
        if (box_distance(node->box, point) > best)
            continue;
        if (node->child[0] >= 0) {
            const double to_first = box_distance(g->nodes[node->child[0]].box, point);
            const double to_second = box_distance(g->nodes[node->child[1]].box, point);
            const int nearer = to_second < to_first;
            const int32_t farther_child = node->child[!nearer], nearer_child = node->child[nearer];
            if (!vhp_push(g, &count, farther_child) || !vhp_push(g, &count, nearer_child))
                return found;
            continue;
        }
        const int32_t face = node->child[1], *v = g->faces + 3 * (int64_t)face;
        if (patch) {
            int taken_out = 0, joined = 0;
            for (int32_t i = 0; i < patch->n_old && !taken_out; i++)
                taken_out = patch->old[i] == face;
            for (int32_t i = 0; i < patch->n_new && !joined && !taken_out; i++)
                for (int k = 0; k < 9; k++)
                    joined |= patch->vertices[i][k / 3] == v[k % 3];
            if (!joined)
                continue;
        }
        double nearest[3];
        const double square = vhp_nearest_on_triangle(point, place(g, v[0]), place(g, v[1]), place(g, v[2]), nearest);
        if (square <= best) {
            best = square;
            found = face;
        }
    }
    return found;
}

int vhp_patch_covers(Guarded *g, const Patch *patch, int force)
{
    const double reach = g->settings.deviation * g->settings.deviation;
    g->n_loose = 0;
    for (int32_t i = 0; i < patch->n_old; i++) {
        int32_t successor = -1;
        for (int32_t s = g->first_sample[patch->old[i]]; s >= 0; s = g->next_sample[s]) {
            for (int32_t j = 0; j < patch->n_new && successor < 0; j++)
                successor = patch->replaces[j] == patch->old[i] ? j : -1;
            successor = successor < 0 ? 0 : successor;
            g->sample_place[s] = successor; /* most likely */
            g->loose[g->n_loose++] = s;
        }
    }
    for (int64_t k = 0; k < g->n_loose; k++) {
        const int32_t s = g->loose[k];
        const double *point = g->sample + 3 * (int64_t)s;
        const int32_t first = g->sample_place[s];
        double best = INFINITY, nearest[3];
        g->counts[WORK]++;
        for (int32_t j = 0; j < patch->n_new && best > NEAR_ENOUGH * reach; j++) {
            const int32_t i = j == 0 ? first : j <= first ? j - 1 : j;
            const int32_t *v = patch->vertices[i];
            double offset[3];
            subtract(point, place(g, v[0]), offset);
            const double height = dot(offset, patch->normal[i]);
            if (height * height >= best)
                continue;
            const double square =
                vhp_nearest_on_triangle(point, place(g, v[0]), place(g, v[1]), place(g, v[2]), nearest);
            if (square < best) {
                best = square;
                g->sample_place[s] = i;
            }
        }
        if (best <= reach || force)
            continue;
        const int32_t beside = nearest_face(g, point, patch);
        if (beside < 0)
            return 0;
        g->sample_place[s] = -1 - beside;
    }
    return 1;
}

void vhp_move_samples(Guarded *g, const Patch *patch, const int32_t *numbers)
{
    for (int32_t i = 0; i < patch->n_old; i++)
        g->first_sample[patch->old[i]] = -1;
    for (int64_t k = 0; k < g->n_loose; k++) {
        const int32_t s = g->loose[k], at = g->sample_place[s];
        const int32_t face = at >= 0 ? numbers[at] : -1 - at;
        g->next_sample[s] = g->first_sample[face];
        g->first_sample[face] = s;
    }
    g->n_loose = 0;
}

int vhp_assign_samples(Guarded *g)
{
    for (int32_t s = 0; s < g->n_samples; s++) {
        const int32_t face = nearest_face(g, g->sample + 3 * (int64_t)s, NULL);
        if (face < 0)
            continue; /* the surface is not there to begin with */
        g->next_sample[s] = g->first_sample[face];
        g->first_sample[face] = s;
    }
    return !g->failed;
}
