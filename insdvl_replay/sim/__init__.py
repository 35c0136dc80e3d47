"""Simulated dives: an exact motion, and sensors with known errors. Results are the same on every processor."""
