"""Simulated drives, each written from its manual without a look at the dialect."""
