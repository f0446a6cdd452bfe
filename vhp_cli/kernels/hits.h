/* Collect the pairs of faces that meet: all are counted, the worst are kept. */
#ifndef VHP_HITS_H
#define VHP_HITS_H

#include <stdint.h>
#include <stdlib.h>

#include "triangles.h"
#include "vhp.h"

/* What is kept in the end fills up in this order. */
static const int worst_first[KINDS - 1] = {KIND_CROSSING, KIND_COPLANAR, KIND_FOLD, KIND_DUPLICATE, KIND_TOUCH};

enum { IN_ANY = 1, IN_CROSSING = 2, IN_COPLANAR = 4 };

/* A soup of triangles can have as many pairs as the square of its faces. Such a mesh is hopeless long before the
 * last pair is counted, so the count stops here; mirrored in spatial.py. */
#define MOST_PAIRS 10000000

typedef struct {
    int64_t limit;         /* pairs kept of each kind */
    int64_t total;         /* pairs met */
    int64_t counts[KINDS]; /* pairs met of each kind */
    int32_t *pairs;        /* (KINDS, limit, 2) */
    uint8_t *marks_a, *marks_b; /* per face: in which kinds of pairs it is; one array if b is a */
} Hits;

static inline void free_hits(Hits *hits)
{
    free(hits->pairs);
    if (hits->marks_b != hits->marks_a)
        free(hits->marks_b);
    free(hits->marks_a);
}

/* n_b < 0: both faces of a pair are of one mesh. Returns 0 if memory runs out. */
static inline int start_hits(Hits *hits, int64_t limit, int64_t n_a, int64_t n_b)
{
    for (int kind = 0; kind < KINDS; kind++)
        hits->counts[kind] = 0;
    hits->limit = limit;
    hits->total = 0;
    hits->pairs = malloc((size_t)limit * KINDS * 2 * sizeof *hits->pairs + 1);
    hits->marks_a = calloc((size_t)n_a + 1, 1);
    hits->marks_b = n_b < 0 ? hits->marks_a : calloc((size_t)n_b + 1, 1);
    if (hits->pairs && hits->marks_a && hits->marks_b)
        return 1;
    free_hits(hits);
    return 0;
}

/* 0 if there is no point in going on. */
static inline int wants_more(const Hits *hits)
{
    return hits->total < MOST_PAIRS;
}

static inline void add_hit(Hits *hits, int kind, int64_t face_a, int64_t face_b)
{
    const uint8_t mark = IN_ANY | (kind == KIND_CROSSING ? IN_CROSSING : 0) | (kind == KIND_COPLANAR ? IN_COPLANAR : 0);
    const int64_t place = hits->counts[kind]++;
    hits->total++;
    hits->marks_a[face_a] |= mark;
    hits->marks_b[face_b] |= mark;
    if (place < hits->limit) {
        int32_t *pair = hits->pairs + 2 * (kind * hits->limit + place);
        pair[0] = (int32_t)face_a;
        pair[1] = (int32_t)face_b;
    }
}

static inline int64_t count_marks(const uint8_t *marks, int64_t n, uint8_t mark)
{
    int64_t count = 0;
    for (int64_t i = 0; i < n; i++)
        count += (marks[i] & mark) != 0;
    return count;
}

/* Write the worst pairs, as numbered by the caller, and free everything.
 * pairs (limit, 2), kinds (limit). counts (KINDS + 4): pairs by kind, faces of a and of b in any
 * pair, faces in a crossing pair, faces in a coplanar pair. Returns the number of pairs written. */
static inline int64_t finish_hits(Hits *hits, const int32_t *numbers_a, int64_t n_a, const int32_t *numbers_b,
                                  int64_t n_b, int32_t *pairs, uint8_t *kinds, int64_t *counts)
{
    int64_t written = 0;
    for (int rank = 0; rank < KINDS - 1; rank++) {
        const int kind = worst_first[rank];
        const int64_t kept = hits->counts[kind] < hits->limit ? hits->counts[kind] : hits->limit;
        for (int64_t k = 0; k < kept && written < hits->limit; k++, written++) {
            const int32_t *pair = hits->pairs + 2 * (kind * hits->limit + k);
            pairs[2 * written] = numbers_a[pair[0]];
            pairs[2 * written + 1] = numbers_b[pair[1]];
            kinds[written] = (uint8_t)kind;
        }
    }
    for (int kind = 0; kind < KINDS; kind++)
        counts[kind] = hits->counts[kind];
    const int one_mesh = hits->marks_a == hits->marks_b;
    counts[KINDS] = count_marks(hits->marks_a, n_a, IN_ANY);
    counts[KINDS + 1] = one_mesh ? 0 : count_marks(hits->marks_b, n_b, IN_ANY);
    counts[KINDS + 2] = count_marks(hits->marks_a, n_a, IN_CROSSING);
    counts[KINDS + 3] = count_marks(hits->marks_a, n_a, IN_COPLANAR);
    if (!one_mesh) {
        counts[KINDS + 2] += count_marks(hits->marks_b, n_b, IN_CROSSING);
        counts[KINDS + 3] += count_marks(hits->marks_b, n_b, IN_COPLANAR);
    }
    free_hits(hits);
    return written;
}

#endif
