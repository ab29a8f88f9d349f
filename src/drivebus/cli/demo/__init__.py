"""The demo: a virtual plant of four lines, its host, and a story that the user can take over."""
