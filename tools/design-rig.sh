#!/bin/sh
# Run the rig study as reported: bounds of 72 rigs, twelve of them tracked, page and figure.
#
#     sh tools/design-rig.sh WORK [SEQUENCE...]
#
# SEQUENCEs are rendered footage on which the visibility is compared with the renderer's.
set -eu
work=$1
shift
bin=${BIN:-.venv/bin} results=evals/results
mkdir -p "$work"
"$bin/egocap-eval" rig --sweep baseline=0.05:0.60:12 --sweep fov=120:220:6 --tracked 12 \
    ${1:+--check "$@"} --page "$work/rig.html" --figure $results/rig.png --out $results/rig.json
