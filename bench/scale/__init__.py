"""Scans larger than memory, and workers of Dask."""
