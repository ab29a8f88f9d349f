"""Protocol families with everything that they need in one folder each; ``protocols.family.BUILT_IN`` lists them.

A folder holds codec, descriptions of frames, dialect, simulated drive, profiles and texts of its family.
"""
