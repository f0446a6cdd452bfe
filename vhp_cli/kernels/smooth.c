/* Laplacian smoothing: each vertex moves towards a mean of its neighbours or of its triangles (thesis 2.3.3).

   A corner h = 3 f + k is corner k of face f; corners are 32-bit numbers, so a mesh may have (2^31 - 1) / 3 faces.
   Collapsed faces (two or three equal vertices) take no part. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#include "vector.h"
#include "vhp.h"

/* Where a vertex is moved to; mirrored in smoothing.py. */
enum {
    STANDARD,  /* the mean of its neighbours (2.12) */
    LUMPED,    /* a third of itself and two thirds of that mean (2.13) */
    CVT,       /* the mean of its triangles' centroids, weighted by their areas (2.14) */
    WCC,       /* the mean of its triangles' circumcentres, weighted by their areas (2.15) */
    CVT_EQUAL, /* the last two with equal weights */
    WCC_EQUAL
};

static inline int is_collapsed(const int32_t *face)
{
    return face[0] == face[1] || face[1] == face[2] || face[2] == face[0];
}

static inline int32_t next_corner(int32_t corner) { return corner % 3 == 2 ? corner - 2 : corner + 1; }
static inline int32_t previous_corner(int32_t corner) { return corner % 3 == 0 ? corner + 2 : corner - 1; }

/* Corners and neighbours of every vertex, in the order of the faces.

   faces              (n, 3), n_vertices vertices
   corner_offsets     (n_vertices + 1), out: the corners of vertex v are those from corner_offsets[v] on
   corners            (3 n), out
   neighbour_offsets  (n_vertices + 1), out
   neighbours         (6 n), out: each neighbour once
   boundary           (n_vertices), out: 1 at the ends of an edge with exactly one face
   Returns 0, or -1 when memory runs out. */
VHP_EXPORT int32_t vhp_smooth_adjacency(const int32_t *faces, int64_t n, int64_t n_vertices, int64_t *corner_offsets,
                                 int32_t *corners, int64_t *neighbour_offsets, int32_t *neighbours, uint8_t *boundary)
{
    /* Entry v + 1 counts the corners of v, then is their start, and when they are filled in, their end. */
    for (int64_t v = 0; v <= n_vertices; v++)
        corner_offsets[v] = 0;
    for (int64_t f = 0; f < n; f++)
        for (int k = 0; !is_collapsed(faces + 3 * f) && k < 3; k++)
            corner_offsets[faces[3 * f + k] + 1]++;
    int64_t largest = 0, total = 0;
    for (int64_t v = 0; v < n_vertices; v++) {
        int64_t degree = corner_offsets[v + 1];
        largest = degree > largest ? degree : largest;
        corner_offsets[v + 1] = total;
        total += degree;
    }
    for (int64_t f = 0; f < n; f++)
        for (int k = 0; !is_collapsed(faces + 3 * f) && k < 3; k++)
            corners[corner_offsets[faces[3 * f + k] + 1]++] = (int32_t)(3 * f + k);

    int64_t *place = malloc(((size_t)n_vertices + 1) * sizeof *place); /* of a vertex among the neighbours */
    int32_t *uses = malloc((2 * (size_t)largest + 1) * sizeof *uses);  /* faces at the edge to each neighbour */
    if (!place || !uses) {
        free(place);
        free(uses);
        return VHP_OUT_OF_MEMORY;
    }
    for (int64_t v = 0; v < n_vertices; v++)
        place[v] = -1;
    int64_t end = 0;
    for (int64_t v = 0; v < n_vertices; v++) {
        int64_t begin = end;
        neighbour_offsets[v] = begin;
        for (int64_t i = corner_offsets[v]; i < corner_offsets[v + 1]; i++) {
            int32_t ends[2] = {faces[next_corner(corners[i])], faces[previous_corner(corners[i])]};
            for (int side = 0; side < 2; side++) {
                /* A place below `begin` was given at an earlier vertex. */
                if (place[ends[side]] < begin) {
                    uses[end - begin] = 0;
                    place[ends[side]] = end;
                    neighbours[end++] = ends[side];
                }
                uses[place[ends[side]] - begin]++;
            }
        }
        boundary[v] = 0;
        for (int64_t i = 0; i < end - begin; i++)
            boundary[v] |= uses[i] == 1;
    }
    neighbour_offsets[n_vertices] = end;
    free(place);
    free(uses);
    return 0;
}

