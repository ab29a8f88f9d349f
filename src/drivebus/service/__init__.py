"""Many buses in one service: configuration, readings, interlocks, alarms, history, rights and a record of it all."""
