/* ASCII STL: facets out of text, with an account of everything that is not as it should be. */
#include <math.h>
#include <stdint.h>
#include <string.h>

#include "text.h"
#include "vhp.h"

/* Indices into `account`, mirrored in reading.py; offsets are bytes from the start of the text, -1: nowhere. */
enum {
    N_SOLIDS,
    N_FACETS,       /* complete facets, handed out */
    N_BAD,          /* facets without exactly three readable vertices, left out */
    FIRST_BAD,      /* offset of the first of them */
    N_LOOSE,        /* departures from the grammar */
    FIRST_LOOSE,    /* offset of the first */
    OPEN_AT_END,    /* 0: the text ends after endsolid, 1: in a solid, 2: in a facet */
    LAST_START,     /* offset of the last "facet" or "solid" */
    TRAILING,       /* offset of what follows the last endsolid */
    COMMA_SEEN,     /* a number that could not be read has a comma */
    FIRST_WILD,     /* offset of the first facet handed out that is not finite or beyond 1e30 */
    N_ACCOUNT
};

enum State { OUTSIDE, IN_SOLID, IN_FACET, IN_LOOP, AFTER_LOOP };

typedef struct {
    const char *text, *end, *cursor;
    enum State state;
    float corners[9];
    int n_corners; /* of the open facet */
    int unreadable;
    float *facets;
    int64_t *bad;
    int64_t *account;
} Parser;

static void note_loose(Parser *p, const char *where)
{
    if (p->account[N_LOOSE]++ == 0)
        p->account[FIRST_LOOSE] = where - p->text;
}

static int is_facet_open(const Parser *p) { return p->state >= IN_FACET; }

static void open_facet(Parser *p, const char *where)
{
    p->n_corners = 0;
    p->unreadable = 0;
    p->state = IN_FACET;
    p->account[LAST_START] = where - p->text;
}

static void close_facet(Parser *p)
{
    int64_t *account = p->account;
    if (p->n_corners == 3 && !p->unreadable) {
        int tame = 1;
        for (int k = 0; k < 9; k++)
            tame &= fabsf(p->corners[k]) <= 1e30f;
        if (!tame && account[FIRST_WILD] < 0)
            account[FIRST_WILD] = account[LAST_START];
        memcpy(p->facets + 9 * account[N_FACETS], p->corners, sizeof p->corners);
        account[N_FACETS]++;
    } else {
        if (p->n_corners != 3)
            note_loose(p, p->text + account[LAST_START]);
        if (account[N_BAD] == 0)
            account[FIRST_BAD] = account[LAST_START];
        p->bad[account[N_BAD]] = account[N_FACETS] + account[N_BAD];
        account[N_BAD]++;
    }
    p->state = IN_SOLID;
}

/* The name runs to the end of the line, unless the facets follow on the same line. */
static void skip_name(Parser *p)
{
    const char *line_end = skip_line(p->cursor, p->end);
    while (p->cursor < line_end) {
        const char *before = p->cursor;
        Word word = next_word(&p->cursor, line_end);
        if (!is_word(word, "facet"))
            continue;
        const char *ahead = p->cursor;
        if (is_word(next_word(&ahead, line_end), "normal")) {
            p->cursor = before;
            return;
        }
    }
    p->cursor = line_end;
}

/* Three numbers that nobody uses: the normal follows from the corners. */
static void skip_normal(Parser *p)
{
    const char *start = p->cursor;
    if (!is_word(next_word(&p->cursor, p->end), "normal")) {
        p->cursor = start;
        note_loose(p, start);
        return;
    }
    for (int axis = 0; axis < 3; axis++) {
        const char *before = p->cursor;
        Word word = next_word(&p->cursor, p->end);
        if (word.begin == word.end)
            return;
        char c = lower(*word.begin);
        if (c == 'o' || c == 'v' || c == 'e' || c == 'f') { /* the next keyword */
            p->cursor = before;
            note_loose(p, word.begin);
            return;
        }
    }
}

