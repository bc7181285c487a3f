// SPDX-License-Identifier: GPL-3.0-or-later
#include <gnuradio/cast/bpsk_correlator.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

namespace py = pybind11;

void bind_bpsk_correlator(py::module& m)
{
    using gr::cast::bpsk_correlator;
    using release = py::call_guard<py::gil_scoped_release>; // work() may hold the block's lock
    py::class_<bpsk_correlator, gr::block, gr::basic_block, std::shared_ptr<bpsk_correlator>>(
        m, "bpsk_correlator",
        "Channel impulse responses (taps per vector) from a periodic BPSK code.")
        .def(py::init(&bpsk_correlator::make), py::arg("chips"), py::arg("samples_per_chip") = 1,
             py::arg("average") = 1, py::arg("sample_rate_hz") = 1.0)
        .def("set_average", &bpsk_correlator::set_average, py::arg("average"), release(),
             "Periods averaged into a vector, from the next vector on.")
        .def("set_sample_rate", &bpsk_correlator::set_sample_rate, py::arg("sample_rate_hz"),
             release(), "Turns differences of rx_time into samples.")
        .def("period", &bpsk_correlator::period, "Samples of one period: the length of a vector.")
        .def("lost_samples", &bpsk_correlator::lost_samples,
             "Samples lost so far by rx_time tags.");
}
