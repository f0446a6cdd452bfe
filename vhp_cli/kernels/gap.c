/* Smallest distance of two meshes, or their first contact. */
#include <math.h>
#include <string.h>

#include "distance.h"
#include "tree.h"
#include "vhp.h"

/* Squared distance of two boxes, or a little less; 0 if they overlap. */
static inline double box_distance(const float *a, const float *b)
{
#ifdef __SSE2__
    /* Differences of floats, widened to double before they are squared; the factor makes up for their
     * rounding. The fourth lane is no coordinate. */
    const __m128 below = _mm_sub_ps(_mm_loadu_ps(a), _mm_loadu_ps(b + 3));
    const __m128 above = _mm_sub_ps(_mm_loadu_ps(b), _mm_loadu_ps(a + 3));
    const __m128 apart = _mm_max_ps(_mm_max_ps(below, above), _mm_setzero_ps());
    const __m128d xy = _mm_cvtps_pd(apart), z = _mm_cvtps_pd(_mm_movehl_ps(apart, apart));
    const __m128d squares = _mm_mul_pd(xy, xy);
    const __m128d sum = _mm_add_sd(_mm_add_sd(squares, _mm_unpackhi_pd(squares, squares)), _mm_mul_sd(z, z));
    return _mm_cvtsd_f64(sum) * (1 - 4e-7);
#else
    double sum = 0;
    for (int d = 0; d < 3; d++) {
        const double below = (double)a[d] - (double)b[3 + d], above = (double)b[d] - (double)a[3 + d];
        const double apart = below > above ? below : above;
        if (apart > 0)
            sum += apart * apart;
    }
    return sum * (1 - 4e-7);
#endif
}

typedef struct {
    double squared;       /* the least squared distance so far, never quite 0 */
    double points[2][3];
    int64_t face_a, face_b;
    int contact;          /* kind of the contact found */
} Nearest;

static inline void face_shape(const Tree *tree, int64_t face, Shape *shape)
{
    vhp_shape_of(shape, corner(tree, face, 0), corner(tree, face, 1), corner(tree, face, 2));
}

/* If edge k of `a` meets the plane of b, try the point where it does. */
static void try_piercing(const Shape *a, int k, const Shape *b, double *best, double points[2][3], int swap)
{
    const double *from = a->v[k], *to = a->v[k == 2 ? 0 : k + 1];
    const Plane plane_b = plane_of(b->v[0], b->v[1], b->v[2]);
    double height[2] = {0, 0}, point[3], nearest[3];
    for (int d = 0; d < 3; d++) {
        height[0] += plane_b.normal[d] * (from[d] - plane_b.a[d]);
        height[1] += plane_b.normal[d] * (to[d] - plane_b.a[d]);
    }
    if (height[0] * height[1] >= 0)
        return;
    const double t = height[0] / (height[0] - height[1]);
    for (int d = 0; d < 3; d++)
        point[d] = from[d] + t * a->edge[k][d];
    const double distance = vhp_point_distance(point, b, *best, nearest);
    if (distance < *best) {
        *best = distance;
        memcpy(points[swap], point, sizeof point);
        memcpy(points[!swap], nearest, sizeof nearest);
    }
}

/* A point that two triangles in contact share, up to rounding. */
static void contact_point(const Shape *a, const Shape *b, double points[2][3])
{
    double best = vhp_shape_distance(a, b, INFINITY, points);
    for (int k = 0; k < 3; k++) {
        try_piercing(a, k, b, &best, points, 0);
        try_piercing(b, k, a, &best, points, 1);
    }
}

