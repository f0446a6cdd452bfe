/* Pairs of faces of two meshes that meet. */
#include "hits.h"
#include "tree.h"
#include "vhp.h"

typedef struct {
    const Tree *a, *b;
    Hits hits;
} PairTest;

static int test_faces(void *context, int64_t i, int64_t j)
{
    PairTest *test = context;
    const double *a[3] = {corner(test->a, i, 0), corner(test->a, i, 1), corner(test->a, i, 2)};
    const double *b[3] = {corner(test->b, j, 0), corner(test->b, j, 1), corner(test->b, j, 2)};
    const int kind = vhp_triangles_meet(a, b);
    if (kind)
        add_hit(&test->hits, kind, i, j);
    return wants_more(&test->hits);
}

/* pairs (limit, 2), kinds (limit), counts (10): see finish_hits. Returns the number of pairs
 * written, or -1 if memory runs out. */
VHP_EXPORT int64_t vhp_pair_hits(const Tree *a, const Tree *b, int64_t limit, int32_t *pairs, uint8_t *kinds,
                                 int64_t *counts)
{
    PairTest test = {.a = a, .b = b};
    if (!start_hits(&test.hits, limit, a->n_faces, b->n_faces))
        return VHP_OUT_OF_MEMORY;
    for_each_box_pair(a, b, test_faces, &test);
    return finish_hits(&test.hits, a->numbers, a->n_faces, b->numbers, b->n_faces, pairs, kinds, counts);
}
