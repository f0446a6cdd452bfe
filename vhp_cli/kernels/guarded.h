/* The mesh that is worked on by guarded local operations.
 *
 * An operation (split, collapse, flip, relocation) takes a few faces out and puts others in their
 * place. It is done only if every guard agrees: the surface stays manifold, no new face touches any
 * other, none turns over, none leaves the envelope about the reference, no point of the reference
 * loses the surface, and the shape of the triangles does not suffer. So after any number of
 * operations the mesh is as valid as it was before the first.
 *
 * All coordinates are float32 values of the unit of the file, in mm as doubles: a new position is rounded first
 * and judged afterwards, and a file of single precision changes nothing.
 *
 * Corner c = 3 f + k is corner k of face f. `across[c]` is the corner that looks at the same edge from
 * the other side: the edge of f that is opposite to c. It is -1 where the edge does not have exactly
 * two faces that run along it in opposite directions; such edges are never touched.
 *
 * Parts: guarded_mesh.c (faces and their neighbours), guarded_boxes.c (search tree over the faces), guarded_reference.c
 * (the surface to stay at); the guards guarded_contact.c, guarded_envelope.c and guarded_samples.c, put together in
 * guarded_patch.c; the operations guarded_relocate.c, guarded_collapse.c, guarded_flip.c and guarded_split.c;
 * guarded_passes.c, guarded_quality.c and guarded_volume.c (work on the whole mesh).
 */
#ifndef VHP_GUARDED_H
#define VHP_GUARDED_H

#include <math.h>
#include <stdint.h>

#include "tree.h"
#include "vector.h"
#include "vhp.h"

/* Marks of a vertex. A pinched one has several fans of faces, of which only one is known: no edge may
 * begin or end there, since it might exist already. */
enum { FROZEN = 1, BOUNDARY = 2, PINCHED = 4 };

/* Most faces about a vertex that moves, and in one operation. */
#define MAX_RING 250
#define MAX_PATCH (2 * MAX_RING)

/* A face of the reference whose normal is this far from another one looks the other way: the far side of a thin wall. */
#define LEAST_COSINE (-0.3)

/* No operation leaves a triangle worse than this: it would be degenerate for all purposes. */
#define LEAST_QUALITY 1e-9

/* What counts as a better q. */
#define GAIN 1e-6

/* What `counts` holds: operations done, and operations refused by each guard. Mirrored in remeshing.py. */
enum {
    DONE_SPLIT, DONE_COLLAPSE, DONE_FLIP, DONE_RELOCATION,
    REFUSED_TOPOLOGY, REFUSED_QUALITY, REFUSED_NORMAL, REFUSED_ENVELOPE, REFUSED_CONTACT, REFUSED_COVERAGE,
    WORK, COUNTS
};

/* Mirrored by `_Settings` in remeshing.py. */
typedef struct {
    double deviation;      /* mm, of the surface from the reference and back */
    double target_quality; /* the quality phase works on triangles below it */
    double floor;          /* no operation for other ends than quality may leave a worse triangle */
    double min_edge;       /* mm; shorter edges are collapsed where possible */
    double edge_floor;     /* mm; no operation makes an edge shorter than this, unless one was */
    double fold_cosine;    /* of two normals at an edge: no new edge is folded more sharply */
    double unit;           /* mm; new coordinates are float32 multiples of it */
    int64_t max_faces;
    int64_t max_work;      /* boxes and triangles looked at; no new operation begins beyond */
} Settings;

/* Node of the search tree: a leaf holds one face. */
typedef struct {
    float box[6];
    int32_t parent;
    int32_t child[2]; /* the two nodes below; of a leaf, -1 and the face */
} BoxNode;

/* What was tried in vain is not tried again before something around it has changed. */
enum { TRIED_FLIP_QUALITY, TRIED_FLIP_BALANCE, TRIED_COLLAPSE, TRIED_IMPROVE, TRIED_RELAX, TRIED_SEARCH, TRIED_KINDS };

/* The faces of the reference about the place of work, so that the many small searches of one operation need not walk
 * the tree. */
#define MOST_NEARBY 256

typedef struct {
    int32_t count;                   /* -1: none gathered */
    float box[8];                    /* every face that reaches into it is in the list */
    float boxes[MOST_NEARBY][8];
    double planes[MOST_NEARBY][6];   /* a vertex and the normal */
    int32_t faces[MOST_NEARBY];
} Nearby;

