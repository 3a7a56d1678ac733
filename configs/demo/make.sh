#!/bin/sh
# Makes the packaged model `demo` again, from the data to the bundle. About ten hours on two CPU cores, by the sum of its parts, which were run
# one by one.
#   sh configs/demo/make.sh ARCHIVES
# ARCHIVES is the folder that configs/demo/data.sh reads.
# A training that was interrupted goes on with `t2m train rvqvae --run runs/demo-rvqvae --resume` (hifigpt: the run of its step).
# The packaged weights were trained up to runs/demo-tenth with less data and other captions (docs/ablations.md),
# and up to runs/demo-eleventh with motions of several actions drawn more rarely, so a new run gives others.
set -eu
sh configs/demo/data.sh "$1"
t2m data import bandai-namco "$1/bandai-namco" data/bandai-namco --splits "$1/splits/bandai-namco"
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
t2m train hifigpt configs/demo/hifigpt_last.yaml --init runs/demo-ninth --run runs/demo-tenth --loop.seed 6 --loop.num_steps 1600 --optimizer.learning_rate 3e-4 --optimizer.cosine 200 1600
t2m train hifigpt configs/demo/text.yaml
t2m train hifigpt configs/demo/all_actions.yaml
t2m train hifigpt configs/demo/all_actions.yaml --init runs/demo-eleventh --run runs/demo-twelfth --loop.seed 1 --loop.num_steps 3200 --optimizer.cosine 300 3200
t2m train rvqvae configs/demo/decoder_all.yaml
t2m bundle runs/demo-eleventh runs/demo-decoder-all runs/demo-eleventh-bundle
t2m bundle runs/demo-twelfth runs/demo-decoder-all runs/demo-twelfth-bundle
rm -rf t2m_jax/bundles/demo
python configs/demo/average.py runs/demo-eleventh-bundle runs/demo-twelfth-bundle t2m_jax/bundles/demo configs/demo/card.md
