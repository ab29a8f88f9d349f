"""Huanyang HY in the campaigns."""
