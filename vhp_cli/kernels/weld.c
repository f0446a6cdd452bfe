/* Merge points that are equal (or nearer than a tolerance) into the vertices of an indexed mesh. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "vhp.h"

/* Open-addressing hash table from a position to the number of its vertex. The positions themselves
   lie in the caller's vertex array; the table holds vertex numbers only, -1 for a free slot. */
typedef struct {
    int32_t *slots;
    uint64_t mask;
    int64_t limit; /* number of vertices at which the table grows */
} Table;

static uint64_t mix(uint64_t hash)
{
    hash ^= hash >> 32;
    hash *= 0xBF58476D1CE4E5B9ULL;
    hash ^= hash >> 29;
    hash *= 0x94D049BB133111EBULL;
    return hash ^ (hash >> 32);
}

static uint64_t hash_words(const uint64_t words[3])
{
    return mix(words[0] * 0x9E3779B97F4A7C15ULL + mix(words[1] + 0x632BE59BD9B4E019ULL * words[2]));
}

static uint64_t hash_point(const double *point)
{
    uint64_t words[3];
    memcpy(words, point, sizeof words);
    return hash_words(words);
}

static int table_create(Table *table, int64_t expected)
{
    uint64_t size = 64;
    while ((int64_t)size < expected)
        size *= 2;
    table->slots = malloc(size * sizeof *table->slots);
    if (!table->slots)
        return -1;
    memset(table->slots, 0xff, size * sizeof *table->slots);
    table->mask = size - 1;
    table->limit = (int64_t)(size / 2);
    return 0;
}

/* Double the table when it is half full. */
static int table_grow(Table *table, const double *vertices, int64_t count)
{
    Table larger;
    if (table_create(&larger, 2 * ((int64_t)table->mask + 1)))
        return -1;
    for (int64_t i = 0; i < count; i++) {
        uint64_t slot = hash_point(vertices + 3 * i) & larger.mask;
        while (larger.slots[slot] >= 0)
            slot = (slot + 1) & larger.mask;
        larger.slots[slot] = (int32_t)i;
    }
    free(table->slots);
    *table = larger;
    return 0;
}

/* Return the vertex at `point`, appending it to `vertices` if it is new; -1 when memory runs out. */
static inline int64_t find_or_add(Table *table, double *vertices, int64_t *count, const double *point)
{
    uint64_t slot = hash_point(point) & table->mask;
    for (;;) {
        int32_t found = table->slots[slot];
        if (found < 0)
            break;
        const double *vertex = vertices + 3 * (int64_t)found;
        if (vertex[0] == point[0] && vertex[1] == point[1] && vertex[2] == point[2])
            return found;
        slot = (slot + 1) & table->mask;
    }
    int64_t fresh = (*count)++;
    table->slots[slot] = (int32_t)fresh;
    memcpy(vertices + 3 * fresh, point, 3 * sizeof *point);
    if (*count >= table->limit && table_grow(table, vertices, *count))
        return -1;
    return fresh;
}

/* Weld exactly: points (n, 3), finite -> vertices in order of first appearance, and for each point its vertex.
   Adding 0.0 turns -0.0 into 0.0, so that equal values have equal bits. Returns the number of vertices. */
VHP_EXPORT int64_t vhp_weld(const double *points, int64_t n, double *vertices, int32_t *index)
{
    Table table;
    int64_t count = 0;
    if (table_create(&table, n / 2))
        return -1;
    for (int64_t i = 0; i < n; i++) {
        double point[3];
        for (int axis = 0; axis < 3; axis++)
            point[axis] = points[3 * i + axis] + 0.0;
        int64_t vertex = find_or_add(&table, vertices, &count, point);
        if (vertex < 0) {
            count = -1;
            break;
        }
        index[i] = (int32_t)vertex;
    }
    free(table.slots);
    return count;
}

/* Weld the corners of n facets, 9 floats each, that lie `stride` bytes apart. Facets with a coordinate that is
   not finite or beyond 1e30 get no face; their numbers go to `unusable`.
   counts: [0] faces, [1] unusable facets. Returns the number of vertices. */
static int64_t weld_facets(const uint8_t *corners, int64_t stride, int64_t n, double *vertices, int32_t *faces,
                           int64_t *unusable, int64_t *counts)
{
    Table table;
    int64_t count = 0, n_faces = 0, n_unusable = 0;
    /* A closed mesh has half as many vertices as faces: the table then stays at most half full. */
    if (table_create(&table, n))
        return -1;
    for (int64_t i = 0; i < n; i++) {
        float corner[9];
        memcpy(corner, corners + i * stride, sizeof corner);
        int usable = 1;
        for (int k = 0; k < 9; k++)
            usable &= fabsf(corner[k]) <= 1e30f;
        if (!usable) {
            unusable[n_unusable++] = i;
            continue;
        }
        for (int k = 0; k < 3; k++) {
            double point[3];
            for (int axis = 0; axis < 3; axis++)
                point[axis] = (double)corner[3 * k + axis] + 0.0;
            int64_t vertex = find_or_add(&table, vertices, &count, point);
            if (vertex < 0) {
                free(table.slots);
                return -1;
            }
            faces[3 * n_faces + k] = (int32_t)vertex;
        }
        n_faces++;
    }
    counts[0] = n_faces;
    counts[1] = n_unusable;
    free(table.slots);
    return count;
}

