"""Many dives: `dive_paths` finds them, `jobs` replays them on `workers`, and `noise_tuning` fits their noise."""
