/* Store of a tetrahedral mesh that changes, and the shape of its tetrahedra. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "tetrahedra.h"
#include "vector.h"
#include "vhp.h"

static const double DEGREES = 57.295779513082320877;
/* In place of a target of 0. */
static const double NO_TARGET = 1e-9;

static double length(const double *v)
{
    return sqrt(dot(v, v));
}

/* What angles and radius ratio are computed from. */
typedef struct {
    double volume, edge[6], cosine_min, cosine_max, radius_ratio;
} Basis;

static void basis_of(const double *a, const double *b, const double *c, const double *d, Basis *found)
{
    double ab[3], ac[3], ad[3], bc[3], bd[3], cd[3], normal[4][3], size[4], sum = 0;
    subtract(b, a, ab);
    subtract(c, a, ac);
    subtract(d, a, ad);
    subtract(c, b, bc);
    subtract(d, b, bd);
    subtract(d, c, cd);
    /* Of the faces opposite to a, b, c and d; all outward or, for a negative volume, all inward. */
    cross(bc, bd, normal[0]);
    cross(ad, ac, normal[1]);
    cross(ab, ad, normal[2]);
    cross(ac, ab, normal[3]);
    found->volume = -dot(normal[3], ad) / 6;
    const double *edges[6] = {ab, ac, ad, bc, bd, cd};
    for (int e = 0; e < 6; e++)
        found->edge[e] = length(edges[e]);
    for (int f = 0; f < 4; f++) {
        size[f] = length(normal[f]);
        sum += size[f];
        const double scale = 1 / (size[f] > 1e-300 ? size[f] : 1e-300);
        for (int k = 0; k < 3; k++)
            normal[f][k] *= scale;
    }
    found->cosine_min = 1;
    found->cosine_max = -1;
    for (int f = 0; f < 4; f++)
        for (int g = f + 1; g < 4; g++) {
            const double cosine = -dot(normal[f], normal[g]);
            if (cosine > found->cosine_max)
                found->cosine_max = cosine;
            if (cosine < found->cosine_min)
                found->cosine_min = cosine;
        }
    /* Products of opposite edges are the sides of a triangle, whose area gives the circumradius (Crelle). */
    const double p = found->edge[0] * found->edge[5], q = found->edge[1] * found->edge[4];
    const double r = found->edge[2] * found->edge[3];
    const double heron = (p + q + r) * (p + q - r) * (p - q + r) * (q + r - p);
    const double volume = fabs(found->volume);
    /* 3 r_in / r_out with r_in = 3 V / (sum of areas) and r_out = sqrt(heron) / (24 V). */
    const double ratio = heron > 0 && sum > 0 ? 432 * volume * volume / (sum * sqrt(heron)) : 0;
    found->radius_ratio = ratio < 1 ? ratio : 1;
}

static double degrees_of(double cosine)
{
    return DEGREES * acos(cosine > 1 ? 1 : cosine < -1 ? -1 : cosine);
}

void vhp_tet_shape(const double *a, const double *b, const double *c, const double *d, TetShape *shape)
{
    /* The edges that meet at each corner. */
    static const int at[4][3] = {{0, 1, 2}, {0, 3, 4}, {1, 3, 5}, {2, 4, 5}};
    Basis found;
    basis_of(a, b, c, d, &found);
    double largest = 0, sum = 0;
    for (int k = 0; k < 4; k++) {
        const double product = found.edge[at[k][0]] * found.edge[at[k][1]] * found.edge[at[k][2]];
        largest = product > largest ? product : largest;
    }
    for (int e = 0; e < 6; e++)
        sum += found.edge[e];
    shape->volume = found.volume;
    shape->min_dihedral_deg = degrees_of(found.cosine_max);
    shape->max_dihedral_deg = degrees_of(found.cosine_min);
    shape->radius_ratio = found.radius_ratio;
    shape->scaled_jacobian = largest > 0 ? 6 * sqrt(2.0) * found.volume / largest : 0;
    shape->mean_edge = sum / 6;
}

void vhp_tet_shares(const double *a, const double *b, const double *c, const double *d, const Target *target,
                    double shares[2])
{
    Basis found;
    basis_of(a, b, c, d, &found);
    shares[0] = found.volume > 0 ? degrees_of(found.cosine_max) / target->angle_deg : -1;
    shares[1] = found.volume > 0 ? found.radius_ratio / target->radius_ratio : -1;
}

double vhp_tet_share(const double *a, const double *b, const double *c, const double *d, const Target *target)
{
    double shares[2];
    vhp_tet_shares(a, b, c, d, target, shares);
    return shares[0] < shares[1] ? shares[0] : shares[1];
}

void vhp_tet_targets(const double *values, Target targets[2])
{
    for (int k = 0; k < 2; k++)
        targets[k] = (Target){fmax(values[2 * k], NO_TARGET), fmax(values[2 * k + 1], NO_TARGET)};
}

