// SPDX-License-Identifier: GPL-3.0-or-later
#include "glfsr_source_impl.h"
#include <algorithm>
#include <gnuradio/io_signature.h>
#include <stdexcept>

namespace gr
{
namespace cast
{

glfsr_source::sptr glfsr_source::make(unsigned degree, uint32_t mask, uint32_t seed,
                                      unsigned samples_per_chip)
{
    kernel::glfsr::validate(degree, mask, seed);
    if (samples_per_chip < 1)
        throw std::invalid_argument("glfsr_source: samples_per_chip: got 0, needs 1 or more");
    return gnuradio::make_block_sptr<glfsr_source_impl>(degree, mask, seed, samples_per_chip);
}

glfsr_source_impl::glfsr_source_impl(unsigned degree, uint32_t mask, uint32_t seed,
                                     unsigned samples_per_chip)
    : gr::sync_block("glfsr_source", gr::io_signature::make(0, 0, 0),
                     gr::io_signature::make(1, 1, sizeof(gr_complex))),
      d_mask(mask ? mask : kernel::glfsr::primitive_mask(degree)),
      d_samples_per_chip(samples_per_chip), d_register(d_mask, seed)
{
}

int glfsr_source_impl::work(int noutput_items, gr_vector_const_void_star&,
                            gr_vector_void_star& output_items)
{
    static const pmt::pmt_t key = pmt::intern("code_period");
    auto* out = static_cast<gr_complex*>(output_items[0]);
    int made = 0;
    while (made < noutput_items) {
        if (d_samples_left == 0) {
            if (d_register.at_period_start())
                add_item_tag(0, nitems_written(0) + made, key, pmt::from_uint64(d_period++));
            d_chip = d_register.next_chip();
            d_samples_left = d_samples_per_chip;
        }
        const int now = std::min<int>(d_samples_left, noutput_items - made);
        std::fill_n(out + made, now, gr_complex(d_chip, 0.0f));
        made += now;
        d_samples_left -= now;
    }
    return noutput_items;
}

} // namespace cast
} // namespace gr
