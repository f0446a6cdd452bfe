/* A queue of edges (edge_queue.h). */
#include "edge_queue.h"

#include <stdlib.h>
#include <string.h>

static int32_t class_of(double cost)
{
    uint64_t bits;
    memcpy(&bits, &cost, sizeof bits);
    return (int32_t)(bits >> 47);
}

EdgeQueue *vhp_queue_create(void)
{
    EdgeQueue *queue = malloc(sizeof *queue);
    if (!queue)
        return NULL;
    queue->entries = NULL;
    queue->room = 0;
    vhp_queue_clear(queue);
    return queue;
}

void vhp_queue_clear(EdgeQueue *queue)
{
    queue->count = 0;
    queue->free_entry = -1;
    queue->least = COST_CLASSES;
    for (int32_t i = 0; i < COST_CLASSES; i++)
        queue->first[i] = queue->last[i] = -1;
}

int vhp_queue_push(EdgeQueue *queue, const EdgeEntry *entry)
{
    int32_t at = queue->free_entry;
    if (at >= 0) {
        queue->free_entry = queue->entries[at].next;
    } else {
        if (queue->count == queue->room) {
            if (queue->room > INT32_MAX / 2 - 1024)
                return 0;
            const int32_t room = 2 * queue->room + 1024;
            EdgeEntry *entries = realloc(queue->entries, (size_t)room * sizeof *entries);
            if (!entries)
                return 0;
            queue->entries = entries;
            queue->room = room;
        }
        at = queue->count++;
    }
    queue->entries[at] = *entry;
    queue->entries[at].next = -1;
    const int32_t class = class_of(entry->cost);
    if (queue->last[class] < 0)
        queue->first[class] = at;
    else
        queue->entries[queue->last[class]].next = at;
    queue->last[class] = at;
    queue->least = class < queue->least ? class : queue->least;
    return 1;
}

int vhp_queue_pop(EdgeQueue *queue, EdgeEntry *entry)
{
    while (queue->least < COST_CLASSES && queue->first[queue->least] < 0)
        queue->least++;
    if (queue->least == COST_CLASSES)
        return 0;
    const int32_t at = queue->first[queue->least], next = queue->entries[at].next;
    *entry = queue->entries[at];
    queue->first[queue->least] = next;
    if (next < 0)
        queue->last[queue->least] = -1;
    else
        __builtin_prefetch(&queue->entries[next]);
    queue->entries[at].next = queue->free_entry;
    queue->free_entry = at;
    return 1;
}

void vhp_queue_free(EdgeQueue *queue)
{
    if (queue)
        free(queue->entries);
    free(queue);
}