/* Facets as 9 contiguous floats. */
VHP_EXPORT int64_t vhp_weld_facets(const float *corners, int64_t n, double *vertices, int32_t *faces, int64_t *unusable,
                                   int64_t *counts)
{
    return weld_facets((const uint8_t *)corners, 9 * sizeof *corners, n, vertices, faces, unusable, counts);
}

/* Binary STL records: normal (12 bytes), corners (36), attribute (2), little-endian as the machine must be.
   counts: [0] faces, [1] unusable facets, [2] records with a non-zero attribute. */
VHP_EXPORT int64_t vhp_weld_stl_records(const uint8_t *records, int64_t n, double *vertices, int32_t *faces,
                                        int64_t *unusable, int64_t *counts)
{
    int64_t attributes = 0;
    for (int64_t i = 0; i < n; i++)
        attributes += (records[50 * i + 48] | records[50 * i + 49]) != 0;
    counts[2] = attributes;
    return weld_facets(records + 12, 50, n, vertices, faces, unusable, counts);
}

static int32_t find_root(int32_t *parent, int32_t i)
{
    while (parent[i] != i) {
        parent[i] = parent[parent[i]];
        i = parent[i];
    }
    return i;
}

/* The smaller root wins: the root of a set is its first member. */
static void unite(int32_t *parent, int32_t i, int32_t j)
{
    i = find_root(parent, i);
    j = find_root(parent, j);
    if (i < j)
        parent[j] = i;
    else
        parent[i] = j;
}

typedef struct {
    int64_t cell[3];
    int32_t newest; /* head of the chain of points in this cell */
} Cell;

/* Return the slot of the cell, or of the free place where it belongs. */
static uint64_t find_cell(const int32_t *slots, uint64_t mask, const Cell *cells, const int64_t *cell)
{
    uint64_t words[3];
    memcpy(words, cell, sizeof words);
    uint64_t slot = hash_words(words) & mask;
    while (slots[slot] >= 0 && memcmp(cells[slots[slot]].cell, cell, 3 * sizeof *cell) != 0)
        slot = (slot + 1) & mask;
    return slot;
}

/* Single linkage: root[i] becomes the first point that is joined to point i by steps not longer than `tolerance`.
   The cells of the grid are so small (tolerance / 2) that all points of one cell are joined without a test, and a
   neighbouring cell that already belongs to the same set is skipped: the cost stays linear for any tolerance.
   `origin` is the lower corner of the points; cell numbers must stay below 2^53. Returns 0, or -1 without memory. */
VHP_EXPORT int32_t vhp_link_points(const double *points, int32_t n, const double *origin, double tolerance,
                                   int32_t *root)
{
    uint64_t size = 64;
    while (size < 2 * (uint64_t)n)
        size *= 2;
    int32_t *slots = malloc(size * sizeof *slots);
    Cell *cells = malloc(((size_t)n + 1) * sizeof *cells);
    int32_t *previous = malloc(((size_t)n + 1) * sizeof *previous);
    int32_t n_cells = 0;
    if (!slots || !cells || !previous) {
        free(slots);
        free(cells);
        free(previous);
        return -1;
    }
    memset(slots, 0xff, size * sizeof *slots);
    for (int32_t i = 0; i < n; i++) {
        const double *point = points + 3 * (int64_t)i;
        int64_t home[3], cell[3];
        root[i] = i;
        for (int axis = 0; axis < 3; axis++)
            home[axis] = (int64_t)floor((point[axis] - origin[axis]) / (0.5 * tolerance));
        for (int neighbour = 0; neighbour < 125; neighbour++) {
            cell[0] = home[0] + neighbour % 5 - 2;
            cell[1] = home[1] + neighbour / 5 % 5 - 2;
            cell[2] = home[2] + neighbour / 25 - 2;
            uint64_t slot = find_cell(slots, size - 1, cells, cell);
            if (slots[slot] < 0)
                continue;
            int32_t other = cells[slots[slot]].newest;
            if (neighbour == 62) { /* the home cell */
                unite(root, i, other);
                continue;
            }
            if (find_root(root, other) == find_root(root, i))
                continue;
            for (; other >= 0; other = previous[other]) {
                const double *position = points + 3 * (int64_t)other;
                double dx = position[0] - point[0], dy = position[1] - point[1], dz = position[2] - point[2];
                if (dx * dx + dy * dy + dz * dz <= tolerance * tolerance) {
                    unite(root, i, other);
                    break;
                }
            }
        }
        uint64_t slot = find_cell(slots, size - 1, cells, home);
        if (slots[slot] < 0) {
            memcpy(cells[n_cells].cell, home, sizeof home);
            cells[n_cells].newest = -1;
            slots[slot] = n_cells++;
        }
        previous[i] = cells[slots[slot]].newest;
        cells[slots[slot]].newest = i;
    }
    for (int32_t i = 0; i < n; i++)
        root[i] = find_root(root, i);
    free(slots);
    free(cells);
    free(previous);
    return 0;
}
