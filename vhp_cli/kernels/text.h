/* Numbers and words in text, for the parsers of the ASCII formats. */
#ifndef VHP_TEXT_H
#define VHP_TEXT_H

#include <stdint.h>

/* A word without the white space around it. */
typedef struct {
    const char *begin, *end;
} Word;

static inline int is_space(char c) { return c == ' ' || (c >= '\t' && c <= '\r'); }

static inline int is_line_end(char c) { return c == '\n' || c == '\r'; }

static inline char lower(char c) { return c >= 'A' && c <= 'Z' ? (char)(c + ('a' - 'A')) : c; }

/* Whether the word is `keyword` (lower case), in any case. */
static inline int is_word(Word word, const char *keyword)
{
    const char *p = word.begin;
    for (; p < word.end && *keyword; p++, keyword++)
        if (lower(*p) != *keyword)
            return 0;
    return p == word.end && !*keyword;
}

static inline const char *skip_space(const char *p, const char *end)
{
    while (p < end && is_space(*p))
        p++;
    return p;
}

static inline const char *skip_word(const char *p, const char *end)
{
    while (p < end && !is_space(*p))
        p++;
    return p;
}

static inline const char *skip_line(const char *p, const char *end)
{
    while (p < end && !is_line_end(*p))
        p++;
    return p;
}

static inline Word next_word(const char **cursor, const char *end)
{
    Word word;
    word.begin = skip_space(*cursor, end);
    word.end = skip_word(word.begin, end);
    *cursor = word.end;
    return word;
}

/* Read the whole word as a number, correctly rounded and independent of the locale; "nan", "inf" and their variants
   ("-1.#IND", "nan(ind)", "infinity") give NaN and infinity. Returns 1, or 0 if the word is no number. */
int vhp_parse_double(Word word, double *value);
int vhp_parse_float(Word word, float *value);

#endif
