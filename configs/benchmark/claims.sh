#!/bin/sh
# The trainings that test the claims of both papers on the NC track of the benchmark, three seeds each. They were not run yet.
#   sh configs/benchmark/claims.sh            prints the commands
#   sh configs/benchmark/claims.sh | sh       runs them, one after the other; add `| grep NAME` to choose
# Estimated hours on two idle CPU cores, for the three seeds together: tokenizers 2, gpt and hifigpt 4, tau 4, corruption 3, depths and codebooks 12, shares of the
# data 4, text encoders 3, and 23 for the reports of 45 generators at half an hour each. In all, about 55 hours.
# Guidance, stop rules and candidates need no training: they are options of `t2m benchmark` (--guidance-scale, --stop-rule) and `t2m generate` (--candidates).
set -eu
data="--data data/benchmark-nc"
for seed in 0 1 2; do
    train() {  # NAME KIND CONFIG [OPTIONS]
        name=$1-$seed
        kind=$2
        config=$3
        shift 3
        echo "t2m train $kind $config $data --loop.seed $seed --run runs/claims/$name $*"
    }
    tokenizer() {  # the same, and its reconstruction
        train "$@"
        echo "t2m evaluate reconstruction --model runs/claims/$1-$seed $data --evaluator benchmark-nc --protocol benchmark --json reports/$1-$seed.json"
    }
    generator() {  # the same, and its report
        train "$@"
        echo "t2m benchmark runs/claims/$1-$seed --track nc --json reports/$1-$seed.json"
    }
    # Two tokenizers: each with its recipe, and the residual one with 9 bits in 4 frames, as the other: depth 2 of 8 frames and 512 codes.
    tokenizer vq vqvae t2m-gpt/vqvae
    tokenizer rvq rvqvae hifigpt/rvqvae
    tokenizer rvq-equal-bits rvqvae hifigpt/rvqvae --model.num_quantizers 2 --model.num_codes 512
    # Two generators with equal parameters and equal updates.
    generator gpt gpt t2m-gpt/gpt --vqvae runs/claims/vq-$seed
    generator hifigpt hifigpt hifigpt/hifigpt --vqvae runs/claims/rvq-$seed
    for tau in 0.0 0.3 0.5 per_motion; do
        generator tau-$tau gpt ablations/tau --vqvae runs/claims/vq-$seed --tau $tau
    done
    for corruption in rows codes none; do
        generator corruption-$corruption hifigpt ablations/hifigpt --vqvae runs/claims/rvq-$seed --corruption $corruption
    done
    for depth in 1 2 4 6 10 12; do
        for codes in 128 256 512 1024; do
            tokenizer depth-$depth-codes-$codes rvqvae ablations/hifigpt_tokenizer --model.num_quantizers $depth --model.num_codes $codes
        done
    done
    for share in 0.25 0.5 0.75 1.0; do
        generator data-$share hifigpt ablations/hifigpt --vqvae runs/claims/rvq-$seed --data_fraction $share
    done
    # One vector for a caption, as of CLIP, against the states of its tokens.
    generator text-vector gpt text_encoders/sentence --vqvae runs/claims/vq-$seed
    generator text-states gpt text_encoders/sentence_states --vqvae runs/claims/vq-$seed
done
