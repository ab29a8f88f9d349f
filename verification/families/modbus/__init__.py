"""Modbus: VC660 and DF800 in the campaigns."""
