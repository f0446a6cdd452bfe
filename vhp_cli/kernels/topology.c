/* Edges, orientation, vertex fans, components and duplicates of a triangle mesh, in time linear in its faces.

   A half-edge h = 3 f + k runs from corner k of face f to corner (k + 1) % 3; half-edges are 32-bit numbers, so a
   mesh may have (2^31 - 1) / 3 faces. Collapsed faces (two or three equal vertices) are named and otherwise left
   out. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "vhp.h"

/* Indices into `counts`, mirrored in surface.py. */
enum {
    N_EDGES,
    N_INNER,     /* edges with exactly two faces */
    N_OUTER,     /* all other edges */
    N_INCONSISTENT,
    N_COMPONENTS,
    N_REFERENCED,
    N_PINCHED,   /* non-manifold vertices */
    N_DUPLICATES,
    N_COLLAPSED
};

/* The edges met so far at one lower vertex. */
typedef struct {
    int32_t first, second; /* half-edges */
    int32_t upper;         /* the other vertex */
    int32_t count;
} Edge;

typedef struct {
    int32_t *bucket_end;   /* per vertex: end of its half-edges in `bucket` (those whose lower vertex it is) */
    int32_t *bucket;
    int32_t *mate;         /* per half-edge: the half-edge of the one other face at this edge, or -1 */
    int32_t *first_corner; /* per vertex: its first corner, or -1 */
    int32_t *degree;       /* per vertex: corners */
    int32_t *latest;       /* per vertex: number of the edge last opened towards it */
    int32_t *parent;       /* union-find over the faces */
    uint8_t *crowded;      /* per vertex: end of an edge with more than two faces */
    uint8_t *suspicious;   /* per face: may have a duplicate */
    Edge *edges;
} Scratch;

static void release(Scratch *s)
{
    free(s->bucket_end);
    free(s->bucket);
    free(s->mate);
    free(s->first_corner);
    free(s->degree);
    free(s->latest);
    free(s->parent);
    free(s->crowded);
    free(s->suspicious);
    free(s->edges);
}

static inline int32_t next_half_edge(int32_t h) { return h % 3 == 2 ? h - 2 : h + 1; }
static inline int32_t previous_half_edge(int32_t h) { return h % 3 == 0 ? h + 2 : h - 1; }

static inline int is_collapsed(const int32_t *face)
{
    return face[0] == face[1] || face[1] == face[2] || face[2] == face[0];
}

static int32_t find_root(int32_t *parent, int32_t i)
{
    while (parent[i] != i) {
        parent[i] = parent[parent[i]];
        i = parent[i];
    }
    return i;
}

/* The smaller root wins: the root of a component is its first face. */
static inline void unite(int32_t *parent, int32_t i, int32_t j)
{
    i = find_root(parent, i);
    j = find_root(parent, j);
    if (i < j)
        parent[j] = i;
    else
        parent[i] = j;
}

/* Whether the faces around vertex v form one fan: walk from one corner over the mates in both directions and
   compare the number of corners met with the degree. Needs at most two faces at every edge of v. */
static int is_one_fan(const int32_t *faces, const Scratch *s, int32_t v)
{
    int32_t start = s->first_corner[v];
    int32_t met = 1;
    int32_t leave = start; /* the half-edge over which the walk leaves the face */
    for (int direction = 0; direction < 2; direction++) {
        while (s->mate[leave] >= 0) {
            int32_t enter = s->mate[leave];
            /* The other edge of this face at v; the two faces may be oriented against each other. */
            int starts_at_v = faces[enter] == v;
            if ((starts_at_v ? enter : next_half_edge(enter)) == start)
                return met == s->degree[v];
            leave = starts_at_v ? previous_half_edge(enter) : next_half_edge(enter);
            met++;
        }
        leave = previous_half_edge(start);
    }
    return met == s->degree[v];
}

