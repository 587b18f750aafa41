#!/bin/sh
# Run the studies behind the paper's section 5, except the detector's, into evals/results.
#
#     sh tools/measure-paper.sh WORK MOTIONS HELDOUT
#
# WORK keeps footage between calls; MOTIONS is a folder with the validation clips; HELDOUT the
# validation frames that `egocap-eval detector --validation` makes. Run it on a machine that does nothing
# else: the runtime study runs first. About an hour and a half on two cores, half of it training.
# After new weights, remove WORK/quick/predictions/learned first: old predictions are refused.
set -eu
work=$1 motions=$2 validation=$3
bin=${BIN:-.venv/bin} results=evals/results

measure() {  # exit code 3: a target was missed; the result lists it
    "$bin/egocap-eval" "$@" || [ $? = 3 ]
}

measure runtime --work "$work/runtime" --out $results/runtime.json
measure ablation --people 3 --seeds 1 --frames 150 --work "$work/ablation" --out $results/ablation.json
measure stress --seeds 4 --out $results/stress.json
measure stress-rendered --people 3 --frames 30 --work "$work/stress" \
    --out $results/stress_rendered.json
measure run quick --motions "$motions" --work "$work/quick" --out $results/quick.json

for n in 1 2 3 4 5 6; do
    "$bin/egocap-sim" generate train-chroma --no-episodes --frames 150 --seed 30080$n \
        --size 640 512 --out "$work/chroma/person-$n"
done
"$bin/egocap-sim" generate train-varied --frames 200 --seed 300820 --out "$work/backgrounds"
for study in augmentation training-set; do
    measure $study "$work/chroma" --held-out "$validation" --backgrounds "$work/backgrounds" \
        --network tiny --steps 400 --store "$work/views" \
        --out $results/$(echo $study | tr - _).json
done
