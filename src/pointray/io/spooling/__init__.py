"""Columns on disk for files larger than memory, with the same values as `gather` produces in memory.

raw : columns as stored in the files; convert : conversion to the types of `Points`; spooled : the cloud on disk

Begin with spool.
"""
