"""drivebus: control and monitor variable-frequency drives of many makes on RS485, truthfully and safely."""
