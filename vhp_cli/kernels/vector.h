/* Vectors of three doubles. */
#ifndef VHP_VECTOR_H
#define VHP_VECTOR_H

static inline void subtract(const double *a, const double *b, double *difference)
{
    for (int d = 0; d < 3; d++)
        difference[d] = a[d] - b[d];
}

static inline void cross(const double *a, const double *b, double *product)
{
    product[0] = a[1] * b[2] - a[2] * b[1];
    product[1] = a[2] * b[0] - a[0] * b[2];
    product[2] = a[0] * b[1] - a[1] * b[0];
}

static inline double dot(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

#endif
