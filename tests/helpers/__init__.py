"""Helpers of tests: slow references, clouds, files, clusters and browsers."""
