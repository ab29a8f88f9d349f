"""The cells of the table of faults and protocols: what each must end in (``table.json``), and the case that shows it.

A case judges by the copper, the motors, and what users are told (answers, outcomes, statistics, health); what a frame
means it reads with ``manual`` and ``alphabet``, which know no codec.
"""
