"""The speed of the viewer."""
