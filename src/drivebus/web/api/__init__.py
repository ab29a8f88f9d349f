"""REST under ``/api/v1``: every operation of the plant as a route, generated from one table."""
