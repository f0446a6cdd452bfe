/* Numbers in text, correctly rounded. */
#include "text.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "vhp.h"

/* A decimal number mantissa * 10^exponent; digits beyond the 19th are dropped from the mantissa. */
typedef struct {
    uint64_t mantissa;
    int64_t exponent;
    int negative;
    int exact; /* no digit other than 0 was dropped */
} Decimal;

/* All powers of ten that a double holds exactly. */
static const double POWERS[] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,  1e8,  1e9,  1e10, 1e11,
                                1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};

enum { MAX_DIGITS = 19, MAX_POWER = 22, EXPONENT_LIMIT = 100000 };

static inline int is_digit(char c) { return c >= '0' && c <= '9'; }

static int scan_decimal(Word word, Decimal *decimal)
{
    const char *p = word.begin, *end = word.end;
    uint64_t mantissa = 0;
    int64_t exponent = 0;
    int digits = 0, seen = 0, after_point = 0;
    decimal->negative = p < end && *p == '-';
    decimal->exact = 1;
    if (p < end && (*p == '-' || *p == '+'))
        p++;
    for (; p < end; p++) {
        if (*p == '.' && !after_point) {
            after_point = 1;
            continue;
        }
        if (!is_digit(*p))
            break;
        seen = 1;
        if (digits < MAX_DIGITS) {
            mantissa = 10 * mantissa + (uint64_t)(*p - '0');
            digits += mantissa != 0; /* leading zeros are no digits */
            exponent -= after_point;
        } else {
            decimal->exact &= *p == '0';
            exponent += !after_point;
        }
    }
    if (!seen)
        return 0;
    if (p < end && (*p == 'e' || *p == 'E' || *p == 'd' || *p == 'D')) { /* d: Fortran */
        int64_t written = 0;
        int negative = 0;
        p++;
        if (p < end && (*p == '-' || *p == '+'))
            negative = *p++ == '-';
        if (p == end)
            return 0;
        for (; p < end && is_digit(*p); p++)
            if (written < EXPONENT_LIMIT)
                written = 10 * written + (*p - '0');
        exponent += negative ? -written : written;
    }
    decimal->mantissa = mantissa;
    decimal->exponent = exponent;
    return p == end;
}

/* The words for "not a number" and "infinite" that C libraries write. */
static int parse_special(Word word, double *value)
{
    const char *p = word.begin;
    int negative = p < word.end && *p == '-';
    if (p < word.end && (*p == '-' || *p == '+'))
        p++;
    Word rest = {p, word.end};
    Word three = {p, word.end - p > 3 ? p + 3 : word.end};
    if (is_word(rest, "inf") || is_word(rest, "infinity") || is_word(rest, "1.#inf") || is_word(rest, "1.#inf00")) {
        *value = negative ? -INFINITY : INFINITY;
        return 1;
    }
    if (is_word(rest, "nan") || (is_word(three, "nan") && word.end - p > 3 && p[3] == '(') || is_word(three, "1.#")) {
        *value = NAN;
        return 1;
    }
    return 0;
}

/* Rewrite the number as digits and exponent without a decimal point, whose character depends on the locale, and let
   the C library round it. Digits beyond the 800th can only tip a tie: one 1 stands for all of them. */
enum { LONGEST = 800 };

static void write_plain(Word word, char *text, size_t size)
{
    const char *p = word.begin;
    size_t length = 0;
    int64_t exponent = 0, written = 0;
    int after_point = 0, sticky = 0, negative = 0;
    if (*p == '-' || *p == '+') {
        if (*p == '-')
            text[length++] = '-';
        p++;
    }
    size_t start = length;
    for (; p < word.end && (is_digit(*p) || *p == '.'); p++) {
        if (*p == '.') {
            after_point = 1;
        } else if (length == start && *p == '0') {
            exponent -= after_point;
        } else if (length - start < LONGEST) {
            text[length++] = *p;
            exponent -= after_point;
        } else {
            sticky |= *p != '0';
            exponent += !after_point;
        }
    }
    if (sticky) {
        text[length++] = '1';
        exponent--;
    }
    if (length == start)
        text[length++] = '0';
    if (p < word.end) {
        p++;
        if (*p == '-' || *p == '+')
            negative = *p++ == '-';
        for (; p < word.end; p++)
            if (written < EXPONENT_LIMIT)
                written = 10 * written + (*p - '0');
    }
    exponent += negative ? -written : written;
    snprintf(text + length, size - length, "e%lld", (long long)exponent);
}

