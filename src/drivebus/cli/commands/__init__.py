"""One module a verb; each has ``command`` and imports what it needs when it runs."""
