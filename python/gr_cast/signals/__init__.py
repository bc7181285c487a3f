# SPDX-License-Identifier: GPL-3.0-or-later
"""What is sent and recorded: codes, waveforms, SigMF recordings, 802.11a frames."""
