#!/bin/sh
# Makes the packaged model `demo` again, from the data to the bundle. About seven hours on two CPU cores.
#   sh configs/demo/make.sh BANDAI FREE
# BANDAI is the folder of the Bandai-Namco-Research-Motiondataset, with the lists of its splits. configs/free/dataset.yaml says what FREE has.
# A training that was interrupted goes on with `t2m train rvqvae --run runs/demo-rvqvae --resume` (hifigpt: runs/demo).
set -eu
t2m data import bandai-namco "$1" data/bandai-namco
t2m data import bandai-namco "$1" data/bandai-namco-composed --composed 3000
t2m data import bvh "$2" data/free --captions configs/free/captions.csv --info configs/free/dataset.yaml
t2m data merge data/bandai-namco-composed data/free data/demo
t2m train rvqvae configs/demo/rvqvae.yaml
t2m train rvqvae configs/demo/decoder.yaml
t2m train hifigpt configs/demo/hifigpt_single.yaml
t2m train hifigpt configs/demo/hifigpt_composed.yaml
t2m train hifigpt configs/demo/hifigpt.yaml
t2m train hifigpt configs/demo/hifigpt_contrastive.yaml
t2m train hifigpt configs/demo/hifigpt_last.yaml
t2m train hifigpt configs/demo/hifigpt_last.yaml --init runs/demo-fifth --run runs/demo-sixth --loop.seed 2 --loop.num_steps 4500 --optimizer.cosine 200 4500
t2m train hifigpt configs/demo/hifigpt_last.yaml --init runs/demo-sixth --run runs/demo-seventh --loop.seed 3 --loop.num_steps 2800 --optimizer.cosine 200 2800
t2m train hifigpt configs/demo/hifigpt_last.yaml --init runs/demo-seventh --run runs/demo-eighth --loop.seed 4 --loop.num_steps 2000 --optimizer.cosine 200 4000
t2m train hifigpt configs/demo/hifigpt_last.yaml --init runs/demo-eighth --run runs/demo-ninth --loop.seed 5 --loop.num_steps 2800 --optimizer.cosine 200 2800
t2m train hifigpt configs/demo/hifigpt_last.yaml --init runs/demo-ninth --run runs/demo --loop.seed 6 --loop.num_steps 1600 --optimizer.learning_rate 3e-4 --optimizer.cosine 200 1600
rm -rf t2m_jax/bundles/demo
t2m bundle runs/demo t2m_jax/bundles/demo --card configs/demo/card.md
