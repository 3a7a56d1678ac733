#!/bin/sh
# Makes a packaged model from the data to the bundle: `demo`; `demo-t2m-gpt`, a T2M-GPT of the same data; or `demo-free`, of motion that is free for commercial use.
# By the sum of its parts, `demo` takes half an hour with a GPU, or 26 hours on two CPU cores (`demo-free`: 10, `demo-t2m-gpt`: 3).
#   sh configs/demo/make.sh ARCHIVES [NAME]
# ARCHIVES is the folder that configs/demo/data.sh reads. NAME is `demo` by default.
# A training that was interrupted goes on with `t2m train rvqvae --run runs/demo-rvqvae --resume` (hifigpt: runs/demo).
# The packaged weights of `demo` began with those before them (docs/ablations.md), so a new run gives others.
set -eu
name=${2:-demo}
case $name in
    demo-t2m-gpt) tokenizer=vqvae generator=gpt data=data/demo ;;
    *) tokenizer=rvqvae generator=hifigpt data=data/$name ;;
esac
sh configs/demo/data.sh "$1"
t2m train $tokenizer "configs/$name/$tokenizer.yaml"
t2m train $generator "configs/$name/$generator.yaml"
rm -rf "t2m_jax/bundles/$name"
t2m teach "runs/$name" configs/data/sentences.yaml "t2m_jax/bundles/$name" --data "$data" --card "configs/$name/card.md"
