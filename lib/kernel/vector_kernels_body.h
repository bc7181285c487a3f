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
    UNROLL(16)
    for (int b = 0; b < blocks; b++)
        real_part[b] = imag_part[b] = zero();
    for (std::size_t p = 0; p < n_paths; p++) {
        const float* x = in[paths[p].input] + at - 2 * static_cast<std::ptrdiff_t>(paths[p].delay);
        const vec gain_real = broadcast(paths[p].gain.real());
        const vec gain_imag = broadcast(paths[p].gain.imag());
        UNROLL(16)
        for (int b = 0; b < blocks; b++) {
            const vec v = load(x + b * width);
            real_part[b] = multiply_add(gain_real, v, real_part[b]);
            imag_part[b] = multiply_add(gain_imag, v, imag_part[b]);
        }
    }
    UNROLL(16)
    for (int b = 0; b < blocks; b++)
        store(out + at + b * width, add_turned(real_part[b], imag_part[b]));
}

// The last floats of all as so many vectors, at most `blocks`; the first of them may be made again.
template <int blocks>
static inline void mix_last(const float* const* in, const path* paths, std::size_t n_paths,
                            float* out, std::size_t n_floats, std::size_t n_vectors)
{
    if (n_vectors == blocks)
        return mix_vectors<blocks>(in, paths, n_paths, out, n_floats - blocks * width);
    if constexpr (blocks > 1)
        mix_last<blocks - 1>(in, paths, n_paths, out, n_floats, n_vectors);
}

static void mix(const float* const* in, const path* paths, std::size_t n_paths, float* out,
                std::size_t n_floats, const float* soon)
{
    constexpr std::size_t line = 16, step = register_blocks * width;
    std::size_t at = 0;
    for (; at + step <= n_floats; at += step) {
        for (std::size_t k = 0; soon && k < step; k += line)
            __builtin_prefetch(soon + at + k, 0, 2);
        mix_vectors<register_blocks>(in, paths, n_paths, out, at);
    }
    const std::size_t n_vectors = (n_floats - at + width - 1) / width;
    if (n_vectors * width <= n_floats)
        return mix_last<register_blocks>(in, paths, n_paths, out, n_floats, n_vectors);
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
        UNROLL(8)
        for (int b = 0; b < n_blocks; b++)
            real_part[b] = imag_part[b] = zero();
        for (int u = 0; u < product.n_used; u++) {
            const vec h = load(taps + u * tile_floats + at);
            const vec h_real = even_twice(h), h_imag = odd_twice(h);
            const std::size_t place = product.inputs[u] * stride + at;
            UNROLL(8)
            for (int b = 0; b < n_blocks; b++) {
                const vec x = load(blocks[b] + place);
                real_part[b] = multiply_add(h_real, x, real_part[b]);
                imag_part[b] = multiply_add(h_imag, x, imag_part[b]);
            }
        }
        UNROLL(8)
        for (int b = 0; b < n_blocks; b++)
            store(reinterpret_cast<float*>(product.results) + (from + b) * stride +
                      tile * tile_floats + at,
                  add_turned(real_part[b], imag_part[b]));
    }
}

// As many blocks as are left and fit into the registers, at most n_blocks; returns how many.
template <int n_blocks>
static inline int multiply_blocks(const float* spectra, std::size_t stride, int n_inputs,
                                  const spectral_product& product, int from, std::size_t tile)
{
    if constexpr (n_blocks > 1)
        if (product.n_blocks - from < n_blocks)
            return multiply_blocks<n_blocks - 1>(spectra, stride, n_inputs, product, from, tile);
    multiply_tile<n_blocks>(spectra, stride, n_inputs, product, from, tile);
    return n_blocks;
}

static void multiply(const float* spectra, std::size_t stride, int n_inputs,
                     const spectral_product* products, std::size_t n_products, std::size_t begin,
                     std::size_t end)
{
    for (std::size_t tile = begin / bins_per_tile; tile < end / bins_per_tile; tile++)
        for (std::size_t p = 0; p < n_products; p++)
            for (int from = 0; from < products[p].n_blocks;)
                from += multiply_blocks<most_blocks>(spectra, stride, n_inputs, products[p], from,
                                                     tile);
}

