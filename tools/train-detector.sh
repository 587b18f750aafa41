#!/bin/sh
# Make detector weights: footage, training, then release-detector.sh.
#
#     sh tools/train-detector.sh WORK TRAINING_CLIPS TEXTURES
#
# TRAINING_CLIPS is a folder of the training set's clips alone (`egocap-eval motion-sets --link`);
# TEXTURES is a folder of images for floors and walls that no validation uses. Every SEED films other
# people, places and motions. Training goes on from the shipped weights for MINUTES (75 on two cores).
# With START= (empty) it begins with random weights; MINUTES=600 or more is then needed. All of it goes
# on after a kill.
set -eu
work=$1 clips=$2 textures=$3 bin=${BIN:-.venv/bin} seed=${SEED:-880000}
start=${START-egocap/detect/shipped/default.safetensors}

for each in clips arms families bikes; do
    "$bin/egocap-sim" generate "tools/training-$each.toml" --seed "$seed" --motions "$clips" \
        --textures "$textures" --out "$work/$each"
    seed=$((seed + 10000))
done
"$bin/egocap" train "$work/clips" "$work/arms" "$work/families" "$work/bikes" --shares 11 4 5.5 1 \
    --store "$work/store" --out "$work/run" --resume ${start:+--start "$start"} \
    --minutes "${MINUTES:-75}" --learning-rate 0.001 --average 0.998 --compile --seed 12 --held-out 0.04
# The mean of the trained weights and those they started from is the better of both on recorded clips.
if [ -n "$start" ]; then
    "$bin/python" -m egocap_eval.detection.average "$work/run/detector.safetensors" "$start" \
        "${SHARE:-0.5}" "$work/averaged.safetensors"
fi
