/* Re-triangulation of a surface by edge flips until it is Delaunay (thesis 2.3.4).

   A half-edge h = 3 f + k runs from corner k of face f to corner (k + 1) % 3; half-edges are 32-bit numbers, so a mesh
   may have (2^31 - 1) / 3 faces. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "vector.h"
#include "vhp.h"

/* Sine of the excess over pi from which on an edge is flipped: four points on a circle are left as they are. */
static const double SMALLEST_EXCESS = 1e-9;

/* In exact arithmetic the surface area falls with every flip, so that the flips end; this many per face in any case. */
enum { MOST_FLIPS_PER_FACE = 32 };

/* Key of a slot of the table in which no edge is. */
static const uint64_t FREE = UINT64_MAX;

/* Open-addressing hash table of the edges; the key is lower vertex * n_vertices + upper vertex. */
typedef struct {
    uint64_t *keys;
    int32_t *first; /* the first half-edge of each edge, -1 if its faces can't be joined; of use in join_faces only */
    uint64_t mask;
} Table;

typedef struct {
    int32_t *faces;
    int32_t *mate;    /* per half-edge: the half-edge of the other face, or -1 where the edge must stay */
    int32_t *queue;   /* ring of half-edges to look at; each is in it once at most */
    uint8_t *waiting; /* per half-edge: is in the queue */
    int64_t head, length, capacity;
    int64_t n_vertices;
    Table edges;
} Flipping;

static inline int32_t next_half_edge(int32_t h) { return h % 3 == 2 ? h - 2 : h + 1; }
static inline int32_t previous_half_edge(int32_t h) { return h % 3 == 0 ? h + 2 : h - 1; }

static inline uint64_t edge_key(const Flipping *s, int32_t a, int32_t b)
{
    return (uint64_t)(a < b ? a : b) * (uint64_t)s->n_vertices + (uint64_t)(a < b ? b : a);
}

static inline uint64_t home_of(const Table *table, uint64_t key)
{
    key = (key ^ (key >> 32)) * 0x9E3779B97F4A7C15ULL;
    return (key ^ (key >> 29)) & table->mask;
}

/* The slot of a key, or the free slot where it belongs. */
static inline uint64_t find_slot(const Table *table, uint64_t key)
{
    uint64_t slot = home_of(table, key);
    while (table->keys[slot] != FREE && table->keys[slot] != key)
        slot = (slot + 1) & table->mask;
    return slot;
}

/* Free a slot, and move up those behind it that would no longer be found. */
static void remove_slot(Table *table, uint64_t slot)
{
    for (uint64_t other = (slot + 1) & table->mask; table->keys[other] != FREE; other = (other + 1) & table->mask) {
        uint64_t home = home_of(table, table->keys[other]);
        if (((other - home) & table->mask) >= ((other - slot) & table->mask)) {
            table->keys[slot] = table->keys[other];
            slot = other;
        }
    }
    table->keys[slot] = FREE;
}

/* Enter all edges; mates only where exactly two faces run along an edge, in opposite directions. */
static void join_faces(Flipping *s, int64_t n)
{
    const int32_t *faces = s->faces;
    for (int64_t h = 0; h < 3 * n; h++)
        s->mate[h] = -1;
    for (int64_t f = 0; f < n; f++) {
        const int32_t *face = faces + 3 * f;
        if (face[0] == face[1] || face[1] == face[2] || face[2] == face[0])
            continue;
        for (int k = 0; k < 3; k++) {
            int32_t h = (int32_t)(3 * f + k), from = face[k];
            uint64_t key = edge_key(s, from, face[k == 2 ? 0 : k + 1]), slot = find_slot(&s->edges, key);
            if (s->edges.keys[slot] == FREE) {
                s->edges.keys[slot] = key;
                s->edges.first[slot] = h;
                continue;
            }
            int32_t first = s->edges.first[slot];
            if (first < 0)
                continue;
            if (s->mate[first] < 0 && faces[first] != from) {
                s->mate[first] = h;
                s->mate[h] = first;
                continue;
            }
            /* A third face, or a second one that runs the same way. */
            if (s->mate[first] >= 0)
                s->mate[s->mate[first]] = -1;
            s->mate[first] = -1;
            s->edges.first[slot] = -1;
        }
    }
}

static void enqueue(Flipping *s, int32_t h)
{
    int32_t other = s->mate[h];
    if (other < 0 || s->waiting[h] || s->waiting[other])
        return;
    s->waiting[h] = 1;
    s->queue[(s->head + s->length++) % s->capacity] = h;
}

static int32_t dequeue(Flipping *s)
{
    int32_t h = s->queue[s->head];
    s->head = (s->head + 1) % s->capacity;
    s->length--;
    s->waiting[h] = 0;
    return h;
}

/* Sine and cosine of the angle at `tip` between the directions to a and b, times the lengths of both. */
static void angle_at(const double *tip, const double *a, const double *b, double *sine, double *cosine)
{
    double u[3], v[3], normal[3];
    subtract(a, tip, u);
    subtract(b, tip, v);
    cross(u, v, normal);
    *sine = sqrt(dot(normal, normal));
    *cosine = dot(u, v);
}