/* Unit normal of every vertex: the area-weighted mean of its faces' normals; 0 where that vanishes. */
VHP_EXPORT void vhp_smooth_normals(const double *vertices, int64_t n_vertices, const int32_t *faces,
                                   const int64_t *corner_offsets, const int32_t *corners, double *normals)
{
    for (int64_t v = 0; v < n_vertices; v++) {
        const double *here = vertices + 3 * v;
        double sum[3] = {0, 0, 0};
        for (int64_t i = corner_offsets[v]; i < corner_offsets[v + 1]; i++) {
            double left[3], right[3], normal[3];
            subtract(vertices + 3 * (int64_t)faces[next_corner(corners[i])], here, left);
            subtract(vertices + 3 * (int64_t)faces[previous_corner(corners[i])], here, right);
            cross(left, right, normal);
            for (int axis = 0; axis < 3; axis++)
                sum[axis] += normal[axis];
        }
        double length = sqrt(dot(sum, sum));
        for (int axis = 0; axis < 3; axis++)
            normals[3 * v + axis] = length > 0 ? sum[axis] / length : 0;
    }
}

/* Mean over the neighbours of a vertex of `values` (rows of three), less `origin`; 0 if it has none. */
static inline int neighbour_mean(const double *values, const double *origin, const int32_t *first, const int32_t *last,
                                 double *mean)
{
    double sum[3] = {0, 0, 0};
    for (const int32_t *neighbour = first; neighbour < last; neighbour++)
        for (int axis = 0; axis < 3; axis++)
            sum[axis] += values[3 * (int64_t)*neighbour + axis] - origin[axis];
    for (int axis = 0; axis < 3; axis++)
        mean[axis] = first < last ? sum[axis] / (double)(last - first) : 0;
    return first < last;
}

/* Mean of the centres of a vertex' triangles, less the vertex itself; 0 if they have no area. A triangle without area
   has no circumcentre and is left out of both means of these.

   With u and v the vectors from the vertex to the other two corners and n = u x v, twice the area is |n|, the
   centroid lies at (u + v) / 3 and the circumcentre at (|v|^2 n x u + |u|^2 v x n) / (2 |n|^2). */
static inline int centre_mean(const double *vertices, const double *here, const int32_t *faces, const int32_t *first,
                              const int32_t *last, int of_circles, int by_area, double *mean)
{
    double sum[3] = {0, 0, 0}, weights = 0;
    for (const int32_t *corner = first; corner < last; corner++) {
        double left[3], right[3], normal[3], centre[3], area = 1;
        subtract(vertices + 3 * (int64_t)faces[next_corner(*corner)], here, left);
        subtract(vertices + 3 * (int64_t)faces[previous_corner(*corner)], here, right);
        if (of_circles || by_area) {
            cross(left, right, normal);
            area = sqrt(dot(normal, normal)); /* twice the area: the factor cancels */
        }
        if (of_circles) {
            if (!(area > 0))
                continue;
            double ahead[3], behind[3], left_square = dot(left, left), right_square = dot(right, right);
            cross(normal, left, ahead);
            cross(right, normal, behind);
            for (int axis = 0; axis < 3; axis++)
                centre[axis] = (right_square * ahead[axis] + left_square * behind[axis]) / area / (2 * area);
        } else {
            for (int axis = 0; axis < 3; axis++)
                centre[axis] = (left[axis] + right[axis]) / 3;
        }
        double weight = by_area ? area : 1;
        weights += weight;
        for (int axis = 0; axis < 3; axis++)
            sum[axis] += weight * centre[axis];
    }
    for (int axis = 0; axis < 3; axis++)
        mean[axis] = weights > 0 ? sum[axis] / weights : 0;
    return weights > 0;
}

static inline void make_tangential(double *move, const double *normal)
{
    double height = dot(move, normal);
    for (int axis = 0; axis < 3; axis++)
        move[axis] -= height * normal[axis];
}

/* Move every free vertex once. `target` may be `source`: then each vertex sees those before it already moved. The
   method is a constant where this is inlined. */
