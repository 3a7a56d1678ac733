#!/bin/sh
# Makes the packaged model `demo` from the data to the bundle, or `demo-free`, of motion that is free for commercial use. By the sum of its parts, half an hour with a GPU,
# or 26 hours on two CPU cores (`demo-free`: 10).
#   sh configs/demo/make.sh ARCHIVES [NAME]
# ARCHIVES is the folder that configs/demo/data.sh reads. NAME is `demo` by default.
# A training that was interrupted goes on with `t2m train rvqvae --run runs/demo-rvqvae --resume` (hifigpt: runs/demo).
# The packaged weights of `demo` began with those before them (docs/ablations.md), so a new run gives others.
set -eu
name=${2:-demo}
sh configs/demo/data.sh "$1"
t2m train rvqvae "configs/$name/rvqvae.yaml"
t2m train hifigpt "configs/$name/hifigpt.yaml"
rm -rf "t2m_jax/bundles/$name"
t2m teach "runs/$name" configs/data/sentences.yaml "t2m_jax/bundles/$name" --data "data/$name" --card "configs/$name/card.md"