static double turn(long turns)
{
    constexpr int chains = 12; // enough to hide the latency of each
    vec sums[chains];
    const vec factor = keep(broadcast(0.5f));
    for (vec& sum : sums)
        sum = factor;
    for (long t = 0; t < turns; t++) {
        UNROLL(12)
        for (int c = 0; c < chains; c++)
            sums[c] = keep(multiply_add(sums[c], factor, factor));
    }
    volatile float seen; // without a reader the sums would not be made
    for (vec& sum : sums)
        seen = sum[0];
    (void)seen;
    return double(turns) * chains * width;
}

// ln(x) for 0 < x <= 1, to a few units of the last place; after Cephes' logf.
static inline float natural_log(float x)
{
    uint32_t bits;
    __builtin_memcpy(&bits, &x, sizeof bits);
    const int32_t shifted =
        int32_t(bits - 0x3f3504f3); // of sqrt(1/2): mantissa in [sqrt(1/2), sqrt(2))
    const float exponent = float(shifted >> 23);
    bits = (uint32_t(shifted) & 0x007fffff) + 0x3f3504f3;
    float m;
    __builtin_memcpy(&m, &bits, sizeof m);
    const float f = m - 1.0f;
    const float z = f * f;
    float y = 7.0376836292e-2f;
    y = y * f - 1.1514610310e-1f;
    y = y * f + 1.1676998740e-1f;
    y = y * f - 1.2420140846e-1f;
    y = y * f + 1.4249322787e-1f;
    y = y * f - 1.6668057665e-1f;
    y = y * f + 2.0000714765e-1f;
    y = y * f - 2.4999993993e-1f;
    y = y * f + 3.3333331174e-1f;
    y = y * f * z - 2.12194440e-4f * exponent - 0.5f * z;
    return f + y + 0.693359375f * exponent;
}

// cos and sin of 2*pi*turn/2^32; polynomials after Cephes.
static inline void turn_to_circle(uint32_t turn, float& cosine, float& sine)
{
    const uint32_t quadrant = (turn + 0x20000000u) >> 30;
    const float x = float(int32_t(turn - (quadrant << 30))) * 1.46291807926715969e-9f;
    const float z = x * x;
    const float c =
        1.0f - 0.5f * z +
        z * z * (4.166664568298827e-2f + z * (-1.388731625493765e-3f + z * 2.443315711809948e-5f));
    const float s = x + x * z * (-1.6666654611e-1f + z * (8.3321608736e-3f - z * 1.9515295891e-4f));
    const float a = quadrant & 1 ? s : c, b = quadrant & 1 ? c : s;
    cosine = (quadrant + 1) & 2 ? -a : a;
    sine = quadrant & 2 ? -b : b;
}

// A Gaussian pair of unit power from two uniform integers (Box-Muller).
static inline void gaussian(const uint32_t* radius, const uint32_t* angle, float* re, float* im)
{
    float length[noise_pairs];
    for (int k = 0; k < noise_pairs; k++) {
        // 24 bits are exact in a float; half a step up keeps the logarithm finite.
        const float u = (float(int32_t(radius[k] >> 8)) + 0.5f) * 5.9604644775390625e-8f;
        length[k] = -natural_log(u);
    }
    for (int k = 0; k < noise_pairs; k += width)
        store(length + k, square_root(load(length + k)));
    for (int k = 0; k < noise_pairs; k++) {
        float cosine, sine;
        turn_to_circle(angle[k], cosine, sine);
        re[k] = length[k] * cosine;
        im[k] = length[k] * sine;
    }
}

