"""Is a picture right, and if not, which mistake explains it? By `verdict`, `grading` and `diagnosis`.

Imports `scene` and what is above it.
"""
