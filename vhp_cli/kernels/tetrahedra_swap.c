/* Swap tetrahedra for others that fill the same space (Klincsek's triangulation of the ring around an edge, and 2-3). */
#include <math.h>
#include <string.h>

#include "tetrahedra.h"
#include "vector.h"
#include "vhp.h"

enum { LONGEST_RING = 8 };
/* Normals of the triangles of an interface that lie farther apart make an edge, which stays. */
static const double SMOOTH_COSINE = 0.766;

/* The tetrahedra around an edge: the i-th one has the edge and points i and i + 1 of the ring. */
typedef struct {
    int32_t a, b, count;
    int32_t point[LONGEST_RING], tet[LONGEST_RING];
    double worst;
} Ring;

/* The two other corners of a tetrahedron with the edge a, b, so that (a, b, first, second) is oriented as it is. */
static void other_corners(const int32_t *own, int32_t a, int32_t b, int32_t *first, int32_t *second)
{
    int i = 0, j = 0;
    while (own[i] != a)
        i++;
    while (own[j] != b)
        j++;
    int rest[2], n = 0;
    for (int k = 0; k < 4; k++)
        if (k != i && k != j)
            rest[n++] = k;
    /* Whether (i, j, rest) is an even permutation. */
    const int order[4] = {i, j, rest[0], rest[1]};
    int odd = 0;
    for (int k = 0; k < 4; k++)
        for (int m = k + 1; m < 4; m++)
            odd ^= order[k] > order[m];
    *first = own[rest[odd]];
    *second = own[rest[1 - odd]];
}

/* Find the ring around an edge; 0 if it is not closed, or too long. */
static int ring_around(const TetMesh *mesh, int32_t a, int32_t b, Ring *ring)
{
    int32_t from[LONGEST_RING], to[LONGEST_RING], tets[LONGEST_RING];
    const Star *star = &mesh->stars[a];
    int count = 0;
    for (int32_t i = 0; i < star->count; i++) {
        const int32_t tet = star->items[i];
        if (!tet_has(mesh, tet, b))
            continue;
        if (count == LONGEST_RING)
            return 0;
        other_corners(tet_corners(mesh, tet), a, b, &from[count], &to[count]);
        tets[count++] = tet;
    }
    if (count < 3)
        return 0;
    ring->a = a;
    ring->b = b;
    ring->count = count;
    ring->worst = HUGE_VAL;
    int at = 0;
    for (int i = 0; i < count; i++) {
        ring->point[i] = from[at];
        ring->tet[i] = tets[at];
        if (mesh->share[tets[at]] < ring->worst)
            ring->worst = mesh->share[tets[at]];
        int next = 0;
        while (next < count && from[next] != to[at])
            next++;
        if (next == count || (next == 0) != (i == count - 1))
            return 0;
        at = next;
    }
    return 1;
}

/* Best triangulation of a polygon of ring points, by its worst tetrahedron. */
typedef struct {
    int count;
    int32_t point[LONGEST_RING];
    double worst;
    int8_t apex[LONGEST_RING][LONGEST_RING];
} Fan;

static double pair_share(const TetMesh *mesh, const Ring *ring, int32_t p, int32_t q, int32_t r, uint8_t used)
{
    const double *at[5] = {tet_point(mesh, p), tet_point(mesh, q), tet_point(mesh, r), tet_point(mesh, ring->a),
                           tet_point(mesh, ring->b)};
    const double above = vhp_tet_share(at[0], at[1], at[2], at[4], &mesh->target[used]);
    if (!(above > ring->worst))
        return -1;
    const double below = vhp_tet_share(at[0], at[2], at[1], at[3], &mesh->target[used]);
    return above < below ? above : below;
}

static void triangulate(const TetMesh *mesh, const Ring *ring, Fan *fan, uint8_t used)
{
    double best[LONGEST_RING][LONGEST_RING];
    for (int i = 0; i + 1 < fan->count; i++)
        best[i][i + 1] = HUGE_VAL;
    for (int span = 2; span < fan->count; span++)
        for (int i = 0; i + span < fan->count; i++) {
            const int k = i + span;
            best[i][k] = -HUGE_VAL;
            fan->apex[i][k] = (int8_t)(i + 1);
            for (int j = i + 1; j < k; j++) {
                double worst = best[i][j] < best[j][k] ? best[i][j] : best[j][k];
                if (!(worst > best[i][k]) || !(worst > ring->worst))
                    continue;
                const double share = pair_share(mesh, ring, fan->point[i], fan->point[j], fan->point[k], used);
                worst = share < worst ? share : worst;
                if (worst > best[i][k]) {
                    best[i][k] = worst;
                    fan->apex[i][k] = (int8_t)j;
                }
            }
        }
    fan->worst = fan->count < 3 ? HUGE_VAL : best[0][fan->count - 1];
}

