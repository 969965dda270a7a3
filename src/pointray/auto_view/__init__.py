"""The first picture of a scan without any instructions: which way is up, where the camera stands, what lights it.

sample: some of a scene's points, in the world; fitted: normals of a model for them
upright: which way is up, from all evidence; evidence: that of the shape; stance, planes: what it is computed from
camera_frame: whether a scan is a frame of a depth camera
direction: the view direction; framing: the distance; studio: the lights
first_view: all of these together, as `pointray.frame`

Begin with first_view.
"""

from __future__ import annotations

STUDIO, HEADLIGHT = "studio", "headlight"
LOOKS = {STUDIO: "a studio: key light and sky", HEADLIGHT: "a headlight"}  # all the light of a scan, by one word
