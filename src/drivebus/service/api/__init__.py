"""The service's own interface: its operations, their dispatcher, queries, errors and pages."""
