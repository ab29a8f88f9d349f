"""Bench work on drives and frames: ``explain`` a frame, ``scan`` a line. Reads and shows; moves nothing."""
