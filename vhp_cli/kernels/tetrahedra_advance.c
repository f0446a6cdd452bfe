/* Move points along given ways, as far as the tetrahedra around them allow. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "tetrahedra.h"
#include "vhp.h"

/* The least part of a way that is tried. */
static const double LEAST_PART = 0.125;

/* Tetrahedra, and those around each point: items[first[p]] to items[first[p + 1] - 1]. */
typedef struct {
    const double *points;
    const int32_t *corners, *items;
    const int64_t *first;
    const uint8_t *used;
    Target target[2];
} Fixed;

static void shares_with(const Fixed *mesh, int32_t tet, int32_t vertex, const double *place, double shares[2])
{
    const int32_t *own = mesh->corners + 4 * (int64_t)tet;
    const double *at[4];
    for (int k = 0; k < 4; k++)
        at[k] = own[k] == vertex ? place : mesh->points + 3 * (int64_t)own[k];
    vhp_tet_shares(at[0], at[1], at[2], at[3], &mesh->target[mesh->used[tet]], shares);
}

/* Whether all around a point keep the targets, or what they have of each, with it at `place`. */
static int star_is_kept(const Fixed *mesh, int32_t vertex, const double *place)
{
    for (int64_t i = mesh->first[vertex]; i < mesh->first[vertex + 1]; i++) {
        const int32_t tet = mesh->items[i];
        double before[2], after[2];
        shares_with(mesh, tet, vertex, place, after);
        if (after[0] >= 1 && after[1] >= 1)
            continue;
        shares_with(mesh, tet, vertex, mesh->points + 3 * (int64_t)vertex, before);
        for (int k = 0; k < 2; k++)
            if (!(after[k] > 0) || after[k] < (before[k] < 1 ? before[k] : 1))
                return 0;
    }
    return 1;
}

/* List the tetrahedra around each point; first (n_points + 1), items (4 n_tets). */
static void list_stars(const int32_t *corners, int64_t n_tets, int64_t n_points, int64_t *first, int32_t *items)
{
    memset(first, 0, ((size_t)n_points + 1) * sizeof *first);
    for (int64_t i = 0; i < 4 * n_tets; i++)
        first[corners[i] + 1]++;
    for (int64_t point = 0; point < n_points; point++)
        first[point + 1] += first[point];
    for (int64_t i = 0; i < 4 * n_tets; i++)
        items[first[corners[i]]++] = (int32_t)(i / 4);
    for (int64_t point = n_points; point > 0; point--)
        first[point] = first[point - 1];
    first[0] = 0;
}

/* Move points along given ways, one after the other, each as far as its tetrahedra allow: all of the way, a half, and
 * so on down to LEAST_PART. None may fall below `target` (min dihedral in degrees and radius ratio of tetrahedra not
 * used, and of those used) by that, or below what it was if that is less. Positively oriented ones stay so.
 *
 * moving (n_moving): numbers of the points; ways (n_moving, 3); done (n_moving): parts of the ways that were gone. */
VHP_EXPORT int vhp_tetrahedra_advance(double *points, int64_t n_points, const int32_t *corners, const uint8_t *used,
                                      int64_t n_tets, const double *target, const int32_t *moving, int64_t n_moving,
                                      const double *ways, double *done)
{
    int64_t *first = malloc(((size_t)n_points + 1) * sizeof *first);
    int32_t *items = malloc(((size_t)n_tets * 4 + 1) * sizeof *items);
    if (!first || !items) {
        free(first);
        free(items);
        return VHP_OUT_OF_MEMORY;
    }
    list_stars(corners, n_tets, n_points, first, items);
    Fixed mesh = {points, corners, items, first, used, {{0, 0}, {0, 0}}};
    vhp_tet_targets(target, mesh.target);
    for (int64_t i = 0; i < n_moving; i++) {
        const double *way = ways + 3 * i;
        double *point = points + 3 * (int64_t)moving[i];
        done[i] = way[0] == 0 && way[1] == 0 && way[2] == 0;
        for (double part = 1; part >= LEAST_PART && !(done[i] > 0); part /= 2) {
            const double place[3] = {point[0] + part * way[0], point[1] + part * way[1], point[2] + part * way[2]};
            if (star_is_kept(&mesh, moving[i], place)) {
                memcpy(point, place, sizeof place);
                done[i] = part;
            }
        }
    }
    free(first);
    free(items);
    return 0;
}
