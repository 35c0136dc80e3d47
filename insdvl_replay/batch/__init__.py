"""Many dives: `dive_paths` finds them, `jobs` says what is to be done, `runs` does it on `workers`.

`fitted_noise` fits the noise that nobody has given, and `noise_tuning` that of the control filter.
"""
