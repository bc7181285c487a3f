# SPDX-License-Identifier: GPL-3.0-or-later
"""Traffic as Colosseum's generator makes it: flows in YAML, sent and logged by NRL's MGEN, read back as figures."""
