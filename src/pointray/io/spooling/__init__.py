"""Columns on disk for files larger than memory, with the same values as `gather` produces in memory.

spool : reading of files to disk; raw : columns with the types of the files
convert : conversion to the types of `Points`; spooled : description of the cloud on disk

Begin with spool.
"""
