/* The search tree over the faces of one mesh, and walks over it.
 *
 * Faces are sorted along a Morton curve and dealt out evenly to a power of two of leaves; the nodes
 * form a heap, so there are no pointers: node q has the children 2q + 1 and 2q + 2. Faces with zero
 * area come last, out of the way of all tests that ignore them. Vertices are renumbered in the order
 * in which the faces use them, so that neighbours in space are neighbours in memory.
 */
#ifndef VHP_TREE_H
#define VHP_TREE_H

#include <math.h>
#include <stdint.h>
#ifdef __SSE2__
#include <emmintrin.h>
#endif

#include "triangles.h"

/* Mirrored by `_TreeView` in spatial.py. */
typedef struct {
    int64_t n_faces, n_regular; /* all, and those with an area: they come first */
    int64_t n_vertices;
    int64_t n_leaves, levels;   /* n_leaves = 2^levels */
    const double *vertices;     /* (n_vertices, 3) */
    const int32_t *faces;       /* (n_faces, 3) */
    const int32_t *numbers;     /* the caller's number of each face */
    const float *face_boxes;    /* (n_faces + 1, 6): lower and upper corner, rounded outward */
    const float *boxes;         /* (2 n_leaves, 6); the last row of both is only room for wide loads */
} Tree;

/* For boxes: a float that is not above, or not below, a number. */
static inline float round_down(double x)
{
    const float nearest = (float)x;
    /* One ulp is at most 2^-23 = 1.192e-7 of the number, or the smallest denormal. */
    return (double)nearest > x ? nearest - (fabsf(nearest) * 1.2e-7f + 3e-45f) : nearest;
}

static inline float round_up(double x)
{
    return -round_down(-x);
}

/* A walk holds at most three waiting nodes per level of a tree, or one per level of each of two, and
 * a tree of less than 2^31 faces has at most 31 levels: 96 places suffice for every walk. */
#define WALK_DEPTH 96

static inline int is_leaf(const Tree *tree, int64_t node)
{
    return node >= tree->n_leaves - 1;
}

/* First face of leaf node `node`; that of `node + 1` is its end. */
static inline int64_t leaf_begin(const Tree *tree, int64_t node)
{
    return ((node - (tree->n_leaves - 1)) * tree->n_faces) >> tree->levels;
}

/* First face below any node. */
static inline int64_t node_begin(const Tree *tree, int64_t node)
{
    while (!is_leaf(tree, node))
        node = 2 * node + 1;
    return leaf_begin(tree, node);
}

static inline int only_degenerate(const Tree *tree, int64_t node)
{
    return tree->n_regular < tree->n_faces && node_begin(tree, node) >= tree->n_regular;
}

static inline const double *corner(const Tree *tree, int64_t face, int k)
{
    return tree->vertices + 3 * (int64_t)tree->faces[3 * face + k];
}

static inline const float *node_box(const Tree *tree, int64_t node)
{
    return tree->boxes + 6 * node;
}

static inline const float *face_box(const Tree *tree, int64_t face)
{
    return tree->face_boxes + 6 * face;
}

/* Without branches: which of the six comparisons fails first can't be predicted. */
static inline int boxes_overlap(const float *a, const float *b)
{
#ifdef __SSE2__
    const __m128 below = _mm_cmple_ps(_mm_loadu_ps(a), _mm_loadu_ps(b + 3));
    const __m128 above = _mm_cmple_ps(_mm_loadu_ps(b), _mm_loadu_ps(a + 3));
    return (_mm_movemask_ps(_mm_and_ps(below, above)) & 7) == 7;
#else
    return (a[0] <= b[3]) & (b[0] <= a[3]) & (a[1] <= b[4]) & (b[1] <= a[4]) & (a[2] <= b[5]) & (b[2] <= a[5]);
#endif
}

static inline float box_size(const float *box)
{
    return (box[3] - box[0]) + (box[4] - box[1]) + (box[5] - box[2]);
}

/* Call visit(context, i, j) for all faces i of a and j of b with an area whose boxes overlap, until it returns 0. */
static inline void for_each_box_pair(const Tree *a, const Tree *b, int (*visit)(void *, int64_t, int64_t),
                                     void *context)
{
    struct { int64_t a, b; } waiting[WALK_DEPTH];
    int count = 0;
    if (!a->n_regular || !b->n_regular)
        return;
    waiting[count].a = waiting[count].b = 0;
    count++;
    while (count) {
        count--;
        const int64_t node_a = waiting[count].a, node_b = waiting[count].b;
        const float *box_a = node_box(a, node_a), *box_b = node_box(b, node_b);
        if (!boxes_overlap(box_a, box_b) || only_degenerate(a, node_a) || only_degenerate(b, node_b))
            continue;
        const int leaf_a = is_leaf(a, node_a), leaf_b = is_leaf(b, node_b);
        if (leaf_a && leaf_b) {
            const int64_t end_a = leaf_begin(a, node_a + 1), end_b = leaf_begin(b, node_b + 1);
            for (int64_t i = leaf_begin(a, node_a); i < end_a && i < a->n_regular; i++) {
                if (!boxes_overlap(face_box(a, i), box_b))
                    continue;
                for (int64_t j = leaf_begin(b, node_b); j < end_b && j < b->n_regular; j++)
                    if (boxes_overlap(face_box(a, i), face_box(b, j)) && !visit(context, i, j))
                        return;
            }
        } else if (leaf_b || (!leaf_a && box_size(box_a) >= box_size(box_b))) {
            for (int64_t child = 2 * node_a + 1; child <= 2 * node_a + 2; child++, count++) {
                waiting[count].a = child;
                waiting[count].b = node_b;
            }
        } else {
            for (int64_t child = 2 * node_b + 1; child <= 2 * node_b + 2; child++, count++) {
                waiting[count].a = node_a;
                waiting[count].b = child;
            }
        }
    }
}

/* 1 if the point is inside the closed surface, 0 outside, -1 on it (inside.c). */
int vhp_point_place(const Tree *tree, const double *point);

/* Volume inside a surface of which every edge is used as often in one direction as in the other (below 0
 * if it is oriented inward), 0 if it is open; the edges are compared by the sum of their 64-bit hashes
 * (enclosed.c). */
double vhp_enclosed_volume(const Tree *tree);

/* Fill face_boxes and boxes from the vertices and faces. */
void vhp_fit_boxes(const Tree *tree, float *face_boxes, float *boxes);

#endif
