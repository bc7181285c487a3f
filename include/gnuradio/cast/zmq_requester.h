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
 * \brief Complex samples of a peer that answers questions over ZeroMQ: what srsRAN's tx_port or
 * GNU Radio's ZMQ REP Sink sends.
 *
 * Connects (REQ) and asks one question at a time; the flow waits while nobody answers. A peer may
 * die and return at any moment: all that it answered is passed on in order, and it is asked again.
 */
class CAST_API zmq_requester : virtual public gr::sync_block
{
public:
    typedef std::shared_ptr<zmq_requester> sptr;

    /*!
     * \param address to connect to, such as tcp://localhost:2000
     *
     * Throws std::runtime_error where the address cannot be.
     */
    static sptr make(const std::string& address);
};

} // namespace cast
} // namespace gr
