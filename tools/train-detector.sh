#!/bin/sh
# Make detector weights: footage, training, then release-detector.sh.
#
#     sh tools/train-detector.sh WORK TRAINING_CLIPS TEXTURES
#
# TRAINING_CLIPS is a folder of the training set's clips alone, as
# evals/egocap_eval/sets/motion_sets.toml names them; TEXTURES is a folder of images for floors and walls.
# Training goes on from the shipped weights for MINUTES (60 on two cores). With START= (empty) it
# begins with random weights; MINUTES=600 or more is then needed. All of it goes on after a kill.
set -eu
work=$1 clips=$2 textures=$3 bin=${BIN:-.venv/bin}
start=${START-egocap/detect/shipped/default.safetensors}

footage() {
    name=$1
    shift
    "$bin/egocap-sim" generate "$@" --textures "$textures" --out "$work/$name"
}

footage clips tools/training-clips.toml --motions "$clips"
footage families tools/training-families.toml --motions "$clips"
footage varied train-varied --frames 8000 --motions "$clips"
footage all tools/training-all.toml --motions "$clips"
footage poses tools/training-poses.toml --motions "$clips"
footage bikes tools/training-bikes.toml
"$bin/egocap" train "$work/clips" "$work/families" "$work/varied" "$work/all" "$work/poses" \
    "$work/bikes" --shares 9 9 4 2 2 1 --out "$work/run" --resume ${start:+--start "$start"} \
    --minutes "${MINUTES:-60}" --learning-rate 0.001 --average 0.997 --compile --seed 2
# The mean of the trained weights and those they started from is the better of both on either's footage.
if [ -n "$start" ]; then
    "$bin/python" -m egocap_eval.detection.average "$work/run/detector.safetensors" "$start" 0.5 \
        "$work/averaged.safetensors"
fi
