// SPDX-License-Identifier: GPL-3.0-or-later
// Included once per instruction set by sparse.cc, which defines `vec` and its operations. No
// include guard on purpose.
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
