"""Baked light, many lights, and pictures beside Mitsuba 3."""
