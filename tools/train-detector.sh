#!/bin/sh
# Make detector weights: footage, training, then release-detector.sh.
#
#     sh tools/train-detector.sh WORK TRAINING_CLIPS TEXTURES
#
# TRAINING_CLIPS is a folder of the training set's clips alone (`egocap-eval motion-sets --link`);
# TEXTURES is a folder of images for floors and walls that no validation uses. Every SEED films other
# people, places and motions. Training goes on from the shipped weights in two rounds, 80 minutes on two
# cores; WORK/averaged.safetensors is the result. With START= (empty) it begins with random weights, and
# the first round should have MINUTES=600 or more. All of it goes on after a kill.
set -eu
work=$1 clips=$2 textures=$3 bin=${BIN:-.venv/bin} seed=${SEED:-880000}
start=${START-egocap/detect/shipped/default.safetensors}

for each in families single clips arms bikes; do
    "$bin/egocap-sim" generate "tools/training-$each.toml" --seed "$seed" --motions "$clips" \
        --textures "$textures" --out "$work/$each"
    seed=$((seed + 10000))
done

# train RUN START MINUTES RATE SEED
train() {
    "$bin/egocap" train "$work/clips" "$work/arms" "$work/families" "$work/single" "$work/bikes" \
        --shares 9 3.5 6.5 3 1 --store "$work/store" --out "$work/$1" --resume \
        ${2:+--start "$2"} --minutes "$3" --learning-rate "$4" --average 0.998 --compile \
        --seed "$5" --held-out 0.04
}

# The mean of trained weights and those they come from is the better of both.
mean() {
    "$bin/python" -m egocap_eval.detection.average "$work/$1/detector.safetensors" "$2" \
        "${SHARE:-0.5}" "$3"
}

train first "$start" "${MINUTES:-44}" 0.001 12
first=$work/first/detector.safetensors
if [ -n "$start" ]; then
    first=$work/first.safetensors
    mean first "$start" "$first"
fi
train second "$first" 34 0.0007 19
mean second "${start:-$first}" "$work/averaged.safetensors"
