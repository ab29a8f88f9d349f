"""Campaigns: one module each, with its ``CAMPAIGN``; no campaign imports another."""
