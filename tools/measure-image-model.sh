#!/bin/sh
# Measure the image model: studies, times and figures as reported, footage included.
#
#     sh tools/measure-image-model.sh WORK [TRIALS]
#
# People and places of the footage are unseen in training and validation. Footage that exists in WORK
# is not made again. Run it on an idle machine: times are measured.
set -eu
work=$1 trials=${2:-8}
bin=${BIN:-.venv/bin} results=evals/results
mkdir -p "$work"

generate() { # NAME SCENE OPTION...
    name=$1
    shift
    "$bin/egocap-sim" generate "$@" --size 640 512 --masks --sensor clean --out "$work/$name"
}

generate walk validation-walk --motion walk --seed 400001 --frames 60
generate gesture validation-walk --motion gestures --seed 400002 --frames 60
generate squat validation-walk --motion squat --seed 400003 --frames 60
generate sequence validation-walk --motion sequence --seed 400004 --frames 280
generate reach validation-walk --motion reach_side --seed 400005 --frames 60
generate live1 live --seed 400000 --frames 250
generate live2 live --seed 400010 --frames 250
generate live3 live --seed 400011 --frames 250

"$bin/python" benchmarks/image_model.py "$work/live1" --out $results/image_model_times.json
"$bin/egocap-eval" image-model "$work/walk" "$work/gesture" "$work/squat" "$work/sequence" \
    "$work/reach" --live "$work/live1" "$work/live2" "$work/live3" --trials "$trials" \
    --plot $results/image_model.png --out $results/image_model.json
