#!/bin/sh
# Makes the data of the benchmark: DATA/benchmark-free, and with `nc` also DATA/benchmark-nc, which adds the Bandai-Namco motions (CC BY-NC).
# Minutes: about 5 on one CPU core, and 5 more for `nc`.
#   sh configs/benchmark/data.sh ARCHIVES [free|nc] [DATA]
# ARCHIVES has the folders accad, cmu-asfamc, cmu-misc, cmu-walks, cmu-bvh and, for `nc`, bandai-namco; docs/benchmark.md says where they are from.
# The tables beside this file are frozen: they name each clip, its person, its split, the SHA-256 of its file, and its captions.
set -eu
archives=$1
track=${2:-free}
data=${3:-data}
here=$(dirname "$0")
parts="$data/benchmark-parts"
import() {  # NAME FOLDER INFO
    t2m data import bvh "$archives/$2" "$parts/$1" --captions "$here/$1.csv" --info "$here/../data/$3.yaml" --frozen
}
mkdir -p "$parts"
import accad accad/accad accad
import cmu-asfamc cmu-asfamc/cmu-asfamc cmu
import cmu-misc cmu-misc/cmu-misc cmu-misc
import cmu-walks cmu-walks/cmu-walks cmu
import cmu-bvh cmu-bvh cmu
free="accad cmu-asfamc cmu-misc cmu-walks cmu-bvh"
(cd "$parts" && t2m data merge $free ../benchmark-free)
t2m data check "$data/benchmark-free"
if [ "$track" = nc ]; then
    import bandai-namco bandai-namco bandai-namco
    (cd "$parts" && t2m data merge $free bandai-namco ../benchmark-nc)
    t2m data check "$data/benchmark-nc"
fi
rm -r "$parts"
