// SPDX-License-Identifier: GPL-3.0-or-later
#include <gnuradio/cast/channel_emulator.h>
#include <pybind11/complex.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

namespace py = pybind11;

void bind_channel_emulator(py::module& m)
{
    using gr::cast::channel_emulator;
    using release = py::call_guard<py::gil_scoped_release>; // work() may hold the block's lock
    py::class_<channel_emulator, gr::sync_block, gr::block, gr::basic_block,
               std::shared_ptr<channel_emulator>>(
        m, "channel_emulator",
        "A network of time-varying channels, y_j = sum_i x_i * h_ij, sample for sample.")
        .def(py::init(&channel_emulator::make), py::arg("n_inputs"), py::arg("n_outputs"),
             py::arg("n_taps") = 512, py::arg("sample_rate_hz") = 1.0, py::arg("n_threads") = 0,
             py::arg("name") = "")
        .def("set_taps", &channel_emulator::set_taps, py::arg("tx"), py::arg("rx"), py::arg("taps"),
             py::arg("offset") = py::none(), py::arg("ramp") = 0, release(),
             "Taps of a link, one per delay, from sample `offset` on (None: the next).")
        .def("set_sparse_taps", &channel_emulator::set_sparse_taps, py::arg("tx"), py::arg("rx"),
             py::arg("delays"), py::arg("gains"), py::arg("offset") = py::none(),
             py::arg("ramp") = 0, release(), "The same with the non-zero taps alone.")
        .def("enable_link", &channel_emulator::enable_link, py::arg("tx"), py::arg("rx"),
             py::arg("enabled"), py::arg("offset") = py::none(), release(),
             "Switch a link off or on again; it keeps its taps.")
        .def("plan", &channel_emulator::plan, release(), "How the network is computed, in words.")
        .def("late_updates", &channel_emulator::late_updates, release(),
             "Updates that named a sample already out.")
        .def("refused_updates", &channel_emulator::refused_updates, release(),
             "Malformed messages and tags.")
        .def("active_links", &channel_emulator::active_links, release(),
             "Links that are on and have taps.");
}
