/* Better the worst tetrahedra of a mesh, the worst one first, until all meet the targets or none gets better. */
#include <stdlib.h>
#include <string.h>

#include "tetrahedra.h"
#include "vhp.h"

/* A gain in parts of the target that is worth a change. */
static const double LEAST_GAIN = 2e-3;
/* How often the corners of a tetrahedron are moved in one round. */
enum { MOVES = 3 };

typedef struct {
    double share;
    int32_t tet;
} Bad;

static int by_share(const void *one, const void *other)
{
    const Bad *a = one, *b = other;
    if (a->share != b->share)
        return a->share < b->share ? -1 : 1;
    return (a->tet > b->tet) - (a->tet < b->tet);
}

/* When something around each point last changed, by rounds. */
typedef struct {
    int32_t *changed;
    int32_t round;
} Clock;

static int is_worth_trying(const TetMesh *mesh, const Clock *clock, int32_t tet)
{
    const int32_t *own = tet_corners(mesh, tet);
    for (int k = 0; k < 4; k++)
        if (clock->changed[own[k]] >= clock->round - 1)
            return 1;
    return 0;
}

static void touch(const TetMesh *mesh, Clock *clock, int32_t vertex)
{
    const Star *star = &mesh->stars[vertex];
    for (int32_t i = 0; i < star->count; i++)
        for (int k = 0; k < 4; k++)
            clock->changed[tet_corners(mesh, star->items[i])[k]] = clock->round;
}

/* Swap a bad tetrahedron away. */
static int swap(TetMesh *mesh, Clock *clock, int32_t tet)
{
    int32_t own[4];
    memcpy(own, tet_corners(mesh, tet), sizeof own);
    int status = 0;
    for (int i = 0; i < 4 && !status; i++)
        for (int j = i + 1; j < 4 && !status; j++)
            status = vhp_tet_remove_edge(mesh, own[i], own[j], LEAST_GAIN);
    for (int i = 0; i < 4 && !status; i++)
        status = vhp_tet_remove_face(mesh, tet, i, LEAST_GAIN);
    for (int k = 0; k < 4 && status > 0; k++)
        touch(mesh, clock, own[k]);
    return status;
}

/* Move the corners of a bad tetrahedron; whether any moved. */
static int move(TetMesh *mesh, Clock *clock, int32_t tet)
{
    int moved = 0;
    for (int turn = 0; turn < MOVES && mesh->share[tet] < 1; turn++) {
        int now = 0;
        for (int k = 0; k < 4; k++) {
            const int32_t vertex = tet_corners(mesh, tet)[k];
            if (vhp_tet_relocate(mesh, vertex, LEAST_GAIN)) {
                touch(mesh, clock, vertex);
                now = 1;
            }
        }
        moved |= now;
        if (!now)
            break;
    }
    return moved;
}

static int better_all(TetMesh *mesh, Clock *clock, Bad *bad, int64_t n_bad, int64_t counts[2])
{
    int changes = 0;
    for (int64_t i = 0; i < n_bad; i++) {
        const int32_t tet = bad[i].tet;
        if (tet_is_gone(mesh, tet) || !(mesh->share[tet] < 1) || !is_worth_trying(mesh, clock, tet))
            continue;
        const int swapped = swap(mesh, clock, tet);
        if (swapped < 0)
            return VHP_OUT_OF_MEMORY;
        const int moved = !swapped && move(mesh, clock, tet);
        counts[0] += swapped;
        counts[1] += moved;
        changes |= swapped | moved;
    }
    return changes;
}

static int relax(TetMesh *mesh, int64_t rounds, int64_t counts[2])
{
    Clock clock = {calloc((size_t)mesh->n_points + 1, sizeof(int32_t)), 0};
    int status = clock.changed ? 1 : VHP_OUT_OF_MEMORY;
    for (int64_t round = 0; round < rounds && status == 1; round++) {
        int64_t n_bad = 0, i = 0;
        clock.round = (int32_t)round + 1;
        for (int32_t tet = 0; tet < mesh->n_tets; tet++)
            n_bad += !tet_is_gone(mesh, tet) && mesh->share[tet] < 1;
        Bad *bad = malloc(((size_t)n_bad + 1) * sizeof *bad);
        if (!bad) {
            status = VHP_OUT_OF_MEMORY;
            break;
        }
        for (int32_t tet = 0; tet < mesh->n_tets; tet++)
            if (!tet_is_gone(mesh, tet) && mesh->share[tet] < 1)
                bad[i++] = (Bad){mesh->share[tet], tet};
        qsort(bad, (size_t)n_bad, sizeof *bad, by_share);
        status = better_all(mesh, &clock, bad, n_bad, counts);
        free(bad);
    }
    free(clock.changed);
    return status < 0 ? status : 0;
}

/* Better the tetrahedra of a mesh by swaps and moves.
 *
 * points (n_points, 3): changed in place. corners (n_tets, 4), labels, used (n_tets): as they are. target: smallest
 * dihedral angle in degrees and radius ratio of tetrahedra not used, then of those used. fixed, border, normals,
 * leash (n_points): see TetMesh. counts (2): number of swaps and moves.
 * Returns the mesh, to be read by vhp_tetrahedra_take and closed by it; NULL if memory runs out. */
VHP_EXPORT void *vhp_tetrahedra_relax(double *points, int64_t n_points, const int32_t *corners, const int32_t *labels,
                                      const uint8_t *used, int64_t n_tets, const double *target, const uint8_t *fixed,
                                      const uint8_t *border, const double *normals, const double *leash,
                                      int64_t rounds, int64_t *counts, int64_t *n_made)
{
    TetMesh *mesh = calloc(1, sizeof *mesh);
    double *origin = malloc(((size_t)n_points + 1) * 3 * sizeof *origin);
    int status = mesh && origin ? vhp_tet_open(mesh, points, n_points, corners, labels, used, n_tets, target)
                                : VHP_OUT_OF_MEMORY;
    if (!status) {
        memcpy(origin, points, (size_t)n_points * 3 * sizeof *origin);
        mesh->fixed = fixed;
        mesh->border = border;
        mesh->normals = normals;
        mesh->origin = origin;
        mesh->leash = leash;
        status = relax(mesh, rounds, counts);
        *n_made = 0;
        for (int32_t tet = 0; tet < mesh->n_tets; tet++)
            *n_made += !tet_is_gone(mesh, tet);
    }
    free(origin);
    if (!status)
        return mesh;
    if (mesh)
        vhp_tet_close(mesh);
    free(mesh);
    return NULL;
}

/* Copy the tetrahedra out of what vhp_tetrahedra_relax returned, and free it. */
VHP_EXPORT void vhp_tetrahedra_take(void *made, int32_t *corners, int32_t *labels, uint8_t *used)
{
    TetMesh *mesh = made;
    int64_t count = 0;
    for (int32_t tet = 0; tet < mesh->n_tets; tet++) {
        if (tet_is_gone(mesh, tet))
            continue;
        memcpy(corners + 4 * count, tet_corners(mesh, tet), 4 * sizeof *corners);
        labels[count] = mesh->labels[tet];
        used[count] = mesh->used[tet];
        count++;
    }
    vhp_tet_close(mesh);
    free(mesh);
}
