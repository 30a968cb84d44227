"""Is a picture right, and if not, which mistake explains it? By `verdict`, `grading` and `diagnosis`."""
