// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/tests/check.h"
#include "tracing/edges.h"
#include <array>
#include <cmath>
#include <complex>

using namespace gr::cast::tracing;
using complex = std::complex<double>;

// One edge takes the share of what is left that its prior and the noise leave it.
static void one_edge_takes_its_share()
{
    const std::array<complex, 3> field{complex(2), complex(0, 1), complex(5)};
    const std::array<double, 3> weight{1, 4, 0}; // the last is not known
    std::array<complex, 3> model{}, residual{complex(1), complex(0, 2), complex()};
    const double power = 4 + 4, told = 2 + 8; // over noise; what the edge says of what is left
    const double cost = loosen(field.data(), 1, 3, weight.data(), model.data(), residual.data());
    const double more = told / (1 + power);
    for (size_t i = 0; i < 3; i++)
        CHECK(std::abs(model[i] - more * field[i]) < 1e-12);
    CHECK(std::abs(residual[0] - (1 - 2 * more)) < 1e-12);
    CHECK(std::abs(residual[1] - complex(0, 2 - more)) < 1e-12);
    CHECK(residual[2] == complex());
    CHECK(std::abs(cost - (more * more + std::log(1 + power))) < 1e-12);
}

int main() { one_edge_takes_its_share(); }
