// SPDX-License-Identifier: GPL-3.0-or-later
#include "channel_emulator_impl.h"
#include <algorithm>
#include <cmath>
#include <gnuradio/io_signature.h>
#include <stdexcept>
#include <thread>
#include <utility>

namespace gr
{
namespace cast
{

namespace
{

// Where neighbours keep up. Shorter calls end before the scheduler has let all of them run.
constexpr int samples_per_call = 65536;

const pmt::pmt_t taps_key = pmt::intern("taps");
const pmt::pmt_t status_key = pmt::intern("status");
const pmt::pmt_t rx_time_key = pmt::intern("rx_time");

// Of the common timeline, not of one transmitter.
bool is_stream_tag(const pmt::pmt_t& key)
{
    static const pmt::pmt_t rx_rate = pmt::intern("rx_rate"), rx_freq = pmt::intern("rx_freq");
    return pmt::eq(key, rx_time_key) || pmt::eq(key, rx_rate) || pmt::eq(key, rx_freq);
}

void check_sample_rate(double sample_rate_hz)
{
    if (!(sample_rate_hz > 0 && std::isfinite(sample_rate_hz)))
        throw std::invalid_argument("channel_emulator: sample_rate_hz: got " +
                                    std::to_string(sample_rate_hz) +
                                    ", needs a finite number of Hz above 0");
}

// Mean power of each, NaN where there were no samples.
pmt::pmt_t powers(const std::vector<kernel::level>& levels)
{
    std::vector<double> values;
    for (const auto& level : levels)
        values.push_back(level.energy / double(level.n));
    return pmt::init_f64vector(values.size(), values);
}

pmt::pmt_t peaks(const std::vector<kernel::level>& levels)
{
    std::vector<double> values;
    for (const auto& level : levels)
        values.push_back(level.peak);
    return pmt::init_f64vector(values.size(), values);
}

} // namespace

channel_emulator::sptr channel_emulator::make(int n_inputs, int n_outputs, int n_taps,
                                              double sample_rate_hz, int n_threads,
                                              const std::string& name, uint64_t seed)
{
    check_sample_rate(sample_rate_hz);
    kernel::emulator::config config;
    config.n_inputs = n_inputs;
    config.n_outputs = n_outputs;
    config.n_taps = n_taps;
    config.n_threads =
        n_threads == 0 ? std::max(1u, std::thread::hardware_concurrency()) : n_threads;
    config.seed = seed;
    kernel::emulator::check(config);
    return gnuradio::make_block_sptr<channel_emulator_impl>(config, sample_rate_hz, name);
}

channel_emulator_impl::channel_emulator_impl(const kernel::emulator::config& config,
                                             double sample_rate_hz, const std::string& name)
    : gr::sync_block(
          "channel_emulator",
          gr::io_signature::make(config.n_inputs, config.n_inputs, sizeof(gr_complex)),
          gr::io_signature::make(config.n_outputs, config.n_outputs, sizeof(gr_complex))),
      d_sample_rate_hz(sample_rate_hz), d_name(name), d_emulator(config), d_clock{sample_rate_hz}
{
    d_levels = d_reported_levels = no_levels();
    set_history(config.n_taps); // a tap reaches n_taps-1 samples back
    set_output_multiple(samples_per_call);
    set_tag_propagation_policy(TPP_DONT); // all-to-all would multiply every tag: see forward()
    message_port_register_out(status_key);
    message_port_register_in(taps_key);
    set_msg_handler(taps_key, [this](const pmt::pmt_t& message) {
        std::lock_guard<std::mutex> lock(d_mutex);
        take(message);
    });
}

void channel_emulator_impl::set_taps(int tx, int rx, const std::vector<gr_complex>& taps,
                                     std::optional<uint64_t> offset, uint64_t ramp)
{
    if (taps.size() > size_t(d_emulator.configuration().n_taps))
        throw std::invalid_argument("taps: got " + std::to_string(taps.size()) +
                                    ", expected at most " +
                                    std::to_string(d_emulator.configuration().n_taps));
    schedule({tx, rx, offset, kernel::taps_from_dense(taps), std::nullopt, std::nullopt, ramp});
}

void channel_emulator_impl::set_sparse_taps(int tx, int rx, const std::vector<int>& delays,
                                            const std::vector<gr_complex>& gains,
                                            std::optional<uint64_t> offset, uint64_t ramp)
{
    schedule({tx, rx, offset, kernel::taps_from_sparse(delays, gains), std::nullopt, std::nullopt,
              ramp});
}

void channel_emulator_impl::enable_link(int tx, int rx, bool enabled,
                                        std::optional<uint64_t> offset)
{
    schedule({tx, rx, offset, std::nullopt, enabled, std::nullopt, 0});
}

void channel_emulator_impl::set_horizon(std::optional<uint64_t> offset)
{
    {
        std::lock_guard<std::mutex> lock(d_mutex);
        d_horizon = offset.value_or(std::numeric_limits<uint64_t>::max());
    }
    d_horizon_moved.notify_all();
}

void channel_emulator_impl::clear()
{
    std::lock_guard<std::mutex> lock(d_mutex);
    d_emulator.clear();
}

void channel_emulator_impl::set_base_loss(int tx, int rx, double base_loss_db,
                                          std::optional<uint64_t> offset)
{
    schedule({tx, rx, offset, std::nullopt, std::nullopt, kernel::gain_of_loss(base_loss_db), 0});
}

void channel_emulator_impl::set_noise_power(int rx, double power)
{
    std::lock_guard<std::mutex> lock(d_mutex);
    d_emulator.set_noise_power(rx, power);
}

void channel_emulator_impl::set_fixed_point(int bits, int tap_bits, double input_full_scale,
                                            double output_full_scale)
{
    std::lock_guard<std::mutex> lock(d_mutex);
    if (bits == 0)
        d_emulator.set_fixed_point(std::nullopt);
    else
        d_emulator.set_fixed_point(
            kernel::fixed_point{bits, tap_bits, float(input_full_scale), float(output_full_scale)});
}

void channel_emulator_impl::set_sample_rate(double sample_rate_hz)
{
    check_sample_rate(sample_rate_hz);
    std::lock_guard<std::mutex> lock(d_mutex);
    d_clock.change_rate(d_emulator.n_processed(), sample_rate_hz);
    d_sample_rate_hz = sample_rate_hz;
}

void channel_emulator_impl::set_scenario_name(const std::string& name)
{
    std::lock_guard<std::mutex> lock(d_mutex);
    d_name = name;
}

std::string channel_emulator_impl::plan() const
{
    std::lock_guard<std::mutex> lock(d_mutex);
    return d_emulator.plan();
}

pmt::pmt_t channel_emulator_impl::status() const
{
    std::lock_guard<std::mutex> lock(d_mutex);
    return describe();
}

uint64_t channel_emulator_impl::late_updates() const
{
    std::lock_guard<std::mutex> lock(d_mutex);
    return d_emulator.n_late();
}

uint64_t channel_emulator_impl::clipped_samples() const
{
    std::lock_guard<std::mutex> lock(d_mutex);
    return d_emulator.n_clipped();
}

uint64_t channel_emulator_impl::refused_updates() const
{
    std::lock_guard<std::mutex> lock(d_mutex);
    return d_refused;
}

int channel_emulator_impl::active_links() const
{
    std::lock_guard<std::mutex> lock(d_mutex);
    return d_emulator.n_active_links();
}

void channel_emulator_impl::schedule(kernel::link_update update)
{
    std::lock_guard<std::mutex> lock(d_mutex);
    d_emulator.schedule(std::move(update));
}

// An update from a message or a tag, all of it or nothing. Never throws: it runs inside the flow.
void channel_emulator_impl::take(const pmt::pmt_t& message, std::optional<int> tagged_input,
                                 std::optional<uint64_t> tagged_offset)
{
    try {
        const auto updates = read_link_updates(message, d_clock, tagged_input, tagged_offset);
        for (const auto& update : updates)
            d_emulator.check(update);
        for (const auto& update : updates)
            d_emulator.schedule(update, tagged_offset.value_or(0));
    } catch (const std::exception& error) {
        d_refused++;
        d_logger->error("update refused: {}", error.what());
    }
}

void channel_emulator_impl::take_tags(uint64_t begin, uint64_t end)
{
    std::vector<tag_t> tags;
    std::vector<std::pair<uint64_t, pmt::pmt_t>> forwarded; // offset and key of stream tags
    for (int input = 0; input < d_emulator.configuration().n_inputs; input++) {
        get_tags_in_range(tags, input, begin, end);
        std::sort(tags.begin(), tags.end(), tag_t::offset_compare);
        for (const tag_t& tag : tags) {
            if (pmt::eq(tag.key, taps_key)) {
                take(tag.value, input, tag.offset);
                continue;
            }
            if (!is_stream_tag(tag.key)) {
                forward(tag, input);
                continue;
            }
            const auto mark = std::make_pair(tag.offset, tag.key);
            if (std::find(forwarded.begin(), forwarded.end(), mark) != forwarded.end())
                continue;
            forwarded.push_back(mark);
            forward(tag, -1);
            if (pmt::eq(tag.key, rx_time_key) && !d_clock.set(tag.offset, tag.value))
                d_logger->warn("rx_time tag at sample {} is malformed", tag.offset);
        }
    }
}

// To the output of the same node; from input -1, or where there is but one input, to every output.
void channel_emulator_impl::forward(const tag_t& tag, int input)
{
    const auto& config = d_emulator.configuration();
    for (int output = 0; output < config.n_outputs; output++)
        if (input < 0 || config.n_inputs == 1 || input == output)
            add_item_tag(output, tag);
}

pmt::pmt_t channel_emulator_impl::describe() const
{
    pmt::pmt_t status = pmt::make_dict();
    const auto add = [&](const char* key, const pmt::pmt_t& value) {
        status = pmt::dict_add(status, pmt::intern(key), value);
    };
    add("scenario", pmt::intern(d_name));
    add("inputs", pmt::from_long(d_emulator.configuration().n_inputs));
    add("outputs", pmt::from_long(d_emulator.configuration().n_outputs));
    add("active_links", pmt::from_long(d_emulator.n_active_links()));
    add("active_taps", pmt::from_long(d_emulator.n_active_taps()));
    add("plan", pmt::intern(d_emulator.plan()));
    add("samples", pmt::from_uint64(d_samples));
    add("real_time_factor", pmt::from_double(d_real_time_factor));
    add("late_updates", pmt::from_uint64(d_emulator.n_late()));
    add("refused_updates", pmt::from_uint64(d_refused));
    add("clipped_samples", pmt::from_uint64(d_emulator.n_clipped()));
    add("input_power", powers(d_reported_levels.inputs));
    add("input_peak_power", peaks(d_reported_levels.inputs));
    add("output_power", powers(d_reported_levels.outputs));
    add("output_peak_power", peaks(d_reported_levels.outputs));
    return status;
}

kernel::emulator::levels channel_emulator_impl::no_levels() const
{
    const auto& config = d_emulator.configuration();
    return {std::vector<kernel::level>(config.n_inputs),
            std::vector<kernel::level>(config.n_outputs)};
}

void channel_emulator_impl::publish_status(clock::time_point now)
{
    const double seconds = std::chrono::duration<double>(now - d_reported_at).count();
    const uint64_t samples = d_samples - d_reported_samples;
    d_reported_at = now;
    d_reported_samples += samples;
    d_reported_levels = std::exchange(d_levels, no_levels());
    d_real_time_factor = seconds > 0 ? double(samples) / d_sample_rate_hz / seconds : 0;
    message_port_pub(status_key, describe());
}

// A multiple makes the buffers before and behind this block two of it long: a call that waits for
// all inputs and wakes all outputs must be worth it. While samples flow a call takes what is there.
bool channel_emulator_impl::start()
{
    set_output_multiple(1);
    std::lock_guard<std::mutex> lock(d_mutex);
    d_logger->info("scenario '{}': {} transmitters, {} receivers, {} links on, {} taps; {}", d_name,
                   d_emulator.configuration().n_inputs, d_emulator.configuration().n_outputs,
                   d_emulator.n_active_links(), d_emulator.n_active_taps(), d_emulator.plan());
    d_emulator.seek(nitems_written(0)); // not 0 where a running flowgraph was reconfigured
    d_reported_at = clock::now();
    d_samples = d_reported_samples = d_emulator.n_processed();
    publish_status(d_reported_at);
    return true;
}

bool channel_emulator_impl::stop()
{
    set_output_multiple(samples_per_call);
    std::lock_guard<std::mutex> lock(d_mutex);
    publish_status(clock::now());
    d_emulator.seek(0); // a flowgraph that starts again counts from 0
    return true;
}

int channel_emulator_impl::work(int noutput_items, gr_vector_const_void_star& input_items,
                                gr_vector_void_star& output_items)
{
    std::unique_lock<std::mutex> lock(d_mutex);
    const uint64_t begin = nitems_written(0);
    // Not longer than the scheduler may be kept from seeing that the flowgraph stops.
    if (!d_horizon_moved.wait_for(lock, std::chrono::milliseconds(20),
                                  [&] { return begin < d_horizon; }))
        return 0;
    noutput_items = int(std::min<uint64_t>(noutput_items, d_horizon - begin));
    take_tags(begin, begin + noutput_items);
    std::vector<const gr_complex*> in;
    for (const void* items : input_items)
        in.push_back(static_cast<const gr_complex*>(items) + history() - 1);
    std::vector<gr_complex*> out;
    for (void* items : output_items)
        out.push_back(static_cast<gr_complex*>(items));
    d_emulator.process(in.data(), out.data(), noutput_items, &d_levels);
    d_samples = d_emulator.n_processed();
    const auto now = clock::now();
    if (now - d_reported_at >= std::chrono::seconds(1))
        publish_status(now);
    return noutput_items;
}

} // namespace cast
} // namespace gr
