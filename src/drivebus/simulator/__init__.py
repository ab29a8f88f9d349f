"""Simulator: motors, a wire, stations written from the manuals, and buses that other masters can use.

Nothing here imports the master's side (bus, ports, profiles, drives), so that one misreading of a manual can't be on
both ends.
"""