/* Whether the angles opposite to edge a-b, at c and d, exceed pi in sum: then the sine of the sum is negative. */
static int exceeds_pi(const double *a, const double *b, const double *c, const double *d)
{
    double sine_c, cosine_c, sine_d, cosine_d;
    angle_at(c, a, b, &sine_c, &cosine_c);
    angle_at(d, a, b, &sine_d, &cosine_d);
    double lengths = sqrt(sine_c * sine_c + cosine_c * cosine_c) * sqrt(sine_d * sine_d + cosine_d * cosine_d);
    return sine_c * cosine_d + cosine_c * sine_d < -SMALLEST_EXCESS * lengths;
}

static int has_area(const double *a, const double *b, const double *c)
{
    double sine, cosine;
    angle_at(a, b, c, &sine, &cosine);
    return sine > 0;
}

/* Replace faces a-b-c and b-a-d at half-edge h (from a to b) by d-b-c and c-a-d; look at their outer edges again. */
static void flip(Flipping *s, int32_t h)
{
    int32_t g = s->mate[h], ca = previous_half_edge(h), db = previous_half_edge(g);
    int32_t a = s->faces[h], b = s->faces[g], c = s->faces[ca], d = s->faces[db];
    remove_slot(&s->edges, find_slot(&s->edges, edge_key(s, a, b)));
    uint64_t key = edge_key(s, c, d);
    s->edges.keys[find_slot(&s->edges, key)] = key;

    /* Half-edge h now runs from d to b, g from c to a; those that did run from c to d and back. */
    s->faces[h] = d;
    s->faces[g] = c;
    int32_t beyond_db = s->mate[db], beyond_ca = s->mate[ca];
    s->mate[h] = beyond_db;
    s->mate[g] = beyond_ca;
    s->mate[ca] = db;
    s->mate[db] = ca;
    if (beyond_db >= 0)
        s->mate[beyond_db] = h;
    if (beyond_ca >= 0)
        s->mate[beyond_ca] = g;
    const int32_t outer[4] = {h, next_half_edge(h), g, next_half_edge(g)};
    for (int i = 0; i < 4; i++)
        enqueue(s, outer[i]);
}

/* Flip, in the order of the faces, every edge whose opposite angles exceed pi in sum, until there is none. An edge
   stays if it does not have exactly two faces that run along it in opposite directions, if both its ends are
   constrained, if the new edge exists already, or if a new face would have no area: so a manifold remains one.

   vertices     (n_vertices, 3)
   faces        (n, 3), in and out: a flip keeps the numbers of its two faces
   constrained  (n_vertices)
   Returns the number of flips, or -1 when memory runs out. */
VHP_EXPORT int64_t vhp_smooth_flips(const double *vertices, int64_t n_vertices, int32_t *faces, int64_t n,
                                      const uint8_t *constrained)
{
    size_t half_edges = 3 * (size_t)n + 1, size = 16;
    while (size < 3 * (size_t)n + (size_t)n / 2) /* about 1.5 edges per face in a closed mesh, 3 in a soup */
        size *= 2;
    Flipping s = {
        .faces = faces,
        .mate = malloc(half_edges * sizeof *s.mate),
        .queue = malloc(half_edges * sizeof *s.queue),
        .waiting = calloc(half_edges, 1),
        .capacity = (int64_t)half_edges,
        .n_vertices = n_vertices,
        .edges = {.keys = malloc(size * sizeof *s.edges.keys),
                  .first = malloc(size * sizeof *s.edges.first),
                  .mask = size - 1},
    };
    int64_t flips = 0;
    if (!s.mate || !s.queue || !s.waiting || !s.edges.keys || !s.edges.first) {
        flips = VHP_OUT_OF_MEMORY;
    } else {
        memset(s.edges.keys, 0xff, size * sizeof *s.edges.keys);
        join_faces(&s, n);
        for (int64_t h = 0; h < 3 * n; h++)
            enqueue(&s, (int32_t)h);
        while (s.length && flips < MOST_FLIPS_PER_FACE * n) {
            int32_t h = dequeue(&s), g = s.mate[h];
            if (g < 0)
                continue;
            int32_t a = faces[h], b = faces[g], c = faces[previous_half_edge(h)], d = faces[previous_half_edge(g)];
            const double *at_a = vertices + 3 * (int64_t)a, *at_b = vertices + 3 * (int64_t)b,
                         *at_c = vertices + 3 * (int64_t)c, *at_d = vertices + 3 * (int64_t)d;
            if (c == d || (constrained[a] && constrained[b]) || !exceeds_pi(at_a, at_b, at_c, at_d))
                continue;
            if (s.edges.keys[find_slot(&s.edges, edge_key(&s, c, d))] != FREE)
                continue;
            if (!has_area(at_c, at_a, at_d) || !has_area(at_d, at_b, at_c))
                continue;
            flip(&s, h);
            flips++;
        }
    }
    free(s.mate);
    free(s.queue);
    free(s.waiting);
    free(s.edges.keys);
    free(s.edges.first);
    return flips;
}
