/* SPDX-License-Identifier: GPL-3.0-or-later */
/* Soft-decision Viterbi decoder of the rate-1/2 code of generators 133 and 171 (octal), from zero to zero. */
#include <stdint.h>
#include <stdlib.h>

static int parity(unsigned word) { return __builtin_parity(word); }

/* soft: 2 * steps values, positive for 0; bits: steps decided bits. */
int decode(const float *soft, int steps, uint8_t *bits)
{
    float metric[64], next[64];
    uint8_t *from = malloc((size_t)steps * 64);
    if (!from)
        return 1;
    for (int s = 0; s < 64; s++)
        metric[s] = s ? -1e30f : 0.0f;
    for (int t = 0; t < steps; t++) {
        for (int s = 0; s < 64; s++) {
            unsigned bit = s >> 5; /* the newest bit stands on top */
            float best = -2e30f;
            for (unsigned old = 0; old < 2; old++) {
                unsigned before = ((s << 1) & 63) | old, word = bit << 6 | before;
                float gain = metric[before] + (parity(word & 0133) ? -1 : 1) * soft[2 * t] +
                             (parity(word & 0171) ? -1 : 1) * soft[2 * t + 1];
                if (gain > best) {
                    best = gain;
                    from[(size_t)t * 64 + s] = (uint8_t)before;
                }
            }
            next[s] = best;
        }
        for (int s = 0; s < 64; s++)
            metric[s] = next[s];
    }
    unsigned state = 0;
    for (int t = steps - 1; t >= 0; t--) {
        bits[t] = (uint8_t)(state >> 5);
        state = from[(size_t)t * 64 + state];
    }
    free(from);
    return 0;
}
