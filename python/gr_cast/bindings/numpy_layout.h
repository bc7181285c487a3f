// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <pybind11/pybind11.h>
#include <stdexcept>
#include <string>

// pybind11 before 2.12 reads what NumPy 2 says of an array as NumPy 1 would have said it: wrong
// numbers without a word. Thrown while a module begins it is an ImportError.
inline void expect_known_numpy()
{
#if PYBIND11_VERSION_HEX < 0x020C0000
    namespace py = pybind11;
    const auto version = py::module_::import("numpy").attr("__version__").cast<std::string>();
    if (version.compare(0, 2, "1.") != 0)
        throw std::runtime_error("NumPy " + version + ": got this, needs NumPy 1, which is all " +
                                 "that this build's pybind11 knows: use the system's Python");
#endif
}
