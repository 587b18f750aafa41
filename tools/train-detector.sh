#!/bin/sh
# Train weights on from those that are shipped: footage, training, then release-detector.sh.
#
#     sh tools/train-detector.sh WORK TRAINING_CLIPS
#
# TRAINING_CLIPS is a folder of BVH and npz clips without those that validation is made of
# (007_*, walking_4*, basketball_signal_3). More folders of footage may be added to the last
# command, each with its share. Two hours on two cores; all of it goes on after a kill.
set -eu
work=$1 clips=$2 bin=${BIN:-.venv/bin}

"$bin/egocap-sim" generate train-varied --frames 20000 --motions "$clips" --out "$work/varied"
"$bin/egocap-sim" generate tools/training-all.toml --motions "$clips" --out "$work/all"
"$bin/egocap-sim" generate tools/training-poses.toml --motions "$clips" --out "$work/poses"
"$bin/egocap-sim" generate tools/training-bikes.toml --out "$work/bikes"
"$bin/egocap" train "$work/varied" "$work/all" "$work/poses" "$work/bikes" --shares 9 8 4 2 --out "$work/run" \
    --resume --start egocap/detect/shipped/default.safetensors --minutes 60 --learning-rate 0.001 \
    --average 0.997 --compile --seed 2
