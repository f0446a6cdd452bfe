/* Search tree of boxes over the faces of a mesh that changes.
 *
 * Built top-down by medians. Afterwards a face that moves refits the boxes above it, a new face becomes
 * the sibling of the one that it was split from, and a face that goes is cut out. Boxes are rounded outward. */
#include <stdlib.h>
#include <string.h>

#include "guarded.h"

/* The tree is built anew after this many changes per face; until then it only grows a little looser. */
#define STALE_AFTER 0.5

void vhp_face_box(const Guarded *g, const int32_t *vertices, float *box)
{
    const double *a = place(g, vertices[0]), *b = place(g, vertices[1]), *c = place(g, vertices[2]);
    for (int d = 0; d < 3; d++) {
        const double low = a[d] < b[d] ? a[d] : b[d], high = a[d] < b[d] ? b[d] : a[d];
        box[d] = round_down(low < c[d] ? low : c[d]);
        box[3 + d] = round_up(high > c[d] ? high : c[d]);
    }
}

static void join_boxes(const float *a, const float *b, float *box)
{
    for (int d = 0; d < 3; d++) {
        box[d] = a[d] < b[d] ? a[d] : b[d];
        box[3 + d] = a[3 + d] > b[3 + d] ? a[3 + d] : b[3 + d];
    }
}

/* Twice the centre of a face's box along an axis. */
static inline float key_of(const Guarded *g, int32_t face, int axis)
{
    const float *box = g->nodes[g->leaf[face]].box;
    return box[axis] + box[3 + axis];
}

/* Put the `rank` smallest faces of order[begin..end) first (Hoare's selection). */
static void select_smallest(const Guarded *g, int32_t *order, int64_t begin, int64_t end, int64_t rank, int axis)
{
    int64_t low = begin, high = end - 1;
    while (low < high) {
        const float pivot = key_of(g, order[low + (high - low) / 2], axis);
        int64_t i = low, j = high;
        while (i <= j) {
            while (key_of(g, order[i], axis) < pivot)
                i++;
            while (key_of(g, order[j], axis) > pivot)
                j--;
            if (i <= j) {
                const int32_t kept = order[i];
                order[i++] = order[j];
                order[j--] = kept;
            }
        }
        if (rank <= j)
            high = j;
        else if (rank >= i)
            low = i;
        else
            return;
    }
}

/* Node over order[begin..end); inner nodes are numbered from g->n_nodes on. The halves differ by one at
 * most, so the recursion is no deeper than 31. */
static int32_t build_node(Guarded *g, int32_t *order, int64_t begin, int64_t end)
{
    if (end - begin == 1)
        return g->leaf[order[begin]];
    float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (int64_t i = begin; i < end; i++)
        for (int d = 0; d < 3; d++) {
            const float key = key_of(g, order[i], d);
            low[d] = key < low[d] ? key : low[d];
            high[d] = key > high[d] ? key : high[d];
        }
    int axis = 0;
    for (int d = 1; d < 3; d++)
        if (high[d] - low[d] > high[axis] - low[axis])
            axis = d;
    const int64_t middle = begin + (end - begin) / 2;
    select_smallest(g, order, begin, end, middle, axis);
    const int32_t node = (int32_t)g->n_nodes++;
    const int32_t left = build_node(g, order, begin, middle), right = build_node(g, order, middle, end);
    BoxNode *made = &g->nodes[node];
    made->child[0] = left;
    made->child[1] = right;
    g->nodes[left].parent = g->nodes[right].parent = node;
    join_boxes(g->nodes[left].box, g->nodes[right].box, made->box);
    return node;
}

static void set_leaf(Guarded *g, int32_t node, int32_t face)
{
    BoxNode *leaf = &g->nodes[node];
    vhp_face_box(g, g->faces + 3 * (int64_t)face, leaf->box);
    leaf->child[0] = -1;
    leaf->child[1] = face;
    g->leaf[face] = node;
}

