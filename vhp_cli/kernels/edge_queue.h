/* A queue of edges, the cheapest first, but for a factor of 1.03: costs are put into classes.
 *
 * Within a class the edges come in the order in which they were added, so that those of a flat region are taken as they
 * lie in memory, and each operation takes constant time. An entry is never changed: when the cost of an edge changes,
 * another one is added, and the user passes over those that are out of date, by the stamps of the two vertices. */
#ifndef VHP_EDGE_QUEUE_H
#define VHP_EDGE_QUEUE_H

#include <stdint.h>

typedef struct {
    double cost; /* not negative, not NaN */
    int32_t vertex[2], stamp[2];
    int32_t attempt;
    int32_t next; /* of the class; for the queue */
} EdgeEntry;

/* The upper bits of a double that is not negative: the exponent and five bits of the mantissa. */
#define COST_CLASSES 65536

typedef struct {
    EdgeEntry *entries;
    int32_t count, room, free_entry;
    int32_t least;                /* no class below it has an entry */
    int32_t first[COST_CLASSES], last[COST_CLASSES];
} EdgeQueue;

/* An empty queue; NULL if memory runs out. */
EdgeQueue *vhp_queue_create(void);
/* Take out all entries. */
void vhp_queue_clear(EdgeQueue *queue);
/* 0 if memory runs out. */
int vhp_queue_push(EdgeQueue *queue, const EdgeEntry *entry);
/* Take out the next entry; 0 if there is none. */
int vhp_queue_pop(EdgeQueue *queue, EdgeEntry *entry);
void vhp_queue_free(EdgeQueue *queue);

#endif
