/* Volume that two closed oriented surfaces A and B have in common, without building their intersection.
 *
 * By the divergence theorem the volume is the sum over all faces f of A and B of p . S / 3, with p any
 * point of the face's plane and S the vector area of the part of f inside the other solid; and S is
 * half the integral of (x - p) x dx around that part. Its outline is made of pieces of the edges of f
 * inside the other solid, and of the segments in which f meets faces g of the other surface. So each
 * piece of an edge adds to its own face, each segment to its two faces, and nothing has to be joined
 * up into loops (compare Franklin 1987, Polygon properties calculated from the vertex neighborhoods,
 * which gets by with the corners alone, but divides by the angle of two faces).
 *
 * Which edges pierce which faces is decided exactly, for B moved by a tiny vector that rids the two
 * surfaces of degenerate contacts. A point of intersection is computed from its edge and face alone,
 * the same for all faces that use it: so the outlines close, and rounding moves points within the
 * plane of a face, which changes no volume to first order. */
#include <math.h>
#include <stdlib.h>

#include "tree.h"
#include "vector.h"
#include "vhp.h"

/* Length of the move relative to the largest coordinate: about 50000 units in the last place. */
#define MOVE 1e-11
#define TRIES 3

static const double moves[TRIES][3] = {
    {0.6180339887, 0.4142135624, 0.7320508076}, {-0.7071067812, 0.2360679775, 0.5772156649},
    {0.3819660113, -0.8414709848, -0.6931471806}};

enum { DONE = 0, DEGENERATE = 1 }; /* besides VHP_OUT_OF_MEMORY */

/* One of the two surfaces. */
typedef struct {
    const Tree *tree;
    int sense;        /* winding number within: 1 if oriented outward, -1 inward */
    int32_t *entries; /* (n_faces, 3) times edge k -> k + 1 enters the other solid, less times it leaves */
    int32_t *parent;  /* per vertex: union-find over the edges */
    int32_t *level;   /* per vertex: winding number of the other surface, relative to the parent */
} Side;

typedef struct {
    Side sides[2];
    double origin[3]; /* amid the common part of the boxes: keeps the terms of the sum small */
    double six_volumes;
    int degenerate;
} Overlap;

static double triple(const double *u, const double *v, const double *w)
{
    return u[0] * (v[1] * w[2] - v[2] * w[1]) + u[1] * (v[2] * w[0] - v[0] * w[2]) +
           u[2] * (v[0] * w[1] - v[1] * w[0]);
}

/* Six times the volume of the cone from the origin over the triangle (first corner of the face, x, y). */
static double cone(const Overlap *o, const Tree *tree, int64_t face, const double *x, const double *y)
{
    double apex[3], u[3], v[3];
    subtract(corner(tree, face, 0), o->origin, apex);
    subtract(x, corner(tree, face, 0), u);
    subtract(y, corner(tree, face, 0), v);
    return triple(apex, u, v);
}

/* ---- where faces meet */

/* A face as seen from the plane of another, its corners in an order of our own. */
typedef struct {
    int order[3];        /* local corners: the one alone on its side first */
    int sides[3];        /* per local corner */
    const double *at[3]; /* in that order */
} Position;

/* Fill in a face that its sides put across the other plane; returns the side of the lone corner. */
static int place_across(Position *position, const Tree *tree, int64_t face)
{
    const int *s = position->sides;
    const int lone = s[1] == s[2] ? 0 : s[0] == s[2] ? 1 : 2;
    for (int k = 0; k < 3; k++) {
        position->order[k] = (lone + k) % 3;
        position->at[k] = corner(tree, face, position->order[k]);
    }
    return s[lone];
}

static void turn_over(Position *position)
{
    const int order = position->order[1];
    const double *at = position->at[1];
    position->order[1] = position->order[2];
    position->at[1] = position->at[2];
    position->order[2] = order;
    position->at[2] = at;
}

/* The edge from the lone corner to corner `end` of the ordered three pierces face g of the other side:
 * note the entry, add the piece of the edge that it bounds, and return the point. */
