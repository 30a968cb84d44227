"""A picture in passes: planned, rendered one by one anywhere, kept on disk, folded into their mean. Imports `scene` and
what is above it."""
