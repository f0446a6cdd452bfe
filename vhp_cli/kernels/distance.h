/* Distance of two triangles, which may be degenerate to segments or points. */
#ifndef VHP_DISTANCE_H
#define VHP_DISTANCE_H

/* A triangle with what its distance to others needs. */
typedef struct {
    const double *v[3];
    double edge[3][3];      /* from vertex k to the next */
    double inverse[3];      /* 1 / squared length of each edge; 0 if it has none */
    int base;               /* the shortest edge, from vertex `base` */
    double height[3];       /* from the foot on the line of the base to the vertex opposite; all 0 if degenerate */
    double foot;            /* place of the foot along the base */
    double inverse_height;  /* 1 / squared length of the height; 0 if degenerate */
    double normal[3];       /* base x height */
    double inverse_normal;  /* 1 / squared length of the normal; 0 if degenerate */
} Shape;

void vhp_shape_of(Shape *shape, const double *a, const double *b, const double *c);

/* 1 if the plane of the triangle keeps the three points farther away than a squared distance of `best`;
 * 0 if it can't tell. */
int vhp_plane_separates(const Shape *shape, const double *const points[3], double best);

/* The smaller of `best` and the squared distance; in the second case the two nearest points are
 * written to `points` (on a, on b). */
double vhp_shape_distance(const Shape *a, const Shape *b, double best, double points[2][3]);

/* Squared distance of a point, and the point of the triangle nearest to it, if below `best`. */
double vhp_point_distance(const double *point, const Shape *shape, double best, double nearest[3]);

#endif
