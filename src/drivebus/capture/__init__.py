"""Recorded traffic: the capture format ``dbcap`` and the export format ``pcapng``."""
