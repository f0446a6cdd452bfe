/* Wavefront OBJ: vertices and faces out of text. */
#include <limits.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

#include "text.h"
#include "vhp.h"

/* Indices into `account`, mirrored in reading.py; offsets are bytes from the start of the text, -1: nowhere. */
enum {
    N_VERTICES,
    N_TRIANGLES,
    N_FACES,
    N_POLYGONS,    /* faces with more than three corners */
    N_OBJECTS,     /* "o" statements */
    N_BAD_FACES,   /* faces without three corners that can be read, left out */
    FIRST_BAD,     /* offset of the first of them */
    N_LOOSE,       /* statements that OBJ does not know, vertices that can't be read */
    FIRST_LOOSE,   /* offset of the first of them */
    N_ACCOUNT
};

/* Statements of the format that say nothing about the surface. */
static const char *const IGNORED[] = {
    "vn",     "vt",     "vp",       "g",         "s",         "mg",    "l",     "p",    "mtllib", "usemtl", "maplib",
    "usemap", "bevel",  "c_interp", "d_interp",  "lod",       "ctech", "stech", "curv", "curv2",  "surf",   "parm",
    "trim",   "hole",   "scrv",     "sp",        "end",       "con",   "deg",   "bmat", "step",   "cstype", "call",
    "csh",    "bsp",    "bzp",      "cdc",       "cdp",       "res",   "fo",    "shadow_obj",     "trace_obj"};

typedef struct {
    const char *text, *end, *cursor;
    double *vertices;
    int32_t *triangles;
    int32_t *face_of;
    int64_t *account;
} Parser;

/* The next word of the statement; empty at its end. A backslash before the end of a line joins the next line to it,
   a word that begins with # starts a comment. */
static Word next_in_statement(Parser *p)
{
    const char *c = p->cursor;
    for (;;) {
        while (c < p->end && is_space(*c) && !is_line_end(*c))
            c++;
        if (c + 1 < p->end && *c == '\\' && is_line_end(c[1])) {
            c += c + 2 < p->end && c[1] == '\r' && c[2] == '\n' ? 3 : 2;
            continue;
        }
        break;
    }
    if (c < p->end && *c == '#')
        c = skip_line(c, p->end);
    Word word = {c, c};
    while (word.end < p->end && !is_space(*word.end) &&
           !(*word.end == '\\' && word.end + 1 < p->end && is_line_end(word.end[1])))
        word.end++;
    p->cursor = word.end;
    return word;
}

static void skip_statement(Parser *p)
{
    for (;;) {
        Word word = next_in_statement(p);
        if (word.begin == word.end)
            return;
    }
}

static void note_loose(Parser *p, const char *where)
{
    if (p->account[N_LOOSE]++ == 0)
        p->account[FIRST_LOOSE] = where - p->text;
}

/* Anything after the third coordinate (a weight, a colour) is left aside. */
static void read_vertex(Parser *p, const char *where)
{
    double *vertex = p->vertices + 3 * p->account[N_VERTICES];
    int readable = 1;
    for (int axis = 0; axis < 3; axis++) {
        Word word = next_in_statement(p);
        if (word.begin == word.end || !vhp_parse_double(word, vertex + axis)) {
            vertex[axis] = NAN;
            readable = 0;
        }
    }
    if (!readable)
        note_loose(p, where);
    p->account[N_VERTICES]++;
    skip_statement(p);
}

/* Read the vertex number of a corner "v", "v/vt", "v//vn" or "v/vt/vn", counted from 1 or, negative, back from the
   latest vertex. Returns it counted from 0, or -1. Numbers of vertices that come later are legal. */
