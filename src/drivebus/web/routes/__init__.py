"""Routes that are no operations of the service: session, users, tokens, files of the page."""
