/* The quality phase: work on the triangles that are badly shaped and on edges that are too short. */
#include "guarded.h"

#define UNLIMITED 1e300

/* Normals that differ by more make an edge a crease: 15 degrees. */
#define CREASE_COSINE 0.9659258262890683

static double ring_quality(const Guarded *g, int32_t vertex)
{
    int32_t ring[MAX_RING];
    double worst = INFINITY;
    const int32_t count = vhp_ring(g, vertex, ring);
    for (int32_t i = 0; i < count; i++) {
        const double q = g->quality[ring[i] / 3];
        worst = q < worst ? q : worst;
    }
    return worst;
}

/* Move a vertex along the creases that run into it. */
static int slide_along_creases(Guarded *g, int32_t v, const double *normal)
{
    static const double parts[3] = {0.3, 0.1, 0.5};
    int32_t ring[MAX_RING];
    double wanted[3];
    const double own[3] = {place(g, v)[0], place(g, v)[1], place(g, v)[2]};
    const int32_t count = vhp_ring(g, v, ring);
    for (int32_t i = 0; i < count; i++) { /* the edge to the next corner, between this face and the one before */
        const int32_t face = ring[i] / 3, before = ring[i == 0 ? count - 1 : i - 1] / 3;
        if (dot(g->normal + 3 * (int64_t)face, g->normal + 3 * (int64_t)before) > CREASE_COSINE)
            continue;
        const double *end = place(g, g->faces[next_corner(ring[i])]);
        for (int k = 0; k < 3; k++) {
            for (int d = 0; d < 3; d++)
                wanted[d] = own[d] + parts[k] * (end[d] - own[d]);
            if (vhp_move_to(g, v, wanted, normal, GOAL_WORST))
                return 1;
        }
    }
    return 0;
}

/* Look for a better place of a vertex: on the way to the centres of its ring, along creases, then around it. */
static int search_place(Guarded *g, int32_t v)
{
    static const double parts[3] = {1, 0.5, 0.2}, half = 0.5, root = 0.8660254037844386;
    const double cosines[12] = {1, root, half, 0, -half, -root, -1, -root, -half, 0, half, root};
    const double own[3] = {place(g, v)[0], place(g, v)[1], place(g, v)[2]};
    double target[3], normal[3], wanted[3], side[3], front[3];
    vhp_look_around(g, &v, 1);
    for (int weighted = 1; weighted >= 0; weighted--) {
        if (!vhp_centre_of_ring(g, v, weighted, target, normal))
            return 0;
        for (int i = 0; i < 3; i++) {
            for (int d = 0; d < 3; d++)
                wanted[d] = own[d] + parts[i] * (target[d] - own[d]);
            if (vhp_move_to(g, v, wanted, normal, GOAL_WORST))
                return 1;
        }
    }
    if (slide_along_creases(g, v, normal))
        return 1;
    const double away[2][3] = {{normal[1], -normal[0], 0}, {0, normal[2], -normal[1]}};
    const double *chosen = away[fabs(normal[2]) >= 0.9];
    const double length = sqrt(dot(chosen, chosen));
    for (int d = 0; d < 3; d++)
        side[d] = chosen[d] / length;
    cross(normal, side, front);
    for (int i = 0; i < 12; i++) {
        const double radius = (0.05 + 0.25 * (i * 7 % 12) / 12) * g->size[v];
        const double right = radius * cosines[i], ahead = radius * cosines[(i + 9) % 12];
        for (int d = 0; d < 3; d++)
            wanted[d] = own[d] + right * side[d] + ahead * front[d];
        if (vhp_move_to(g, v, wanted, normal, GOAL_WORST))
            return 1;
    }
    return 0;
}

/* Move the vertices of triangles below `quality` to better places. */
static int64_t search_places(Guarded *g, double quality)
{
    int32_t *tried = g->tried[TRIED_SEARCH];
    int64_t done = 0;
    for (int32_t v = 0; v < g->n_vertices && !out_of_work(g); v++) {
        if (g->corner[v] < 0 || (g->marks[v] & FROZEN) || (tried[v] >= 0 && g->touched[v] <= tried[v]))
            continue;
        const int moved = ring_quality(g, v) < quality && search_place(g, v);
        done += moved;
        tried[v] = moved ? tried[v] : g->clock;
    }
    return done;
}

