"""A picture in passes: planned, rendered one by one anywhere, kept on disk, folded into their mean."""