static void pierce(Overlap *o, int side, int64_t f, int64_t g, const Position *position, int end, double *point)
{
    const Tree *tree = o->sides[side].tree, *other = o->sides[!side].tree;
    const int x = position->order[0], y = position->order[end];
    const int edge = y == (x + 1) % 3 ? x : y, next = (edge + 1) % 3;
    const int entry = position->sides[edge] > 0 ? 1 : -1;

    /* From the lower to the higher vertex number, so that both faces at the edge get the same point. */
    const int32_t *face = tree->faces + 3 * f;
    const int along = face[edge] < face[next];
    const double *from = corner(tree, f, along ? edge : next), *to = corner(tree, f, along ? next : edge);
    const Plane plane_g = plane_of(corner(other, g, 0), corner(other, g, 1), corner(other, g, 2));
    double heights[2] = {0, 0};
    for (int d = 0; d < 3; d++) {
        heights[0] += plane_g.normal[d] * (from[d] - plane_g.a[d]);
        heights[1] += plane_g.normal[d] * (to[d] - plane_g.a[d]);
    }
    double t = heights[0] / (heights[0] - heights[1]);
    t = t > 0 ? (t < 1 ? t : 1) : 0; /* 0 also for 0 / 0 */
    for (int d = 0; d < 3; d++)
        point[d] = from[d] + t * (to[d] - from[d]);

    o->sides[side].entries[3 * f + edge] += entry;
    /* Edges at the first corner add nothing, as (x - p) x dx is 0 along them. */
    if (edge == 1)
        o->six_volumes -= entry * (along ? t : 1 - t) * cone(o, tree, f, corner(tree, f, 1), corner(tree, f, 2));
}

static int sides_of(const Plane *p, const Tree *tree, int64_t face, int sides[3])
{
    for (int k = 0; k < 3; k++)
        sides[k] = plane_side(p, corner(tree, face, k));
    return sides[0] && sides[1] && sides[2];
}

static int on_one_side(const int sides[3])
{
    return sides[0] == sides[1] && sides[1] == sides[2];
}

/* If faces f of A and g of B meet, add their segment to both; 0 if they meet in a degenerate way. The
 * order of the four points in which their edges pierce the other plane along the common line is found as
 * in vhp_triangles_meet. */
static int add_segment(void *context, int64_t f, int64_t g)
{
    Overlap *o = context;
    const Tree *a = o->sides[0].tree, *b = o->sides[1].tree;
    Position p, q;
    const Plane plane_f = plane_of(corner(a, f, 0), corner(a, f, 1), corner(a, f, 2));
    const int clear_q = sides_of(&plane_f, b, g, q.sides);
    if (clear_q && on_one_side(q.sides))
        return 1;
    const Plane plane_g = plane_of(corner(b, g, 0), corner(b, g, 1), corner(b, g, 2));
    const int clear_p = sides_of(&plane_g, a, f, p.sides);
    if (clear_p && on_one_side(p.sides))
        return 1;
    if (!clear_p || !clear_q) {
        o->degenerate = 1;
        return 0;
    }
    const int up_p = place_across(&p, a, f) > 0, up_q = place_across(&q, b, g) > 0;
    if (!up_p)
        turn_over(&q);
    if (!up_q)
        turn_over(&p);
    const int before = orient3d(p.at[0], p.at[1], q.at[0], q.at[1]);
    const int after = orient3d(p.at[0], p.at[2], q.at[0], q.at[2]);
    if (before > 0 || after < 0)
        return 1;
    const int start_side = orient3d(p.at[0], p.at[2], q.at[0], q.at[1]);
    const int end_side = orient3d(p.at[0], p.at[1], q.at[0], q.at[2]);
    if (!before || !after || !start_side || !end_side) {
        o->degenerate = 1;
        return 0;
    }
    double ends[2][3];
    if (start_side < 0)
        pierce(o, 0, f, g, &p, 2, ends[0]);
    else
        pierce(o, 1, g, f, &q, 1, ends[0]);
    if (end_side < 0)
        pierce(o, 1, g, f, &q, 2, ends[1]);
    else
        pierce(o, 0, f, g, &p, 1, ends[1]);
    /* With the inside on the left, the outline of f runs along (normal of f) x (normal of g), that of
     * g the other way; each turning over has reversed the order of the ends. */
    const int first = up_p != up_q;
    o->six_volumes += cone(o, a, f, ends[first], ends[!first]) + cone(o, b, g, ends[!first], ends[first]);
    return 1;
}

