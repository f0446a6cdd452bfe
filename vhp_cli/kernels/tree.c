/* Build the search tree: sort the faces along a Morton curve and fit the boxes (see tree.h). */
#include "tree.h"

#include <stdlib.h>
#include <string.h>

#include "vhp.h"

#define OUT_OF_RANGE (-2)
#define TOO_SMALL (-3)
#define LARGEST 1e38 /* see predicates.h */
#define SMALLEST 1e-60

/* Morton keys have 16 bits per axis and are sorted by 12 bits at a time. */
#define AXIS_CELLS 65535.0
#define KEY_BITS 48
#define DIGIT_BITS 12
#define DIGITS (1 << DIGIT_BITS)

/* Faces with the same key are sorted again, by a finer key, from this number on. */
#define LONG_RUN 8

typedef struct {
    const double *vertices;
    const int32_t *faces;
    uint64_t *keys, *spare_keys;
    int32_t *order, *spare_order;
} Sorting;

/* Move bit k of the lower 16 bits to bit 3k. */
static inline uint64_t spread_bits(uint64_t x)
{
    x = (x | x << 16) & 0x0000ff0000ffULL;
    x = (x | x << 8) & 0x00f00f00f00fULL;
    x = (x | x << 4) & 0x0c30c30c30c3ULL;
    return (x | x << 2) & 0x249249249249ULL;
}

static inline void face_centre(const Sorting *s, int32_t face, double *centre)
{
    const double *a = s->vertices + 3 * (int64_t)s->faces[3 * (int64_t)face];
    const double *b = s->vertices + 3 * (int64_t)s->faces[3 * (int64_t)face + 1];
    const double *c = s->vertices + 3 * (int64_t)s->faces[3 * (int64_t)face + 2];
    for (int d = 0; d < 3; d++)
        centre[d] = (a[d] + b[d] + c[d]) / 3.0;
}

/* Stable radix sort of order[begin..end) by keys. */
static void sort_by_key(const Sorting *s, int64_t begin, int64_t end)
{
    uint64_t *keys = s->keys + begin, *other_keys = s->spare_keys + begin;
    int32_t *order = s->order + begin, *other_order = s->spare_order + begin;
    const int64_t count = end - begin;
    /* An even number of passes: the result is back in the first pair of arrays. */
    for (int shift = 0; shift < KEY_BITS; shift += DIGIT_BITS) {
        int64_t place[DIGITS] = {0}, sum = 0;
        for (int64_t i = 0; i < count; i++)
            place[(keys[i] >> shift) & (DIGITS - 1)]++;
        for (int digit = 0; digit < DIGITS; digit++) {
            const int64_t number = place[digit];
            place[digit] = sum;
            sum += number;
        }
        for (int64_t i = 0; i < count; i++) {
            const int64_t target = place[(keys[i] >> shift) & (DIGITS - 1)]++;
            other_keys[target] = keys[i];
            other_order[target] = order[i];
        }
        uint64_t *swap_keys = keys;
        int32_t *swap_order = order;
        keys = other_keys;
        other_keys = swap_keys;
        order = other_order;
        other_order = swap_order;
    }
}

/* Insertion sort for a few faces. */
static void sort_few(const Sorting *s, int64_t begin, int64_t end)
{
    for (int64_t i = begin + 1; i < end; i++) {
        const uint64_t key = s->keys[i];
        const int32_t face = s->order[i];
        int64_t j = i;
        for (; j > begin && s->keys[j - 1] > key; j--) {
            s->keys[j] = s->keys[j - 1];
            s->order[j] = s->order[j - 1];
        }
        s->keys[j] = key;
        s->order[j] = face;
    }
}

/* Grow the box lower, upper by a point. */
static inline void grow_box(double *box, const double *point)
{
    for (int d = 0; d < 3; d++) {
        box[d] = point[d] < box[d] ? point[d] : box[d];
        box[3 + d] = point[d] > box[3 + d] ? point[d] : box[3 + d];
    }
}

