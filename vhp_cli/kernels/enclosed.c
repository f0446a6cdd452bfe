/* Is a surface closed, and what volume does it enclose. */
#include "tree.h"

static uint64_t scramble(uint64_t x)
{
    x = (x ^ (x >> 31)) * 0x7fb5d329728ea185ULL;
    x = (x ^ (x >> 27)) * 0x81dadef4bc2dd44dULL;
    return x ^ (x >> 33);
}

double vhp_enclosed_volume(const Tree *tree)
{
    const double *origin = tree->vertices;
    uint64_t sum = 0;
    double six_volumes = 0;
    for (int64_t f = 0; f < tree->n_faces; f++) {
        double v[3][3];
        for (int k = 0; k < 3; k++) {
            const uint32_t from = (uint32_t)tree->faces[3 * f + k], to = (uint32_t)tree->faces[3 * f + (k + 1) % 3];
            for (int d = 0; d < 3; d++)
                v[k][d] = corner(tree, f, k)[d] - origin[d];
            if (from < to)
                sum += scramble((uint64_t)from << 32 | to);
            else if (from > to)
                sum -= scramble((uint64_t)to << 32 | from);
        }
        six_volumes += v[0][0] * (v[1][1] * v[2][2] - v[1][2] * v[2][1]) +
                       v[0][1] * (v[1][2] * v[2][0] - v[1][0] * v[2][2]) +
                       v[0][2] * (v[1][0] * v[2][1] - v[1][1] * v[2][0]);
    }
    return sum == 0 ? six_volumes / 6 : 0;
}