/* ---- which vertices are inside */

/* Root of a vertex; level[vertex] becomes relative to it. */
static int32_t find_root(Side *side, int32_t vertex)
{
    int32_t root = vertex, level = 0;
    while (side->parent[root] != root) {
        level += side->level[root];
        root = side->parent[root];
    }
    while (side->parent[vertex] != root) {
        const int32_t next = side->parent[vertex], own = side->level[vertex];
        side->parent[vertex] = root;
        side->level[vertex] = level;
        level -= own;
        vertex = next;
    }
    return root;
}

/* Join all vertices along edges, by how often an edge enters the other solid; 0 if that is inconsistent. */
static int join_vertices(Side *side)
{
    const Tree *tree = side->tree;
    for (int32_t v = 0; v < tree->n_vertices; v++) {
        side->parent[v] = v;
        side->level[v] = 0;
    }
    for (int64_t f = 0; f < tree->n_regular; f++)
        for (int k = 0; k < 3; k++) {
            const int32_t from = tree->faces[3 * f + k], to = tree->faces[3 * f + (k + 1) % 3];
            const int32_t root_from = find_root(side, from), root_to = find_root(side, to);
            const int32_t step = side->level[from] + side->entries[3 * f + k] - side->level[to];
            if (root_from == root_to) {
                if (step)
                    return 0;
            } else { /* the lower number stays root, which keeps paths short in the order of first use */
                const int32_t upper = root_from < root_to ? root_to : root_from;
                side->parent[upper] = root_from < root_to ? root_from : root_to;
                side->level[upper] = root_from < root_to ? step : -step;
            }
        }
    return 1;
}

static int in_box(const float *box, const double *point)
{
    return box[0] <= point[0] && point[0] <= box[3] && box[1] <= point[1] && point[1] <= box[4] &&
           box[2] <= point[2] && point[2] <= box[5];
}

/* Turn levels into winding numbers of the other surface: 0 for a vertex outside its box, and by a
 * ray for a part of this surface that lies wholly within the box. Uses `known` (n_vertices, 0). */
static int settle_levels(Side *side, const Side *other, uint8_t *known)
{
    const Tree *tree = side->tree;
    for (int ask = 0; ask < 2; ask++)
        for (int32_t v = 0; v < tree->n_vertices; v++) {
            const int32_t root = find_root(side, v);
            const double *point = tree->vertices + 3 * (int64_t)v;
            if (known[root] || (!ask && in_box(other->tree->boxes, point)))
                continue;
            const int place = ask ? vhp_point_place(other->tree, point) : 0;
            if (place < 0)
                return DEGENERATE;
            /* The root keeps its own winding number as its level: see level_of. */
            const int32_t of_root = place * other->sense - (v == root ? 0 : side->level[v]);
            side->level[root] = of_root;
            known[root] = 1;
        }
    return DONE;
}

static int32_t level_of(Side *side, int32_t vertex)
{
    const int32_t root = find_root(side, vertex);
    return vertex == root ? side->level[root] : side->level[root] + side->level[vertex];
}

/* ---- the whole */

/* Pieces of edges begin where the edge enters and end where it leaves or at its last vertex, if that is
 * inside; `pierce` has added the former, this adds the latter. */
static int add_inner_vertices(Overlap *o, int which)
{
    Side *side = &o->sides[which];
    const Tree *tree = side->tree;
    if (!join_vertices(side)) {
        o->six_volumes = NAN;
        return DONE;
    }
    uint8_t *known = calloc((size_t)tree->n_vertices + 1, 1);
    if (!known)
        return VHP_OUT_OF_MEMORY;
    const int status = settle_levels(side, &o->sides[!which], known);
    free(known);
    if (status != DONE)
        return status;
    for (int64_t f = 0; f < tree->n_regular; f++) {
        const int32_t level = level_of(side, tree->faces[3 * f + 2]);
        if (level)
            o->six_volumes += level * cone(o, tree, f, corner(tree, f, 1), corner(tree, f, 2));
    }
    return DONE;
}

