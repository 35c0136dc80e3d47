"""Simulated dives: an exact motion, and sensors that err by a known amount.

`trajectories` says how a vehicle turns and tilts, `motion` what perfect sensors would feel on the way, `sensor_errors`
how real ones fall short, and `dive` puts them together. Its sines are its own, the same on every processor.
"""