/* Build the tree if there is none, or if it has changed much; 0 if memory runs out. */
int vhp_boxes_build(Guarded *g)
{
    if (g->root >= 0 && (double)g->changes < STALE_AFTER * (double)g->n_live_faces)
        return 1;
    int32_t *order = malloc((size_t)g->n_live_faces * sizeof *order + 1);
    if (!order)
        return 0;
    int64_t count = 0;
    g->n_nodes = 0;
    g->free_node = -1;
    for (int32_t f = 0; f < g->n_faces; f++)
        if (is_live(g, f)) {
            set_leaf(g, (int32_t)g->n_nodes++, f);
            order[count++] = f;
        }
    g->root = -1;
    if (count) {
        g->root = build_node(g, order, 0, count);
        g->nodes[g->root].parent = -1;
    }
    g->changes = 0;
    free(order);
    return 1;
}

static void refit_above(Guarded *g, int32_t node)
{
    while (node >= 0) {
        BoxNode *above = &g->nodes[node];
        float box[6];
        join_boxes(g->nodes[above->child[0]].box, g->nodes[above->child[1]].box, box);
        if (!memcmp(box, above->box, sizeof box))
            return;
        memcpy(above->box, box, sizeof box);
        node = above->parent;
    }
}

void vhp_boxes_refit(Guarded *g, int32_t face)
{
    if (g->root < 0)
        return; /* there is no tree */
    BoxNode *leaf = &g->nodes[g->leaf[face]];
    vhp_face_box(g, g->faces + 3 * (int64_t)face, leaf->box);
    refit_above(g, leaf->parent);
}

static int32_t new_node(Guarded *g)
{
    if (g->free_node < 0)
        return (int32_t)g->n_nodes++;
    const int32_t node = g->free_node;
    g->free_node = g->nodes[node].parent;
    return node;
}

/* Add a face as the sibling of another; a tree over n faces has 2 n - 1 nodes, so there is room. */
void vhp_boxes_insert(Guarded *g, int32_t face, int32_t beside)
{
    const int32_t sibling = g->leaf[beside], parent = g->nodes[sibling].parent;
    const int32_t leaf = new_node(g), inner = new_node(g);
    set_leaf(g, leaf, face);
    BoxNode *made = &g->nodes[inner];
    made->parent = parent;
    made->child[0] = sibling;
    made->child[1] = leaf;
    g->nodes[sibling].parent = g->nodes[leaf].parent = inner;
    join_boxes(g->nodes[sibling].box, g->nodes[leaf].box, made->box);
    if (parent < 0)
        g->root = inner;
    else
        g->nodes[parent].child[g->nodes[parent].child[1] == sibling] = inner;
    refit_above(g, parent);
    g->changes++;
}

static void free_node(Guarded *g, int32_t node)
{
    g->nodes[node].parent = g->free_node;
    g->free_node = node;
}

void vhp_boxes_remove(Guarded *g, int32_t face)
{
    if (g->root < 0)
        return;
    const int32_t leaf = g->leaf[face], parent = g->nodes[leaf].parent;
    g->changes++;
    if (parent < 0) {
        g->root = -1;
        free_node(g, leaf);
        return;
    }
    const int32_t sibling = g->nodes[parent].child[g->nodes[parent].child[0] == leaf];
    const int32_t above = g->nodes[parent].parent;
    g->nodes[sibling].parent = above;
    if (above < 0)
        g->root = sibling;
    else
        g->nodes[above].child[g->nodes[above].child[1] == parent] = sibling;
    free_node(g, leaf);
    free_node(g, parent);
    refit_above(g, above);
}

int vhp_push(Guarded *g, int64_t *count, int32_t node)
{
    if (*count == g->stack_room) {
        const int64_t room = 2 * g->stack_room + 64;
        int32_t *stack = realloc(g->stack, (size_t)room * sizeof *stack);
        if (!stack) {
            g->failed = 1;
            return 0;
        }
        g->stack = stack;
        g->stack_room = room;
    }
    g->stack[(*count)++] = node;
    return 1;
}
