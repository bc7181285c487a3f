// SPDX-License-Identifier: GPL-3.0-or-later
// Included once per instruction set by vector_kernels.cc, which defines `vec` and its operations.
// No include guard on purpose.
//
// Samples stay interleaved: sums of Re(gain)*x and Im(gain)*x are kept apart, and meet once at the
// end, so that a tap costs one load and two fused multiply-adds per vector and no shuffle at all.

// `blocks` vectors of the output at once: the gains of a tap are loaded once for all of them.
template <int blocks>
static inline void mix_vectors(const float* const* in, const path* paths, std::size_t n_paths,
                               float* out, std::size_t at)
{
    vec real_part[blocks], imag_part[blocks];
#pragma GCC unroll 16
    for (int b = 0; b < blocks; b++)
        real_part[b] = imag_part[b] = zero();
    for (std::size_t p = 0; p < n_paths; p++) {
        const float* x = in[paths[p].input] + at - 2 * static_cast<std::ptrdiff_t>(paths[p].delay);
        const vec gain_real = broadcast(paths[p].gain.real());
        const vec gain_imag = broadcast(paths[p].gain.imag());
#pragma GCC unroll 16
        for (int b = 0; b < blocks; b++) {
            const vec v = load(x + b * width);
            real_part[b] = multiply_add(gain_real, v, real_part[b]);
            imag_part[b] = multiply_add(gain_imag, v, imag_part[b]);
        }
    }
#pragma GCC unroll 16
    for (int b = 0; b < blocks; b++)
        store(out + at + b * width, add_turned(real_part[b], imag_part[b]));
}

static void mix(const float* const* in, const path* paths, std::size_t n_paths, float* out,
                std::size_t n_floats)
{
    std::size_t at = 0;
    for (; at + register_blocks * width <= n_floats; at += register_blocks * width)
        mix_vectors<register_blocks>(in, paths, n_paths, out, at);
    for (; at + width <= n_floats; at += width)
        mix_vectors<1>(in, paths, n_paths, out, at);
    for (; at < n_floats; at += 2) {
        float rr = 0, ri = 0, ir = 0, ii = 0;
        for (std::size_t p = 0; p < n_paths; p++) {
            const float* x =
                in[paths[p].input] + at - 2 * static_cast<std::ptrdiff_t>(paths[p].delay);
            const float gain_real = paths[p].gain.real(), gain_imag = paths[p].gain.imag();
            rr = multiply_add(gain_real, x[0], rr);
            ri = multiply_add(gain_real, x[1], ri);
            ir = multiply_add(gain_imag, x[0], ir);
            ii = multiply_add(gain_imag, x[1], ii);
        }
        out[at] = rr - ii;
        out[at + 1] = ri + ir;
    }
}

// One tile of n_blocks blocks of a product, from block `from` on; `spectra` and `stride` in floats.
template <int n_blocks>
static inline void multiply_tile(const float* spectra, std::size_t stride, int n_inputs,
                                 const spectral_product& product, int from, std::size_t tile)
{
    constexpr std::size_t tile_floats = 2 * bins_per_tile;
    const float* blocks[n_blocks];
    for (int b = 0; b < n_blocks; b++)
        blocks[b] = spectra + (product.block + from + b) * n_inputs * stride + tile * tile_floats;
    const auto* taps =
        reinterpret_cast<const float*>(product.taps) + tile * product.n_used * tile_floats;
    for (std::size_t at = 0; at < tile_floats; at += width) {
        vec real_part[n_blocks], imag_part[n_blocks];
#pragma GCC unroll 4
        for (int b = 0; b < n_blocks; b++)
            real_part[b] = imag_part[b] = zero();
        for (int u = 0; u < product.n_used; u++) {
            const vec h = load(taps + u * tile_floats + at);
            const vec h_real = even_twice(h), h_imag = odd_twice(h);
            const std::size_t place = product.inputs[u] * stride + at;
#pragma GCC unroll 4
            for (int b = 0; b < n_blocks; b++) {
                const vec x = load(blocks[b] + place);
                real_part[b] = multiply_add(h_real, x, real_part[b]);
                imag_part[b] = multiply_add(h_imag, x, imag_part[b]);
            }
        }
#pragma GCC unroll 4
        for (int b = 0; b < n_blocks; b++)
            store(reinterpret_cast<float*>(product.results[from + b]) + tile * tile_floats + at,
                  add_turned(real_part[b], imag_part[b]));
    }
}

static void multiply(const float* spectra, std::size_t stride, int n_inputs,
                     const spectral_product* products, std::size_t n_products, std::size_t begin,
                     std::size_t end)
{
    for (std::size_t tile = begin / bins_per_tile; tile < end / bins_per_tile; tile++)
        for (std::size_t p = 0; p < n_products; p++)
            for (int from = 0; from < products[p].n_blocks; from += 4)
                switch (products[p].n_blocks - from) {
                case 1:
                    multiply_tile<1>(spectra, stride, n_inputs, products[p], from, tile);
                    break;
                case 2:
                    multiply_tile<2>(spectra, stride, n_inputs, products[p], from, tile);
                    break;
                case 3:
                    multiply_tile<3>(spectra, stride, n_inputs, products[p], from, tile);
                    break;
                default:
                    multiply_tile<4>(spectra, stride, n_inputs, products[p], from, tile);
                }
}

static double turn(long turns)
{
    constexpr int chains = 12; // enough to hide the latency of each
    vec sums[chains];
    const vec factor = keep(broadcast(0.5f));
    for (vec& sum : sums)
        sum = factor;
    for (long t = 0; t < turns; t++)
#pragma GCC unroll 12
        for (int c = 0; c < chains; c++)
            sums[c] = keep(multiply_add(sums[c], factor, factor));
    volatile float seen; // without a reader the sums would not be made
    for (vec& sum : sums)
        seen = sum[0];
    (void)seen;
    return double(turns) * chains * width;
}
