# SPDX-License-Identifier: GPL-3.0-or-later
"""The network on a graphics card: arithmetic written once against the array interface, and CUDA kernels that must equal it."""
