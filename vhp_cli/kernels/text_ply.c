/* Records of varying length: elements of a PLY file that have list properties. */
#include <stdint.h>
#include <string.h>

#include "vhp.h"

/* How the length of a list is stored, mirrored in reading.py. Text is read into doubles first, so that an ASCII file
   looks like a binary one whose values are all doubles. */
enum { SCALAR, COUNT_U8, COUNT_I8, COUNT_U16, COUNT_I16, COUNT_U32, COUNT_I32, COUNT_DOUBLE };

static const int64_t COUNT_SIZE[] = {0, 1, 1, 2, 2, 4, 4, 8};

/* The list length at `p`, or -1 if it is no length. */
static int64_t read_count(const uint8_t *p, int32_t kind, int big_endian)
{
    if (kind == COUNT_DOUBLE) {
        double value;
        memcpy(&value, p, sizeof value);
        return value >= 0 && value < 4e9 && value == (double)(int64_t)value ? (int64_t)value : -1;
    }
    uint64_t bits = 0;
    int64_t size = COUNT_SIZE[kind];
    for (int64_t i = 0; i < size; i++)
        bits |= (uint64_t)p[big_endian ? size - 1 - i : i] << (8 * i);
    int is_signed = kind == COUNT_I8 || kind == COUNT_I16 || kind == COUNT_I32;
    return is_signed && bits >> (8 * size - 1) ? -1 : (int64_t)bits;
}

/* Walk over n records.

   properties   (n_properties, 2): kind of the list length, or SCALAR; bytes of a value
   target       the list property whose place is wanted
   starts, lengths   (n), out: offset of the first value of that list, and number of values
   stop         out: offset behind the last complete record
   Returns the number of complete records: fewer than n if the data ends or a length is negative. */
VHP_EXPORT int64_t vhp_walk_records(const uint8_t *data, int64_t length, int64_t n, const int32_t *properties,
                                    int32_t n_properties, int32_t target, int32_t big_endian, int64_t *starts,
                                    int64_t *lengths, int64_t *stop)
{
    int64_t offset = 0, record = 0;
    for (; record < n; record++) {
        int64_t place = offset;
        for (int32_t k = 0; k < n_properties; k++) {
            int32_t kind = properties[2 * k];
            int64_t count = 1, size = properties[2 * k + 1];
            if (COUNT_SIZE[kind] > length - place)
                goto done;
            if (kind != SCALAR)
                count = read_count(data + place, kind, big_endian);
            place += COUNT_SIZE[kind];
            if (count < 0 || count > (length - place) / size)
                goto done;
            if (k == target) {
                starts[record] = place;
                lengths[record] = count;
            }
            place += count * size;
        }
        offset = place;
    }
done:
    *stop = offset;
    return record;
}
