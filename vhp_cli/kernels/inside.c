/* Is a point inside a closed surface: exact parity of the crossings of a ray. */
#include <stdlib.h>
#include <string.h>

#include "tree.h"
#include "vhp.h"

enum { OUTSIDE = 0, INSIDE = 1, ON_SURFACE = -1 };

/* Side of the line through the (y, z) shadows of u and w on which that of the point lies, the point
 * moved by (e, e^2) for an infinitely small e: never 0 but for u and w with one shadow, and always
 * the opposite for w and u. So a ray meets no edge and no vertex, and two faces at an edge agree. */
static inline int shadow_side(const double *u, const double *w, const double *point)
{
    const int side = orient2d(u[1], u[2], w[1], w[2], point[1], point[2]);
    if (side)
        return side;
    if (u[2] != w[2])
        return u[2] > w[2] ? 1 : -1;
    if (u[1] != w[1])
        return w[1] > u[1] ? 1 : -1;
    return 0;
}

/* 1 if the ray from the point along +x crosses the face, -1 if the point lies on the face. */
static int ray_meets_face(const Tree *tree, int64_t face, const double *point)
{
    const double *a = corner(tree, face, 0), *b = corner(tree, face, 1), *c = corner(tree, face, 2);
    const float *box = face_box(tree, face);
    if (box[0] <= point[0] && vhp_point_on_triangle(point, a, b, c))
        return ON_SURFACE;
    const int turn = shadow_side(a, b, point);
    if (turn == 0 || shadow_side(b, c, point) != turn || shadow_side(c, a, point) != turn)
        return 0;
    /* The shadow runs round as the x component of the normal points. */
    return turn * orient3d(a, b, c, point) < 0;
}

static inline int ray_meets_box(const float *box, const double *point)
{
    return point[0] <= box[3] && box[1] <= point[1] && point[1] <= box[4] && box[2] <= point[2] && point[2] <= box[5];
}

/* Call meet(context, face, result) for each face that the ray crosses or the point lies on, until it
 * returns 0. */
static inline void for_each_on_ray(const Tree *tree, const double *point, int (*meet)(void *, int64_t, int),
                                   void *context)
{
    int64_t waiting[WALK_DEPTH];
    int count = 0;
    if (tree->n_regular)
        waiting[count++] = 0;
    while (count) {
        const int64_t node = waiting[--count];
        if (!ray_meets_box(node_box(tree, node), point))
            continue;
        if (!is_leaf(tree, node)) {
            waiting[count++] = 2 * node + 2;
            waiting[count++] = 2 * node + 1;
            continue;
        }
        const int64_t end = leaf_begin(tree, node + 1);
        for (int64_t i = leaf_begin(tree, node); i < end && i < tree->n_regular; i++) {
            if (!ray_meets_box(face_box(tree, i), point))
                continue;
            const int result = ray_meets_face(tree, i, point);
            if (result && !meet(context, i, result))
                return;
        }
    }
}

static int flip_parity(void *context, int64_t face, int result)
{
    int *place = context;
    (void)face;
    *place = result == ON_SURFACE ? ON_SURFACE : !*place;
    return *place != ON_SURFACE;
}

int vhp_point_place(const Tree *tree, const double *point)
{
    int place = OUTSIDE;
    for_each_on_ray(tree, point, flip_parity, &place);
    return place;
}

/* places (n_points): 1 inside, 0 outside, -1 on the surface. */
VHP_EXPORT void vhp_inside(const Tree *tree, const double *points, int64_t n_points, int8_t *places)
{
    for (int64_t i = 0; i < n_points; i++)
        places[i] = (int8_t)vhp_point_place(tree, points + 3 * i);
}

/* Parity of the crossings with each component along one ray. */
typedef struct {
    const int32_t *labels;  /* per face of the tree */
    uint8_t *odd;           /* per component */
    int32_t own;
    int64_t depth;          /* components crossed an odd number of times */
    int on_other;
} ComponentRay;

static int count_component(void *context, int64_t face, int result)
{
    ComponentRay *ray = context;
    const int32_t label = ray->labels[face];
    if (label < 0 || label == ray->own)
        return 1;
    if (result == ON_SURFACE) {
        ray->on_other = 1;
        return 0;
    }
    ray->depth += ray->odd[label] ? -1 : 1;
    ray->odd[label] = !ray->odd[label];
    return 1;
}

static int forget_component(void *context, int64_t face, int result)
{
    const ComponentRay *ray = context;
    (void)result;
    if (ray->labels[face] >= 0)
        ray->odd[ray->labels[face]] = 0;
    return 1;
}

/* How many other components contain each component of a mesh.
 *
 * caller_labels (n_faces): component of each of the caller's faces; those with -1 are ignored.
 * depths, undecided (n_components). A vertex that lies on another component says nothing, so others
 * are tried; a component of which every vertex lies on others is undecided, with depth 0.
 * Returns 0, or -1 if memory runs out. */
VHP_EXPORT int vhp_component_depths(const Tree *tree, const int32_t *caller_labels, int64_t n_components,
                                    int32_t *depths, uint8_t *undecided)
{
    int status = VHP_OUT_OF_MEMORY;
    int32_t *labels = malloc((size_t)tree->n_faces * sizeof *labels + 1);
    uint8_t *odd = calloc((size_t)n_components + 1, 1);
    uint8_t *tried = calloc((size_t)tree->n_vertices + 1, 1);
    if (labels && odd && tried) {
        for (int64_t i = 0; i < tree->n_faces; i++)
            labels[i] = caller_labels[tree->numbers[i]];
        for (int64_t c = 0; c < n_components; c++) {
            depths[c] = 0;
            undecided[c] = 1;
        }
        for (int64_t i = 0; i < tree->n_faces; i++)
            for (int k = 0; k < 3; k++) {
                const int32_t vertex = tree->faces[3 * i + k];
                if (labels[i] < 0 || !undecided[labels[i]] || tried[vertex])
                    continue;
                ComponentRay ray = {.labels = labels, .odd = odd, .own = labels[i]};
                tried[vertex] = 1;
                for_each_on_ray(tree, corner(tree, i, k), count_component, &ray);
                for_each_on_ray(tree, corner(tree, i, k), forget_component, &ray);
                if (!ray.on_other) {
                    depths[labels[i]] = (int32_t)ray.depth;
                    undecided[labels[i]] = 0;
                }
            }
        status = 0;
    }
    free(labels);
    free(odd);
    free(tried);
    return status;
}
