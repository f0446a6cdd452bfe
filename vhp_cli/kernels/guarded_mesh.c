/* Faces, vertices and their neighbours in a mesh under guarded operations: making, growing, walking, reading. */
#include <stdlib.h>
#include <string.h>

#include "guarded.h"

/* An edge of a face, as seen from the opposite corner. */
typedef struct {
    int32_t low, high; /* its vertices */
    int32_t corner;
    int32_t upward;    /* 1 if the face runs from `low` to `high` */
} HalfEdge;

static int compare_half_edges(const void *first, const void *second)
{
    const HalfEdge *a = first, *b = second;
    if (a->high != b->high)
        return a->high < b->high ? -1 : 1;
    return a->corner < b->corner ? -1 : a->corner > b->corner;
}

/* Sort half edges with the same lower vertex by the higher one, then by corner: few by insertion. */
static void sort_half_edges(HalfEdge *edges, int64_t count)
{
    if (count > 32) {
        qsort(edges, (size_t)count, sizeof *edges, compare_half_edges);
        return;
    }
    for (int64_t i = 1; i < count; i++) {
        const HalfEdge edge = edges[i];
        int64_t at = i;
        for (; at > 0 && compare_half_edges(&edges[at - 1], &edge) > 0; at--)
            edges[at] = edges[at - 1];
        edges[at] = edge;
    }
}

/* Resize an array that has `*array` as its address; 0 if memory runs out. */
static int resize(void *array, int64_t count, size_t width)
{
    void *old, *fresh;
    memcpy(&old, array, sizeof old);
    fresh = realloc(old, (size_t)count * width + 1);
    if (!fresh)
        return 0;
    memcpy(array, &fresh, sizeof fresh);
    return 1;
}

static int is_vertex_kind(int kind)
{
    return kind == TRIED_RELAX || kind == TRIED_SEARCH;
}

/* Make room for that many vertices and faces in all; 0 if memory runs out. */
int vhp_guarded_reserve(Guarded *g, int64_t vertices, int64_t faces)
{
    if (vertices > g->vertex_room) {
        const int64_t old = g->vertex_room, room = vertices + vertices / 2;
        if (!resize(&g->xyz, 3 * room, sizeof *g->xyz) || !resize(&g->size, room, sizeof *g->size) ||
            !resize(&g->corner, room, sizeof *g->corner) || !resize(&g->valence, room, sizeof *g->valence) ||
            !resize(&g->near, room, sizeof *g->near) || !resize(&g->component, room, sizeof *g->component) ||
            !resize(&g->marks, room, sizeof *g->marks) || !resize(&g->touched, room, sizeof *g->touched))
            return 0;
        for (int kind = 0; kind < TRIED_KINDS; kind++)
            if (is_vertex_kind(kind)) {
                if (!resize(&g->tried[kind], room, sizeof(int32_t)))
                    return 0;
                for (int64_t v = old; v < room; v++)
                    g->tried[kind][v] = -1;
            }
        g->vertex_room = room;
    }
    if (faces > g->face_room) {
        const int64_t old = g->face_room, room = faces + faces / 2;
        if (!resize(&g->faces, 3 * room, sizeof *g->faces) || !resize(&g->across, 3 * room, sizeof *g->across) ||
            !resize(&g->normal, 3 * room, sizeof *g->normal) || !resize(&g->quality, room, sizeof *g->quality) ||
            !resize(&g->shortest, room, sizeof *g->shortest) ||
            !resize(&g->degenerate, room, sizeof *g->degenerate) ||
            !resize(&g->first_sample, room, sizeof *g->first_sample) || !resize(&g->leaf, room, sizeof *g->leaf) ||
            !resize(&g->nodes, 2 * room, sizeof *g->nodes))
            return 0;
        for (int kind = 0; kind < TRIED_KINDS; kind++)
            if (!is_vertex_kind(kind)) {
                if (!resize(&g->tried[kind], room, sizeof(int32_t)))
                    return 0;
                for (int64_t f = old; f < room; f++)
                    g->tried[kind][f] = -1;
            }
        g->face_room = room;
    }
    return 1;
}

void vhp_forget_tries(Guarded *g)
{
    for (int kind = 0; kind < TRIED_KINDS; kind++) {
        const int64_t room = is_vertex_kind(kind) ? g->vertex_room : g->face_room;
        for (int64_t i = 0; i < room; i++)
            g->tried[kind][i] = -1;
    }
}

