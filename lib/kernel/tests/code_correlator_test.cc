// SPDX-License-Identifier: GPL-3.0-or-later
#include "check.h"
#include "kernel/code_correlator.h"
#include "kernel/glfsr.h"
#include <random>
#include <stdexcept>

using gr::cast::kernel::code_correlator;
using gr::cast::kernel::glfsr;
using complex = std::complex<float>;

static std::vector<float> m_sequence(unsigned degree)
{
    glfsr source(glfsr::primitive_mask(degree), 1);
    std::vector<float> chips((size_t(1) << degree) - 1);
    for (float& chip : chips)
        chip = source.next_chip();
    return chips;
}

static std::vector<float> random_code(size_t length, std::mt19937& random)
{
    std::vector<float> chips(length);
    for (float& chip : chips)
        chip = random() & 1 ? 1.0f : -1.0f;
    return chips;
}

// The definition, in double precision: h[τ] = Σ_k r[k+τ] s[k] / sᵀs, circular over one period.
static void agrees_with_the_definition(const std::vector<float>& chips, unsigned spc, size_t count,
                                       bool fast)
{
    std::mt19937 random(7);
    std::normal_distribution<float> normal;
    code_correlator correlator(chips, spc);
    CHECK(correlator.is_fast() == fast);
    const size_t period = correlator.period();
    CHECK(period == chips.size() * spc);
    std::vector<complex> in(period * count), out(period * count);
    for (complex& x : in)
        x = complex(normal(random), normal(random));
    correlator.correlate(in.data(), out.data(), count);
    for (size_t p = 0; p < count; p++) {
        for (size_t delay = 0; delay < period; delay++) {
            std::complex<double> sum = 0;
            for (size_t k = 0; k < period; k++)
                sum += std::complex<double>(in[p * period + (k + delay) % period]) *
                       double(chips[k / spc]);
            CHECK(std::abs(sum / double(period) - std::complex<double>(out[p * period + delay])) <
                  1e-6);
        }
    }
}

static bool refused(const std::vector<float>& chips, unsigned spc)
{
    try {
        code_correlator::validate(chips, spc);
    } catch (const std::invalid_argument&) {
        return true;
    }
    return false;
}

int main()
{
    std::mt19937 random(3);
    for (unsigned spc : {1u, 2u, 3u, 5u, 8u, 11u, 17u})
        for (size_t count : {1, 2, 7, 9, 17})
            agrees_with_the_definition(m_sequence(4), spc, count, true);
    agrees_with_the_definition(m_sequence(8), 1, 9, true);
    agrees_with_the_definition(m_sequence(9), 2, 5, true);
    agrees_with_the_definition(random_code(15, random), 3, 3, false);
    agrees_with_the_definition(random_code(128, random), 1, 3, false);
    agrees_with_the_definition(random_code(101, random), 2, 2, false);
    agrees_with_the_definition({1.0f}, 1, 3, false);
    CHECK(refused({}, 1));
    CHECK(refused({1.0f, 0.5f}, 1));
    CHECK(refused({1.0f, -1.0f}, 0));
}
