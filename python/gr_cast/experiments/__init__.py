# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's experiments: what is on the air, what is measured, and the figures. They need neither GNU Radio nor a radio."""