/* m * 10^e with at most three roundings; exact where the mantissa and the power are doubles. */
static inline double approximate(const Decimal *decimal)
{
    double m = (double)decimal->mantissa;
    return decimal->exponent < 0 ? m / POWERS[-decimal->exponent] : m * POWERS[decimal->exponent];
}

int vhp_parse_double(Word word, double *value)
{
    Decimal decimal;
    if (!scan_decimal(word, &decimal))
        return parse_special(word, value);
    if (decimal.exact && decimal.mantissa <= (1ULL << 53) && decimal.exponent >= -MAX_POWER &&
        decimal.exponent <= MAX_POWER) {
        double magnitude = approximate(&decimal);
        *value = decimal.negative ? -magnitude : magnitude;
        return 1;
    }
    char text[LONGEST + 40];
    write_plain(word, text, sizeof text);
    *value = strtod(text, NULL);
    return 1;
}

int vhp_parse_float(Word word, float *value)
{
    Decimal decimal;
    if (!scan_decimal(word, &decimal)) {
        double special;
        if (!parse_special(word, &special))
            return 0;
        *value = (float)special;
        return 1;
    }
    if (decimal.exponent >= -MAX_POWER && decimal.exponent <= MAX_POWER) {
        double magnitude = approximate(&decimal);
        /* The double is right to a few units in its last place. That fixes the float unless it lies so near to the
           middle between two floats, where the 29 bits that a float lacks are 1000...0. */
        uint64_t bits;
        memcpy(&bits, &magnitude, sizeof bits);
        int64_t from_middle = (int64_t)(bits & 0x1fffffff) - 0x10000000;
        int is_normal = magnitude > 2 * (double)FLT_MIN && magnitude < 0.5 * (double)FLT_MAX;
        if (magnitude == 0 || (is_normal && (from_middle > 16 || from_middle < -16))) {
            *value = (float)(decimal.negative ? -magnitude : magnitude);
            return 1;
        }
    }
    char text[LONGEST + 40];
    write_plain(word, text, sizeof text);
    *value = strtof(text, NULL);
    return 1;
}

/* Read white-space separated numbers: words that are none end the reading. Stops after `capacity` numbers.
   Returns how many were read; *stop is where the reading ended (the length if the text is used up). */
VHP_EXPORT int64_t vhp_parse_numbers(const char *text, int64_t length, double *values, int64_t capacity, int64_t *stop)
{
    const char *cursor = text, *end = text + length;
    int64_t count = 0;
    while (count < capacity) {
        Word word = next_word(&cursor, end);
        if (word.begin == word.end || !vhp_parse_double(word, values + count)) {
            cursor = word.begin;
            break;
        }
        count++;
    }
    *stop = cursor - text;
    return count;
}

/* As above, rounded to float; for the tests of both number parsers. */
VHP_EXPORT int64_t vhp_parse_floats(const char *text, int64_t length, float *values, int64_t capacity, int64_t *stop)
{
    const char *cursor = text, *end = text + length;
    int64_t count = 0;
    while (count < capacity) {
        Word word = next_word(&cursor, end);
        if (word.begin == word.end || !vhp_parse_float(word, values + count)) {
            cursor = word.begin;
            break;
        }
        count++;
    }
    *stop = cursor - text;
    return count;
}

/* Number of white-space separated words. */
VHP_EXPORT int64_t vhp_count_words(const char *text, int64_t length)
{
    int64_t count = 0;
    int inside = 0;
    for (int64_t i = 0; i < length; i++) {
        int space = is_space(text[i]);
        count += !space && !inside;
        inside = !space;
    }
    return count;
}
