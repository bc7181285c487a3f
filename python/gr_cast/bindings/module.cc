// SPDX-License-Identifier: GPL-3.0-or-later
#include "numpy_layout.h"

namespace py = pybind11;

void bind_glfsr_source(py::module& m);
void bind_bpsk_correlator(py::module& m);
void bind_channel_emulator(py::module& m);
void bind_zmq_ports(py::module& m);

PYBIND11_MODULE(cast_python, m)
{
    expect_known_numpy();
    py::module::import("gnuradio.gr"); // registers the base classes that the blocks derive from
    bind_glfsr_source(m);
    bind_bpsk_correlator(m);
    bind_channel_emulator(m);
    bind_zmq_ports(m);
}
