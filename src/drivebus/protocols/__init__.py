"""Protocols: bytes to messages and back, without clock, port or log. No protocol imports another."""
