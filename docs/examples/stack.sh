#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# Makes a stack's repository of gr-cast's own 802.11a modem: stack.sh FOLDER (new). Its sites lie beside it, in FOLDER-sites.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
folder=$1
[ ! -e "$folder" ] && [ ! -e "$folder-sites" ] || { echo "$folder or $folder-sites is there already" >&2; exit 2; }
cp -r "$here/stack" "$folder"
mv "$folder/sites" "$folder-sites"
# The modem stands alone: without the package round it, and without SciPy.
sed -e 's/^from \.\.core\.errors import CastError$/CastError = ValueError/' \
    -e 's/^from scipy\.fft import next_fast_len$/next_fast_len = lambda n: 1 << (n - 1).bit_length()/' \
    "$here/../../python/gr_cast/signals/wifi.py" > "$folder/src/modem.py"
printf 'bin/\n' > "$folder/.gitignore"
git -C "$folder" init --quiet --initial-branch main
git -C "$folder" add .
git -C "$folder" -c user.name=stack -c user.email=stack@localhost commit --quiet -m "The modem as a stack"
echo "$folder: a stack with one commit; its sites: $folder-sites"
