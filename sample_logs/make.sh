#!/bin/sh
# Makes the sample logs anew, and their checksums. Usage: sh sample_logs/make.sh [insdvl-replay]
set -eu
program=${1:-insdvl-replay}
folder=$(dirname "$0")
"$program" simulate straight --seed 1 --force --output "$folder/straight.mcap"
"$program" simulate figure-eight --seed 1 --force --output "$folder/figure_eight.mcap"
cd "$folder"
sha256sum straight.mcap figure_eight.mcap > SHA256SUMS