static uint64_t hash_triple(const int32_t *triple)
{
    uint64_t hash = (uint64_t)(uint32_t)triple[0] * 0x9E3779B97F4A7C15ULL;
    hash = (hash ^ (hash >> 29)) + (uint32_t)triple[1];
    hash *= 0xBF58476D1CE4E5B9ULL;
    hash = (hash ^ (hash >> 32)) + (uint32_t)triple[2];
    hash *= 0x94D049BB133111EBULL;
    return hash ^ (hash >> 31);
}

static void sorted_triple(const int32_t *face, int32_t *triple)
{
    int32_t low = face[0] < face[1] ? face[0] : face[1], high = face[0] < face[1] ? face[1] : face[0];
    triple[0] = low < face[2] ? low : face[2];
    triple[2] = high > face[2] ? high : face[2];
    triple[1] = low < face[2] ? (high < face[2] ? high : face[2]) : low;
}

/* Among the suspicious faces, name those whose three vertices an earlier one has, by hashing. */
static int64_t find_duplicates(const int32_t *faces, int64_t n, const uint8_t *suspicious, int32_t *duplicates)
{
    int64_t n_suspicious = 0, found = 0;
    for (int64_t f = 0; f < n; f++)
        n_suspicious += suspicious[f];
    if (!n_suspicious)
        return 0;
    uint64_t size = 16;
    while (size < 2 * (uint64_t)n_suspicious)
        size *= 2;
    int32_t *slots = malloc(size * sizeof *slots);
    if (!slots)
        return -1;
    memset(slots, 0xff, size * sizeof *slots);
    for (int64_t f = 0; f < n; f++) {
        if (!suspicious[f])
            continue;
        int32_t mine[3], other[3];
        sorted_triple(faces + 3 * f, mine);
        uint64_t slot = hash_triple(mine) & (size - 1);
        for (; slots[slot] >= 0; slot = (slot + 1) & (size - 1)) {
            sorted_triple(faces + 3 * (int64_t)slots[slot], other);
            if (!memcmp(mine, other, sizeof mine))
                break;
        }
        if (slots[slot] >= 0)
            duplicates[found++] = (int32_t)f;
        else
            slots[slot] = (int32_t)f;
    }
    free(slots);
    return found;
}

/* Everything about the connections of the faces.

   faces            (n, 3), n_vertices vertices
   edge_vertices    (3 n, 2), out: edges with two faces from the front, all others from the back; lower vertex first
   edge_faces       (3 n, 2), out: their faces; the second is -1 at a boundary edge, and -k at one with k > 2 faces
   inconsistent     (3 n / 2), out: those of the edges with two faces that both faces run along in the same direction
   component        (n), out: label by shared edges, in the order of the first faces; -1 for collapsed faces
   pinched, pinched_faces   (n_vertices), out: vertices whose faces do not form one fan, or at an edge with more than
                    two faces, and one face of each
   duplicates, collapsed    (n), out: face numbers
   lengths          out: minimum, sum and maximum of the edge lengths
   shortest         out: the two vertices and one face of the shortest edge (-1 if there is no edge)
   Returns 0, or -1 when memory runs out. */