static int add_fan(TetMesh *mesh, const Ring *ring, const Fan *fan, int i, int k, int32_t label, uint8_t used)
{
    if (k < i + 2)
        return 0;
    const int j = fan->apex[i][k];
    const int32_t above[4] = {fan->point[i], fan->point[j], fan->point[k], ring->b};
    const int32_t below[4] = {fan->point[i], fan->point[k], fan->point[j], ring->a};
    if (vhp_tet_add(mesh, above, label, used) || vhp_tet_add(mesh, below, label, used) ||
        add_fan(mesh, ring, fan, i, j, label, used) || add_fan(mesh, ring, fan, j, k, label, used))
        return VHP_OUT_OF_MEMORY;
    return 0;
}

static double normal_of(const double *a, const double *b, const double *c, double *normal)
{
    double ab[3], ac[3];
    subtract(b, a, ab);
    subtract(c, a, ac);
    cross(ab, ac, normal);
    return sqrt(dot(normal, normal));
}

/* Whether an interface stays what it is, within the leash and without an edge, if its edge a, b becomes p, q. */
static int interface_allows(const TetMesh *mesh, const Ring *ring, int32_t p, int32_t q)
{
    const double *a = tet_point(mesh, ring->a), *b = tet_point(mesh, ring->b);
    const double *c = tet_point(mesh, p), *d = tet_point(mesh, q);
    double ab[3], cd[3], across[3], offset[3], normal[4][3], size[4];
    subtract(b, a, ab);
    subtract(d, c, cd);
    subtract(c, a, offset);
    cross(ab, cd, across);
    const double area = sqrt(dot(across, across));
    double leash = HUGE_VAL;
    const int32_t ends[4] = {ring->a, ring->b, p, q};
    for (int k = 0; k < 4; k++) {
        if (mesh->fixed[ends[k]])
            return 0;
        leash = mesh->leash[ends[k]] < leash ? mesh->leash[ends[k]] : leash;
    }
    if (!(area > 0) || !(fabs(dot(across, offset)) <= leash * area))
        return 0;
    /* All four turned to the same side. */
    size[0] = normal_of(a, b, d, normal[0]);
    size[1] = normal_of(b, a, c, normal[1]);
    size[2] = normal_of(c, d, a, normal[2]);
    size[3] = normal_of(d, c, b, normal[3]);
    for (int i = 0; i < 4; i++)
        for (int j = i + 1; j < 4; j++)
            if (!(dot(normal[i], normal[j]) > SMOOTH_COSINE * size[i] * size[j]))
                return 0;
    /* Nor may the new edge be one of an interface already. */
    int32_t label = -1;
    const Star *star = &mesh->stars[p];
    for (int32_t i = 0; i < star->count; i++) {
        const int32_t tet = star->items[i];
        if (!tet_has(mesh, tet, q) || (tet_has(mesh, tet, ring->a) && tet_has(mesh, tet, ring->b)))
            continue;
        if (label >= 0 && mesh->labels[tet] != label)
            return 0;
        label = mesh->labels[tet];
    }
    return 1;
}

/* Whether what is left and right of a flat tetrahedron that changes sides belongs to the side it leaves. */
static int lies_on(const TetMesh *mesh, const Ring *ring, int32_t p, int32_t q, int32_t label)
{
    int sides = 0;
    const Star *star = &mesh->stars[p];
    for (int32_t i = 0; i < star->count; i++) {
        const int32_t tet = star->items[i];
        if (!tet_has(mesh, tet, q))
            continue;
        const int at_a = tet_has(mesh, tet, ring->a), at_b = tet_has(mesh, tet, ring->b);
        if (at_a != at_b)
            sides += mesh->labels[tet] == label;
    }
    return sides == 2;
}

/* Put other tetrahedra in place of those of a ring. */
static int replace(TetMesh *mesh, const Ring *ring, const Fan *fans, const int32_t *labels, const uint8_t *used, int n)
{
    if (vhp_tet_reserve(mesh, 2 * LONGEST_RING))
        return VHP_OUT_OF_MEMORY;
    for (int i = 0; i < ring->count; i++)
        vhp_tet_remove(mesh, ring->tet[i]);
    for (int i = 0; i < n; i++)
        if (add_fan(mesh, ring, &fans[i], 0, fans[i].count - 1, labels[i], used[i]))
            return VHP_OUT_OF_MEMORY;
    return 1;
}

