/* Exact orientation predicates on doubles.
 *
 * Each predicate evaluates its determinant in double arithmetic with a forward error bound, and
 * only when the sign is not certain falls back to expansion arithmetic (Shewchuk 1997, Adaptive
 * precision floating-point arithmetic and fast robust geometric predicates).
 *
 * Range: exact as long as every coordinate is 0 or 1e-60 <= |x| <= 1e38. The determinants have
 * degree 3, so the largest product stays below 1e116; a difference of two such numbers is 0 or at
 * least 1e-76, so no product falls below 1e-228 and its last error term not below 1e-270: nothing
 * overflows, nothing underflows, and every error-free transformation is error-free.
 *
 * Error bound of plane_side (u = 2^-53): a product of one term of the determinant passes through at
 * most 8 roundings (3 differences, 2 multiplications, 3 additions), so the error is at most
 * 8u (1 + O(u)) times the sum of the absolute products; that sum, as computed, is itself too small
 * by at most a factor 1 - 9u. 1e-15 = 9.007u covers both. For orient2d the count is 3 roundings of
 * each of the two products: (3 + 16u)u times the sum of their absolute values, as in Shewchuk.
 */
#ifndef VHP_PREDICATES_H
#define VHP_PREDICATES_H

#include <math.h>

#define PLANE_SIDE_ERROR 1e-15
#define ORIENT2D_ERROR 3.3306690738754716e-16

/* The exact fallbacks. */
int vhp_orient2d_exact(double ax, double ay, double bx, double by, double cx, double cy);
int vhp_orient3d_exact(const double *a, const double *b, const double *c, const double *d);

/* The plane through a triangle, with what the error bound of plane_side needs. */
typedef struct {
    const double *a, *b, *c;
    double normal[3];  /* (b - a) x (c - a) */
    double scale[3];   /* the same with absolute products added up */
} Plane;

static inline Plane plane_of(const double *a, const double *b, const double *c)
{
    const double ux = b[0] - a[0], uy = b[1] - a[1], uz = b[2] - a[2];
    const double vx = c[0] - a[0], vy = c[1] - a[1], vz = c[2] - a[2];
    const double yz = uy * vz, zy = uz * vy, zx = uz * vx, xz = ux * vz, xy = ux * vy, yx = uy * vx;
    Plane p = {a, b, c,
               {yz - zy, zx - xz, xy - yx},
               {fabs(yz) + fabs(zy), fabs(zx) + fabs(xz), fabs(xy) + fabs(yx)}};
    return p;
}

/* Side of the plane on which a point lies: +1 where the normal points, -1 behind, 0 exactly on it. */
static inline int plane_side(const Plane *p, const double *point)
{
    const double x = point[0] - p->a[0], y = point[1] - p->a[1], z = point[2] - p->a[2];
    const double side = p->normal[0] * x + p->normal[1] * y + p->normal[2] * z;
    const double error =
        PLANE_SIDE_ERROR * (p->scale[0] * fabs(x) + p->scale[1] * fabs(y) + p->scale[2] * fabs(z));
    if (side > error)
        return 1;
    if (side < -error)
        return -1;
    return vhp_orient3d_exact(p->a, p->b, p->c, point);
}

/* Sign of det(b - a, c - a, d - a): +1 if d sees a, b, c counter-clockwise. */
static inline int orient3d(const double *a, const double *b, const double *c, const double *d)
{
    const Plane p = plane_of(a, b, c);
    return plane_side(&p, d);
}

/* Sign of the area of the 2-D triangle a, b, c: +1 if counter-clockwise. */
static inline int orient2d(double ax, double ay, double bx, double by, double cx, double cy)
{
    const double left = (ax - cx) * (by - cy), right = (ay - cy) * (bx - cx);
    const double area = left - right, error = ORIENT2D_ERROR * (fabs(left) + fabs(right));
    if (area > error)
        return 1;
    if (area < -error)
        return -1;
    return vhp_orient2d_exact(ax, ay, bx, by, cx, cy);
}

/* orient2d of three space points seen along coordinate axis `axis` (0, 1, 2), from its positive end. */
static inline int orient2d_along(int axis, const double *a, const double *b, const double *c)
{
    const int i = axis == 2 ? 0 : axis + 1, j = axis == 0 ? 2 : axis - 1;
    return orient2d(a[i], a[j], b[i], b[j], c[i], c[j]);
}

#endif
