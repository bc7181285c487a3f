// SPDX-License-Identifier: GPL-3.0-or-later
#include <gnuradio/cast/glfsr_source.h>
#include <pybind11/pybind11.h>

namespace py = pybind11;

void bind_glfsr_source(py::module& m)
{
    using gr::cast::glfsr_source;
    py::class_<glfsr_source, gr::sync_block, gr::block, gr::basic_block,
               std::shared_ptr<glfsr_source>>(m, "glfsr_source",
                                              "BPSK code of a Galois LFSR; tags code_period.")
        .def(py::init(&glfsr_source::make), py::arg("degree"), py::arg("mask") = 0,
             py::arg("seed") = 1, py::arg("samples_per_chip") = 1)
        .def("mask", &glfsr_source::mask, "The feedback mask in use.");
}
