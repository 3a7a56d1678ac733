#!/bin/sh
# Measures one GPU or TPU in at most 10 minutes. accelerator.md and accelerator.json in FOLDER are for docs/performance.md.
#   sh docs/measure/accelerator.sh [--small] [--parts "train sample parity updates"] [FOLDER]
# FOLDER is runs/accelerator by default. A part that fails or has no time left does not stop the others: the report names what is missing, and the
# exit status is 1. The same command again measures only that. An empty FOLDER starts anew. --small takes 5 minutes of a CPU, and says nothing about speed.
#   train    updates of both stages of both systems at full size: default products of the device (TF32 on NVIDIA), bfloat16, full float32 products
#   sample   sampling of both systems at full size in batches of 1, 32 and 512: default and full float32 products
#   parity   codes of 100 motions of `demo`, on the device and on the CPU
#   updates  1,000 updates of each published recipe on computed motion, with the captions read by `minilm`, because CLIP is a download
# It needs no network. The packages that t2m_jax needs must be installed, t2m_jax itself need not.
set -u
root=$(CDPATH='' cd -- "$(dirname -- "$0")/../.." && pwd)
small='' parts='train sample parity updates' folder=runs/accelerator started=$(date +%s)
while [ $# -gt 0 ]; do
    case $1 in
        --small) small=--small ;;
        --parts) parts=$2; shift ;;
        -*) sed -n '2,11s/^# *//p' "$0"; exit 2 ;;
        *) folder=$1 ;;
    esac
    shift
done
mkdir -p "$folder"
folder=$(CDPATH='' cd -- "$folder" && pwd)
# t2m_jax finds its models and trainings by the entry points of an installation. These are those of this checkout.
installation=$folder/installation/t2m_jax-0.dist-info
mkdir -p "$installation"
sed -n '1,/^version/ { s/^name = /Name: /p; s/^version = /Version: /p; }' "$root/pyproject.toml" | tr -d '"' >"$installation/METADATA"
sed -n '/^\[project.entry-points/,/^$/p' "$root/pyproject.toml" | sed 's/^.*entry-points\./[/' | tr -d '"' >"$installation/entry_points.txt"
export PYTHONPATH="$root:$folder/installation${PYTHONPATH:+:$PYTHONPATH}"
script=$root/docs/measure/accelerator.py

until_second() {  # SECOND COMMAND...: ends the command at this second of all. A training then keeps its updates.
    left=$(($1 - $(date +%s) + started))
    shift
    [ "$left" -gt 0 ] && timeout -k 10 "$left" "$@"
}
measure() {  # SECOND PART
    until_second "$1" python "$script" "$2" "$folder" $small
}
train() {  # KIND RECIPE [OPTIONS]
    kind=$1 run=$folder/runs/$1
    shift
    # shellcheck disable=SC2086
    if [ -e "$run/run.yaml" ]; then
        until_second 580 python -m t2m_jax train "$kind" --run "$run" --resume
    else
        until_second 580 python -m t2m_jax train "$kind" "$@" --data "$folder/data" --run "$run" $loop
    fi
}
updates() {
    [ -d "$folder/data" ] || python -m t2m_jax data synthetic "$folder/data" || return 1
    loop='--loop.validate_every 0 --loop.checkpoint_every 1000000 --loop.num_steps 1000 --loop.log_every 50'
    tokenizer='' gpt='' hifigpt=''
    if [ -n "$small" ]; then
        loop='--loop.validate_every 0 --loop.checkpoint_every 1000000 --loop.num_steps 20 --loop.log_every 5 --loop.batch_size 4'
        tokenizer='--model.width 32 --model.depth 1 --model.code_dim 32 --model.num_codes 64'
        gpt='--model.embed_dim 32 --model.num_layers 1 --model.num_heads 2'
        hifigpt="$gpt --model.num_residual_layers 1"
    fi
    text='--text_encoder sentence --model.text_dim 384'
    # shellcheck disable=SC2086
    {
        train vqvae official --statistics data $tokenizer
        train gpt official --vqvae "$folder/runs/vqvae" $text $gpt
        train rvqvae hifigpt/paper $tokenizer
        train hifigpt hifigpt/paper --vqvae "$folder/runs/rvqvae" $text $hifigpt
    }
}

for part in $parts; do
    case $part in
        train) measure 270 train ;;
        sample) measure 370 sample ;;
        parity)
            measure 430 device
            (export JAX_PLATFORMS=cpu; measure 430 cpu)
            ;;
        updates) updates ;;
        *) echo "unknown part '$part'" >&2; exit 2 ;;
    esac
done
# shellcheck disable=SC2086
python "$script" report "$folder" $small --parts $parts
