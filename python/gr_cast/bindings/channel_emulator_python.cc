// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/emulator.h"
#include "kernel/fma_rate.h"
#include <gnuradio/cast/channel_emulator.h>
#include <pybind11/complex.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

namespace py = pybind11;

namespace
{

using gr::cast::kernel::emulator;
using samples = py::array_t<gr::cast::kernel::sample, py::array::c_style | py::array::forcecast>;

// An array in memory that an earlier one no longer holds, where there is some of that size: the
// system takes longer to hand out fresh pages than many a network to fill them. Called, and freed,
// with the interpreter's lock held.
samples array_of(py::ssize_t rows, py::ssize_t columns)
{
    using memory = std::vector<gr::cast::kernel::sample,
                               gr::cast::kernel::cache_aligned<gr::cast::kernel::sample>>;
    constexpr std::size_t most_kept = 2, largest_kept = 1 << 22;
    static auto& kept = *new std::vector<std::unique_ptr<memory>>; // outlives all arrays
    auto made = std::make_unique<memory>();
    if (!kept.empty()) {
        made = std::move(kept.back());
        kept.pop_back();
    }
    made->resize(rows * columns);
    auto* data = made->data();
    const py::capsule owner(made.release(), [](void* done) {
        std::unique_ptr<memory> of(static_cast<memory*>(done));
        if (kept.size() < most_kept && of->capacity() <= largest_kept)
            kept.push_back(std::move(of));
    });
    return samples({rows, columns}, data, owner);
}

// (n_inputs, n_taps - 1 + n) in, the past first; (n_outputs, n) out.
samples process(emulator& e, const samples& inputs)
{
    const auto& config = e.configuration();
    const py::ssize_t past = config.n_taps - 1;
    if (inputs.ndim() != 2 || inputs.shape(0) != config.n_inputs || inputs.shape(1) < past)
        throw std::invalid_argument("inputs: expected shape (" + std::to_string(config.n_inputs) +
                                    ", " + std::to_string(past) + " of the past and the new)");
    const py::ssize_t n = inputs.shape(1) - past;
    samples outputs = array_of(config.n_outputs, n);
    if (n == 0) // no row of nothing has an address
        return outputs;
    std::vector<const gr::cast::kernel::sample*> in;
    std::vector<gr::cast::kernel::sample*> out;
    for (int i = 0; i < config.n_inputs; i++)
        in.push_back(inputs.data(i, 0) + past);
    for (int j = 0; j < config.n_outputs; j++)
        out.push_back(outputs.mutable_data(j, 0));
    py::gil_scoped_release released;
    e.process(in.data(), out.data(), n);
    return outputs;
}

void set_all(emulator& e, uint64_t offset, const py::array_t<int, py::array::c_style>& delays,
             const samples& gains)
{
    const int n_outputs = e.configuration().n_outputs,
              n_links = e.configuration().n_inputs * n_outputs;
    if (delays.ndim() != 2 || delays.shape(0) != n_links || gains.ndim() != 2 ||
        gains.shape(0) != n_links || gains.shape(1) != delays.shape(1))
        throw std::invalid_argument("delays, gains: expected shape (" + std::to_string(n_links) +
                                    " links, taps)");
    e.schedule_all(offset, delays.data(), gains.data(), delays.shape(1));
}

void bind_kernel(py::module& m)
{
    using namespace gr::cast::kernel;
    py::class_<emulator>(m, "emulator_kernel", "The emulator without a scheduler.")
        .def(py::init([](int n_inputs, int n_outputs, int n_taps, int n_threads,
                         const std::string& isa, const std::string& method, uint64_t seed) {
                 return std::make_unique<emulator>(
                     emulator::config{n_inputs, n_outputs, n_taps, n_threads, isa, method, seed});
             }),
             py::arg("n_inputs"), py::arg("n_outputs"), py::arg("n_taps") = 512,
             py::arg("n_threads") = 1, py::arg("isa") = "auto", py::arg("method") = "auto",
             py::arg("seed") = 0)
        .def(
            "set_sparse_taps",
            [](emulator& e, int tx, int rx, const std::vector<int>& delays,
               const std::vector<sample>& gains, std::optional<uint64_t> offset, uint64_t ramp) {
                e.schedule({tx, rx, offset, taps_from_sparse(delays, gains), std::nullopt,
                            std::nullopt, ramp});
            },
            py::arg("tx"), py::arg("rx"), py::arg("delays"), py::arg("gains"),
            py::arg("offset") = py::none(), py::arg("ramp") = 0)
        .def("set_all", &set_all, py::arg("offset"), py::arg("delays"), py::arg("gains"),
             "Taps of every link, link (tx, rx) in row tx * n_outputs + rx, from sample `offset` "
             "on.")
        .def(
            "set_base_loss",
            [](emulator& e, int tx, int rx, double base_loss_db, std::optional<uint64_t> offset) {
                e.schedule(
                    {tx, rx, offset, std::nullopt, std::nullopt, gain_of_loss(base_loss_db), 0});
            },
            py::arg("tx"), py::arg("rx"), py::arg("base_loss_db"), py::arg("offset") = py::none())
        .def(
            "set_fixed_point",
            [](emulator& e, int bits, int tap_bits, float input_full_scale,
               float output_full_scale) {
                e.set_fixed_point(fixed_point{bits, tap_bits, input_full_scale, output_full_scale});
            },
            py::arg("bits"), py::arg("tap_bits"), py::arg("input_full_scale"),
            py::arg("output_full_scale"))
        .def("clipped_samples", &emulator::n_clipped)
        .def("seek", &emulator::seek, py::arg("position"))
        .def("skip_to", &emulator::skip_to, py::arg("position"))
        .def("process", &process, py::arg("inputs"),
             "(n_inputs, n_taps-1 past and n new samples) -> (n_outputs, n), complex64.")
        .def("set_noise_power", &emulator::set_noise_power, py::arg("rx"), py::arg("power"))
        .def("plan", &emulator::plan);
    m.def("fma_rate", &fma_rate, py::arg("isa") = "auto",
          "Multiply-adds of single floats per second that this core reaches.");
}

} // namespace

