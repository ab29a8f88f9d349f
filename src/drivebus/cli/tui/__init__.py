"""The live view that ``demo`` and ``monitor`` share: rows and lines as values, shown full screen, plain or as JSON."""
