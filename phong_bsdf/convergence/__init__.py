"""Error against run time: `plan` what to render, `measuring` it, `study` the passes, `conclusions` from them."""