static const double empty_box[6] = {INFINITY, INFINITY, INFINITY, -INFINITY, -INFINITY, -INFINITY};

/* Sort order[begin..end) along the Morton curve through a box that holds the face centres. A far
 * outlier can press all other faces into one cell; such runs are sorted again in a box of their own.
 * That box is smaller by 2^16 each time, from 1e38 to no less than 1e-76: at most 24 levels. */
static void sort_along_curve(const Sorting *s, int64_t begin, int64_t end, const double *box)
{
    double size = 0, centre[3];
    for (int d = 0; d < 3; d++)
        size = box[3 + d] - box[d] > size ? box[3 + d] - box[d] : size;
    if (!(size > 0))
        return;
    const double scale = AXIS_CELLS / size;
    for (int64_t i = begin; i < end; i++) {
        face_centre(s, s->order[i], centre);
        s->keys[i] = 0;
        for (int d = 0; d < 3; d++) {
            const double cell = (centre[d] - box[d]) * scale; /* a centre may leave the box by rounding */
            s->keys[i] |= spread_bits(cell > 0 ? (uint64_t)cell : 0) << d;
        }
    }
    if (end - begin > 64)
        sort_by_key(s, begin, end);
    else
        sort_few(s, begin, end);
    for (int64_t i = begin; i < end;) {
        int64_t run_end = i + 1;
        while (run_end < end && s->keys[run_end] == s->keys[i])
            run_end++;
        if (run_end - i >= LONG_RUN) {
            double run_box[6];
            memcpy(run_box, empty_box, sizeof run_box);
            for (int64_t j = i; j < run_end; j++) {
                face_centre(s, s->order[j], centre);
                grow_box(run_box, centre);
            }
            sort_along_curve(s, i, run_end, run_box);
        }
        i = run_end;
    }
}

static int has_area(const double *vertices, const int32_t *face)
{
    if (face[0] == face[1] || face[1] == face[2] || face[2] == face[0])
        return 0;
    const double *a = vertices + 3 * (int64_t)face[0], *b = vertices + 3 * (int64_t)face[1];
    const double *c = vertices + 3 * (int64_t)face[2];
    const Plane p = plane_of(a, b, c);
    for (int d = 0; d < 3; d++)
        if (fabs(p.normal[d]) > PLANE_SIDE_ERROR * p.scale[d])
            return 1;
    return vhp_projection_axis(a, b, c) >= 0;
}

void vhp_fit_boxes(const Tree *tree, float *face_boxes, float *boxes)
{
    for (int64_t i = 0; i < tree->n_faces; i++) {
        const double *a = corner(tree, i, 0), *b = corner(tree, i, 1), *c = corner(tree, i, 2);
        float *box = face_boxes + 6 * i;
        for (int d = 0; d < 3; d++) {
            const double low = a[d] < b[d] ? a[d] : b[d], high = a[d] < b[d] ? b[d] : a[d];
            box[d] = round_down(low < c[d] ? low : c[d]);
            box[3 + d] = round_up(high > c[d] ? high : c[d]);
        }
    }
    for (int64_t node = 2 * tree->n_leaves - 2; node >= 0; node--) {
        float *box = boxes + 6 * node;
        const int leaf = is_leaf(tree, node);
        int64_t part = leaf ? leaf_begin(tree, node) : 2 * node + 1;
        const int64_t end = leaf ? leaf_begin(tree, node + 1) : 2 * node + 3;
        const float *parts = leaf ? face_boxes : boxes;
        for (int d = 0; d < 3; d++) {
            box[d] = INFINITY;
            box[3 + d] = -INFINITY;
        }
        for (; part < end; part++)
            for (int d = 0; d < 3; d++) {
                box[d] = parts[6 * part + d] < box[d] ? parts[6 * part + d] : box[d];
                box[3 + d] = parts[6 * part + 3 + d] > box[3 + d] ? parts[6 * part + 3 + d] : box[3 + d];
            }
    }
}

