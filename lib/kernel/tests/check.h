// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdio>
#include <cstdlib>

// A law that must hold: says which one failed and where, and leaves with status 1.
#define CHECK(law)                                                                                 \
    do {                                                                                           \
        if (!(law)) {                                                                              \
            std::fprintf(stderr, "%s:%d: %s\n", __FILE__, __LINE__, #law);                         \
            std::exit(1);                                                                          \
        }                                                                                          \
    } while (0)
