"""Shared by all gateways: the cache of live values, over a ``ServiceClient``. Gateways import no other gateway."""