typedef struct {
    Settings settings;
    int64_t counts[COUNTS];
    Nearby nearby;

    int64_t n_vertices, vertex_room, n_faces, face_room; /* numbers in use, dead ones among them */
    int64_t n_live_faces;
    double *xyz;          /* (V, 3) */
    double *size;         /* (V) wanted edge length */
    int32_t *corner;      /* (V) a corner at the vertex, on the boundary the first one; -1 if unused */
    int32_t *valence;     /* (V) faces at the vertex */
    int32_t *near;        /* (V) a face of the reference nearest to the vertex, or near; -1 if none */
    int32_t *component;   /* (V) */
    uint8_t *marks;       /* (V) */
    int32_t *touched;     /* (V) time of the last change around the vertex */
    int32_t *tried[TRIED_KINDS]; /* time of the last vain attempt, by face (first four kinds) or vertex */
    int32_t clock;

    int32_t *faces;       /* (F, 3); the first is -1 for a dead face */
    int32_t *across;      /* (F, 3) */
    double *normal;       /* (F, 3) of length 1, or 0 where there is none */
    double *quality;      /* (F) */
    double *shortest;     /* (F) mm2, square of the shortest edge */
    uint8_t *degenerate;  /* (F) exactly zero area */
    int32_t *first_sample; /* (F) list of the samples that the face covers */

    BoxNode *nodes;       /* search tree over the live faces (guarded_boxes.c) */
    int32_t *leaf;        /* (F) */
    int32_t root, free_node;
    int64_t n_nodes;
    int64_t changes;      /* of the tree since it was built */
    int32_t *stack;       /* for walks */
    int64_t stack_room;

    const Tree *reference;
    double *reference_normal; /* (n_regular, 3) */
    double *reference_size;   /* (n_regular, 3) wanted edge length at each corner */

    int64_t n_samples;
    double *sample;       /* (n_samples, 3) points of the reference that must keep the surface within reach */
    int32_t *next_sample, *sample_place; /* the list of each face; new place, while a patch is judged */
    int32_t *loose;       /* samples of the faces being replaced */
    int64_t n_loose;

    int64_t n_components;
    double *wanted_volume; /* (n_components); NaN for an open one */
    int64_t failed;        /* memory ran out */
} Guarded;

/* The faces that an operation takes out and those that it puts in. */
typedef struct {
    int32_t n_old, n_new;
    int32_t old[MAX_PATCH];
    int32_t replaces[MAX_PATCH];     /* old face that the new one turns out of; -1: several */
    int32_t vertices[MAX_PATCH][3];  /* of the new faces */
    double normal[MAX_PATCH][3];
    double quality[MAX_PATCH];
    double shortest[MAX_PATCH];
    int32_t n_edges;
    int32_t edges[MAX_PATCH][2];     /* edges that come into being or move */
} Patch;

static inline int32_t next_corner(int32_t c)
{
    return c % 3 == 2 ? c - 2 : c + 1;
}

static inline int32_t previous_corner(int32_t c)
{
    return c % 3 == 0 ? c + 2 : c - 1;
}

static inline double *place(const Guarded *g, int32_t vertex)
{
    return g->xyz + 3 * (int64_t)vertex;
}

static inline int is_live(const Guarded *g, int64_t face)
{
    return g->faces[3 * face] >= 0;
}

static inline int out_of_work(const Guarded *g)
{
    return g->counts[WORK] > g->settings.max_work || g->failed;
}

static inline double squared_distance(const double *a, const double *b)
{
    const double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
    return x * x + y * y + z * z;
}

static inline double distance(const double *a, const double *b)
{
    return sqrt(squared_distance(a, b));
}

/* Squared distance of a point from a box. */
static inline double box_distance(const float *box, const double *p)
{
    double sum = 0;
    for (int d = 0; d < 3; d++) {
        const double under = (double)box[d] - p[d], over = p[d] - (double)box[3 + d];
        const double off = under > over ? under : over;
        sum += off > 0 ? off * off : 0;
    }
    return sum;
}

/* By way of memory: GCC 12 takes a conversion to float and back for nothing where it vectorizes the two. */
static inline void round_to_file(const Guarded *g, double *point)
{
    for (int d = 0; d < 3; d++) {
        volatile float rounded = (float)(point[d] * (1 / g->settings.unit));
        point[d] = (double)rounded * g->settings.unit;
    }
}

