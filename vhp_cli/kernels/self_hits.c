/* Pairs of faces of one mesh that meet where the mesh does not join them. */
#include "hits.h"
#include "tree.h"
#include "vhp.h"

/* Faces i and j of one mesh. What they share by vertex number is no contact. */
static inline int faces_meet(const Tree *tree, int64_t i, int64_t j)
{
    static const int next[3] = {1, 2, 0}, before[3] = {2, 0, 1};
    const int32_t *f = tree->faces + 3 * i, *g = tree->faces + 3 * j;
    unsigned same = 0; /* bit 3k + m: corner k of g is corner m of f */
    for (int k = 0; k < 3; k++)
        for (int m = 0; m < 3; m++)
            same |= (unsigned)(f[m] == g[k]) << (3 * k + m);
    if (!same) {
        const double *a[3] = {corner(tree, i, 0), corner(tree, i, 1), corner(tree, i, 2)};
        const double *b[3] = {corner(tree, j, 0), corner(tree, j, 1), corner(tree, j, 2)};
        return vhp_triangles_meet(a, b);
    }
    const int first = __builtin_ctz(same), at_f = first % 3, at_g = first / 3;
    const unsigned others = same & (same - 1);
    if (!others)
        return triangles_at_vertex_meet(corner(tree, i, at_f), corner(tree, i, next[at_f]),
                                        corner(tree, i, before[at_f]), corner(tree, j, next[at_g]),
                                        corner(tree, j, before[at_g]));
    if (others & (others - 1))
        return KIND_DUPLICATE;
    const int second = __builtin_ctz(others), other_f = second % 3, other_g = second / 3;
    return triangles_at_edge_meet(corner(tree, i, at_f), corner(tree, i, other_f), corner(tree, i, 3 - at_f - other_f),
                                  corner(tree, j, 3 - at_g - other_g));
}

static inline void test_faces(const Tree *tree, Hits *hits, int64_t i, int64_t j)
{
    if (!boxes_overlap(face_box(tree, i), face_box(tree, j)))
        return;
    const int kind = faces_meet(tree, i, j);
    if (kind)
        add_hit(hits, kind, i, j);
}

/* pairs (limit, 2), kinds (limit), counts (10): see finish_hits. Returns the number of pairs
 * written, or -1 if memory runs out. */
VHP_EXPORT int64_t vhp_self_hits(const Tree *tree, int64_t limit, int32_t *pairs, uint8_t *kinds, int64_t *counts)
{
    struct { int64_t a, b; } waiting[WALK_DEPTH];
    int count = 0;
    Hits hits;
    if (!start_hits(&hits, limit, tree->n_faces, -1))
        return VHP_OUT_OF_MEMORY;
    if (tree->n_regular) {
        waiting[0].a = waiting[0].b = 0;
        count = 1;
    }
    while (count && wants_more(&hits)) {
        count--;
        const int64_t a = waiting[count].a, b = waiting[count].b; /* of one level; a <= b */
        if (only_degenerate(tree, b))
            continue;
        if (is_leaf(tree, a)) {
            int64_t end_a = leaf_begin(tree, a + 1), end_b = leaf_begin(tree, b + 1);
            end_a = end_a < tree->n_regular ? end_a : tree->n_regular;
            end_b = end_b < tree->n_regular ? end_b : tree->n_regular;
            for (int64_t i = leaf_begin(tree, a); i < end_a; i++)
                for (int64_t j = a == b ? i + 1 : leaf_begin(tree, b); j < end_b; j++)
                    test_faces(tree, &hits, i, j);
            continue;
        }
        const int64_t first_a = 2 * a + 1, first_b = 2 * b + 1;
        for (int64_t child_a = first_a; child_a <= first_a + 1; child_a++)
            for (int64_t child_b = a == b ? child_a : first_b; child_b <= first_b + 1; child_b++) {
                waiting[count].a = child_a;
                waiting[count].b = child_b;
                count += child_a == child_b || boxes_overlap(node_box(tree, child_a), node_box(tree, child_b));
            }
    }
    return finish_hits(&hits, tree->numbers, tree->n_faces, tree->numbers, tree->n_faces, pairs, kinds, counts);
}
