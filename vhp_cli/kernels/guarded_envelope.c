/* The envelope: new faces and edges stay near the reference.
 *
 * If the corners of a face are all within reach of one face of the reference, so is the whole of it, since the points
 * within reach of a convex set are convex. Elsewhere points of the face are looked at. */
#include "guarded.h"

/* 1 if all points (at most three) are within reach of one of the faces `hints`. */
static int share_a_face(Guarded *g, const double *const *points, int count, const double *normal,
                        const int32_t hints[3])
{
    const Tree *tree = g->reference;
    const double reach = g->settings.deviation * g->settings.deviation;
    for (int k = 0; k < count; k++) {
        const int32_t face = hints[k];
        if (face < 0 || (k > 0 && face == hints[k - 1]))
            continue;
        if (normal && dot(normal, g->reference_normal + 3 * (int64_t)face) < LEAST_COSINE)
            continue;
        const double *a = corner(tree, face, 0), *b = corner(tree, face, 1), *c = corner(tree, face, 2);
        int near = 1;
        for (int i = 0; i < count && near; i++) {
            double offset[3];
            subtract(points[i], a, offset);
            const double height = dot(offset, g->reference_normal + 3 * (int64_t)face);
            near = height * height <= reach && box_distance(face_box(tree, face), points[i]) <= reach;
        }
        for (int i = 0; i < count && near; i++) {
            double nearest[3];
            near = vhp_nearest_on_triangle(points[i], a, b, c, nearest) <= reach;
        }
        if (near)
            return 1;
    }
    return 0;
}

static int face_within(Guarded *g, const int32_t *vertices, const double *normal, int thorough)
{
    const double *corners[3] = {place(g, vertices[0]), place(g, vertices[1]), place(g, vertices[2])};
    const int32_t hints[3] = {g->near[vertices[0]], g->near[vertices[1]], g->near[vertices[2]]};
    if (share_a_face(g, corners, 3, normal, hints))
        return 1;
    double point[3];
    for (int d = 0; d < 3; d++)
        point[d] = (corners[0][d] + corners[1][d] + corners[2][d]) / 3;
    if (!vhp_within_reference(g, point, normal, hints))
        return 0;
    for (int k = 0; k < 3 && thorough; k++) {
        for (int d = 0; d < 3; d++)
            point[d] = (corners[0][d] + corners[1][d] + corners[2][d] + 3 * corners[k][d]) / 6;
        if (!vhp_within_reference(g, point, NULL, hints))
            return 0;
    }
    return 1;
}

static int edge_within(Guarded *g, const int32_t *ends, int thorough)
{
    const double *points[2] = {place(g, ends[0]), place(g, ends[1])};
    const int32_t hints[3] = {g->near[ends[0]], g->near[ends[1]], -1};
    if (share_a_face(g, points, 2, NULL, hints))
        return 1;
    const int parts = thorough ? 4 : 2;
    for (int i = 1; i < parts; i++) {
        const double t = (double)i / parts;
        double point[3];
        for (int d = 0; d < 3; d++)
            point[d] = (1 - t) * points[0][d] + t * points[1][d];
        if (!vhp_within_reference(g, point, NULL, hints))
            return 0;
    }
    return 1;
}

int vhp_patch_within(Guarded *g, const Patch *patch, int thorough)
{
    for (int32_t i = 0; i < patch->n_edges; i++)
        if (!edge_within(g, patch->edges[i], thorough))
            return 0;
    for (int32_t i = 0; i < patch->n_new; i++)
        if (!face_within(g, patch->vertices[i], patch->normal[i], thorough))
            return 0;
    return 1;
}