static int common_volume(const Tree *a, int sense_a, const Tree *b, int sense_b, double *volume)
{
    Overlap o = {.sides = {{.tree = a, .sense = sense_a}, {.tree = b, .sense = sense_b}}};
    int status = DONE;
    for (int d = 0; d < 3; d++) {
        const double low = a->boxes[d] > b->boxes[d] ? a->boxes[d] : b->boxes[d];
        const double high = a->boxes[3 + d] < b->boxes[3 + d] ? a->boxes[3 + d] : b->boxes[3 + d];
        o.origin[d] = 0.5 * (low + high);
    }
    for (int k = 0; k < 2; k++) {
        Side *side = &o.sides[k];
        side->entries = calloc((size_t)side->tree->n_faces * 3 + 1, sizeof *side->entries);
        side->parent = malloc((size_t)side->tree->n_vertices * sizeof *side->parent + 1);
        side->level = malloc((size_t)side->tree->n_vertices * sizeof *side->level + 1);
        if (!side->entries || !side->parent || !side->level)
            status = VHP_OUT_OF_MEMORY;
    }
    if (status == DONE) {
        for_each_box_pair(a, b, add_segment, &o);
        status = o.degenerate ? DEGENERATE : add_inner_vertices(&o, 0);
        if (status == DONE)
            status = add_inner_vertices(&o, 1);
    }
    for (int k = 0; k < 2; k++) {
        free(o.sides[k].entries);
        free(o.sides[k].parent);
        free(o.sides[k].level);
    }
    /* So far the integral of the product of the two winding numbers. */
    *volume = o.six_volumes / 6 * sense_a * sense_b;
    return status;
}

static int common_volume_moved(const Tree *a, int sense_a, const Tree *b, int sense_b, const double *move,
                               double *volume)
{
    int status = VHP_OUT_OF_MEMORY;
    const size_t n_boxes = 6 * (2 * (size_t)b->n_leaves);
    double *vertices = malloc((size_t)b->n_vertices * 3 * sizeof *vertices);
    float *face_boxes = calloc(6 * ((size_t)b->n_faces + 1), sizeof *face_boxes);
    float *boxes = calloc(n_boxes, sizeof *boxes);
    if (vertices && face_boxes && boxes) {
        Tree moved = *b;
        for (int64_t i = 0; i < 3 * b->n_vertices; i++)
            vertices[i] = b->vertices[i] + move[i % 3];
        moved.vertices = vertices;
        moved.face_boxes = face_boxes;
        moved.boxes = boxes;
        vhp_fit_boxes(&moved, face_boxes, boxes);
        status = common_volume(a, sense_a, &moved, sense_b, volume);
    }
    free(vertices);
    free(face_boxes);
    free(boxes);
    return status;
}

/* volume: of the common interior; nan if one surface is open or encloses nothing. What one of them
 * encloses several times counts as often.
 * Returns 0, or -1 if memory runs out. */
VHP_EXPORT int vhp_overlap_volume(const Tree *a, const Tree *b, double *volume)
{
    *volume = NAN;
    if (!a->n_regular || !b->n_regular)
        return 0;
    const double volume_a = vhp_enclosed_volume(a), volume_b = vhp_enclosed_volume(b);
    if (!(volume_a != 0 && volume_b != 0))
        return 0;
    *volume = 0;
    if (!boxes_overlap(a->boxes, b->boxes))
        return 0;
    double size = 0;
    for (int d = 0; d < 6; d++) {
        size = fabs((double)a->boxes[d]) > size ? fabs((double)a->boxes[d]) : size;
        size = fabs((double)b->boxes[d]) > size ? fabs((double)b->boxes[d]) : size;
    }
    for (int try = 0; try < TRIES; try++) {
        double move[3];
        for (int d = 0; d < 3; d++)
            move[d] = moves[try][d] * MOVE * size;
        const int status = common_volume_moved(a, volume_a > 0 ? 1 : -1, b, volume_b > 0 ? 1 : -1, move, volume);
        if (status == VHP_OUT_OF_MEMORY)
            return status;
        if (status == DONE) {
            /* Below 0 by rounding, or where a fold of one surface, inside out, lies in the other. */
            const double fold = 1e-4 * (fabs(volume_a) < fabs(volume_b) ? fabs(volume_a) : fabs(volume_b));
            if (*volume < 0)
                *volume = *volume > -fold ? 0 : NAN;
            return 0;
        }
    }
    *volume = NAN;
    return 0;
}
