// SPDX-License-Identifier: GPL-3.0-or-later
#include "edges.h"
#include <algorithm>
#include <cmath>
#include <vector>

namespace gr
{
namespace cast
{
namespace tracing
{

namespace
{

using complex = std::complex<double>;

constexpr size_t LANES = 4; // numbers that are summed at the same time

// Complex numbers in rows, real parts and imaginary parts apart, zeros behind them.
class planes
{
public:
    planes(size_t rows, size_t count)
        : wide((count + LANES - 1) / LANES * LANES), real(rows * wide), imag(rows * wide)
    {
    }

    void set(size_t row, size_t n, const complex& value)
    {
        real[row * wide + n] = value.real();
        imag[row * wide + n] = value.imag();
    }

    complex at(size_t row, size_t n) const { return {real[row * wide + n], imag[row * wide + n]}; }

    // Sum of one row's conjugate times another's.
    complex shared(size_t row, const planes& others, size_t other) const
    {
        const double *a = &real[row * wide], *b = &imag[row * wide];
        const double *c = &others.real[other * wide], *d = &others.imag[other * wide];
        double re[LANES] = {}, im[LANES] = {};
        for (size_t n = 0; n < wide; n += LANES)
            for (size_t k = 0; k < LANES; k++) {
                re[k] += a[n + k] * c[n + k] + b[n + k] * d[n + k];
                im[k] += a[n + k] * d[n + k] - b[n + k] * c[n + k];
            }
        return {re[0] + re[1] + re[2] + re[3], im[0] + im[1] + im[2] + im[3]};
    }

    // Rows, each times a number, added up.
    void add_up(const std::vector<complex>& by)
    {
        for (size_t row = 0; row < by.size(); row++) {
            const double re = by[row].real(), im = by[row].imag();
            for (size_t n = 0; n < wide; n++) {
                const double a = real[row * wide + n], b = imag[row * wide + n];
                real[row * wide + n] = a * re - b * im;
                imag[row * wide + n] = a * im + b * re;
            }
            for (size_t n = 0; row && n < wide; n++) {
                real[n] += real[row * wide + n];
                imag[n] += imag[row * wide + n];
            }
        }
    }

private:
    size_t wide;
    std::vector<double> real, imag;
};

// Lower factor of a Hermitian matrix (size x size, its lower half) none of whose eigenvalues is
// below `least`, in its place; ln of its determinant.
double factored(std::vector<complex>& matrix, size_t size, double least)
{
    double log_determinant = 0;
    for (size_t j = 0; j < size; j++) {
        double left = matrix[j * size + j].real();
        for (size_t k = 0; k < j; k++)
            left -= std::norm(matrix[j * size + k]);
        const double root = std::sqrt(std::max(left, least));
        matrix[j * size + j] = root;
        log_determinant += 2 * std::log(root);
        for (size_t i = j + 1; i < size; i++) {
            complex sum = matrix[i * size + j];
            for (size_t k = 0; k < j; k++)
                sum -= matrix[i * size + k] * std::conj(matrix[j * size + k]);
            matrix[i * size + j] = sum / root;
        }
    }
    return log_determinant;
}

// What such a factor and its conjugate make a right side of, in its place.
void solve(const std::vector<complex>& factor, size_t size, std::vector<complex>& side)
{
    for (size_t i = 0; i < size; i++) {
        for (size_t k = 0; k < i; k++)
            side[i] -= factor[i * size + k] * side[k];
        side[i] /= factor[i * size + i].real();
    }
    for (size_t i = size; i-- > 0;) {
        for (size_t k = i + 1; k < size; k++)
            side[i] -= std::conj(factor[k * size + i]) * side[k];
        side[i] /= factor[i * size + i].real();
    }
}

} // namespace

double loosen(const complex* field, size_t edges, size_t count, const double* weight,
              complex* model, complex* residual)
{
    planes fields(edges, count), weighed(edges, count), left(1, count);
    for (size_t i = 0; i < edges; i++)
        for (size_t n = 0; n < count; n++) {
            fields.set(i, n, field[i * count + n]);
            weighed.set(i, n, field[i * count + n] * weight[n]);
        }
    for (size_t n = 0; n < count; n++)
        left.set(0, n, residual[n]);
    std::vector<complex> inner(edges * edges), change(edges);
    for (size_t i = 0; i < edges; i++) {
        for (size_t j = 0; j <= i; j++)
            inner[i * edges + j] = weighed.shared(i, fields, j);
        inner[i * edges + i] += 1;
        change[i] = weighed.shared(i, left, 0);
    }
    double price = factored(inner, edges, 1);
    solve(inner, edges, change);
    for (const complex& one : change)
        price += std::norm(one);
    fields.add_up(change);
    for (size_t n = 0; n < count && edges; n++) {
        const complex more = fields.at(0, n);
        model[n] += more;
        residual[n] -= weight[n] > 0 ? more : 0;
    }
    return price;
}

} // namespace tracing
} // namespace cast
} // namespace gr
