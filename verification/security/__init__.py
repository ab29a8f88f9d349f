"""Strangers at the doors of the service, and hands in its audit trail."""