int32_t vhp_ring(const Guarded *g, int32_t vertex, int32_t *corners)
{
    const int32_t start = g->corner[vertex];
    int32_t c = start, count = 0;
    if (start < 0)
        return 0;
    do {
        if (count == MAX_RING)
            return -1;
        corners[count++] = c;
        const int32_t beyond = g->across[next_corner(c)];
        if (beyond < 0)
            break;
        c = next_corner(beyond);
    } while (c != start);
    return count;
}

int vhp_joined(const Guarded *g, int32_t a, int32_t b)
{
    /* Walk around the one with fewer faces, but never around a pinched one. */
    if ((g->marks[a] & PINCHED) || (!(g->marks[b] & PINCHED) && g->valence[a] > g->valence[b])) {
        const int32_t kept = a;
        a = b;
        b = kept;
    }
    const int32_t start = g->corner[a];
    int32_t c = start;
    if (g->marks[a] & PINCHED)
        return 1; /* nobody knows */
    if (start < 0)
        return 0;
    do {
        if (g->faces[next_corner(c)] == b || g->faces[previous_corner(c)] == b)
            return 1;
        const int32_t beyond = g->across[next_corner(c)];
        if (beyond < 0)
            break;
        c = next_corner(beyond);
    } while (c != start);
    return 0;
}

void vhp_set_face(Guarded *g, int32_t face, const int32_t vertices[3], const int32_t across[3])
{
    for (int32_t k = 0; k < 3; k++) {
        const int32_t c = 3 * face + k;
        g->faces[c] = vertices[k];
        g->across[c] = across[k];
        if (across[k] >= 0)
            g->across[across[k]] = c;
    }
}

void vhp_set_corner(Guarded *g, int32_t vertex, int32_t corner)
{
    /* Around a vertex on the boundary a walk has to begin at its clockwise end. */
    if (g->marks[vertex] & (BOUNDARY | PINCHED)) {
        const int32_t start = corner;
        for (;;) {
            const int32_t beyond = g->across[previous_corner(corner)];
            if (beyond < 0)
                break;
            corner = previous_corner(beyond);
            if (corner == start)
                break;
        }
    }
    g->corner[vertex] = corner;
}

/* Join the faces at the edges that have exactly two faces, in opposite directions; freeze the ends of all others. */
static int join_faces(Guarded *g)
{
    const int64_t n = 3 * g->n_faces;
    HalfEdge *edges = malloc((size_t)n * sizeof *edges + 1);
    int64_t *begin = calloc((size_t)g->n_vertices + 2, sizeof *begin); /* of the edges of each lower vertex, then end */
    if (!edges || !begin) {
        free(edges);
        free(begin);
        return 0;
    }
    for (int32_t c = 0; c < n; c++) {
        const int32_t from = g->faces[next_corner(c)], to = g->faces[previous_corner(c)];
        begin[(from < to ? from : to) + 2]++;
        g->across[c] = -1;
    }
    for (int64_t v = 0; v < g->n_vertices; v++)
        begin[v + 2] += begin[v + 1];
    for (int32_t c = 0; c < n; c++) {
        const int32_t from = g->faces[next_corner(c)], to = g->faces[previous_corner(c)];
        const HalfEdge edge = {from < to ? from : to, from < to ? to : from, c, from < to};
        edges[begin[edge.low + 1]++] = edge;
    }
    for (int64_t v = 0; v < g->n_vertices; v++)
        sort_half_edges(edges + begin[v], begin[v + 1] - begin[v]);
    free(begin);
    for (int64_t i = 0, end; i < n; i = end) {
        for (end = i + 1; end < n && edges[end].low == edges[i].low && edges[end].high == edges[i].high;)
            end++;
        if (end - i == 2 && edges[i].upward != edges[i + 1].upward) {
            g->across[edges[i].corner] = edges[i + 1].corner;
            g->across[edges[i + 1].corner] = edges[i].corner;
            continue;
        }
        const uint8_t marks = FROZEN | BOUNDARY | (end - i > 2 ? PINCHED : 0);
        g->marks[edges[i].low] |= marks;
        g->marks[edges[i].high] |= marks;
    }
    free(edges);
    return 1;
}

/* Give every vertex a corner, and mark those whose faces do not form one fan. */
static void find_corners(Guarded *g)
{
    for (int32_t c = 0; c < 3 * g->n_faces; c++) {
        const int32_t vertex = g->faces[c];
        g->valence[vertex]++;
        if (g->corner[vertex] < 0)
            vhp_set_corner(g, vertex, c);
    }
    for (int32_t v = 0; v < g->n_vertices; v++) {
        const int32_t start = g->corner[v];
        int32_t c = start, count = 0;
        if (start < 0)
            continue;
        do {
            count++;
            const int32_t beyond = g->across[next_corner(c)];
            if (beyond < 0)
                break;
            c = next_corner(beyond);
        } while (c != start);
        if (count != g->valence[v])
            g->marks[v] |= FROZEN | PINCHED;
    }
}

