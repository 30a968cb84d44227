"""Seconds and memory of `phong-bsdf convert` on a large OBJ model: a hilly square of two triangles for each cell.

    python tests/benchmarks/model.py [TRIANGLES] [--smooth]

With `--smooth` the file has a smoothing group instead of normals.
"""

import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from phong_bsdf.importers import convert_model

MATERIALS = 10


def write(folder: Path, triangles: int, smooth: bool) -> Path:
    """The model, with texture coordinates and its materials."""
    n = round((triangles / 2) ** 0.5) + 1
    x, z = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n))
    positions = np.stack([x, 0.1 * np.sin(9 * x) * np.cos(7 * z), z], axis=-1).reshape(-1, 3)
    normals = np.stack([-0.9 * np.cos(9 * x) * np.cos(7 * z), x * 0 + 1, 0.7 * np.sin(9 * x) * np.sin(7 * z)], axis=-1)
    corner = (np.arange(n * (n - 1)).reshape(n - 1, n)[:, :-1].ravel() + 1)[:, None]
    faces = np.concatenate([corner + np.array([0, n, 1]), corner + np.array([1, n, n + 1])])
    path = folder / "large.obj"
    with open(path, "w") as file:
        file.write("mtllib large.mtl\n")
        np.savetxt(file, positions, "v %.6f %.6f %.6f")
        np.savetxt(file, np.stack([x, z], axis=-1).reshape(-1, 2), "vt %.6f %.6f")
        if smooth:
            file.write("s 1\n")
        else:
            np.savetxt(file, normals.reshape(-1, 3), "vn %.6f %.6f %.6f")
        line = "f %d/%d %d/%d %d/%d" if smooth else "f %d/%d/%d %d/%d/%d %d/%d/%d"
        for i, part in enumerate(np.array_split(faces, MATERIALS)):
            file.write(f"usemtl m{i}\n")
            np.savetxt(file, np.repeat(part, 2 if smooth else 3, axis=1), line)
    materials = (f"newmtl m{i}\nKd 0.{i} 0.5 0.5\nKs 0.3 0.3 0.3\nNs 50\n" for i in range(MATERIALS))
    (folder / "large.mtl").write_text("".join(materials))
    return path


def main() -> None:
    """Convert it once."""
    numbers = [argument for argument in sys.argv[1:] if argument.isdigit()]
    triangles = int(numbers[0]) if numbers else 10**6
    with tempfile.TemporaryDirectory() as name:
        path = write(Path(name), triangles, "--smooth" in sys.argv)
        size = path.stat().st_size
        start = time.perf_counter()
        convert_model(path, path.with_suffix(".xml"))
        seconds = time.perf_counter() - start
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"{triangles} triangles, {size / 1e6:.0f} MB: {seconds:.1f} s, {memory:.2f} GiB at most")


if __name__ == "__main__":
    main()
