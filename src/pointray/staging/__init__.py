"""The first picture of a scan without any instructions: which way is up, where the camera stands, what lights it.

sample: some of a scene's points, in the world; upright: which way is up; direction: the view direction; framing: the
distance; first_view: all of these together, as `pointray.frame`; studio: the lights.

Begin with first_view.
"""

from __future__ import annotations

STUDIO, HEADLIGHT = "studio", "headlight"
LOOKS = {STUDIO: "a studio: key light and sky", HEADLIGHT: "a headlight"}  # all the light of a scan, by one word
