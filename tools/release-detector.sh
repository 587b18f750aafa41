#!/bin/sh
# From trained weights to the ones that are shipped: calibrate, score, write the model card.
#
#     sh tools/release-detector.sh WEIGHTS.safetensors WORK MOTIONS
#
# WORK keeps footage between calls: WORK/calibration is made here of evals/calibration.toml, 60 people
# that no training and no validation has seen; WORK/heldout is the held-out set. MOTIONS is a folder
# with the validation clips (bvh/007_05.bvh, npz/basketball_signal_3.npz).
set -eu
weights=$1 work=$2 motions=$3
bin=${BIN:-.venv/bin} shipped=egocap/detect/shipped results=evals/results

for rig in egorig1 egorig2 sampled; do
    case $rig in egorig1) seed=400100 ;; egorig2) seed=400200 ;; *) seed=400300 ;; esac
    "$bin/egocap-sim" generate evals/calibration.toml --out "$work/calibration/$rig" \
        --seed $seed --rig $rig
done

mkdir -p $shipped
"$bin/egocap" calibrate-detector "$work/calibration" --weights "$weights" \
    --out $shipped/default.safetensors
# Exit code 3: a target was missed, which the card says too.
"$bin/egocap-eval" detector --heldout "$work/heldout" --motions "$motions" \
    --picture $results/detector.png --out $results/detector.json || [ $? = 3 ]
"$bin/python" -m egocap_eval.detection.model_card $shipped/default.safetensors $results/detector.json \
    $shipped/default.md
