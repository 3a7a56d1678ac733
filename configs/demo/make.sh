#!/bin/sh
# Makes the packaged model `demo`, from the data to the bundle. By the sum of its parts, half an hour with a GPU, or 26 hours on two CPU cores.
#   sh configs/demo/make.sh ARCHIVES
# ARCHIVES is the folder that configs/demo/data.sh reads.
# A training that was interrupted goes on with `t2m train rvqvae --run runs/demo-rvqvae --resume` (hifigpt: runs/demo).
# The packaged weights began with those before them (docs/ablations.md), so a new run gives others.
set -eu
sh configs/demo/data.sh "$1"
t2m train rvqvae configs/demo/rvqvae.yaml
t2m train hifigpt configs/demo/hifigpt.yaml
rm -rf t2m_jax/bundles/demo
t2m bundle runs/demo t2m_jax/bundles/demo --card configs/demo/card.md
