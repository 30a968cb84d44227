"""From nothing to the first picture, stage by stage: python first_picture.py SCENE.xml PICTURE.exr VARIANT [--plain]

With `--plain` only what any script with Mitsuba needs: no plugins, no picture.
"""

import json
import sys
import time
from pathlib import Path


def main(source, target, variant, plain=""):
    """Prints the seconds of each stage as JSON."""
    stages = {}
    start = time.perf_counter()

    def done(stage):
        """What has passed since the last call was `stage`."""
        nonlocal start
        now = time.perf_counter()
        stages[stage] = now - start
        start = now

    if not plain:
        import phong_bsdf  # noqa: F401
    import drjit as dr
    import mitsuba as mi

    done("import")
    mi.set_variant(variant)
    mi.set_log_level(mi.LogLevel.Error)
    done("variant and LLVM")
    scene = mi.load_file(source)
    done("load")
    if not plain:
        dr.set_flag(dr.JitFlag.KernelHistory, True)
        image = mi.render(scene)
        dr.eval(image)
        dr.sync_thread()
        compiling = sum(k.get(name, 0) for k in dr.kernel_history() for name in ("codegen_time", "backend_time")) / 1000
        done("render")
        stages.update(compile=compiling, render=stages["render"] - compiling)
        from phong_bsdf.pictures import images

        images.write(Path(target), image.numpy())
        done("write")
    print(json.dumps(stages))


if __name__ == "__main__":
    main(*sys.argv[1:])
