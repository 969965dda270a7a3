"""The accuracy of the surface, and points on surfaces apart from scattered ones."""
