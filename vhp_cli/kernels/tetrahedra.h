/* A tetrahedral mesh that can be changed: corners move, tetrahedra are swapped for others in the same space. */
#ifndef VHP_TETRAHEDRA_H
#define VHP_TETRAHEDRA_H

#include <stdint.h>

/* What is measured on a tetrahedron. */
typedef struct {
    double volume, min_dihedral_deg, max_dihedral_deg, radius_ratio, scaled_jacobian, mean_edge;
} TetShape;

/* Tetrahedra around a vertex. */
typedef struct {
    int32_t *items;
    int32_t count, room;
} Star;

/* Targets of tetrahedra that are used, and of those that only have to keep some volume. */
typedef struct {
    double angle_deg, radius_ratio;
} Target;

typedef struct {
    int64_t n_points, n_tets, room;
    double *points;        /* (n_points, 3) */
    int32_t *corners;      /* (n_tets, 4), positively oriented; the first is -1 where a tetrahedron is gone */
    int32_t *labels;       /* (n_tets) */
    uint8_t *used;         /* (n_tets): which target counts */
    double *share;         /* (n_tets): the smaller part of both targets that it reaches, 1 or more if it meets them */
    Star *stars;           /* (n_points) */
    Target target[2];      /* of those not used, and of those used */
    const uint8_t *fixed;  /* (n_points): may not move */
    const uint8_t *border; /* (n_points): lies on an interface or the hull */
    const double *normals; /* (n_points, 3): of the surface at a point that may slide along it; else 0 */
    const double *origin;  /* (n_points, 3): where the points of interfaces were */
    const double *leash;   /* (n_points): how far a point may leave the surface, or, where it has no normal, its origin */
} TetMesh;

void vhp_tet_shape(const double *a, const double *b, const double *c, const double *d, TetShape *shape);
/* Parts of both targets that a tetrahedron reaches, and the smaller one; negative if it has no positive volume. */
void vhp_tet_shares(const double *a, const double *b, const double *c, const double *d, const Target *target,
                    double shares[2]);
double vhp_tet_share(const double *a, const double *b, const double *c, const double *d, const Target *target);
/* The targets of tetrahedra not used, and of those used, from four numbers. */
void vhp_tet_targets(const double *values, Target targets[2]);

/* Fill a mesh from arrays, of which points and all but corners, labels and used are kept by reference. */
int vhp_tet_open(TetMesh *mesh, double *points, int64_t n_points, const int32_t *corners, const int32_t *labels,
                 const uint8_t *used, int64_t n_tets, const double *target);
void vhp_tet_close(TetMesh *mesh);
int vhp_tet_add(TetMesh *mesh, const int32_t corners[4], int32_t label, uint8_t used);
void vhp_tet_remove(TetMesh *mesh, int32_t tet);
/* Make sure that so many more tetrahedra can be added without running out of memory. */
int vhp_tet_reserve(TetMesh *mesh, int32_t count);

static inline const double *tet_point(const TetMesh *mesh, int32_t vertex)
{
    return mesh->points + 3 * (int64_t)vertex;
}

static inline int32_t *tet_corners(const TetMesh *mesh, int32_t tet)
{
    return mesh->corners + 4 * (int64_t)tet;
}

static inline int tet_is_gone(const TetMesh *mesh, int32_t tet)
{
    return mesh->corners[4 * (int64_t)tet] < 0;
}

static inline int tet_has(const TetMesh *mesh, int32_t tet, int32_t vertex)
{
    const int32_t *own = tet_corners(mesh, tet);
    return own[0] == vertex || own[1] == vertex || own[2] == vertex || own[3] == vertex;
}

/* Move one corner of a tetrahedron's star uphill; whether it moved. */
int vhp_tet_relocate(TetMesh *mesh, int32_t vertex, double least_gain);
/* Swap the tetrahedra around an edge, or the two at a face, for better ones. 1: done, 0: not, -1: out of memory. */
int vhp_tet_remove_edge(TetMesh *mesh, int32_t a, int32_t b, double least_gain);
int vhp_tet_remove_face(TetMesh *mesh, int32_t tet, int32_t opposite, double least_gain);

#endif