// Circular Gaussian noise of unit power for 2 * noise_pairs samples, of which `first` is the first
// pair's number, by Philox4x32-10 (Salmon et al., SC11). Whole blocks only, so that a sample's
// noise depends on nothing but its number.
static void noise(uint64_t seed, uint32_t stream, uint64_t first, float* out)
{
    uint32_t c0[noise_pairs], c1[noise_pairs], c2[noise_pairs], c3[noise_pairs];
    for (int k = 0; k < noise_pairs; k++) {
        c0[k] = uint32_t(first) + k; // a block never crosses 2^32: both are powers of two
        c1[k] = uint32_t(first >> 32);
        c2[k] = stream;
        c3[k] = 0;
    }
    uint32_t key0 = uint32_t(seed), key1 = uint32_t(seed >> 32);
    for (int round = 0; round < 10; round++, key0 += 0x9E3779B9u, key1 += 0xBB67AE85u)
        for (int k = 0; k < noise_pairs; k++) {
            const uint64_t a = uint64_t(0xD2511F53u) * c0[k], b = uint64_t(0xCD9E8D57u) * c2[k];
            c0[k] = uint32_t(b >> 32) ^ c1[k] ^ key0;
            c1[k] = uint32_t(b);
            c2[k] = uint32_t(a >> 32) ^ c3[k] ^ key1;
            c3[k] = uint32_t(a);
        }
    float re[2][noise_pairs], im[2][noise_pairs];
    gaussian(c0, c1, re[0], im[0]);
    gaussian(c2, c3, re[1], im[1]);
    for (int k = 0; k < noise_pairs; k++) {
        out[4 * k] = re[0][k];
        out[4 * k + 1] = im[0][k];
        out[4 * k + 2] = re[1][k];
        out[4 * k + 3] = im[1][k];
    }
}

static void add_noise(uint64_t seed, uint32_t stream, uint64_t number, float amplitude, float* out,
                      std::size_t n)
{
    constexpr std::size_t block = 2 * noise_pairs;
    float made[2 * block];
    for (std::size_t done = 0; done < n;) {
        const std::size_t from = (number + done) % block;
        noise(seed, stream, (number + done - from) / 2, made);
        const std::size_t now = block - from < n - done ? block - from : n - done;
        for (std::size_t k = 0; k < 2 * now; k++)
            out[2 * done + k] += amplitude * made[2 * from + k];
        done += now;
    }
}

// To the nearest multiple of 1/scale, between -limit and limit multiples; counts samples beyond.
static std::size_t quantize(const float* in, float scale, float limit, float* out, std::size_t n)
{
    std::size_t clipped = 0;
    const float step = 1.0f / scale;
    for (std::size_t k = 0; k < n; k++) {
        const float re = in[2 * k] * scale, im = in[2 * k + 1] * scale;
        const float low = -limit - 1.0f;
        float a = __builtin_rintf(re), b = __builtin_rintf(im);
        clipped += !(a >= low) | (a > limit) | !(b >= low) | (b > limit);
        // No converter gives what is no number.
        a = a != a ? 0.0f : a < low ? low : a > limit ? limit : a;
        b = b != b ? 0.0f : b < low ? low : b > limit ? limit : b;
        out[2 * k] = a * step;
        out[2 * k + 1] = b * step;
    }
    return clipped;
}

// Adds the power of samples to `energy`, and raises `peak` to the largest of them.
static void measure(const float* in, std::size_t n_floats, double& energy, float& peak)
{
    constexpr std::size_t most = 8192; // sums of floats stay short
    for (std::size_t at = 0; at < n_floats;) {
        const std::size_t end = at + most < n_floats ? at + most : n_floats;
        vec sums[2] = {zero(), zero()}, tops[2] = {zero(), zero()};
        for (; at + 2 * width <= end; at += 2 * width) {
            UNROLL(2)
            for (int b = 0; b < 2; b++) {
                const vec v = load(in + at + b * width), squares = v * v;
                const vec power = even_twice(squares) + odd_twice(squares);
                sums[b] += squares;
                tops[b] = power > tops[b] ? power : tops[b];
            }
        }
        for (int b = 0; b < 2; b++)
            for (int lane = 0; lane < width; lane++) {
                energy += sums[b][lane];
                peak = tops[b][lane] > peak ? tops[b][lane] : peak;
            }
        for (; at < end; at += 2) {
            const float power = in[at] * in[at] + in[at + 1] * in[at + 1];
            energy += power;
            peak = power > peak ? power : peak;
        }
    }
}
