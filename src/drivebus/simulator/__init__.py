"""Honest pretend drives: motors, a wire, stations written from the manuals, and benches that other masters can talk to.

Nothing here imports the host's side (bus, ports, profiles, drives): a misreading of a manual can't pass both ends.
"""