/* Number the sets of vertices that edges connect, by their first vertex. */
static int find_components(Guarded *g)
{
    const int64_t n = g->n_vertices;
    int32_t *parent = malloc((size_t)n * sizeof *parent + 1);
    if (!parent)
        return 0;
    for (int32_t v = 0; v < n; v++)
        parent[v] = v;
    for (int32_t c = 0; c < 3 * g->n_faces; c++) {
        int32_t a = g->faces[c], b = g->faces[next_corner(c)];
        while (parent[a] != a)
            a = parent[a] = parent[parent[a]];
        while (parent[b] != b)
            b = parent[b] = parent[parent[b]];
        if (a < b)
            parent[b] = a;
        else
            parent[a] = b;
    }
    for (int32_t v = 0; v < n; v++) { /* a root comes before its set */
        int32_t root = v;
        while (parent[root] != root)
            root = parent[root];
        if (g->corner[v] < 0)
            g->component[v] = -1; /* in no face */
        else
            g->component[v] = root == v ? (int32_t)g->n_components++ : g->component[root];
    }
    free(parent);
    return 1;
}

/* Normals and wanted lengths at the corners of the faces of the reference. */
static int prepare_reference(Guarded *g, const double *reference_sizes)
{
    const Tree *tree = g->reference;
    const size_t n = (size_t)tree->n_regular;
    g->reference_normal = malloc(3 * n * sizeof *g->reference_normal + 1);
    g->reference_size = malloc(3 * n * sizeof *g->reference_size + 1);
    if (!g->reference_normal || !g->reference_size)
        return 0;
    for (int64_t i = 0; i < tree->n_regular; i++) {
        shape_of(corner(tree, i, 0), corner(tree, i, 1), corner(tree, i, 2), g->reference_normal + 3 * i);
        memcpy(g->reference_size + 3 * i, reference_sizes + 3 * (int64_t)tree->numbers[i], 3 * sizeof(double));
    }
    return 1;
}

VHP_EXPORT void vhp_guarded_free(Guarded *g)
{
    if (!g)
        return;
    void *arrays[] = {g->xyz, g->size, g->corner, g->valence, g->near, g->component, g->marks, g->touched, g->faces,
                      g->across, g->normal, g->quality, g->shortest, g->degenerate, g->first_sample, g->nodes, g->leaf, g->stack,
                      g->reference_normal, g->reference_size, g->sample, g->next_sample, g->sample_place, g->loose,
                      g->wanted_volume};
    for (size_t i = 0; i < sizeof arrays / sizeof *arrays; i++)
        free(arrays[i]);
    for (int kind = 0; kind < TRIED_KINDS; kind++)
        free(g->tried[kind]);
    free(g);
}

static int fill(Guarded *g, const double *vertices, int64_t n_vertices, const int32_t *faces, int64_t n_faces,
                const double *sizes, const uint8_t *frozen, const double *reference_sizes, const double *samples,
                int64_t n_samples)
{
    if (!vhp_guarded_reserve(g, n_vertices, n_faces))
        return 0;
    g->n_vertices = n_vertices;
    g->n_faces = g->n_live_faces = n_faces;
    if (n_vertices) { /* arrays of nothing may have no address */
        memcpy(g->xyz, vertices, (size_t)n_vertices * 3 * sizeof *vertices);
        memcpy(g->size, sizes, (size_t)n_vertices * sizeof *sizes);
    }
    if (n_faces)
        memcpy(g->faces, faces, (size_t)n_faces * 3 * sizeof *faces);
    for (int64_t v = 0; v < n_vertices; v++) {
        g->corner[v] = g->near[v] = -1;
        g->valence[v] = g->touched[v] = 0;
        g->marks[v] = frozen && frozen[v] ? FROZEN : 0;
    }
    if (!join_faces(g))
        return 0;
    find_corners(g);
    if (!find_components(g) || !prepare_reference(g, reference_sizes))
        return 0;
    for (int64_t f = 0; f < n_faces; f++) {
        const double *a = place(g, faces[3 * f]), *b = place(g, faces[3 * f + 1]), *c = place(g, faces[3 * f + 2]);
        g->quality[f] = shape_of(a, b, c, g->normal + 3 * f);
        g->shortest[f] = shortest_of(a, b, c);
        g->degenerate[f] = vhp_projection_axis(a, b, c) < 0;
        g->first_sample[f] = -1;
    }
    g->n_samples = n_samples;
    g->sample = malloc((size_t)n_samples * 3 * sizeof *g->sample + 1);
    g->next_sample = malloc((size_t)n_samples * sizeof *g->next_sample + 1);
    g->sample_place = malloc((size_t)n_samples * sizeof *g->sample_place + 1);
    g->loose = malloc((size_t)n_samples * sizeof *g->loose + 1);
    g->wanted_volume = malloc((size_t)g->n_components * sizeof *g->wanted_volume + 1);
    if (!g->sample || !g->next_sample || !g->sample_place || !g->loose || !g->wanted_volume)
        return 0;
    if (n_samples)
        memcpy(g->sample, samples, (size_t)n_samples * 3 * sizeof *samples);
    for (int64_t v = 0; v < n_vertices; v++)
        if (g->corner[v] >= 0) {
            double nearest[3];
            g->near[v] = vhp_nearest_reference(g, place(g, (int32_t)v), g->settings.deviation, NULL, 0, -1, nearest);
        }
    if (n_samples && (!vhp_boxes_build(g) || !vhp_assign_samples(g))) /* else the tree is built when it is needed */
        return 0;
    vhp_component_volumes(g, g->wanted_volume, NULL);
    return 1;
}

