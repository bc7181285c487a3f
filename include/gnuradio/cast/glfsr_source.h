// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <gnuradio/cast/api.h>
#include <gnuradio/sync_block.h>

namespace gr
{
namespace cast
{

/*!
 * \brief BPSK code of a Galois linear feedback shift register: +1 and -1 as complex samples,
 * without end.
 *
 * The chips are those of gr::digital::glfsr_source. A tag `code_period` (uint64, counted from 0)
 * marks the first sample of every period.
 */
class CAST_API glfsr_source : virtual public gr::sync_block
{
public:
    typedef std::shared_ptr<glfsr_source> sptr;

    /*!
     * \param degree 1 to 32; a primitive mask gives a period of 2^degree - 1 chips
     * \param mask feedback mask with bit degree-1 set, or 0 for a primitive default
     * \param seed register at the first chip, not 0
     * \param samples_per_chip samples that a chip is held for
     *
     * Throws std::invalid_argument where a parameter is out of its range.
     */
    static sptr make(unsigned degree, uint32_t mask = 0, uint32_t seed = 1,
                     unsigned samples_per_chip = 1);

    //! The feedback mask in use.
    virtual uint32_t mask() const = 0;
};

} // namespace cast
} // namespace gr
