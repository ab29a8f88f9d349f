"""Command line: one module per command in ``commands``; a command imports what it needs when it runs."""
