/* Quadric error: the sum of the squared distances of a point to planes, each weighted by an area.
 *
 * Garland & Heckbert 1997, Surface simplification using quadric error metrics. Q(x) = x'Ax - 2 b'x + c.
 */
#ifndef VHP_QUADRICS_H
#define VHP_QUADRICS_H

typedef struct {
    double a[6];   /* xx, xy, xz, yy, yz, zz */
    double b[3];
    double c;
    double weight; /* of all planes together */
} Quadric;

/* Add the plane of a triangle, weighted by its area. */
void vhp_quadric_add_triangle(Quadric *quadric, const double *p, const double *q, const double *r);
/* The sum of two; `sum` may be one of them. */
void vhp_quadric_add(const Quadric *first, const Quadric *second, Quadric *sum);
/* Mean squared distance of a point to the planes; never below 0. */
double vhp_quadric_error(const Quadric *quadric, const double *x);
/* The point x with the least Q(x) + pull |x - near|^2 trace(A), where normal . (x - near) = offset unless `normal` is
 * NULL: what the planes leave open is decided by the distance from `near`. 0 if there is no such point. */
int vhp_quadric_minimize(const Quadric *quadric, const double *near, double pull, const double *normal, double offset,
                         double *x);

#endif
