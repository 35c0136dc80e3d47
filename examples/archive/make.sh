#!/bin/sh
# Makes the four dives of the example archive anew, and their checksums.
# Usage: sh examples/archive/make.sh [insdvl-replay]
set -eu
program=${1:-insdvl-replay}
folder=$(dirname "$0")/dives
"$program" simulate straight --duration 40 --seed 11 --force --output "$folder/transit.mcap"
"$program" simulate lawnmower --duration 60 --seed 12 --force --output "$folder/survey.mcap"
"$program" simulate figure-eight --duration 40 --seed 13 --outage 10:15 --force --output "$folder/outage.mcap"
"$program" simulate straight --duration 40 --seed 14 --imu tactical --lost-beam 2:10:20 --force --output "$folder/lost_beam.mcap"
cd "$folder"
sha256sum transit.mcap survey.mcap outage.mcap lost_beam.mcap > SHA256SUMS