int vhp_tet_remove_edge(TetMesh *mesh, int32_t a, int32_t b, double least_gain)
{
    Ring ring;
    if (!ring_around(mesh, a, b, &ring))
        return 0;
    /* Where another label begins. */
    int change[2] = {0, 0}, changes = 0;
    for (int i = 0; i < ring.count; i++) {
        const int before = ring.tet[(i + ring.count - 1) % ring.count];
        if (mesh->labels[ring.tet[i]] != mesh->labels[before]) {
            if (changes == 2)
                return 0;
            change[changes++] = i;
        }
    }
    Fan fans[2];
    int32_t labels[2];
    uint8_t used[2];
    double worst = HUGE_VAL;
    const int n = changes ? 2 : 1;
    if (changes && !interface_allows(mesh, &ring, ring.point[change[0]], ring.point[change[1]]))
        return 0;
    for (int side = 0; side < n; side++) {
        const int first = change[side];
        const int steps = n == 1 ? ring.count - 1 : (change[1 - side] - first + ring.count) % ring.count;
        const int32_t own = ring.tet[first];
        labels[side] = mesh->labels[own];
        used[side] = mesh->used[own];
        fans[side].count = steps + 1;
        for (int i = 0; i <= steps; i++)
            fans[side].point[i] = ring.point[(first + i) % ring.count];
        if (n == 2 && steps == 1 &&
            !lies_on(mesh, &ring, fans[side].point[0], fans[side].point[1], labels[side]))
            return 0;
        triangulate(mesh, &ring, &fans[side], used[side]);
        worst = fans[side].worst < worst ? fans[side].worst : worst;
        if (!(worst > ring.worst + least_gain))
            return 0;
    }
    return replace(mesh, &ring, fans, labels, used, n);
}

int vhp_tet_remove_face(TetMesh *mesh, int32_t tet, int32_t opposite, double least_gain)
{
    int32_t corners[4];
    memcpy(corners, tet_corners(mesh, tet), sizeof corners);
    /* (apex, p, q, r) oriented as the tetrahedron: an even permutation that brings the apex to the front. */
    static const int turned[4][4] = {{0, 1, 2, 3}, {1, 0, 3, 2}, {2, 3, 0, 1}, {3, 2, 1, 0}};
    const int32_t apex = corners[opposite];
    const int32_t p = corners[turned[opposite][1]], q = corners[turned[opposite][2]], r = corners[turned[opposite][3]];
    int32_t other = -1;
    const Star *star = &mesh->stars[p];
    for (int32_t i = 0; i < star->count; i++)
        if (star->items[i] != tet && tet_has(mesh, star->items[i], q) && tet_has(mesh, star->items[i], r))
            other = star->items[i];
    if (other < 0 || mesh->labels[other] != mesh->labels[tet] || mesh->used[other] != mesh->used[tet])
        return 0;
    int32_t far = -1;
    for (int k = 0; k < 4; k++) {
        const int32_t corner = tet_corners(mesh, other)[k];
        if (corner != p && corner != q && corner != r)
            far = corner;
    }
    const double before = mesh->share[tet] < mesh->share[other] ? mesh->share[tet] : mesh->share[other];
    const int32_t made[3][4] = {{apex, p, q, far}, {apex, q, r, far}, {apex, r, p, far}};
    for (int k = 0; k < 3; k++) {
        const double share = vhp_tet_share(tet_point(mesh, made[k][0]), tet_point(mesh, made[k][1]),
                                           tet_point(mesh, made[k][2]), tet_point(mesh, made[k][3]),
                                           &mesh->target[mesh->used[tet]]);
        if (!(share > before + least_gain))
            return 0;
    }
    const int32_t label = mesh->labels[tet];
    const uint8_t used = mesh->used[tet];
    if (vhp_tet_reserve(mesh, 3))
        return VHP_OUT_OF_MEMORY;
    vhp_tet_remove(mesh, tet);
    vhp_tet_remove(mesh, other);
    for (int k = 0; k < 3; k++)
        if (vhp_tet_add(mesh, made[k], label, used))
            return VHP_OUT_OF_MEMORY;
    return 1;
}
