"""Fault matrix: the table of faults and protocols (``table.json``), and one check a cell.

A check uses the bytes on the wire, the motors, and the results, statistics and health that users get. The meaning of
frames comes from ``verification.reference``, which knows no codec.
"""
