#include <math.h>
#include "tree.h"
#include "vhp.h"
VHP_EXPORT int vhp_overlap_volume(const Tree *a, const Tree *b, double *volume)
{
    (void)a;
    (void)b;
    *volume = NAN;
    return 0;
}
