#!/bin/sh
# Makes the data of the packaged models, each with its composed motions: DATA/demo of everything, and DATA/demo-free without the
# Bandai-Namco motions (CC BY-NC) and Berkeley MHAD (license not confirmed). DATA/all and DATA/all-free are the same without composed motions. About
# 25 minutes on one CPU core.
#   sh configs/demo/data.sh ARCHIVES [DATA]
# ARCHIVES has the folders bandai-namco, accad, berkeley-mhad, cmu-asfamc, cmu-misc, cmu-walks, cmu-bvh, cmu-dance and cc0-glb, and
# splits/bandai-namco with the lists of the Bandai-Namco motions. DATA is `data` by default. Tables and licenses are in configs/data.
set -eu
archives=$1
data=${2:-data}
tables=$(dirname "$0")/../data
import() {  # NAME FOLDER INFO
    t2m data import bvh "$archives/$2" "$data/parts/$1" --captions "$tables/$1.csv" --info "$tables/$3.yaml"
}
mkdir -p "$data/parts"
t2m data import bandai-namco "$archives/bandai-namco" "$data/parts/bandai-namco" --splits "$archives/splits/bandai-namco" --workers 1
import accad accad/accad accad
import berkeley-mhad berkeley-mhad/berkeley-mhad berkeley-mhad
import cmu-asfamc cmu-asfamc/cmu-asfamc cmu
import cmu-misc cmu-misc/cmu-misc cmu-misc
import cmu-walks cmu-walks/cmu-walks cmu
import cmu-bvh cmu-bvh cmu
import cmu-dance cmu-dance cmu
import cc0-glb cc0-glb cc0-glb
free="accad cmu-asfamc cmu-misc cmu-walks cmu-bvh cmu-dance cc0-glb"
(cd "$data/parts" && t2m data merge $free all-free && t2m data merge bandai-namco berkeley-mhad $free all)
t2m data compose "$data/parts/all" "$data/demo" --still --slow --turns 8000 --at-once 2500 --repeated 2500 --timed 1500
t2m data compose "$data/parts/all-free" "$data/demo-free" --still --slow --turns 4000 --at-once 1200 --repeated 1200 --timed 800
mv "$data/parts/all" "$data/parts/all-free" "$data"
rm -r "$data/parts"