static int32_t read_corner(Word word, int64_t n_vertices)
{
    const char *c = word.begin;
    int negative = c < word.end && *c == '-';
    int64_t value = 0;
    if (c < word.end && (*c == '-' || *c == '+'))
        c++;
    const char *digits = c;
    for (; c < word.end && *c >= '0' && *c <= '9'; c++)
        if (value <= INT32_MAX)
            value = 10 * value + (*c - '0');
    if (c == digits || (c < word.end && *c != '/') || value == 0 || value > INT32_MAX)
        return -1;
    if (!negative)
        return (int32_t)(value - 1);
    return value <= n_vertices ? (int32_t)(n_vertices - value) : -1;
}

/* Cut the face into a fan of triangles about its first corner. */
static void read_face(Parser *p, const char *where)
{
    int64_t *account = p->account, start = account[N_TRIANGLES], corners = 0;
    int32_t first = 0, previous = 0;
    int readable = 1;
    for (;;) {
        Word word = next_in_statement(p);
        if (word.begin == word.end)
            break;
        int32_t corner = read_corner(word, account[N_VERTICES]);
        if (corner < 0)
            readable = 0;
        if (corners == 0)
            first = corner;
        if (corners >= 2) {
            int64_t triangle = account[N_TRIANGLES]++;
            p->triangles[3 * triangle] = first;
            p->triangles[3 * triangle + 1] = previous;
            p->triangles[3 * triangle + 2] = corner;
            p->face_of[triangle] = (int32_t)account[N_FACES];
        }
        previous = corner;
        corners++;
    }
    if (corners < 3 || !readable) {
        account[N_TRIANGLES] = start;
        if (account[N_BAD_FACES]++ == 0)
            account[FIRST_BAD] = where - p->text;
    }
    account[N_POLYGONS] += corners > 3;
    account[N_FACES]++;
}

static int is_ignored(Word word)
{
    for (size_t i = 0; i < sizeof IGNORED / sizeof *IGNORED; i++)
        if (is_word(word, IGNORED[i]))
            return 1;
    return 0;
}

/* Bounds for the arrays of vhp_parse_obj: sizes[0] vertices, sizes[1] triangles. */
VHP_EXPORT void vhp_count_obj(const char *text, int64_t length, int64_t *sizes)
{
    Parser p = {.text = text, .end = text + length, .cursor = text};
    sizes[0] = sizes[1] = 0;
    while ((p.cursor = skip_space(p.cursor, p.end)) < p.end) {
        Word word = next_in_statement(&p);
        if (is_word(word, "v"))
            sizes[0]++;
        if (!is_word(word, "f")) {
            skip_statement(&p);
            continue;
        }
        for (int64_t corners = 0;; corners++) {
            word = next_in_statement(&p);
            if (word.begin == word.end)
                break;
            sizes[1] += corners >= 2;
        }
    }
}

/* Read the whole text.

   vertices     (sizes[0], 3), out; NaN where a coordinate can't be read
   triangles    (sizes[1], 3), out: vertex numbers from 0, which may be too large
   face_of      (sizes[1]), out: number of the face that the triangle is part of
   account      N_ACCOUNT values, see the enum */
VHP_EXPORT void vhp_parse_obj(const char *text, int64_t length, double *vertices, int32_t *triangles, int32_t *face_of,
                              int64_t *account)
{
    Parser p = {.text = text,
                .end = text + length,
                .cursor = text,
                .vertices = vertices,
                .triangles = triangles,
                .face_of = face_of,
                .account = account};
    memset(account, 0, N_ACCOUNT * sizeof *account);
    account[FIRST_BAD] = account[FIRST_LOOSE] = -1;
    while ((p.cursor = skip_space(p.cursor, p.end)) < p.end) {
        Word word = next_in_statement(&p);
        if (is_word(word, "v")) {
            read_vertex(&p, word.begin);
        } else if (is_word(word, "f")) {
            read_face(&p, word.begin);
        } else {
            account[N_OBJECTS] += is_word(word, "o");
            if (word.begin < word.end && !is_word(word, "o") && !is_ignored(word))
                note_loose(&p, word.begin);
            skip_statement(&p);
        }
    }
}
