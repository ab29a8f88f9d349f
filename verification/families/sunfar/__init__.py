"""Sunfar C320 in the campaigns."""
