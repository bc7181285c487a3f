#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# Writes *.lock from *.in: every release with its hashes, for every Python from 3.11 on and every platform.
# Usage: bash apps/requirements/lock.sh [--upgrade]; needs uv (PyPI).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"
for wanted in *.in; do
    uv pip compile -q --universal --python-version 3.11 --generate-hashes --no-annotate \
        --custom-compile-command "bash apps/requirements/lock.sh" --output-file "${wanted%.in}.lock" "$@" "$wanted"
done
