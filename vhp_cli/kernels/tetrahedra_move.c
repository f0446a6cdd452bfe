/* Move the corners of tetrahedra: uphill in quality, or as far as quality allows on a way that is given. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "tetrahedra.h"
#include "vector.h"
#include "vhp.h"

/* Parts of the mean edge of the worst tetrahedron by which a corner is moved, tried in turn. */
static const double STEPS[] = {0.3, 0.12, 0.04, 0.012};
enum { N_STEPS = 4 };
static const double DIFFERENCE = 1e-4;
/* Tetrahedra that are worse than the worst one by less than this lead the way together. */
static const double ABREAST = 0.15;

/* Shares of a tetrahedron if one of its corners were at `place`. */
static void shares_with(const TetMesh *mesh, int32_t tet, int32_t vertex, const double *place, double shares[2])
{
    const int32_t *own = tet_corners(mesh, tet);
    const double *at[4];
    for (int k = 0; k < 4; k++)
        at[k] = own[k] == vertex ? place : tet_point(mesh, own[k]);
    vhp_tet_shares(at[0], at[1], at[2], at[3], &mesh->target[mesh->used[tet]], shares);
}

static double share_with(const TetMesh *mesh, int32_t tet, int32_t vertex, const double *place)
{
    double shares[2];
    shares_with(mesh, tet, vertex, place, shares);
    return shares[0] < shares[1] ? shares[0] : shares[1];
}

/* Whether all around a vertex are better than `least` with it at `place`; then `worst` is the least of them. */
static int star_exceeds(const TetMesh *mesh, int32_t vertex, const double *place, double least, double *worst)
{
    const Star *star = &mesh->stars[vertex];
    *worst = HUGE_VAL;
    for (int32_t i = 0; i < star->count; i++) {
        const double share = share_with(mesh, star->items[i], vertex, place);
        if (!(share > least))
            return 0;
        if (share < *worst)
            *worst = share;
    }
    return 1;
}

static void put(TetMesh *mesh, int32_t vertex, const double *place)
{
    const Star *star = &mesh->stars[vertex];
    memcpy(mesh->points + 3 * (int64_t)vertex, place, 3 * sizeof *place);
    for (int32_t i = 0; i < star->count; i++)
        mesh->share[star->items[i]] = share_with(mesh, star->items[i], vertex, place);
}

static void add_gradient(const TetMesh *mesh, int32_t tet, int32_t vertex, double size, double *way)
{
    double gradient[3], place[3], norm = 0;
    memcpy(place, tet_point(mesh, vertex), sizeof place);
    for (int axis = 0; axis < 3; axis++) {
        const double middle = place[axis];
        place[axis] = middle + DIFFERENCE * size;
        const double ahead = share_with(mesh, tet, vertex, place);
        place[axis] = middle - DIFFERENCE * size;
        gradient[axis] = ahead - share_with(mesh, tet, vertex, place);
        place[axis] = middle;
        norm += gradient[axis] * gradient[axis];
    }
    if (norm > 0)
        for (int axis = 0; axis < 3; axis++)
            way[axis] += gradient[axis] / sqrt(norm);
}

/* Take out of a way what leads off the surface of a vertex that has a normal; 0 if nothing is left. */
static int along_surface(const TetMesh *mesh, int32_t vertex, double *way)
{
    const double *normal = mesh->normals + 3 * (int64_t)vertex;
    const double across = dot(way, normal);
    for (int axis = 0; axis < 3; axis++)
        way[axis] -= across * normal[axis];
    const double norm = sqrt(dot(way, way));
    for (int axis = 0; axis < 3; axis++)
        way[axis] /= norm > 0 ? norm : 1;
    return norm > 0;
}

/* Bring a place for a vertex of an interface back to where the vertex may go. */
static void keep_on_leash(const TetMesh *mesh, int32_t vertex, double *place)
{
    const double leash = mesh->leash[vertex];
    const double *origin = mesh->origin + 3 * (int64_t)vertex, *normal = mesh->normals + 3 * (int64_t)vertex;
    double away[3];
    subtract(place, origin, away);
    if (dot(normal, normal) > 0) {
        const double across = dot(away, normal);
        const double excess = across > leash ? across - leash : across < -leash ? across + leash : 0;
        for (int axis = 0; axis < 3; axis++)
            place[axis] -= excess * normal[axis];
        return;
    }
    const double distance = sqrt(dot(away, away));
    if (distance > leash)
        for (int axis = 0; axis < 3; axis++)
            place[axis] = origin[axis] + away[axis] * leash / distance;
}

/* Try places on a way; whether the best of them betters the worst around the vertex by enough. */
static int walk(TetMesh *mesh, int32_t vertex, const double *way, double size, double least, double least_gain)
{
    double best[3], best_share = least + least_gain;
    int found = 0;
    for (int step = 0; step < N_STEPS; step++) {
        double place[3], worst;
        for (int axis = 0; axis < 3; axis++)
            place[axis] = tet_point(mesh, vertex)[axis] + STEPS[step] * size * way[axis];
        if (mesh->border[vertex])
            keep_on_leash(mesh, vertex, place);
        if (star_exceeds(mesh, vertex, place, best_share, &worst)) {
            memcpy(best, place, sizeof best);
            best_share = worst;
            found = 1;
        }
    }
    if (found)
        put(mesh, vertex, best);
    return found;
}

int vhp_tet_relocate(TetMesh *mesh, int32_t vertex, double least_gain)
{
    const Star *star = &mesh->stars[vertex];
    if (mesh->fixed[vertex] || !star->count)
        return 0;
    int32_t worst = star->items[0];
    for (int32_t i = 1; i < star->count; i++)
        if (mesh->share[star->items[i]] < mesh->share[worst])
            worst = star->items[i];
    const double least = mesh->share[worst];
    const int32_t *own = tet_corners(mesh, worst);
    TetShape shape;
    vhp_tet_shape(tet_point(mesh, own[0]), tet_point(mesh, own[1]), tet_point(mesh, own[2]), tet_point(mesh, own[3]),
                  &shape);
    /* Uphill for the worst; uphill for all that are about as bad; to the middle of what is around. */
    double way[3][3] = {{0}};
    add_gradient(mesh, worst, vertex, shape.mean_edge, way[0]);
    int abreast = 0;
    for (int32_t i = 0; i < star->count; i++) {
        const int32_t tet = star->items[i];
        if (mesh->share[tet] < least + ABREAST) {
            add_gradient(mesh, tet, vertex, shape.mean_edge, way[1]);
            abreast++;
        }
        for (int k = 0; k < 4; k++) {
            const double *corner = tet_point(mesh, tet_corners(mesh, tet)[k]);
            for (int axis = 0; axis < 3; axis++)
                way[2][axis] += corner[axis] - tet_point(mesh, vertex)[axis];
        }
    }
    for (int kind = 0; kind < 3; kind++) {
        if (kind == 1 && abreast < 2)
            continue;
        if (along_surface(mesh, vertex, way[kind]) &&
            walk(mesh, vertex, way[kind], shape.mean_edge, least, least_gain))
            return 1;
    }
    /* Off the surface, as far as the leash allows. */
    double free_way[3] = {0};
    if (!mesh->border[vertex] || !(mesh->leash[vertex] > 0))
        return 0;
    add_gradient(mesh, worst, vertex, shape.mean_edge, free_way);
    return walk(mesh, vertex, free_way, shape.mean_edge, least, least_gain);
}
