// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <gnuradio/attributes.h>

#ifdef gnuradio_cast_EXPORTS
#define CAST_API __GR_ATTR_EXPORT
#else
#define CAST_API __GR_ATTR_IMPORT
#endif
