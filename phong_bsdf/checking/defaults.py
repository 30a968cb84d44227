"""What the command needs to know before anything slow is imported: tolerances, verdicts."""

# How far a right picture may be off, in steps of 8 bits beyond rounding, and at which part of the pixels an edge may be
# hit or missed. A ray tracer in float64 needs less than half of either on the course's scenes.
TOLERANCE = 1.0
EDGES = 0.002

# What becomes of a picture.
RIGHT, WRONG, UNREADABLE = "right", "wrong", "unreadable"