VHP_EXPORT int32_t vhp_topology(const double *vertices, int64_t n_vertices, const int32_t *faces, int64_t n,
                                int32_t *edge_vertices, int32_t *edge_faces, int32_t *inconsistent, int32_t *component,
                                int32_t *pinched, int32_t *pinched_faces, int32_t *duplicates, int32_t *collapsed,
                                int64_t *counts, double *lengths, int32_t *shortest)
{
    size_t nv = (size_t)n_vertices + 1, nh = 3 * (size_t)n + 1;
    Scratch s = {
        .bucket_end = calloc(nv, sizeof *s.bucket_end),
        .bucket = malloc(nh * sizeof *s.bucket),
        .mate = malloc(nh * sizeof *s.mate),
        .first_corner = malloc(nv * sizeof *s.first_corner),
        .degree = calloc(nv, sizeof *s.degree),
        .latest = malloc(nv * sizeof *s.latest),
        .parent = malloc(((size_t)n + 1) * sizeof *s.parent),
        .crowded = calloc(nv, 1),
        .suspicious = calloc((size_t)n + 1, 1),
    };
    if (!s.bucket_end || !s.bucket || !s.mate || !s.first_corner || !s.degree || !s.latest || !s.parent || !s.crowded ||
        !s.suspicious) {
        release(&s);
        return -1;
    }

    /* Sort the half-edges by their lower vertex. */
    int64_t n_collapsed = 0;
    for (int64_t f = n - 1; f >= 0; f--) {
        const int32_t *face = faces + 3 * f;
        s.parent[f] = (int32_t)f;
        if (is_collapsed(face))
            continue;
        for (int k = 0; k < 3; k++) {
            int32_t from = face[k], to = face[k == 2 ? 0 : k + 1];
            s.bucket_end[from < to ? from : to]++;
            s.degree[from]++;
            s.first_corner[from] = (int32_t)(3 * f + k);
        }
    }
    int32_t total = 0, largest = 0;
    for (int64_t v = 0; v < n_vertices; v++) {
        int32_t size = s.bucket_end[v];
        s.bucket_end[v] = total; /* the start, until the bucket is filled */
        total += size;
        if (size > largest)
            largest = size;
        s.latest[v] = -1;
    }
    for (int64_t f = 0; f < n; f++) {
        const int32_t *face = faces + 3 * f;
        if (is_collapsed(face)) {
            collapsed[n_collapsed++] = (int32_t)f;
            continue;
        }
        for (int k = 0; k < 3; k++) {
            int32_t from = face[k], to = face[k == 2 ? 0 : k + 1];
            s.bucket[s.bucket_end[from < to ? from : to]++] = (int32_t)(3 * f + k);
        }
    }
    s.edges = malloc(((size_t)largest + 1) * sizeof *s.edges);
    if (!s.edges) {
        release(&s);
        return -1;
    }
    for (int64_t h = 0; h < 3 * n; h++)
        s.mate[h] = -1;

    /* Join the half-edges of each lower vertex into edges. Edges are numbered in the order in which they are opened,
       so latest[w] belongs to this lower vertex exactly if it is not below the number of its first edge. */
    int32_t n_edges = 0, n_inner = 0, n_inconsistent = 0, n_outer = 0;
    double shortest_square = INFINITY, longest_square = 0, length_sum = 0;
    shortest[0] = shortest[1] = shortest[2] = -1;
    for (int64_t v = 0; v < n_vertices; v++) {
        int32_t begin = v ? s.bucket_end[v - 1] : 0, end = s.bucket_end[v], base = n_edges;
        int any_crowded = 0;
        double length_here = 0;
        for (int32_t i = begin; i < end; i++) {
            int32_t h = s.bucket[i];
            int32_t upper = faces[h] == (int32_t)v ? faces[next_half_edge(h)] : faces[h];
            if (s.latest[upper] < base) {
                s.edges[n_edges - base] = (Edge){.first = h, .second = -1, .upper = upper, .count = 1};
                s.latest[upper] = n_edges++;
                continue;
            }
            Edge *edge = s.edges + (s.latest[upper] - base);
            if (edge->count++ == 1)
                edge->second = h;
            else
                any_crowded = 1;
            unite(s.parent, edge->first / 3, h / 3);
        }
        for (int32_t e = 0; e < n_edges - base; e++) {
            Edge edge = s.edges[e];
            int32_t face = edge.first / 3;
            int64_t place;
            if (edge.count == 2) {
                int32_t other = edge.second / 3;
                s.mate[edge.first] = edge.second;
                s.mate[edge.second] = edge.first;
                if (faces[edge.first] == faces[edge.second])
                    inconsistent[n_inconsistent++] = n_inner;
                if (faces[previous_half_edge(edge.first)] == faces[previous_half_edge(edge.second)])
                    s.suspicious[face] = s.suspicious[other] = 1;
                place = n_inner++;
                edge_faces[2 * place + 1] = other;
            } else {
                place = 3 * n - ++n_outer;
                edge_faces[2 * place + 1] = edge.count == 1 ? -1 : -edge.count;
                if (edge.count > 2)
                    s.crowded[v] = s.crowded[edge.upper] = 1;
            }
            edge_faces[2 * place] = face;
            edge_vertices[2 * place] = (int32_t)v;
            edge_vertices[2 * place + 1] = edge.upper;
            const double *a = vertices + 3 * v, *b = vertices + 3 * (int64_t)edge.upper;
            double dx = a[0] - b[0], dy = a[1] - b[1], dz = a[2] - b[2], square = dx * dx + dy * dy + dz * dz;
            length_here += sqrt(square);
            if (square > longest_square)
                longest_square = square;
            if (square < shortest_square) {
                shortest_square = square;
                shortest[0] = (int32_t)v;
                shortest[1] = edge.upper;
                shortest[2] = face;
            }
        }
        length_sum += length_here;
        for (int32_t i = begin; any_crowded && i < end; i++) {
            int32_t h = s.bucket[i];
            int32_t upper = faces[h] == (int32_t)v ? faces[next_half_edge(h)] : faces[h];
            if (s.edges[s.latest[upper] - base].count > 2)
                s.suspicious[h / 3] = 1;
        }
    }

    int64_t n_referenced = 0, n_pinched = 0;
    for (int64_t v = 0; v < n_vertices; v++) {
        if (!s.degree[v])
            continue;
        n_referenced++;
        if (s.crowded[v] || !is_one_fan(faces, &s, (int32_t)v)) {
            pinched[n_pinched] = (int32_t)v;
            pinched_faces[n_pinched++] = s.first_corner[v] / 3;
        }
    }

    /* Roots are first faces, so they come before all other faces of their component. */
    int32_t n_components = 0;
    for (int64_t f = 0; f < n; f++) {
        if (is_collapsed(faces + 3 * f)) {
            component[f] = -1;
            continue;
        }
        int32_t root = find_root(s.parent, (int32_t)f);
        component[f] = root == f ? n_components++ : component[root];
    }

    int64_t n_duplicates = find_duplicates(faces, n, s.suspicious, duplicates);
    release(&s);
    if (n_duplicates < 0)
        return -1;
    counts[N_EDGES] = n_edges;
    counts[N_INNER] = n_inner;
    counts[N_OUTER] = n_outer;
    counts[N_INCONSISTENT] = n_inconsistent;
    counts[N_COMPONENTS] = n_components;
    counts[N_REFERENCED] = n_referenced;
    counts[N_PINCHED] = n_pinched;
    counts[N_DUPLICATES] = n_duplicates;
    counts[N_COLLAPSED] = n_collapsed;
    lengths[0] = sqrt(shortest_square);
    lengths[1] = length_sum;
    lengths[2] = sqrt(longest_square);
    return 0;
}

/* Label the connected pieces of a graph of n edges (n, 2) over n_vertices vertices, in the order of their first edge.
   Returns the number of pieces, or -1 when memory runs out. */
VHP_EXPORT int32_t vhp_edge_loops(const int32_t *edges, int64_t n, int64_t n_vertices, int32_t *label)
{
    int32_t *parent = malloc(((size_t)n_vertices + 1) * sizeof *parent);
    int32_t *number = malloc(((size_t)n_vertices + 1) * sizeof *number);
    int32_t pieces = 0;
    if (!parent || !number) {
        free(parent);
        free(number);
        return -1;
    }
    for (int64_t v = 0; v < n_vertices; v++) {
        parent[v] = (int32_t)v;
        number[v] = -1;
    }
    for (int64_t e = 0; e < n; e++)
        unite(parent, edges[2 * e], edges[2 * e + 1]);
    for (int64_t e = 0; e < n; e++) {
        int32_t root = find_root(parent, edges[2 * e]);
        if (number[root] < 0)
            number[root] = pieces++;
        label[e] = number[root];
    }
    free(parent);
    free(number);
    return pieces;
}
