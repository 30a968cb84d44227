"""What Python code hands to a BSDF, as the variant's own types.

Mitsuba converts arguments for its own BSDFs on the way to C++; a BSDF in Python gets them as they are. Each function
takes what Mitsuba's would take, and raises TypeError for the rest.
"""

import mitsuba as mi


def direction(value):
    """A list, tuple, NumPy array or any vector of three numbers as a direction."""
    return value if isinstance(value, mi.Vector3f) else mi.Vector3f(value)


def random_number(value):
    """A number or an array as one random number."""
    return value if type(value) is mi.Float else mi.Float(value)


def random_point(value):
    """A list, tuple, NumPy array or any vector of two numbers as a point of the unit square."""
    return value if isinstance(value, mi.Point2f) else mi.Point2f(value)


def mask(value):
    """True, False or an array of them."""
    return value if type(value) in (bool, mi.Bool) else mi.Bool(value)
