#!/bin/sh
# Measure the posterior's calibration: well-specified, then with the learned detector's errors.
#
#     sh tools/calibrate-posterior.sh WORK [WORKERS]
#
# WORK keeps footage and finished frames between calls: twelve short sequences of people and places
# unseen in training and validation, every other one for the temperature. After new weights, only
# the frames are sampled again.
set -eu
work=$1 workers=${2:-2}
bin=${BIN:-.venv/bin} results=evals/results

sequences=
seed=400600
for scene in walk basketball juggler vr live bike; do
    for _ in fitted scored; do
        "$bin/egocap-sim" generate $scene --seed $seed --frames 60 --size 640 512 \
            --workers "$workers" --out "$work/$scene-$seed"
        sequences="$sequences $work/$scene-$seed"
        seed=$((seed + 1))
    done
done

# Exit code 3: a target was missed; the result lists it.
"$bin/egocap-eval" calibration --frames 300 --workers "$workers" --keep "$work/frames.jsonl" \
    --page "$work/calibration.html" --out $results/calibration.json || [ $? = 3 ]
"$bin/egocap-eval" calibration $sequences --only-detector --detections learned --frames 50 \
    --workers "$workers" --keep "$work/detector-frames.jsonl" \
    --page "$work/calibration-detector.html" --out $results/calibration-detector.json
