/* The point of a surface nearest to each of many query points. */
#include <math.h>
#include <string.h>

#include "distance.h"
#include "tree.h"
#include "vector.h"
#include "vhp.h"

/* Rounding of a box distance and of a squared distance from a face, many times over. */
#define BELOW (1 - 1e-12)
#define ABOVE (1 + 1e-9)
/* Keeps a bound above a squared distance of zero. */
#define TINY 1e-300

/* Squared distance of a point from a box, or a little less; 0 inside. */
static inline double point_box_distance(const double *point, const float *box)
{
    double sum = 0;
    for (int d = 0; d < 3; d++) {
        const double below = (double)box[d] - point[d], above = point[d] - (double)box[3 + d];
        const double apart = below > above ? below : above;
        sum += apart > 0 ? apart * apart : 0;
    }
    return sum * BELOW;
}

static inline void face_shape(const Tree *tree, int64_t face, Shape *shape)
{
    vhp_shape_of(shape, corner(tree, face, 0), corner(tree, face, 1), corner(tree, face, 2));
}

/* Face nearest to the point and its place, if nearer than the square root of `bound`, which becomes the
 * squared distance; -1 if there is none.
 *
 * Branch and bound, the nearer half first. The order of the walk depends on the point alone, and a bound
 * above the result leaves out only what could not win, so neither face nor distance depends on it. */
static int64_t nearest_face(const Tree *tree, const double *point, double *bound, double place[3])
{
    struct { int64_t node; double apart; } waiting[WALK_DEPTH];
    int count = 0;
    int64_t found = -1;
    double best = *bound;
    Shape shape;
    waiting[count].node = 0;
    waiting[count++].apart = point_box_distance(point, node_box(tree, 0));
    while (count) {
        count--;
        const int64_t node = waiting[count].node;
        if (waiting[count].apart >= best)
            continue;
        if (!is_leaf(tree, node)) {
            const double left = point_box_distance(point, node_box(tree, 2 * node + 1));
            const double right = point_box_distance(point, node_box(tree, 2 * node + 2));
            const int left_last = left <= right;
            const double apart[2] = {left_last ? right : left, left_last ? left : right};
            for (int turn = 0; turn < 2; turn++) {
                if (apart[turn] >= best)
                    continue;
                waiting[count].node = 2 * node + 1 + (turn != left_last);
                waiting[count++].apart = apart[turn];
            }
            continue;
        }
        const int64_t end = leaf_begin(tree, node + 1);
        for (int64_t face = leaf_begin(tree, node); face < end; face++) {
            if (point_box_distance(point, face_box(tree, face)) >= best)
                continue;
            double candidate[3];
            face_shape(tree, face, &shape);
            const double squared = vhp_point_distance(point, &shape, best, candidate);
            if (squared < best) {
                best = squared;
                found = face;
                memcpy(place, candidate, sizeof candidate);
            }
        }
    }
    *bound = best;
    return found;
}

/* distances (n_points), places (n_points, 3), faces (n_points, as numbered by the caller): the nearest
 * point of the surface, infinity and -1 if it is farther away than `limit`.
 *
 * The distance from the face that was nearest to the point before is the first bound: queries in an order
 * that follows the surface are answered after a few faces. */
VHP_EXPORT void vhp_closest(const Tree *tree, const double *points, int64_t n_points, double limit,
                            double *distances, double *places, int32_t *faces)
{
    const double largest = limit < 1e150 ? limit * limit * ABOVE + TINY : INFINITY;
    int64_t last = -1;
    Shape last_shape;
    for (int64_t i = 0; i < n_points; i++) {
        const double *point = points + 3 * i;
        double bound = largest, place[3] = {NAN, NAN, NAN};
        int64_t face = -1;
        if (last >= 0) {
            double unused[3];
            const double squared = vhp_point_distance(point, &last_shape, INFINITY, unused) * ABOVE + TINY;
            bound = squared < bound ? squared : bound;
        }
        if (tree->n_faces)
            face = nearest_face(tree, point, &bound, place);
        if (tree->n_faces && face < 0 && bound < largest) {
            /* The plane of a sliver is uncertain: by its own bound it can rule itself out. */
            bound = largest;
            face = nearest_face(tree, point, &bound, place);
        }
        if (face >= 0 && face != last) {
            last = face;
            face_shape(tree, face, &last_shape);
        }
        const double distance = face >= 0 ? sqrt(bound) : INFINITY;
        const int within = distance <= limit && face >= 0;
        distances[i] = within ? distance : INFINITY;
        faces[i] = within ? tree->numbers[face] : -1;
        for (int d = 0; d < 3; d++)
            places[3 * i + d] = within ? place[d] : NAN;
    }
}
