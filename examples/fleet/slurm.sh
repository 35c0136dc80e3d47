#!/bin/bash
# job=$(sbatch --parsable slurm.sh); sbatch --dependency=afterok:$job --wrap "insdvl-replay merge parts -o results"
#SBATCH --job-name=replay
#SBATCH --array=1-20
#SBATCH --cpus-per-task=4
shards=20 # as many as the array has; `sbatch --array=7 slurm.sh` runs one of them again
insdvl-replay run archive -c vehicle.toml --shard "$SLURM_ARRAY_TASK_ID/$shards" \
  --jobs "${SLURM_CPUS_PER_TASK:-1}" -o parts ||
  [ $? -eq 3 ] # a dive that cannot be used stops no job: the merge reports it
