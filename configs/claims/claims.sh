#!/bin/sh
# The trainings and measurements that test the claims of both papers on the NC track of the benchmark, three seeds each, by small models.
#   sh configs/claims/claims.sh            prints the commands
#   sh configs/claims/claims.sh | sh       runs them, one after the other; add `| grep NAME` to choose
# On one CPU core, a tokenizer takes 11 minutes with its evaluation, a GPT about 17, a HiFiGPT about 24, and the best of four samples 12 (measured).
# In all, about 18 hours of one core. Two at once, each on a core of its own (taskset), take half of that. `python docs/measure/claims.py reports` makes the tables.
set -eu
data="--data data/benchmark-nc"
train() {  # NAME KIND CONFIG [OPTIONS]
    name=$1-$seed
    kind=$2
    config=$3
    shift 3
    echo "t2m train $kind claims/$config $data --loop.seed $seed --run runs/claims/$name $*"
}
tokenizer() {  # the same, and its reconstruction
    train "$@"
    echo "t2m evaluate reconstruction --model runs/claims/$1-$seed $data --evaluator benchmark-nc --protocol benchmark --num-repeats 3 --json reports/$1-$seed.json"
}
measure() {  # NAME REPORT [OPTIONS]
    model=$1-$seed
    report=$2-$seed
    shift 2
    echo "t2m benchmark runs/claims/$model --track nc --num-repeats 3 --json reports/$report.json $*"
}
generator() {  # as `train`, and its report
    train "$@"
    measure "$1" "$1"
}
for seed in 0 1 2; do
    # Two tokenizers with as many parameters; rvq-2-512 also keeps as many bits as vq: 9 bits in 4 frames.
    tokenizer vq vqvae vqvae
    for depth in 1 2 4 6 10 12; do
        tokenizer rvq-$depth-256 rvqvae rvqvae --model.num_quantizers $depth
    done
    tokenizer rvq-2-512 rvqvae rvqvae --model.num_quantizers 2 --model.num_codes 512
    for codes in 128 512 1024; do
        tokenizer rvq-10-$codes rvqvae rvqvae --model.num_codes $codes
    done
done
for seed in 0 1 2; do
    # Two generators with as many parameters, motions and updates are gpt-0.5 and hifigpt-rows.
    for tau in 0.0 0.3 0.5 per_motion; do
        generator gpt-$tau gpt gpt --vqvae runs/claims/vq-$seed --tau $tau
    done
    for corruption in rows codes none; do
        generator hifigpt-$corruption hifigpt hifigpt --vqvae runs/claims/rvq-6-256-$seed --corruption $corruption
    done
    for share in 0.25 0.5; do
        generator hifigpt-data-$share hifigpt hifigpt --vqvae runs/claims/rvq-6-256-$seed --data_fraction $share
    done
    # One vector for a caption, as of CLIP, against the states of its tokens.
    generator gpt-vector gpt gpt_vector --vqvae runs/claims/vq-$seed
    generator gpt-states gpt gpt_states --vqvae runs/claims/vq-$seed
    # Guidance and stop rules need no training.
    for scale in 1 4; do
        measure hifigpt-rows hifigpt-guidance-$scale --guidance-scale $scale
    done
    for rule in argmax threshold; do
        measure hifigpt-rows hifigpt-stop-$rule --stop-rule $rule
    done
    # Nor does choosing the best of four samples.
    echo "python docs/measure/candidates.py runs/claims/hifigpt-rows-$seed --track nc --number 4 --num-repeats 3 --json reports/hifigpt-candidates-4-$seed.json"
done
