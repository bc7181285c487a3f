// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <gnuradio/block.h>
#include <gnuradio/cast/api.h>
#include <vector>

namespace gr
{
namespace cast
{

/*!
 * \brief Channel impulse responses from a received periodic BPSK code: h = (r ⊗ s) / sᵀs.
 *
 * Takes complex samples, gives one vector of chips * samples_per_chip complex taps per `average`
 * periods (coherent mean). A second output, where connected, is |h|, a third 20·log10|h| (dB).
 * Circular over one period: a delay longer than the code aliases.
 *
 * Frames keep the phase of the code: a sample lost by the receiver (a later `rx_time` tag than the
 * sample count says) restarts the average at the next period start, on the same delay axis. The
 * first vector, and every first vector after a gap, carries the tags `sample_index` (uint64, of its
 * first sample, lost ones counted), `rx_time` (where the input has one) and, after a gap,
 * `lost_samples` (int64).
 */
class CAST_API bpsk_correlator : virtual public gr::block
{
public:
    typedef std::shared_ptr<bpsk_correlator> sptr;

    /*!
     * \param chips one period of the code, each +1 or -1
     * \param samples_per_chip samples that a chip is held for
     * \param average periods averaged into one vector, 1 or more
     * \param sample_rate_hz turns differences of rx_time into samples
     *
     * Throws std::invalid_argument where a parameter is out of its range.
     */
    static sptr make(const std::vector<float>& chips, unsigned samples_per_chip, unsigned average,
                     double sample_rate_hz);

    //! Periods averaged into a vector, from the next vector on.
    virtual void set_average(unsigned average) = 0;

    //! From now on; times are told again from the next rx_time tag on.
    virtual void set_sample_rate(double sample_rate_hz) = 0;

    //! Samples of one period: the length of an output vector.
    virtual size_t period() const = 0;

    //! Samples that the receiver lost so far, by its rx_time tags.
    virtual int64_t lost_samples() const = 0;
};

} // namespace cast
} // namespace gr
