// SPDX-License-Identifier: GPL-3.0-or-later
// Which instruction set a kernel runs on: chosen at run time, so that one binary serves every
// machine.
#pragma once

#include <string>

namespace gr
{
namespace cast
{
namespace kernel
{

enum class isa { generic, avx2, avx512 };

// The widest instruction set that this processor has.
isa best_isa();

// "auto" (the widest), "generic", "avx2" or "avx512".
// Throws std::invalid_argument on another name or a set that this processor lacks.
isa isa_from_name(const std::string& name);

const char* isa_name(isa set);

} // namespace kernel
} // namespace cast
} // namespace gr
