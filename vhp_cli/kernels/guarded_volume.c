/* Volume of the components, and its restoration by a guarded offset. */
#include <stdlib.h>

#include "guarded.h"

/* Largest step, as a part of the deviation allowed. */
#define LARGEST_STEP 0.5

/* A component that has lost or gained more than this is left alone: something else is wrong. */
#define LARGEST_LOSS 0.3

void vhp_component_volumes(const Guarded *g, double *volume, double *area)
{
    double centre[3] = {0, 0, 0};
    for (int64_t i = 0; i < g->n_components; i++) {
        if (volume)
            volume[i] = 0;
        if (area)
            area[i] = 0;
    }
    for (int64_t f = 0; f < g->n_faces; f++)
        if (is_live(g, f)) { /* any point near the mesh will do */
            for (int d = 0; d < 3; d++)
                centre[d] = place(g, g->faces[3 * f])[d];
            break;
        }
    for (int64_t f = 0; f < g->n_faces; f++) {
        double a[3], b[3], c[3], product[3], ab[3], ac[3];
        if (!is_live(g, f))
            continue;
        const int32_t *v = g->faces + 3 * f, component = g->component[v[0]];
        subtract(place(g, v[0]), centre, a);
        subtract(place(g, v[1]), centre, b);
        subtract(place(g, v[2]), centre, c);
        if (volume) {
            cross(b, c, product);
            volume[component] += dot(a, product) / 6;
        }
        if (area) {
            subtract(b, a, ab);
            subtract(c, a, ac);
            cross(ab, ac, product);
            area[component] += 0.5 * sqrt(dot(product, product));
        }
    }
    for (int64_t v = 0; v < g->n_vertices && volume; v++)
        if (g->corner[v] >= 0 && (g->marks[v] & BOUNDARY))
            volume[g->component[v]] = NAN;
}

/* Move a vertex along the mean normal of its faces. */
static int offset_vertex(Guarded *g, int32_t vertex, double step)
{
    int32_t ring[MAX_RING];
    double normal[3] = {0, 0, 0}, position[3];
    const int32_t count = vhp_ring(g, vertex, ring);
    for (int32_t i = 0; i < count; i++) {
        const int64_t face = ring[i] / 3;
        double ab[3], ac[3], product[3];
        const double *a = place(g, g->faces[3 * face]);
        subtract(place(g, g->faces[3 * face + 1]), a, ab);
        subtract(place(g, g->faces[3 * face + 2]), a, ac);
        cross(ab, ac, product);
        for (int d = 0; d < 3; d++)
            normal[d] += product[d];
    }
    const double length = sqrt(dot(normal, normal));
    if (!(length > 0))
        return 0;
    vhp_look_around(g, &vertex, 1);
    for (int part = 1; part <= 2; part++) {
        for (int d = 0; d < 3; d++)
            position[d] = place(g, vertex)[d] + step / part * normal[d] / length;
        if (vhp_relocate(g, vertex, position, -1, GOAL_KEEP))
            return 1;
    }
    return 0;
}

/* Bring the volume of each closed component back to what it was at the beginning, up to a relative error, in so
 * many rounds. Returns the number of vertices moved; -1 if memory runs out. */
VHP_EXPORT int64_t vhp_guarded_restore_volume(Guarded *g, int64_t rounds, double tolerance)
{
    const size_t n = (size_t)g->n_components;
    double *volume = malloc(n * sizeof *volume + 1), *step = malloc(n * sizeof *step + 1);
    const int64_t before = g->counts[DONE_RELOCATION];
    if (!volume || !step || !vhp_boxes_build(g)) {
        free(volume);
        free(step);
        return VHP_OUT_OF_MEMORY;
    }
    for (int64_t round = 0; round < rounds; round++) {
        int wanted = 0;
        vhp_component_volumes(g, volume, step);
        for (int64_t i = 0; i < g->n_components; i++) {
            const double missing = g->wanted_volume[i] - volume[i], size = fabs(g->wanted_volume[i]), area = step[i];
            const double most = LARGEST_STEP * g->settings.deviation;
            step[i] = 0;
            if (fabs(missing) > tolerance * size && fabs(missing) < LARGEST_LOSS * size && area > 0) {
                step[i] = fmax(-most, fmin(most, missing / area));
                wanted = 1;
            }
        }
        if (!wanted)
            break;
        for (int32_t v = 0; v < g->n_vertices && !out_of_work(g); v++)
            if (g->corner[v] >= 0 && step[g->component[v]] != 0 && !(g->marks[v] & FROZEN))
                offset_vertex(g, v, step[g->component[v]]);
    }
    free(volume);
    free(step);
    return g->failed ? VHP_OUT_OF_MEMORY : g->counts[DONE_RELOCATION] - before;
}

/* Volumes (NaN where open) and areas now, and the volumes wanted: three arrays of a number per component. */
VHP_EXPORT void vhp_guarded_volumes(const Guarded *g, double *volume, double *area, double *wanted)
{
    vhp_component_volumes(g, volume, area);
    for (int64_t i = 0; i < g->n_components; i++)
        wanted[i] = g->wanted_volume[i];
}

VHP_EXPORT int64_t vhp_guarded_components(const Guarded *g)
{
    return g->n_components;
}
