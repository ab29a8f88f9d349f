"""One module per command, each with ``command``; a module imports what it needs when it runs."""
