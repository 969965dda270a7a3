"""The speed of rays beside Embree, of instances, and what the shape of the tree changes."""
