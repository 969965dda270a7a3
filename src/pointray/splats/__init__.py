"""Points -> Splats: how far each point reaches."""

from .radii import check_radii, choose_radii

__all__ = ["check_radii", "choose_radii"]
