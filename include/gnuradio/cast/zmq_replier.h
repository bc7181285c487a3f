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
 * \brief Complex samples for a peer that asks for them over ZeroMQ: srsRAN's rx_port or GNU Radio's
 * ZMQ REQ Source.
 *
 * Binds (REP) and answers each question with the samples that are there, 65,536 at most; the flow
 * waits while nobody asks. A peer may die and return at any moment: samples that could not be sent
 * to it go to the next one that asks.
 */
class CAST_API zmq_replier : virtual public gr::sync_block
{
public:
    typedef std::shared_ptr<zmq_replier> sptr;

    /*!
     * \param address to bind, such as tcp://127.0.0.1:2001; "*" for the host is all of this machine
     *
     * Throws std::runtime_error where the address cannot be, or is taken.
     */
    static sptr make(const std::string& address);
};

} // namespace cast
} // namespace gr
