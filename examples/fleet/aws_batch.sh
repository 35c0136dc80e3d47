#!/bin/bash
# The command of a job definition whose image has insdvl-replay and aws. SHARDS and BUCKET are in its environment.
# aws batch submit-job --job-name replay --job-queue QUEUE --job-definition replay --array-properties size=20
# Once all are done: aws s3 sync "$BUCKET/parts" parts && insdvl-replay merge parts -o results
shard=$((AWS_BATCH_JOB_ARRAY_INDEX + 1)) # the index begins at 0
insdvl-replay run dives.toml -c vehicle.toml --shard "$shard/$SHARDS" -o parts ||
  [ $? -eq 3 ] || exit # a dive that cannot be used stops no job: the merge reports it
aws s3 sync parts "$BUCKET/parts"
