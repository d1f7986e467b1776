#!/bin/sh
# page.sh: puts what the live page needs of other projects into the package j2a_bridge: uPlot, as npm has it.
# Git ignores it; archives hold it. Does nothing where that was done before.
set -eu
cd "$(dirname "$0")/.."
sh tools/npm.sh bridge/page
from=bridge/page/node_modules/uplot to=bridge/j2a_bridge/page/uplot
mkdir -p "$to"
for file in dist/uPlot.esm.js dist/uPlot.min.css LICENSE; do
    cmp -s "$from/$file" "$to/${file##*/}" || cp "$from/$file" "$to/"
done
