"""Verification: campaigns that try to break the bus on purpose, with reproducible seeds and committed reports."""
