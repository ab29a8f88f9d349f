"""Live view of ``demo`` and ``monitor``: rows of drives and buses, shown full screen, as text or as JSON."""
