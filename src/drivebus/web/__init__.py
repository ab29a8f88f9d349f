"""The web process: page, API and metrics over HTTP. It is a client of the service, which runs on without it."""
