/* The surface to stay at: nearest points of it, and the edge length wanted there. */
#include <string.h>

#include "guarded.h"

/* Squared distance of a point, and the point of the triangle nearest to it (Ericson 2005, Real-time collision
 * detection, 5.1.5). */
double vhp_nearest_on_triangle(const double *p, const double *a, const double *b, const double *c, double *nearest)
{
    double ab[3], ac[3], ap[3], bp[3], cp[3];
    double v = 0, w = 0; /* nearest = a + v ab + w ac */
    subtract(b, a, ab);
    subtract(c, a, ac);
    subtract(p, a, ap);
    subtract(p, b, bp);
    subtract(p, c, cp);
    const double d1 = dot(ab, ap), d2 = dot(ac, ap), d3 = dot(ab, bp), d4 = dot(ac, bp), d5 = dot(ab, cp);
    const double d6 = dot(ac, cp);
    const double va = d3 * d6 - d5 * d4, vb = d5 * d2 - d1 * d6, vc = d1 * d4 - d3 * d2;
    if (d1 <= 0 && d2 <= 0) {
        v = w = 0;
    } else if (d3 >= 0 && d4 <= d3) {
        v = 1;
    } else if (vc <= 0 && d1 >= 0 && d3 <= 0) {
        v = d1 > d3 ? d1 / (d1 - d3) : 0;
    } else if (d6 >= 0 && d5 <= d6) {
        w = 1;
    } else if (vb <= 0 && d2 >= 0 && d6 <= 0) {
        w = d2 > d6 ? d2 / (d2 - d6) : 0;
    } else if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) {
        const double sum = (d4 - d3) + (d5 - d6);
        w = sum > 0 ? (d4 - d3) / sum : 0;
        v = 1 - w;
    } else if (va + vb + vc > 0) {
        v = vb / (va + vb + vc);
        w = vc / (va + vb + vc);
    }
    for (int d = 0; d < 3; d++)
        nearest[d] = a[d] + v * ab[d] + w * ac[d];
    return squared_distance(p, nearest);
}

typedef struct {
    const double *point, *normal; /* normal: NULL if any will do */
    double least_cosine;
    double enough;                /* squared; stop at a face so near */
    double best;                  /* squared */
    int32_t face;
    double nearest[3];
} Probe;

static inline void probe_face(const Guarded *g, Probe *probe, int64_t i)
{
    const Tree *tree = g->reference;
    const double *normal = g->reference_normal + 3 * i, *a = corner(tree, i, 0);
    double offset[3], nearest[3];
    if (probe->normal && dot(normal, probe->normal) < probe->least_cosine)
        return;
    subtract(probe->point, a, offset);
    const double height = dot(offset, normal);
    if (height * height > probe->best)
        return;
    const double square = vhp_nearest_on_triangle(probe->point, a, corner(tree, i, 1), corner(tree, i, 2), nearest);
    if (square < probe->best || (probe->face < 0 && square <= probe->best)) {
        probe->best = square;
        probe->face = (int32_t)i;
        memcpy(probe->nearest, nearest, sizeof nearest);
    }
}

/* A float surely below a number, by little. */
static inline float below(double x)
{
    return (float)(x - fabs(x) * 1.2e-7 - 1e-30);
}

static inline int is_inside(const float *inner, const float *outer)
{
    return (inner[0] >= outer[0]) & (inner[1] >= outer[1]) & (inner[2] >= outer[2]) & (inner[3] <= outer[3]) &
           (inner[4] <= outer[4]) & (inner[5] <= outer[5]);
}

void vhp_look_around(Guarded *g, const int32_t *vertices, int count)
{
    const Tree *tree = g->reference;
    Nearby *nearby = &g->nearby;
    float box[8] = {INFINITY, INFINITY, INFINITY, -INFINITY, -INFINITY, -INFINITY, 0, 0};
    int32_t ring[MAX_RING];
    for (int i = 0; i < count; i++) {
        const int32_t faces = vhp_ring(g, vertices[i], ring);
        for (int32_t k = 0; k < faces; k++) {
            const float *around = g->nodes[g->leaf[ring[k] / 3]].box;
            for (int d = 0; d < 3; d++) {
                box[d] = around[d] < box[d] ? around[d] : box[d];
                box[3 + d] = around[3 + d] > box[3 + d] ? around[3 + d] : box[3 + d];
            }
        }
    }
    for (int d = 0; d < 3; d++) {
        box[d] = below((double)box[d] - 1.001 * g->settings.deviation);
        box[3 + d] = -below(-(double)box[3 + d] - 1.001 * g->settings.deviation);
    }
    if (nearby->count >= 0 && is_inside(box, nearby->box))
        return;
    nearby->count = -1;
    memcpy(nearby->box, box, sizeof box);
    if (!tree->n_regular || !(box[0] <= box[3]))
        return;
    int64_t waiting[WALK_DEPTH];
    int waits = 0;
    int32_t found = 0;
    waiting[waits++] = 0;
    while (waits) {
        const int64_t node = waiting[--waits];
        g->counts[WORK]++;
        if (!boxes_overlap(node_box(tree, node), box))
            continue;
        if (!is_leaf(tree, node)) {
            waiting[waits++] = 2 * node + 1;
            waiting[waits++] = 2 * node + 2;
            continue;
        }
        int64_t end = leaf_begin(tree, node + 1);
        end = end < tree->n_regular ? end : tree->n_regular;
        for (int64_t i = leaf_begin(tree, node); i < end; i++) {
            if (!boxes_overlap(face_box(tree, i), box))
                continue;
            if (found == MOST_NEARBY)
                return;
            memcpy(nearby->boxes[found], face_box(tree, i), 6 * sizeof(float));
            memcpy(nearby->planes[found], corner(tree, i, 0), 3 * sizeof(double));
            memcpy(nearby->planes[found] + 3, g->reference_normal + 3 * i, 3 * sizeof(double));
            nearby->faces[found++] = (int32_t)i;
        }
    }
    nearby->count = found;
}

