/* Quadric error (quadrics.h). */
#include "quadrics.h"

#include <math.h>

#include "vector.h"

/* A constraint that moves the point by less than this has no direction. */
#define LEAST_EFFECT 1e-200

void vhp_quadric_add_triangle(Quadric *quadric, const double *p, const double *q, const double *r)
{
    double pq[3], pr[3], n[3];
    subtract(q, p, pq);
    subtract(r, p, pr);
    cross(pq, pr, n);
    const double double_area = sqrt(dot(n, n));
    if (!(double_area > 0))
        return;
    const double area = 0.5 * double_area, scale = 1 / double_area;
    for (int d = 0; d < 3; d++)
        n[d] *= scale;
    const double height = dot(n, p);
    quadric->a[0] += area * n[0] * n[0];
    quadric->a[1] += area * n[0] * n[1];
    quadric->a[2] += area * n[0] * n[2];
    quadric->a[3] += area * n[1] * n[1];
    quadric->a[4] += area * n[1] * n[2];
    quadric->a[5] += area * n[2] * n[2];
    for (int d = 0; d < 3; d++)
        quadric->b[d] += area * height * n[d];
    quadric->c += area * height * height;
    quadric->weight += area;
}

void vhp_quadric_add(const Quadric *first, const Quadric *second, Quadric *sum)
{
    for (int k = 0; k < 6; k++)
        sum->a[k] = first->a[k] + second->a[k];
    for (int d = 0; d < 3; d++)
        sum->b[d] = first->b[d] + second->b[d];
    sum->c = first->c + second->c;
    sum->weight = first->weight + second->weight;
}

static inline void multiply(const double a[6], const double *x, double *product)
{
    product[0] = a[0] * x[0] + a[1] * x[1] + a[2] * x[2];
    product[1] = a[1] * x[0] + a[3] * x[1] + a[4] * x[2];
    product[2] = a[2] * x[0] + a[4] * x[1] + a[5] * x[2];
}

double vhp_quadric_error(const Quadric *quadric, const double *x)
{
    double ax[3];
    multiply(quadric->a, x, ax);
    const double error = dot(ax, x) - 2 * dot(quadric->b, x) + quadric->c;
    return error > 0 && quadric->weight > 0 ? error / quadric->weight : 0;
}

/* A = L D L' with ones on the diagonal of L: stable for positive definite matrices, however flat. */
typedef struct {
    double d[3], l10, l20, l21;
} Factors;

static int factorize(const double a[6], Factors *f)
{
    f->d[0] = a[0];
    if (!(f->d[0] > 0))
        return 0;
    f->l10 = a[1] / f->d[0];
    f->l20 = a[2] / f->d[0];
    f->d[1] = a[3] - f->l10 * a[1];
    if (!(f->d[1] > 0))
        return 0;
    const double rest = a[4] - f->l20 * a[1];
    f->l21 = rest / f->d[1];
    f->d[2] = a[5] - f->l20 * a[2] - f->l21 * rest;
    return f->d[2] > 0;
}

static void solve(const Factors *f, const double *right, double *x)
{
    const double y1 = right[1] - f->l10 * right[0], y2 = right[2] - f->l20 * right[0] - f->l21 * y1;
    x[2] = y2 / f->d[2];
    x[1] = y1 / f->d[1] - f->l21 * x[2];
    x[0] = right[0] / f->d[0] - f->l10 * x[1] - f->l20 * x[2];
}

int vhp_quadric_minimize(const Quadric *quadric, const double *near, double pull, const double *normal, double offset,
                         double *x)
{
    double a[6], rest[3], y[3], z[3];
    const double trace = quadric->a[0] + quadric->a[3] + quadric->a[5];
    if (!(trace > 0))
        return 0;
    multiply(quadric->a, near, rest);
    subtract(quadric->b, rest, rest);
    for (int k = 0; k < 6; k++)
        a[k] = quadric->a[k] / trace;
    a[0] += pull;
    a[3] += pull;
    a[5] += pull;
    Factors factors;
    if (!factorize(a, &factors))
        return 0;
    solve(&factors, rest, y);
    for (int d = 0; d < 3; d++)
        y[d] /= trace;
    if (normal) {
        solve(&factors, normal, z);
        const double effect = dot(normal, z);
        if (effect > LEAST_EFFECT) {
            const double way = (offset - dot(normal, y)) / effect;
            for (int d = 0; d < 3; d++)
                y[d] += way * z[d];
        }
    }
    for (int d = 0; d < 3; d++)
        x[d] = near[d] + y[d];
    return isfinite(x[0]) && isfinite(x[1]) && isfinite(x[2]);
}
