/* The face on the other side of a gap, a wall, or of a region that two sheets of one surface enclose wrongly. */
#include <math.h>
#include <string.h>

#include "distance.h"
#include "tree.h"
#include "vector.h"
#include "vhp.h"

static double squared_box_distance(const double *point, const float *box)
{
    double sum = 0;
    for (int d = 0; d < 3; d++) {
        const double below = (double)box[d] - point[d], above = point[d] - (double)box[3 + d];
        const double apart = below > above ? below : above;
        sum += apart > 0 ? apart * apart : 0;
    }
    return sum;
}

/* What is sought from one vertex. */
typedef struct {
    const double *point, *normal;
    int32_t vertex;         /* by the caller's numbers; its own faces do not count */
    int side;               /* +1: the vertex is behind the face; -1: in front of it */
    const int32_t *faces;   /* the caller's faces */
} Query;

/* Shape of the face if it looks against the vertex and has it on the wanted side; 0 if not. */
static int is_opposite(const Tree *tree, const Query *query, int64_t face, Shape *shape)
{
    const int32_t *own = query->faces + 3 * (int64_t)tree->numbers[face];
    if (own[0] == query->vertex || own[1] == query->vertex || own[2] == query->vertex)
        return 0;
    double offset[3], normal[3];
    vhp_shape_of(shape, corner(tree, face, 0), corner(tree, face, 1), corner(tree, face, 2));
    cross(shape->edge[0], shape->edge[1], normal);
    if (!(dot(normal, query->normal) < 0))
        return 0;
    subtract(query->point, shape->v[0], offset);
    return dot(normal, offset) * query->side <= 0;
}

/* Nearest such face within the square root of `best`, and the point on it; -1 if there is none. */
static int64_t nearest_opposite(const Tree *tree, const Query *query, double best, double place[3])
{
    int64_t waiting[WALK_DEPTH], found = -1;
    int count = 0;
    if (tree->n_regular)
        waiting[count++] = 0;
    while (count) {
        const int64_t node = waiting[--count];
        if (squared_box_distance(query->point, node_box(tree, node)) >= best)
            continue;
        if (!is_leaf(tree, node)) {
            const double left = squared_box_distance(query->point, node_box(tree, 2 * node + 1));
            const double right = squared_box_distance(query->point, node_box(tree, 2 * node + 2));
            waiting[count++] = 2 * node + (left <= right ? 2 : 1);
            waiting[count++] = 2 * node + (left <= right ? 1 : 2);
            continue;
        }
        const int64_t end = leaf_begin(tree, node + 1);
        for (int64_t face = leaf_begin(tree, node); face < end && face < tree->n_regular; face++) {
            Shape shape;
            double candidate[3];
            if (squared_box_distance(query->point, face_box(tree, face)) >= best ||
                !is_opposite(tree, query, face, &shape))
                continue;
            const double squared = vhp_point_distance(query->point, &shape, best, candidate);
            if (squared < best) {
                best = squared;
                found = face;
                memcpy(place, candidate, sizeof candidate);
            }
        }
    }
    return found;
}

/* For each of n_queries vertices (caller's numbers, with points and unit normals): the nearest face within
 * `reach` that looks against it and has it behind (side +1) or in front (side -1).
 * found (n_queries, caller's numbers, -1: none), places (n_queries, 3). */
VHP_EXPORT void vhp_opposite(const Tree *tree, const int32_t *faces, const int32_t *vertices, const double *points,
                             const double *normals, const int8_t *sides, int64_t n_queries, double reach,
                             int32_t *found, double *places)
{
    for (int64_t i = 0; i < n_queries; i++) {
        const Query query = {points + 3 * i, normals + 3 * i, vertices[i], sides[i], faces};
        /* A face at a distance of exactly `reach` counts. */
        const int64_t face = nearest_opposite(tree, &query, reach * reach * (1 + 1e-12) + 1e-300, places + 3 * i);
        found[i] = face < 0 ? -1 : tree->numbers[face];
    }
}
