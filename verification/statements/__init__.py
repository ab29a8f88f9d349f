"""Misbehaving drives, and the checks of what the product states about them (campaign ``statements``)."""
