/* Whether the new faces of a patch meet any other face of the mesh: exact, as `vhp check` tests it. */
#include "guarded.h"

/* A triangle of at least this quality has a reliable normal, and a point farther than this part of its distance from
 * the plane is off it. */
#define SOUND 0.01
#define SURELY_OFF 1e-9

typedef struct {
    Guarded *g;
    const Patch *patch;
    float boxes[MAX_PATCH][8]; /* of the new faces; eight for wide loads */
    float box[8];              /* of all */
    double least_fold;         /* cosine at the sharpest fold there is now; computed when needed */
    int fold_known;
} Search;

/* Cosine between a face of the patch and another, below which their edge is folded too sharply: what was folded
 * more sharply before may stay so. */
static double fold_limit(Search *search)
{
    const Guarded *g = search->g;
    if (!search->fold_known) {
        double least = g->settings.fold_cosine;
        for (int32_t i = 0; i < search->patch->n_old; i++)
            for (int k = 0; k < 3; k++) {
                const int64_t c = 3 * (int64_t)search->patch->old[i] + k;
                if (g->across[c] < 0)
                    continue;
                const double cosine = dot(g->normal + 3 * (c / 3), g->normal + 3 * (int64_t)(g->across[c] / 3));
                least = cosine < least ? cosine : least;
            }
        search->least_fold = least;
        search->fold_known = 1;
    }
    return search->least_fold;
}

/* 1 if both points surely lie on one side of the plane of a face with vertex `at` and a normal of length 1: a quick
 * look before the exact test. The normal of a face that is no sliver is known to 1e-13 or better. */
static inline int on_one_side(const double *at, const double *normal, const double *p, const double *q)
{
    double to_p[3], to_q[3];
    subtract(p, at, to_p);
    subtract(q, at, to_q);
    const double p_side = dot(to_p, normal), q_side = dot(to_q, normal);
    const double error = SURELY_OFF * (fabs(to_p[0]) + fabs(to_p[1]) + fabs(to_p[2]) + fabs(to_q[0]) +
                                       fabs(to_q[1]) + fabs(to_q[2]));
    return (p_side > error && q_side > error) || (p_side < -error && q_side < -error);
}

/* How two faces meet beyond the vertices they share by number; `f` is a new one. */
static int faces_meet(Search *search, const int32_t *f, const double *f_normal, double f_quality, const int32_t *g,
                      const double *g_normal, double g_quality)
{
    static const int next[3] = {1, 2, 0}, before[3] = {2, 0, 1};
    const Guarded *mesh = search->g;
    unsigned same = 0; /* bit 3k + m: corner k of g is corner m of f */
    for (int k = 0; k < 3; k++)
        for (int m = 0; m < 3; m++)
            same |= (unsigned)(f[m] == g[k]) << (3 * k + m);
    if (!same) {
        const double *a[3] = {place(mesh, f[0]), place(mesh, f[1]), place(mesh, f[2])};
        const double *b[3] = {place(mesh, g[0]), place(mesh, g[1]), place(mesh, g[2])};
        return vhp_triangles_meet(a, b);
    }
    const int first = __builtin_ctz(same), at_f = first % 3, at_g = first / 3;
    const unsigned others = same & (same - 1);
    if (!others) {
        const double *v = place(mesh, f[at_f]), *p = place(mesh, f[next[at_f]]), *q = place(mesh, f[before[at_f]]);
        const double *r = place(mesh, g[next[at_g]]), *s = place(mesh, g[before[at_g]]);
        if ((f_quality > SOUND && on_one_side(v, f_normal, r, s)) ||
            (g_quality > SOUND && on_one_side(v, g_normal, p, q)))
            return APART;
        return triangles_at_vertex_meet(v, p, q, r, s);
    }
    if (others & (others - 1))
        return KIND_DUPLICATE;
    const double cosine = dot(f_normal, g_normal);
    if (cosine < mesh->settings.fold_cosine && cosine < fold_limit(search))
        return KIND_FOLD;
    const int second = __builtin_ctz(others), other_f = second % 3, other_g = second / 3;
    const double *tip = place(mesh, g[3 - at_g - other_g]);
    if (f_quality > SOUND && on_one_side(place(mesh, f[at_f]), f_normal, tip, tip))
        return APART;
    return triangles_at_edge_meet(place(mesh, f[at_f]), place(mesh, f[other_f]), place(mesh, f[3 - at_f - other_f]),
                                  tip);
}

static int is_taken_out(const Patch *patch, int32_t face)
{
    for (int32_t i = 0; i < patch->n_old; i++)
        if (patch->old[i] == face)
            return 1;
    return 0;
}

static int new_faces_meet(Search *search)
{
    const Patch *patch = search->patch;
    for (int32_t i = 0; i < patch->n_new; i++)
        for (int32_t j = 0; j < i; j++)
            if (boxes_overlap(search->boxes[i], search->boxes[j]) &&
                faces_meet(search, patch->vertices[i], patch->normal[i], patch->quality[i], patch->vertices[j],
                           patch->normal[j], patch->quality[j]))
                return 1;
    return 0;
}

/* A face of the mesh against all new ones. */
static int meets_face(Search *search, const BoxNode *leaf)
{
    Guarded *g = search->g;
    const Patch *patch = search->patch;
    const int32_t face = leaf->child[1];
    if (g->degenerate[face] || is_taken_out(patch, face))
        return 0;
    for (int32_t i = 0; i < patch->n_new; i++)
        if (boxes_overlap(search->boxes[i], leaf->box)) {
            g->counts[WORK]++;
            if (faces_meet(search, patch->vertices[i], patch->normal[i], patch->quality[i],
                           g->faces + 3 * (int64_t)face, g->normal + 3 * (int64_t)face, g->quality[face]))
                return 1;
        }
    return 0;
}

int vhp_patch_meets(Guarded *g, const Patch *patch)
{
    Search search;
    int64_t count = 0;
    search.g = g;
    search.patch = patch;
    search.fold_known = 0;
    for (int d = 0; d < 3; d++) {
        search.box[d] = INFINITY;
        search.box[3 + d] = -INFINITY;
    }
    for (int32_t i = 0; i < patch->n_new; i++) {
        float *box = search.boxes[i];
        vhp_face_box(g, patch->vertices[i], box);
        for (int d = 0; d < 3; d++) {
            search.box[d] = box[d] < search.box[d] ? box[d] : search.box[d];
            search.box[3 + d] = box[3 + d] > search.box[3 + d] ? box[3 + d] : search.box[3 + d];
        }
    }
    if (new_faces_meet(&search))
        return 1;
    if (g->root >= 0 && !vhp_push(g, &count, g->root))
        return 1;
    while (count) {
        const BoxNode *node = &g->nodes[g->stack[--count]];
        g->counts[WORK]++;
        if (!boxes_overlap(node->box, search.box))
            continue;
        if (node->child[0] < 0) {
            if (meets_face(&search, node))
                return 1;
        } else if (!vhp_push(g, &count, node->child[0]) || !vhp_push(g, &count, node->child[1])) {
            return 1;
        }
    }
    return 0;
}
