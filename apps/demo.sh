#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# Installs what is missing, builds, and sounds the four-tap scenario on the embedded emulator: no radio, no screen.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"

install_missing "${run_packages[@]}"
build "$root/build"
say "sounding the four-tap scenario at 50 MS/s"
"$root/apps/cast_sounder.py" run --scenario four_tap --output "$root/demo-output"
say "look at demo-output/cir.png; the numbers are in demo-output/result.json"
