// SPDX-License-Identifier: GPL-3.0-or-later
#include "bpsk_correlator_impl.h"
#include <algorithm>
#include <cmath>
#include <gnuradio/io_signature.h>
#include <stdexcept>
#include <volk/volk.h>

namespace gr
{
namespace cast
{

namespace
{

const pmt::pmt_t& rx_time_key()
{
    static const pmt::pmt_t key = pmt::intern("rx_time");
    return key;
}

int64_t floor_mod(int64_t value, int64_t modulus)
{
    return ((value % modulus) + modulus) % modulus;
}

void check_average(unsigned average)
{
    if (average < 1)
        throw std::invalid_argument("bpsk_correlator: average: got 0, needs 1 period or more");
}

void check_sample_rate(double sample_rate_hz)
{
    if (!(sample_rate_hz > 0 && std::isfinite(sample_rate_hz)))
        throw std::invalid_argument("bpsk_correlator: sample_rate_hz: got " +
                                    std::to_string(sample_rate_hz) +
                                    ", needs a finite number of Hz above 0");
}

} // namespace

bpsk_correlator::sptr bpsk_correlator::make(const std::vector<float>& chips,
                                            unsigned samples_per_chip, unsigned average,
                                            double sample_rate_hz)
{
    kernel::code_correlator::validate(chips, samples_per_chip);
    check_average(average);
    check_sample_rate(sample_rate_hz);
    return gnuradio::make_block_sptr<bpsk_correlator_impl>(chips, samples_per_chip, average,
                                                           sample_rate_hz);
}

bpsk_correlator_impl::bpsk_correlator_impl(const std::vector<float>& chips,
                                           unsigned samples_per_chip, unsigned average,
                                           double sample_rate_hz)
    : gr::block("bpsk_correlator", gr::io_signature::make(1, 1, sizeof(gr_complex)),
                gr::io_signature::make3(1, 3, sizeof(gr_complex) * chips.size() * samples_per_chip,
                                        sizeof(float) * chips.size() * samples_per_chip,
                                        sizeof(float) * chips.size() * samples_per_chip)),
      d_average(average), d_next_average(average), d_sample_rate_hz(sample_rate_hz),
      d_correlator(chips, samples_per_chip), d_sum(d_correlator.period())
{
    set_tag_propagation_policy(
        TPP_DONT); // input offsets mean nothing in vectors: tag_run writes its own
}

void bpsk_correlator_impl::set_average(unsigned average)
{
    check_average(average);
    gr::thread::scoped_lock guard(d_setlock);
    d_next_average = average;
}

void bpsk_correlator_impl::set_sample_rate(double sample_rate_hz)
{
    check_sample_rate(sample_rate_hz);
    gr::thread::scoped_lock guard(d_setlock);
    d_sample_rate_hz = sample_rate_hz;
    d_mark.reset(); // samples at the old rate say nothing about the time at the new one
}

// Periods are gathered here, so that codes longer than a scheduler buffer work too.
void bpsk_correlator_impl::forecast(int, gr_vector_int& ninput_items_required)
{
    ninput_items_required[0] = 1;
}

device_time bpsk_correlator_impl::time_of(uint64_t offset) const
{
    const double fraction =
        d_mark->time.fraction + static_cast<double>(offset - d_mark->offset) / d_sample_rate_hz;
    const double whole = std::floor(fraction);
    return {d_mark->time.seconds + static_cast<uint64_t>(whole), fraction - whole};
}

void bpsk_correlator_impl::restart_at(uint64_t offset, device_time time)
{
    if (d_mark) {
        const device_time expected = time_of(offset);
        const double late_s = static_cast<double>(int64_t(time.seconds - expected.seconds)) +
                              (time.fraction - expected.fraction);
        const int64_t lost = std::llround(late_s * d_sample_rate_hz);
        if (lost != 0) {
            const auto length = static_cast<int64_t>(period());
            d_skip = floor_mod(-(static_cast<int64_t>(offset) + d_lost + lost), length);
            d_lost += lost;
            d_lost_now += lost;
            d_position = 0;
            d_periods = 0;
            d_run_starts = true;
            d_logger->warn("{} samples lost before sample {}", lost, offset);
        }
    }
    d_mark = time_mark{offset, time};
}

void bpsk_correlator_impl::tag_run(int made, uint64_t first_item)
{
    const uint64_t vector = nitems_written(0) + made;
    const uint64_t index = static_cast<uint64_t>(static_cast<int64_t>(first_item) + d_lost);
    add_item_tag(0, vector, pmt::intern("sample_index"), pmt::from_uint64(index));
    if (d_mark && first_item >= d_mark->offset) {
        const device_time time = time_of(first_item);
        add_item_tag(
            0, vector, rx_time_key(),
            pmt::make_tuple(pmt::from_uint64(time.seconds), pmt::from_double(time.fraction)));
    }
    if (d_lost_now != 0)
        add_item_tag(0, vector, pmt::intern("lost_samples"), pmt::from_long(d_lost_now));
    d_lost_now = 0;
    d_run_starts = false;
}

// Takes samples without a gap between them, of which the first is input item `first_item`, and
// adds the vectors they complete to the `made` ones, up to `room`. Returns the samples used.
int bpsk_correlator_impl::process(const gr_complex* in, int n_in, uint64_t first_item,
                                  gr_complex* out, int room, int& made)
{
    const size_t length = period();
    int used = 0;
    while (used < n_in && made < room) {
        const size_t left = n_in - used;
        if (d_skip > 0) {
            const size_t now = std::min(d_skip, left);
            d_skip -= now;
            used += now;
            continue;
        }
        const uint64_t item = first_item + used;
        if (d_position == 0 && d_periods == 0)
            d_average = d_next_average;
        if (d_average == 1 && d_position == 0 && left >= length) {
            const size_t now = std::min<size_t>(left / length, room - made);
            if (d_run_starts)
                tag_run(made, item);
            d_correlator.correlate(in + used, out + made * length, now);
            made += now;
            used += now * length;
            continue;
        }
        const size_t now = std::min(left, length - d_position);
        gr_complex* sum = d_sum.data() + d_position;
        if (d_periods == 0)
            std::copy_n(in + used, now, sum);
        else
            volk_32fc_x2_add_32fc(sum, sum, in + used, now);
        d_position += now;
        used += now;
        if (d_position < length)
            continue;
        d_position = 0;
        if (++d_periods < d_average)
            continue;
        d_periods = 0;
        if (d_run_starts)
            tag_run(made, item + now - uint64_t(d_average) * length);
        gr_complex* response = out + made * length;
        d_correlator.correlate(d_sum.data(), response, 1);
        volk_32f_s32f_multiply_32f(reinterpret_cast<float*>(response),
                                   reinterpret_cast<float*>(response), 1.0f / d_average,
                                   2 * length);
        made++;
    }
    return used;
}

int bpsk_correlator_impl::general_work(int noutput_items, gr_vector_int& ninput_items,
                                       gr_vector_const_void_star& input_items,
                                       gr_vector_void_star& output_items)
{
    gr::thread::scoped_lock guard(d_setlock);
    const auto* in = static_cast<const gr_complex*>(input_items[0]);
    auto* out = static_cast<gr_complex*>(output_items[0]);
    const uint64_t begin = nitems_read(0), end = begin + ninput_items[0];
    std::vector<tag_t> tags;
    get_tags_in_range(tags, 0, begin, end, rx_time_key());
    std::sort(tags.begin(), tags.end(), tag_t::offset_compare);

    uint64_t item = begin;
    int made = 0;
    auto tag = tags.begin();
    while (item < end && made < noutput_items) {
        for (; tag != tags.end() && tag->offset == item; ++tag)
            if (const auto time = read_device_time(tag->value))
                restart_at(item, *time);
        const uint64_t stop = tag == tags.end() ? end : tag->offset;
        item += process(in + (item - begin), static_cast<int>(stop - item), item, out,
                        noutput_items, made);
    }
    consume_each(static_cast<int>(item - begin));

    const size_t values = made * period();
    if (output_items.size() > 1)
        volk_32fc_magnitude_32f(static_cast<float*>(output_items[1]), out, values);
    if (output_items.size() > 2) {
        auto* gain_db = static_cast<float*>(output_items[2]);
        volk_32fc_magnitude_squared_32f(gain_db, out, values);
        for (size_t i = 0; i < values; i++)
            gain_db[i] = 10.0f * std::log10(gain_db[i]);
    }
    return made;
}

} // namespace cast
} // namespace gr
