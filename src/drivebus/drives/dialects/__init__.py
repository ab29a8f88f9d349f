"""Dialects: operations of a drive to requests of its protocol, and replies to readings."""
