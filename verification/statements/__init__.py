"""Misbehaving drives and the judge of what the product states about them (campaign ``statements``)."""
