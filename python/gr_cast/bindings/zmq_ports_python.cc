// SPDX-License-Identifier: GPL-3.0-or-later
#include <gnuradio/cast/zmq_replier.h>
#include <gnuradio/cast/zmq_requester.h>
#include <gnuradio/cast/zmq_subscriber.h>
#include <pybind11/pybind11.h>

namespace py = pybind11;

namespace
{

template <class block> void bind(py::module& m, const char* name, const char* what)
{
    py::class_<block, gr::sync_block, gr::block, gr::basic_block, std::shared_ptr<block>>(m, name,
                                                                                          what)
        .def(py::init(&block::make), py::arg("address"));
}

} // namespace

void bind_zmq_ports(py::module& m)
{
    bind<gr::cast::zmq_requester>(
        m, "zmq_requester", "Samples of a ZeroMQ peer that answers questions (srsRAN's tx_port).");
    bind<gr::cast::zmq_replier>(m, "zmq_replier",
                                "Samples for a ZeroMQ peer that asks for them (srsRAN's rx_port).");
    bind<gr::cast::zmq_subscriber>(m, "zmq_subscriber", "Samples of a ZeroMQ publisher.");
}