/* Make a mesh to work on; NULL if memory runs out.
 *
 * vertices (n_vertices, 3) as the file holds them, faces (n_faces, 3) without repeated vertices, sizes (n_vertices)
 * in mm, frozen (n_vertices) or NULL. reference: tree over the surface to stay at, which must live as long as the
 * result; reference_sizes (faces of the reference, 3): wanted edge length at its corners. samples (n_samples, 3):
 * points of the reference that must stay covered. */
VHP_EXPORT Guarded *vhp_guarded_create(const double *vertices, int64_t n_vertices, const int32_t *faces,
                                       int64_t n_faces, const double *sizes, const uint8_t *frozen,
                                       const Tree *reference, const double *reference_sizes, const double *samples,
                                       int64_t n_samples, const Settings *settings)
{
    Guarded *g = calloc(1, sizeof *g);
    if (!g)
        return NULL;
    g->settings = *settings;
    g->reference = reference;
    g->root = g->free_node = g->nearby.count = -1;
    if (!fill(g, vertices, n_vertices, faces, n_faces, sizes, frozen, reference_sizes, samples, n_samples)) {
        vhp_guarded_free(g);
        return NULL;
    }
    return g;
}

VHP_EXPORT void vhp_guarded_set(Guarded *g, const Settings *settings)
{
    g->settings = *settings;
    vhp_forget_tries(g);
}

/* Numbers of vertices in use and of faces: what vhp_guarded_read writes. */
VHP_EXPORT void vhp_guarded_extent(const Guarded *g, int64_t *n_vertices, int64_t *n_faces)
{
    *n_vertices = 0;
    *n_faces = g->n_live_faces;
    for (int64_t v = 0; v < g->n_vertices; v++)
        *n_vertices += g->corner[v] >= 0;
}

/* Write the mesh without dead faces and unused vertices, in the order of their numbers, and wanted sizes;
 * `numbers`: scratch of as many entries as there are vertex numbers is made here. -1 if memory runs out. */
VHP_EXPORT int vhp_guarded_read(const Guarded *g, double *vertices, double *sizes, int32_t *faces)
{
    int32_t *numbers = malloc((size_t)g->n_vertices * sizeof *numbers + 1), used = 0;
    if (!numbers)
        return VHP_OUT_OF_MEMORY;
    for (int32_t v = 0; v < g->n_vertices; v++) {
        if (g->corner[v] < 0)
            continue;
        memcpy(vertices + 3 * (int64_t)used, place(g, v), 3 * sizeof *vertices);
        sizes[used] = g->size[v];
        numbers[v] = used++;
    }
    int64_t row = 0;
    for (int64_t f = 0; f < g->n_faces; f++) {
        if (!is_live(g, f))
            continue;
        for (int k = 0; k < 3; k++)
            faces[3 * row + k] = numbers[g->faces[3 * f + k]];
        row++;
    }
    free(numbers);
    return 0;
}

VHP_EXPORT void vhp_guarded_counts(const Guarded *g, int64_t *counts)
{
    memcpy(counts, g->counts, sizeof g->counts);
}
