"""Records as compact tables: one line for each point, one column for each quantity."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from phong_bsdf.report.tables import number, text_table

from .measure import Record


@dataclass(frozen=True)
class Column:
    """A heading, the records that it shows (values of their fields), and what their medians are multiplied with."""

    heading: str
    where: dict
    scale: float = 1.0


@dataclass(frozen=True)
class Table:
    """Records grouped `by` fields, one line a group. `only` says which records belong here."""

    title: str
    by: tuple[str, ...]
    columns: tuple[Column, ...]
    only: dict = field(default_factory=dict)
    grows: str = "size"
    """What `x` is."""

    def text(self, records: Iterable[Record]) -> str:
        """The table, empty lines left out."""
        groups = {}
        for row in records:
            if _matches(row, self.only):
                groups.setdefault(tuple(getattr(row, name) for name in self.by), []).append(row)
        lines = []
        for key, rows in groups.items():
            cells = [self._cell(rows, column) for column in self.columns]
            if any(cell is not None for cell in cells):
                lines.append([*map(_label, key), *map(_shown, cells)])
        headings = [*(name if name != "x" else self.grows for name in self.by), *(c.heading for c in self.columns)]
        return f"{self.title}\n\n{text_table(headings, lines)}" if lines else ""

    @staticmethod
    def _cell(rows, column):
        return next((row.median * column.scale for row in rows if _matches(row, column.where)), None)


def _matches(row, where) -> bool:
    return all(getattr(row, name) == value for name, value in where.items())


def _shown(value) -> str:
    """Counts and large numbers in full, others in three digits."""
    whole = value is not None and abs(value) < 1e8 and (abs(value) >= 100 or value == int(value))
    return f"{value:.0f}" if whole else number(value)


def _label(value) -> str:
    return f"{value:.10g}" if isinstance(value, float) else "" if value is None else str(value)


def _of(heading, task, quantity, scale=1.0):
    return Column(heading, {"task": task, "quantity": quantity}, scale)


MS, MB = 1e3, 2.0**-20
OURS, FLOOR, GENERAL = "whitted", "ray floor", "whitted, general"

FLOOR_TABLES = (
    Table(
        "Milliseconds, and their ratio to the ray floor",
        ("scene", "x"),
        (
            _of("floor", FLOOR, "time", MS),
            _of("whitted", OURS, "time", MS),
            _of("general", GENERAL, "time", MS),
            _of("whitted / floor", OURS, "time / ray floor"),
            _of("general / floor", GENERAL, "time / ray floor"),
        ),
    ),
    Table(
        "Rays traced",
        ("scene", "x"),
        (
            _of("shadow, floor", FLOOR, "shadow rays"),
            _of("shadow, whitted", OURS, "shadow rays"),
            _of("camera and mirror, floor", FLOOR, "camera and mirror rays"),
            _of("camera and mirror, whitted", OURS, "camera and mirror rays"),
            _of("share that differs", OURS, "share of rays that differ"),
        ),
    ),
)


def _race(kind):
    columns = [_of("ours", "phong_bsdf", f"{kind} time", MS)]
    for program in ("povray", "tachyon"):
        columns.append(_of(program, program, f"{kind} time", MS))
    for program in ("povray", "tachyon"):
        columns.append(_of(f"{program} / ours", program, f"{kind} time / phong_bsdf"))
    return tuple(columns)


PEER_TABLES = (
    Table("Warm: tracing a loaded scene, milliseconds", ("scene", "x"), _race("warm")),
    Table("Cold: whole process, milliseconds", ("scene", "x"), _race("cold")),
    Table(
        "How far the pictures differ",
        ("scene", "task", "x"),
        (
            Column("largest difference away from edges", {"quantity": "largest difference away from edges"}),
            Column("share above 2e-5", {"quantity": "share of pixels that differ by more than 2e-05"}),
            Column("share near edges", {"quantity": "share of pixels near edges"}),
        ),
    ),
)

NATIVE_TABLES = (
    Table(
        "Milliseconds, and their ratio to `direct` with `roughplastic`",
        ("task", "x"),
        (
            Column("ms", {"quantity": "time"}, MS),
            Column("ratio", {"quantity": "time / direct, roughplastic"}),
            Column("to direct, same BSDF", {"quantity": "time / direct, same BSDF"}),
        ),
    ),
)

GROWTH_TABLES = (
    Table(
        "Each point",
        ("scene", "x"),
        (
            _of("ms", OURS, "time", MS),
            _of("floor ms", FLOOR, "time", MS),
            _of("operations", OURS, "operations"),
            _of("first kernels", OURS, "kernels of the first picture"),
            _of("compile ms", OURS, "compile time", MS),
            _of("arrays MB", OURS, "memory of arrays", MB),
            _of("process MB", OURS, "memory of the process", MB),
        ),
    ),
    Table(
        "Exponents n of (quantity ~ size^n), over the larger half of the sizes",
        ("scene",),
        tuple(
            _of(name, OURS, f"exponent of {name}") for name in ("time", "operations", "memory of arrays")
        ),
    ),
)  # fmt: skip

COLD_TABLES = (
    Table(
        "Milliseconds of each stage, and of all up to the first picture",
        ("quantity",),
        tuple(Column(task, {"task": task}, MS) for task in ("empty cache", "filled cache", "plain Mitsuba")),
        {"unit": "s"},
    ),
    Table(
        "First picture in units of what any script with Mitsuba pays before its own",
        ("task",),
        (Column("ratio", {"quantity": "first picture / plain Mitsuba"}),),
    ),
    Table(
        "Compiling for the first picture",
        ("task",),
        (
            Column("ms", {"quantity": "compile time"}, MS),
            Column("operations", {"quantity": "operations"}),
            Column("time / general", {"quantity": "compile time / whitted, general"}),
        ),
    ),
)

MEMORY_TABLES = (
    Table("Bytes", ("quantity", "x"), (Column("bytes", {"unit": "bytes"}),)),
    Table("A frame of 64 x 64", ("task",), (Column("ms", {"quantity": "time"}, MS),)),
)

GRADIENT_TABLES = (
    Table(
        "Milliseconds",
        ("task", "x"),
        (
            Column("ms", {"quantity": "time"}, MS),
            Column("/ picture", {"quantity": "time / picture"}),
            Column("/ step", {"quantity": "time / step"}),
        ),
    ),
)

LOBE_TABLES = (
    Table(
        "Milliseconds of a picture with the stable and with the naive formulas",
        ("scene",),
        (
            _of("stable", "stable", "time", MS),
            _of("naive", "naive", "time", MS),
            _of("stable / naive", "stable", "time / naive"),
        ),
    ),
)

GAP_TABLES = (
    Table(
        "Milliseconds of a picture, rays kept from slipping between triangles or not",
        ("scene",),
        (
            _of("without gaps", "without gaps", "time", MS),
            _of("with gaps", "with gaps", "time", MS),
            _of("without / with", "without gaps", "time / with gaps"),
        ),
    ),
)

CLUSTER_TABLES = (
    Table(
        "What comes to the rendering",
        ("task",),
        (Column("ms", {"unit": "s"}, MS), Column("ns a byte", {"unit": "ns"})),
        {"quantity": "cost"},
    ),
    Table(
        "One picture, its passes as long as the command chooses",
        ("task",),
        (
            Column("seconds", {"quantity": "time of the picture"}),
            Column("time / no cluster", {"quantity": "time / no cluster"}),
        ),
    ),
    Table(
        "Predicted: an hour of one process on so many workers",
        ("x",),
        tuple(_of(name, "predicted", name) for name in ("time of a pass", "seconds", "speedup")),
        {"task": "predicted"},
        "workers",
    ),
)

TABLES = {
    "floor": FLOOR_TABLES,
    "peers": PEER_TABLES,
    "native": NATIVE_TABLES,
    "growth": GROWTH_TABLES,
    "cold": COLD_TABLES,
    "memory": MEMORY_TABLES,
    "lobes": LOBE_TABLES,
    "gaps": GAP_TABLES,
    "gradients": GRADIENT_TABLES,
    "cluster": CLUSTER_TABLES,
}


def text(name: str, records: Sequence[Record]) -> str:
    """All tables of one benchmark."""
    return "\n".join(filter(None, (table.text(records) for table in TABLES[name])))


def where(records: Sequence[Record]) -> str:
    """Machine, versions, threads and load of the records."""
    first = records[0]
    loads = [row.load for row in records]
    return (
        f"{first.machine}; {first.versions}; {first.variant}, {first.threads} threads; "
        f"load average {min(loads):.1f} to {max(loads):.1f}"
    )
