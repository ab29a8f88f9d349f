"""Commands, a module each with its ``command``; a module imports what it needs when it runs."""
