"""The API under ``/api/v1``: every operation of the service as a route."""
