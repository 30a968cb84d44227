"""`python -m phong_bsdf` is the command `phong-bsdf`."""

from .cli import main

main(prog_name="phong-bsdf")
