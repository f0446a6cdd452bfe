/* What every kernel shares: the mark of an exported function.
 *
 * Conventions of all kernels: plain C arrays in and out, coordinates in mm, rows of three; a
 * function that allocates returns -1 when memory runs out; everything not exported is `static` or,
 * if two files share it, prefixed `vhp_` and hidden by -fvisibility=hidden.
 */
#ifndef VHP_H
#define VHP_H

#include <stdint.h>

#ifdef _WIN32
#define VHP_EXPORT __declspec(dllexport)
#else
#define VHP_EXPORT __attribute__((visibility("default")))
#endif

#define VHP_OUT_OF_MEMORY (-1)

#endif
