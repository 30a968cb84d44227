"""The maps of MTL materials -> Mitsuba's textures: options, factors, and images that are not there."""

import contextlib
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath

import numpy as np

from . import bake
from .mtl import Map, Material
from .paths import Files
from .records import ConversionError, Journal
from .values import set_color
from .xmlfile import Node

CHANNELS = {"r": 0, "g": 1, "b": 2}
# ITU-R BT.709
LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)


@dataclass
class Maps:
    """Makes the textures of one model."""

    files: Files
    journal: Journal

    def color(
        self, material: Material, name: str, parameter: str, default, gain, parent: Node, upper: float = np.inf
    ) -> Node:
        """A colour, or its map times the colour, times `gain` (a number, or one for each channel)."""
        value = material.values.get(name, (1.0, 1.0, 1.0) if name in material.maps else default)
        if name in material.maps and max(value) == 0:
            self.journal.change(
                material.place(name),
                f"{name.capitalize()} 0 0 0 of '{material.name}' with a map",
                "the map counts alone",
            )
            value = (1.0, 1.0, 1.0)
        factor = [float(x) for x in np.broadcast_to(np.asarray(value, float) * gain, 3)]
        if name in material.maps:
            made = self._texture(material, name, parameter, factor, parent, raw=False)
            if made is not None:
                return made
            value = material.values.get(name, default)
            factor = [float(x) for x in np.broadcast_to(np.asarray(value, float) * gain, 3)]
        made = parent.like("rgb", name=parameter)
        set_color(made, [min(x, upper) for x in factor])
        return made

    def number(
        self, material: Material, name: str, parameter: str, value: float, parent: Node, upper: float = np.inf
    ) -> Node:
        """A number, or its map times the number."""
        if name in material.maps:
            made = self._texture(material, name, parameter, [value], parent, raw=True)
            if made is not None:
                return made
        return parent.like("float", name=parameter, value=f"{min(value, upper):.7g}")

    def bumps(self, material: Material, name: str, parent: Node) -> Node | None:
        """A bump or normal map as it is in its file; None where there is none."""
        return self._texture(material, name, name, [1.0], parent, raw=True) if name in material.maps else None

    def _texture(self, material: Material, name: str, parameter: str, factor, parent: Node, raw: bool) -> Node | None:
        """A bitmap, None where its file is missing or cannot be read."""
        given = material.maps[name]
        place = (material.library.name, given.line)
        path = self._find(given, material, place)
        if path is None:
            return None
        if not path.is_file():
            self.journal.loss(place, f"texture '{given.file}'", "there is no such file; its constant stands in")
            return None
        try:
            image = bake.read(path)
        except (ConversionError, OSError, RuntimeError, ValueError) as error:
            self.journal.loss(place, f"texture '{given.file}'", f"cannot be read ({error}); its constant stands in")
            return None
        made = parent.like("texture", type="bitmap", name=parameter)
        changed = self._change(image, given, name, factor, raw)
        if changed is None:
            made.add("string", name="filename", value=self.files.relative(path))
        else:
            what = "-".join([name, *(f"{x:.3g}".replace("+", "") for x in dict.fromkeys(factor))])
            new = bake.write(self.files, path, changed, what)
            made.add("string", name="filename", value=self.files.relative(new.resolve()))
            self.journal.change(
                place, f"texture '{given.file}'", f"copied to '{new.name}', its values as the material wants them"
            )
        if raw:
            made.add("boolean", name="raw", value="true")
        self._place(made, given)
        return made

    def _find(self, given: Map, material: Material, place) -> Path | None:
        """The file of a map, None where it may not be read.

        Exporters write the paths of their own machine. The image often lies beside the materials.
        """
        folder = material.library.parent
        try:
            return self.files.find(given.file, folder, place)
        except ConversionError as error:
            with contextlib.suppress(ConversionError):
                beside = self.files.find(PureWindowsPath(given.file).name, folder, place)
                if beside.is_file():
                    self.journal.change(place, f"texture '{given.file}'", f"now '{beside.name}', beside the materials")
                    return beside
            self.journal.loss(place, f"texture '{given.file}'", f"its constant stands in: {error.reason}")
            return None

    def _change(self, image: np.ndarray, given: Map, name: str, factor, raw: bool) -> np.ndarray | None:
        """The image that the texture shows, None where it is the file's."""
        base, gain = given.numbers("-mm", (0.0, 1.0))
        channel = given.options.get("-imfchan", [""])[0]
        alpha = bake.alpha(image)
        if name == "d" and not channel:
            channel = "m"
        if channel == "m" and alpha is not None:
            color = alpha
        elif channel in ("l", *CHANNELS) and image.shape[2] > 2:
            color = bake.decode(image, 1.0 if raw else None)
            color = (color @ LUMINANCE if channel == "l" else color[..., CHANNELS[channel]])[..., None]
        elif (base, gain) == (0.0, 1.0) and set(factor) == {1.0}:
            return None
        else:
            color = bake.decode(image, 1.0 if raw else None)
        return np.ascontiguousarray(bake.scaled(base + gain * color, factor), np.float32)

    @staticmethod
    def _place(made: Node, given: Map) -> None:
        """Scale, offset and clamping. v counts from the top here: 1 - (s (1 - v) + o) = s v + 1 - s - o."""
        if given.options.get("-clamp") == ["on"]:
            made.add("string", name="wrap_mode", value="clamp")
        (su, sv, _), (ou, ov, _) = given.numbers("-s", (1.0,) * 3), given.numbers("-o", (0.0,) * 3)
        if (su, sv, ou, ov) != (1, 1, 0, 0):
            transform = made.add("transform", name="to_uv")
            transform.add("scale", x=f"{su:.7g}", y=f"{sv:.7g}")
            transform.add("translate", x=f"{ou:.7g}", y=f"{1 - sv - ov:.7g}")
