#!/bin/sh
# Make detector weights: footage, training, then release-detector.sh.
#
#     sh tools/train-detector.sh WORK TRAINING_CLIPS TEXTURES
#
# TRAINING_CLIPS is a folder of the training set's clips alone (`egocap-eval motion-sets --link`);
# TEXTURES is a folder of images for floors and walls that no validation uses. Training goes on from the
# shipped weights for MINUTES (60 on two cores). With START= (empty) it begins with random weights;
# MINUTES=600 or more is then needed. All of it goes on after a kill.
set -eu
work=$1 clips=$2 textures=$3 bin=${BIN:-.venv/bin}
start=${START-egocap/detect/shipped/default.safetensors}

"$bin/egocap-sim" generate tools/training-clips.toml --motions "$clips" --out "$work/clips"
for each in arms families; do
    "$bin/egocap-sim" generate "tools/training-$each.toml" --motions "$clips" \
        --textures "$textures" --out "$work/$each"
done
"$bin/egocap" train "$work/clips" "$work/arms" "$work/families" --shares 9 3 4 --store "$work/store" \
    --out "$work/run" --resume ${start:+--start "$start"} --minutes "${MINUTES:-60}" \
    --learning-rate 0.001 --average 0.998 --compile --seed 11 --held-out 0.04
# The mean of the trained weights and those they started from is the better of both on either's footage.
if [ -n "$start" ]; then
    "$bin/python" -m egocap_eval.detection.average "$work/run/detector.safetensors" "$start" \
        "${SHARE:-0.5}" "$work/averaged.safetensors"
fi
