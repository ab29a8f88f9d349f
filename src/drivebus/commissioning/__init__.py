"""Bench work on drives and frames: decode a frame, scan a bus, acceptance, a new profile, a capture for Wireshark."""