/* Corners of a face by the length of the opposite edge, shortest first, and that length. */
static double sort_edges(const Guarded *g, int32_t face, int32_t corners[3])
{
    double length[3];
    for (int k = 0; k < 3; k++) {
        const int32_t c = 3 * face + k;
        corners[k] = c;
        length[k] = squared_distance(place(g, g->faces[next_corner(c)]), place(g, g->faces[previous_corner(c)]));
    }
    for (int i = 1; i < 3; i++)
        for (int j = i; j > 0 && length[corners[j] % 3] < length[corners[j - 1] % 3]; j--) {
            const int32_t kept = corners[j];
            corners[j] = corners[j - 1];
            corners[j - 1] = kept;
        }
    return sqrt(length[corners[0] % 3]);
}

/* Move the vertex of a cap onto the opposite edge, from its foot towards the middle. */
static int flatten_cap(Guarded *g, int32_t corner)
{
    static const double towards_middle[2] = {0, 0.5};
    const int32_t vertex = g->faces[corner], a = g->faces[next_corner(corner)], b = g->faces[previous_corner(corner)];
    double along[3], offset[3], wanted[3], target[3], normal[3], projected[3];
    subtract(place(g, b), place(g, a), along);
    subtract(place(g, vertex), place(g, a), offset);
    const double square = dot(along, along), foot = square > 0 ? dot(offset, along) / square : 0;
    if (!(foot > 0 && foot < 1) || (g->marks[vertex] & FROZEN) || !vhp_centre_of_ring(g, vertex, 0, target, normal))
        return 0;
    for (int i = 0; i < 2; i++) {
        const double t = foot + towards_middle[i] * (0.5 - foot);
        for (int d = 0; d < 3; d++)
            wanted[d] = place(g, a)[d] + t * along[d];
        const int32_t face = vhp_project(g, vertex, wanted, normal, projected);
        if (face >= 0 && vhp_flip_onto(g, corner, projected, face)) {
            g->size[vertex] = vhp_reference_size(g, face, projected);
            return 1;
        }
    }
    return 0;
}

static int improve_face(Guarded *g, int32_t face, double quality)
{
    int32_t corners[3];
    const double shortest = sort_edges(g, face, corners);
    const int too_short = shortest < g->settings.min_edge;
    if (g->quality[face] >= quality && !too_short)
        return 0;
    if (vhp_flip(g, corners[2], FLIP_QUALITY))
        return 1;
    for (int k = 0; k < 3; k++)
        if (vhp_try_collapse(g, corners[k], too_short && k == 0 ? 0.05 : -1, UNLIMITED))
            return 1;
    return vhp_flip(g, corners[0], FLIP_QUALITY) || vhp_flip(g, corners[1], FLIP_QUALITY) ||
           flatten_cap(g, corners[2]);
}

/* Flip or collapse edges of triangles below `quality`, or with an edge that is too short. */
static int64_t improve_faces(Guarded *g, double quality)
{
    int32_t *tried = g->tried[TRIED_IMPROVE];
    int64_t done = 0;
    if (!vhp_boxes_build(g))
        return VHP_OUT_OF_MEMORY;
    for (int32_t f = 0; f < g->n_faces && !out_of_work(g); f++) {
        if (!is_live(g, f) || vhp_face_unchanged(g, f, tried[f]))
            continue;
        const int improved = improve_face(g, f, quality);
        done += improved;
        if (!improved)
            tried[f] = g->clock;
    }
    return done;
}

/* The quality phase: work on triangles below `quality` and on edges below the least length, until nothing helps any
 * more, in at most so many rounds. `moving`: by moving vertices, too. */
VHP_EXPORT int64_t vhp_guarded_improve(Guarded *g, double quality, int64_t rounds, int moving)
{
    int64_t done = 0;
    /* What was tried at another quality says nothing. */
    for (int64_t f = 0; f < g->face_room; f++)
        g->tried[TRIED_IMPROVE][f] = -1;
    for (int64_t v = 0; v < g->vertex_room; v++)
        g->tried[TRIED_SEARCH][v] = -1;
    for (int64_t round = 0; round < rounds && !out_of_work(g); round++) {
        const int64_t improved = improve_faces(g, quality);
        if (improved < 0)
            return improved;
        const int64_t moved = moving ? search_places(g, quality) : 0;
        done += improved + moved;
        if (!improved && !moved)
            break;
    }
    return g->failed ? VHP_OUT_OF_MEMORY : done;
}
