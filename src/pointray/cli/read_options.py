"""The options about reading scans, which several commands share, parsed into a `Reading`."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from functools import wraps
from typing import Annotated, Any

import typer

PANEL = "Which points are read, and how"


@dataclass(frozen=True)
class Reading:
    """How scans are read: the arguments of `pr.read` besides the files.

    Attributes
    ----------
    columns : tuple of str or None
    every : int
    max_points : int or None
    bounds : tuple of six floats or None
    keep, drop : dict of str to tuple of float, or None
    resolution : float or None
    sample : int or None
    opacity : float
    intrinsics : tuple of four or five floats, or None
    strict : bool
    drop_strays : bool
        Whether strays are left out of what was read: no argument of `pr.read`.
    """

    columns: tuple[str, ...] | None = None
    every: int = 1
    max_points: int | None = None
    bounds: tuple[float, ...] | None = None
    keep: Mapping[str, tuple[float, ...]] | None = None
    drop: Mapping[str, tuple[float, ...]] | None = None
    resolution: float | None = None
    sample: int | None = None
    opacity: float = 0.1
    intrinsics: tuple[float, ...] | None = None
    strict: bool = False
    drop_strays: bool = False

    @property
    def arguments(self) -> dict[str, Any]:
        """What is not as usual, as arguments of `pr.read`."""
        return {name: getattr(self, name) for name in self.unusual if name != "drop_strays"}

    @property
    def unusual(self) -> list[str]:
        """The names of what is not as usual."""
        return [x.name for x in fields(self) if getattr(self, x.name) != x.default]

    @property
    def is_plain(self) -> bool:
        """Whether all is as usual."""
        return not self.unusual

    @property
    def inputs(self) -> dict[str, Any]:
        """All of it, as values of JSON."""
        return asdict(self)

    @property
    def request(self) -> Any:
        """The `Request` that formats get."""
        from ..io.files import request_of

        return request_of(
            self.columns, self.bounds, self.resolution, self.sample, self.opacity, self.intrinsics, self.strict
        )


ColumnsOption = Annotated[
    str | None,
    typer.Option(
        help="Of a text file, or of a .bin file of float32: what its columns are, like x,y,z,r,g,b,intensity; "
        '"-" leaves one out. Default: found.',
        rich_help_panel=PANEL,
    ),
]
EveryOption = Annotated[int, typer.Option(help="Take every so manieth point.", rich_help_panel=PANEL)]
MaxPointsOption = Annotated[
    int | None, typer.Option(help="At most so many points, evenly spread over the rows.", rich_help_panel=PANEL)
]
BoundsOption = Annotated[
    str | None, typer.Option(help="Only what lies in the box x0,y0,z0,x1,y1,z1.", rich_help_panel=PANEL)
]
KeepOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Only points with these values, like classification=ground,6; repeatable.", rich_help_panel=PANEL
    ),
]
DropOption = Annotated[
    list[str] | None,
    typer.Option(help="No points with these values, like classification=low-noise,18.", rich_help_panel=PANEL),
]
ResolutionOption = Annotated[
    float | None,
    typer.Option(help="Of a COPC file: the coarsest spacing that will do. Default: all points.", rich_help_panel=PANEL),
]
SampleOption = Annotated[
    int | None,
    typer.Option(
        help="Number of points to sample on the triangles of a mesh; 0 takes its vertices. Default: the vertices, "
        "or 200,000 points if these are too far apart to show the surface.",
        rich_help_panel=PANEL,
    ),
]
OpacityOption = Annotated[
    float,
    typer.Option(help="Of Gaussian splats: those of less opacity, 0 to 1, are left out.", rich_help_panel=PANEL),
]
IntrinsicsOption = Annotated[
    str | None,
    typer.Option(
        help="Of a depth picture: fx,fy,cx,cy in pixels, perhaps ,steps: its values in a unit of length.",
        rich_help_panel=PANEL,
    ),
]
StrictOption = Annotated[
    bool,
    typer.Option(
        "--strict",
        help="Refuse files that are cut off, contradict themselves or lack a file that they name.",
        rich_help_panel=PANEL,
    ),
]
DropStraysOption = Annotated[
    bool,
    typer.Option(
        "--drop-strays",
        help="Leave out points of no surface: sparse second layers, veils, floating groups, lone ones.",
        rich_help_panel=PANEL,
    ),
]
OPTIONS = {
    "columns": ColumnsOption,
    "every": EveryOption,
    "max_points": MaxPointsOption,
    "bounds": BoundsOption,
    "keep": KeepOption,
    "drop": DropOption,
    "resolution": ResolutionOption,
    "sample": SampleOption,
    "opacity": OpacityOption,
    "intrinsics": IntrinsicsOption,
    "strict": StrictOption,
    "drop_strays": DropStraysOption,
}


def with_reading(command: Callable[..., None]) -> Callable[..., None]:
    """The command with the options of reading in place of its parameter `reading`, which is made of them."""
    signature = inspect.signature(command, eval_str=True)
    own = [parameter for name, parameter in signature.parameters.items() if name != "reading"]
    assert len(own) < len(signature.parameters)
    usual = {field.name: field.default for field in fields(Reading)}
    options = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=usual[name], annotation=kind)
        for name, kind in OPTIONS.items()
    ]

    @wraps(command)
    def run(**values: Any) -> None:
        texts = {name: values.pop(name) for name in OPTIONS}
        command(**values, reading=reading_of(texts))

    run.__signature__ = signature.replace(parameters=[*own, *options])  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in (*own, *options)}
    return run


def reading_of(values: dict[str, Any]) -> Reading:
    """Parse the values of the options; a wrong one raises ValueError."""
    parsed = dict(values)
    if values["columns"] is not None:
        parsed["columns"] = tuple(name.strip() for name in values["columns"].split(","))
    if values["bounds"] is not None:
        parsed["bounds"] = _numbers(values["bounds"], "--bounds", "x0,y0,z0,x1,y1,z1")
    if values["intrinsics"] is not None:
        parsed["intrinsics"] = _numbers(values["intrinsics"], "--intrinsics", "fx,fy,cx,cy, perhaps ,steps")
    for name in ("keep", "drop"):
        parsed[name] = _choices(values[name] or [], f"--{name}")
    reading = Reading(**parsed)
    if not reading.is_plain:
        from ..io.reading import check_reading

        try:
            check_reading(reading.arguments)
        except ValueError as error:
            raise ValueError(_as_option(str(error))) from None
    return reading


def _numbers(text: str, name: str, wanted: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"{name} must be {wanted}, not {text!r}") from None


def _choices(texts: list[str], name: str) -> dict[str, tuple[float, ...]] | None:
    """Parse `attribute=value,value`; of an attribute that is given twice all values count."""
    found: dict[str, tuple[float, ...]] = {}
    for text in texts:
        attribute, _, values = text.rpartition("=")
        if not attribute:
            raise ValueError(f"{name} must be like classification=2,6, not {text!r}")
        numbers = tuple(x for value in values.split(",") for x in _value(value.strip(), attribute, name))
        found[attribute] = tuple(dict.fromkeys((*found.get(attribute, ()), *numbers)))
    return found or None


def _value(text: str, attribute: str, name: str) -> tuple[float, ...]:
    """One value: a number, or the name of a class of LAS."""
    if not text or text[0] in "+-." or text[0].isdigit():
        return _numbers(text, name, f"like {attribute}=2,6")
    from ..shade.attributes import ASPRS, is_classification

    names = (
        {label.replace(" ", "-"): code for code, (label, _) in ASPRS.items()} if is_classification(attribute) else {}
    )
    if text.lower().replace(" ", "-") not in names:
        known = f", or the name of a class: {', '.join(names)}" if names else ""
        raise ValueError(f"{name} must be like {attribute}=2,6{known}, not {text!r}")
    return (float(names[text.lower().replace(" ", "-")]),)


def _as_option(message: str) -> str:
    """A message that begins with the name of an argument, as one that begins with an option's."""
    name = next((name for name in OPTIONS if message.startswith(name)), "")
    return f"--{name.replace('_', '-')}{message.removeprefix(name)}" if name else message