/* Compare the faces of two leaves; returns 1 as soon as two of them are in contact. */
static int compare_leaves(const Tree *a, const Tree *b, int64_t leaf_a, int64_t leaf_b, Nearest *nearest)
{
    const int64_t end_a = leaf_begin(a, leaf_a + 1), end_b = leaf_begin(b, leaf_b + 1);
    Shape shape_a, shape_b;
    for (int64_t i = leaf_begin(a, leaf_a); i < end_a; i++) {
        if (box_distance(face_box(a, i), node_box(b, leaf_b)) >= nearest->squared)
            continue;
        face_shape(a, i, &shape_a);
        for (int64_t j = leaf_begin(b, leaf_b); j < end_b; j++) {
            const double apart = box_distance(face_box(a, i), face_box(b, j));
            if (apart >= nearest->squared)
                continue;
            const double *corners_b[3] = {corner(b, j, 0), corner(b, j, 1), corner(b, j, 2)};
            if (apart == 0 && i < a->n_regular && j < b->n_regular) {
                nearest->contact = vhp_triangles_meet(shape_a.v, corners_b);
                if (nearest->contact) {
                    nearest->face_a = i;
                    nearest->face_b = j;
                    face_shape(b, j, &shape_b);
                    contact_point(&shape_a, &shape_b, nearest->points);
                    return 1;
                }
            }
            if (vhp_plane_separates(&shape_a, corners_b, nearest->squared))
                continue;
            face_shape(b, j, &shape_b);
            if (vhp_plane_separates(&shape_b, shape_a.v, nearest->squared))
                continue;
            const double squared = vhp_shape_distance(&shape_a, &shape_b, nearest->squared, nearest->points);
            if (squared < nearest->squared) {
                /* Pairs with overlapping boxes must still be tested for contact: 0 < squared. */
                nearest->squared = squared > 1e-300 ? squared : 1e-300;
                nearest->face_a = i;
                nearest->face_b = j;
            }
        }
    }
    return 0;
}

/* Smallest distance of two meshes, if at most `limit`; the search ends at the first contact.
 *
 * distance: one value; points (2, 3); faces (2): as numbered by the caller.
 * Returns the kind of the contact (distance 0), 0 if the meshes are apart, -1 if by more than `limit`. */
VHP_EXPORT int vhp_gap(const Tree *a, const Tree *b, double limit, double *distance, double *points, int32_t *faces)
{
    struct { int64_t a, b; double apart; } waiting[WALK_DEPTH];
    int count = 0;
    Nearest nearest = {.squared = limit * limit * (1 + 1e-12) + 1e-300, .face_a = -1, .face_b = -1};
    if (!a->n_faces || !b->n_faces)
        return -1;
    waiting[count].a = waiting[count].b = 0;
    waiting[count].apart = box_distance(node_box(a, 0), node_box(b, 0));
    count++;
    while (count) {
        count--;
        const int64_t node_a = waiting[count].a, node_b = waiting[count].b;
        if (waiting[count].apart >= nearest.squared)
            continue;
        const int leaf_a = is_leaf(a, node_a), leaf_b = is_leaf(b, node_b);
        if (leaf_a && leaf_b) {
            if (compare_leaves(a, b, node_a, node_b, &nearest))
                break;
            continue;
        }
        /* Open the larger box; the nearer half goes on top. */
        const int open_a = leaf_b || (!leaf_a && box_size(node_box(a, node_a)) >= box_size(node_box(b, node_b)));
        const int64_t first = 2 * (open_a ? node_a : node_b) + 1;
        double apart[2];
        for (int k = 0; k < 2; k++)
            apart[k] = open_a ? box_distance(node_box(a, first + k), node_box(b, node_b))
                              : box_distance(node_box(a, node_a), node_box(b, first + k));
        const int nearer = apart[1] < apart[0];
        for (int turn = 0; turn < 2; turn++) {
            const int k = turn ? nearer : !nearer;
            if (apart[k] >= nearest.squared)
                continue;
            waiting[count].a = open_a ? first + k : node_a;
            waiting[count].b = open_a ? node_b : first + k;
            waiting[count].apart = apart[k];
            count++;
        }
    }
    if (nearest.face_a < 0)
        return -1;
    *distance = nearest.contact ? 0 : sqrt(nearest.squared);
    if (nearest.squared <= 1e-300)
        *distance = 0;
    if (*distance > limit)
        return -1;
    memcpy(points, nearest.points, sizeof nearest.points);
    faces[0] = a->numbers[nearest.face_a];
    faces[1] = b->numbers[nearest.face_b];
    return nearest.contact;
}
