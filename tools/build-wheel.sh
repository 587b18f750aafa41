#!/bin/sh
# Build the wheel, install it with pinned versions in a new environment, and run the whole path from
# another folder: generate, verify, track, score, export. Prints the sizes; fails above the limits.
#
#     sh tools/build-wheel.sh OUT
set -eu
mkdir -p "$1"
out=$(cd "$1" && pwd) lock=$PWD/requirements.lock
wheel_limit_mb=25 environment_limit_mb=1000
check=$(mktemp -d)
trap 'rm -rf "$check"' EXIT
unset PYTHONPATH
"${PYTHON:-python3}" -m venv "$check/venv"
bin=$check/venv/bin
rm -f "$out"/egocap-*.whl
"$bin/python" -m pip wheel --quiet --no-deps --wheel-dir "$out" .
start=$(date +%s)
"$bin/python" -m pip install --quiet --no-compile --constraint "$lock" "$out"/egocap-*.whl
installed=$(($(date +%s) - start))
environment_mb=$(du -sm "$check/venv" | cut -f1)
cd "$check"
if "$bin/python" -c 'import torch' 2>/dev/null; then
    echo "the light install holds torch" >&2
    exit 1
fi
"$bin/egocap-sim" generate validation-walk --frames 30 --out walk
"$bin/egocap-sim" verify walk
"$bin/egocap" track walk --out walk.track.npz
"$bin/egocap-eval" pose walk --track walk.track.npz
"$bin/egocap" export walk.track.npz --out walk.bvh
"$bin/egocap" export walk.track.npz --format npz --out walk.npz
wheel_mb=$(du -sm "$out"/egocap-*.whl | cut -f1)
echo "wheel $wheel_mb MB (limit $wheel_limit_mb), installed environment $environment_mb MB" \
    "(limit $environment_limit_mb), installed in $installed s"
[ "$wheel_mb" -le $wheel_limit_mb ] && [ "$environment_mb" -le $environment_limit_mb ]