/* q = 2 r_in / r_out of a triangle, and its normal of length 1 (0 if it has no area). */
static inline double shape_of(const double *a, const double *b, const double *c, double *normal)
{
    double ab[3], ac[3], bc[3];
    subtract(b, a, ab);
    subtract(c, a, ac);
    subtract(c, b, bc);
    cross(ab, ac, normal);
    const double square = dot(normal, normal), double_area = sqrt(square);
    const double x = sqrt(dot(ab, ab)), y = sqrt(dot(ac, ac)), z = sqrt(dot(bc, bc));
    const double divisor = x * y * z * (x + y + z);
    const double scale = double_area > 0 ? 1 / double_area : 0;
    for (int d = 0; d < 3; d++)
        normal[d] *= scale;
    return divisor > 0 ? 4 * square / divisor : 0;
}

/* Square of the shortest edge of a triangle. */
static inline double shortest_of(const double *a, const double *b, const double *c)
{
    const double ab = squared_distance(a, b), bc = squared_distance(b, c), ca = squared_distance(c, a);
    const double least = ab < bc ? ab : bc;
    return least < ca ? least : ca;
}

/* guarded_mesh.c */
int vhp_guarded_reserve(Guarded *g, int64_t vertices, int64_t faces);
/* Corners at a vertex, counter-clockwise; their number, or -1 if there are more than MAX_RING. */
int32_t vhp_ring(const Guarded *g, int32_t vertex, int32_t *corners);
/* 1 if an edge joins the two vertices, or if it can't be told since both are pinched. */
int vhp_joined(const Guarded *g, int32_t a, int32_t b);
/* Write a face and join it to its neighbours: across[k] is what its corner k looks at. */
void vhp_set_face(Guarded *g, int32_t face, const int32_t vertices[3], const int32_t across[3]);
/* Name a corner at a vertex, from which walks around it start. */
void vhp_set_corner(Guarded *g, int32_t vertex, int32_t corner);
/* Forget all vain attempts. */
void vhp_forget_tries(Guarded *g);

/* guarded_boxes.c */
int vhp_boxes_build(Guarded *g);
void vhp_boxes_refit(Guarded *g, int32_t face);
void vhp_boxes_insert(Guarded *g, int32_t face, int32_t beside);
void vhp_boxes_remove(Guarded *g, int32_t face);
void vhp_face_box(const Guarded *g, const int32_t *vertices, float *box);
/* Put a node on the stack of a walk that holds `count`; 0 if memory runs out. */
int vhp_push(Guarded *g, int64_t *count, int32_t node);

/* guarded_reference.c */
double vhp_nearest_on_triangle(const double *p, const double *a, const double *b, const double *c, double *nearest);
/* Prepare searches about the faces at some vertices; without it they only take longer. */
void vhp_look_around(Guarded *g, const int32_t *vertices, int count);
/* Face of the reference nearest to a point, within `reach` and with a normal along `normal` (NULL: any);
 * -1 if there is none. `hint`: a face to try first, or -1. */
int32_t vhp_nearest_reference(Guarded *g, const double *point, double reach, const double *normal, double least_cosine,
                              int32_t hint, double *nearest);
/* 1 if a point is within the deviation of the reference, first asking the faces `hints`; with a normal (NULL: any)
 * only faces that do not look the other way count. */
int vhp_within_reference(Guarded *g, const double *point, const double *normal, const int32_t hints[3]);
/* Wanted edge length at a point on a face of the reference. */
double vhp_reference_size(const Guarded *g, int32_t face, const double *point);

/* guarded_contact.c */
/* 1 if a new face of the patch meets any other face, or is folded onto a neighbour. */
int vhp_patch_meets(Guarded *g, const Patch *patch);

/* guarded_envelope.c */
/* 1 if the new faces and edges of a patch stay within the envelope. */
int vhp_patch_within(Guarded *g, const Patch *patch, int thorough);

/* guarded_samples.c */
/* Find for each sample of the old faces the new face that covers it; 0 if one is left without, unless `force`. */
int vhp_patch_covers(Guarded *g, const Patch *patch, int force);
/* Give the samples to the faces found; `numbers` are those of the new faces. */
void vhp_move_samples(Guarded *g, const Patch *patch, const int32_t *numbers);
/* Give each sample to the face nearest to it. */
int vhp_assign_samples(Guarded *g);

