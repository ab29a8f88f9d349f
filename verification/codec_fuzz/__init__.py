"""Damaged frames of every codec and their reference results, for the campaigns ``fuzz`` and ``flips``."""
