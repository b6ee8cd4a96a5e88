"""The overlays of a picture by name; the API reads them, so nothing numerical is imported."""

from typing import Literal

# MuJoCo's flags of these names: joints, points of contact, the centre of mass, bodies one can see through.
Overlay = Literal["joints", "contacts", "centre_of_mass", "transparent"]
