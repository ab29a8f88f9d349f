"""Live WebSocket ``/api/v1/live``: snapshots and deltas of the live cache."""
