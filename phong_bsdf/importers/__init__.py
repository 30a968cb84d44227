"""Old scenes, made into scenes that Mitsuba 3 loads: Mitsuba 0.x files, and OBJ models with their MTL materials.

Imports `pictures` and what is above it.

`convert_scene` and `convert_model` write the new scene and return a `Conversion`: what was
changed, and what could not be carried over, line by line.
"""

from .legacy import convert_scene
from .model import convert_model
from .records import Conversion, ConversionError, Record, story

__all__ = ["Conversion", "ConversionError", "Record", "convert_model", "convert_scene", "story"]
