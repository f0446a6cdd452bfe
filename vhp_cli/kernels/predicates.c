/* Exact fallbacks of the orientation predicates: expansion arithmetic (see predicates.h). */
#include "predicates.h"

#include "vhp.h"

/* sum + error == a + b exactly. */
static inline double two_sum(double a, double b, double *error)
{
    const double sum = a + b, part = sum - a;
    *error = (a - (sum - part)) + (b - part);
    return sum;
}

/* product + error == a * b exactly (Dekker's splitting; 134217729 = 2^27 + 1). */
static inline double two_product(double a, double b, double *error)
{
    const double product = a * b;
    const double a_big = 134217729.0 * a, a_high = a_big - (a_big - a), a_low = a - a_high;
    const double b_big = 134217729.0 * b, b_high = b_big - (b_big - b), b_low = b - b_high;
    *error = a_low * b_low - (((product - a_high * b_high) - a_low * b_high) - a_high * b_low);
    return product;
}

/* An expansion is a sum of non-overlapping doubles in order of growing magnitude, without zeros;
 * its sign is that of the last term. */
typedef struct {
    int length;
    double terms[96]; /* orient3d_exact adds 4 determinants of 6 products of at most 4 terms each */
} Expansion;

static inline int expansion_sign(const Expansion *e)
{
    if (e->length == 0)
        return 0;
    return e->terms[e->length - 1] > 0 ? 1 : -1;
}

static void add_term(Expansion *e, double value)
{
    int kept = 0;
    if (value == 0)
        return;
    for (int i = 0; i < e->length; i++) {
        double error;
        value = two_sum(value, e->terms[i], &error);
        if (error != 0)
            e->terms[kept++] = error;
    }
    if (value != 0)
        e->terms[kept++] = value;
    e->length = kept;
}

static void add_product2(Expansion *e, double a, double b)
{
    double low;
    const double high = two_product(a, b, &low);
    add_term(e, low);
    add_term(e, high);
}

static void add_product3(Expansion *e, double a, double b, double c)
{
    double low, error;
    if (a == 0 || b == 0 || c == 0)
        return;
    const double high = two_product(a, b, &low);
    if (low != 0) {
        const double product = two_product(low, c, &error);
        add_term(e, error);
        add_term(e, product);
    }
    const double product = two_product(high, c, &error);
    add_term(e, error);
    add_term(e, product);
}

/* Add sign * det(a, b, c). */
static void add_determinant(Expansion *e, const double *a, const double *b, const double *c, double sign)
{
    add_product3(e, sign * a[0], b[1], c[2]);
    add_product3(e, -sign * a[0], b[2], c[1]);
    add_product3(e, sign * a[1], b[2], c[0]);
    add_product3(e, -sign * a[1], b[0], c[2]);
    add_product3(e, sign * a[2], b[0], c[1]);
    add_product3(e, -sign * a[2], b[1], c[0]);
}

int vhp_orient2d_exact(double ax, double ay, double bx, double by, double cx, double cy)
{
    Expansion e = {.length = 0};
    add_product2(&e, ax, by);
    add_product2(&e, -ay, bx);
    add_product2(&e, bx, cy);
    add_product2(&e, -by, cx);
    add_product2(&e, cx, ay);
    add_product2(&e, -cy, ax);
    return expansion_sign(&e);
}

int vhp_orient3d_exact(const double *a, const double *b, const double *c, const double *d)
{
    double u[3], v[3], w[3];
    int exact = 1;
    Expansion e;
    e.length = 0; /* the terms need no initial value */

    for (int k = 0; k < 3; k++) {
        /* Surfaces cut along a coordinate plane or made of voxels end here most often. */
        if (a[k] == b[k] && a[k] == c[k] && a[k] == d[k])
            return 0;
    }
    for (int k = 0; k < 3; k++) {
        double error_u, error_v, error_w;
        u[k] = two_sum(b[k], -a[k], &error_u);
        v[k] = two_sum(c[k], -a[k], &error_v);
        w[k] = two_sum(d[k], -a[k], &error_w);
        exact &= error_u == 0 && error_v == 0 && error_w == 0;
    }
    if (exact) { /* the rule for float32 coordinates of one size */
        add_determinant(&e, u, v, w, 1.0);
    } else {     /* det(b-a, c-a, d-a) = |bcd| - |acd| + |abd| - |abc| */
        add_determinant(&e, b, c, d, 1.0);
        add_determinant(&e, a, c, d, -1.0);
        add_determinant(&e, a, b, d, 1.0);
        add_determinant(&e, a, b, c, -1.0);
    }
    return expansion_sign(&e);
}

/* Signs of `count` triangles (count, 3, 2): what the tests compare with rational arithmetic. */
VHP_EXPORT void vhp_orient2d(const double *triangles, int64_t count, int8_t *signs)
{
    for (int64_t i = 0; i < count; i++) {
        const double *t = triangles + 6 * i;
        signs[i] = (int8_t)orient2d(t[0], t[1], t[2], t[3], t[4], t[5]);
    }
}

/* Signs of `count` tetrahedra (count, 4, 3). */
VHP_EXPORT void vhp_orient3d(const double *tetrahedra, int64_t count, int8_t *signs)
{
    for (int64_t i = 0; i < count; i++) {
        const double *t = tetrahedra + 12 * i;
        signs[i] = (int8_t)orient3d(t, t + 3, t + 6, t + 9);
    }
}
