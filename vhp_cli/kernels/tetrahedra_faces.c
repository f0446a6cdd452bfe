/* Find equal faces of tetrahedra: by their lowest corner, then by the others. */
#include <stdlib.h>
#include <string.h>

#include "vhp.h"

/* A face by its two higher corners, in ascending order, and its number. */
typedef struct {
    int32_t middle, high;
    int64_t number;
} Face;

/* The three corners opposite to each corner, in any order. */
static const int OPPOSITE[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};

static int32_t ordered(const int32_t *corners, int which, int32_t *middle, int32_t *high)
{
    int32_t a = corners[OPPOSITE[which][0]], b = corners[OPPOSITE[which][1]], c = corners[OPPOSITE[which][2]], swap;
    if (a > b) {
        swap = a;
        a = b;
        b = swap;
    }
    if (b > c) {
        swap = b;
        b = c;
        c = swap;
    }
    if (a > b) {
        swap = a;
        a = b;
        b = swap;
    }
    *middle = b;
    *high = c;
    return a;
}

static int by_corners(const void *one, const void *other)
{
    const Face *a = one, *b = other;
    if (a->middle != b->middle)
        return a->middle < b->middle ? -1 : 1;
    if (a->high != b->high)
        return a->high < b->high ? -1 : 1;
    return (a->number > b->number) - (a->number < b->number);
}

/* Bring the 4 n_tets faces of tetrahedra, of which face 4 t + k lies opposite to corner k of t, into the order of their
 * sorted corners, then of their numbers.
 *
 * order (4 n_tets): their numbers; equal (4 n_tets): whether each has the corners of the one before. */
VHP_EXPORT int vhp_tetrahedra_faces(const int32_t *corners, int64_t n_tets, int64_t n_points, int64_t *order,
                                    uint8_t *equal)
{
    const int64_t n_faces = 4 * n_tets;
    int64_t *first = calloc((size_t)n_points + 2, sizeof *first);
    Face *faces = malloc(((size_t)n_faces + 1) * sizeof *faces);
    if (!first || !faces) {
        free(first);
        free(faces);
        return VHP_OUT_OF_MEMORY;
    }
    int32_t middle, high;
    for (int64_t number = 0; number < n_faces; number++)
        first[ordered(corners + 4 * (number / 4), (int)(number % 4), &middle, &high) + 2]++;
    for (int64_t point = 0; point < n_points; point++)
        first[point + 2] += first[point + 1];
    for (int64_t number = 0; number < n_faces; number++) {
        const int32_t low = ordered(corners + 4 * (number / 4), (int)(number % 4), &middle, &high);
        faces[first[low + 1]++] = (Face){middle, high, number};
    }
    for (int64_t point = 0; point < n_points; point++) {
        const int64_t begin = first[point], count = first[point + 1] - begin;
        if (count > 1)
            qsort(faces + begin, (size_t)count, sizeof *faces, by_corners);
        for (int64_t i = begin; i < begin + count; i++) {
            order[i] = faces[i].number;
            equal[i] = i > begin && faces[i].middle == faces[i - 1].middle && faces[i].high == faces[i - 1].high;
        }
    }
    free(first);
    free(faces);
    return 0;
}
