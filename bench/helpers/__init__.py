"""Exact surfaces and the rays that measure others against them."""
