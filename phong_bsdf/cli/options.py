"""What the commands share: kinds of values, and the options of every command that renders."""

from pathlib import Path

import click

LARGEST_SIDE = 65536


class Size(click.ParamType):
    """`640x480`."""

    name = "WxH"

    def convert(self, value, param, ctx):
        sides = str(value).lower().split("x")
        if len(sides) != 2 or not all(side.isdigit() and 0 < int(side) <= LARGEST_SIDE for side in sides):
            self.fail(f"'{value}' is no size; write it as 640x480, sides up to {LARGEST_SIDE}", param, ctx)
        return int(sides[0]), int(sides[1])


class Define(click.ParamType):
    """`name=value`."""

    name = "name=value"

    def convert(self, value, param, ctx):
        name, equals, text = str(value).partition("=")
        if not (name and equals):
            self.fail(f"'{value}' should be name=value", param, ctx)
        return name, text


class Bsdf(click.ParamType):
    """`id=plugin,name=value,...`: a surface, its new plugin, and the plugin's parameters."""

    name = "id=plugin,name=value..."

    def convert(self, value, param, ctx):
        surface, equals, rest = str(value).partition("=")
        plugin, *assignments = rest.split(",")
        pairs = [assignment.partition("=") for assignment in assignments]
        if not (surface and equals and plugin.strip()) or not all(name.strip() and eq for name, eq, _ in pairs):
            self.fail(f"'{value}' should be id=plugin or id=plugin,name=value,name=value", param, ctx)
        return surface, plugin.strip(), {name.strip(): self.parameter(text.strip()) for name, _, text in pairs}

    @staticmethod
    def parameter(text: str):
        """A number, a colour of three numbers, true or false, or else a word."""
        if text in ("true", "false"):
            return text == "true"
        try:
            numbers = tuple(map(float, text.split()))
        except ValueError:
            return text
        return numbers[0] if len(numbers) == 1 else numbers if len(numbers) == 3 else text


class Levels(click.ParamType):
    """`1,4,16`: numbers of samples, ascending."""

    name = "N,N,..."

    def convert(self, value, param, ctx):
        numbers = [text.strip() for text in str(value).split(",")]
        if not all(number.isdigit() and int(number) > 0 for number in numbers):
            self.fail(f"'{value}' is no list of samples per pixel; write it as 1,4,16", param, ctx)
        return sorted({int(number) for number in numbers})


class MethodSpec(click.ParamType):
    """`name` or `name=key=value,key=value`."""

    name = "name[=key=value,...]"

    def convert(self, value, param, ctx):
        name, _, rest = str(value).partition("=")
        pairs = [assignment.partition("=") for assignment in rest.split(",")] if rest else []
        if not name or not all(key.strip() and equals and text.strip() for key, equals, text in pairs):
            self.fail(f"'{value}' should be a name, or name=key=value,key=value", param, ctx)
        return name.strip(), {key.strip(): self.parameter(key.strip(), text.strip()) for key, _, text in pairs}

    @staticmethod
    def parameter(key: str, text: str):
        """A whole number, or what it is for a BSDF; of `spp` the text."""
        if key == "spp":
            return text
        return int(text) if text.lstrip("+-").isdigit() else Bsdf.parameter(text)


mode_option = click.option("-m", "--mode", "variant", help="Mitsuba variant. Default: llvm_ad_rgb, else scalar_rgb.")
threads_option = click.option("-t", "--threads", type=click.IntRange(min=1),
                              help="Threads, at least 2. Default: one for each core that it may use.")  # fmt: skip
verbose_option = click.option("-v", "--verbose", is_flag=True, help="Show Mitsuba's log.")

# Of commands that write pictures.
outputs_option = click.option(
    "-o",
    "--output",
    "outputs",
    multiple=True,
    required=True,
    type=click.Path(path_type=Path),
    help="File to write, .exr (linear) or .png (8 bit). May be given several times.",
)
linear_option = click.option("--linear", is_flag=True, help="PNG: 255 times the value, without the sRGB curve.")


def scene_options(command):
    """The options of every command that renders a scene."""
    spp = click.option("--spp", type=click.IntRange(min=1), help="Samples per pixel. Default: as the scene says.")
    return spp(renderer_options(command))


def renderer_options(command):
    """The options of every command that renders a scene, but for the number of samples."""
    options = (
        mode_option,
        click.option("-D", "--define", "defines", multiple=True, type=Define(),
                     help="Value for a <default> of the scene. May be given several times."),
        click.option("--size", type=Size(), help="Size of the picture. Default: as the scene says."),
        click.option("--camera", default=1, show_default=True, help="Which sensor of the scene, counted from 1."),
        click.option("-s", "--seed", type=click.IntRange(0, 2**32 - 1), default=0, show_default=True,
                     help="Seed of the sampler."),
        threads_option,
        verbose_option,
    )  # fmt: skip
    for option in reversed(options):
        command = option(command)
    return command
