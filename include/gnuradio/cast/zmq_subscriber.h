// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <gnuradio/cast/api.h>
#include <gnuradio/sync_block.h>
#include <string>

namespace gr
{
namespace cast
{

/*!
 * \brief Complex samples of a ZeroMQ publisher: GNU Radio's ZMQ PUB Sink, or srsRAN with
 * tx_type=pub.
 *
 * Connects (SUB); the flow waits while nobody publishes, and what it is too slow for is lost. A
 * publisher may die and return at any moment. A message that is not whole samples is cut, where
 * GNU Radio's own block ends the flow.
 */
class CAST_API zmq_subscriber : virtual public gr::sync_block
{
public:
    typedef std::shared_ptr<zmq_subscriber> sptr;

    /*!
     * \param address to connect to, such as tcp://localhost:2000
     *
     * Throws std::runtime_error where the address cannot be.
     */
    static sptr make(const std::string& address);
};

} // namespace cast
} // namespace gr
