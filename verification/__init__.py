"""The laboratory: campaigns that try to break the bus on purpose, each with a seed that reproduces and a report."""