/* guarded_patch.c: what the operations share */
/* A vertex put to a place for trial, and where it was. */
typedef struct {
    int32_t vertex, near;
    double xyz[3];
} Trial;

void vhp_patch_begin(Patch *patch);
void vhp_patch_take(Patch *patch, int32_t face);
void vhp_patch_add(Patch *patch, int32_t a, int32_t b, int32_t c, int32_t replaces);
void vhp_patch_edge(Patch *patch, int32_t a, int32_t b);
/* Worst and mean q of the old faces; the same of the new ones, which are measured. */
double vhp_old_quality(const Guarded *g, const Patch *patch, double *mean);
double vhp_new_quality(const Guarded *g, Patch *patch, double *mean);
/* Round a position and put a vertex there; `near`: a face of the reference near it, or -1. */
Trial vhp_try_place(Guarded *g, int32_t vertex, const double *position, int32_t near);
/* Put the vertex back, count the refusal, and return 0. */
int vhp_take_back(Guarded *g, const Trial *trial, int guard);
/* 1 if no face turns over, and each has an area for certain. */
int vhp_keeps_sides(const Guarded *g, const Patch *patch);
/* The guard that refuses a patch that has been measured, or -1. `moved`: the vertex that has moved, or -1. */
/* 1 unless an edge is shorter than the floor and than all edges were. */
int vhp_keeps_edges(const Guarded *g, const Patch *patch);
int vhp_refusing_guard(Guarded *g, const Patch *patch, int32_t moved, int thorough);
/* Note that a patch is done: shape and samples of the new faces `numbers`, time of change of their vertices, and the
 * boxes of the first `n_boxes` of them. */
void vhp_settle(Guarded *g, const Patch *patch, const int32_t *numbers, int32_t n_boxes);

/* The operations: 1 if done. */
enum { GOAL_WORST, GOAL_MEAN, GOAL_KEEP }; /* raise the worst q; the mean q; only keep the worst from falling far */
int vhp_relocate(Guarded *g, int32_t vertex, const double *position, int32_t near, int goal);
/* Merge the edge opposite to a corner into its end `kept`, which goes to a position. least_quality < 0: only if the
 * worst q rises. */
int vhp_collapse(Guarded *g, int32_t corner, int32_t kept, const double *position, int32_t near, double least_quality,
                 double longest);
/* A collapse in two steps, for other goals and guards: the patch, with the number of faces about the end that goes, or -1
 * where the surface would not stay manifold; and what changes the mesh. */
int vhp_plan_collapse(const Guarded *g, int32_t corner, int32_t kept, Patch *patch, int32_t *gone_ring);
void vhp_do_collapse(Guarded *g, int32_t corner, int32_t kept, const int32_t *gone_ring, int32_t n_gone,
                     const Patch *patch);
enum { FLIP_QUALITY, FLIP_BALANCE };
int vhp_flip(Guarded *g, int32_t corner, int goal);
int vhp_flip_onto(Guarded *g, int32_t corner, const double *position, int32_t near);
/* The new vertex, or -1. */
int32_t vhp_split(Guarded *g, int32_t corner);

/* guarded_passes.c */
/* Where a vertex would lie well: the centroid of its faces (weighted by their area in units of the wanted length, or
 * all alike), moved into the plane of its normal. 0 if it has no normal. */
int vhp_centre_of_ring(const Guarded *g, int32_t vertex, int weighted, double *target, double *normal);
/* Nearest point of the reference to a place wanted for a vertex; the face, or -1. */
int32_t vhp_project(Guarded *g, int32_t vertex, const double *wanted, const double *normal, double *projected);
/* Move a vertex to the projection of `wanted`, and take the wanted length from there. */
int vhp_move_to(Guarded *g, int32_t vertex, const double *wanted, const double *normal, int goal);
/* Collapse the edge opposite to a corner to its middle on the reference, or to one of its ends. */
int vhp_try_collapse(Guarded *g, int32_t corner, double least_quality, double longest);
/* 1 if nothing has changed around the vertices of a face since `time`. */
int vhp_face_unchanged(const Guarded *g, int32_t face, int32_t time);

/* guarded_quality.c */
int64_t vhp_guarded_improve(Guarded *g, double quality, int64_t rounds, int moving);

/* guarded_volume.c */
/* Volume (NaN if open) and area of each component; either may be NULL. */
void vhp_component_volumes(const Guarded *g, double *volume, double *area);

#endif