static int star_add(Star *star, int32_t tet)
{
    if (star->count == star->room) {
        const int32_t room = star->room ? 2 * star->room : 24;
        int32_t *items = realloc(star->items, (size_t)room * sizeof *items);
        if (!items)
            return VHP_OUT_OF_MEMORY;
        star->items = items;
        star->room = room;
    }
    star->items[star->count++] = tet;
    return 0;
}

int vhp_tet_reserve(TetMesh *mesh, int32_t count)
{
    if (mesh->n_tets + count <= mesh->room)
        return 0;
    const int64_t room = mesh->room + mesh->room / 4 + count + 64;
    int32_t *corners = realloc(mesh->corners, (size_t)room * 4 * sizeof *corners);
    if (corners)
        mesh->corners = corners;
    int32_t *labels = realloc(mesh->labels, (size_t)room * sizeof *labels);
    if (labels)
        mesh->labels = labels;
    uint8_t *used = realloc(mesh->used, (size_t)room);
    if (used)
        mesh->used = used;
    double *share = realloc(mesh->share, (size_t)room * sizeof *share);
    if (share)
        mesh->share = share;
    if (!corners || !labels || !used || !share)
        return VHP_OUT_OF_MEMORY;
    mesh->room = room;
    return 0;
}

int vhp_tet_add(TetMesh *mesh, const int32_t corners[4], int32_t label, uint8_t used)
{
    if (vhp_tet_reserve(mesh, 1))
        return VHP_OUT_OF_MEMORY;
    const int32_t tet = (int32_t)mesh->n_tets;
    for (int k = 0; k < 4; k++)
        if (star_add(&mesh->stars[corners[k]], tet))
            return VHP_OUT_OF_MEMORY;
    memcpy(tet_corners(mesh, tet), corners, 4 * sizeof *corners);
    mesh->labels[tet] = label;
    mesh->used[tet] = used;
    mesh->share[tet] = vhp_tet_share(tet_point(mesh, corners[0]), tet_point(mesh, corners[1]),
                                     tet_point(mesh, corners[2]), tet_point(mesh, corners[3]), &mesh->target[used]);
    mesh->n_tets++;
    return 0;
}

void vhp_tet_remove(TetMesh *mesh, int32_t tet)
{
    int32_t *corners = tet_corners(mesh, tet);
    for (int k = 0; k < 4; k++) {
        Star *star = &mesh->stars[corners[k]];
        int32_t place = 0;
        while (star->items[place] != tet)
            place++;
        /* The order stays, so that what is done next does not depend on what was done before. */
        memmove(star->items + place, star->items + place + 1,
                (size_t)(star->count - place - 1) * sizeof *star->items);
        star->count--;
    }
    corners[0] = -1;
}

int vhp_tet_open(TetMesh *mesh, double *points, int64_t n_points, const int32_t *corners, const int32_t *labels,
                 const uint8_t *used, int64_t n_tets, const double *target)
{
    memset(mesh, 0, sizeof *mesh);
    mesh->points = points;
    mesh->n_points = n_points;
    vhp_tet_targets(target, mesh->target);
    mesh->stars = calloc((size_t)n_points + 1, sizeof *mesh->stars);
    if (!mesh->stars || vhp_tet_reserve(mesh, (int32_t)n_tets))
        return VHP_OUT_OF_MEMORY;
    for (int64_t tet = 0; tet < n_tets; tet++)
        if (vhp_tet_add(mesh, corners + 4 * tet, labels[tet], used[tet]))
            return VHP_OUT_OF_MEMORY;
    return 0;
}

void vhp_tet_close(TetMesh *mesh)
{
    for (int64_t point = 0; mesh->stars && point < mesh->n_points; point++)
        free(mesh->stars[point].items);
    free(mesh->stars);
    free(mesh->corners);
    free(mesh->labels);
    free(mesh->used);
    free(mesh->share);
}

/* Shape of n_tets tetrahedra: six columns of n_tets each, in the order of TetShape. */
VHP_EXPORT void vhp_tetrahedra_shape(const double *points, const int32_t *corners, int64_t n_tets, double *columns)
{
    for (int64_t tet = 0; tet < n_tets; tet++) {
        const int32_t *own = corners + 4 * tet;
        TetShape shape;
        vhp_tet_shape(points + 3 * (int64_t)own[0], points + 3 * (int64_t)own[1], points + 3 * (int64_t)own[2],
                      points + 3 * (int64_t)own[3], &shape);
        columns[tet] = shape.volume;
        columns[n_tets + tet] = shape.radius_ratio;
        columns[2 * n_tets + tet] = shape.min_dihedral_deg;
        columns[3 * n_tets + tet] = shape.max_dihedral_deg;
        columns[4 * n_tets + tet] = shape.scaled_jacobian;
        columns[5 * n_tets + tet] = shape.mean_edge;
    }
}
