// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <gnuradio/cast/api.h>
#include <gnuradio/sync_block.h>
#include <optional>
#include <string>
#include <vector>

namespace gr
{
namespace cast
{

/*!
 * \brief A whole network of time-varying radio channels: y_j = Σ_i x_i * h_ij, as Colosseum's
 * MCHEM.
 *
 * Input i is what node i transmits, output j what node j receives, sample for sample: no delay is
 * added, and a single tap of exactly 1 is a copy to the last bit. No link is connected at first.
 *
 * Links change at a named sample. By method, or by a PMT dictionary on the message port `taps` or
 * in a stream tag `taps` (in force from the tag's own sample; `tx` defaults to the tagged input):
 * `tx`, `rx` (integers); `taps` (complex vector, one per delay) or `delays` (integers, samples)
 * with `gains` (complex vector); `enabled` (bool); `base_loss_db` (real); `offset` (sample) or
 * `time` (tuple of whole and fractional seconds, on the clock of the inputs' `rx_time` tags;
 * without any, sample 0 is 0 s); `ramp` (samples over which the taps move in a straight line). A
 * list of dictionaries is taken as one. An update without offset or time holds from the next sample
 * on. One for a sample already out holds from the next sample too, and is counted; a malformed one
 * is logged, counted and changes nothing.
 *
 * Message port `status`: a dictionary at the start and every second (see docs/emulator.md).
 * Tags: `rx_time`, `rx_rate` and `rx_freq` reach every output once; every other tag of input i
 * reaches output i, or every output where there is one input.
 */
class CAST_API channel_emulator : virtual public gr::sync_block
{
public:
    typedef std::shared_ptr<channel_emulator> sptr;

    /*!
     * \param n_inputs transmitters
     * \param n_outputs receivers
     * \param n_taps length of every link's filter: delays are 0 to n_taps-1 samples
     * \param sample_rate_hz turns times into samples, and is what real time means
     * \param n_threads threads that share the work; 0: one per core
     * \param name of the scenario, for the log and the status
     * \param seed of the receivers' noise
     *
     * Throws std::invalid_argument where a parameter is out of its range.
     */
    static sptr make(int n_inputs, int n_outputs, int n_taps = 512, double sample_rate_hz = 1.0,
                     int n_threads = 0, const std::string& name = "", uint64_t seed = 0);

    /*!
     * \brief Replace the taps of the link from input `tx` to output `rx`: taps[d] is the gain at a
     * delay of d samples.
     *
     * \param offset first sample with these taps; absent: the next one
     * \param ramp samples over which the taps move there in a straight line; 0: at once
     *
     * Throws std::invalid_argument on a malformed update.
     */
    virtual void set_taps(int tx, int rx, const std::vector<gr_complex>& taps,
                          std::optional<uint64_t> offset = std::nullopt, uint64_t ramp = 0) = 0;

    //! The same with the non-zero taps alone.
    virtual void set_sparse_taps(int tx, int rx, const std::vector<int>& delays,
                                 const std::vector<gr_complex>& gains,
                                 std::optional<uint64_t> offset = std::nullopt,
                                 uint64_t ramp = 0) = 0;

    //! Switch a link off or on again; it keeps its taps.
    virtual void enable_link(int tx, int rx, bool enabled,
                             std::optional<uint64_t> offset = std::nullopt) = 0;

    //! No sample from this one on is made until a later horizon is set; absent: no horizon. Who
    //! schedules updates piece by piece sets it where the next piece begins, and none comes late.
    virtual void set_horizon(std::optional<uint64_t> offset) = 0;

    //! From the next sample on no link has taps, and no update is pending.
    virtual void clear() = 0;

    //! Loss in dB that the link has on top of its taps; a change of it takes force like a change of
    //! taps.
    virtual void set_base_loss(int tx, int rx, double base_loss_db,
                               std::optional<uint64_t> offset = std::nullopt) = 0;

    //! Mean power of the noise that a receiver adds, in units of the samples squared; 0: none.
    //! Equal seeds give equal noise at equal samples; receivers are independent.
    virtual void set_noise_power(int rx, double power) = 0;

    /*!
     * \brief Compute as a fixed-point machine does: samples rounded to `bits` of their full scale
     * and saturated (counted as clipped), taps to `tap_bits` within -2 … 2. Bits 0: in floating
     * point again.
     */
    virtual void set_fixed_point(int bits, int tap_bits = 16, double input_full_scale = 1.0,
                                 double output_full_scale = 1.0) = 0;

    //! From now on: what real time means, and times that updates name.
    virtual void set_sample_rate(double sample_rate_hz) = 0;

    //! What log and status call the scenario.
    virtual void set_scenario_name(const std::string& name) = 0;

    //! How the network is computed, in words.
    virtual std::string plan() const = 0;

    //! What the message port `status` says, now.
    virtual pmt::pmt_t status() const = 0;

    virtual uint64_t late_updates() const = 0;
    virtual uint64_t refused_updates() const = 0;
    virtual uint64_t clipped_samples() const = 0;
    virtual int active_links() const = 0;
};

} // namespace cast
} // namespace gr
