"""Automatic view of a scan: up direction, camera and lights for a render without options.

sample: evenly drawn points of a scene in world coordinates; fitted: their normals, from a model's tree
clusters: the points to frame, without distant and duplicate ones
upright: up direction from weighted evidence; evidence: scores from the shape; stability, planes: their inputs
camera_frame: detection of depth camera frames
direction: view direction; framing: camera distance; coverage: share of the image that points cover
studio: lights; fronts: test for visible back faces
splats: files of Gaussian splats, with baked light, as `pointray.write_splats`
contact: contact shadow of a standing object; shadow_under_image: kernel that composites it
first_view: all of these together, as `pointray.frame`. Begin here.
default_scene: scans, points or models in the studio's light, for `render`, `view` and `bake` of anything but a scene
"""

from __future__ import annotations

STUDIO, HEADLIGHT = "studio", "headlight"
LOOKS = {STUDIO: "a studio: key light and sky", HEADLIGHT: "a headlight"}  # lighting presets