/* Copy the vertices that faces use, in order of first use; `renumbered` (n_vertices) maps old to new. */
static int64_t renumber(const double *vertices, int64_t n_vertices, const int32_t *faces, int64_t n_faces,
                        const int32_t *order, int32_t *renumbered, double *vertices_out, int32_t *faces_out)
{
    int32_t used = 0;
    for (int64_t v = 0; v < n_vertices; v++)
        renumbered[v] = -1;
    for (int64_t i = 0; i < n_faces; i++)
        for (int k = 0; k < 3; k++) {
            const int32_t vertex = faces[3 * (int64_t)order[i] + k];
            if (renumbered[vertex] < 0) {
                memcpy(vertices_out + 3 * (int64_t)used, vertices + 3 * (int64_t)vertex, 3 * sizeof *vertices);
                renumbered[vertex] = used++;
            }
            faces_out[3 * i + k] = renumbered[vertex];
        }
    return used;
}

/* Build a tree over faces (n_faces, 3) of vertices (n_vertices, 3).
 *
 * vertices_out (n_vertices, 3; only the first `counts[1]` rows are filled), faces_out, numbers_out,
 * face_boxes (n_faces + 1, 6), boxes (2 n_leaves, 6): the arrays of the Tree of 2^levels leaves.
 * counts: faces with an area, vertices in use. bounds: lower and upper corner.
 * Returns 0, -1 (out of memory), -2 (a coordinate is not finite or above 1e38) or -3 (a coordinate
 * is smaller than 1e-60, but not 0). */
VHP_EXPORT int vhp_tree_build(const double *vertices, int64_t n_vertices, const int32_t *faces, int64_t n_faces,
                              int64_t levels, double *vertices_out, int32_t *faces_out, int32_t *numbers_out,
                              float *face_boxes, float *boxes, int64_t *counts, double *bounds)
{
    const size_t n = (size_t)n_faces;
    memset(face_boxes + 6 * n, 0, 6 * sizeof *face_boxes);
    memset(boxes + 6 * (((size_t)2 << levels) - 1), 0, 6 * sizeof *boxes);
    memcpy(bounds, empty_box, sizeof empty_box);
    for (int64_t i = 0; i < 3 * n_faces; i++) {
        const double *vertex = vertices + 3 * (int64_t)faces[i];
        for (int d = 0; d < 3; d++) {
            if (!(fabs(vertex[d]) <= LARGEST))
                return OUT_OF_RANGE;
            if (fabs(vertex[d]) < SMALLEST && vertex[d] != 0)
                return TOO_SMALL;
        }
        grow_box(bounds, vertex);
    }

    int status = VHP_OUT_OF_MEMORY;
    uint64_t *keys = malloc(2 * n * sizeof *keys + 1);
    int32_t *spare_order = malloc(n * sizeof *spare_order + 1);
    int32_t *renumbered = malloc((size_t)n_vertices * sizeof *renumbered + 1);
    if (keys && spare_order && renumbered) {
        const Sorting sorting = {vertices, faces, keys, keys + n, numbers_out, spare_order};
        int64_t n_regular = 0, n_degenerate = 0;
        for (int64_t i = 0; i < n_faces; i++) {
            if (has_area(vertices, faces + 3 * i))
                numbers_out[n_regular++] = (int32_t)i;
            else
                spare_order[n_degenerate++] = (int32_t)i;
        }
        memcpy(numbers_out + n_regular, spare_order, (size_t)n_degenerate * sizeof *spare_order);
        sort_along_curve(&sorting, 0, n_regular, bounds);
        sort_along_curve(&sorting, n_regular, n_faces, bounds);
        counts[0] = n_regular;
        counts[1] = renumber(vertices, n_vertices, faces, n_faces, numbers_out, renumbered, vertices_out, faces_out);
        const Tree tree = {n_faces,      n_regular, counts[1],   (int64_t)1 << levels, levels,
                           vertices_out, faces_out, numbers_out, face_boxes,           boxes};
        vhp_fit_boxes(&tree, face_boxes, boxes);
        status = 0;
    }
    free(keys);
    free(spare_order);
    free(renumbered);
    return status;
}
