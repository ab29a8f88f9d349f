"""Scenarios: the real bus with simulated drives in virtual time, user commands, and an oracle that checks both."""
