"""Frames of every codec, damaged and judged: what ``fuzz`` and ``flips`` share."""