void bind_channel_emulator(py::module& m)
{
    bind_kernel(m);
    using gr::cast::channel_emulator;
    using release = py::call_guard<py::gil_scoped_release>; // work() may hold the block's lock
    py::class_<channel_emulator, gr::sync_block, gr::block, gr::basic_block,
               std::shared_ptr<channel_emulator>>(
        m, "channel_emulator",
        "A network of time-varying channels, y_j = sum_i x_i * h_ij, sample for sample.")
        .def(py::init(&channel_emulator::make), py::arg("n_inputs"), py::arg("n_outputs"),
             py::arg("n_taps") = 512, py::arg("sample_rate_hz") = 1.0, py::arg("n_threads") = 0,
             py::arg("name") = "", py::arg("seed") = 0)
        .def("set_taps", &channel_emulator::set_taps, py::arg("tx"), py::arg("rx"), py::arg("taps"),
             py::arg("offset") = py::none(), py::arg("ramp") = 0, release(),
             "Taps of a link, one per delay, from sample `offset` on (None: the next).")
        .def("set_sparse_taps", &channel_emulator::set_sparse_taps, py::arg("tx"), py::arg("rx"),
             py::arg("delays"), py::arg("gains"), py::arg("offset") = py::none(),
             py::arg("ramp") = 0, release(), "The same with the non-zero taps alone.")
        .def("enable_link", &channel_emulator::enable_link, py::arg("tx"), py::arg("rx"),
             py::arg("enabled"), py::arg("offset") = py::none(), release(),
             "Switch a link off or on again; it keeps its taps.")
        .def("set_horizon", &channel_emulator::set_horizon, py::arg("offset"), release(),
             "No sample from this one on is made until a later horizon is set; None: no horizon.")
        .def("clear", &channel_emulator::clear, release(),
             "No link has taps from the next sample on, no update is pending.")
        .def("set_base_loss", &channel_emulator::set_base_loss, py::arg("tx"), py::arg("rx"),
             py::arg("base_loss_db"), py::arg("offset") = py::none(), release(),
             "Loss of the link on top of its taps, in dB.")
        .def("set_noise_power", &channel_emulator::set_noise_power, py::arg("rx"), py::arg("power"),
             release(), "Mean power of a receiver's noise, in units of the samples squared.")
        .def("set_fixed_point", &channel_emulator::set_fixed_point, py::arg("bits"),
             py::arg("tap_bits") = 16, py::arg("input_full_scale") = 1.0,
             py::arg("output_full_scale") = 1.0, release(),
             "Compute in fixed point; bits 0: in floating point again.")
        .def("set_sample_rate", &channel_emulator::set_sample_rate, py::arg("sample_rate_hz"),
             release(), "What real time means from now on, and times that updates name.")
        .def("set_scenario_name", &channel_emulator::set_scenario_name, py::arg("name"), release(),
             "What log and status call the scenario.")
        .def("clipped_samples", &channel_emulator::clipped_samples, release(),
             "Samples that a fixed-point full scale cut off.")
        .def("plan", &channel_emulator::plan, release(), "How the network is computed, in words.")
        .def("status", &channel_emulator::status, release(),
             "What the message port `status` says, now.")
        .def("late_updates", &channel_emulator::late_updates, release(),
             "Updates that named a sample already out.")
        .def("refused_updates", &channel_emulator::refused_updates, release(),
             "Malformed messages and tags.")
        .def("active_links", &channel_emulator::active_links, release(),
             "Links that are on and have taps.");
}
