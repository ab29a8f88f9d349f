"""Mitsubishi computer link in the campaigns."""
