"""Simulated dives: an exact motion, and sensors with known errors. Its sines are the same on every processor."""
