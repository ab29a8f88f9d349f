"""Bench work on drives and frames: ``explain`` a frame, ``scan`` a line, a capture for Wireshark. Moves nothing."""