static inline void move_all(int method, const double *source, int64_t n_vertices, const int32_t *faces,
                            const int64_t *corner_offsets, const int32_t *corners, const int64_t *neighbour_offsets,
                            const int32_t *neighbours, const uint8_t *fixed, double step, const double *normals,
                            double *target)
{
    if (method == LUMPED)
        step *= 2.0 / 3.0;
    for (int64_t v = 0; v < n_vertices; v++) {
        const double here[3] = {source[3 * v], source[3 * v + 1], source[3 * v + 2]};
        double move[3] = {0, 0, 0};
        int found = 0;
        if (!fixed[v]) {
            if (method == STANDARD || method == LUMPED)
                found = neighbour_mean(source, here, neighbours + neighbour_offsets[v],
                                       neighbours + neighbour_offsets[v + 1], move);
            else
                found = centre_mean(source, here, faces, corners + corner_offsets[v], corners + corner_offsets[v + 1],
                                    method == WCC || method == WCC_EQUAL, method == CVT || method == WCC, move);
        }
        if (found && normals) {
            const double *normal = normals + 3 * v;
            /* Without a normal there is no tangent plane to stay in. */
            found = normal[0] != 0 || normal[1] != 0 || normal[2] != 0;
            make_tangential(move, normal);
        }
        for (int axis = 0; axis < 3; axis++)
            target[3 * v + axis] = found ? here[axis] + step * move[axis] : here[axis];
    }
}

/* One pass of smoothing: p := p + step (p* - p) for all free vertices.

   source     (n_vertices, 3)
   faces to neighbours   as `vhp_smooth_adjacency` returns them
   fixed      (n_vertices): 1 where a vertex stays
   normals    (n_vertices, 3): the move is projected to the plane perpendicular to them; NULL: it is not
   target     (n_vertices, 3), out: the same array as `source` for sequential updates in the order of the vertices,
              another one for simultaneous updates */
VHP_EXPORT void vhp_smooth_pass(const double *source, int64_t n_vertices, const int32_t *faces,
                                const int64_t *corner_offsets, const int32_t *corners, const int64_t *neighbour_offsets,
                                const int32_t *neighbours, const uint8_t *fixed, int32_t method, double step,
                                const double *normals, double *target)
{
#define MOVE_ALL(constant)                                                                                            \
    move_all(constant, source, n_vertices, faces, corner_offsets, corners, neighbour_offsets, neighbours, fixed, step, \
             normals, target)
    switch (method) {
    case STANDARD:
        MOVE_ALL(STANDARD);
        break;
    case LUMPED:
        MOVE_ALL(LUMPED);
        break;
    case CVT:
        MOVE_ALL(CVT);
        break;
    case WCC:
        MOVE_ALL(WCC);
        break;
    case CVT_EQUAL:
        MOVE_ALL(CVT_EQUAL);
        break;
    default:
        MOVE_ALL(WCC_EQUAL);
    }
#undef MOVE_ALL
}

/* The second half of an HC iteration (Vollmer et al. 1999): push every free vertex back by beta b + (1 - beta) times
   the mean of b over its neighbours, where b says how far each vertex has come.

   displacement (n_vertices, 3): b
   normals      as above
   vertices     (n_vertices, 3), in and out */
VHP_EXPORT void vhp_smooth_push_back(const double *displacement, int64_t n_vertices, const int64_t *neighbour_offsets,
                                     const int32_t *neighbours, const uint8_t *fixed, double beta,
                                     const double *normals, double *vertices)
{
    const double origin[3] = {0, 0, 0};
    for (int64_t v = 0; v < n_vertices; v++) {
        double move[3];
        if (fixed[v] || !neighbour_mean(displacement, origin, neighbours + neighbour_offsets[v],
                                        neighbours + neighbour_offsets[v + 1], move))
            continue;
        for (int axis = 0; axis < 3; axis++)
            move[axis] = beta * displacement[3 * v + axis] + (1 - beta) * move[axis];
        if (normals) {
            const double *normal = normals + 3 * v;
            if (normal[0] == 0 && normal[1] == 0 && normal[2] == 0)
                continue;
            make_tangential(move, normal);
        }
        for (int axis = 0; axis < 3; axis++)
            vertices[3 * v + axis] -= move[axis];
    }
}
