// SPDX-License-Identifier: GPL-3.0-or-later
#include "check.h"
#include "kernel/glfsr.h"
#include <stdexcept>

using gr::cast::kernel::glfsr;

// A primitive polynomial visits every non-zero state once: 2^d - 1 chips, 2^(d-1) of them +1.
static void a_primitive_register_has_full_period_and_one_more_plus_than_minus()
{
    for (unsigned degree = 1; degree <= 20; degree++) {
        glfsr source(glfsr::primitive_mask(degree), 1);
        uint64_t length = 0;
        int64_t balance = 0;
        do {
            balance += source.next_chip() > 0 ? 1 : -1;
            length++;
        } while (!source.at_period_start());
        CHECK(length == (uint64_t(1) << degree) - 1);
        CHECK(balance == 1);
    }
}

static bool refused(unsigned degree, uint32_t mask, uint32_t seed)
{
    try {
        glfsr::validate(degree, mask, seed);
    } catch (const std::invalid_argument&) {
        return true;
    }
    return false;
}

static void a_register_without_a_period_is_refused()
{
    CHECK(refused(0, 0, 1));
    CHECK(refused(33, 0, 1));
    CHECK(refused(8, 0, 0));
    CHECK(refused(8, 0, 256));
    CHECK(refused(8, 0x40, 1));
    CHECK(refused(8, 0x100, 1));
    CHECK(!refused(8, 0x8E, 255));
    CHECK(!refused(32, 0, 0xFFFFFFFFu));
}

int main()
{
    a_primitive_register_has_full_period_and_one_more_plus_than_minus();
    a_register_without_a_period_is_refused();
}
