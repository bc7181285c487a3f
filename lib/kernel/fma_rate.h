// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "isa.h"
#include <gnuradio/cast/api.h>

namespace gr
{
namespace cast
{
namespace kernel
{

// Fused multiply-adds of single floats per second that this core reaches on registers alone: what a
// kernel is measured against.
CAST_API double fma_rate(const std::string& isa_name);

} // namespace kernel
} // namespace cast
} // namespace gr
