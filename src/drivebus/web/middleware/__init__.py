"""Checks of every request before a route runs."""
