/* Generalized winding numbers, hierarchical: Barill, Dickson, Schmidt, Levin & Jacobson 2018, Fast
 * winding numbers for soups and clouds (the first-order term). */
#include <math.h>

#include "tree.h"
#include "vhp.h"

#define PI 3.14159265358979323846

/* Per node: sum of the faces' area vectors, their area-weighted centre, and the radius of a ball
 * about it that holds the node's box. */
enum { AREA_VECTOR = 0, CENTRE = 3, RADIUS = 6, MOMENTS = 7 };

static double length(const double *v)
{
    return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

static void add_face(const Tree *tree, int64_t face, double *moments, double *area)
{
    const double *a = corner(tree, face, 0), *b = corner(tree, face, 1), *c = corner(tree, face, 2);
    const Plane p = plane_of(a, b, c);
    const double face_area = 0.5 * length(p.normal);
    for (int d = 0; d < 3; d++) {
        moments[AREA_VECTOR + d] += 0.5 * p.normal[d];
        moments[CENTRE + d] += face_area * ((a[d] + b[d] + c[d]) / 3.0);
    }
    *area += face_area;
}

/* moments (2 n_leaves - 1, 7). */
VHP_EXPORT void vhp_winding_prepare(const Tree *tree, double *moments)
{
    /* From the leaves up; the radius holds the area until the node's parent has been summed up. */
    for (int64_t node = 2 * tree->n_leaves - 2; node >= 0; node--) {
        double *m = moments + MOMENTS * node, area = 0;
        for (int d = 0; d < MOMENTS; d++)
            m[d] = 0;
        if (is_leaf(tree, node)) {
            const int64_t end = leaf_begin(tree, node + 1);
            for (int64_t i = leaf_begin(tree, node); i < end; i++)
                add_face(tree, i, m, &area);
        } else {
            for (int64_t child = 2 * node + 1; child <= 2 * node + 2; child++) {
                const double *part = moments + MOMENTS * child;
                for (int d = 0; d < 6; d++)
                    m[d] += part[d];
                area += part[RADIUS];
            }
        }
        m[RADIUS] = area;
    }
    for (int64_t node = 0; node < 2 * tree->n_leaves - 1; node++) {
        double *m = moments + MOMENTS * node, farthest[3];
        const double area = m[RADIUS];
        const float *box = node_box(tree, node);
        for (int d = 0; d < 3; d++) {
            const double low = box[d], high = box[3 + d];
            m[CENTRE + d] = area > 0 ? m[CENTRE + d] / area : 0.5 * (low + high);
            farthest[d] = fmax(high - m[CENTRE + d], m[CENTRE + d] - low);
        }
        m[RADIUS] = length(farthest);
    }
}

/* Solid angle of a face: van Oosterom & Strackee 1983, The solid angle of a plane triangle. */
static double solid_angle(const Tree *tree, int64_t face, const double *point)
{
    double v[3][3], r[3];
    for (int k = 0; k < 3; k++) {
        const double *vertex = corner(tree, face, k);
        for (int d = 0; d < 3; d++)
            v[k][d] = vertex[d] - point[d];
        r[k] = length(v[k]);
    }
    const double *a = v[0], *b = v[1], *c = v[2];
    const double volume = a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) +
                          a[2] * (b[0] * c[1] - b[1] * c[0]);
    const double ab = a[0] * b[0] + a[1] * b[1] + a[2] * b[2], bc = b[0] * c[0] + b[1] * c[1] + b[2] * c[2];
    const double ca = c[0] * a[0] + c[1] * a[1] + c[2] * a[2];
    return 2 * atan2(volume, r[0] * r[1] * r[2] + ab * r[2] + bc * r[0] + ca * r[1]);
}

/* winding (n_points). A node farther away than `accuracy` times its radius is taken as one dipole. */
VHP_EXPORT void vhp_winding(const Tree *tree, const double *moments, const double *points, int64_t n_points,
                            double accuracy, double *winding)
{
    for (int64_t k = 0; k < n_points; k++) {
        const double *point = points + 3 * k;
        int64_t waiting[WALK_DEPTH];
        int count = 0;
        double sum = 0;
        if (tree->n_faces)
            waiting[count++] = 0;
        while (count) {
            const int64_t node = waiting[--count];
            const double *m = moments + MOMENTS * node;
            double offset[3];
            for (int d = 0; d < 3; d++)
                offset[d] = m[CENTRE + d] - point[d];
            const double distance = length(offset);
            if (distance > accuracy * m[RADIUS] && distance > 0) {
                sum += (m[0] * offset[0] + m[1] * offset[1] + m[2] * offset[2]) / (distance * distance * distance);
            } else if (is_leaf(tree, node)) {
                const int64_t end = leaf_begin(tree, node + 1);
                for (int64_t i = leaf_begin(tree, node); i < end; i++)
                    sum += solid_angle(tree, i, point);
            } else {
                waiting[count++] = 2 * node + 2;
                waiting[count++] = 2 * node + 1;
            }
        }
        winding[k] = sum / (4 * PI);
    }
}
