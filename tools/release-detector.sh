#!/bin/sh
# From trained weights to the ones that are shipped: calibrate, score, write the model card.
#
#     sh tools/release-detector.sh WEIGHTS.safetensors WORK MOTIONS
#
# WORK keeps footage between calls: WORK/calibration is made here, of people, places and rigs that no
# training and no validation has seen (seeds 400100 to 400113), WORK/heldout is the held-out set.
# MOTIONS is a folder with the validation clips (bvh/007_05.bvh, npz/basketball_signal_3.npz).
set -eu
weights=$1 work=$2 motions=$3
bin=${BIN:-.venv/bin} shipped=egocap/detect/shipped results=evals/results

for i in $(seq 0 13); do
    folder=$work/calibration/c$i
    case $((i % 5)) in
        3) rig=sampled ;;
        4) rig=egorig2 ;;
        *) rig=egorig1 ;;
    esac
    [ -f "$folder/truth.npz" ] || "$bin/egocap-sim" generate train-varied --out "$folder" \
        --seed $((400100 + i)) --rig $rig --frames 40 --size 640 512 --sensor clean
done

mkdir -p $shipped
"$bin/egocap" calibrate-detector "$work/calibration" --weights "$weights" \
    --out $shipped/default.safetensors
# Exit code 3: a target was missed, which the card says too.
"$bin/egocap-eval" detector --heldout "$work/heldout" --motions "$motions" \
    --picture $results/detector.png --out $results/detector.json || [ $? = 3 ]
"$bin/python" -m evals.model_card $shipped/default.safetensors $results/detector.json \
    $shipped/default.md
