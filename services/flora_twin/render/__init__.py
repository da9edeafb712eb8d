"""Photographs of the grow box: camera, scene, plant and sensor, in numpy and OpenCV.

Light is linear until the sensor, 1.0 being the value at which the sensor saturates at its reference exposure.
"""

from flora_twin.render.foliage import Subject
from flora_twin.render.sensor import Exposure
from flora_twin.render.studio import Lighting, Studio

__all__ = ["Exposure", "Lighting", "Studio", "Subject"]