/* Search the faces gathered; 0 if that would not find all. */
static int probe_nearby(Guarded *g, Probe *probe)
{
    const Nearby *nearby = &g->nearby;
    const double reach = sqrt(probe->best);
    float box[8];
    if (nearby->count < 0)
        return 0;
    for (int d = 0; d < 3; d++) {
        box[d] = below(probe->point[d] - reach);
        box[3 + d] = -below(-probe->point[d] - reach);
    }
    if (!is_inside(box, nearby->box))
        return 0;
    g->counts[WORK]++;
    for (int32_t i = 0; i < nearby->count; i++) {
        const double *plane = nearby->planes[i];
        double offset[3];
        if (!boxes_overlap(nearby->boxes[i], box))
            continue;
        subtract(probe->point, plane, offset);
        const double height = dot(offset, plane + 3);
        if (height * height > probe->best)
            continue;
        probe_face(g, probe, nearby->faces[i]);
        if (probe->face >= 0 && probe->best <= probe->enough)
            break;
    }
    return 1;
}

static void probe_tree(Guarded *g, Probe *probe)
{
    const Tree *tree = g->reference;
    struct { int64_t node; double distance; } waiting[WALK_DEPTH];
    int count = 0;
    if (!tree->n_regular || (probe->face >= 0 && probe->best <= probe->enough) || probe_nearby(g, probe))
        return;
    waiting[count].node = 0;
    waiting[count++].distance = box_distance(node_box(tree, 0), probe->point);
    while (count) {
        count--;
        int64_t node = waiting[count].node;
        if (waiting[count].distance > probe->best)
            continue;
        while (!is_leaf(tree, node)) {
            const int64_t left = 2 * node + 1;
            const double to_left = box_distance(node_box(tree, left), probe->point);
            const double to_right = box_distance(node_box(tree, left + 1), probe->point);
            const int nearer = to_right < to_left;
            g->counts[WORK]++;
            if ((nearer ? to_right : to_left) > probe->best)
                break;
            if ((nearer ? to_left : to_right) <= probe->best) {
                waiting[count].node = left + !nearer;
                waiting[count++].distance = nearer ? to_left : to_right;
            }
            node = left + nearer;
        }
        if (!is_leaf(tree, node))
            continue;
        int64_t end = leaf_begin(tree, node + 1);
        end = end < tree->n_regular ? end : tree->n_regular;
        for (int64_t i = leaf_begin(tree, node); i < end; i++) {
            if (box_distance(face_box(tree, i), probe->point) > probe->best)
                continue;
            probe_face(g, probe, i);
            if (probe->face >= 0 && probe->best <= probe->enough)
                return;
        }
    }
}

int32_t vhp_nearest_reference(Guarded *g, const double *point, double reach, const double *normal, double least_cosine,
                              int32_t hint, double *nearest)
{
    Probe probe = {point, normal, least_cosine, 0, reach * reach, -1, {0, 0, 0}};
    if (hint >= 0)
        probe_face(g, &probe, hint);
    probe_tree(g, &probe);
    memcpy(nearest, probe.nearest, sizeof probe.nearest);
    return probe.face;
}

/* 1 if a point is within reach of the reference, first asking the faces `hints`. */
int vhp_within_reference(Guarded *g, const double *point, const double *normal, const int32_t hints[3])
{
    const double reach = g->settings.deviation * g->settings.deviation;
    Probe probe = {point, normal, LEAST_COSINE, reach, reach, -1, {0, 0, 0}};
    for (int k = 0; k < 3; k++)
        if (hints[k] >= 0) {
            probe_face(g, &probe, hints[k]);
            if (probe.face >= 0)
                return 1;
        }
    probe_tree(g, &probe);
    return probe.face >= 0;
}

double vhp_reference_size(const Guarded *g, int32_t face, const double *point)
{
    const Tree *tree = g->reference;
    const double *a = corner(tree, face, 0), *b = corner(tree, face, 1), *c = corner(tree, face, 2);
    const double *size = g->reference_size + 3 * (int64_t)face, *normal = g->reference_normal + 3 * (int64_t)face;
    double pa[3], pb[3], pc[3], product[3], weight[3];
    subtract(a, point, pa);
    subtract(b, point, pb);
    subtract(c, point, pc);
    cross(pb, pc, product);
    weight[0] = fmax(dot(product, normal), 0);
    cross(pc, pa, product);
    weight[1] = fmax(dot(product, normal), 0);
    cross(pa, pb, product);
    weight[2] = fmax(dot(product, normal), 0);
    const double sum = weight[0] + weight[1] + weight[2];
    if (!(sum > 0))
        return size[0];
    return (weight[0] * size[0] + weight[1] * size[1] + weight[2] * size[2]) / sum;
}
