#!/bin/sh
# The image model's studies, times and pictures as they are reported, footage included.
#
#     sh tools/measure-image-model.sh WORK [TRIALS]
#
# People and places of the footage are none that anything is trained or validated on. What is there
# already in WORK is not made again. Run it on a machine that does nothing else: times are measured.
set -eu
work=$1 trials=${2:-8}
bin=${BIN:-.venv/bin} results=evals/results
mkdir -p "$work"

film() { # NAME SCENE OPTION...
    name=$1
    shift
    "$bin/egocap-sim" generate "$@" --size 640 512 --masks --sensor clean --out "$work/$name"
}

film walk validation-walk --motion walk --seed 400001 --frames 60
film gesture validation-walk --motion gestures --seed 400002 --frames 60
film squat validation-walk --motion squat --seed 400003 --frames 60
film sequence validation-walk --motion sequence --seed 400004 --frames 280
film reach validation-walk --motion reach_side --seed 400005 --frames 60
film live1 live --seed 400000 --frames 250
film live2 live --seed 400010 --frames 250
film live3 live --seed 400011 --frames 250

"$bin/python" benchmarks/image_model.py "$work/live1" --out $results/image_model_times.json
"$bin/egocap-eval" image-model "$work/walk" "$work/gesture" "$work/squat" "$work/sequence" \
    "$work/reach" --live "$work/live1" "$work/live2" "$work/live3" --trials "$trials" \
    --plot $results/image_model.png --out $results/image_model.json