static void read_vertex(Parser *p, const char *where)
{
    if (p->state != IN_LOOP) {
        note_loose(p, where);
        if (!is_facet_open(p))
            open_facet(p, where);
        p->state = IN_LOOP;
    }
    for (int axis = 0; axis < 3; axis++) {
        const char *before = p->cursor;
        Word word = next_word(&p->cursor, p->end);
        float value;
        if (word.begin == word.end || !vhp_parse_float(word, &value)) {
            p->unreadable = 1;
            note_loose(p, word.begin);
            if (memchr(word.begin, ',', (size_t)(word.end - word.begin)))
                p->account[COMMA_SEEN] = 1;
            p->cursor = before; /* it may be the next keyword */
            return;
        }
        if (p->n_corners < 3)
            p->corners[3 * p->n_corners + axis] = value;
    }
    if (p->n_corners <= 3)
        p->n_corners++;
}

/* What follows the last solid counts as trailing only if nothing that matters comes after it. */
static void expect_inside(Parser *p, const char *where)
{
    if (p->account[TRAILING] >= 0) {
        p->account[TRAILING] = -1;
        note_loose(p, where);
    }
}

static void read_keyword(Parser *p, Word word)
{
    if (is_word(word, "vertex")) {
        expect_inside(p, word.begin);
        read_vertex(p, word.begin);
    } else if (is_word(word, "facet")) {
        expect_inside(p, word.begin);
        if (p->state != IN_SOLID)
            note_loose(p, word.begin);
        if (is_facet_open(p))
            close_facet(p);
        open_facet(p, word.begin);
        skip_normal(p);
    } else if (is_word(word, "outer")) {
        const char *before = p->cursor;
        if (p->state != IN_FACET)
            note_loose(p, word.begin);
        if (is_facet_open(p))
            p->state = IN_LOOP;
        if (!is_word(next_word(&p->cursor, p->end), "loop")) {
            p->cursor = before;
            note_loose(p, word.begin);
        }
    } else if (is_word(word, "endloop")) {
        if (p->state != IN_LOOP)
            note_loose(p, word.begin);
        if (is_facet_open(p))
            p->state = AFTER_LOOP;
    } else if (is_word(word, "endfacet")) {
        if (p->state != AFTER_LOOP)
            note_loose(p, word.begin);
        if (is_facet_open(p))
            close_facet(p);
    } else if (is_word(word, "endsolid")) {
        if (p->state != IN_SOLID)
            note_loose(p, word.begin);
        if (is_facet_open(p))
            close_facet(p);
        p->state = OUTSIDE;
        skip_name(p);
    } else if (is_word(word, "solid")) {
        expect_inside(p, word.begin);
        if (p->state != OUTSIDE)
            note_loose(p, word.begin);
        if (is_facet_open(p))
            close_facet(p);
        p->state = IN_SOLID;
        p->account[N_SOLIDS]++;
        p->account[LAST_START] = word.begin - p->text;
        skip_name(p);
    } else {
        if (p->state != OUTSIDE || p->account[N_SOLIDS] == 0)
            note_loose(p, word.begin);
        else if (p->account[TRAILING] < 0)
            p->account[TRAILING] = word.begin - p->text;
        p->cursor = skip_line(p->cursor, p->end);
    }
}

/* Read all facets of the text.

   facets   room for length / 38 + 1 facets of 9 floats
   bad      room for length / 5 + 1 numbers: which of all facets, counted from 0, had to be left out
   account  N_ACCOUNT values, see the enum
   A facet that the end of the text cuts off is neither handed out nor counted as bad. */
VHP_EXPORT void vhp_parse_stl(const char *text, int64_t length, float *facets, int64_t *bad, int64_t *account)
{
    Parser parser = {
        .text = text, .end = text + length, .cursor = text, .facets = facets, .bad = bad, .account = account};
    memset(account, 0, N_ACCOUNT * sizeof *account);
    account[FIRST_BAD] = account[FIRST_LOOSE] = account[LAST_START] = account[TRAILING] = account[FIRST_WILD] = -1;
    for (;;) {
        Word word = next_word(&parser.cursor, parser.end);
        if (word.begin == word.end)
            break;
        read_keyword(&parser, word);
    }
    account[OPEN_AT_END] = is_facet_open(&parser) ? 2 : parser.state == IN_SOLID;
}
