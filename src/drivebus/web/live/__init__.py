"""``/api/v1/live``: what the plant tells, once heard from it and told on to every WebSocket that wants it."""
